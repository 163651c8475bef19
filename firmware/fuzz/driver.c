/* driver RUNS [SEED]: a plain mutating fuzzer, for compilers without libFuzzer. Bounded, reproducible; a finding aborts
 * (or the sanitizer does), after the input that caused it was written to ./finding. */
#include <signal.h>
#include <stdio.h>
#include <string.h>

#include "fuzz.h"

enum { LONGEST = 1200, KEPT = 256 };

static uint8_t input[LONGEST];
static size_t input_length;

static uint32_t next(uint32_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return *state;
}

static void save(int signal_number)
{
    FILE *file = fopen("finding", "wb");
    if (file != NULL) {
        fwrite(input, 1, input_length, file);
        fclose(file);
    }
    signal(signal_number, SIG_DFL);
    raise(signal_number);
}

static void insert(uint32_t *state, size_t at, size_t count)
{
    count = count > LONGEST - input_length ? LONGEST - input_length : count;
    memmove(input + at + count, input + at, input_length - at);
    for (size_t i = 0; i < count; i++) {
        input[at + i] = input_length > 0 && next(state) % 2 == 0 ? input[next(state) % input_length] : (uint8_t)next(state);
    }
    input_length += count;
}

static void mutate(uint32_t *state)
{
    const size_t at = input_length == 0 ? 0 : next(state) % input_length;
    const size_t rest = input_length - at;
    switch (next(state) % 6) {
    case 0: insert(state, at, 1 + next(state) % 8); break;
    case 1: insert(state, at, 1 + next(state) % 300); break;
    case 2:
        if (rest > 0) {
            const size_t count = 1 + next(state) % (rest < 16 ? rest : 16);
            memmove(input + at, input + at + count, rest - count);
            input_length -= count;
        }
        break;
    case 3:
        if (rest > 0) {
            input[at] ^= (uint8_t)(1U << next(state) % 8);
        }
        break;
    case 4:
        if (rest > 0) {
            static const uint8_t odd[] = {0x00, 0xFF, 0x7F, 0x80, '\n', '$', '=', 0xA5, 0x5A, 0xB5, 0x62};
            input[at] = odd[next(state) % sizeof odd];
        }
        break;
    default: input_length = at; break;
    }
}

int main(int count, char **arguments)
{
    const unsigned long runs = count > 1 ? strtoul(arguments[1], NULL, 10) : 100000;
    uint32_t state = count > 2 ? (uint32_t)strtoul(arguments[2], NULL, 10) : 1;
    size_t seeds = 0;
    while (fuzz_seeds[seeds] != NULL) {
        seeds++;
    }
    signal(SIGABRT, save);
    for (unsigned long i = 0; i < runs; i++) {
        const char *seed = fuzz_seeds[next(&state) % seeds];
        input_length = strlen(seed);
        memcpy(input, seed, input_length);
        for (uint32_t changes = next(&state) % 12; changes > 0; changes--) {
            mutate(&state);
        }
        uint8_t *exact = malloc(input_length > 0 ? input_length : 1); /* so that the sanitizer sees a byte too far */
        if (exact == NULL) {
            return 2;
        }
        memcpy(exact, input, input_length);
        LLVMFuzzerTestOneInput(exact, input_length);
        free(exact);
    }
    printf("%lu inputs, no finding\n", runs);
    return 0;
}
