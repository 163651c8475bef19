#include <string.h>

#include "check.h"
#include "config.h"

static config_result_t parse(config_t *config, const char *text)
{
    return config_parse(config, text, strlen(text));
}

static bool are_same(config_t a, config_t b)
{
    char text_a[CONFIG_TEXT_LONGEST];
    char text_b[CONFIG_TEXT_LONGEST];
    const size_t length = config_print(&a, text_a);
    return length == config_print(&b, text_b) && memcmp(text_a, text_b, length) == 0;
}

static void empty(void)
{
    config_t config;
    const char *const texts[] = {"", "\n", "# only a comment", "  \t\r\n\r\n#\n"};
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        CHECK_EQUAL(parse(&config, texts[i]).flaw, CONFIG_FINE);
        CHECK(are_same(config, config_defaults()));
    }
}

static void all_keys(void)
{
    config_t config;
    const config_result_t result =
        parse(&config, "imu_rate = 200\r\nACCEL_RANGE=8\n gyro_range=2000 # deg/s\nlowpass=41\nmagnetometer=No\n"
                       "gps_rate=1\ngps_baud=9600\nautostart=no\nself_test=YES\nstream=50\nstream_baud=460800");
    CHECK(result.flaw == CONFIG_FINE && result.line == 0);
    CHECK(config.imu_rate == 200 && config.accel_range == 8 && config.gyro_range == 2000 && config.lowpass == 41);
    CHECK(!config.magnetometer && config.gps_rate == 1 && config.gps_baud == 9600 && !config.autostart);
    CHECK(config.self_test && config.stream == 50 && config.stream_baud == 460800);
}

static void echo(void)
{
    config_t config = config_defaults();
    config_t again;
    char text[CONFIG_TEXT_LONGEST];
    config.imu_rate = 50;
    config.stream = 1000;
    config.stream_baud = 921600;
    config.gps_baud = 115200;
    config.gyro_range = 2000;
    const size_t length = config_print(&config, text);
    CHECK(length <= sizeof text);
    CHECK_EQUAL(config_parse(&again, text, length).flaw, CONFIG_FINE);
    CHECK(are_same(config, again));
}

typedef struct {
    const char *text;
    config_flaw_t flaw;
    uint16_t line;
} flawed_t;

static void flaws(void)
{
    const flawed_t cases[] = {
        {"imu_rate 200", CONFIG_NO_EQUALS, 1},
        {"\nimu_rte=200", CONFIG_UNKNOWN_KEY, 2},
        {"=5", CONFIG_UNKNOWN_KEY, 1},
        {"imu_rate=200\nimu_rate=200", CONFIG_REPEATED_KEY, 2},
        {"imu_rate=", CONFIG_BAD_VALUE, 1},
        {"imu_rate=-5", CONFIG_BAD_VALUE, 1},
        {"imu_rate=300", CONFIG_BAD_VALUE, 1}, /* 333 is 1000 / 3, 300 is nothing */
        {"imu_rate=0", CONFIG_BAD_VALUE, 1},
        {"imu_rate=2000", CONFIG_BAD_VALUE, 1},
        {"imu_rate=4294967496", CONFIG_BAD_VALUE, 1}, /* 2^32 + 200 */
        {"accel_range=0", CONFIG_BAD_VALUE, 1},
        {"accel_range=16g", CONFIG_BAD_VALUE, 1},
        {"autostart=maybe", CONFIG_BAD_VALUE, 1},
        {"autostart=yess", CONFIG_BAD_VALUE, 1},
        {"gps_rate=11", CONFIG_BAD_VALUE, 1},
        {"stream=1 0", CONFIG_BAD_VALUE, 1},
        {"# caf\xC3\xA9", CONFIG_BAD_TEXT, 1},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        config_t config;
        const config_result_t result = parse(&config, cases[i].text);
        CHECK_EQUAL(result.flaw, cases[i].flaw);
        CHECK_EQUAL(result.line, cases[i].line);
        CHECK(are_same(config, config_defaults()));
    }
}

static void long_file(void)
{
    static char text[CONFIG_FILE_LONGEST + 1];
    config_t config;
    memset(text, '\n', sizeof text);
    CHECK_EQUAL(config_parse(&config, text, sizeof text - 1).flaw, CONFIG_FINE);
    CHECK_EQUAL(config_parse(&config, text, sizeof text).flaw, CONFIG_TOO_LONG);
}

static void rates(void)
{
    uint32_t allowed = 0;
    for (uint32_t rate = 0; rate <= 1100; rate++) {
        char text[] = "imu_rate=0000";
        for (size_t i = 0, rest = rate; i < 4; i++, rest /= 10) {
            text[sizeof text - 2 - i] = (char)('0' + rest % 10);
        }
        config_t config;
        allowed += parse(&config, text).flaw == CONFIG_FINE ? 1 : 0;
    }
    CHECK_EQUAL(allowed, 20); /* 1000 / n for n = 1 to 20 */
}

const suite_t config_suite = {"config",
                              (const test_t[]){{"an empty file means the defaults", empty},
                                               {"every key is read, in any case of letters", all_keys},
                                               {"what is echoed reads back the same", echo},
                                               {"any flaw rejects the file, with its line", flaws},
                                               {"a file of no end is refused", long_file},
                                               {"exactly the rates the sensor has are allowed", rates},
                                               {0}}};
