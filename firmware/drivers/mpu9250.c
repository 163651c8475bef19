#include "mpu9250.h"

enum {
    REG_SELF_TEST_GYRO = 0x00,
    REG_SELF_TEST_ACCEL = 0x0D,
    REG_SMPLRT_DIV = 0x19,
    REG_CONFIG = 0x1A,
    REG_GYRO_CONFIG = 0x1B,
    REG_ACCEL_CONFIG = 0x1C,
    REG_ACCEL_CONFIG_2 = 0x1D,
    REG_I2C_MST_CTRL = 0x24,
    REG_I2C_SLV0_ADDR = 0x25,
    REG_I2C_SLV0_REG = 0x26,
    REG_I2C_SLV0_CTRL = 0x27,
    REG_I2C_SLV4_ADDR = 0x31,
    REG_I2C_SLV4_REG = 0x32,
    REG_I2C_SLV4_DO = 0x33,
    REG_I2C_SLV4_CTRL = 0x34,
    REG_I2C_SLV4_DI = 0x35,
    REG_I2C_MST_STATUS = 0x36,
    REG_INT_PIN_CFG = 0x37,
    REG_INT_ENABLE = 0x38,
    REG_INT_STATUS = 0x3A,
    REG_I2C_MST_DELAY_CTRL = 0x67,
    REG_USER_CTRL = 0x6A,
    REG_PWR_MGMT_1 = 0x6B,
    REG_PWR_MGMT_2 = 0x6C,
    REG_WHO_AM_I = 0x75,
    READ = 0x80
};

enum {
    PWR_RESET = 0x80,
    PWR_CLOCK_PLL = 0x01,
    USER_I2C_MASTER = 0x20,
    USER_RESET_MASTER = 0x02,  /* clears itself */
    USER_NO_I2C_SLAVE = 0x10,  /* this is SPI: the pins must not be taken for I2C */
    MASTER_WAIT_FOR_ES = 0x40, /* data ready only when the magnetometer's bytes are there too */
    MASTER_400_KHZ = 0x0D,
    DELAY_ES_SHADOW = 0x80,
    SLAVE_ENABLE = 0x80,
    SLV4_DONE = 0x40,
    SLV4_NACK = 0x10,
    INT_RAW_READY = 0x01,
    SELF_TEST_ON = 0xE0,
    RESET_US = 100000,
    SETTLE_US = 35000, /* gyro start-up */
    MASTER_US = 500,
    MASTER_TRIES = 20 /* 10 ms: ten samples, for the divider is set last */
};

enum {
    AK_ADDRESS = 0x0C,
    AK_WIA = 0x00,
    AK_ST1 = 0x02,
    AK_SHADOW_BYTES = 8, /* ST1, six of data, ST2: reading ST2 is what lets the next reading in */
    AK_CNTL1 = 0x0A,
    AK_CNTL2 = 0x0B,
    AK_ASAX = 0x10,
    AK_ID = 0x48,
    AK_POWER_DOWN = 0x00,
    AK_FUSE_ACCESS = 0x0F,
    AK_100_HZ_16_BIT = 0x16,
    AK_SOFT_RESET = 0x01,
    AK_PERIOD_US = 10000,
    ST1_READY = 0x01,
    ST1_OVERRUN = 0x02,
    ST2_OVERFLOW = 0x08
};

/* RM-MPU-9250A-00 4.5 to 4.8: one setting of DLPF_CFG and A_DLPFCFG for each */
static const struct {
    uint8_t setting;
    uint16_t gyro_hz, gyro_delay_us, accel_hz, accel_delay_us;
} filters[] = {{1, 184, 2900, 218, 1880}, {2, 92, 3900, 99, 2880},  {3, 41, 5900, 45, 4880},
               {4, 20, 9900, 21, 8870},   {5, 10, 17850, 10, 16830}, {6, 5, 33480, 5, 32480}};
enum { FILTERS = sizeof filters / sizeof *filters };

/* ---- registers ---- */

