/* core_tests [suite]: run one suite or all; exit code 1 if anything failed. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "check.h"

static unsigned failures;

static const suite_t *const suites[] = {
    &crc32_suite, &records_suite, &block_suite,  &ring_suite, &log_writer_suite, &frame_suite,    &config_suite,
    &nmea_suite,  &ubx_suite,     &button_suite, &led_suite,  &logger_suite,     &recovery_suite,
};

void check_that(bool holds, const char *text, const char *file, int line)
{
    if (!holds) {
        failures++;
        printf("%s:%d: not so: %s\n", file, line, text);
    }
}

void check_equal(int64_t have, int64_t want, const char *text, const char *file, int line)
{
    if (have != want) {
        failures++;
        printf("%s:%d: not so: %s (%" PRId64 ", not %" PRId64 ")\n", file, line, text, have, want);
    }
}

void check_same(const void *have, const void *want, size_t length, const char *text, const char *file, int line)
{
    check_that(memcmp(have, want, length) == 0, text, file, line);
}

uint32_t random_next(uint32_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return *state;
}

uint32_t random_below(uint32_t *state, uint32_t limit)
{
    return random_next(state) % limit;
}

static void run(const suite_t *suite)
{
    for (const test_t *test = suite->tests; test->says != NULL; test++) {
        const unsigned before = failures;
        test->run();
        printf("%s %s: %s\n", failures == before ? "ok  " : "FAIL", suite->name, test->says);
    }
}

int main(int count, char **arguments)
{
    size_t ran = 0;
    for (size_t i = 0; i < sizeof suites / sizeof *suites; i++) {
        if (count < 2 || strcmp(arguments[1], suites[i]->name) == 0) {
            run(suites[i]);
            ran++;
        }
    }
    if (ran == 0) {
        fprintf(stderr, "no suite named %s\n", arguments[1]);
    }
    return failures > 0 || ran == 0 ? 1 : 0;
}
