#include "recovery.h"

#include "block.h"
#include "error.h"

typedef struct {
    const recovery_source_t *source;
    uint8_t *block;
    uint32_t blocks;
    uint32_t session;
    uint32_t first; /* sequence of block 0 */
} search_t;

/* 1 if block `index` belongs to the recording, 0 if not, or CORE_DEVICE. */
static int belongs(const search_t *search, uint32_t index)
{
    block_head_t head;
    if (search->source->read(search->source->context, index, search->block) < 0) {
        return CORE_DEVICE;
    }
    if (block_read_head(search->block, &head) != CORE_OK) {
        return 0;
    }
    return head.session == search->session && head.sequence == search->first + index ? 1 : 0;
}

/* The first block that can be read says which recording this is. 1 found, 0 none, or CORE_DEVICE. */
static int identify(search_t *search)
{
    for (uint32_t index = 0; index < RECOVERY_MISSING && index < search->blocks; index++) {
        block_head_t head;
        if (search->source->read(search->source->context, index, search->block) < 0) {
            return CORE_DEVICE;
        }
        if (block_read_head(search->block, &head) == CORE_OK && head.session != 0) {
            search->session = head.session;
            search->first = head.sequence - index;
            return 1;
        }
    }
    return 0;
}

/* The first block from `index` on that belongs, looking at no more than may be missing: 1 and *at, 0, or CORE_DEVICE. */
static int next_of(const search_t *search, uint32_t index, uint32_t *at)
{
    for (uint32_t i = index; i < search->blocks && i - index < RECOVERY_MISSING; i++) {
        const int result = belongs(search, i);
        if (result != 0) {
            *at = i;
            return result;
        }
    }
    return 0;
}

/* Binary search for the last block: `last` belongs; from `beyond` on nothing does. */
static int search_end(const search_t *search, uint32_t *last)
{
    uint32_t beyond = search->blocks;
    while (beyond - *last > 1) {
        const uint32_t middle = *last + (beyond - *last) / 2;
        uint32_t found = 0;
        const int result = next_of(search, middle, &found);
        if (result < 0) {
            return result;
        }
        if (result == 0) {
            beyond = middle;
        } else {
            *last = found;
        }
        if (*last >= beyond) {
            break;
        }
    }
    return CORE_OK;
}

int recovery_find_end(const recovery_source_t *source, uint32_t blocks, uint8_t *block, recovery_end_t *end)
{
    search_t search = {.source = source, .block = block, .blocks = blocks};
    *end = (recovery_end_t){0, 0, 0};
    int result = identify(&search);
    if (result <= 0) {
        return result;
    }
    uint32_t last = 0;
    result = next_of(&search, 0, &last);
    if (result < 0) {
        return result;
    }
    result = search_end(&search, &last);
    if (result < 0) {
        return result;
    }
    *end = (recovery_end_t){.blocks = last + 1, .session = search.session, .sequence = search.first + last + 1};
    return CORE_OK;
}
