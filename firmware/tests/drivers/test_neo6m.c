/* The receiver's driver against the model of the receiver. */
#include <string.h>

#include "check.h"
#include "neo6m.h"
#include "sim_board.h"

static sim_t sim;
static neo6m_t gps;
static struct {
    uint32_t sentences, intact, velocities, lost, configured, silent, baud, refused;
    uint64_t last_us, worst_error_us;
    char last[RECORD_GPS_LONGEST + 1];
} seen;

static void on_sentence(void *context, uint64_t time_us, const uint8_t *sentence, size_t length)
{
    (void)context;
    if (sentence[0] == UBX_SYNC_0) {
        CHECK_EQUAL(length, UBX_OVERHEAD + UBX_VELNED_BYTES);
        CHECK(memcmp(sentence + 10, "$$$$$$$$", 8) == 0);
        CHECK(time_us > seen.last_us); /* the model says it last */
        seen.velocities++;
        return;
    }
    seen.sentences++;
    seen.intact += nmea_is_intact(sentence, length);
    seen.last_us = time_us;
    memcpy(seen.last, sentence, length);
    seen.last[length] = '\0';
}

static void on_lost(void *context, uint64_t time_us, uint32_t sentences)
{
    (void)context;
    (void)time_us;
    seen.lost += sentences;
}

static void on_configured(void *context, uint32_t baud, uint32_t refused)
{
    (void)context;
    seen.configured++;
    seen.baud = baud;
    seen.refused = refused;
}

static void on_silent(void *context, uint32_t silent_ms)
{
    (void)context;
    CHECK(silent_ms >= 3000);
    seen.silent++;
}

static const neo6m_events_t events = {
    .on_sentence = on_sentence, .on_lost = on_lost, .on_configured = on_configured, .on_silent = on_silent};

static void begin(void)
{
    sim_init(&sim, SD_MODEL_HC, 2048);
    memset(&seen, 0, sizeof seen);
}

static void start_at(uint32_t baud, uint16_t period_ms)
{
    const neo6m_settings_t settings = {.baud = baud, .period_ms = period_ms};
    neo6m_init(&gps, &sim.board.gps, &events, &settings, sim.now_us);
}

static void start(uint32_t baud)
{
    start_at(baud, 200);
}

static void run(uint64_t duration_us)
{
    const uint64_t end_us = sim.now_us + duration_us;
    while (sim.now_us < end_us) {
        neo6m_step(&gps, sim.now_us);
        sim_advance(&sim, 5000);
    }
}

static void check_settings(uint32_t baud)
{
    static const bool wanted[8] = {[0] = true, [4] = true, [7] = true}; /* GGA, RMC, GST */
    CHECK_EQUAL(gps.state, NEO6M_RUNNING);
    CHECK_EQUAL(sim.gps.baud, baud);
    CHECK_EQUAL(sim.gps.period_ms, 200);
    CHECK_EQUAL(sim.gps.dynamic_model, 4);
    CHECK_EQUAL(sim.gps.power_mode, 0);
    CHECK(memcmp(sim.gps.messages, wanted, sizeof wanted) == 0);
    CHECK(sim.gps.has_velocity);
}

static void test_receiver_is_configured_from_power_on_within_2_s(void)
{
    begin();
    start(57600);
    run(2000000);
    check_settings(57600);
    CHECK_EQUAL(seen.configured, 1);
    CHECK_EQUAL(seen.refused, 0);
    CHECK_EQUAL(seen.baud, 57600);
    const uint32_t before = seen.sentences, velocities = seen.velocities;
    run(4000000);
    CHECK(seen.sentences - before >= 58 && seen.sentences - before <= 62);
    CHECK(seen.velocities - velocities >= 19 && seen.velocities - velocities <= 21);
    CHECK_EQUAL(seen.sentences, seen.intact);
    CHECK_EQUAL(seen.lost, 0);
    sim_free(&sim);
}

