/* MPU9250 (and MPU9255, MPU6500) over SPI with its AK8963 behind the chip's own I2C master.
 *
 * Sources: InvenSense PS-MPU-9250A rev 1.1, RM-MPU-9250A-00 rev 1.6, AN-MPU-9250A-03 (self-test); AKM AK8963 data sheet
 * 2013-10. Set up on a slow clock, every register read back; then one burst of MPU9250_BURST bytes for each sample,
 * clocked by the board in the background at up to 20 MHz, and taken apart here. Counts only, axes of each chip. */
#ifndef DRIVERS_MPU9250_H
#define DRIVERS_MPU9250_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    MPU9250_OK = 0,
    MPU9250_ABSENT = -1,     /* WHO_AM_I reads 00 or FF: nobody there */
    MPU9250_UNFAITHFUL = -2, /* a register does not keep what was written */
    MPU9250_BUS = -3,
    MPU9250_MAG_SILENT = -4  /* the I2C master got no answer in time */
};

enum { MPU9250_WHO_MPU6500 = 0x70 }; /* the same die without magnetometer */

/* The burst: its first byte out is MPU9250_BURST_COMMAND, then INT_STATUS, accel, temperature, gyro, ST1 .. ST2. */
enum { MPU9250_BURST = 24, MPU9250_BURST_COMMAND = 0x80 | 0x3A };

typedef struct {
    void *context;
    /* One chip-selected transfer of a few bytes at no more than 1 MHz; in and out may be the same. 0 or negative. */
    int (*transfer)(void *context, const uint8_t *out, uint8_t *in, size_t length);
    void (*wait_us)(void *context, uint32_t duration_us); /* at least so long; others may be served */
} mpu9250_bus_t;

typedef struct {
    uint16_t rate_hz;        /* 1000 / n */
    uint16_t accel_range_g;  /* 2, 4, 8, 16 */
    uint16_t gyro_range_dps; /* 250, 500, 1000, 2000 */
    uint16_t lowpass_hz;     /* of the gyro: 184, 92, 41, 20, 10, 5 */
    bool has_magnetometer;   /* look for one */
} mpu9250_settings_t;

/* What was found and set. */
typedef struct {
    uint8_t who_am_i;
    uint8_t mag_who_am_i;       /* 0x48, or 0: none */
    uint8_t mag_adjustment[3];  /* ASAX, ASAY, ASAZ */
    uint32_t period_us;
    uint32_t mag_period_us;     /* 0: none */
    uint16_t accel_lowpass_hz, gyro_lowpass_hz;
    uint16_t accel_delay_us, gyro_delay_us;
} mpu9250_info_t;

typedef struct {
    bool has_data;        /* INT_STATUS.RAW_DATA_RDY: a sample not read before */
    bool has_mag;         /* a new reading of the magnetometer came with it */
    bool has_mag_overflow, has_mag_missed;
    int16_t accel[3], gyro[3], temperature, mag[3];
} mpu9250_sample_t;

/* Outcome of the factory's self-test, axes accel x y z, gyro x y z. */
typedef struct {
    int16_t response[6]; /* counts at 2 g and 250 deg/s */
    uint8_t factory_code[6];
    uint8_t passed; /* bit i: axis i */
} mpu9250_self_test_t;

/* Reset and set up; takes about 150 ms. A silent magnetometer is not an error: mag_who_am_i says so. */
int mpu9250_open(const mpu9250_bus_t *bus, const mpu9250_settings_t *settings, mpu9250_info_t *info);

/* Take a burst apart. */
void mpu9250_decode(const uint8_t burst[MPU9250_BURST], mpu9250_sample_t *sample);

/* Run the self-test; the chip has to lie still, and has to be opened again afterwards. Takes about 500 ms. */
int mpu9250_self_test(const mpu9250_bus_t *bus, mpu9250_self_test_t *result);

/* Tells a sensor that answers but has stopped measuring: feed it every sample. */
typedef struct {
    int16_t last[6];
    uint16_t repeats;
} mpu9250_watch_t;
enum { MPU9250_FROZEN = 100 }; /* equal samples in a row: noise makes the eleventh a wonder already */
bool mpu9250_is_frozen(mpu9250_watch_t *watch, const mpu9250_sample_t *sample);

#endif
