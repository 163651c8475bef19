/* The whole logger on the board of models: what is on the card afterwards is read block by block and compared with what
 * the sensors measured.
 *
 *   test_app NAME    one test; without a name: what there is
 *   test_app save FILE   a recording
 *   test_app sweep   the longest stall that each size of the ring rides out */
#include <string.h>

#include "app.h"
#include "block.h"
#include "bytes.h"
#include "check.h"
#include "error.h"
#include "fat_image.h"
#include "frame.h"
#include "sim_board.h"

enum {
    CARD_SECTORS = 2048 + 32 + 2 * 513 + 65600 * 128, /* the smallest FAT32 of 64 KB clusters */
    WATCHDOG_US = 2600000,                            /* 4 s by a clock that may be half as fast again */
    MOST_FILES = 16,
    ROUNDS = 20
};

static sim_t sim;
static app_t app;

/* ---- life ---- */

static void begin(uint32_t free_clusters)
{
    sim_init(&sim, SD_MODEL_HC, CARD_SECTORS);
    fat_format(&sim.card, &(fat_image_t){.bits = 32, .cluster_sectors = 128, .free_clusters = free_clusters});
    sim.imu.is_mag_absent = true; /* no offer to calibrate, unless a test is about that */
}

static void boot(void)
{
    app_init(&app, &sim.board);
}

static void run(uint64_t duration_us)
{
    const uint64_t end_us = sim.now_us + duration_us;
    while (sim.now_us < end_us) {
        app_step(&app);
        sim.board.sleep(&sim);
    }
}

static void press_for(uint64_t duration_us)
{
    sim.is_pressed = true;
    run(duration_us);
    sim.is_pressed = false;
    run(600000);
}

static void press(void)
{
    press_for(60000);
}

/* Stop by the button, and let the card come to rest. */
static void stop(void)
{
    press();
    run(1500000);
    CHECK(!app.recording.is_open);
}

static void end(void)
{
    CHECK_EQUAL(sim.card.protocol_errors, 0);
    CHECK_EQUAL(sim.imu.fast_accesses, 0);
    CHECK(sim.longest_unfed_us < WATCHDOG_US);
    CHECK_EQUAL(fat_check(&sim.card, true), 0);
    sim_free(&sim);
}

/* ---- reading the card ---- */

typedef struct {
    uint32_t files, blocks, sessions, repeated, damaged;
    uint32_t imu, mag, gps, gaps, gap_imu, setups, configs, stops, temperatures, self_tests;
    uint32_t first_number, last_number; /* of the samples, recognised by their values */
    uint32_t strange;                   /* samples that are not the next one, without a gap before them */
    uint32_t events;                    /* bit set of codes */
    uint32_t session, first_sequence, next_sequence;
    uint8_t stop_reason, purpose, setup_flags;
    uint32_t gap_pending; /* after the last sample */
    uint64_t last_us;
} log_t;

static bool is_sample(uint32_t number, const uint8_t *data)
{
    int16_t motion[6];
    mpu_model_motion(number, motion);
    for (int i = 0; i < 6; i++)
        if (bytes_get_i16(data + 2 * i) != motion[i])
            return false;
    return true;
}

/* Which sample this is: the next one, or one after those the gap speaks of. */
static void read_imu(log_t *log, const block_record_t *record)
{
    uint32_t number = log->last_number + 1;
    if (log->imu == 0 || log->gap_pending) {
        number = log->imu ? log->last_number + 1 : 0;
        while (number < log->last_number + 100000 && !is_sample(number, record->data))
            number++;
        const uint32_t missing = number - log->last_number - 1;
        if (log->imu && missing != log->gap_pending)
            log->strange++;
    }
    if (!is_sample(number, record->data))
        log->strange++;
    if (log->imu++ == 0)
        log->first_number = number;
    log->last_number = number;
    log->gap_pending = 0;
}

