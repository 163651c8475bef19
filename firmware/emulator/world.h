/* The board around the controller: card, IMU and receiver (the models of tests/drivers), button, supply; what the sensors
 * measure from a file, and what happens when from another. */
#ifndef EMULATOR_WORLD_H
#define EMULATOR_WORLD_H

#include <stdio.h>

#include "chip.h"
#include "mpu_model.h"
#include "neo_model.h"
#include "sd_model.h"

enum { CARD_CLUSTER_SECTORS = 64, JOURNAL = 32, LONGEST_LINE = 120 };

/* In a copy of the world whose power was cut, since it came back: by then all is in order and the button is pressed, to
 * record once more; and the copy's end. */
enum { AGAIN_PRESS_US = 2400000, PRESSED_US = 120000, AFTERWARDS_US = 3600000 };

typedef struct {
    uint64_t time_us;
    int16_t values[6];
} motion_t;

typedef struct {
    uint64_t time_us;
    int16_t values[3];
} field_t;

/* How long the card is busy. Short: `busy_us` and an exponential part of mean `busy_us` more, after every write. Stalls:
 * the first write later than an exponential pause of mean `stall_pause_us` after `stall_rest_us` of peace meets one, its
 * length uniform up to stall_us, but every third exactly that. */
typedef struct {
    uint32_t busy_us, stall_us, stall_pause_us, stall_rest_us;
} delays_t;

typedef struct {
    uint64_t time_us;
    char line[LONGEST_LINE];
} action_t;

/* How the card was formatted, as in fat_image_t; a blank one was not. */
typedef struct {
    uint32_t clusters, free_clusters, free_run, is_blank;
    char config[SD_MODEL_SECTOR]; /* CONFIG.TXT; empty: none */
} card_plan_t;

typedef struct {
    uint32_t sector;
    uint64_t time_us;
    uint8_t before[SD_MODEL_SECTOR];
} written_t;

typedef struct {
    machine_t machine;
    chip_t chip;
    uint64_t now_us;
    const char *typed; /* still to be typed; NULL: nothing */
    uint64_t next_typed_us;
    sd_model_t card, other_card;
    card_plan_t plan;
    mpu_model_t imu;
    neo_model_t receiver;
    mpu_feed_t feed;

    motion_t *motions;
    field_t *fields;
    neo_fix_t *fixes;
    size_t motion_count, field_count, fix_count;
    uint64_t lead_us; /* before the first sample the first second is measured, to and fro */

    action_t *actions;
    size_t action_count, action_at;
    bool is_pressed, is_supply_low, is_cut_wanted, is_restart_wanted, is_child;
    uint64_t on_us, again_us; /* in a copy: when its power came back, and after what time it goes again (0: it does not) */
    uint32_t flip_every; /* of the card's wires, from power-on */
    uint32_t cache; /* sectors that a power cut may undo */
    unsigned cuts, cut_parallel;
    uint32_t spurious_us, stream_baud;
    uint64_t next_spurious; /* cycles */
    bool is_wire_broken;    /* of the IMU's interrupt */
    uint32_t storm_us;      /* an edge on it so often; 0: as the IMU says */
    uint64_t next_storm_us;
    bool is_other_card;

    delays_t delays;
    uint64_t random, next_stall_us;
    uint32_t exact_stall_us; /* of the next write, once */
    written_t journal[JOURNAL];
    uint32_t journal_writes;

    const char *out;
    FILE *serial;
    FILE *panel; /* time and state of the LED, at each change */

    /* seen */
    uint32_t stalls, longest_stall_us, seen_samples, edges, led_changes, resets, spurious;
    uint64_t stall_from_us, stall_until_us;
    uint64_t measured_from, measured_until, measured_slept;
    bool is_measuring;
    uint32_t metadata_writes; /* to tables and root directory, while measuring */
    FILE *writes;             /* if asked for: time and sector of each */
} world_t;

int world_init(world_t *world, const char *image, const char *stimulus, const char *script, const char *out);
void world_report(const world_t *world);

/* Write the medium's volume (without the partition table), its recordings and the list of its files into the folder
 * `out`; of the card that was in before into `out`/other. */
int world_save(const world_t *world, const char *out);

#endif
