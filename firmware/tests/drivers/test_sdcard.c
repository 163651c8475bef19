/* The card's driver against the card's model. */
#include <string.h>

#include "check.h"
#include "sdcard.h"
#include "sim_board.h"

enum { SECTORS = 1 << 15 };

static sim_t sim;
static sd_card_t card;

static void begin(sd_model_kind_t kind)
{
    sim_init(&sim, kind, SECTORS);
}

static void end(void)
{
    CHECK_EQUAL(sim.card.protocol_errors, 0);
    sim_free(&sim);
}

static int open_card(void)
{
    return sd_open(&card, &sim.board.card);
}

static void fill(uint8_t *block, uint32_t number)
{
    for (uint32_t i = 0; i < SD_SECTOR; i++)
        block[i] = (uint8_t)(number * 31 + i * 7 + (i >> 8));
}

static void check_sector(uint32_t sector, uint32_t number)
{
    uint8_t wanted[SD_SECTOR];
    fill(wanted, number);
    CHECK(memcmp(sd_model_view(&sim.card, sector), wanted, SD_SECTOR) == 0);
}

/* Values from the specification's own examples, 4.5 and 7.2.2. */
static void test_sums_are_those_of_the_specification(void)
{
    static const uint8_t go_idle[] = {0x40, 0, 0, 0, 0}, if_cond[] = {0x48, 0, 0, 1, 0xAA};
    uint8_t ones[SD_SECTOR];
    memset(ones, 0xFF, sizeof ones);
    CHECK_EQUAL(sd_crc7(go_idle, 5), 0x95);
    CHECK_EQUAL(sd_crc7(if_cond, 5), 0x87);
    CHECK_EQUAL(sd_crc16(ones, sizeof ones), 0x7FA1);
}

static void test_every_kind_of_card_starts(void)
{
    static const sd_model_kind_t kinds[] = {SD_MODEL_V1, SD_MODEL_V2, SD_MODEL_HC};
    for (int i = 0; i < 3; i++) {
        uint8_t out[2 * SD_SECTOR], in[2 * SD_SECTOR];
        begin(kinds[i]);
        CHECK_EQUAL(open_card(), SD_OK);
        CHECK_EQUAL(card.sectors, SECTORS);
        CHECK_EQUAL(card.has_sector_addresses, kinds[i] == SD_MODEL_HC);
        CHECK(sim.card.has_crc);
        fill(out, 1);
        fill(out + SD_SECTOR, 2);
        CHECK_EQUAL(sd_write(&card, 1000, out, 2), SD_OK);
        CHECK_EQUAL(sd_read(&card, 1000, in, 2), SD_OK);
        CHECK(memcmp(in, out, sizeof in) == 0);
        check_sector(1001, 2);
        end();
    }
}

static void test_missing_card_is_told_within_200_ms(void)
{
    begin(SD_MODEL_HC);
    sim.card.is_absent = true;
    const uint64_t since_us = sim.now_us;
    CHECK_EQUAL(open_card(), SD_NO_ANSWER);
    CHECK(sim.now_us - since_us < 200000);
    end();
}

static void test_card_that_never_starts_is_given_up_after_a_second(void)
{
    begin(SD_MODEL_HC);
    sim.card.is_mute = true;
    const uint64_t since_us = sim.now_us;
    CHECK_EQUAL(open_card(), SD_TIMEOUT);
    CHECK(sim.now_us - since_us < 1200000);
    end();
}

static void test_card_without_sums_is_used_without(void)
{
    uint8_t data[SD_SECTOR];
    begin(SD_MODEL_HC);
    sim.card.is_crc_unknown = true;
    CHECK_EQUAL(open_card(), SD_OK);
    fill(data, 5);
    CHECK_EQUAL(sd_write(&card, 9, data, 1), SD_OK);
    check_sector(9, 5);
    end();
}

static void test_sectors_beyond_the_card_are_refused(void)
{
    uint8_t data[SD_SECTOR];
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(sd_read(&card, SECTORS, data, 1), SD_MISUSE);
    CHECK_EQUAL(sd_write(&card, SECTORS - 1, data, 2), SD_MISUSE);
    CHECK_EQUAL(sd_stream_put(&card, data), SD_MISUSE);
    CHECK_EQUAL(sim.card.writes, 0);
    end();
}

static void test_flipped_bits_are_noticed_in_both_directions(void)
{
    uint8_t data[SD_SECTOR];
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    fill(data, 3);
    sim.card.mishear_at = 0;
    CHECK_EQUAL(sd_write(&card, 5, data, 1), SD_OK);
    CHECK_EQUAL(card.retries, 1);
    check_sector(5, 3);
    sim.card.misread_at = sim.card.reads;
    memset(data, 0, sizeof data);
    CHECK_EQUAL(sd_read(&card, 5, data, 1), SD_OK);
    CHECK_EQUAL(card.retries, 2);
    CHECK(memcmp(data, sd_model_view(&sim.card, 5), sizeof data) == 0);
    end();
}

