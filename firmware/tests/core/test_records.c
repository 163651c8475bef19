#include <string.h>

#include "check.h"
#include "error.h"
#include "records.h"

static void imu_bytes(void)
{
    uint8_t out[RECORD_LONGEST];
    const record_imu_t imu = {{1, -2, INT16_MAX}, {INT16_MIN, 256, -256}};
    const uint8_t want[] = {0x01, 0x34, 0x12, 1, 0, 0xFE, 0xFF, 0xFF, 0x7F, 0x00, 0x80, 0, 1, 0, 0xFF};
    CHECK_EQUAL(record_put_imu(out, 0x1234, &imu), RECORD_IMU_BYTES);
    CHECK_SAME(out, want, sizeof want);
}

static void mag_and_temperature_bytes(void)
{
    uint8_t out[RECORD_LONGEST];
    const record_mag_t mag = {{100, -100, 3}, MAG_OVERFLOW};
    const uint8_t want_mag[] = {0x02, 5, 0, 100, 0, 0x9C, 0xFF, 3, 0, 1};
    const uint8_t want_temperature[] = {0x03, 0xFF, 0xFF, 0xFE, 0xFF};
    CHECK_EQUAL(record_put_mag(out, 5, &mag), RECORD_MAG_BYTES);
    CHECK_SAME(out, want_mag, sizeof want_mag);
    CHECK_EQUAL(record_put_temperature(out, 65535, -2), RECORD_TEMPERATURE_BYTES);
    CHECK_SAME(out, want_temperature, sizeof want_temperature);
}

static void sentence_bytes(void)
{
    uint8_t out[RECORD_LONGEST];
    const uint8_t want[] = {0x81, 3, 0xFE, 0xFF, 0xFF, 0xFF, '$', 'a', '\n'};
    CHECK_EQUAL(record_put_gps(out, -2, (const uint8_t *)"$a\n", 3), sizeof want);
    CHECK_SAME(out, want, sizeof want);
}

static void gap_bytes(void)
{
    uint8_t out[RECORD_LONGEST];
    const record_gap_t gap = {RECORD_IMU, GAP_NO_ROOM, 0x01020304, UINT64_C(0x0A0B0C0D0E0F), UINT64_C(0xFFFFFFFFFFFF)};
    const uint8_t want[] = {0x83, 18, 7, 0, 0, 0, 1, 1, 4, 3, 2, 1, 0x0F, 0x0E, 0x0D, 0x0C, 0x0B, 0x0A, 0xFF, 0xFF, 0xFF,
                            0xFF, 0xFF, 0xFF};
    CHECK_EQUAL(record_put_gap(out, 7, &gap), RECORD_GAP_BYTES);
    CHECK_SAME(out, want, sizeof want);
}

static void lengths(void)
{
    uint8_t out[RECORD_LONGEST] = {0};
    const record_setup_t setup = {.purpose = PURPOSE_DRIVE};
    const record_self_test_t test = {.passed = 0x3F};
    const record_stop_t stop = {.reason = STOP_BUTTON};
    const size_t have[] = {record_put_setup(out, 0, &setup), record_put_event(out, 0, EVENT_BUTTON, 1),
                           record_put_self_test(out, 0, &test), record_put_stop(out, 0, &stop),
                           record_put_config(out, 0, 0, 2, "a=", 2)};
    const size_t want[] = {RECORD_SETUP_BYTES, RECORD_EVENT_BYTES, RECORD_SELF_TEST_BYTES, RECORD_STOP_BYTES,
                           RECORD_LONG_HEAD + 4 + 2};
    CHECK_SAME(have, want, sizeof want);
    CHECK_EQUAL(record_length(out, sizeof out), RECORD_LONG_HEAD + 4 + 2);
}

static void cut_off(void)
{
    uint8_t out[RECORD_LONGEST];
    const record_imu_t imu = {{0}, {0}};
    const size_t length = record_put_imu(out, 0, &imu);
    for (size_t there = 0; there < length; there++) {
        CHECK_EQUAL(record_length(out, there), CORE_INVALID);
    }
    CHECK_EQUAL(record_length(out, length), (int)length);
}

static void unknown(void)
{
    const uint8_t unknown_short[] = {0x7F, 0, 0, 0};
    const uint8_t unknown_long[] = {0xFF, 1, 0, 0, 0, 0, 9};
    CHECK_EQUAL(record_length(unknown_short, sizeof unknown_short), CORE_INVALID);
    CHECK_EQUAL(record_length(unknown_long, sizeof unknown_long), 7);
}

const suite_t records_suite = {"records",
                               (const test_t[]){{"an IMU record has the bytes of the format", imu_bytes},
                                                {"so have MAG and TEMPERATURE", mag_and_temperature_bytes},
                                                {"so has a sentence, older than its block", sentence_bytes},
                                                {"so has a gap, with whole times", gap_bytes},
                                                {"every long record has the length of the format", lengths},
                                                {"a record cut off anywhere is refused", cut_off},
                                                {"an unknown long record is skipped, a short one is not", unknown},
                                                {0}}};
