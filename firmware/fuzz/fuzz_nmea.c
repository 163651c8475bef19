/* Whatever comes over the line: sentences are framed, and neither parser is ever stuck. */
#include <string.h>

#include "fuzz.h"
#include "nmea.h"
#include "ubx.h"

static const char good[] = "$GPTXT,fuzz*70\r\n";

static void check_sentence(const nmea_framer_t *framer, size_t length)
{
    const uint8_t *sentence = framer->sentence;
    fuzz_require(length <= RECORD_GPS_LONGEST && sentence[0] == '$' && sentence[length - 1] == '\n');
    fuzz_require(memchr(sentence + 1, '$', length - 1) == NULL);
    if (nmea_fix(sentence, length) != NMEA_SAYS_NOTHING) {
        fuzz_require(nmea_is_intact(sentence, length));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    nmea_framer_t framer;
    ubx_parser_t parser;
    nmea_init(&framer);
    ubx_init(&parser);
    for (size_t i = 0; i < size; i++) {
        const size_t length = nmea_push(&framer, data[i], i);
        if (length > 0) {
            check_sentence(&framer, length);
        }
        if (ubx_push(&parser, data[i])) {
            fuzz_require(parser.length <= 1024);
            (void)ubx_answer(&parser, UBX_CLASS_CFG, UBX_CFG_RATE);
        }
    }
    (void)nmea_is_intact(data, size);
    (void)nmea_fix(data, size);
    size_t whole = 0;
    for (size_t i = 0; i < sizeof good - 1; i++) {
        whole = nmea_push(&framer, (uint8_t)good[i], size + i);
    }
    fuzz_require(whole == sizeof good - 1 && framer.time_us == size);
    return 0;
}

const char *const fuzz_seeds[] = {
    "$GPRMC,104500.00,A,5000.12345,N,00800.12345,E,031.123,200.12,160526,,,A*50\r\n"
    "$GPGGA,104500.00,5000.12345,N,00800.12345,E,1,08,0.90,120.0,M,0.0,M,,*5A\r\n",
    "\xB5\x62\x05\x01\x02\x01\x06\x08\x17\x44",
    NULL,
};
