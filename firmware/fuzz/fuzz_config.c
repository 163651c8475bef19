/* Whatever CONFIG.TXT holds: settings are defaults or allowed ones, and their echo reads back the same. */
#include <stdlib.h>
#include <string.h>

#include "config.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    config_t config;
    config_t again;
    char text[CONFIG_TEXT_LONGEST];
    char text_again[CONFIG_TEXT_LONGEST];
    const config_result_t result = config_parse(&config, (const char *)data, size);
    fuzz_require((result.flaw == CONFIG_FINE) == (result.line == 0));
    const size_t length = config_print(&config, text);
    fuzz_require(config_parse(&again, text, length).flaw == CONFIG_FINE);
    fuzz_require(config_print(&again, text_again) == length && memcmp(text, text_again, length) == 0);
    fuzz_require(config.imu_rate >= 50 && config.imu_rate <= 1000 && config.gps_rate >= 1 && config.stream <= 1000);
    return 0;
}

const char *const fuzz_seeds[] = {
    "imu_rate=200\naccel_range=8\ngyro_range=2000\nlowpass=41\nmagnetometer=no\ngps_rate=1\n",
    "# comment\r\ngps_baud = 9600\r\nautostart=no\r\nself_test=yes\r\nstream=50\r\nstream_baud=460800\r\n",
    "imu_rte=3\n",
    NULL,
};