static int read_registers(const mpu9250_bus_t *bus, uint8_t reg, uint8_t *values, size_t count)
{
    uint8_t bytes[1 + 14] = {(uint8_t)(READ | reg)};
    if (count >= sizeof bytes || bus->transfer(bus->context, bytes, bytes, 1 + count) < 0)
        return MPU9250_BUS;
    for (size_t i = 0; i < count; i++)
        values[i] = bytes[1 + i];
    return MPU9250_OK;
}

static int write_blind(const mpu9250_bus_t *bus, uint8_t reg, uint8_t value)
{
    uint8_t bytes[2] = {reg, value};
    return bus->transfer(bus->context, bytes, bytes, sizeof bytes) < 0 ? MPU9250_BUS : MPU9250_OK;
}

static int write_register(const mpu9250_bus_t *bus, uint8_t reg, uint8_t value)
{
    uint8_t kept = 0;
    int result = write_blind(bus, reg, value);
    if (result == MPU9250_OK)
        result = read_registers(bus, reg, &kept, 1);
    if (result != MPU9250_OK)
        return result;
    return kept == value ? MPU9250_OK : MPU9250_UNFAITHFUL;
}

typedef struct {
    uint8_t reg, value;
} write_t;

static int write_all(const mpu9250_bus_t *bus, const write_t *writes, size_t count)
{
    int result = MPU9250_OK;
    for (size_t i = 0; i < count && result == MPU9250_OK; i++)
        result = write_register(bus, writes[i].reg, writes[i].value);
    return result;
}

/* ---- the magnetometer, one register at a time through slave 4 of the I2C master ---- */

static int run_slave_4(const mpu9250_bus_t *bus)
{
    int result = write_blind(bus, REG_I2C_SLV4_CTRL, SLAVE_ENABLE); /* clears itself, so it cannot be read back */
    for (int i = 0; i < MASTER_TRIES && result == MPU9250_OK; i++) {
        uint8_t status = 0;
        bus->wait_us(bus->context, MASTER_US);
        result = read_registers(bus, REG_I2C_MST_STATUS, &status, 1);
        if (result == MPU9250_OK && (status & SLV4_DONE))
            return status & SLV4_NACK ? MPU9250_MAG_SILENT : MPU9250_OK;
    }
    return result == MPU9250_OK ? MPU9250_MAG_SILENT : result;
}

static int mag_write(const mpu9250_bus_t *bus, uint8_t reg, uint8_t value)
{
    const write_t writes[] = {{REG_I2C_SLV4_ADDR, AK_ADDRESS}, {REG_I2C_SLV4_REG, reg}, {REG_I2C_SLV4_DO, value}};
    const int result = write_all(bus, writes, sizeof writes / sizeof *writes);
    return result == MPU9250_OK ? run_slave_4(bus) : result;
}

static int mag_read(const mpu9250_bus_t *bus, uint8_t reg, uint8_t *value)
{
    const write_t writes[] = {{REG_I2C_SLV4_ADDR, READ | AK_ADDRESS}, {REG_I2C_SLV4_REG, reg}};
    int result = write_all(bus, writes, sizeof writes / sizeof *writes);
    if (result == MPU9250_OK)
        result = run_slave_4(bus);
    return result == MPU9250_OK ? read_registers(bus, REG_I2C_SLV4_DI, value, 1) : result;
}

/* AK8963 6.3: through power-down between modes, 100 us each. */
static int mag_set_mode(const mpu9250_bus_t *bus, uint8_t mode)
{
    int result = mag_write(bus, AK_CNTL1, AK_POWER_DOWN);
    bus->wait_us(bus->context, MASTER_US);
    if (result == MPU9250_OK && mode != AK_POWER_DOWN)
        result = mag_write(bus, AK_CNTL1, mode);
    bus->wait_us(bus->context, MASTER_US);
    return result;
}

static int mag_read_adjustment(const mpu9250_bus_t *bus, uint8_t adjustment[3])
{
    int result = mag_set_mode(bus, AK_FUSE_ACCESS);
    for (uint8_t i = 0; i < 3 && result == MPU9250_OK; i++)
        result = mag_read(bus, AK_ASAX + i, &adjustment[i]);
    return result;
}

