#include "config.h"

#include <string.h>

enum { KEYS = 11, VALUE_LONGEST = 6 /* digits of 921600 */, BASE = 10 };

enum { KEY_IMU_RATE, KEY_ACCEL_RANGE, KEY_GYRO_RANGE, KEY_LOWPASS, KEY_MAGNETOMETER, KEY_GPS_RATE, KEY_GPS_BAUD,
       KEY_AUTOSTART, KEY_SELF_TEST, KEY_STREAM, KEY_STREAM_BAUD };

static const char *const keys[KEYS] = {
    "imu_rate", "accel_range", "gyro_range", "lowpass", "magnetometer", "gps_rate", "gps_baud",
    "autostart", "self_test", "stream", "stream_baud",
};

static const uint32_t accel_ranges[] = {2, 4, 8, 16, 0};
static const uint32_t gyro_ranges[] = {250, 500, 1000, 2000, 0};
static const uint32_t lowpasses[] = {184, 92, 41, 20, 10, 5, 0};
static const uint32_t gps_bauds[] = {9600, 19200, 38400, 57600, 115200, 0};
static const uint32_t stream_bauds[] = {9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600, 0};

enum { FASTEST_IMU = 1000, SLOWEST_IMU = 50, FASTEST_GPS = 10, FASTEST_STREAM = 1000 };

typedef struct {
    const char *start;
    size_t length;
} span_t;

config_t config_defaults(void)
{
    return (config_t){
        .imu_rate = 1000,
        .accel_range = 16,
        .gyro_range = 1000,
        .lowpass = 92,
        .magnetometer = true,
        .gps_rate = 5,
        .gps_baud = 57600,
        .autostart = true,
        .self_test = false,
        .stream = 0,
        .stream_baud = 115200,
    };
}

