#include "check.h"

#include <string.h>

int run_tests(const test_t *tests, size_t count, int argc, char **argv)
{
    int found = argc < 2;
    for (size_t i = 0; i < count; i++) {
        if (argc < 2) {
            puts(tests[i].name);
        } else if (strcmp(argv[1], tests[i].name) == 0) {
            found = 1;
            tests[i].run();
        }
    }
    return found ? 0 : 2;
}
