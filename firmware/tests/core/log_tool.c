/* log_tool RING SESSION NOW: reads orders from stdin, a line each, and writes what the consumer takes to stdout: blocks, or
 * frames. Through it other languages drive the writer.
 *
 *   imu T ax ay az gx gy gz | mag T x y z flags | temperature T counts | gps T hex | event T code value
 *   setup T hex(64) | config T hex | selftest T 6 responses hex(6) passed | lose source reason first last count
 *   take N | flush | stop T reason retries | frame (short records that follow go into a frame) | endframe
 *
 * Prints nothing else; exit code 1 for an order it does not know. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bytes.h"
#include "error.h"
#include "frame.h"
#include "log_writer.h"

enum { MOST_BLOCKS = 64, LINE = 1024, VALUES = 8 };

typedef struct {
    log_writer_t writer;
    frame_t frame;
    bool is_framing;
} tool_t;

static size_t read_hex(const char *text, uint8_t *out, size_t most)
{
    size_t length = 0;
    unsigned byte = 0;
    while (length < most && sscanf(text + 2 * length, "%2x", &byte) == 1) {
        out[length++] = (uint8_t)byte;
    }
    return length;
}

static size_t read_values(const char *text, int64_t *values, size_t most)
{
    size_t count = 0;
    char *end = NULL;
    for (; count < most; count++, text = end) {
        values[count] = strtoll(text, &end, 10);
        if (end == text) {
            break;
        }
    }
    return count;
}

static void copy_i16(int16_t *out, const int64_t *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        out[i] = (int16_t)values[i];
    }
}

static void take(log_writer_t *writer, int64_t count)
{
    for (; count > 0 && log_writer_count(writer) > 0; count--) {
        fwrite(log_writer_front(writer, 0), BLOCK_BYTES, 1, stdout);
        log_writer_release(writer);
    }
}

static void end_frame(frame_t *frame)
{
    fwrite(frame->bytes, 1, frame_finish(frame), stdout);
    frame_next(frame);
}

static void frame_imu(frame_t *frame, uint64_t time_us, const record_imu_t *imu)
{
    int32_t since = 0;
    uint8_t *out = frame_reserve(frame, RECORD_IMU, RECORD_IMU_BYTES, time_us, &since);
    if (out == NULL) {
        end_frame(frame);
        out = frame_reserve(frame, RECORD_IMU, RECORD_IMU_BYTES, time_us, &since);
    }
    if (out != NULL) {
        frame_append(frame, record_put_imu(out, (uint16_t)since, imu));
    }
}

static record_setup_t read_setup(const char *hex)
{
    uint8_t d[RECORD_SETUP_BYTES - RECORD_LONG_HEAD] = {0};
    read_hex(hex, d, sizeof d);
    record_setup_t setup = {
        .purpose = d[0],
        .flags = d[1],
        .imu_who_am_i = d[2],
        .mag_who_am_i = d[3],
        .mag_adjustment = {d[4], d[5], d[6]},
        .reset_cause = d[7],
        .imu_period_us = bytes_get_u32(d + 8),
        .accel_range_g = bytes_get_u16(d + 12),
        .gyro_range_dps = bytes_get_u16(d + 14),
        .accel_lowpass_hz = bytes_get_u16(d + 16),
        .gyro_lowpass_hz = bytes_get_u16(d + 18),
        .accel_delay_us = bytes_get_u16(d + 20),
        .gyro_delay_us = bytes_get_u16(d + 22),
        .mag_period_us = bytes_get_u32(d + 24),
        .gps_period_us = bytes_get_u32(d + 28),
        .gps_baud = bytes_get_u32(d + 32),
        .boot_number = bytes_get_u32(d + 36),
        .config_crc = bytes_get_u32(d + 40),
    };
    memcpy(setup.firmware, d + 44, sizeof setup.firmware);
    memcpy(setup.device, d + 52, sizeof setup.device);
    return setup;
}

static void put_imu(tool_t *tool, const int64_t *v)
{
    record_imu_t imu;
    copy_i16(imu.accel, v + 1, 3);
    copy_i16(imu.gyro, v + 4, 3);
    if (tool->is_framing) {
        frame_imu(&tool->frame, (uint64_t)v[0], &imu);
    } else {
        (void)log_writer_imu(&tool->writer, (uint64_t)v[0], &imu);
    }
}

static void put_mag(log_writer_t *writer, const int64_t *v)
{
    record_mag_t mag = {.flags = (uint8_t)v[4]};
    copy_i16(mag.field, v + 1, 3);
    (void)log_writer_mag(writer, (uint64_t)v[0], &mag);
}

static void put_self_test(log_writer_t *writer, const char *text)
{
    int64_t v[VALUES];
    record_self_test_t test = {{0}, {0}, 0};
    read_values(text, v, 8);
    copy_i16(test.response, v + 1, 6);
    const char *hex = strchr(text, 'x');
    read_hex(hex == NULL ? "" : hex + 1, test.factory_code, sizeof test.factory_code);
    test.passed = (uint8_t)v[7];
    (void)log_writer_self_test(writer, (uint64_t)v[0], &test);
}

/* Orders whose arguments are numbers. False if it is none of them. */
static bool do_numbers(tool_t *tool, const char *order, const int64_t *v)
{
    log_writer_t *writer = &tool->writer;
    if (strcmp(order, "imu") == 0) {
        put_imu(tool, v);
    } else if (strcmp(order, "mag") == 0) {
        put_mag(writer, v);
    } else if (strcmp(order, "temperature") == 0) {
        (void)log_writer_temperature(writer, (uint64_t)v[0], (int16_t)v[1]);
    } else if (strcmp(order, "event") == 0) {
        (void)log_writer_event(writer, (uint64_t)v[0], (uint16_t)v[1], (uint32_t)v[2]);
    } else if (strcmp(order, "lose") == 0) {
        log_writer_lose(writer, (uint8_t)v[0], (uint8_t)v[1], (uint64_t)v[2], (uint64_t)v[3], (uint32_t)v[4]);
    } else if (strcmp(order, "take") == 0) {
        take(writer, v[0]);
    } else if (strcmp(order, "stop") == 0) {
        while (log_writer_stop(writer, (uint64_t)v[0], (uint8_t)v[1], (uint16_t)v[2]) == CORE_NO_ROOM) {
            take(writer, 1);
        }
    } else {
        return false;
    }
    return true;
}