static void read_record(log_t *log, const block_record_t *record)
{
    switch (record->type) {
    case RECORD_IMU:
        read_imu(log, record);
        break;
    case RECORD_MAG:
        log->mag++;
        break;
    case RECORD_TEMPERATURE:
        log->temperatures++;
        break;
    case RECORD_GPS:
        log->gps++;
        break;
    case RECORD_GAP:
        log->gaps++;
        if (record->data[0] == RECORD_IMU) {
            log->gap_imu += bytes_get_u32(record->data + 2);
            log->gap_pending += bytes_get_u32(record->data + 2);
        }
        break;
    case RECORD_SETUP:
        log->setups++;
        log->purpose = record->data[0];
        log->setup_flags = record->data[1];
        break;
    case RECORD_CONFIG:
        log->configs++;
        break;
    case RECORD_EVENT:
        log->events |= 1u << bytes_get_u16(record->data);
        break;
    case RECORD_SELF_TEST:
        log->self_tests++;
        break;
    case RECORD_STOP:
        log->stops++;
        log->stop_reason = record->data[0];
        break;
    default:
        break;
    }
}

static void read_block(log_t *log, const uint8_t *block)
{
    block_head_t head;
    block_record_t record;
    size_t at = 0;
    int result;
    if (block_read_head(block, &head) != CORE_OK) {
        log->damaged++;
        return;
    }
    if (head.session != log->session) {
        log->sessions++;
        log->session = head.session;
        log->first_sequence = log->next_sequence = head.sequence;
    }
    if (head.sequence < log->next_sequence) { /* written twice: the card had it, but did not say so */
        log->repeated++;
        return;
    }
    CHECK_EQUAL(head.sequence, log->next_sequence);
    log->next_sequence = head.sequence + 1;
    log->blocks++;
    while ((result = block_next(block, &head, &at, &record)) == 1)
        read_record(log, &record);
    CHECK_EQUAL(result, 0);
}

/* Read all recordings whose names begin with `prefix`, in the order of the directory. */
static log_t read_card(const sd_model_t *card, const char *prefix)
{
    static log_t log;
    fat_file_t files[MOST_FILES];
    log = (log_t){.files = 0};
    const size_t count = fat_list(card, files, MOST_FILES);
    for (size_t i = 0; i < count; i++) {
        if (memcmp(files[i].name, prefix, 3) != 0 || memcmp(files[i].name + 8, "KLG", 3) != 0)
            continue;
        log.files++;
        for (uint32_t block = 0; block < files[i].bytes / BLOCK_BYTES; block++)
            read_block(&log, sd_model_view(card, files[i].first_sector + block));
    }
    return log;
}

static log_t read_log(void)
{
    return read_card(&sim.card, "LOG");
}

/* ---- tests ---- */

static void test_every_sample_is_recorded(void)
{
    for (int wired = 0; wired < 2; wired++) {
        begin(1300);
        sim.is_int_wired = wired == 1;
        boot();
        run(12000000);
        CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
        stop();
        const log_t log = read_log();
        CHECK_EQUAL(log.sessions, 1);
        CHECK(log.imu > 11500);
        CHECK_EQUAL(log.strange, 0);
        CHECK_EQUAL(log.gaps, 0);
        CHECK_EQUAL(log.last_number - log.first_number + 1, log.imu);
        CHECK_EQUAL(log.damaged, 0); /* the file ends with its last block */
        CHECK(log.gps > 140);
        FILINFO info;
        CHECK_EQUAL(f_stat("LOG00001.KLG", &info), FR_OK);
        CHECK_EQUAL((uint32_t)info.fdate, app.storage.volume.fat_time >> 16); /* the receiver's, of some seconds ago */
        CHECK(app.storage.volume.fat_time != 0 && (info.fdate >> 9) != 2026 - 1980);
        CHECK(log.temperatures > 110);
        CHECK(log.setups >= 3 && log.configs >= 3);
        CHECK_EQUAL(log.setup_flags & SETUP_IMU_INTERRUPT, wired ? SETUP_IMU_INTERRUPT : 0);
        CHECK(log.setup_flags & SETUP_GPS_ACKNOWLEDGED);
        CHECK_EQUAL(log.stops, 1);
        CHECK_EQUAL(log.stop_reason, STOP_BUTTON);
        end();
    }
}

