/* The whole logger on the board of models. */
#include <string.h>

#include "app.h"
#include "check.h"
#include "fat_image.h"
#include "sim_board.h"

enum { CARD_SECTORS = 2048 + 32 + 2 * 513 + 65600 * 128 }; /* the smallest FAT32 of 64 KB clusters */

static sim_t sim;
static app_t app;

static void begin(uint32_t free_clusters)
{
    sim_init(&sim, SD_MODEL_HC, CARD_SECTORS);
    fat_format(&sim.card, &(fat_image_t){.bits = 32, .cluster_sectors = 128, .free_clusters = free_clusters});
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

static void press(uint64_t duration_us)
{
    sim.is_pressed = true;
    run(duration_us);
    sim.is_pressed = false;
    run(600000);
}

static void test_records_by_itself(void)
{
    fat_file_t files[8];
    begin(1300);
    boot();
    run(30000000);
    fwrite(sim.output, sim.output_length, 1, stdout);
    CHECK_EQUAL(app.logger.state, LOGGER_RECORDING);
    press(100000);
    run(2000000);
    CHECK_EQUAL(app.logger.state, LOGGER_IDLE);
    const size_t count = fat_list(&sim.card, files, 8);
    for (size_t i = 0; i < count; i++)
        printf("%s %u\n", files[i].name, files[i].bytes);
    CHECK_EQUAL(fat_check(&sim.card, true), 0);
    CHECK_EQUAL(sim.card.protocol_errors, 0);
    CHECK_EQUAL(app.writer.imu_lost, 0);
    sim_free(&sim);
}

int main(int argc, char **argv)
{
    static const test_t tests[] = {{"records_by_itself", test_records_by_itself}};
    return run_tests(tests, sizeof tests / sizeof *tests, argc, argv);
}
