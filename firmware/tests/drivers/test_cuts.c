/* The power fails at every write there is, from the first boot on a fresh card to the end of a second recording, and the
 * sector being written is torn. After the next start the file system is whole and every block the card had taken is in
 * its file.
 *
 *   test_cuts every          one life for each write, a few tears each
 *   test_cuts directory      writes outside of recordings, torn at every byte that could matter
 *   test_cuts show K BYTES   one of them, with the logger's words and the complaints of the check
 *   test_cuts save K BYTES IMAGE   one of them, and the card as an image */
#include <string.h>

#include "app.h"
#include "block.h"
#include "check.h"
#include "fat_image.h"
#include "sim_board.h"

enum {
    CARD_SECTORS = 2048 + 32 + 2 * 513 + 65600 * 128, /* the smallest FAT32 of 64 KB clusters */
    FREE_CLUSTERS = 1300,                             /* room for a file of 80 MB */
    DATA_FROM = 2048 + 32 + 2 * 513 + 14 * 128,       /* behind tables and root directory */
    MOST_FILES = 16
};

static sim_t sim;
static app_t app;
static sd_model_t fresh;

static void prepare(void)
{
    static const uint64_t zero;
    sim_init(&sim, SD_MODEL_HC, CARD_SECTORS);
    sim.sleep_us = 1000; /* thousands of lives */
    sd_model_init(&fresh, SD_MODEL_HC, CARD_SECTORS, &zero);
    fat_format(&fresh, &(fat_image_t){.bits = 32, .cluster_sectors = 128, .free_clusters = FREE_CLUSTERS});
}

static void run(uint64_t duration_us)
{
    const uint64_t end_us = sim.now_us + duration_us;
    while (sim.now_us < end_us && !sim.card.is_cut) {
        app_step(&app);
        sim.board.sleep(&sim);
    }
}

/* What the logger believes to be on the card: blocks of a session. */
typedef struct {
    uint32_t session, blocks;
} promise_t;
enum { MOST_PROMISES = 8 };
static promise_t promises[MOST_PROMISES];
static size_t promise_count;

static void promise(void)
{
    promises[promise_count++] = (promise_t){app.recording.session, app.storage.next_block};
}

static void press(void)
{
    sim.is_pressed = true;
    run(50000);
    sim.is_pressed = false;
    run(600000);
}

/* Boot, record, stop, record again, stop. */
static void live(void)
{
    app_init(&app, &sim.board);
    run(700000);
    press();
    promise();
    run(300000);
    press();
    run(200000);
    press();
    run(600000);
}

static void begin_life(uint32_t cut_at, uint32_t torn_bytes)
{
    sd_model_copy_medium(&sim.card, &fresh);
    promise_count = 0;
    sim.now_us = 1000;
    sim_power_cycle(&sim);
    sim.imu.is_mag_absent = true; /* no offer to calibrate: it would take ten seconds of every life */
    sim.card.cut_at = cut_at;
    sim.card.torn_bytes = torn_bytes;
}

/* Blocks of the file in an unbroken row from its first. */
static uint32_t count_blocks(const fat_file_t *file, uint32_t *session)
{
    block_head_t head, first = {.session = 0};
    uint32_t count = 0;
    for (; count < file->bytes / BLOCK_BYTES; count++) {
        if (block_read_head(sd_model_view(&sim.card, file->first_sector + count), &head) < 0)
            break;
        if (count == 0)
            first = head;
        if (head.session != first.session || head.sequence != count)
            break;
    }
    *session = first.session;
    return count;
}

static bool is_kept(const promise_t *wanted, const fat_file_t *files, size_t count)
{
    if (wanted->blocks == 0)
        return true;
    for (size_t i = 0; i < count; i++) {
        uint32_t session = 0;
        const bool is_recording = memcmp(files[i].name + 8, "KLG", 3) == 0;
        const uint32_t blocks = is_recording ? count_blocks(&files[i], &session) : 0;
        if (blocks >= wanted->blocks && session == wanted->session)
            return blocks * BLOCK_BYTES == files[i].bytes; /* and the file ends with them */
    }
    return false;
}