static void test_calibration_is_offered_once_and_ends_by_itself(void)
{
    begin(1300);
    sim.imu.is_mag_absent = false;
    boot();
    run(2000000);
    CHECK_EQUAL(app.logger.state, LOGGER_OFFERING);
    press();
    CHECK_EQUAL(app.logger.state, LOGGER_CALIBRATING);
    run(12000000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING); /* goes on to drive */
    const log_t log = read_card(&sim.card, "MAG");
    CHECK_EQUAL(log.files, 1);
    CHECK_EQUAL(log.purpose, PURPOSE_MAG_CALIBRATION);
    CHECK(log.mag >= LOGGER_CALIBRATION_POINTS);
    CHECK_EQUAL(log.stop_reason, STOP_CALIBRATED);
    sim_power_cycle(&sim);
    boot();
    run(3000000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING); /* not offered again */
    stop();
    end();
}

static void test_double_press_calibrates_later(void)
{
    begin(1300);
    boot();
    run(1500000);
    stop();
    sim.imu.is_mag_absent = false;
    app.imu.is_restart_wanted = true;
    sim.is_pressed = true;
    run(60000);
    sim.is_pressed = false;
    run(60000);
    press();
    CHECK_EQUAL(app.logger.state, LOGGER_CALIBRATING);
    stop();
    CHECK_EQUAL(read_card(&sim.card, "MAG").files, 1);
    end();
}

static void test_stalls_of_700_ms_cost_nothing(void)
{
    begin(1300);
    sim.imu.is_mag_absent = false; /* the magnetometer's records take room too */
    boot();
    sim.card.stall_us = 0;
    run(14000000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    sim.card.stall_us = 700000;
    sim.card.stall_every = 60;
    run(20000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.gaps, 0);
    CHECK(app.writer.most_blocks >= 24 && app.writer.most_blocks <= APP_RING_BLOCKS);
    end();
}

static void test_stall_beyond_the_bound_leaves_a_gap_with_the_right_count(void)
{
    begin(1300);
    boot();
    run(3000000);
    sim.card.stall_every = 40;
    sim.card.stall_us = 950000;
    run(10000000);
    sim.card.stall_every = SD_MODEL_INFINITE;
    stop();
    const log_t log = read_log();
    CHECK(log.gap_imu > 500);
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.last_number - log.first_number + 1 + log.gap_pending, log.imu + log.gap_imu);
    end();
}

static void test_card_that_hangs_is_started_again_and_the_file_goes_on(void)
{
    begin(1300);
    boot();
    run(3000000);
    sim.card.hang_at = sim.card.writes + 20;
    run(5000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.files, 1);
    CHECK_EQUAL(log.sessions, 1);
    CHECK(log.events & 1u << EVENT_CARD_RETRY);
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.last_number - log.first_number + 1 + log.gap_pending, log.imu + log.gap_imu);
    CHECK(log.gap_imu < 700); /* a second of silence, less what the ring holds */
    end();
}

static void test_refused_and_misheard_blocks_are_written_again(void)
{
    begin(1300);
    boot();
    run(3000000);
    sim.card.refuse_at = sim.card.writes + 10;
    sim.card.mishear_at = sim.card.writes + 40;
    run(5000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.gaps, 0);
    CHECK_EQUAL(log.files, 1);
    CHECK_EQUAL(app.recording.card_retries, 0);
    CHECK_EQUAL(app.storage.card.retries, 2);
    CHECK(log.events & 1u << EVENT_CARD_RETRY);
    end();
}

/* A contact that lets go on a bump, for any time up to what the ring holds. */
static void test_loose_contact_of_half_a_second_costs_nothing(void)
{
    for (uint32_t away_us = 1000; away_us < 560000; away_us += 43000) {
        begin(1300);
        boot();
        run(3000000 + away_us % 27000); /* at different fills of the block */
        sim.card.is_absent = true;
        run(away_us);
        sd_model_power_cycle(&sim.card);
        run(3000000);
        stop();
        const log_t log = read_log();
        CHECK_EQUAL(log.files, 1);
        CHECK_EQUAL(log.gaps, 0);
        CHECK_EQUAL(log.strange, 0);
        end();
    }
}