/* Write `count` blocks from `sector` on; 0 or the error. No poll may wait, but for a card that answers wrongly. */
static int stream(uint32_t sector, uint32_t count)
{
    static uint8_t block[SD_SECTOR];
    int result = sd_stream_open(&card, sector);
    for (uint32_t i = 0; i < count && result >= 0; i++) {
        fill(block, i);
        result = sd_stream_put(&card, block);
        while (result == 0) {
            const uint64_t since_us = sim.now_us;
            const bool is_well = card.tries == 0;
            result = sd_stream_poll(&card);
            CHECK(sim.now_us - since_us < (is_well && card.tries == 0 ? 50u << card.speed : 2000u));
            if (result == 0)
                sim.board.sleep(&sim);
        }
    }
    return result < 0 ? result : sd_stream_close(&card);
}

/* So many sectors written and read, and blocks streamed, over wires that flip a bit of every so many bytes. */
static void use_over_wires(uint32_t flip_every, uint32_t flip_above_hz)
{
    uint8_t out[SD_SECTOR], in[SD_SECTOR];
    begin(SD_MODEL_HC);
    sim.card.flip_every = flip_every;
    sim.card.flip_above_hz = flip_above_hz;
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(card.sectors, SECTORS);
    for (uint32_t i = 0; i < 300; i++) {
        fill(out, i);
        CHECK_EQUAL(sd_write(&card, i, out, 1), SD_OK);
        CHECK_EQUAL(sd_read(&card, i, in, 1), SD_OK);
        CHECK(memcmp(in, out, sizeof in) == 0);
    }
    CHECK_EQUAL(stream(1000, 2000), SD_OK);
    for (uint32_t i = 0; i < 2000; i++)
        check_sector(1000 + i, i);
}

static void test_wires_that_flip_a_bit_in_20000_bytes_lose_nothing(void)
{
    use_over_wires(20000, 0);
    CHECK(sim.card.flips > 30);
    CHECK_EQUAL(card.speed, SD_FAST);
    sim_free(&sim);
}

static void test_card_is_slowed_down_to_what_its_wires_carry(void)
{
    use_over_wires(1500, 10000000);
    CHECK_EQUAL(card.speed, SD_HALF);
    CHECK_EQUAL(sd_open_again(&card), SD_OK);
    CHECK_EQUAL(sim.card_hz, 9000000);
    sim_free(&sim);
    use_over_wires(1500, 5000000);
    CHECK_EQUAL(card.speed, SD_QUARTER);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(sim.card_hz, 18000000);
    sim_free(&sim);
}

static void test_card_that_answers_nothing_right_is_given_up(void)
{
    uint8_t data[SD_SECTOR] = {0};
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    sim.card.flip_every = 20;
    CHECK(sd_write(&card, 5, data, 1) < 0);
    CHECK_EQUAL(card.error != SD_OK, true);
    CHECK(stream(100, 1) < 0);
    sim_free(&sim);
}

/* A card may hold back what it was sent until the stop: at most a second of it is at stake. */
static void test_stream_is_stopped_and_opened_again_each_second(void)
{
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    const uint32_t commands = sim.card.commands;
    sim.card.busy_us = 25000;
    CHECK_EQUAL(stream(100, 200), SD_OK);
    const uint32_t stops = (sim.card.commands - commands - 2) / 2; /* CMD13 and CMD25 each, one of both besides */
    CHECK(stops >= 4 && stops <= 6);
    for (uint32_t i = 0; i < 200; i++)
        check_sector(100 + i, i);
    CHECK_EQUAL(sim.card.writes, 200);
    end();
}

static void test_halt_sends_the_stop_token_and_no_command(void)
{
    static uint8_t block[SD_SECTOR];
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(sd_stream_open(&card, 100), SD_OK);
    CHECK_EQUAL(sd_stream_put(&card, block), SD_OK);
    const uint32_t commands = sim.card.commands;
    CHECK_EQUAL(sd_stream_halt(&card), SD_OK);
    CHECK_EQUAL(sim.card.commands, commands);
    CHECK_EQUAL(sim.card.writes, 1);
    CHECK(!sim.card.is_waiting_for_token);
    end();
}

static void test_stream_writes_block_after_block(void)
{
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(stream(700, 200), SD_OK);
    for (uint32_t i = 0; i < 200; i++)
        check_sector(700 + i, i);
    CHECK_EQUAL(sim.card.writes, 200);
    CHECK_EQUAL(card.state, SD_IDLE);
    end();
}

static void test_stream_rides_out_a_card_busy_for_900_ms(void)
{
    begin(SD_MODEL_V2);
    CHECK_EQUAL(open_card(), SD_OK);
    sim.card.stall_every = 10;
    sim.card.stall_us = 900000;
    CHECK_EQUAL(stream(100, 25), SD_OK);
    CHECK(card.longest_busy_us > 850000 && card.longest_busy_us < 950000);
    check_sector(124, 24);
    end();
}