static const char *judge(bool is_loud)
{
    fat_file_t files[MOST_FILES];
    if (fat_check(&sim.card, is_loud) != 0)
        return "the file system is damaged";
    const size_t count = fat_list(&sim.card, files, MOST_FILES);
    for (size_t i = 0; i < count && is_loud; i++)
        fprintf(stderr, "%s %u\n", files[i].name, files[i].bytes);
    for (size_t i = 0; i < promise_count; i++)
        if (!is_kept(&promises[i], files, count))
            return "blocks are missing";
    if (sim.card.protocol_errors)
        return "the card was spoken to in the wrong way";
    return NULL;
}

/* Live until the cut, start again, look. NULL: all is well. */
static const char *cut_and_look(uint32_t cut_at, uint32_t torn_bytes, bool is_loud, uint32_t *sector)
{
    begin_life(cut_at, torn_bytes);
    live();
    if (!sim.card.is_cut)
        return "the power did not fail";
    *sector = sim.card.address;
    promise();
    sim_power_cycle(&sim);
    sim.imu.is_mag_absent = true;
    app_init(&app, &sim.board);
    run(700000);
    if (app.logger.state != LOGGER_RECORDING)
        return "it does not record again";
    press();
    run(200000);
    promise();
    if (is_loud)
        fwrite(sim.output, sim.output_length, 1, stderr);
    return judge(is_loud);
}

/* Of the second life: the models' clocks begin at 0 in the first alone, which makes a block of difference. */
static uint32_t count_writes(void)
{
    for (int i = 0; i < 2; i++) {
        begin_life(SD_MODEL_INFINITE, 0);
        live();
    }
    return sim.card.writes;
}

static void look_at(uint32_t cut_at, uint32_t torn_bytes, uint32_t *sector)
{
    sim.output_length = 0;
    const char *complaint = cut_and_look(cut_at, torn_bytes, false, sector);
    if (complaint) {
        fprintf(stderr, "write %u, %u bytes of it stored (sector %u): %s\n", cut_at, torn_bytes, *sector, complaint);
        exit(1);
    }
}

static void test_every(void)
{
    static const uint32_t tears[] = {0, 27, 256, 511};
    const uint32_t writes = count_writes();
    uint32_t lives = 0, sector = 0;
    for (uint32_t cut_at = 0; cut_at < writes; cut_at++) {
        look_at(cut_at, 512, &sector);
        lives++;
        const size_t count = sector < DATA_FROM ? sizeof tears / sizeof *tears : 1;
        for (size_t i = 0; i < count; i++, lives++)
            look_at(cut_at, tears[(i + cut_at) % (sizeof tears / sizeof *tears)], &sector);
    }
    printf("%u writes, %u lives\n", writes, lives);
    CHECK(writes > 60);
}

/* Within a sector only bytes that change can be torn apart; entries of the directory are the ones that matter. */
static void test_directory(void)
{
    const uint32_t writes = count_writes();
    uint32_t lives = 0, sector = 0;
    for (uint32_t cut_at = 0; cut_at < writes; cut_at++) {
        look_at(cut_at, 0, &sector);
        if (sector < 2048 + 32 + 2 * 513 || sector >= 2048 + 32 + 2 * 513 + 128)
            continue;
        for (uint32_t torn = 32; torn < 32 * 4; torn++, lives++)
            look_at(cut_at, torn, &sector);
    }
    printf("%u lives\n", lives);
    CHECK(lives > 500);
}

int main(int argc, char **argv)
{
    static const test_t tests[] = {{"every", test_every}, {"directory", test_directory}};
    prepare();
    if (argc == 4 && strcmp(argv[1], "show") == 0) {
        uint32_t sector;
        const char *complaint = cut_and_look((uint32_t)atoi(argv[2]), (uint32_t)atoi(argv[3]), true, &sector);
        fprintf(stderr, "sector %u: %s\n", sector, complaint ? complaint : "all is well");
        return 0;
    }
    if (argc == 5 && strcmp(argv[1], "save") == 0) {
        uint32_t sector;
        look_at((uint32_t)atoi(argv[2]), (uint32_t)atoi(argv[3]), &sector);
        return sd_model_save(&sim.card, argv[4]) ? 1 : 0;
    }
    const int result = run_tests(tests, sizeof tests / sizeof *tests, argc, argv);
    sd_model_free(&fresh);
    sim_free(&sim);
    return result;
}