static int mag_start(const mpu9250_bus_t *bus, mpu9250_info_t *info)
{
    const write_t shadow[] = {{REG_I2C_SLV0_ADDR, READ | AK_ADDRESS},
                              {REG_I2C_SLV0_REG, AK_ST1},
                              {REG_I2C_SLV0_CTRL, SLAVE_ENABLE | AK_SHADOW_BYTES}};
    uint8_t id = 0;
    int result = mag_write(bus, AK_CNTL2, AK_SOFT_RESET);
    bus->wait_us(bus->context, MASTER_US);
    if (result == MPU9250_OK)
        result = mag_read(bus, AK_WIA, &id);
    if (result == MPU9250_OK && id != AK_ID)
        result = MPU9250_MAG_SILENT;
    if (result == MPU9250_OK)
        result = mag_read_adjustment(bus, info->mag_adjustment);
    if (result == MPU9250_OK)
        result = mag_set_mode(bus, AK_100_HZ_16_BIT);
    if (result == MPU9250_OK)
        result = write_all(bus, shadow, sizeof shadow / sizeof *shadow);
    if (result != MPU9250_OK)
        return result;
    info->mag_who_am_i = id;
    info->mag_period_us = AK_PERIOD_US;
    return MPU9250_OK;
}

/* A transfer that a reset of the controller cut short leaves the master, or the magnetometer on its bus, waiting. */
static int reset_master(const mpu9250_bus_t *bus)
{
    const int result = write_blind(bus, REG_USER_CTRL, USER_I2C_MASTER | USER_NO_I2C_SLAVE | USER_RESET_MASTER);
    bus->wait_us(bus->context, MASTER_US);
    return result;
}

/* A magnetometer that does not answer is left alone: six axes are logged and said to be six. */
static int open_magnetometer(const mpu9250_bus_t *bus, mpu9250_info_t *info)
{
    const write_t master[] = {{REG_I2C_MST_CTRL, MASTER_WAIT_FOR_ES | MASTER_400_KHZ},
                              {REG_I2C_MST_DELAY_CTRL, DELAY_ES_SHADOW},
                              {REG_USER_CTRL, USER_I2C_MASTER | USER_NO_I2C_SLAVE}};
    int result = write_all(bus, master, sizeof master / sizeof *master);
    for (int i = 0; i < 2 && result == MPU9250_OK; i++) {
        result = mag_start(bus, info);
        if (result != MPU9250_MAG_SILENT)
            return result;
        result = reset_master(bus);
    }
    const write_t off[] = {{REG_I2C_SLV0_CTRL, 0}, {REG_I2C_MST_CTRL, MASTER_400_KHZ}, {REG_USER_CTRL, USER_NO_I2C_SLAVE}};
    return result == MPU9250_OK ? write_all(bus, off, sizeof off / sizeof *off) : result;
}

/* ---- start ---- */

static int reset(const mpu9250_bus_t *bus, uint8_t *who_am_i)
{
    int result = write_blind(bus, REG_PWR_MGMT_1, PWR_RESET);
    bus->wait_us(bus->context, RESET_US);
    if (result == MPU9250_OK)
        result = write_blind(bus, REG_USER_CTRL, USER_NO_I2C_SLAVE);
    if (result == MPU9250_OK)
        result = read_registers(bus, REG_WHO_AM_I, who_am_i, 1);
    if (result == MPU9250_OK && (*who_am_i == 0x00 || *who_am_i == 0xFF))
        result = MPU9250_ABSENT;
    const write_t wake[] = {{REG_USER_CTRL, USER_NO_I2C_SLAVE}, {REG_PWR_MGMT_1, PWR_CLOCK_PLL}, {REG_PWR_MGMT_2, 0}};
    if (result == MPU9250_OK)
        result = write_all(bus, wake, sizeof wake / sizeof *wake);
    bus->wait_us(bus->context, SETTLE_US);
    return result;
}

/* FS_SEL of a full scale that doubles from the least. */
static uint8_t range_bits(uint16_t range, uint16_t least)
{
    uint8_t bits = 0;
    while (bits < 3 && least << bits < range)
        bits++;
    return (uint8_t)(bits << 3);
}

