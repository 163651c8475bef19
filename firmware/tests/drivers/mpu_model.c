#include "mpu_model.h"

#include <string.h>

enum {
    RESET_US = 100000,
    MAG_PERIOD_US = 10000,
    ST1_READY = 1,
    ST1_OVERRUN = 2,
    OVERFLOW = 8,
    REGISTERS_HZ = 1000000,
    MEASUREMENTS_HZ = 20000000
};

void mpu_model_motion(uint32_t number, int16_t values[6])
{
    uint32_t x = number * 2654435761u;
    for (int i = 0; i < 6; i++) {
        x ^= x >> 15;
        x *= 2246822519u;
        values[i] = (int16_t)((int32_t)(x >> 16) - 32768);
    }
}

/* A box that is turned: the field goes round. */
void mpu_model_field(uint32_t number, int16_t values[3])
{
    const int32_t phase = (int32_t)(number * 5 % 1200);
    const int32_t triangle = phase < 600 ? phase - 300 : 900 - phase;
    values[0] = (int16_t)triangle;
    values[1] = (int16_t)(300 - (triangle < 0 ? -triangle : triangle));
    values[2] = (int16_t)(-120 - triangle / 3);
}

static uint64_t after_sample(const mpu_model_t *chip, uint64_t time_us, uint32_t period_us)
{
    return chip->feed ? chip->feed->next_sample_us(chip->feed->context, time_us) : time_us + period_us;
}

static uint64_t after_mag(const mpu_model_t *chip, uint64_t time_us)
{
    return chip->feed ? chip->feed->next_mag_us(chip->feed->context, time_us) : time_us + MAG_PERIOD_US;
}

static void reset(mpu_model_t *chip)
{
    memset(chip->registers, 0, sizeof chip->registers);
    memset(chip->mag, 0, sizeof chip->mag);
    chip->registers[0x6B] = 0x01;
    chip->registers[0x75] = chip->who_am_i;
    chip->is_slave_4_due = false;
    chip->reset_us = *chip->now_us;
    static const uint8_t gyro_codes[3] = {100, 110, 0}, accel_codes[3] = {120, 0, 130};
    memcpy(chip->registers, gyro_codes, 3);
    memcpy(chip->registers + 0x0D, accel_codes, 3);
    chip->mag[0] = 0x48;
    chip->next_sample_us = chip->feed ? after_sample(chip, *chip->now_us + RESET_US, 0) : *chip->now_us + RESET_US;
}

void mpu_model_init(mpu_model_t *chip, const uint64_t *now_us)
{
    *chip = (mpu_model_t){.now_us = now_us, .who_am_i = 0x71, .adjustment = {176, 178, 166}, .mag_overflow_from_us = UINT64_MAX};
    reset(chip);
    chip->reset_us = 0;
}

static void put16(uint8_t *at, int16_t value)
{
    at[0] = (uint8_t)((uint16_t)value >> 8);
    at[1] = (uint8_t)value;
}

/* ---- the magnetometer ---- */

static void measure_field(mpu_model_t *chip)
{
    int16_t values[3];
    if (chip->feed)
        chip->feed->field(chip->feed->context, chip->next_mag_us, values);
    else
        mpu_model_field(chip->mag_number, values);
    chip->mag_number++;
    if (chip->mag[2] & ST1_READY)
        chip->mag[2] |= ST1_OVERRUN;
    chip->mag[2] |= ST1_READY;
    for (int i = 0; i < 3; i++) {
        chip->mag[3 + 2 * i] = (uint8_t)values[i];
        chip->mag[4 + 2 * i] = (uint8_t)((uint16_t)values[i] >> 8);
    }
    chip->mag[9] = (uint8_t)(0x10 | (*chip->now_us >= chip->mag_overflow_from_us ? OVERFLOW : 0));
}

static uint8_t read_mag(mpu_model_t *chip, uint8_t reg)
{
    if (reg >= 0x10 && reg <= 0x12)
        return (chip->mag[0x0A] & 15) == 0x0F ? chip->adjustment[reg - 0x10] : 0; /* fuse access mode only */
    const uint8_t value = reg < sizeof chip->mag ? chip->mag[reg] : 0;
    if (reg == 9)
        chip->mag[2] &= (uint8_t)~(ST1_READY | ST1_OVERRUN); /* reading ST2 ends the reading */
    return value;
}

static void write_mag(mpu_model_t *chip, uint8_t reg, uint8_t value)
{
    if (reg == 0x0B && (value & 1)) {
        memset(chip->mag + 2, 0, sizeof chip->mag - 2);
        return;
    }
    const uint8_t mode = chip->mag[0x0A] & 15;
    if (reg == 0x0A && mode != 0 && (value & 15) != 0)
        return; /* only through power-down */
    if (reg == 0x0A || reg == 0x0C)
        chip->mag[reg] = value;
    chip->next_mag_us = after_mag(chip, *chip->now_us);
}

static bool is_master_on(const mpu_model_t *chip)
{
    return (chip->registers[0x6A] & 0x20) != 0 && !chip->is_master_stuck;
}

/* The I2C master works at the sample rate: slave 0, then slave 4, register map 4.6 and 4.12. */
static void run_slave_4(mpu_model_t *chip)
{
    const uint8_t address = chip->registers[0x31];
    const bool is_answered = !chip->is_mag_absent && (address & 0x7F) == 0x0C && is_master_on(chip);
    if (!chip->is_slave_4_due || !is_master_on(chip))
        return;
    chip->is_slave_4_due = false;
    chip->registers[0x34] &= 0x7F;
    chip->registers[0x36] |= (uint8_t)(0x40 | (is_answered ? 0 : 0x10));
    if (is_answered && (address & 0x80))
        chip->registers[0x35] = read_mag(chip, chip->registers[0x32]);
    else if (is_answered)
        write_mag(chip, chip->registers[0x32], chip->registers[0x33]);
}