static void test_stream_gives_up_a_card_busy_for_ever_and_starts_it_again(void)
{
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    sim.card.hang_at = 3;
    const uint64_t since_us = sim.now_us;
    CHECK_EQUAL(stream(100, 10), SD_TIMEOUT);
    CHECK(sim.now_us - since_us > 1000000 && sim.now_us - since_us < 1300000);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(stream(104, 10), SD_OK);
    end();
}

static void test_stream_sends_a_refused_block_five_times_and_says_why_it_gave_up(void)
{
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    sim.card.refuse_at = 4;
    sim.card.refuse_times = 4;
    CHECK_EQUAL(stream(100, 10), SD_OK);
    CHECK_EQUAL(card.retries, 4);
    sim.card.mishear_at = sim.card.writes + 2;
    CHECK_EQUAL(stream(100, 10), SD_OK);
    CHECK_EQUAL(card.retries, 5);
    check_sector(109, 9);
    sim.card.refuse_at = sim.card.writes + 4;
    sim.card.refuse_times = 5;
    CHECK_EQUAL(stream(100, 10), SD_WRITE_FAILED);
    CHECK_EQUAL(card.error, SD_WRITE_FAILED);
    CHECK_EQUAL(card.state, SD_CLOSED);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(stream(100, 10), SD_OK);
    end();
}

static void test_stream_ends_when_the_card_is_pulled_out(void)
{
    static uint8_t block[SD_SECTOR];
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(sd_stream_open(&card, 100), SD_OK);
    CHECK_EQUAL(sd_stream_put(&card, block), SD_OK);
    sim.card.is_absent = true;
    int result = 0;
    while (result == 0) {
        sim.board.sleep(&sim);
        result = sd_stream_poll(&card);
    }
    CHECK_EQUAL(result, SD_NO_ANSWER);
    end();
}

/* The controller alone is reset after any number of bytes of a block: the card still wants the rest. */
static void test_card_starts_again_after_a_reset_amid_a_block(void)
{
    static const uint8_t token[2] = {0xFF, 0xFC};
    static uint8_t block[SD_SECTOR + 2];
    for (size_t sent = 0; sent <= sizeof block; sent += sent < 8 || sent > 506 ? 1 : 31) {
        begin(SD_MODEL_HC);
        CHECK_EQUAL(open_card(), SD_OK);
        CHECK_EQUAL(sd_stream_open(&card, 100), SD_OK);
        const sd_bus_t *bus = &sim.board.card;
        CHECK_EQUAL(bus->exchange(bus->context, token, NULL, sizeof token), 0);
        CHECK_EQUAL(bus->exchange(bus->context, block, NULL, sent), 0);
        sim_reset(&sim);
        CHECK_EQUAL(open_card(), SD_OK);
        CHECK_EQUAL(stream(200, 3), SD_OK);
        check_sector(202, 2);
        end();
    }
}

static void test_check_notices_that_the_card_has_gone(void)
{
    begin(SD_MODEL_HC);
    CHECK_EQUAL(open_card(), SD_OK);
    CHECK_EQUAL(sd_check(&card), SD_OK);
    sim.card.is_absent = true;
    CHECK_EQUAL(sd_check(&card), SD_NO_ANSWER);
    end();
}

#define TEST(name) {#name, test_##name}

int main(int argc, char **argv)
{
    static const test_t tests[] = {
        TEST(sums_are_those_of_the_specification),
        TEST(every_kind_of_card_starts),
        TEST(missing_card_is_told_within_200_ms),
        TEST(card_that_never_starts_is_given_up_after_a_second),
        TEST(card_without_sums_is_used_without),
        TEST(sectors_beyond_the_card_are_refused),
        TEST(flipped_bits_are_noticed_in_both_directions),
        TEST(stream_writes_block_after_block),
        TEST(stream_rides_out_a_card_busy_for_900_ms),
        TEST(stream_gives_up_a_card_busy_for_ever_and_starts_it_again),
        TEST(stream_sends_a_refused_block_five_times_and_says_why_it_gave_up),
        TEST(wires_that_flip_a_bit_in_20000_bytes_lose_nothing),
        TEST(card_is_slowed_down_to_what_its_wires_carry),
        TEST(card_that_answers_nothing_right_is_given_up),
        TEST(stream_is_stopped_and_opened_again_each_second),
        TEST(halt_sends_the_stop_token_and_no_command),
        TEST(stream_ends_when_the_card_is_pulled_out),
        TEST(card_starts_again_after_a_reset_amid_a_block),
        TEST(check_notices_that_the_card_has_gone),
    };
    return run_tests(tests, sizeof tests / sizeof *tests, argc, argv);
}