static void test_receiver_is_found_at_every_rate_it_may_have(void)
{
    static const uint32_t rates[] = {9600, 57600, 38400, 115200, 19200, 4800};
    for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
        begin();
        sim.gps.baud = rates[i];
        start(115200);
        run(30000000);
        check_settings(115200);
        sim_free(&sim);
    }
}

/* An M10 knows CFG-VALSET alone; what it does not know it refuses, or passes over. */
static void test_receiver_of_today_is_configured_too(void)
{
    static const uint32_t rates[] = {9600, 38400, 57600};
    for (size_t i = 0; i < 6; i++) {
        begin();
        sim.gps.is_modern = true;
        sim.gps.is_mute_to_old = i % 2;
        sim.gps.shortest_ms = 50;
        sim.gps.baud = rates[i / 2];
        start_at(57600, 100);
        run(9000000);
        CHECK_EQUAL(gps.state, NEO6M_RUNNING);
        CHECK(gps.is_modern && seen.refused == 0 && seen.configured == 1);
        CHECK_EQUAL(sim.gps.period_ms, 100);
        sim.gps.period_ms = 200; /* the rest is as always */
        check_settings(57600);
        sim_free(&sim);
    }
}

static void test_ten_fixes_a_second_come_whole_or_five_where_they_are_refused(void)
{
    for (int is_fast = 0; is_fast < 2; is_fast++) {
        begin();
        sim.gps.shortest_ms = is_fast ? 100 : 200;
        start_at(57600, 100);
        run(3000000);
        CHECK_EQUAL(seen.refused, 0);
        CHECK_EQUAL(gps.settings.period_ms, is_fast ? 100 : 200);
        CHECK_EQUAL(sim.gps.period_ms, gps.settings.period_ms);
        const uint32_t before = seen.intact, velocities = seen.velocities;
        run(4000000);
        const uint32_t epochs = is_fast ? 40 : 20;
        CHECK(seen.velocities - velocities >= epochs - 1 && seen.velocities - velocities <= epochs + 1);
        CHECK(seen.intact - before >= 3 * epochs - 3);
        CHECK_EQUAL(seen.lost, 0);
        sim_free(&sim);
    }
}

/* A wire is missing: it talks, but nothing reaches it. */
static void test_receiver_that_does_not_hear_is_logged_as_it_is(void)
{
    begin();
    sim.gps.is_deaf = true;
    start(57600);
    run(10000000);
    CHECK_EQUAL(gps.state, NEO6M_RUNNING);
    CHECK_EQUAL(gps.baud, 9600);
    CHECK_EQUAL(seen.refused, (1u << NEO6M_SETTINGS) - 1);
    CHECK(seen.intact > 30);
    CHECK(neo6m_is_working(&gps, sim.now_us));
    sim_free(&sim);
}

static void test_refused_setting_is_told_and_the_rest_is_set(void)
{
    begin();
    sim.gps.refuse_class_id = 0x0624; /* the dynamic model */
    start(57600);
    run(4000000);
    CHECK_EQUAL(gps.state, NEO6M_RUNNING);
    CHECK_EQUAL(seen.refused, 1u << 2);
    CHECK_EQUAL(sim.gps.period_ms, 200);
    CHECK(sim.gps.messages[7] && !sim.gps.messages[3]);
    sim_free(&sim);
}

static void test_receiver_that_was_reset_alone_is_configured_again(void)
{
    begin();
    start(57600);
    run(3000000);
    neo_model_power_cycle(&sim.gps);
    run(8000000);
    check_settings(57600);
    CHECK_EQUAL(seen.silent, 1);
    CHECK_EQUAL(seen.configured, 2);
    sim_free(&sim);
}