static void test_card_pulled_out_comes_back_to_the_same_recording(void)
{
    begin(1300);
    boot();
    run(3000000);
    sim.card.is_absent = true;
    run(4000000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    CHECK_EQUAL(logger_led(&app.logger), LED_CARD_MISSING);
    sd_model_power_cycle(&sim.card);
    run(6000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.sessions, 1);
    CHECK(log.gap_imu > 3000);
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.last_number - log.first_number + 1 + log.gap_pending, log.imu + log.gap_imu);
    CHECK(log.events & 1u << EVENT_CARD_BACK);
    CHECK_EQUAL(log.stops, 1);
    end();
}

static void test_another_card_takes_the_recording_on(void)
{
    static sim_t other;
    begin(1300);
    sim_init(&other, SD_MODEL_HC, CARD_SECTORS);
    fat_format(&other.card, &(fat_image_t){.bits = 32, .cluster_sectors = 128, .free_clusters = 1300});
    boot();
    run(3000000);
    const uint32_t session = app.recording.session;
    sim.card.is_absent = true;
    run(2000000);
    sd_model_t first = sim.card;
    sim.card = other.card;
    sim.card.now_us = &sim.now_us;
    run(6000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.files, 1);
    CHECK_EQUAL(log.session, session);
    CHECK(log.first_sequence > 50); /* numbers run on from card to card */
    CHECK_EQUAL(log.strange, 0);
    end();
    sd_model_free(&first);
}

static void test_full_card_ends_the_recording_and_nothing_else(void)
{
    begin(257); /* 16 MB and a cluster */
    boot();
    run(1500000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    CHECK_EQUAL(app.storage.blocks, 16 << 11);
    const uint32_t blocks = app.storage.blocks = 400; /* or this would take a quarter of an hour */
    for (int i = 0; i < 20 && app.logger.state == LOGGER_RECORDING; i++)
        run(1000000);
    CHECK_EQUAL(app.logger.state, LOGGER_FULL);
    run(1000000);
    CHECK_EQUAL(logger_led(&app.logger), LED_CARD_FULL);
    const log_t log = read_log();
    CHECK_EQUAL(log.stop_reason, STOP_CARD_FULL);
    CHECK_EQUAL(log.stops, 1);
    CHECK_EQUAL(log.strange, 0);
    CHECK(log.blocks > blocks - STORAGE_RESERVE);
    end();
}

/* The table is read once, however often it is in the way: on a large card that takes seconds. */
static void test_pieces_of_a_fragmented_card_are_used(void)
{
    static const struct {
        uint32_t free_run, megabytes;
    } cards[] = {{300, 16}, {700, 32}, {255, 0}};
    for (size_t i = 0; i < sizeof cards / sizeof *cards; i++) {
        sim_init(&sim, SD_MODEL_HC, CARD_SECTORS);
        fat_format(&sim.card, &(fat_image_t){.bits = 32, .cluster_sectors = 128, .free_run = cards[i].free_run});
        sim.imu.is_mag_absent = true;
        boot();
        app_step(&app);
        CHECK(sim.card.reads < 513 + 64 + 60); /* and once more what lies before the start of the search */
        run(3000000);
        CHECK_EQUAL(app.logger.state, cards[i].megabytes ? LOGGER_RECORDING : LOGGER_FULL);
        if (cards[i].megabytes) {
            CHECK_EQUAL(app.storage.blocks, cards[i].megabytes << 11);
            stop();
            CHECK_EQUAL(read_log().strange, 0);
        }
        end();
    }
}

static void test_recording_goes_on_in_the_next_file(void)
{
    begin(8500); /* 512 MB, and some for the next */
    boot();
    run(1500000);
    const uint32_t session = app.recording.session;
    app.storage.blocks = 200; /* of 512 MB */
    for (int i = 0; i < 20 && app.storage.current.number < 2; i++)
        run(1000000);
    run(5000000);
    CHECK_EQUAL(app.recording.session, session);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.files, 2);
    CHECK_EQUAL(log.sessions, 1);
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.gaps, 0);
    end();
}

static void test_without_receiver_the_imu_is_logged(void)
{
    begin(1300);
    sim.gps.is_absent = true;
    boot();
    run(4000000);
    CHECK_EQUAL(logger_led(&app.logger), LED_NO_FIX);
    stop();
    const log_t log = read_log();
    CHECK(log.imu > 3000);
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(log.gps, 0);
    end();
}

