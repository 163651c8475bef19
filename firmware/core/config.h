/* CONFIG.TXT: `key=value` lines; `#` starts a comment; spaces around key and value do not count; keys and values in any
 * case of letters; CR LF or LF. Strict: the first line that is wrong rejects the whole file, with its number. */
#ifndef CORE_CONFIG_H
#define CORE_CONFIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CONFIG_TEXT_LONGEST = 256, CONFIG_FILE_LONGEST = 4096 };

/* In the order in which they are echoed. */
typedef struct {
    uint16_t imu_rate;        /* imu_rate=1000      Hz: 1000 / n, n = 1 to 20 (rounded down where not whole) */
    uint16_t accel_range;     /* accel_range=16     g: 2, 4, 8, 16 */
    uint16_t gyro_range;      /* gyro_range=1000    deg/s: 250, 500, 1000, 2000 */
    uint16_t lowpass;         /* lowpass=92         Hz, of the gyro: 184, 92, 41, 20, 10, 5; accel the next to it */
    bool magnetometer;        /* magnetometer=yes   yes or no */
    uint16_t gps_rate;        /* gps_rate=5         Hz: 1 to 10; a receiver that refuses it: 5 */
    uint32_t gps_baud;        /* gps_baud=57600     9600, 19200, 38400, 57600, 115200 */
    bool autostart;           /* autostart=yes      record as soon as card and sensor are ready */
    bool self_test;           /* self_test=no       at the start of a recording */
    uint16_t stream;          /* stream=0           samples a second over USART1, 0 to 1000; 0 off */
    uint32_t stream_baud;     /* stream_baud=115200 9600 to 921600, as gps_baud and 230400, 460800, 921600 */
} config_t;

typedef enum {
    CONFIG_FINE = 0,
    CONFIG_NO_EQUALS,     /* a line that is no key=value */
    CONFIG_UNKNOWN_KEY,
    CONFIG_REPEATED_KEY,
    CONFIG_BAD_VALUE,     /* no number, or not one of those allowed */
    CONFIG_BAD_TEXT,      /* bytes that are no text */
    CONFIG_TOO_LONG       /* more than CONFIG_FILE_LONGEST bytes */
} config_flaw_t;

typedef struct {
    config_flaw_t flaw;
    uint16_t line; /* from 1; 0 when there is no flaw */
} config_result_t;

config_t config_defaults(void);

/* Read a whole file. On a flaw `config` holds the defaults, all of them. */
config_result_t config_parse(config_t *config, const char *text, size_t length);

/* Write the settings in force, every key, into CONFIG_TEXT_LONGEST bytes; returns the length. Not terminated. */
size_t config_print(const config_t *config, char *text);

#endif
