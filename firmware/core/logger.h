/* The state machine: what the logger does, from what the button, the card and the sensors say. Pure: it is stepped with
 * everything it needs to know and answers with what the app has to do. */
#ifndef CORE_LOGGER_H
#define CORE_LOGGER_H

#include <stdbool.h>
#include <stdint.h>

#include "button.h"
#include "led.h"

enum {
    LOGGER_CALIBRATION_POINTS = 500,        /* as in the thesis */
    LOGGER_OFFER_US = 10000000,             /* how long calibration is offered at the first boot */
    LOGGER_CALIBRATION_LONGEST_US = 180000000
};

typedef enum {
    LOGGER_STARTING,    /* card or sensor not ready yet */
    LOGGER_OFFERING,    /* first boot: calibrate the magnetometer? */
    LOGGER_IDLE,
    LOGGER_RECORDING,
    LOGGER_CALIBRATING,
    LOGGER_FULL,        /* the card is full; only another card or a restart helps */
    LOGGER_SAFE,        /* stopped for good by a long press or a low supply: safe to switch off */
    LOGGER_FATAL        /* neither IMU nor GPS */
} logger_state_t;

typedef enum {
    LOGGER_DO_NOTHING,
    LOGGER_START_RECORDING,
    LOGGER_START_CALIBRATION,
    LOGGER_STOP_BUTTON,      /* stop the recording, with the STOP_* reason of that name */
    LOGGER_STOP_CARD_FULL,
    LOGGER_STOP_SUPPLY_LOW,
    LOGGER_STOP_CALIBRATED,
    LOGGER_STOP_FAULT
} logger_action_t;

/* What keeps the card from being written; being retried. */
typedef enum { CARD_WELL, CARD_MISSING, CARD_FAILING, CARD_FOREIGN } card_trouble_t;

/* Levels, not edges: as they are now. */
typedef struct {
    uint64_t now_us;
    gesture_t gesture;         /* since the last step */
    bool is_card_ready;        /* a file system with a spare file */
    bool is_card_full;
    card_trouble_t card_trouble;
    bool is_imu_known;         /* found, or given up */
    bool is_imu_working;
    bool is_mag_working;
    bool is_gps_working;       /* bytes came in the last seconds */
    bool has_fix;
    bool is_supply_low;
    bool is_calibrated;        /* a calibration of the magnetometer is on the card */
    uint16_t calibration_points;
} logger_inputs_t;

typedef struct {
    logger_state_t state;
    uint64_t since_us;
    bool autostart;
    bool was_offered;
    bool is_safe_by_supply;
    card_trouble_t card_trouble;
    bool is_imu_working;
    bool has_fix;
} logger_t;

void logger_init(logger_t *logger, bool autostart, uint64_t now_us);
logger_action_t logger_step(logger_t *logger, const logger_inputs_t *inputs);
led_pattern_t logger_led(const logger_t *logger);

#endif