/* Orders with a time and a text in hexadecimal digits, or with nothing. False if it is none of them. */
static bool do_text(tool_t *tool, const char *order, uint64_t time_us, const char *hex)
{
    uint8_t bytes[CONFIG_TEXT_LONGEST];
    log_writer_t *writer = &tool->writer;
    if (strcmp(order, "gps") == 0) {
        (void)log_writer_gps(writer, time_us, bytes, read_hex(hex, bytes, sizeof bytes));
    } else if (strcmp(order, "config") == 0) {
        (void)log_writer_config(writer, time_us, (const char *)bytes, read_hex(hex, bytes, sizeof bytes));
    } else if (strcmp(order, "setup") == 0) {
        const record_setup_t setup = read_setup(hex);
        (void)log_writer_setup(writer, time_us, &setup);
    } else if (strcmp(order, "flush") == 0) {
        log_writer_flush(writer);
    } else if (strcmp(order, "frame") == 0) {
        tool->is_framing = true;
    } else if (strcmp(order, "endframe") == 0) {
        end_frame(&tool->frame);
        tool->is_framing = false;
    } else {
        return false;
    }
    return true;
}

static bool do_line(tool_t *tool, char *line)
{
    int64_t values[VALUES] = {0};
    char *rest = strchr(line, ' ');
    if (rest != NULL) {
        *rest++ = '\0';
    }
    const char *text = rest == NULL ? "" : rest;
    if (strcmp(line, "selftest") == 0) {
        put_self_test(&tool->writer, text);
        return true;
    }
    read_values(text, values, VALUES);
    if (do_numbers(tool, line, values)) {
        return true;
    }
    const char *hex = strchr(text, ' ');
    return do_text(tool, line, (uint64_t)values[0], hex == NULL ? "" : hex + 1);
}

int main(int count, char **arguments)
{
    static uint8_t storage[MOST_BLOCKS][BLOCK_BYTES];
    static tool_t tool;
    static char line[LINE];
    ring_t ring;
    if (count != 4) {
        return 1;
    }
    ring_init(&ring, storage, (uint32_t)strtoul(arguments[1], NULL, 10));
    log_writer_start(&tool.writer, &ring, (uint32_t)strtoul(arguments[2], NULL, 10),
                     strtoull(arguments[3], NULL, 10));
    frame_init(&tool.frame);
    while (fgets(line, sizeof line, stdin) != NULL) {
        line[strcspn(line, "\n")] = '\0';
        if (!do_line(&tool, line)) {
            fprintf(stderr, "unknown order: %s\n", line);
            return 1;
        }
    }
    take(&tool.writer, INT64_MAX);
    return 0;
}
