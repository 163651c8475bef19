/* One target for libFuzzer (clang -fsanitize=fuzzer) and for driver.c where there is no clang. */
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
