/* The logger as a whole: the drivers and core wired together over a board. No registers in here; the host tests run all
 * of it against models. */
#ifndef APP_APP_H
#define APP_APP_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "config.h"
#include "logger.h"
#include "log_writer.h"
#include "sampler.h"
#include "storage.h"
#include "stream.h"

enum {
    APP_RING_BLOCKS = 28,            /* rides out 712 ms at 1 kHz: DESIGN.md section 3 */
    APP_STREAM_BLOCKS = 2,           /* of them, lent to the stream if there is one */
    APP_SETUP_US = 5000000,          /* SETUP and CONFIG are repeated */
    APP_FLUSH_US = 1000000,          /* a block is written though not full */
    APP_IMU_SILENT_US = 200000,      /* no sample for so long: reset it */
    APP_IMU_TRIES = 3,               /* in quick succession */
    APP_IMU_RETRY_US = 5000000,
    APP_MAG_SILENT_US = 1000000,     /* no reading for so long: say so, and set the sensor up anew while idle .. */
    APP_MAG_RETRY_US = 10000000,     /* .. so often */
    APP_CARD_CHECK_US = 2000000,
    APP_CARD_RETRY_US = 20000,       /* doubles with each failure .. */
    APP_CARD_RETRY_MOST_US = 2000000, /* .. up to this */
    APP_CARD_RESUMES = 5,            /* within 0.6 s, before the card is taken for a new one */
    APP_STOP_LONGEST_US = 10000000,  /* for the last blocks, should the card be away */
    APP_BLOCKED_LONGEST_US = 60000000, /* one call into the card: then the watchdog may bite */
    APP_FIX_US = 3000000             /* how long a fix counts */
};

/* Where the main loop was, for the watchdog's event. */
typedef enum { AT_LOOP = 1, AT_CARD_OPEN, AT_CARD_STEP, AT_CARD_RESUME, AT_CARD_END, AT_IMU } app_mark_t;

typedef struct {
    config_t config;
    config_result_t result;
    bool is_known; /* a card was looked at */
    bool has_file;
} app_settings_t;

typedef struct {
    bool is_open;     /* a session, up to its last block */
    bool is_stopping; /* it is being ended */
    bool is_stop_written;
    bool is_calibration;
    uint8_t stop_reason;
    uint32_t session;
    uint64_t setup_us, stop_us;
    uint16_t card_retries; /* those of the driver are its own */
    uint32_t noted_retries;
} app_recording_t;

typedef struct {
    uint64_t retry_us, lost_us, checked_us;
    uint8_t failures; /* in a row */
    int lost_error;
    int8_t result; /* of the last opening */
    bool has_been_tried;
} app_card_t;

typedef struct {
    board_events_t events;
    mpu9250_info_t chip;
    sampler_t sampler;
    record_self_test_t self_test;
    bool has_self_test;
    bool is_known, is_working;
    bool is_mag_silent, is_restart_wanted;
    uint8_t failures;
    uint64_t retry_us, lost_us, started_us;
} app_imu_t;

typedef struct {
    neo6m_t receiver;
    neo6m_events_t events;
    uint32_t baud, refused;
    bool has_fix;
    uint64_t fix_us;
} app_gps_t;

typedef struct {
    panel_t pins;
    gesture_t gesture; /* not yet seen by the logger */
    bool is_checking;  /* the parts, by `selftest` */
} app_panel_t;

/* Of the ring, a stream borrows some blocks. */
typedef union {
    uint8_t blocks[APP_RING_BLOCKS][BLOCK_BYTES];
    struct {
        uint8_t ring[APP_RING_BLOCKS - APP_STREAM_BLOCKS][BLOCK_BYTES];
        stream_memory_t stream;
    } with_stream;
} app_memory_t;

typedef struct {
    const board_t *board;
    app_settings_t settings;
    logger_t logger; /* what is to be done, from what all the others say */
    app_panel_t panel;
    app_imu_t imu;
    app_gps_t gps;
    app_card_t card;
    app_recording_t recording;
    ring_t ring;
    log_writer_t writer;
    storage_t storage;
    stream_t stream;
    uint64_t step_us, report_us;
    app_memory_t memory;
} app_t;

_Static_assert(sizeof(stream_memory_t) <= APP_STREAM_BLOCKS * BLOCK_BYTES, "the stream needs more");

/* `app` may be any memory; it must stay where it is. */
void app_init(app_t *app, const board_t *board);

/* One turn of the main loop. */
void app_step(app_t *app);

/* ---- between the files of the app: app.c knows all of them, and none of them app.c ---- */

/* Appending from the main loop keeps the sampling interrupt out: the writer has one producer at a time. */
#define LOCKED(app, expression)                       \
    do {                                              \
        (app)->board->lock((app)->board->context);    \
        (expression);                                 \
        (app)->board->unlock((app)->board->context);  \
    } while (0)

/* imu.c of the app: keep the sensor working, set it up anew when imu.is_restart_wanted. Uses the journal. */
void app_step_imu(app_t *app, uint64_t now_us);
void app_run_self_test(app_t *app);

/* journal.c: what is written besides samples. */
void app_event(app_t *app, uint16_t code, uint32_t value);
record_setup_t app_setup(const app_t *app);
void app_write_setup(app_t *app, uint64_t now_us);
void app_write_history(app_t *app);

/* recording.c: sessions. Uses the journal and the storage, not the files below; 0 or an error of the storage. */
int app_start_recording(app_t *app, uint64_t now_us, bool is_calibration);
void app_stop_recording(app_t *app, uint64_t now_us, uint8_t reason);
void app_step_recording(app_t *app, uint64_t now_us);
void app_clear_ring(app_t *app);

/* gps.c of the app: begin to look for the receiver and set it up. Uses the journal. */
void app_start_gps(app_t *app, uint64_t now_us);

/* checks.c: `selftest` on the serial line; a few seconds. Uses imu.c and the storage. */
void app_check_parts(app_t *app);

/* card.c of the app: keep the card working, move blocks, read the settings. Uses recording.c, gps.c, the journal and the storage. */
void app_step_card(app_t *app, uint64_t now_us);
void app_card_failed(app_t *app, uint64_t now_us);

#endif
