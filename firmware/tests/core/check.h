/* A test is a function; a suite is a list of them; a failed check says where and lets the rest run. */
#ifndef CHECK_H
#define CHECK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    const char *says; /* what the behaviour is */
    void (*run)(void);
} test_t;

typedef struct {
    const char *name;
    const test_t *tests; /* up to one without `says` */
} suite_t;

void check_that(bool holds, const char *text, const char *file, int line);
void check_equal(int64_t have, int64_t want, const char *text, const char *file, int line);
void check_same(const void *have, const void *want, size_t length, const char *text, const char *file, int line);

#define CHECK(condition) check_that((condition), #condition, __FILE__, __LINE__)
#define CHECK_EQUAL(have, want) check_equal((int64_t)(have), (int64_t)(want), #have " == " #want, __FILE__, __LINE__)
#define CHECK_SAME(have, want, length) check_same((have), (want), (length), #have " == " #want, __FILE__, __LINE__)

/* Reproducible pseudo-random numbers (xorshift, Marsaglia 2003). */
uint32_t random_next(uint32_t *state);
uint32_t random_below(uint32_t *state, uint32_t limit);

extern const suite_t crc32_suite, records_suite, block_suite, ring_suite, log_writer_suite, frame_suite, config_suite,
    nmea_suite, ubx_suite, button_suite, led_suite, logger_suite, recovery_suite;

#endif