static size_t find_filter(uint16_t lowpass_hz)
{
    size_t i = 0;
    while (i < FILTERS - 1 && filters[i].gyro_hz > lowpass_hz)
        i++;
    return i;
}

int mpu9250_open(const mpu9250_bus_t *bus, const mpu9250_settings_t *settings, mpu9250_info_t *info)
{
    const size_t filter = find_filter(settings->lowpass_hz);
    const uint8_t divider = (uint8_t)(settings->rate_hz ? 1000 / settings->rate_hz - 1 : 0);
    *info = (mpu9250_info_t){.period_us = (divider + 1u) * 1000,
                             .accel_lowpass_hz = filters[filter].accel_hz,
                             .gyro_lowpass_hz = filters[filter].gyro_hz,
                             .accel_delay_us = filters[filter].accel_delay_us,
                             .gyro_delay_us = filters[filter].gyro_delay_us};
    const write_t writes[] = {{REG_CONFIG, filters[filter].setting},
                              {REG_GYRO_CONFIG, range_bits(settings->gyro_range_dps, 250)},
                              {REG_ACCEL_CONFIG, range_bits(settings->accel_range_g, 2)},
                              {REG_ACCEL_CONFIG_2, filters[filter].setting},
                              {REG_INT_PIN_CFG, 0}, /* a push-pull pulse of 50 us */
                              {REG_INT_ENABLE, INT_RAW_READY}};
    int result = reset(bus, &info->who_am_i);
    if (result == MPU9250_OK)
        result = write_all(bus, writes, sizeof writes / sizeof *writes);
    if (result == MPU9250_OK && settings->has_magnetometer && info->who_am_i != MPU9250_WHO_MPU6500)
        result = open_magnetometer(bus, info);
    /* last: the I2C master works once a sample, and at 50 Hz each of its registers would take 20 ms */
    return result == MPU9250_OK ? write_register(bus, REG_SMPLRT_DIV, divider) : result;
}

/* ---- samples ---- */

static int16_t big_endian(const uint8_t *bytes)
{
    const int32_t value = bytes[0] << 8 | bytes[1];
    return (int16_t)(value < 0x8000 ? value : value - 0x10000);
}

static int16_t little_endian(const uint8_t *bytes)
{
    const uint8_t swapped[2] = {bytes[1], bytes[0]};
    return big_endian(swapped);
}

void mpu9250_decode(const uint8_t burst[MPU9250_BURST], mpu9250_sample_t *sample)
{
    const uint8_t *status = burst + 1, *accel = burst + 2, *gyro = burst + 10, *mag = burst + 16;
    sample->has_data = (*status & INT_RAW_READY) != 0 && *status != 0xFF; /* FF: nobody drives the line */
    sample->temperature = big_endian(burst + 8);
    for (size_t i = 0; i < 3; i++) {
        sample->accel[i] = big_endian(accel + 2 * i);
        sample->gyro[i] = big_endian(gyro + 2 * i);
        sample->mag[i] = little_endian(mag + 1 + 2 * i); /* the AK8963 sends the low byte first */
    }
    sample->has_mag = (mag[0] & ST1_READY) != 0;
    sample->has_mag_missed = (mag[0] & ST1_OVERRUN) != 0;
    sample->has_mag_overflow = (mag[7] & ST2_OVERFLOW) != 0;
}

bool mpu9250_is_frozen(mpu9250_watch_t *watch, const mpu9250_sample_t *sample)
{
    bool is_equal = true;
    for (size_t i = 0; i < 3; i++) {
        is_equal = is_equal && watch->last[i] == sample->accel[i] && watch->last[3 + i] == sample->gyro[i];
        watch->last[i] = sample->accel[i];
        watch->last[3 + i] = sample->gyro[i];
    }
    watch->repeats = is_equal && watch->repeats < MPU9250_FROZEN ? watch->repeats + 1 : is_equal ? MPU9250_FROZEN : 0;
    return watch->repeats >= MPU9250_FROZEN;
}