/* Its wires let go for a moment, in the midst of its settings. */
static void test_receiver_that_missed_settings_gets_them_later(void)
{
    for (uint8_t setting = 1; setting < NEO6M_SETTINGS; setting++) {
        begin();
        start(57600);
        while (gps.state != NEO6M_CONFIGURING || gps.setting < setting)
            run(5000);
        sim.gps.is_absent = true;
        run(2500000);
        sim.gps.is_absent = false;
        run(16000000);
        check_settings(57600);
        CHECK_EQUAL(seen.refused, 0);
        sim_free(&sim);
    }
}

static void test_absent_receiver_is_looked_for_without_end_or_waiting(void)
{
    begin();
    sim.gps.is_absent = true;
    start(57600);
    for (int i = 0; i < 6000; i++) {
        const uint64_t before_us = sim.now_us;
        neo6m_step(&gps, sim.now_us);
        CHECK_EQUAL(sim.now_us, before_us);
        sim_advance(&sim, 5000);
    }
    CHECK(!neo6m_is_working(&gps, sim.now_us));
    CHECK_EQUAL(seen.sentences, 0);
    sim.gps.is_absent = false;
    neo_model_power_cycle(&sim.gps);
    run(25000000);
    check_settings(57600);
    sim_free(&sim);
}

/* Its supply comes back at any moment of the search: it has the rate of power-on then. */
static void test_receiver_whose_supply_comes_back_is_running_within_6_s(void)
{
    for (uint64_t away_us = 4000000; away_us < 36000000; away_us += 1700000) {
        begin();
        start(57600);
        run(3000000);
        sim.gps.is_absent = true;
        run(away_us);
        sim.gps.is_absent = false;
        neo_model_power_cycle(&sim.gps);
        run(6000000);
        check_settings(57600);
        sim_free(&sim);
    }
}

static void test_noise_between_sentences_costs_none(void)
{
    begin();
    sim.gps.chatter = 20;
    start(57600);
    run(3000000);
    const uint32_t before = seen.intact;
    run(4000000);
    CHECK(seen.intact - before >= 58);
    sim_free(&sim);
}

/* The epoch's first sentence begins when the model says so, to a byte time. */
static void test_sentence_has_the_time_of_its_first_byte(void)
{
    begin();
    start(57600);
    run(3000000);
    for (int i = 0; i < 20; i++) {
        const uint64_t epoch_us = sim.gps.next_epoch_us;
        while (sim.now_us < epoch_us + 100000)
            run(5000);
        /* GGA, RMC, GST: the last began after the two before, one byte time each */
        const uint64_t bytes = (uint64_t)(2 * strlen(seen.last));
        const uint64_t wanted_us = epoch_us + bytes * 173; /* 10 / 57600 s, rounded as the model does */
        CHECK(strncmp(seen.last, "$GPGST", 6) == 0);
        CHECK(seen.last_us + 200 > wanted_us && seen.last_us < wanted_us + 200); /* a byte takes 174 us */
    }
    sim_free(&sim);
}

#define TEST(name) {#name, test_##name}

int main(int argc, char **argv)
{
    static const test_t tests[] = {
        TEST(receiver_is_configured_from_power_on_within_2_s),
        TEST(receiver_is_found_at_every_rate_it_may_have),
        TEST(receiver_of_today_is_configured_too),
        TEST(ten_fixes_a_second_come_whole_or_five_where_they_are_refused),
        TEST(receiver_that_does_not_hear_is_logged_as_it_is),
        TEST(refused_setting_is_told_and_the_rest_is_set),
        TEST(receiver_that_was_reset_alone_is_configured_again),
        TEST(receiver_that_missed_settings_gets_them_later),
        TEST(absent_receiver_is_looked_for_without_end_or_waiting),
        TEST(receiver_whose_supply_comes_back_is_running_within_6_s),
        TEST(noise_between_sentences_costs_none),
        TEST(sentence_has_the_time_of_its_first_byte),
    };
    return run_tests(tests, sizeof tests / sizeof *tests, argc, argv);
}
