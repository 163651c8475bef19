/* The end of a file that was not closed: the first block that does not continue it, by binary search. */
#ifndef CORE_RECOVERY_H
#define CORE_RECOVERY_H

#include <stdint.h>

typedef struct {
    int (*read)(void *context, uint32_t index, uint8_t *block); /* block `index` of the file; 0 or negative */
    void *context;
} recovery_source_t;

typedef struct {
    uint32_t blocks;   /* that belong to the recording */
    uint32_t session;  /* 0: the file holds none */
    uint32_t sequence; /* of the block that would come next */
} recovery_end_t;

/* Search a file of `blocks` blocks with `block` (BLOCK_BYTES) as scratch; reads about log2(blocks) + 8 of them. A few
 * damaged blocks do not end a recording: only RECOVERY_MISSING in a row do. CORE_OK or CORE_DEVICE. */
enum { RECOVERY_MISSING = 4 };
int recovery_find_end(const recovery_source_t *source, uint32_t blocks, uint8_t *block, recovery_end_t *end);

#endif
