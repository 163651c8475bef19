#include "check.h"
#include "crc32.h"

static void check_value(void)
{
    CHECK_EQUAL(crc32_update(0, (const uint8_t *)"123456789", 9), 0xCBF43926); /* the catalogue's check value */
}

static void nothing(void)
{
    CHECK_EQUAL(crc32_update(0, NULL, 0), 0);
}

static void in_pieces(void)
{
    const uint8_t *text = (const uint8_t *)"123456789";
    for (size_t cut = 0; cut <= 9; cut++) {
        CHECK_EQUAL(crc32_update(crc32_update(0, text, cut), text + cut, 9 - cut), 0xCBF43926);
    }
}

const suite_t crc32_suite = {"crc32",
                             (const test_t[]){{"the check value of the catalogue comes out", check_value},
                                              {"nothing has CRC 0", nothing},
                                              {"the CRC of two pieces is that of the whole", in_pieces},
                                              {0}}};
