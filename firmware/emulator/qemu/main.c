/* The logger's way with a card, on a card that others wrote: open it, put right what the last run left, read CONFIG.TXT,
 * make a recording that is ended and one that is not.
 *
 * Samples tell their number as in emulator/evidence.py. Prints "name value" lines; exit code 1 if anything failed. */
#include "board.h"

#include <stdbool.h>

#include "log_writer.h"
#include "storage.h"

enum { RING_BLOCKS = 28, ENDED_SAMPLES = 60000, OPEN_SAMPLES = 20000, SAMPLE_US = 1000, LOW_BITS = 14, SETUP_EVERY = 5000 };

static storage_t storage;
static log_writer_t writer;
static ring_t ring;
static uint8_t blocks[RING_BLOCKS][BLOCK_BYTES];

static bool check(const char *what, int result)
{
    if (result >= 0)
        return true;
    board_print(what);
    board_print(" failed ");
    board_print_number((uint32_t)-result);
    board_print(" card error ");
    board_print_number((uint32_t)-storage.card_error);
    board_print("\n");
    return false;
}

static void say(const char *name, uint32_t value)
{
    board_print(name);
    board_print(" ");
    board_print_number(value);
    board_print("\n");
}

static int16_t stir(uint32_t number, uint32_t column)
{
    uint64_t x = number * 0x9E3779B97F4A7C15u + column;
    x = (x ^ x >> 29) * 0xBF58476D1CE4E5B9u;
    return (int16_t)(uint16_t)(x >> 48);
}

static void append(uint32_t number)
{
    const uint64_t time_us = (uint64_t)(number + 1) * SAMPLE_US;
    const record_setup_t setup = {.imu_who_am_i = 0x71, .imu_period_us = SAMPLE_US, .accel_range_g = 16, .gyro_range_dps = 1000};
    record_imu_t imu = {.accel = {(int16_t)(number & ((1u << LOW_BITS) - 1)), (int16_t)(number >> LOW_BITS), stir(number, 0)}};
    for (uint32_t i = 0; i < 3; i++)
        imu.gyro[i] = stir(number, i + 1);
    if (number % SETUP_EVERY == 0)
        (void)log_writer_setup(&writer, time_us, &setup); /* a loss is counted, and would be seen */
    (void)log_writer_imu(&writer, time_us, &imu);
}

/* Move blocks until no more than `left` wait. */
static bool drain(uint32_t left)
{
    while (log_writer_count(&writer) > left || (left == 0 && !storage_is_drained(&storage, &writer)))
        if (!check("step", storage_step(&storage, &writer)))
            return false;
    return true;
}

static bool record(uint32_t samples, bool is_ended)
{
    const uint32_t session = 0x5EED0000u + storage.spare.number;
    ring_init(&ring, blocks, RING_BLOCKS);
    log_writer_start(&writer, &ring, session, 0);
    if (!check("begin", storage_begin(&storage, session, false)))
        return false;
    for (uint32_t number = 0; number < samples; number++) {
        append(number);
        if (log_writer_count(&writer) > RING_BLOCKS / 2 && !drain(1))
            return false;
    }
    if (is_ended)
        (void)log_writer_stop(&writer, (uint64_t)samples * SAMPLE_US, STOP_BUTTON, 0); /* there is room */
    say("lost", writer.imu_lost);
    return drain(0) && (!is_ended || check("end", storage_end(&storage)));
}

int main(void)
{
    size_t length = 0;
    if (!check("open", storage_open(&storage, board_init())))
        return 1;
    say("sectors", storage.card.sectors);
    say("crc", storage.card.has_crc);
    say("recovered", storage.recovered);
    if (!check("read", storage_read_file(&storage, "CONFIG.TXT", (char *)blocks, sizeof blocks, &length)))
        return 1;
    say("config", (uint32_t)length);
    if (!check("check", storage_check(&storage)) || !record(ENDED_SAMPLES, true) || !record(OPEN_SAMPLES, false))
        return 1;
    board_print("done 1\n");
    return 0;
}