static bool is_space(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

static span_t trimmed(span_t span)
{
    while (span.length > 0 && is_space(span.start[0])) {
        span.start++;
        span.length--;
    }
    while (span.length > 0 && is_space(span.start[span.length - 1])) {
        span.length--;
    }
    return span;
}

static int lower(char c)
{
    return c >= 'A' && c <= 'Z' ? c - 'A' + 'a' : c;
}

static bool is_same(span_t span, const char *word)
{
    size_t i = 0;
    while (i < span.length && word[i] != '\0' && lower(span.start[i]) == word[i]) {
        i++;
    }
    return i == span.length && word[i] == '\0';
}

static bool is_text(span_t span)
{
    for (size_t i = 0; i < span.length; i++) {
        const char c = span.start[i];
        if (!is_space(c) && (c < ' ' || c > '~')) {
            return false;
        }
    }
    return true;
}

static bool read_number(span_t span, uint32_t *value)
{
    uint32_t number = 0;
    for (size_t i = 0; i < span.length; i++) {
        if (span.start[i] < '0' || span.start[i] > '9') {
            return false;
        }
        number = number * BASE + (uint32_t)(span.start[i] - '0');
    }
    *value = number;
    return span.length > 0 && span.length <= VALUE_LONGEST;
}

static bool read_choice(span_t span, const uint32_t *choices, uint32_t *value)
{
    if (!read_number(span, value)) {
        return false;
    }
    while (*choices != 0 && *choices != *value) {
        choices++;
    }
    return *choices != 0;
}

static bool read_range(span_t span, uint32_t least, uint32_t most, uint32_t *value)
{
    return read_number(span, value) && *value >= least && *value <= most;
}

static bool read_imu_rate(span_t span, uint32_t *value)
{
    return read_range(span, SLOWEST_IMU, FASTEST_IMU, value) && FASTEST_IMU / (FASTEST_IMU / *value) == *value;
}

static bool read_word(span_t span, bool *value)
{
    *value = is_same(span, "yes");
    return *value || is_same(span, "no");
}

/* Of the 16-bit settings: read into 32 bits first, and kept only if allowed. By pointer, because it is not said which
 * argument of a call is evaluated first. */
static bool keep_u16(bool is_allowed, const uint32_t *value, uint16_t *setting)
{
    if (is_allowed) {
        *setting = (uint16_t)*value;
    }
    return is_allowed;
}

static bool set_value(config_t *config, size_t key, span_t span)
{
    uint32_t value = 0;
    switch (key) {
    case KEY_IMU_RATE: return keep_u16(read_imu_rate(span, &value), &value, &config->imu_rate);
    case KEY_ACCEL_RANGE: return keep_u16(read_choice(span, accel_ranges, &value), &value, &config->accel_range);
    case KEY_GYRO_RANGE: return keep_u16(read_choice(span, gyro_ranges, &value), &value, &config->gyro_range);
    case KEY_LOWPASS: return keep_u16(read_choice(span, lowpasses, &value), &value, &config->lowpass);
    case KEY_MAGNETOMETER: return read_word(span, &config->magnetometer);
    case KEY_GPS_RATE: return keep_u16(read_range(span, 1, FASTEST_GPS, &value), &value, &config->gps_rate);
    case KEY_GPS_BAUD: return read_choice(span, gps_bauds, &config->gps_baud);
    case KEY_AUTOSTART: return read_word(span, &config->autostart);
    case KEY_SELF_TEST: return read_word(span, &config->self_test);
    case KEY_STREAM: return keep_u16(read_range(span, 0, FASTEST_STREAM, &value), &value, &config->stream);
    default: return read_choice(span, stream_bauds, &config->stream_baud);
    }
}

static config_flaw_t read_line(config_t *config, span_t line, uint32_t *seen)
{
    if (!is_text(line)) {
        return CONFIG_BAD_TEXT;
    }
    const char *comment = memchr(line.start, '#', line.length);
    line = trimmed((span_t){line.start, comment == NULL ? line.length : (size_t)(comment - line.start)});
    if (line.length == 0) {
        return CONFIG_FINE;
    }
    const char *equals = memchr(line.start, '=', line.length);
    if (equals == NULL) {
        return CONFIG_NO_EQUALS;
    }
    const size_t before = (size_t)(equals - line.start);
    const span_t name = trimmed((span_t){line.start, before});
    size_t key = 0;
    while (key < KEYS && !is_same(name, keys[key])) {
        key++;
    }
    if (key == KEYS) {
        return CONFIG_UNKNOWN_KEY;
    }
    if ((*seen & UINT32_C(1) << key) != 0) {
        return CONFIG_REPEATED_KEY;
    }
    *seen |= UINT32_C(1) << key;
    const span_t value = trimmed((span_t){equals + 1, line.length - before - 1});
    return set_value(config, key, value) ? CONFIG_FINE : CONFIG_BAD_VALUE;
}

static config_result_t reject(config_t *config, config_flaw_t flaw, uint16_t line)
{
    *config = config_defaults();
    return (config_result_t){flaw, line};
}

config_result_t config_parse(config_t *config, const char *text, size_t length)
{
    *config = config_defaults();
    if (length > CONFIG_FILE_LONGEST) {
        return reject(config, CONFIG_TOO_LONG, 1);
    }
    uint32_t seen = 0;
    uint16_t number = 1;
    for (size_t at = 0; at < length; number++) {
        const char *end = memchr(text + at, '\n', length - at);
        const size_t line = end == NULL ? length - at : (size_t)(end - text) - at;
        const config_flaw_t flaw = read_line(config, (span_t){text + at, line}, &seen);
        if (flaw != CONFIG_FINE) {
            return reject(config, flaw, number);
        }
        at += line + 1;
    }
    return (config_result_t){CONFIG_FINE, 0};
}

static size_t print_text(char *out, const char *text)
{
    const size_t length = strlen(text);
    memcpy(out, text, length);
    return length;
}

static size_t print_number(char *out, uint32_t value)
{
    char digits[BASE];
    size_t count = 0;
    do {
        digits[count++] = (char)('0' + value % BASE);
        value /= BASE;
    } while (value > 0);
    for (size_t i = 0; i < count; i++) {
        out[i] = digits[count - 1 - i];
    }
    return count;
}

static size_t print_value(char *out, const config_t *config, size_t key)
{
    switch (key) {
    case KEY_IMU_RATE: return print_number(out, config->imu_rate);
    case KEY_ACCEL_RANGE: return print_number(out, config->accel_range);
    case KEY_GYRO_RANGE: return print_number(out, config->gyro_range);
    case KEY_LOWPASS: return print_number(out, config->lowpass);
    case KEY_MAGNETOMETER: return print_text(out, config->magnetometer ? "yes" : "no");
    case KEY_GPS_RATE: return print_number(out, config->gps_rate);
    case KEY_GPS_BAUD: return print_number(out, config->gps_baud);
    case KEY_AUTOSTART: return print_text(out, config->autostart ? "yes" : "no");
    case KEY_SELF_TEST: return print_text(out, config->self_test ? "yes" : "no");
    case KEY_STREAM: return print_number(out, config->stream);
    default: return print_number(out, config->stream_baud);
    }
}

size_t config_print(const config_t *config, char *text)
{
    size_t at = 0;
    for (size_t key = 0; key < KEYS; key++) {
        at += print_text(text + at, keys[key]);
        text[at++] = '=';
        at += print_value(text + at, config, key);
        text[at++] = '\n';
    }
    return at;
}
