#include "log_writer.h"

#include <string.h>

#include "error.h"

enum { LONGEST_SHORT_TIME_US = 65535 };

static const uint8_t sources[LOG_SOURCES] = {RECORD_IMU, RECORD_MAG, RECORD_TEMPERATURE, RECORD_GPS, 0};

void log_writer_start(log_writer_t *writer, ring_t *ring, uint32_t session, uint64_t now_us)
{
    memset(writer, 0, sizeof *writer);
    writer->ring = ring;
    writer->session = session;
    writer->latest_us = now_us;
}

static log_loss_t *loss_of(log_writer_t *writer, uint8_t source)
{
    size_t i = 0;
    while (i < LOG_SOURCES - 1 && sources[i] != source) {
        i++;
    }
    return &writer->loss[i];
}

void log_writer_lose(log_writer_t *writer, uint8_t source, uint8_t reason, uint64_t first_us, uint64_t last_us,
                     uint32_t count)
{
    log_loss_t *loss = loss_of(writer, source);
    if (count == 0) {
        return;
    }
    if (loss->count == 0) {
        loss->first_us = first_us;
        loss->last_us = last_us;
        loss->reason = reason;
    }
    loss->first_us = first_us < loss->first_us ? first_us : loss->first_us;
    loss->last_us = last_us > loss->last_us ? last_us : loss->last_us;
    loss->count += count;
    if (source == RECORD_IMU) {
        writer->imu_lost += count;
    }
}

static void commit(log_writer_t *writer)
{
    block_close(writer->block, &writer->head);
    writer->block = NULL;
    writer->sequence++;
    ring_commit(writer->ring);
    const uint32_t count = ring_count(writer->ring);
    if (count > writer->most_blocks) {
        writer->most_blocks = (uint16_t)count;
    }
}

static bool open_block(log_writer_t *writer, uint64_t base_us)
{
    writer->block = ring_open(writer->ring);
    if (writer->block == NULL) {
        return false;
    }
    writer->head = (block_head_t){
        .session = writer->session,
        .sequence = writer->sequence,
        .base_us = base_us,
        .imu_number = writer->imu_number,
        .used = 0,
    };
    return true;
}

static bool fits(const log_writer_t *writer, uint8_t type, uint64_t time_us, size_t length)
{
    if (writer->head.used + length > BLOCK_CAPACITY) {
        return false;
    }
    const uint64_t base_us = writer->head.base_us;
    if (type >= RECORD_FIRST_LONG) {
        return time_us <= base_us + INT32_MAX;
    }
    return time_us >= base_us && time_us - base_us <= LONGEST_SHORT_TIME_US;
}

/* Base of a block that begins with this record. The samples that follow a long record must lie within 65 ms after the
 * base, and the next one may be older than the record: so the newest sample's time, while samples come. */
static uint64_t base_for(const log_writer_t *writer, uint8_t type, uint64_t time_us)
{
    const bool do_samples_come = time_us <= writer->latest_us + LONGEST_SHORT_TIME_US;
    return type >= RECORD_FIRST_LONG && do_samples_come ? writer->latest_us : time_us;
}

/* Where a record may be written in the block being filled, or in a new one; NULL without room. */
static uint8_t *make_room(log_writer_t *writer, uint8_t type, uint64_t time_us, size_t length)
{
    if (writer->block != NULL && !fits(writer, type, time_us, length)) {
        commit(writer);
    }
    if (writer->block == NULL && !open_block(writer, base_for(writer, type, time_us))) {
        return NULL;
    }
    return writer->block + BLOCK_RECORDS + writer->head.used;
}

static int32_t since_base(const log_writer_t *writer, uint64_t time_us)
{
    const int64_t since_us = (int64_t)time_us - (int64_t)writer->head.base_us;
    return since_us < INT32_MIN ? INT32_MIN : (int32_t)since_us;
}

static bool write_gap(log_writer_t *writer, size_t i, uint64_t now_us)
{
    log_loss_t *loss = &writer->loss[i];
    const uint64_t time_us = now_us > writer->latest_us ? now_us : writer->latest_us;
    uint8_t *out = make_room(writer, RECORD_GAP, time_us, RECORD_GAP_BYTES);
    if (out == NULL) {
        return false;
    }
    const record_gap_t gap = {sources[i], loss->reason, loss->count, loss->first_us, loss->last_us};
    writer->head.used = (uint16_t)(writer->head.used + record_put_gap(out, since_base(writer, time_us), &gap));
    if (sources[i] == RECORD_IMU) {
        writer->imu_number += loss->count;
    }
    loss->count = 0;
    return true;
}

static bool write_gaps(log_writer_t *writer, uint64_t now_us)
{
    for (size_t i = 0; i < LOG_SOURCES; i++) {
        if (writer->loss[i].count > 0 && !write_gap(writer, i, now_us)) {
            return false;
        }
    }
    return true;
}

/* Room for a record after all outstanding gaps; NULL, and the loss counted, if there is none. */
static uint8_t *reserve(log_writer_t *writer, uint8_t type, uint64_t time_us, size_t length)
{
    if (type < RECORD_FIRST_LONG && time_us > writer->latest_us) {
        writer->latest_us = time_us;
    }
    uint8_t *out = write_gaps(writer, time_us) ? make_room(writer, type, time_us, length) : NULL;
    if (out == NULL) {
        log_writer_lose(writer, type, GAP_NO_ROOM, time_us, time_us, 1);
    }
    return out;
}

