/* Records of FORMAT.md sections 3 to 6: types, limits, and encoding of one record into bytes.
 *
 * Each record_put_* writes one record whose base time is `base_us`, returns its length in bytes, and needs
 * RECORD_LONGEST bytes of room at most. Decoding is in block.h. */
#ifndef CORE_RECORDS_H
#define CORE_RECORDS_H

#include <stddef.h>
#include <stdint.h>

enum {
    RECORD_IMU = 0x01,
    RECORD_MAG = 0x02,
    RECORD_TEMPERATURE = 0x03,
    RECORD_GPS = 0x81,
    RECORD_GAP = 0x83,
    RECORD_SETUP = 0x84,
    RECORD_CONFIG = 0x85,
    RECORD_EVENT = 0x86,
    RECORD_SELF_TEST = 0x87,
    RECORD_STOP = 0x88
};

enum {
    RECORD_FIRST_LONG = 0x80,   /* types from here on are long */
    RECORD_SHORT_HEAD = 3,      /* type, u16 time */
    RECORD_LONG_HEAD = 6,       /* type, length, i32 time */
    RECORD_IMU_BYTES = 15,
    RECORD_MAG_BYTES = 10,
    RECORD_TEMPERATURE_BYTES = 5,
    RECORD_GAP_BYTES = 24,
    RECORD_SETUP_BYTES = 70,
    RECORD_EVENT_BYTES = 12,
    RECORD_SELF_TEST_BYTES = 25,
    RECORD_STOP_BYTES = 23,
    RECORD_GPS_LONGEST = 128,   /* bytes of a sentence */
    RECORD_CONFIG_PIECE = 128,  /* bytes of text in one CONFIG record */
    RECORD_LONGEST = RECORD_LONG_HEAD + 4 + RECORD_CONFIG_PIECE
};

enum { MAG_OVERFLOW = 0x01, MAG_MISSED = 0x02 };                                          /* record_mag_t.flags */
enum { GAP_NO_ROOM = 1, GAP_SENSOR = 2, GAP_SERIAL = 3 };                                 /* record_gap_t.reason */
enum { STOP_BUTTON = 1, STOP_CARD_FULL = 2, STOP_SUPPLY_LOW = 3, STOP_CALIBRATED = 4, STOP_FAULT = 5 };
enum { PURPOSE_DRIVE = 0, PURPOSE_MAG_CALIBRATION = 1 };                                  /* record_setup_t.purpose */
enum {                                                                                    /* record_setup_t.flags */
    SETUP_IMU_INTERRUPT = 0x01,
    SETUP_GPS_ACKNOWLEDGED = 0x04,
    SETUP_CONFIG_READ = 0x08,
    SETUP_CONFIG_REJECTED = 0x10
};
enum {                                                                                    /* record_event_t.code */
    EVENT_CARD_LOST = 1,
    EVENT_CARD_BACK = 2,
    EVENT_CARD_RETRY = 3,
    EVENT_IMU_LOST = 4,
    EVENT_IMU_BACK = 5,
    EVENT_GPS_SILENT = 6,
    EVENT_GPS_CONFIGURED = 7,
    EVENT_GPS_NOT_CONFIGURED = 8,
    EVENT_CONFIG_REJECTED = 9,
    EVENT_MAG_ABSENT = 10,
    EVENT_SUPPLY_LOW = 11,
    EVENT_WATCHDOG = 12,
    EVENT_BUTTON = 13,
    EVENT_RECOVERED = 14,
    EVENT_FAULT_PC = 15,
    EVENT_FAULT_LR = 16,
    EVENT_FAULT_STATUS = 17
};

typedef struct {
    int16_t accel[3]; /* counts, axes of the chip */
    int16_t gyro[3];
} record_imu_t;

typedef struct {
    int16_t field[3]; /* counts, axes of the magnetometer, not adjusted */
    uint8_t flags;    /* MAG_* */
} record_mag_t;

typedef struct {
    uint8_t source; /* RECORD_* of what was lost, 0 for any other */
    uint8_t reason; /* GAP_* */
    uint32_t count;
    uint64_t first_us;
    uint64_t last_us;
} record_gap_t;

typedef struct {
    uint8_t purpose; /* PURPOSE_* */
    uint8_t flags;   /* SETUP_* */
    uint8_t imu_who_am_i;
    uint8_t mag_who_am_i;
    uint8_t mag_adjustment[3];
    uint8_t reset_cause;
    uint32_t imu_period_us;
    uint16_t accel_range_g;
    uint16_t gyro_range_dps;
    uint16_t accel_lowpass_hz;
    uint16_t gyro_lowpass_hz;
    uint16_t accel_delay_us;
    uint16_t gyro_delay_us;
    uint32_t mag_period_us;
    uint32_t gps_period_us;
    uint32_t gps_baud;
    uint32_t boot_number;
    uint32_t config_crc;
    uint8_t firmware[8];
    uint8_t device[12];
} record_setup_t;

typedef struct {
    int16_t response[6]; /* counts: accel x y z, gyro x y z */
    uint8_t factory_code[6];
    uint8_t passed; /* bit i: axis i */
} record_self_test_t;

typedef struct {
    uint8_t reason; /* STOP_* */
    uint32_t imu_records;
    uint32_t imu_lost;
    uint32_t gps_records;
    uint16_t most_blocks;
    uint16_t card_retries;
} record_stop_t;

size_t record_put_imu(uint8_t *out, uint16_t since_base_us, const record_imu_t *imu);
size_t record_put_mag(uint8_t *out, uint16_t since_base_us, const record_mag_t *mag);
size_t record_put_temperature(uint8_t *out, uint16_t since_base_us, int16_t counts);
size_t record_put_gps(uint8_t *out, int32_t since_base_us, const uint8_t *sentence, size_t length);
size_t record_put_gap(uint8_t *out, int32_t since_base_us, const record_gap_t *gap);
size_t record_put_setup(uint8_t *out, int32_t since_base_us, const record_setup_t *setup);
size_t record_put_config(uint8_t *out, int32_t since_base_us, uint16_t offset, uint16_t total, const char *piece,
                         size_t length);
size_t record_put_event(uint8_t *out, int32_t since_base_us, uint16_t code, uint32_t value);
size_t record_put_self_test(uint8_t *out, int32_t since_base_us, const record_self_test_t *test);
size_t record_put_stop(uint8_t *out, int32_t since_base_us, const record_stop_t *stop);

/* Bytes of the whole record at `record`, of which `length` are there: CORE_INVALID if it is unknown or cut off. */
int record_length(const uint8_t *record, size_t length);

#endif
