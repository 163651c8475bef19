#include "nmea.h"

#include <string.h>

enum { TIME_FIELD = 1, DATE_FIELD = 9, DATE_DIGITS = 6, FAT_YEAR = 1980 };
enum { STATUS_FIELD = 2, QUALITY_FIELD = 6, TYPE_AT = 3, TYPE_LENGTH = 3, SHORTEST = 10, SUM_LENGTH = 3 };

void nmea_init(nmea_framer_t *framer)
{
    memset(framer, 0, sizeof *framer);
}

void nmea_break(nmea_framer_t *framer)
{
    if (framer->length > 0 && !framer->is_whole) {
        framer->dropped++;
    }
    framer->length = 0;
    framer->is_whole = false;
}

static size_t begin(nmea_framer_t *framer, uint8_t byte, uint64_t time_us)
{
    nmea_break(framer);
    framer->sentence[0] = byte;
    framer->length = 1;
    framer->time_us = time_us;
    return 0;
}

size_t nmea_push(nmea_framer_t *framer, uint8_t byte, uint64_t time_us)
{
    if (byte == '$') {
        return begin(framer, byte, time_us);
    }
    if (framer->length == 0 || framer->is_whole) {
        framer->noise++;
        return 0;
    }
    const bool is_text = (byte >= ' ' && byte <= '~') || byte == '\r' || byte == '\n';
    if (!is_text || framer->length == RECORD_GPS_LONGEST) {
        framer->noise++;
        nmea_break(framer);
        return 0;
    }
    framer->sentence[framer->length++] = byte;
    framer->is_whole = byte == '\n';
    return framer->is_whole ? framer->length : 0;
}

static size_t without_line_end(const uint8_t *sentence, size_t length)
{
    while (length > 0 && (sentence[length - 1] == '\n' || sentence[length - 1] == '\r')) {
        length--;
    }
    return length;
}

static int hex_digit(uint8_t c)
{
    if (c >= '0' && c <= '9') {
        return c - '0';
    }
    if (c >= 'A' && c <= 'F') {
        return c - 'A' + 10;
    }
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

bool nmea_is_intact(const uint8_t *sentence, size_t length)
{
    length = without_line_end(sentence, length);
    if (length < SHORTEST || sentence[0] != '$' || sentence[length - SUM_LENGTH] != '*') {
        return false;
    }
    int sum = 0;
    for (size_t i = 1; i < length - SUM_LENGTH; i++) {
        sum ^= sentence[i];
    }
    const int high = hex_digit(sentence[length - 2]);
    const int low = hex_digit(sentence[length - 1]);
    return high >= 0 && low >= 0 && sum == high * 16 + low;
}

/* Where a comma-separated field begins; `length` for one that is not there. */
static size_t field_at(const uint8_t *sentence, size_t length, size_t number)
{
    size_t at = 0;
    for (; number > 0 && at < length; at++) {
        number -= sentence[at] == ',' ? 1 : 0;
    }
    return number > 0 ? length : at;
}

/* First byte of a field, '\0' for one that is empty or not there. */
static uint8_t field(const uint8_t *sentence, size_t length, size_t number)
{
    const size_t at = field_at(sentence, length, number);
    return at >= length || sentence[at] == ',' || sentence[at] == '*' ? '\0' : sentence[at];
}

/* Three numbers of two digits; whether they are there. */
static bool pairs(const uint8_t *sentence, size_t length, size_t number, uint32_t values[3])
{
    const size_t at = field_at(sentence, length, number);
    if (at + DATE_DIGITS > length) {
        return false;
    }
    for (size_t i = 0; i < DATE_DIGITS; i++) {
        const uint8_t c = sentence[at + i];
        if (c < '0' || c > '9') {
            return false;
        }
        values[i / 2] = (i % 2 ? 10 * values[i / 2] : 0) + (uint32_t)(c - '0');
    }
    return true;
}

uint32_t nmea_fat_time(const uint8_t *sentence, size_t length)
{
    uint32_t clock[3] = {0};
    uint32_t date[3] = {0}; /* day, month, year */
    const bool is_fix = nmea_fix(sentence, length) == NMEA_FIX && memcmp(sentence + TYPE_AT, "RMC", TYPE_LENGTH) == 0;
    if (!is_fix || !pairs(sentence, length, TIME_FIELD, clock) || !pairs(sentence, length, DATE_FIELD, date)) {
        return 0;
    }
    return (2000 + date[2] - FAT_YEAR) << 25 | date[1] << 21 | date[0] << 16 | clock[0] << 11 | clock[1] << 5 | clock[2] / 2;
}

nmea_fix_t nmea_fix(const uint8_t *sentence, size_t length)
{
    if (!nmea_is_intact(sentence, length)) {
        return NMEA_SAYS_NOTHING;
    }
    if (memcmp(sentence + TYPE_AT, "RMC", TYPE_LENGTH) == 0) {
        return field(sentence, length, STATUS_FIELD) == 'A' ? NMEA_FIX : NMEA_NO_FIX;
    }
    if (memcmp(sentence + TYPE_AT, "GGA", TYPE_LENGTH) == 0) {
        const uint8_t quality = field(sentence, length, QUALITY_FIELD);
        return quality > '0' && quality <= '9' ? NMEA_FIX : NMEA_NO_FIX;
    }
    return NMEA_SAYS_NOTHING;
}
