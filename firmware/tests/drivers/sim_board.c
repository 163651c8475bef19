#include "sim_board.h"

#include <string.h>

enum { START_HZ = 281250, IMU_SLOW_HZ = 562500, IMU_FAST_HZ = 9000000, TICK_US = 500 };

/* ---- interrupts ---- */

static void burst(sim_t *sim, uint64_t time_us)
{
    uint8_t out[MPU9250_BURST] = {MPU9250_BURST_COMMAND}, in[MPU9250_BURST];
    const board_events_t *events = sim->events;
    sim->imu.clock_hz = IMU_FAST_HZ;
    mpu_model_transfer(&sim->imu, out, in, sizeof in);
    sim->bursts++;
    events->on_burst(events->context, time_us, in);
}

/* What is due up to now, if nothing keeps it from happening. */
static void interrupt(sim_t *sim)
{
    if (sim->locks || sim->is_in_interrupt || !sim->events)
        return;
    sim->is_in_interrupt = true;
    mpu_model_step(&sim->imu);
    const bool has_edge = sim->is_int_wired && mpu_model_has_sample(&sim->imu);
    if (has_edge) {
        sim->edge_us = sim->now_us;
        burst(sim, sim->now_us);
    } else if (sim->now_us >= sim->next_tick_us && sim->now_us - sim->edge_us > 30000) {
        burst(sim, sim->now_us);
    }
    if (sim->now_us >= sim->next_tick_us)
        sim->next_tick_us = sim->now_us + TICK_US;
    sim->is_in_interrupt = false;
}

static void send_serial(sim_t *sim)
{
    while (sim->next_serial_us <= sim->now_us) {
        const int byte = serial_take(&sim->serial);
        if (byte < 0) {
            sim->next_serial_us = sim->now_us;
            return;
        }
        if (sim->output_length < SIM_OUTPUT)
            sim->output[sim->output_length++] = (uint8_t)byte;
        sim->next_serial_us += 10000000u / sim->serial_baud;
    }
}

void sim_advance(sim_t *sim, uint64_t duration_us)
{
    const uint64_t end_us = sim->now_us + duration_us;
    while (sim->now_us < end_us) {
        uint64_t next_us = end_us;
        if (sim->events && sim->next_tick_us > sim->now_us && sim->next_tick_us < next_us)
            next_us = sim->next_tick_us;
        if (sim->is_int_wired && sim->imu.next_sample_us > sim->now_us && sim->imu.next_sample_us < next_us)
            next_us = sim->imu.next_sample_us;
        sim->now_us = next_us;
        interrupt(sim);
    }
    send_serial(sim);
}

/* ---- card ---- */

static void card_select(void *context, bool is_selected)
{
    sim_t *sim = context;
    sd_model_select(&sim->card, is_selected);
}

static void card_set_speed(void *context, sd_speed_t speed)
{
    static const uint32_t hz[] = {[SD_FAST] = 18000000, [SD_HALF] = 9000000, [SD_QUARTER] = 4500000, [SD_START_UP] = START_HZ};
    sim_t *sim = context;
    sim->card_hz = hz[speed];
}

static uint64_t card_time_us(const sim_t *sim, size_t bytes)
{
    return bytes * 8 * 1000000 / sim->card_hz;
}

static void clock_bytes(sim_t *sim, const uint8_t *out, uint8_t *in, size_t length)
{
    sim->card.clock_hz = sim->card_hz;
    for (size_t i = 0; i < length; i++) {
        const uint8_t byte = sd_model_exchange(&sim->card, out ? out[i] : 0xFF);
        if (in)
            in[i] = byte;
    }
}

static int card_exchange(void *context, const uint8_t *out, uint8_t *in, size_t length)
{
    sim_t *sim = context;
    clock_bytes(sim, out, in, length);
    sim_advance(sim, card_time_us(sim, length) + 1);
    return 0;
}

static int card_start(void *context, const uint8_t *out, uint8_t *in, size_t length)
{
    sim_t *sim = context;
    sim->transfer_out = out;
    sim->transfer_in = in;
    sim->transfer_length = length;
    sim->is_transfer_running = true;
    sim->transfer_done_us = sim->now_us + card_time_us(sim, length);
    return 0;
}

static int card_is_done(void *context)
{
    sim_t *sim = context;
    if (sim->is_transfer_running && sim->now_us >= sim->transfer_done_us) {
        clock_bytes(sim, sim->transfer_out, sim->transfer_in, sim->transfer_length);
        sim->is_transfer_running = false;
    }
    return !sim->is_transfer_running;
}

static uint64_t now_us(void *context)
{
    const sim_t *sim = context;
    return sim->now_us;
}

static void sleep(void *context)
{
    sim_t *sim = context;
    sim_advance(sim, sim->sleep_us);
}

static void wait(void *context)
{
    sim_t *sim = context;
    sleep(sim);
    if (sim->idle)
        sim->idle(sim->idle_context);
}

/* ---- IMU ---- */

static int imu_transfer(void *context, const uint8_t *out, uint8_t *in, size_t length)
{
    sim_t *sim = context;
    uint8_t received[64];
    sim->imu.clock_hz = IMU_SLOW_HZ;
    mpu_model_transfer(&sim->imu, out, received, length);
    memcpy(in, received, length);
    sim_advance(sim, length * 8 * 1000000 / IMU_SLOW_HZ);
    return 0;
}

static void imu_wait_us(void *context, uint32_t duration_us)
{
    sim_t *sim = context;
    const uint64_t end_us = sim->now_us + duration_us;
    while (sim->now_us < end_us)
        wait(sim);
}

static void start_sampling(void *context, const board_events_t *events)
{
    sim_t *sim = context;
    sim->events = events;
    sim->next_tick_us = sim->now_us + TICK_US;
    sim->edge_us = 0;
}