/* ---- self-test, AN-MPU-9250A-03 ---- */

enum {
    TEST_SAMPLES = 200,
    TEST_SETTLE_US = 20000,
    TEST_BASE = 2620,                 /* factory response for code 1, counts at 2 g and 250 deg/s */
    TEST_GYRO_LEAST = 60 * 32768 / 250, /* without a factory code: 60 deg/s */
    TEST_ACCEL_LEAST = 225 * 16384 / 1000, /* 225 and 675 mg */
    TEST_ACCEL_MOST = 675 * 16384 / 1000
};

/* Means of accel x y z, gyro x y z. */
static int average(const mpu9250_bus_t *bus, int32_t means[6])
{
    int32_t sums[6] = {0};
    for (int n = 0; n < TEST_SAMPLES; n++) {
        uint8_t bytes[14];
        bus->wait_us(bus->context, 1000);
        const int result = read_registers(bus, REG_INT_STATUS + 1, bytes, sizeof bytes);
        if (result != MPU9250_OK)
            return result;
        for (size_t i = 0; i < 3; i++) {
            sums[i] += big_endian(bytes + 2 * i);
            sums[3 + i] += big_endian(bytes + 8 + 2 * i);
        }
    }
    for (size_t i = 0; i < 6; i++)
        means[i] = sums[i] / TEST_SAMPLES;
    return MPU9250_OK;
}

/* 2620 * 1.01^(code - 1), rounded down at every step of 1/1024 count. */
static int32_t factory_response(uint8_t code)
{
    uint64_t response = (uint64_t)TEST_BASE << 10;
    for (int i = 1; i < code; i++)
        response = response * 101 / 100;
    return (int32_t)(response >> 10);
}

static bool has_axis_passed(size_t axis, int32_t response, uint8_t code)
{
    const bool is_gyro = axis >= 3;
    const int32_t size = response < 0 ? -response : response;
    if (code == 0)
        return is_gyro ? size >= TEST_GYRO_LEAST : size >= TEST_ACCEL_LEAST && size <= TEST_ACCEL_MOST;
    const int32_t factory = factory_response(code);
    return is_gyro ? 2 * response > factory : 2 * response > factory && 2 * response < 3 * factory;
}

int mpu9250_self_test(const mpu9250_bus_t *bus, mpu9250_self_test_t *test)
{
    static const write_t quiet[] = {{REG_SMPLRT_DIV, 0}, {REG_CONFIG, 2}, {REG_ACCEL_CONFIG_2, 2}, {REG_GYRO_CONFIG, 0}, {REG_ACCEL_CONFIG, 0}};
    static const write_t driven[] = {{REG_GYRO_CONFIG, SELF_TEST_ON}, {REG_ACCEL_CONFIG, SELF_TEST_ON}};
    int32_t rest[6] = {0}, pushed[6] = {0};
    uint8_t who_am_i = 0;
    int result = reset(bus, &who_am_i);
    if (result == MPU9250_OK)
        result = write_all(bus, quiet, sizeof quiet / sizeof *quiet);
    bus->wait_us(bus->context, TEST_SETTLE_US);
    if (result == MPU9250_OK)
        result = average(bus, rest);
    if (result == MPU9250_OK)
        result = write_all(bus, driven, sizeof driven / sizeof *driven);
    bus->wait_us(bus->context, TEST_SETTLE_US);
    if (result == MPU9250_OK)
        result = average(bus, pushed);
    if (result == MPU9250_OK)
        result = read_registers(bus, REG_SELF_TEST_ACCEL, test->factory_code, 3);
    if (result == MPU9250_OK)
        result = read_registers(bus, REG_SELF_TEST_GYRO, test->factory_code + 3, 3);
    test->passed = 0;
    for (size_t i = 0; i < 6 && result == MPU9250_OK; i++) {
        const int32_t response = pushed[i] - rest[i];
        test->response[i] = (int16_t)(response > 32767 ? 32767 : response < -32768 ? -32768 : response);
        if (has_axis_passed(i, response, test->factory_code[i]))
            test->passed |= (uint8_t)(1 << i);
    }
    return result;
}
