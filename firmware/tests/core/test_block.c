#include <string.h>

#include "block.h"
#include "check.h"
#include "crc32.h"
#include "error.h"
#include "records.h"

static const block_head_t example = {.session = 0xDEADBEEF, .sequence = 7, .base_us = UINT64_C(0x123456789A),
                                     .imu_number = 31, .used = 0};

static block_head_t fill(uint8_t *block)
{
    const record_imu_t imu = {{1, 2, 3}, {4, 5, 6}};
    block_head_t head = example;
    uint8_t *out = block + BLOCK_RECORDS;
    out += record_put_imu(out, 10, &imu);
    out += record_put_gps(out, -5, (const uint8_t *)"$x\r\n", 4);
    head.used = (uint16_t)(out - block - BLOCK_RECORDS);
    block_close(block, &head);
    block_seal(block);
    return head;
}

static void round_trip(void)
{
    uint8_t block[BLOCK_BYTES];
    memset(block, 0xEE, sizeof block);
    const block_head_t head = fill(block);
    block_head_t have;
    CHECK_EQUAL(block_read_head(block, &have), CORE_OK);
    CHECK(have.session == head.session && have.sequence == head.sequence && have.base_us == head.base_us);
    CHECK(have.imu_number == head.imu_number && have.used == head.used);
    block_record_t record;
    size_t at = 0;
    CHECK_EQUAL(block_next(block, &have, &at, &record), 1);
    CHECK(record.type == RECORD_IMU && record.time_us == head.base_us + 10 && record.length == 12);
    CHECK_EQUAL(block_next(block, &have, &at, &record), 1);
    CHECK(record.type == RECORD_GPS && record.time_us == head.base_us - 5 && record.length == 4);
    CHECK_SAME(record.data, "$x\r\n", 4);
    CHECK_EQUAL(block_next(block, &have, &at, &record), 0);
}

static void rest_is_zero(void)
{
    uint8_t block[BLOCK_BYTES];
    memset(block, 0xEE, sizeof block);
    const block_head_t head = fill(block);
    for (size_t i = BLOCK_RECORDS + head.used; i < BLOCK_CRC; i++) {
        CHECK_EQUAL(block[i], 0);
    }
}

static void every_bit(void)
{
    uint8_t block[BLOCK_BYTES];
    fill(block);
    for (size_t bit = 0; bit < (size_t)BLOCK_BYTES * 8; bit++) {
        block_head_t head = example;
        block[bit / 8] ^= (uint8_t)(1U << bit % 8);
        CHECK_EQUAL(block_read_head(block, &head), CORE_INVALID);
        CHECK_EQUAL(head.sequence, example.sequence);
        block[bit / 8] ^= (uint8_t)(1U << bit % 8);
    }
}

static void too_much_used(void)
{
    uint8_t block[BLOCK_BYTES];
    block_head_t head = fill(block);
    block[BLOCK_USED] = (BLOCK_CAPACITY + 1) & 0xFF;
    block[BLOCK_USED + 1] = (BLOCK_CAPACITY + 1) >> 8;
    block_seal(block);
    CHECK_EQUAL(block_read_head(block, &head), CORE_INVALID);
}

static void unreadable_rest(void)
{
    uint8_t block[BLOCK_BYTES];
    block_head_t head = fill(block);
    block[BLOCK_RECORDS + RECORD_IMU_BYTES] = 0x7E; /* an unknown short type where the sentence was */
    block_seal(block);
    block_record_t record;
    size_t at = 0;
    CHECK_EQUAL(block_read_head(block, &head), CORE_OK);
    CHECK_EQUAL(block_next(block, &head, &at, &record), 1);
    CHECK_EQUAL(block_next(block, &head, &at, &record), CORE_INVALID);
}

const suite_t block_suite = {"block",
                             (const test_t[]){{"what was written into a block is read from it", round_trip},
                                              {"what follows the records is zero", rest_is_zero},
                                              {"any flipped bit is noticed", every_bit},
                                              {"more used bytes than there are is no block", too_much_used},
                                              {"an unknown record ends the block for a reader", unreadable_rest},
                                              {0}}};
