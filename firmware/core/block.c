#include "block.h"

#include <string.h>

#include "bytes.h"
#include "crc32.h"
#include "error.h"
#include "records.h"

static const uint8_t magic[4] = {'K', 'L', 'G', 1};

void block_close(uint8_t *block, const block_head_t *head)
{
    memcpy(block, magic, sizeof magic);
    bytes_put_u32(block + BLOCK_SESSION, head->session);
    bytes_put_u32(block + BLOCK_SEQUENCE, head->sequence);
    bytes_put_u48(block + BLOCK_BASE, head->base_us);
    bytes_put_u16(block + BLOCK_USED, head->used);
    bytes_put_u32(block + BLOCK_IMU_NUMBER, head->imu_number);
    memset(block + BLOCK_RECORDS + head->used, 0, (size_t)BLOCK_CAPACITY - head->used);
}

void block_seal(uint8_t *block)
{
    bytes_put_u32(block + BLOCK_CRC, crc32_update(0, block, BLOCK_CRC));
}

int block_read_head(const uint8_t *block, block_head_t *head)
{
    const uint16_t used = bytes_get_u16(block + BLOCK_USED);
    if (memcmp(block, magic, sizeof magic) != 0 || used > BLOCK_CAPACITY ||
        crc32_update(0, block, BLOCK_CRC) != bytes_get_u32(block + BLOCK_CRC)) {
        return CORE_INVALID;
    }
    head->session = bytes_get_u32(block + BLOCK_SESSION);
    head->sequence = bytes_get_u32(block + BLOCK_SEQUENCE);
    head->base_us = bytes_get_u48(block + BLOCK_BASE);
    head->imu_number = bytes_get_u32(block + BLOCK_IMU_NUMBER);
    head->used = used;
    return CORE_OK;
}

int block_next(const uint8_t *block, const block_head_t *head, size_t *at, block_record_t *record)
{
    if (*at >= head->used) {
        return 0;
    }
    const uint8_t *start = block + BLOCK_RECORDS + *at;
    const int length = record_length(start, head->used - *at);
    if (length < 0) {
        return CORE_INVALID;
    }
    const bool is_long = start[0] >= RECORD_FIRST_LONG;
    const size_t head_bytes = is_long ? RECORD_LONG_HEAD : RECORD_SHORT_HEAD;
    const int64_t since_base_us = is_long ? bytes_get_i32(start + 2) : (int64_t)bytes_get_u16(start + 1);
    record->type = start[0];
    record->time_us = (uint64_t)((int64_t)head->base_us + since_base_us);
    record->data = start + head_bytes;
    record->length = (size_t)length - head_bytes;
    *at += (size_t)length;
    return 1;
}
