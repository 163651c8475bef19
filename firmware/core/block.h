/* Blocks of FORMAT.md section 2: layout, sealing, checking, and walking the records of one. */
#ifndef CORE_BLOCK_H
#define CORE_BLOCK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    BLOCK_BYTES = 512,
    BLOCK_SESSION = 4,
    BLOCK_SEQUENCE = 8,
    BLOCK_BASE = 12,
    BLOCK_USED = 18,
    BLOCK_IMU_NUMBER = 20,
    BLOCK_RECORDS = 24,
    BLOCK_CRC = 508,
    BLOCK_CAPACITY = BLOCK_CRC - BLOCK_RECORDS
};

typedef struct {
    uint32_t session;
    uint32_t sequence;
    uint64_t base_us;
    uint32_t imu_number;
    uint16_t used;
} block_head_t;

typedef struct {
    uint8_t type;
    uint64_t time_us;
    const uint8_t *data; /* inside the block */
    size_t length;
} block_record_t;

/* Write the head of a block whose records are in place, and zeros after them. */
void block_close(uint8_t *block, const block_head_t *head);

/* Write the CRC of a closed block; may be repeated. Apart from block_close, so that no interrupt computes it. */
void block_seal(uint8_t *block);

/* Read the head of a block. CORE_INVALID, and `head` untouched, unless magic, CRC and used bytes are right. */
int block_read_head(const uint8_t *block, block_head_t *head);

/* Step through the records of a block that block_read_head has accepted: start with *at = 0. Return 1 and the record,
 * 0 at the end, CORE_INVALID where the rest cannot be read. */
int block_next(const uint8_t *block, const block_head_t *head, size_t *at, block_record_t *record);

#endif
