#include <string.h>

#include "block.h"
#include "check.h"
#include "error.h"
#include "recovery.h"

enum { FILE_BLOCKS = 200, SESSION = 77, OLDER = 76 };

static uint8_t file[FILE_BLOCKS][BLOCK_BYTES];
static uint32_t reads;

static int read_block(void *context, uint32_t index, uint8_t *block)
{
    const uint32_t *failing = context;
    reads++;
    if (index >= FILE_BLOCKS || index == *failing) {
        return -1;
    }
    memcpy(block, file[index], BLOCK_BYTES);
    return 0;
}

static void write_block(uint32_t index, uint32_t session, uint32_t sequence)
{
    const block_head_t head = {.session = session, .sequence = sequence};
    block_close(file[index], &head);
    block_seal(file[index]);
}

static int find(recovery_end_t *end)
{
    uint8_t block[BLOCK_BYTES];
    uint32_t failing = UINT32_MAX;
    reads = 0;
    return recovery_find_end(&(recovery_source_t){read_block, &failing}, FILE_BLOCKS, block, end);
}

static void older_recording(void)
{
    for (uint32_t i = 0; i < FILE_BLOCKS; i++) {
        write_block(i, OLDER, i);
    }
}

static void every_length(void)
{
    for (uint32_t length = 1; length <= FILE_BLOCKS; length++) {
        recovery_end_t end;
        older_recording();
        for (uint32_t i = 0; i < length; i++) {
            write_block(i, SESSION, 1000 + i);
        }
        CHECK_EQUAL(find(&end), CORE_OK);
        CHECK(end.blocks == length && end.session == SESSION && end.sequence == 1000 + length);
        CHECK(reads <= 1 + 1 + 8 * RECOVERY_MISSING);
    }
}

static void torn_last(void)
{
    recovery_end_t end;
    older_recording();
    for (uint32_t i = 0; i < 50; i++) {
        write_block(i, SESSION, i);
    }
    memset(file[49] + 256, 0xFF, 256);
    CHECK_EQUAL(find(&end), CORE_OK);
    CHECK_EQUAL(end.blocks, 49);
}

static void damaged_inside(void)
{
    for (uint32_t bad = 0; bad < 47; bad++) {
        recovery_end_t end;
        older_recording();
        for (uint32_t i = 0; i < 50; i++) {
            write_block(i, SESSION, i);
        }
        for (uint32_t i = bad; i < bad + RECOVERY_MISSING - 1; i++) {
            memset(file[i], 0, BLOCK_BYTES);
        }
        CHECK_EQUAL(find(&end), CORE_OK);
        CHECK_EQUAL(end.blocks, 50);
    }
}

static void nothing_there(void)
{
    recovery_end_t end;
    memset(file, 0, sizeof file);
    CHECK_EQUAL(find(&end), CORE_OK);
    CHECK(end.blocks == 0 && end.session == 0);
    CHECK_EQUAL(reads, RECOVERY_MISSING);
}

static void failing_card(void)
{
    older_recording();
    uint8_t block[BLOCK_BYTES];
    uint32_t failing = 0;
    recovery_end_t end;
    CHECK_EQUAL(recovery_find_end(&(recovery_source_t){read_block, &failing}, FILE_BLOCKS, block, &end), CORE_DEVICE);
    failing = FILE_BLOCKS / 2;
    CHECK_EQUAL(recovery_find_end(&(recovery_source_t){read_block, &failing}, FILE_BLOCKS, block, &end), CORE_DEVICE);
}

const suite_t recovery_suite = {
    "recovery",
    (const test_t[]){{"the end is found whatever the length, before blocks of an older recording", every_length},
                     {"a torn last block is not part of the file", torn_last},
                     {"a few damaged blocks do not end a recording", damaged_inside},
                     {"a file without a recording has none", nothing_there},
                     {"a card that cannot be read is said", failing_card},
                     {0}}};
