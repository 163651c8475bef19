/* The ring between two threads, for ThreadSanitizer: what one commits the other sees whole and in order. */
#define _POSIX_C_SOURCE 200809L
#include <pthread.h>
#include <sched.h>
#include <stdio.h>
#include <string.h>

#include "ring.h"

enum { SIZE = 4, BLOCKS = 20000 };

static uint8_t storage[SIZE][BLOCK_BYTES];
static ring_t ring;

static void *produce(void *unused)
{
    for (uint32_t i = 0; i < BLOCKS;) {
        uint8_t *block = ring_open(&ring);
        if (block != NULL) {
            memcpy(block, &i, sizeof i);
            memcpy(block + BLOCK_BYTES - sizeof i, &i, sizeof i);
            ring_commit(&ring);
            i++;
        } else {
            sched_yield();
        }
    }
    return unused;
}

int main(void)
{
    pthread_t producer;
    unsigned wrong = 0;
    ring_init(&ring, storage, SIZE);
    if (pthread_create(&producer, NULL, produce, NULL) != 0) {
        return 2;
    }
    for (uint32_t i = 0; i < BLOCKS;) {
        const uint8_t *block = ring_peek(&ring, 0);
        if (block != NULL) {
            wrong += memcmp(block, &i, sizeof i) != 0 || memcmp(block + BLOCK_BYTES - sizeof i, &i, sizeof i) != 0 ? 1 : 0;
            ring_release(&ring);
            i++;
        } else {
            sched_yield();
        }
    }
    pthread_join(producer, NULL);
    printf("%u of %d blocks wrong\n", wrong, BLOCKS);
    return wrong == 0 ? 0 : 1;
}
