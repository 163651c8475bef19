/* Checks for the programs here: the first that fails says where and ends the program. */
#ifndef TESTS_CHECK_H
#define TESTS_CHECK_H

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#define CHECK(condition)                                                            \
    do {                                                                            \
        if (!(condition)) {                                                         \
            fprintf(stderr, "%s:%d: not so: %s\n", __FILE__, __LINE__, #condition); \
            exit(1);                                                                \
        }                                                                           \
    } while (0)

#define CHECK_EQUAL(left, right)                                                                          \
    do {                                                                                                  \
        const long long left_value = (long long)(left), right_value = (long long)(right);                 \
        if (left_value != right_value) {                                                                  \
            fprintf(stderr, "%s:%d: %s is %lld, not %lld (%s)\n", __FILE__, __LINE__, #left, left_value,  \
                    right_value, #right);                                                                 \
            exit(1);                                                                                      \
        }                                                                                                 \
    } while (0)

/* A program is a row of named tests; with an argument it runs the one of that name, without it lists them. */
typedef struct {
    const char *name;
    void (*run)(void);
} test_t;

int run_tests(const test_t *tests, size_t count, int argc, char **argv);

#endif