static void stop_sampling(void *context)
{
    sim_t *sim = context;
    sim->events = NULL;
}

static bool is_sampling_on_pin(void *context)
{
    const sim_t *sim = context;
    return sim->edge_us && sim->now_us - sim->edge_us < 30000;
}

/* ---- receiver ---- */

static void gps_set_baud(void *context, uint32_t baud)
{
    sim_t *sim = context;
    uint8_t byte;
    uint64_t began_us;
    while (neo_model_next(&sim->gps, sim->line_baud, &byte, &began_us)) {
    }
    sim->line_baud = baud;
}

static int gps_write(void *context, const uint8_t *data, size_t length)
{
    sim_t *sim = context;
    if (sim->now_us < sim->sent_until_us)
        return -1;
    sim->sent_until_us = sim->now_us + length * 10000000u / sim->line_baud;
    neo_model_receive(&sim->gps, data, length, sim->line_baud);
    return 0;
}

static size_t gps_read(void *context, uint8_t *data, size_t size, uint64_t *first_us, uint32_t *lost)
{
    sim_t *sim = context;
    uint64_t began_us;
    size_t count = 0;
    *lost = 0;
    while (count < size && neo_model_next(&sim->gps, sim->line_baud, &data[count], &began_us))
        if (count++ == 0)
            *first_us = began_us;
    return count;
}

/* ---- the rest ---- */

static void set_led(void *context, bool is_on)
{
    sim_t *sim = context;
    sim->led_changes += sim->is_led_on != is_on;
    sim->is_led_on = is_on;
}

static bool is_pressed(void *context)
{
    const sim_t *sim = context;
    return sim->is_pressed;
}

static void lock(void *context)
{
    sim_t *sim = context;
    sim->locks++;
}

static void unlock(void *context)
{
    sim_t *sim = context;
    sim->locks--;
}

static bool is_supply_low(void *context)
{
    const sim_t *sim = context;
    return sim->is_supply_low;
}

static void set_serial_baud(void *context, uint32_t baud)
{
    sim_t *sim = context;
    sim->serial_baud = baud;
}

static void feed_watchdog(void *context)
{
    sim_t *sim = context;
    if (sim->now_us - sim->fed_us > sim->longest_unfed_us)
        sim->longest_unfed_us = sim->now_us - sim->fed_us;
    sim->fed_us = sim->now_us;
}

static void set_idle(void *context, void (*idle)(void *), void *idle_context)
{
    sim_t *sim = context;
    sim->idle = idle;
    sim->idle_context = idle_context;
}

static void restart(void *context)
{
    (void)context;
}

static void set_mark(void *context, uint16_t mark)
{
    sim_t *sim = context;
    sim->mark = mark;
}

static uint32_t stack_free(void *context)
{
    (void)context;
    return 0;
}

static void kick(void *context)
{
    (void)context;
}

void sim_reset(sim_t *sim)
{
    sim->events = NULL;
    sim->idle = NULL;
    sim->locks = 0;
    sim->is_transfer_running = sim->is_in_interrupt = false;
    memset(&sim->serial, 0, sizeof sim->serial);
    sim->serial.kick = kick;
    sim->serial_baud = 115200;
    sim->fed_us = sim->now_us;
    sim->line_baud = 9600;
    sim->sent_until_us = 0;
    sim->card_hz = START_HZ;
    sim->next_tick_us = sim->next_serial_us = sim->now_us;
    sim->edge_us = 0;
    sd_model_host_restarts(&sim->card);
}

void sim_power_cycle(sim_t *sim)
{
    sim_reset(sim);
    sd_model_power_cycle(&sim->card);
    const bool is_deaf = sim->gps.is_deaf;
    neo_model_power_cycle(&sim->gps);
    sim->gps.is_deaf = is_deaf;
    const mpu_model_t before = sim->imu;
    mpu_model_init(&sim->imu, &sim->now_us);
    sim->imu.sample_number = before.sample_number;
}

void sim_init(sim_t *sim, sd_model_kind_t kind, uint32_t sectors)
{
    memset(sim, 0, sizeof *sim);
    sim->now_us = 1000;
    sd_model_init(&sim->card, kind, sectors, &sim->now_us);
    mpu_model_init(&sim->imu, &sim->now_us);
    neo_model_init(&sim->gps, &sim->now_us);
    sim->is_int_wired = true;
    sim->sleep_us = 250;
    sim_reset(sim);
    sim->board = (board_t){
        .context = sim,
        .card = {.context = sim,
                 .select = card_select,
                 .set_speed = card_set_speed,
                 .exchange = card_exchange,
                 .start = card_start,
                 .is_done = card_is_done,
                 .now_us = now_us,
                 .wait = wait},
        .imu = {.context = sim, .transfer = imu_transfer, .wait_us = imu_wait_us},
        .gps = {.context = sim, .set_baud = gps_set_baud, .write = gps_write, .read = gps_read},
        .panel = {.context = sim, .set_led = set_led, .is_pressed = is_pressed},
        .serial = &sim->serial,
        .now_us = now_us,
        .set_idle = set_idle,
        .start_sampling = start_sampling,
        .stop_sampling = stop_sampling,
        .is_sampling_on_pin = is_sampling_on_pin,
        .lock = lock,
        .unlock = unlock,
        .is_supply_low = is_supply_low,
        .set_serial_baud = set_serial_baud,
        .feed_watchdog = feed_watchdog,
        .sleep = sleep,
        .restart = restart,
        .set_mark = set_mark,
        .stack_free = stack_free,
        .boot_number = 1,
        .device = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12},
    };
}

void sim_free(sim_t *sim)
{
    sd_model_free(&sim->card);
}
