/* The interrupt's side of sampling: takes bursts apart, appends to the log, and leaves copies for the live stream. All of
 * it runs at one interrupt priority; the main loop reads the volatile words, or locks. */
#ifndef APP_SAMPLER_H
#define APP_SAMPLER_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include "log_writer.h"
#include "mpu9250.h"
#include "records.h"

enum {
    SAMPLER_QUEUE = 8,           /* samples for the stream: 8 ms at 1 kHz; a power of two */
    SAMPLER_MAG_FROZEN = 20,     /* equal readings in a row: the I2C master hangs, and its last bytes are read again and again */
    SAMPLER_MAG_STEP = 20        /* counts, 3 uT: the field must have turned so far for another point of calibration */
};

typedef struct {
    uint64_t time_us;
    record_imu_t imu;
    record_mag_t mag;
    bool has_mag;
} sampler_item_t;

typedef struct {
    log_writer_t *writer;
    volatile bool is_recording;
    volatile bool is_frozen;
    bool has_begun;                /* the sample that lay there when sampling began has been read */
    volatile uint32_t samples;     /* since the start */
    volatile uint32_t last_ms;     /* of the newest sample; a word, so that it is read whole */
    volatile uint32_t mag_ms;      /* of the magnetometer's newest reading */
    volatile uint16_t points;      /* of the magnetometer, since the calibration began */
    uint32_t period_us;
    uint32_t temperature_every;    /* samples */
    uint32_t stream_every;         /* samples; 0 no stream */
    uint32_t noise;                /* of the sensor, stirred: a source of session ids */
    uint64_t last_us;
    mpu9250_watch_t watch;
    int16_t last_point[3], last_mag[3];
    uint16_t mag_repeats;
    sampler_item_t *queue; /* SAMPLER_QUEUE of them; NULL without a stream */
    atomic_uint_fast32_t put, taken;
} sampler_t;

/* Begin afresh, before sampling is started. */
void sampler_init(sampler_t *sampler, log_writer_t *writer, uint32_t period_us);

/* board_events_t */
void sampler_on_burst(void *sampler, uint64_t time_us, const uint8_t *burst);

/* The main loop's side of the queue: false when it is empty. */
bool sampler_take(sampler_t *sampler, sampler_item_t *item);

#endif