static void test_without_imu_the_receiver_is_logged(void)
{
    begin(1300);
    sim.imu.is_absent = true;
    boot();
    run(8000000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    CHECK_EQUAL(logger_led(&app.logger), LED_SENSOR_ERROR);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.imu, 0);
    CHECK(log.gps > 50);
    CHECK(log.events & 1u << EVENT_IMU_LOST);
    end();
}

static void test_imu_that_freezes_or_falls_silent_is_reset(void)
{
    for (int way = 0; way < 2; way++) {
        begin(1300);
        boot();
        run(3000000);
        sim.imu.is_frozen = way == 0;
        sim.imu.is_absent = way == 1;
        run(1500000);
        sim.imu.is_frozen = sim.imu.is_absent = false;
        run(8000000);
        CHECK(app.imu.is_working);
        stop();
        const log_t log = read_log();
        CHECK(log.events & 1u << EVENT_IMU_LOST);
        CHECK(log.events & 1u << EVENT_IMU_BACK);
        CHECK(log.imu > 5000);
        end();
    }
}

static void test_settings_come_from_the_card(void)
{
    begin(1300);
    fat_add_file(&sim.card, "CONFIG  TXT", "imu_rate=500\r\naccel_range = 8\r\ngyro_range=2000\r\nautostart=no\r\n");
    boot();
    run(3000000);
    CHECK_EQUAL(app.logger.state, LOGGER_IDLE);
    CHECK_EQUAL(sim.imu.registers[0x19], 1);
    CHECK_EQUAL(sim.imu.registers[0x1C], 2 << 3);
    press();
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    run(2000000);
    stop();
    const log_t log = read_log();
    CHECK(log.imu > 1200 && log.imu < 1500);
    CHECK(log.setup_flags & SETUP_CONFIG_READ);
    end();
}

static void test_bad_settings_are_rejected_whole_and_said(void)
{
    begin(1300);
    fat_add_file(&sim.card, "CONFIG  TXT", "imu_rate=500\naccel_range=7\n");
    boot();
    run(2000000);
    CHECK_EQUAL(sim.imu.registers[0x19], 0);
    stop();
    const log_t log = read_log();
    CHECK(log.events & 1u << EVENT_CONFIG_REJECTED);
    CHECK(log.setup_flags & SETUP_CONFIG_REJECTED);
    end();
}

static void test_self_test_stands_in_the_recording(void)
{
    begin(1300);
    fat_add_file(&sim.card, "CONFIG  TXT", "self_test=yes\n");
    boot();
    run(5000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.self_tests, 1);
    CHECK(log.imu > 3000);
    CHECK_EQUAL(log.strange, 0);
    CHECK_EQUAL(app.imu.self_test.passed, 0x1F);
    end();
}

static void test_low_supply_ends_the_recording_and_its_return_begins_another(void)
{
    begin(1300);
    boot();
    run(3000000);
    sim.is_supply_low = true;
    const uint64_t since_us = sim.now_us;
    while (app.recording.is_open && sim.now_us - since_us < 1000000)
        run(1000);
    CHECK(sim.now_us - since_us < 20000); /* with what is left in the capacitors */
    run(500000);
    sim.is_supply_low = false;
    run(8000000);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.files, 2);
    CHECK_EQUAL(log.sessions, 2);
    CHECK_EQUAL(log.stops, 2);
    end();
}

static void test_long_press_makes_it_safe_to_switch_off(void)
{
    begin(1300);
    boot();
    run(3000000);
    press_for(2000000);
    run(1000000);
    CHECK_EQUAL(app.logger.state, LOGGER_SAFE);
    CHECK(!app.recording.is_open);
    CHECK_EQUAL(read_log().stops, 1);
    end();
}

static void test_reset_by_the_watchdog_recovers_the_recording_and_is_told(void)
{
    begin(1300);
    boot();
    run(3000000);
    const uint32_t blocks = app.storage.next_block;
    sim_reset(&sim);
    sim.board.reset_cause = RESET_BY_WATCHDOG;
    sim.board.mark_before_reset = AT_CARD_STEP;
    boot();
    run(3000000);
    stop();
    const log_t log = read_log();
    CHECK_EQUAL(log.files, 2);
    CHECK(log.events & 1u << EVENT_WATCHDOG);
    CHECK(log.events & 1u << EVENT_RECOVERED);
    CHECK(log.blocks >= blocks);
    end();
}

