/* An MPU9250 with its AK8963, register by register: an independent reading of their manuals. Its motion is a function of
 * time, so that what is logged can be compared with what was measured. */
#ifndef TESTS_MPU_MODEL_H
#define TESTS_MPU_MODEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What is measured, and when, if not the model's own motion: the first time after `after_us`, and the values of then. */
typedef struct {
    void *context;
    uint64_t (*next_sample_us)(void *context, uint64_t after_us);
    void (*motion)(void *context, uint64_t time_us, int16_t values[6]);
    uint64_t (*next_mag_us)(void *context, uint64_t after_us);
    void (*field)(void *context, uint64_t time_us, int16_t values[3]);
} mpu_feed_t;

typedef struct {
    const uint64_t *now_us;
    const mpu_feed_t *feed; /* NULL: the model's own */
    uint8_t who_am_i;       /* 0x71 */
    bool is_absent;         /* nobody drives MISO */
    bool is_mag_absent;
    bool is_master_stuck;   /* a transfer never ends, until the master is reset */
    bool is_frozen;         /* answers, but measures the same for ever */
    uint8_t stuck_register; /* does not keep what is written (0: none) */
    uint64_t mag_overflow_from_us;

    uint8_t registers[128];
    uint8_t mag[32];
    uint8_t adjustment[3];
    bool is_sleeping;
    uint64_t reset_us;      /* registers answer 0 until 100 ms later */
    uint64_t next_sample_us;
    uint64_t next_mag_us;
    uint32_t sample_number; /* of the newest */
    uint32_t mag_number;
    uint32_t overruns;      /* samples never read */
    uint32_t fast_accesses; /* refused: registers but measurements above 1 MHz, those above 20 MHz */
    uint32_t slave_errors;  /* slave 4 set up while its transfer was on its way */
    bool is_slave_4_due;    /* its transfer comes with the next sample */
    uint32_t clock_hz;      /* of the bus, set by the board */
} mpu_model_t;

void mpu_model_init(mpu_model_t *chip, const uint64_t *now_us);

uint32_t mpu_model_period_us(const mpu_model_t *chip);

/* Let measurements happen up to now. */
void mpu_model_step(mpu_model_t *chip);

/* One chip-selected transfer. */
void mpu_model_transfer(mpu_model_t *chip, const uint8_t *out, uint8_t *in, size_t length);

/* Whether the interrupt pin would have pulsed since the last sample was read. */
bool mpu_model_has_sample(const mpu_model_t *chip);

/* What sample `number` measures: accel x y z, gyro x y z; and reading `number` of the magnetometer. */
void mpu_model_motion(uint32_t number, int16_t values[6]);
void mpu_model_field(uint32_t number, int16_t values[3]);

#endif
