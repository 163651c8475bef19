#include "check.h"
#include "ring.h"

enum { SIZE = 3 };

static uint8_t storage[SIZE][BLOCK_BYTES];

static void order(void)
{
    ring_t ring;
    ring_init(&ring, storage, SIZE);
    uint32_t state = 1;
    uint8_t next_in = 0;
    uint8_t next_out = 0;
    for (int i = 0; i < 10000; i++) {
        uint8_t *block = ring_open(&ring);
        CHECK((block == NULL) == (ring_count(&ring) == SIZE));
        if (block != NULL && random_below(&state, 2) == 0) {
            *block = next_in++;
            ring_commit(&ring);
        }
        if (ring_count(&ring) > 0 && random_below(&state, 2) == 0) {
            CHECK_EQUAL(*ring_peek(&ring, 0), next_out);
            next_out++;
            ring_release(&ring);
        }
        CHECK_EQUAL(ring_count(&ring), (uint8_t)(next_in - next_out));
    }
}

static void same_block_until_committed(void)
{
    ring_t ring;
    ring_init(&ring, storage, SIZE);
    uint8_t *block = ring_open(&ring);
    CHECK(block == ring_open(&ring));
    ring_commit(&ring);
    CHECK(block != ring_open(&ring));
}

static void look_ahead(void)
{
    ring_t ring;
    ring_init(&ring, storage, SIZE);
    CHECK(ring_peek(&ring, 0) == NULL);
    for (uint8_t i = 0; i < SIZE; i++) {
        *ring_open(&ring) = i;
        ring_commit(&ring);
    }
    for (uint8_t i = 0; i < SIZE; i++) {
        CHECK_EQUAL(*ring_peek(&ring, i), i);
    }
    CHECK(ring_peek(&ring, SIZE) == NULL && ring_open(&ring) == NULL);
}

const suite_t ring_suite = {"ring",
                            (const test_t[]){{"blocks come out in the order they went in", order},
                                             {"the open block stays the same until it is committed",
                                              same_block_until_committed},
                                             {"the consumer sees all committed blocks and no other", look_ahead},
                                             {0}}};
