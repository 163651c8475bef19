#include "sampler.h"

#include "crc32.h"

enum { TEMPERATURES_PER_S = 10 };

void sampler_init(sampler_t *sampler, log_writer_t *writer, uint32_t period_us)
{
    sampler->writer = writer;
    sampler->is_frozen = sampler->has_begun = false;
    sampler->period_us = period_us;
    sampler->temperature_every = 1000000 / TEMPERATURES_PER_S / period_us;
    sampler->watch = (mpu9250_watch_t){.repeats = 0};
}

/* Samples the sensor made and nobody fetched. Polled stamps are early or late by up to half a period at 1 kHz, so a
 * distance of 1.5 periods is still none missed. */
static void count_missed(sampler_t *sampler, uint64_t time_us)
{
    const uint64_t since_us = time_us - sampler->last_us;
    if (sampler->last_us == 0 || since_us < sampler->period_us + sampler->period_us * 3 / 4)
        return;
    const uint32_t missed = (uint32_t)((since_us + sampler->period_us / 4) / sampler->period_us - 1);
    log_writer_lose(sampler->writer, RECORD_IMU, GAP_SENSOR, sampler->last_us + sampler->period_us,
                    time_us - sampler->period_us, missed);
}

/* Results of appending are of no use here: the writer counts what found no room and records it as a gap. */
static void append(sampler_t *sampler, uint64_t time_us, const mpu9250_sample_t *sample, const record_imu_t *imu,
                   const record_mag_t *mag)
{
    count_missed(sampler, time_us);
    (void)log_writer_imu(sampler->writer, time_us, imu);
    if (sample->has_mag)
        (void)log_writer_mag(sampler->writer, time_us, mag);
    if (sampler->samples % sampler->temperature_every == 0)
        (void)log_writer_temperature(sampler->writer, time_us, sample->temperature);
}

/* A point of calibration counts when the box has been turned since the one before: 500 of them cannot all be alike. */
static void count_point(sampler_t *sampler, const mpu9250_sample_t *sample)
{
    int32_t distance = 0;
    for (int i = 0; i < 3; i++) {
        const int32_t change = sample->mag[i] - sampler->last_point[i];
        distance += change < 0 ? -change : change;
    }
    if (sample->has_mag_overflow || distance < SAMPLER_MAG_STEP)
        return;
    for (int i = 0; i < 3; i++)
        sampler->last_point[i] = sample->mag[i];
    if (sampler->points < UINT16_MAX)
        sampler->points++;
}

static void offer(sampler_t *sampler, uint64_t time_us, const mpu9250_sample_t *sample, const record_imu_t *imu,
                  const record_mag_t *mag)
{
    if (sampler->stream_every == 0 || !sampler->queue)
        return;
    const bool is_due = sampler->samples % sampler->stream_every == 0;
    const uint32_t put = (uint32_t)atomic_load_explicit(&sampler->put, memory_order_relaxed);
    const uint32_t taken = (uint32_t)atomic_load_explicit(&sampler->taken, memory_order_acquire);
    if (!is_due || (uint32_t)(put - taken) >= SAMPLER_QUEUE)
        return;
    sampler->queue[put % SAMPLER_QUEUE] =
        (sampler_item_t){.time_us = time_us, .imu = *imu, .mag = *mag, .has_mag = sample->has_mag};
    atomic_store_explicit(&sampler->put, put + 1, memory_order_release);
}

bool sampler_take(sampler_t *sampler, sampler_item_t *item)
{
    const uint32_t taken = (uint32_t)atomic_load_explicit(&sampler->taken, memory_order_relaxed);
    if (taken == (uint32_t)atomic_load_explicit(&sampler->put, memory_order_acquire))
        return false;
    *item = sampler->queue[taken % SAMPLER_QUEUE];
    atomic_store_explicit(&sampler->taken, taken + 1, memory_order_release);
    return true;
}

/* Whether the magnetometer's bytes are a reading: those of a master that hangs say for ever that they are new. */
static bool is_reading(sampler_t *sampler, const mpu9250_sample_t *sample)
{
    bool is_equal = true;
    if (!sample->has_mag)
        return false;
    for (int i = 0; i < 3; i++) {
        is_equal = is_equal && sampler->last_mag[i] == sample->mag[i];
        sampler->last_mag[i] = sample->mag[i];
    }
    sampler->mag_repeats = !is_equal ? 0 : sampler->mag_repeats < SAMPLER_MAG_FROZEN ? sampler->mag_repeats + 1 : SAMPLER_MAG_FROZEN;
    return sampler->mag_repeats < SAMPLER_MAG_FROZEN;
}

void sampler_on_burst(void *context, uint64_t time_us, const uint8_t *burst)
{
    sampler_t *sampler = context;
    mpu9250_sample_t sample;
    mpu9250_decode(burst, &sample);
    if (!sample.has_data)
        return;
    if (!sampler->has_begun) { /* nobody knows how long it lay there */
        sampler->has_begun = true;
        return;
    }
    record_imu_t imu;
    record_mag_t mag = {.flags = (uint8_t)((sample.has_mag_overflow ? MAG_OVERFLOW : 0) |
                                           (sample.has_mag_missed ? MAG_MISSED : 0))};
    for (int i = 0; i < 3; i++) {
        imu.accel[i] = sample.accel[i];
        imu.gyro[i] = sample.gyro[i];
        mag.field[i] = sample.mag[i];
    }
    sampler->is_frozen = mpu9250_is_frozen(&sampler->watch, &sample);
    sampler->samples++;
    sampler->noise = crc32_update(sampler->noise, burst, MPU9250_BURST);
    sample.has_mag = is_reading(sampler, &sample);
    if (sample.has_mag) {
        sampler->mag_ms = (uint32_t)(time_us / 1000);
        count_point(sampler, &sample);
    }
    if (sampler->is_recording)
        append(sampler, time_us, &sample, &imu, &mag);
    offer(sampler, time_us, &sample, &imu, &mag);
    sampler->last_us = time_us;
    sampler->last_ms = (uint32_t)(time_us / 1000);
}
