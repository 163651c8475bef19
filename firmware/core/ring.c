#include "ring.h"

#include <stddef.h>

void ring_init(ring_t *ring, uint8_t (*blocks)[BLOCK_BYTES], uint32_t size)
{
    ring->blocks = blocks;
    ring->size = size;
    atomic_init(&ring->head, 0);
    atomic_init(&ring->tail, 0);
}

/* Both indices count on for ever and their difference is right across the wrap at 2^32; block 0 follows the last slot
 * then only if size divides 2^32, which at 30 blocks a second is 4 years away. */
static uint8_t *slot(ring_t *ring, uint32_t number)
{
    return ring->blocks[number % ring->size];
}

static uint32_t load(atomic_uint_fast32_t *index)
{
    return (uint32_t)atomic_load_explicit(index, memory_order_acquire);
}

uint8_t *ring_open(ring_t *ring)
{
    const uint32_t head = load(&ring->head);
    return (uint32_t)(head - load(&ring->tail)) >= ring->size ? NULL : slot(ring, head);
}

void ring_commit(ring_t *ring)
{
    atomic_store_explicit(&ring->head, (uint32_t)(load(&ring->head) + 1), memory_order_release);
}

uint32_t ring_count(ring_t *ring)
{
    return (uint32_t)(load(&ring->head) - load(&ring->tail));
}

uint8_t *ring_peek(ring_t *ring, uint32_t index)
{
    return index < ring_count(ring) ? slot(ring, load(&ring->tail) + index) : NULL;
}

void ring_release(ring_t *ring)
{
    atomic_store_explicit(&ring->tail, (uint32_t)(load(&ring->tail) + 1), memory_order_release);
}
