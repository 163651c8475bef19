/* Whatever a sector or a line holds: blocks and frames are walked inside their bounds. Magic and CRC are made right, so
 * that the records are reached. */
#include <string.h>

#include "block.h"
#include "error.h"
#include "frame.h"
#include "fuzz.h"
#include "records.h"

static void walk(const uint8_t *block, const block_head_t *head)
{
    block_record_t record;
    size_t at = 0;
    int result = block_next(block, head, &at, &record);
    for (; result > 0; result = block_next(block, head, &at, &record)) {
        fuzz_require(record.data >= block + BLOCK_RECORDS + RECORD_SHORT_HEAD);
        fuzz_require(record.data + record.length <= block + BLOCK_RECORDS + head->used);
        fuzz_require(at <= head->used);
    }
}

static void as_block(const uint8_t *data, size_t size)
{
    uint8_t block[BLOCK_BYTES] = {0};
    block_head_t head = {.session = 1};
    memcpy(block, data, size < BLOCK_CRC ? size : BLOCK_CRC);
    if (block_read_head(block, &head) == CORE_OK) {
        walk(block, &head);
    }
    memcpy(block, "KLG\x01", 4);
    block_seal(block);
    if (block_read_head(block, &head) == CORE_OK) {
        walk(block, &head);
    }
}

static void as_frames(const uint8_t *data, size_t size)
{
    frame_view_t view;
    size_t at = 0;
    for (size_t done = frame_find(data, size, &view); done > 0; done = frame_find(data + at, size - at, &view)) {
        at += done;
        fuzz_require(at <= size && view.length <= FRAME_CAPACITY);
        fuzz_require(view.length == 0 || view.records + view.length <= data + at);
    }
}

static void as_records(const uint8_t *data, size_t size)
{
    for (size_t at = 0; at < size;) {
        const int length = record_length(data + at, size - at);
        if (length < 0) {
            break;
        }
        fuzz_require(length > 0 && (size_t)length <= size - at);
        at += (size_t)length;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    as_block(data, size);
    as_frames(data, size);
    as_records(data, size);
    return 0;
}

const char *const fuzz_seeds[] = {
    "KLG\x01....1234567890\x20\x01....\x01..123456789012\x02..1234567\x03..12\x81\x05....$abc\n\x83\x12....",
    "\xA5\x5A\x0F..123456\x01..123456789012....",
    NULL,
};
