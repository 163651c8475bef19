/* From samples to blocks: appends records to the block being filled, starts blocks, records every loss as a gap.
 *
 * log_writer_* with the time of a record belong to the producer: call them from one interrupt priority only, or with
 * that interrupt masked. They copy some 150 bytes at most and never wait. log_writer_front and log_writer_release
 * belong to the consumer. Times are us since power-on; short records (IMU, MAG, TEMPERATURE) come in order of time.
 *
 * A record that finds no room is counted, and stands as a GAP before the first record of any kind that finds room
 * again. Appending returns CORE_OK, CORE_NO_ROOM (lost, and counted) or CORE_TOO_LONG (not recorded, not counted). */
#ifndef CORE_LOG_WRITER_H
#define CORE_LOG_WRITER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "block.h"
#include "config.h"
#include "records.h"
#include "ring.h"

enum { LOG_SOURCES = 5 }; /* IMU, MAG, TEMPERATURE, GPS, others */

typedef struct {
    uint64_t first_us;
    uint64_t last_us;
    uint32_t count; /* 0: nothing lost */
    uint8_t reason; /* GAP_* of the first */
} log_loss_t;

typedef struct {
    ring_t *ring;
    uint8_t *block; /* being filled, NULL between blocks */
    block_head_t head;
    uint64_t latest_us; /* time of the newest short record, stored or lost */
    uint32_t sequence;
    uint32_t session;
    uint32_t imu_number;
    log_loss_t loss[LOG_SOURCES];
    uint32_t imu_records;
    uint32_t imu_lost;
    uint32_t gps_records;
    uint16_t most_blocks;
} log_writer_t;

/* Start a recording in an empty ring. */
void log_writer_start(log_writer_t *writer, ring_t *ring, uint32_t session, uint64_t now_us);

int log_writer_imu(log_writer_t *writer, uint64_t time_us, const record_imu_t *imu);
int log_writer_mag(log_writer_t *writer, uint64_t time_us, const record_mag_t *mag);
int log_writer_temperature(log_writer_t *writer, uint64_t time_us, int16_t counts);
int log_writer_gps(log_writer_t *writer, uint64_t time_us, const uint8_t *sentence, size_t length);
int log_writer_setup(log_writer_t *writer, uint64_t time_us, const record_setup_t *setup);
int log_writer_config(log_writer_t *writer, uint64_t time_us, const char *text, size_t length);
int log_writer_event(log_writer_t *writer, uint64_t time_us, uint16_t code, uint32_t value);
int log_writer_self_test(log_writer_t *writer, uint64_t time_us, const record_self_test_t *test);

/* Say that `count` records of `source`, the first at first_us and the last at last_us, were lost before they could be
 * appended (sensor not read, serial line overrun). */
void log_writer_lose(log_writer_t *writer, uint8_t source, uint8_t reason, uint64_t first_us, uint64_t last_us,
                     uint32_t count);

/* Commit the block being filled, if it holds anything: before a stop, and when nothing came for long. */
void log_writer_flush(log_writer_t *writer);

/* Commit the block being filled if its base is older than `age_us`. */
void log_writer_flush_older(log_writer_t *writer, uint64_t now_us, uint32_t age_us);

/* Write outstanding gaps and the STOP record, and flush. CORE_NO_ROOM: release blocks and call again. */
int log_writer_stop(log_writer_t *writer, uint64_t time_us, uint8_t reason, uint16_t card_retries);

/* Consumer: how many sealed blocks wait; block `index` of them, ready to be written (NULL: none); drop the oldest. */
uint32_t log_writer_count(log_writer_t *writer);
const uint8_t *log_writer_front(log_writer_t *writer, uint32_t index);
void log_writer_release(log_writer_t *writer);

#endif
