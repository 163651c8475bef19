/* Ring of blocks between one producer (interrupts of one priority) and one consumer (the main loop).
 *
 * The producer fills a block in place and commits it; the consumer sees committed blocks only, oldest first, and may
 * look at several before it releases them (multi-block writes). No lock: each index has one writer.
 *
 * With IMU at 1 kHz, compass at 100 Hz, temperature and three sentences at 5 Hz, one block in the card's hands, and a
 * stall that begins at the worst moment (the block being filled is nearly full), the shortest stall that loses a sample
 * is 612 ms with 24 blocks, 693 with 27, 722 with 28: so 28 ride out 700 ms. tests/firmware/test_core.py measures it. */
#ifndef CORE_RING_H
#define CORE_RING_H

#include <stdatomic.h>
#include <stdint.h>

#include "block.h"

typedef struct {
    uint8_t (*blocks)[BLOCK_BYTES];
    uint32_t size;             /* blocks there are room for */
    atomic_uint_fast32_t head; /* blocks committed since the start; only the producer writes it */
    atomic_uint_fast32_t tail; /* blocks released since the start; only the consumer writes it */
} ring_t;

void ring_init(ring_t *ring, uint8_t (*blocks)[BLOCK_BYTES], uint32_t size);

/* Producer: the block to fill, NULL while all are committed and none released. The same one until it is committed. */
uint8_t *ring_open(ring_t *ring);
void ring_commit(ring_t *ring);

/* Consumer: committed blocks waiting; block `index` of them (0 the oldest), NULL if there are not so many. */
uint32_t ring_count(ring_t *ring);
uint8_t *ring_peek(ring_t *ring, uint32_t index);
void ring_release(ring_t *ring);

#endif
