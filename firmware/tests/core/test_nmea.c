#include <string.h>

#include "check.h"
#include "nmea.h"

static const char good[] = "$GPRMC,104500.00,A,5000.12345,N,00800.12345,E,031.123,200.12,160526,,,A*66\r\n";

static size_t push_all(nmea_framer_t *framer, const char *text, size_t length, uint32_t *whole)
{
    size_t last = 0;
    *whole = 0;
    for (size_t i = 0; i < length; i++) {
        const size_t result = nmea_push(framer, (uint8_t)text[i], 1000 + i);
        last = result > 0 ? result : last;
        *whole += result > 0 ? 1 : 0;
    }
    return last;
}

static void sentence_between_noise(void)
{
    nmea_framer_t framer;
    uint32_t whole;
    nmea_init(&framer);
    push_all(&framer, "\xB5\x62\x01\r\n", 5, &whole);
    CHECK_EQUAL(whole, 0);
    CHECK_EQUAL(push_all(&framer, good, strlen(good), &whole), strlen(good));
    CHECK(whole == 1 && framer.time_us == 1000 && framer.noise == 5 && framer.dropped == 0);
    CHECK_SAME(framer.sentence, good, strlen(good));
}

static void cut_sentence(void)
{
    nmea_framer_t framer;
    uint32_t whole;
    nmea_init(&framer);
    push_all(&framer, "$GPRMC,1045$GPGGA,1\r\n", 21, &whole);
    CHECK(whole == 1 && framer.dropped == 1 && framer.time_us == 1000 + 11);
    CHECK_SAME(framer.sentence, "$GPGGA,1\r\n", 10);
}

static void garbled_sentence(void)
{
    nmea_framer_t framer;
    uint32_t whole;
    nmea_init(&framer);
    push_all(&framer, "$GPR\x80MC,1\r\n", 11, &whole);
    CHECK(whole == 0 && framer.dropped == 1);
}

static void longest_sentence(void)
{
    nmea_framer_t framer;
    uint32_t whole;
    char text[RECORD_GPS_LONGEST + 1];
    memset(text, 'a', sizeof text);
    text[0] = '$';
    text[RECORD_GPS_LONGEST - 1] = '\n';
    nmea_init(&framer);
    CHECK_EQUAL(push_all(&framer, text, RECORD_GPS_LONGEST, &whole), RECORD_GPS_LONGEST);
    text[RECORD_GPS_LONGEST - 1] = 'a';
    text[RECORD_GPS_LONGEST] = '\n';
    push_all(&framer, text, sizeof text, &whole);
    CHECK(whole == 0 && framer.dropped == 1);
}

static void lost_bytes(void)
{
    nmea_framer_t framer;
    uint32_t whole;
    nmea_init(&framer);
    push_all(&framer, "$GPRMC", 6, &whole);
    nmea_break(&framer);
    push_all(&framer, ",1\r\n", 4, &whole);
    CHECK(whole == 0 && framer.dropped == 1);
    push_all(&framer, good, strlen(good), &whole);
    nmea_break(&framer);
    CHECK(whole == 1 && framer.dropped == 1);
}

static bool is_intact(const char *text)
{
    return nmea_is_intact((const uint8_t *)text, strlen(text));
}

static void checksums(void)
{
    CHECK(is_intact(good));
    CHECK(is_intact("$GPTXT,fuzz*70\r\n"));
    const char *const digits[] = {"$GPTXT,I*2A", "$GPTXT,I*2a", "$GPTXT,M*2E", "$GPTXT,M*2e", "$GPTXT,L*2F", "$GPTXT,L*2f"};
    for (size_t i = 0; i < sizeof digits / sizeof *digits; i++) {
        CHECK(is_intact(digits[i]));
    }
    CHECK(!is_intact("$GPTXT,D*2G") && !is_intact("$GPTXT,D*2g") && !is_intact("$GPTXT,I*2:") && !is_intact("$GPTXT,I*2@"));
    char text[sizeof good];
    for (size_t i = 0; i < strlen(good) - 2; i++) {
        memcpy(text, good, sizeof good);
        text[i] = (char)(text[i] ^ 1);
        CHECK(!is_intact(text));
    }
    for (size_t length = 0; length < strlen(good) - 2; length++) {
        CHECK(!nmea_is_intact((const uint8_t *)good, length));
    }
}

static nmea_fix_t fix(const char *body)
{
    char text[RECORD_GPS_LONGEST];
    const char *const digits = "0123456789ABCDEF";
    uint8_t sum = 0;
    size_t length = strlen(body);
    memcpy(text, body, length);
    for (size_t i = 1; i < length; i++) {
        sum ^= (uint8_t)body[i];
    }
    text[length++] = '*';
    text[length++] = digits[sum >> 4];
    text[length++] = digits[sum & 15];
    text[length++] = '\n';
    return nmea_fix((const uint8_t *)text, length);
}

static void fixes(void)
{
    CHECK_EQUAL(fix("$GPRMC,104500.00,A,5000.1,N"), NMEA_FIX);
    CHECK_EQUAL(fix("$GNRMC,104500.00,V,,"), NMEA_NO_FIX);
    CHECK_EQUAL(fix("$GPGGA,104500.00,5000.1,N,00800.1,E,1,08"), NMEA_FIX);
    CHECK_EQUAL(fix("$GPGGA,104500.00,,,,,0,00"), NMEA_NO_FIX);
    CHECK_EQUAL(fix("$GPGGA,104500.00,,,,,,"), NMEA_NO_FIX);
    CHECK_EQUAL(fix("$GPGST,104500.00,1,1,1"), NMEA_SAYS_NOTHING);
    CHECK_EQUAL(nmea_fix((const uint8_t *)"$GPRMC,,A", 9), NMEA_SAYS_NOTHING);
}

static void dates(void)
{
    const uint8_t *rmc = (const uint8_t *)good;
    const uint32_t time = nmea_fat_time(rmc, strlen(good));
    CHECK_EQUAL(time >> 25, 2026 - 1980);
    CHECK_EQUAL(time >> 21 & 15, 5);
    CHECK_EQUAL(time >> 16 & 31, 16);
    CHECK_EQUAL(time >> 11 & 31, 10);
    CHECK_EQUAL(time >> 5 & 63, 45);
    CHECK_EQUAL(time & 31, 0);
    CHECK_EQUAL(nmea_fat_time(rmc, strlen(good) - 1), time);
    CHECK_EQUAL(nmea_fat_time(rmc, strlen(good) - 4), 0);
    const char *const gga = "$GPGGA,1045*40\r\n";
    CHECK_EQUAL(nmea_fat_time((const uint8_t *)gga, strlen(gga)), 0);
}

const suite_t nmea_suite = {"nmea",
                            (const test_t[]){{"a sentence is found between noise, with the time of its first byte",
                                              sentence_between_noise},
                                             {"a sentence cut by the next is counted", cut_sentence},
                                             {"a garbled sentence is counted", garbled_sentence},
                                             {"the longest sentence fits, a longer one is counted", longest_sentence},
                                             {"lost bytes end a sentence", lost_bytes},
                                             {"one wrong bit or byte less breaks the checksum", checksums},
                                             {"RMC with a fix has the date of files", dates},
                                             {"RMC and GGA tell whether there is a fix", fixes},
                                             {0}}};