static void run_slave_0(mpu_model_t *chip)
{
    const uint8_t control = chip->registers[0x27];
    if (!is_master_on(chip) || !(control & 0x80) || chip->is_mag_absent || chip->registers[0x25] != 0x8C)
        return;
    for (uint8_t i = 0; i < (control & 15); i++)
        chip->registers[0x49 + i] = read_mag(chip, (uint8_t)(chip->registers[0x26] + i));
}

/* ---- measuring ---- */

static void measure(mpu_model_t *chip)
{
    int16_t values[6];
    if (chip->feed && !chip->is_frozen)
        chip->feed->motion(chip->feed->context, chip->next_sample_us, values);
    else
        mpu_model_motion(chip->is_frozen ? 1 : chip->sample_number, values);
    const bool is_pushed_gyro = (chip->registers[0x1B] & 0xE0) == 0xE0, is_pushed_accel = (chip->registers[0x1C] & 0xE0) == 0xE0;
    for (int i = 0; i < 3; i++) { /* self-test: little noise, and a push */
        if (chip->registers[0x1C] == 0x00 || is_pushed_accel)
            values[i] = (int16_t)(values[i] / 2000 + (is_pushed_accel ? 8000 : 0));
        if (chip->registers[0x1B] == 0x00 || is_pushed_gyro)
            values[3 + i] = (int16_t)(values[3 + i] / 2000 + (is_pushed_gyro ? 7800 : 0));
        put16(chip->registers + 0x3B + 2 * i, values[i]);
        put16(chip->registers + 0x43 + 2 * i, values[3 + i]);
    }
    put16(chip->registers + 0x41, (int16_t)(chip->sample_number % 1000));
    run_slave_0(chip);
    run_slave_4(chip);
    if (chip->registers[0x3A] & 1)
        chip->overruns++;
    if (chip->registers[0x38] & 1)
        chip->registers[0x3A] |= 1;
    chip->sample_number++;
}

/* Register map 4.4: the divider divides 1 kHz, if the low-pass is on. */
uint32_t mpu_model_period_us(const mpu_model_t *chip)
{
    const uint8_t lowpass = chip->registers[0x1A] & 7;
    return lowpass == 0 || lowpass == 7 ? 125 : 1000u * (1u + chip->registers[0x19]);
}

void mpu_model_step(mpu_model_t *chip)
{
    const uint32_t period_us = mpu_model_period_us(chip);
    while (chip->next_sample_us <= *chip->now_us) {
        while ((chip->mag[0x0A] & 15) == 6 && chip->next_mag_us <= chip->next_sample_us) {
            measure_field(chip);
            chip->next_mag_us = after_mag(chip, chip->next_mag_us);
        }
        measure(chip);
        chip->next_sample_us = after_sample(chip, chip->next_sample_us, period_us);
    }
}

bool mpu_model_has_sample(const mpu_model_t *chip)
{
    return !chip->is_absent && (chip->registers[0x3A] & 1);
}

/* ---- the bus ---- */

static bool is_measurement(uint8_t reg)
{
    return reg >= 0x3A && reg <= 0x60;
}

static bool is_slow_enough(mpu_model_t *chip, uint8_t reg, bool is_read)
{
    const uint32_t most_hz = is_read && is_measurement(reg) ? MEASUREMENTS_HZ : REGISTERS_HZ;
    chip->fast_accesses += chip->clock_hz > most_hz;
    return chip->clock_hz <= most_hz;
}

static void write_register(mpu_model_t *chip, uint8_t reg, uint8_t value)
{
    const bool is_read_only = reg == 0x75 || is_measurement(reg) || reg == 0x36 || reg == 0x35;
    chip->slave_errors += chip->is_slave_4_due && reg >= 0x31 && reg <= 0x34;
    if (reg == 0x6B && (value & 0x80)) {
        reset(chip);
        return;
    }
    if (is_read_only || (reg == chip->stuck_register && reg))
        return;
    chip->registers[reg] = value;
    if (reg == 0x6A && (value & 0x02)) { /* the master's reset clears itself */
        chip->registers[reg] &= (uint8_t)~0x02;
        chip->is_master_stuck = chip->is_slave_4_due = false;
    }
    chip->is_slave_4_due |= reg == 0x34 && (value & 0x80);
}

static uint8_t read_register(mpu_model_t *chip, uint8_t reg)
{
    const uint8_t value = chip->registers[reg & 0x7F];
    if (reg == 0x3A || reg == 0x36)
        chip->registers[reg] = 0; /* cleared by reading */
    return value;
}

void mpu_model_transfer(mpu_model_t *chip, const uint8_t *out, uint8_t *in, size_t length)
{
    const bool is_awake = chip->reset_us == 0 || *chip->now_us - chip->reset_us >= RESET_US;
    const uint8_t first = out[0];
    mpu_model_step(chip);
    in[0] = 0xFF;
    for (size_t i = 1; i < length; i++) {
        const uint8_t sent = out[i], reg = (uint8_t)((first & 0x7F) + i - 1);
        in[i] = 0xFF;
        if (chip->is_absent || !is_slow_enough(chip, reg, (first & 0x80) != 0))
            continue;
        if (first & 0x80)
            in[i] = is_awake ? read_register(chip, reg) : 0;
        else if (is_awake || reg == 0x6B)
            write_register(chip, reg, sent);
    }
}