static int append(log_writer_t *writer, size_t length)
{
    writer->head.used = (uint16_t)(writer->head.used + length);
    return CORE_OK;
}

int log_writer_imu(log_writer_t *writer, uint64_t time_us, const record_imu_t *imu)
{
    uint8_t *out = reserve(writer, RECORD_IMU, time_us, RECORD_IMU_BYTES);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    writer->imu_number++;
    writer->imu_records++;
    return append(writer, record_put_imu(out, (uint16_t)since_base(writer, time_us), imu));
}

int log_writer_mag(log_writer_t *writer, uint64_t time_us, const record_mag_t *mag)
{
    uint8_t *out = reserve(writer, RECORD_MAG, time_us, RECORD_MAG_BYTES);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    return append(writer, record_put_mag(out, (uint16_t)since_base(writer, time_us), mag));
}

int log_writer_temperature(log_writer_t *writer, uint64_t time_us, int16_t counts)
{
    uint8_t *out = reserve(writer, RECORD_TEMPERATURE, time_us, RECORD_TEMPERATURE_BYTES);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    const uint16_t since = (uint16_t)since_base(writer, time_us);
    return append(writer, record_put_temperature(out, since, counts));
}

int log_writer_gps(log_writer_t *writer, uint64_t time_us, const uint8_t *sentence, size_t length)
{
    if (length > RECORD_GPS_LONGEST) {
        return CORE_TOO_LONG;
    }
    uint8_t *out = reserve(writer, RECORD_GPS, time_us, RECORD_LONG_HEAD + length);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    writer->gps_records++;
    return append(writer, record_put_gps(out, since_base(writer, time_us), sentence, length));
}

int log_writer_setup(log_writer_t *writer, uint64_t time_us, const record_setup_t *setup)
{
    uint8_t *out = reserve(writer, RECORD_SETUP, time_us, RECORD_SETUP_BYTES);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    return append(writer, record_put_setup(out, since_base(writer, time_us), setup));
}

static int config_piece(log_writer_t *writer, uint64_t time_us, const char *text, size_t total, size_t offset)
{
    const size_t left = total - offset;
    const size_t length = left < RECORD_CONFIG_PIECE ? left : RECORD_CONFIG_PIECE;
    uint8_t *out = reserve(writer, RECORD_CONFIG, time_us, RECORD_LONG_HEAD + 4 + length);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    const int32_t since = since_base(writer, time_us);
    return append(writer, record_put_config(out, since, (uint16_t)offset, (uint16_t)total, text + offset, length));
}

int log_writer_config(log_writer_t *writer, uint64_t time_us, const char *text, size_t length)
{
    if (length > CONFIG_TEXT_LONGEST) {
        return CORE_TOO_LONG;
    }
    int result = CORE_OK;
    for (size_t offset = 0; offset < length && result == CORE_OK; offset += RECORD_CONFIG_PIECE) {
        result = config_piece(writer, time_us, text, length, offset);
    }
    return result;
}

int log_writer_event(log_writer_t *writer, uint64_t time_us, uint16_t code, uint32_t value)
{
    uint8_t *out = reserve(writer, RECORD_EVENT, time_us, RECORD_EVENT_BYTES);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    return append(writer, record_put_event(out, since_base(writer, time_us), code, value));
}

int log_writer_self_test(log_writer_t *writer, uint64_t time_us, const record_self_test_t *test)
{
    uint8_t *out = reserve(writer, RECORD_SELF_TEST, time_us, RECORD_SELF_TEST_BYTES);
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    return append(writer, record_put_self_test(out, since_base(writer, time_us), test));
}

void log_writer_flush(log_writer_t *writer)
{
    if (writer->block != NULL && writer->head.used > 0) {
        commit(writer);
    }
}

void log_writer_flush_older(log_writer_t *writer, uint64_t now_us, uint32_t age_us)
{
    if (writer->block != NULL && now_us > writer->head.base_us && now_us - writer->head.base_us > age_us) {
        log_writer_flush(writer);
    }
}

int log_writer_stop(log_writer_t *writer, uint64_t time_us, uint8_t reason, uint16_t card_retries)
{
    uint8_t *out = write_gaps(writer, time_us) ? make_room(writer, RECORD_STOP, time_us, RECORD_STOP_BYTES) : NULL;
    if (out == NULL) {
        return CORE_NO_ROOM;
    }
    const record_stop_t stop = {
        .reason = reason,
        .imu_records = writer->imu_records,
        .imu_lost = writer->imu_lost,
        .gps_records = writer->gps_records,
        .most_blocks = writer->most_blocks,
        .card_retries = card_retries,
    };
    writer->head.used = (uint16_t)(writer->head.used + record_put_stop(out, since_base(writer, time_us), &stop));
    log_writer_flush(writer);
    return CORE_OK;
}

uint32_t log_writer_count(log_writer_t *writer)
{
    return ring_count(writer->ring);
}

const uint8_t *log_writer_front(log_writer_t *writer, uint32_t index)
{
    uint8_t *block = ring_peek(writer->ring, index);
    if (block != NULL) {
        block_seal(block);
    }
    return block;
}

void log_writer_release(log_writer_t *writer)
{
    ring_release(writer->ring);
}
