#include "records.h"

#include <string.h>

#include "bytes.h"
#include "error.h"

static void put_three(uint8_t *out, const int16_t values[3])
{
    for (size_t i = 0; i < 3; i++) {
        bytes_put_i16(out + 2 * i, values[i]);
    }
}

static uint8_t *put_short_head(uint8_t *out, uint8_t type, uint16_t since_base_us)
{
    out[0] = type;
    bytes_put_u16(out + 1, since_base_us);
    return out + RECORD_SHORT_HEAD;
}

static uint8_t *put_long_head(uint8_t *out, uint8_t type, size_t length, int32_t since_base_us)
{
    out[0] = type;
    out[1] = (uint8_t)length;
    bytes_put_u32(out + 2, (uint32_t)since_base_us);
    return out + RECORD_LONG_HEAD;
}

size_t record_put_imu(uint8_t *out, uint16_t since_base_us, const record_imu_t *imu)
{
    uint8_t *data = put_short_head(out, RECORD_IMU, since_base_us);
    put_three(data, imu->accel);
    put_three(data + 6, imu->gyro);
    return RECORD_IMU_BYTES;
}

size_t record_put_mag(uint8_t *out, uint16_t since_base_us, const record_mag_t *mag)
{
    uint8_t *data = put_short_head(out, RECORD_MAG, since_base_us);
    put_three(data, mag->field);
    data[6] = mag->flags;
    return RECORD_MAG_BYTES;
}

size_t record_put_temperature(uint8_t *out, uint16_t since_base_us, int16_t counts)
{
    bytes_put_i16(put_short_head(out, RECORD_TEMPERATURE, since_base_us), counts);
    return RECORD_TEMPERATURE_BYTES;
}

size_t record_put_gps(uint8_t *out, int32_t since_base_us, const uint8_t *sentence, size_t length)
{
    memcpy(put_long_head(out, RECORD_GPS, length, since_base_us), sentence, length);
    return RECORD_LONG_HEAD + length;
}

size_t record_put_gap(uint8_t *out, int32_t since_base_us, const record_gap_t *gap)
{
    uint8_t *data = put_long_head(out, RECORD_GAP, RECORD_GAP_BYTES - RECORD_LONG_HEAD, since_base_us);
    data[0] = gap->source;
    data[1] = gap->reason;
    bytes_put_u32(data + 2, gap->count);
    bytes_put_u48(data + 6, gap->first_us);
    bytes_put_u48(data + 12, gap->last_us);
    return RECORD_GAP_BYTES;
}

size_t record_put_setup(uint8_t *out, int32_t since_base_us, const record_setup_t *setup)
{
    uint8_t *data = put_long_head(out, RECORD_SETUP, RECORD_SETUP_BYTES - RECORD_LONG_HEAD, since_base_us);
    data[0] = setup->purpose;
    data[1] = setup->flags;
    data[2] = setup->imu_who_am_i;
    data[3] = setup->mag_who_am_i;
    memcpy(data + 4, setup->mag_adjustment, 3);
    data[7] = setup->reset_cause;
    bytes_put_u32(data + 8, setup->imu_period_us);
    bytes_put_u16(data + 12, setup->accel_range_g);
    bytes_put_u16(data + 14, setup->gyro_range_dps);
    bytes_put_u16(data + 16, setup->accel_lowpass_hz);
    bytes_put_u16(data + 18, setup->gyro_lowpass_hz);
    bytes_put_u16(data + 20, setup->accel_delay_us);
    bytes_put_u16(data + 22, setup->gyro_delay_us);
    bytes_put_u32(data + 24, setup->mag_period_us);
    bytes_put_u32(data + 28, setup->gps_period_us);
    bytes_put_u32(data + 32, setup->gps_baud);
    bytes_put_u32(data + 36, setup->boot_number);
    bytes_put_u32(data + 40, setup->config_crc);
    memcpy(data + 44, setup->firmware, sizeof setup->firmware);
    memcpy(data + 52, setup->device, sizeof setup->device);
    return RECORD_SETUP_BYTES;
}

size_t record_put_config(uint8_t *out, int32_t since_base_us, uint16_t offset, uint16_t total, const char *piece,
                         size_t length)
{
    uint8_t *data = put_long_head(out, RECORD_CONFIG, 4 + length, since_base_us);
    bytes_put_u16(data, offset);
    bytes_put_u16(data + 2, total);
    memcpy(data + 4, piece, length);
    return RECORD_LONG_HEAD + 4 + length;
}

size_t record_put_event(uint8_t *out, int32_t since_base_us, uint16_t code, uint32_t value)
{
    uint8_t *data = put_long_head(out, RECORD_EVENT, RECORD_EVENT_BYTES - RECORD_LONG_HEAD, since_base_us);
    bytes_put_u16(data, code);
    bytes_put_u32(data + 2, value);
    return RECORD_EVENT_BYTES;
}

size_t record_put_self_test(uint8_t *out, int32_t since_base_us, const record_self_test_t *test)
{
    uint8_t *data = put_long_head(out, RECORD_SELF_TEST, RECORD_SELF_TEST_BYTES - RECORD_LONG_HEAD, since_base_us);
    put_three(data, test->response);
    put_three(data + 6, test->response + 3);
    memcpy(data + 12, test->factory_code, sizeof test->factory_code);
    data[18] = test->passed;
    return RECORD_SELF_TEST_BYTES;
}

size_t record_put_stop(uint8_t *out, int32_t since_base_us, const record_stop_t *stop)
{
    uint8_t *data = put_long_head(out, RECORD_STOP, RECORD_STOP_BYTES - RECORD_LONG_HEAD, since_base_us);
    data[0] = stop->reason;
    bytes_put_u32(data + 1, stop->imu_records);
    bytes_put_u32(data + 5, stop->imu_lost);
    bytes_put_u32(data + 9, stop->gps_records);
    bytes_put_u16(data + 13, stop->most_blocks);
    bytes_put_u16(data + 15, stop->card_retries);
    return RECORD_STOP_BYTES;
}

static size_t short_length(uint8_t type)
{
    switch (type) {
    case RECORD_IMU: return RECORD_IMU_BYTES;
    case RECORD_MAG: return RECORD_MAG_BYTES;
    case RECORD_TEMPERATURE: return RECORD_TEMPERATURE_BYTES;
    default: return 0;
    }
}

int record_length(const uint8_t *record, size_t length)
{
    if (length == 0) {
        return CORE_INVALID;
    }
    size_t whole = short_length(record[0]);
    if (record[0] >= RECORD_FIRST_LONG) {
        if (length < RECORD_LONG_HEAD) {
            return CORE_INVALID;
        }
        whole = (size_t)RECORD_LONG_HEAD + record[1];
    }
    return whole == 0 || whole > length ? CORE_INVALID : (int)whole;
}
