/* One target for libFuzzer, for long runs, and for driver.c, which needs no clang and is what the tests run. In firmware/:
 *
 *   clang -std=c11 -g -O1 -fsanitize=fuzzer,address,undefined -Icore -Ifuzz core/[a-z]*.c fuzz/fuzz_block.c -o fuzz_block
 *   ./fuzz_block -max_total_time=90 -max_len=1200
 *   cc -std=c11 -g -O1 -fsanitize=address,undefined -Icore -Ifuzz core/[a-z]*.c fuzz/fuzz_block.c fuzz/driver.c */
#ifndef FUZZ_H
#define FUZZ_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

extern const char *const fuzz_seeds[]; /* up to NULL; for driver.c */

static inline void fuzz_require(int holds)
{
    if (!holds) {
        abort();
    }
}

#endif