static void test_old_and_small_cards_work_too(void)
{
    static const sd_model_kind_t kinds[] = {SD_MODEL_V1, SD_MODEL_V2};
    for (int i = 0; i < 2; i++) {
        sim_init(&sim, kinds[i], 1 << 17); /* 64 MB, FAT16 */
        fat_format(&sim.card, &(fat_image_t){.bits = 16, .cluster_sectors = 8});
        sim.imu.is_mag_absent = true;
        boot();
        run(3000000);
        stop();
        const log_t log = read_log();
        CHECK_EQUAL(log.files, 1);
        CHECK_EQUAL(log.strange, 0);
        CHECK(log.imu > 2000);
        end();
    }
}

static void test_stream_carries_the_same_samples(void)
{
    begin(1300);
    fat_add_file(&sim.card, "CONFIG  TXT", "stream=1000\nstream_baud=230400\n");
    boot();
    run(8000000);
    frame_view_t view;
    uint32_t frames = 0, samples = 0, setups = 0, gps = 0, next = 0;
    for (size_t at = 0; at < sim.output_length;) {
        const size_t used = frame_find(sim.output + at, sim.output_length - at, &view);
        if (used == 0)
            break;
        at += used;
        for (size_t i = 0; i < view.length;) {
            const int length = record_length(view.records + i, view.length - i);
            CHECK(length > 0);
            samples += view.records[i] == RECORD_IMU;
            setups += view.records[i] == RECORD_SETUP;
            gps += view.records[i] == RECORD_GPS;
            i += (size_t)length;
        }
        if (view.length && frames++ > 0)
            CHECK_EQUAL(view.number, next);
        if (view.length)
            next = (view.number + 1u) & 0xFFFF;
    }
    CHECK(frames > 500);
    CHECK(samples > 7000);
    CHECK(setups >= 3);
    CHECK(gps > 80);
    stop();
    end();
}

/* Stalls at random, up to the bound and beyond it: what was measured is in the file, or in its gaps. */
static void test_any_stalls_leave_samples_or_gaps(void)
{
    uint64_t random = 12345;
    uint32_t with_gaps = 0;
    for (int round = 0; round < ROUNDS; round++) {
        begin(1300);
        boot();
        run(1500000);
        for (int i = 0; i < 12; i++) {
            random = random * 6364136223846793005u + 1442695040888963407u;
            const uint32_t one = (uint32_t)(random >> 33), two = (uint32_t)(random >> 13) & 0xFFFFFF;
            sim.card.stall_every = 1 + one % 40;
            sim.card.stall_us = two % (round % 2 ? 350000 : 970000) / (sim.card.stall_every < 20 ? 20 : 1);
            run(300000 + one % 500000);
        }
        sim.card.stall_every = SD_MODEL_INFINITE;
        stop();
        const log_t log = read_log();
        CHECK_EQUAL(log.strange, 0);
        CHECK_EQUAL(log.last_number - log.first_number + 1 + log.gap_pending, log.imu + log.gap_imu);
        CHECK_EQUAL(log.gap_imu, app.writer.imu_lost);
        with_gaps += log.gap_imu != 0;
        if (round % 2)
            CHECK_EQUAL(log.gap_imu, 0); /* those stalls were within the bound */
        end();
    }
    printf("%u of %d with gaps\n", with_gaps, ROUNDS);
    CHECK(with_gaps > 0 && with_gaps < ROUNDS);
}

/* ---- a recording for the reader in Python: `test_app save FILE` ---- */

