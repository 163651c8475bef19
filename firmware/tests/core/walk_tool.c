/* walk_tool: reads blocks from stdin and prints every record of every whole one: sequence, type, time, length of data;
 * then `unreadable` where the rest of a block cannot be read. */
#include <inttypes.h>
#include <stdio.h>

#include "block.h"
#include "error.h"

static void walk(const uint8_t *block, const block_head_t *head)
{
    block_record_t record;
    size_t at = 0;
    int result = block_next(block, head, &at, &record);
    for (; result > 0; result = block_next(block, head, &at, &record)) {
        printf("%" PRIu32 " %u %" PRId64 " %zu\n", head->sequence, record.type, (int64_t)record.time_us, record.length);
    }
    if (result < 0) {
        printf("%" PRIu32 " unreadable\n", head->sequence);
    }
}

int main(void)
{
    uint8_t block[BLOCK_BYTES];
    block_head_t head;
    while (fread(block, sizeof block, 1, stdin) == 1) {
        if (block_read_head(block, &head) == CORE_OK) {
            walk(block, &head);
        }
    }
    return 0;
}