/* Drive for 20 s, with one stall too long; say what is to be found. */
static int save_recording(const char *path)
{
    fat_file_t files[MOST_FILES];
    begin(1300);
    sim.imu.is_mag_absent = false;
    boot();
    app.logger.was_offered = true;
    run(12000000);
    sim.card.stall_every = 30;
    sim.card.stall_us = 950000;
    run(2000000);
    sim.card.stall_every = SD_MODEL_INFINITE;
    run(6000000);
    stop();
    const log_t log = read_log();
    printf("imu %u mag %u gps %u gap %u first %u\n", log.imu, log.mag, log.gps, log.gap_imu, log.first_number);
    FILE *file = fopen(path, "wb");
    CHECK(file != NULL);
    const size_t count = fat_list(&sim.card, files, MOST_FILES);
    for (size_t i = 0; i < count; i++)
        for (uint32_t block = 0; memcmp(files[i].name, "LOG00001KLG", 11) == 0 && block < files[i].bytes / BLOCK_BYTES; block++)
            CHECK_EQUAL(fwrite(sd_model_view(&sim.card, files[i].first_sector + block), BLOCK_BYTES, 1, file), 1);
    CHECK_EQUAL(fclose(file), 0);
    end();
    return 0;
}

/* ---- a table for DESIGN.md: `test_app sweep` ---- */

static bool survives(uint32_t ring_blocks, uint32_t stall_us)
{
    begin(1300);
    sim.imu.is_mag_absent = false;
    boot();
    app.logger.was_offered = true;
    while (app.logger.state != LOGGER_RECORDING)
        run(1000);
    app.ring.size = ring_blocks; /* nothing is in it yet */
    run(2000000);
    for (int i = 0; i < 20; i++) { /* stalls that begin at different fills of the block */
        sim.card.stall_every = 1;
        sim.card.stall_us = stall_us;
        const uint32_t writes = sim.card.writes;
        while (sim.card.writes == writes)
            run(1000);
        sim.card.stall_every = SD_MODEL_INFINITE;
        run(stall_us + 1100000);
    }
    const bool has_survived = app.writer.imu_lost == 0;
    sim_free(&sim);
    return has_survived;
}

static void print_sweep(void)
{
    static const uint32_t sizes[] = {8, 16, 24, 26, 27, 28};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        uint32_t good = 0, bad = 1000000;
        while (bad - good > 2000) {
            const uint32_t middle = (good + bad) / 2;
            if (survives(sizes[i], middle))
                good = middle;
            else
                bad = middle;
        }
        printf("%u blocks: %u ms\n", sizes[i], good / 1000);
    }
}

#define TEST(name) {#name, test_##name}

int main(int argc, char **argv)
{
    if (argc == 2 && strcmp(argv[1], "sweep") == 0) {
        print_sweep();
        return 0;
    }
    if (argc == 3 && strcmp(argv[1], "save") == 0)
        return save_recording(argv[2]);
    static const test_t tests[] = {
        TEST(every_sample_is_recorded),
        TEST(calibration_is_offered_once_and_ends_by_itself),
        TEST(double_press_calibrates_later),
        TEST(stalls_of_700_ms_cost_nothing),
        TEST(stall_beyond_the_bound_leaves_a_gap_with_the_right_count),
        TEST(card_that_hangs_is_started_again_and_the_file_goes_on),
        TEST(refused_and_misheard_blocks_are_written_again),
        TEST(loose_contact_of_half_a_second_costs_nothing),
        TEST(card_pulled_out_comes_back_to_the_same_recording),
        TEST(another_card_takes_the_recording_on),
        TEST(full_card_ends_the_recording_and_nothing_else),
        TEST(pieces_of_a_fragmented_card_are_used),
        TEST(recording_goes_on_in_the_next_file),
        TEST(without_receiver_the_imu_is_logged),
        TEST(without_imu_the_receiver_is_logged),
        TEST(imu_that_freezes_or_falls_silent_is_reset),
        TEST(settings_come_from_the_card),
        TEST(bad_settings_are_rejected_whole_and_said),
        TEST(self_test_stands_in_the_recording),
        TEST(low_supply_ends_the_recording_and_its_return_begins_another),
        TEST(long_press_makes_it_safe_to_switch_off),
        TEST(reset_by_the_watchdog_recovers_the_recording_and_is_told),
        TEST(old_and_small_cards_work_too),
        TEST(stream_carries_the_same_samples),
        TEST(any_stalls_leave_samples_or_gaps),
    };
    return run_tests(tests, sizeof tests / sizeof *tests, argc, argv);
}
