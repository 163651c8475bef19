#include "world.h"

#include "fat_image.h"
#include "rules.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MESSAGES_BAUD = 115200 };
enum { SLACK_US = 400 /* by which two samples of a table may be nearer than their period */ };
enum { PARTITION = 2048, POWER_ON = 0x0C, WATCHDOG = 0x24, SOFTWARE = 0x14, MOST_FILES = 64, LONGEST_PATH = 600, USUAL_CLUSTERS = 131072 };

static world_t *of(void *context)
{
    return context;
}

/* ---- chance: splitmix64 ---- */

static double chance(world_t *world)
{
    uint64_t z = world->random += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

static uint64_t exponential(world_t *world, uint32_t mean)
{
    return (uint64_t)(-log(1.0 - chance(world)) * mean);
}

/* ---- the card ---- */

static void note_stall(world_t *world, uint32_t stall_us)
{
    world->stalls++;
    world->stall_from_us = world->now_us;
    world->stall_until_us = world->now_us + stall_us;
    if (stall_us > world->longest_stall_us)
        world->longest_stall_us = stall_us;
}

static uint32_t take_exact_stall(world_t *world)
{
    const uint32_t stall_us = world->exact_stall_us;
    world->exact_stall_us = 0;
    note_stall(world, stall_us);
    return stall_us;
}

static uint32_t draw_busy(world_t *world)
{
    const delays_t *delays = &world->delays;
    if (world->exact_stall_us)
        return take_exact_stall(world);
    if (!delays->stall_us || world->now_us < world->next_stall_us)
        return delays->busy_us + (uint32_t)exponential(world, delays->busy_us);
    const bool is_longest = (world->stalls + 1) % 3 == 0;
    const uint32_t stall = is_longest ? delays->stall_us : (uint32_t)(chance(world) * delays->stall_us);
    note_stall(world, stall);
    world->next_stall_us = world->stall_until_us + delays->stall_rest_us + exponential(world, delays->stall_pause_us);
    return stall;
}

static bool is_about_to_store(const sd_model_t *card)
{
    return card->is_receiving && card->in_length == sizeof card->in - 1 && card->address < card->sectors;
}

static void remember_write(world_t *world, written_t *write)
{
    const sd_model_t *card = &world->card;
    write->sector = card->address;
    write->time_us = world->now_us;
    sd_model_peek(card, card->address, write->before);
}

static uint32_t first_file_sector(const world_t *world)
{
    return PARTITION + 32 + 2 * ((world->plan.clusters + 2) * 4 / SD_MODEL_SECTOR + 1) + CARD_CLUSTER_SECTORS;
}

static void note_write(world_t *world, const written_t *write)
{
    world->journal_writes++;
    if (world->is_measuring && write->sector < first_file_sector(world))
        world->metadata_writes++;
    if (world->writes && !world->is_child)
        fprintf(world->writes, "%" PRIu64 " %u %" PRIu64 "\n", write->time_us, write->sector, world->card.busy_until_us);
}

static const rule_t card_rules[] = {
    [SD_MODEL_ASLEEP] = RULE_CARD_ASLEEP,     [SD_MODEL_TOO_FAST] = RULE_CARD_TOO_FAST, [SD_MODEL_IN_BUSY] = RULE_CARD_BUSY,
    [SD_MODEL_DISORDER] = RULE_CARD_ORDER,    [SD_MODEL_TOKEN] = RULE_CARD_TOKEN,       [SD_MODEL_CHECKSUM] = RULE_CARD_CHECKSUM,
    [SD_MODEL_LET_GO] = RULE_CARD_SELECT,
};

static uint8_t card_byte(void *context, uint8_t out, uint32_t clock_hz)
{
    world_t *world = of(context);
    const uint32_t writes = world->card.writes;
    world->now_us = world->machine.cycles / CYCLES_PER_US;
    world->card.clock_hz = clock_hz;
    if (is_about_to_store(&world->card)) {
        world->card.busy_us = draw_busy(world);
        remember_write(world, &world->journal[world->journal_writes % JOURNAL]);
    }
    const uint8_t in = sd_model_exchange(&world->card, out);
    if (world->card.writes != writes)
        note_write(world, &world->journal[world->journal_writes % JOURNAL]);
    if (world->card.flaw != SD_MODEL_FINE)
        rules_break(&world->machine, card_rules[world->card.flaw], "card");
    return in;
}

static void card_select(void *context, bool is_selected)
{
    sd_model_select(&of(context)->card, is_selected);
}

/* What a power cut does to the medium: of the sectors in its cache, so many of the newest are undone, and the oldest of
 * those is torn. A card that is idle and has no cache keeps everything. */
static void tear(world_t *world)
{
    const uint32_t kept = world->journal_writes < JOURNAL ? world->journal_writes : JOURNAL;
    uint32_t undone = (uint32_t)(chance(world) * (world->cache + 1));
    const bool is_programming = world->now_us < world->card.busy_until_us;
    if (undone == 0 && is_programming)
        undone = 1;
    for (uint32_t i = 1; i <= undone && i <= kept; i++) {
        const written_t *write = &world->journal[(world->journal_writes - i) % JOURNAL];
        uint8_t sector[SD_MODEL_SECTOR];
        const size_t stored = i == undone ? (size_t)(chance(world) * (SD_MODEL_SECTOR + 1)) : 0;
        sd_model_peek(&world->card, write->sector, sector);
        memcpy(sector + stored, write->before + stored, SD_MODEL_SECTOR - stored);
        sd_model_poke(&world->card, write->sector, sector);
    }
}

/* ---- what the sensors measure ---- */

/* First of `count` structures of `size` bytes, which begin with their time, that is later than `after_us`. */
static size_t find_after(const void *table, size_t size, size_t count, uint64_t after_us)
{
    size_t low = 0, high = count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        uint64_t time;
        memcpy(&time, (const uint8_t *)table + middle * size, sizeof time);
        if (time <= after_us)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The next time that a sensor measures, which it does every `period_us`: in the lead-in such that the first of the table
 * follows in its time, then at a time of the table. It need not be the next one there, and where none is due nearly then
 * (a sensor that is faster than the table) it is between two. */
static uint64_t next_in(const void *table, size_t size, size_t count, uint64_t after_us, uint64_t period_us)
{
    uint64_t first = NEVER, time = NEVER;
    if (count == 0)
        return NEVER;
    memcpy(&first, table, sizeof first);
    if (after_us + period_us < first)
        return first - (first - after_us - 1) / period_us * period_us;
    const size_t i = find_after(table, size, count, after_us + period_us - (period_us / 2 < SLACK_US ? period_us / 2 : SLACK_US));
    if (i < count)
        memcpy(&time, (const uint8_t *)table + i * size, sizeof time);
    return time == NEVER || time < after_us + 2 * period_us ? time : after_us + period_us;
}

/* Where to look in the table for what is measured at a time: the newest, or in the lead-in the first second to and fro. */
static size_t find_now(const void *table, size_t size, size_t count, uint64_t time_us)
{
    const uint64_t span_us = 1000000;
    uint64_t first;
    memcpy(&first, table, sizeof first);
    if (time_us < first) {
        const uint64_t back = (first - time_us) % (2 * span_us);
        time_us = first + (back < span_us ? back : 2 * span_us - back);
    }
    const size_t i = find_after(table, size, count, time_us);
    return i ? i - 1 : 0;
}

static uint64_t next_sample_us(void *context, uint64_t after_us)
{
    const world_t *world = context;
    return next_in(world->motions, sizeof(motion_t), world->motion_count, after_us, mpu_model_period_us(&world->imu));
}

static void motion(void *context, uint64_t time_us, int16_t values[6])
{
    const world_t *world = context;
    memcpy(values, world->motions[find_now(world->motions, sizeof(motion_t), world->motion_count, time_us)].values, 12);
}

static uint64_t next_mag_us(void *context, uint64_t after_us)
{
    const world_t *world = context;
    return next_in(world->fields, sizeof(field_t), world->field_count, after_us, 10000);
}

static void field(void *context, uint64_t time_us, int16_t values[3])
{
    const world_t *world = context;
    memcpy(values, world->fields[find_now(world->fields, sizeof(field_t), world->field_count, time_us)].values, 6);
}

static void imu_transfer(void *context, const uint8_t *out, uint8_t *in, size_t length, uint32_t clock_hz)
{
    world_t *world = of(context);
    world->now_us = world->machine.cycles / CYCLES_PER_US;
    world->imu.clock_hz = clock_hz;
    mpu_model_transfer(&world->imu, out, in, length);
    if (world->imu.fast_accesses)
        rules_break(&world->machine, RULE_IMU_TOO_FAST, "IMU");
    else if (world->imu.slave_errors)
        rules_break(&world->machine, RULE_IMU_SLAVE, "IMU");
}

/* ---- receiver, serial line, panel ---- */

static void to_receiver(void *context, uint8_t byte, uint32_t baud)
{
    world_t *world = of(context);
    world->now_us = world->machine.cycles / CYCLES_PER_US;
    neo_model_receive(&world->receiver, &byte, 1, baud);
}

/* A serial adapter, set to what a person would set it to: the rate of the messages, or that of CONFIG.TXT. */
static void to_serial(void *context, uint8_t byte, uint32_t baud)
{
    world_t *world = of(context);
    const uint32_t known[] = {MESSAGES_BAUD, world->stream_baud};
    bool is_known = false;
    for (size_t i = 0; i < 2; i++)
        is_known |= baud > known[i] - known[i] / 50 && baud < known[i] + known[i] / 50;
    if (!is_known)
        rules_break(&world->machine, RULE_USART_RATE, "USART1");
    if (world->serial)
        fputc(byte, world->serial);
}

static void led(void *context, bool is_on)
{
    world_t *world = of(context);
    world->led_changes++;
    if (world->panel && !world->is_child)
        fprintf(world->panel, "%" PRIu64 " %d\n", world->machine.cycles / CYCLES_PER_US, is_on);
}

static bool is_button_pressed(void *context)
{
    return of(context)->is_pressed;
}

static bool is_supply_low(void *context)
{
    return of(context)->is_supply_low;
}

/* ---- what happens when ---- */

typedef struct {
    const char *name;
    void (*act)(world_t *world, uint64_t value);
} verb_t;

static void do_button(world_t *world, uint64_t value) { world->is_pressed = value != 0; }
static void do_supply_low(world_t *world, uint64_t value) { world->is_supply_low = value != 0; }
static void do_card_absent(world_t *world, uint64_t value)
{
    world->card.is_absent = value != 0;
    if (value) { /* what was on its way is gone with its power; the medium stays */
        const delays_t delays = world->delays;
        sd_model_power_cycle(&world->card);
        world->card.is_absent = true;
        world->delays = delays;
    }
}
static void do_card_mute(world_t *world, uint64_t value) { world->card.is_mute = value != 0; }
static void do_card_refuse(world_t *world, uint64_t value)
{
    world->card.refuse_at = world->card.writes;
    world->card.refuse_times = (uint32_t)value;
}
static void do_card_mishear(world_t *world, uint64_t value) { world->card.mishear_at = world->card.writes + (uint32_t)value; }
static void do_card_hang(world_t *world, uint64_t value) { world->card.hang_at = world->card.writes + (uint32_t)value; }
static void do_card_misread(world_t *world, uint64_t value) { world->card.misread_at = world->card.reads + (uint32_t)value; }
static void do_card_no_crc(world_t *world, uint64_t value) { world->card.is_crc_unknown = value != 0; }
static void do_card_flip(world_t *world, uint64_t value) { world->card.flip_every = (uint32_t)value; }
static void do_card_flip_above(world_t *world, uint64_t value) { world->card.flip_above_hz = (uint32_t)value; }
static void do_card_protect(world_t *world, uint64_t value) { world->card.is_protected = value != 0; }
static void do_card_read(world_t *world, uint64_t value) { world->card.read_us = (uint32_t)value; }
static void do_card_stall(world_t *world, uint64_t value) { world->exact_stall_us = (uint32_t)value; }
static void do_card_other(world_t *world, uint64_t value)
{
    const sd_model_t card = world->card;
    (void)value;
    world->is_other_card = true;
    world->card = world->other_card;
    world->other_card = card;
    sd_model_power_cycle(&world->card);
}
static void do_card_busy(world_t *world, uint64_t value) { world->delays.busy_us = (uint32_t)value; }
static void do_stall(world_t *world, uint64_t value) { world->delays.stall_us = (uint32_t)value; }
static void do_who(world_t *world, uint64_t value) { world->imu.who_am_i = world->imu.registers[0x75] = (uint8_t)value; }
static void do_imu_absent(world_t *world, uint64_t value) { world->imu.is_absent = value != 0; }
static void do_imu_frozen(world_t *world, uint64_t value) { world->imu.is_frozen = value != 0; }
static void do_imu_stuck(world_t *world, uint64_t value) { world->imu.stuck_register = (uint8_t)value; }
static void do_mag_absent(world_t *world, uint64_t value) { world->imu.is_mag_absent = value != 0; }
static void do_mag_hang(world_t *world, uint64_t value) { world->imu.is_master_stuck = value != 0; }
static void do_mag_overflow(world_t *world, uint64_t value) { world->imu.mag_overflow_from_us = value ? world->now_us : NEVER; }
static void do_gps_absent(world_t *world, uint64_t value) { world->receiver.is_absent = value != 0; }
static void do_gps_deaf(world_t *world, uint64_t value) { world->receiver.is_deaf = value != 0; }
static void do_gps_chatter(world_t *world, uint64_t value) { world->receiver.chatter = (uint32_t)value; }
static void do_gps_garble(world_t *world, uint64_t value) { world->receiver.is_garbled = value != 0; }
static void do_gps_refuse(world_t *world, uint64_t value) { world->receiver.refuse_class_id = (uint32_t)value; }
static void do_gps_restart(world_t *world, uint64_t value)
{
    (void)value;
    neo_model_power_cycle(&world->receiver);
}
static void do_imu_wire(world_t *world, uint64_t value) { world->is_wire_broken = value == 0; }
static void do_imu_storm(world_t *world, uint64_t value)
{
    world->storm_us = (uint32_t)value;
    world->next_storm_us = world->now_us;
}
static void do_stick(world_t *world, uint64_t value)
{
    (void)value;
    world->machine.is_stuck_wanted = true;
    machine_attend(&world->machine);
}
static void do_lose(world_t *world, uint64_t value)
{
    (void)value;
    world->machine.is_lost_wanted = world->machine.is_fault_delivered = true;
    machine_attend(&world->machine);
}
/* A word of RAM: its offset in the upper half of the value. */
static void do_poke(world_t *world, uint64_t value)
{
    const uint32_t word = (uint32_t)value;
    if (value >> 32 <= RAM_BYTES - sizeof word)
        memcpy(world->machine.ram + (value >> 32), &word, sizeof word);
}
static void do_restart(world_t *world, uint64_t value)
{
    (void)value;
    world->is_restart_wanted = world->machine.is_reset_wanted = true;
}
static void do_type(world_t *world, uint64_t value)
{
    (void)value;
    world->typed = "selftest\r\n";
    world->next_typed_us = world->now_us;
}
static void do_crystal(world_t *world, uint64_t value) { world->chip.has_crystal = value != 0; }
static void do_measure(world_t *world, uint64_t value)
{
    (void)value;
    world->measured_from = world->machine.cycles;
    world->measured_slept = world->machine.slept;
    world->is_measuring = true;
    memset(world->machine.irqs, 0, sizeof world->machine.irqs);
}
static void do_measured(world_t *world, uint64_t value)
{
    (void)value;
    world->is_measuring = false;
    world->measured_until = world->machine.cycles;
    world->measured_slept = world->machine.slept - world->measured_slept;
}
static void do_cut(world_t *world, uint64_t value)
{
    world->is_cut_wanted = world->machine.is_reset_wanted = true;
    world->again_us = value;
}
static void do_end(world_t *world, uint64_t value)
{
    (void)value;
    world->machine.is_over = true;
}

static const verb_t verbs[] = {
    {"button", do_button},           {"supply_low", do_supply_low},   {"card_absent", do_card_absent},
    {"card_mute", do_card_mute},     {"card_refuse", do_card_refuse}, {"card_mishear", do_card_mishear},
    {"card_hang", do_card_hang},     {"card_misread", do_card_misread}, {"card_no_crc", do_card_no_crc},
    {"card_busy", do_card_busy},     {"stall", do_stall},             {"who", do_who},
    {"imu_absent", do_imu_absent},   {"imu_frozen", do_imu_frozen},   {"imu_stuck", do_imu_stuck},
    {"mag_absent", do_mag_absent},   {"mag_overflow", do_mag_overflow}, {"gps_absent", do_gps_absent},
    {"gps_deaf", do_gps_deaf},       {"gps_chatter", do_gps_chatter}, {"crystal", do_crystal},
    {"measure", do_measure},         {"measured", do_measured},       {"cut", do_cut},
    {"end", do_end},                 {"card_protect", do_card_protect}, {"card_read", do_card_read},
    {"card_stall", do_card_stall},   {"card_other", do_card_other},   {"gps_garble", do_gps_garble},
    {"imu_wire", do_imu_wire},       {"imu_storm", do_imu_storm},     {"stick", do_stick},
    {"restart", do_restart},         {"gps_refuse", do_gps_refuse},   {"gps_restart", do_gps_restart},
    {"lose", do_lose},               {"mag_hang", do_mag_hang},       {"type", do_type},
    {"poke", do_poke},               {"card_flip", do_card_flip},     {"card_flip_above", do_card_flip_above},
};

static void act(world_t *world, const char *line)
{
    char name[LONGEST_LINE];
    uint64_t value = 0;
    if (sscanf(line, "%119s %" SCNu64, name, &value) < 1)
        return;
    for (size_t i = 0; i < sizeof verbs / sizeof *verbs; i++)
        if (strcmp(verbs[i].name, name) == 0) {
            verbs[i].act(world, value);
            return;
        }
    fprintf(stderr, "script: unknown: %s\n", line);
    exit(2);
}

static uint64_t step_actions(world_t *world)
{
    if (world->is_child)
        return NEVER;
    while (world->action_at < world->action_count && world->actions[world->action_at].time_us <= world->now_us) {
        act(world, world->actions[world->action_at++].line);
    }
    return world->action_at < world->action_count ? world->actions[world->action_at].time_us : NEVER;
}

/* ---- time ---- */

static uint64_t step_imu(world_t *world)
{
    mpu_model_step(&world->imu);
    if (world->imu.sample_number != world->seen_samples) {
        world->seen_samples = world->imu.sample_number;
        if (mpu_model_has_sample(&world->imu) && !world->is_wire_broken) { /* the interrupt is switched on */
            world->edges++;
            chip_imu_edge(&world->chip);
        }
    }
    return world->imu.next_sample_us;
}

static uint64_t step_receiver(world_t *world)
{
    const uint32_t baud = chip_receiver_baud(&world->chip);
    uint8_t byte;
    uint64_t began_us;
    while (neo_model_next(&world->receiver, baud, &byte, &began_us))
        chip_receive(&world->chip, byte);
    const uint64_t due_us = neo_model_due_us(&world->receiver);
    if (world->receiver.is_absent)
        return world->now_us + 100000;
    return due_us > world->now_us ? due_us : world->now_us + 1;
}

/* A person at the serial adapter. */
static uint64_t step_typing(world_t *world)
{
    enum { LETTER_US = 2000 };
    if (!world->typed)
        return NEVER;
    if (world->now_us >= world->next_typed_us) {
        chip_hear(&world->chip, (uint8_t)*world->typed);
        world->typed = world->typed[1] ? world->typed + 1 : NULL;
        world->next_typed_us = world->now_us + LETTER_US;
    }
    return world->next_typed_us;
}

/* A pin that oscillates. */
static uint64_t step_storm(world_t *world)
{
    if (!world->storm_us)
        return NEVER;
    if (world->now_us >= world->next_storm_us) {
        world->next_storm_us = world->now_us + world->storm_us;
        chip_imu_edge(&world->chip);
    }
    return world->next_storm_us;
}

/* An interrupt that nobody asked for, of those that are switched on, at any cycle. */
static uint64_t step_spurious(world_t *world)
{
    if (!world->spurious_us)
        return NEVER;
    if (world->machine.cycles >= world->next_spurious) {
        const unsigned irq = (unsigned)(chance(world) * IRQS);
        if (world->machine.enabled >> irq & 1) {
            world->machine.pending |= 1ull << irq;
            world->machine.pending_since[irq] = world->machine.cycles;
            world->spurious++;
        }
        world->next_spurious = world->machine.cycles + 1 + exponential(world, world->spurious_us * CYCLES_PER_US);
    }
    return world->next_spurious;
}

static uint64_t earlier(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* In a copy whose power was cut: it may go once more, then the button is pressed, then the copy ends. */
static uint64_t step_afterwards(world_t *world)
{
    const uint64_t since_us = world->now_us - world->on_us, times[] = {AGAIN_PRESS_US, AGAIN_PRESS_US + PRESSED_US, AFTERWARDS_US};
    if (!world->is_child)
        return NEVER;
    if (world->again_us) {
        if (since_us < world->again_us)
            return world->on_us + world->again_us;
        world->is_cut_wanted = world->machine.is_reset_wanted = true;
        return world->now_us + 1;
    }
    world->is_pressed = since_us >= times[0] && since_us < times[1];
    world->machine.is_over |= since_us >= times[2];
    for (size_t i = 0; i < sizeof times / sizeof *times; i++)
        if (since_us < times[i])
            return world->on_us + times[i];
    return NEVER;
}

static uint64_t advance(void *context)
{
    world_t *world = of(context);
    world->now_us = world->machine.cycles / CYCLES_PER_US;
    const uint64_t chip_next = chip_advance(&world->chip);
    uint64_t next = earlier(step_imu(world), step_receiver(world));
    next = earlier(next, earlier(step_storm(world), step_typing(world)));
    const uint64_t spurious_next = step_spurious(world);
    next = earlier(next, earlier(step_actions(world), step_afterwards(world)));
    /* what came in by the steps may have brought something of the chip's nearer */
    const uint64_t chip_soon = earlier(earlier(chip_next, world->chip.idle_at), spurious_next);
    return earlier(chip_soon, next == NEVER ? NEVER : next * CYCLES_PER_US);
}

/* ---- resets and power ---- */

static void power_on(world_t *world)
{
    const mpu_model_t old = world->imu;
    memset(world->machine.ram, 0xA5, RAM_BYTES);
    sd_model_power_cycle(&world->card);
    sd_model_host_restarts(&world->card);
    world->card.flip_every = world->flip_every;
    mpu_model_init(&world->imu, &world->now_us);
    world->imu.who_am_i = world->imu.registers[0x75] = old.who_am_i ? old.who_am_i : 0x71;
    memset(world->imu.adjustment, 128, sizeof world->imu.adjustment); /* a field is measured as it is given */
    world->imu.feed = world->motion_count ? &world->feed : NULL;
    world->imu.next_sample_us = world->imu.feed ? next_sample_us(world, world->now_us) : world->imu.next_sample_us;
    world->seen_samples = 0;
    neo_model_power_cycle(&world->receiver);
    chip_reset(&world->chip, POWER_ON);
    machine_reset(&world->machine);
}

static void report_cut(const world_t *world, uint64_t cut_us)
{
    char path[LONGEST_PATH];
    snprintf(path, sizeof path, "%s/cut%05u", world->out, world->cuts);
    mkdir(path, 0777);
    snprintf(path, sizeof path, "%s/cut%05u/about.txt", world->out, world->cuts);
    FILE *file = fopen(path, "w");
    if (!file)
        exit(2);
    fprintf(file, "cut_us=%" PRIu64 "\nlast_write_us=%" PRIu64 "\nwrites=%u\nstall_from_us=%" PRIu64 "\nstall_until_us=%" PRIu64 "\n",
            cut_us, world->journal_writes ? world->journal[(world->journal_writes - 1) % JOURNAL].time_us : 0,
            world->card.writes, world->stall_from_us, world->stall_until_us);
    fclose(file);
}

/* The power goes, and comes back at once. */
static void lose_power(world_t *world)
{
    tear(world);
    world->journal_writes = 0; /* what has survived is on the medium */
    world->is_pressed = false;
    world->on_us = world->now_us;
    power_on(world);
}

/* The power goes in a copy of the world, which then starts anew; this one goes on. */
static void cut(world_t *world)
{
    char path[LONGEST_PATH];
    world->is_cut_wanted = false;
    if (world->is_child) {
        world->again_us = 0;
        lose_power(world);
        return;
    }
    world->cuts++;
    fflush(NULL);
    const pid_t child = fork();
    if (child != 0) {
        int status = 0;
        if (child < 0 || waitpid(child, &status, 0) < 0 || status != 0)
            machine_forbid(&world->machine, "a copy of the world after a power cut met a fault", world->out);
        return;
    }
    world->is_child = true;
    report_cut(world, world->now_us);
    snprintf(path, sizeof path, "%s/cut%05u/serial.txt", world->out, world->cuts);
    world->serial = fopen(path, "w");
    world->random += world->cuts;
    lose_power(world);
}

static void note_reset(world_t *world, const char *kind)
{
    if (world->serial)
        fprintf(world->serial, "\n[%s at %" PRIu64 " us]\n", kind, world->now_us);
}

static void reset(void *context)
{
    world_t *world = of(context);
    if (world->is_cut_wanted) {
        cut(world);
        return;
    }
    if (world->is_restart_wanted) {
        world->is_restart_wanted = false;
        note_reset(world, "power off and on");
        power_on(world);
        return;
    }
    const uint32_t cause = chip_reset_cause(&world->chip);
    world->resets++;
    note_reset(world, "reset");
    sd_model_host_restarts(&world->card);
    chip_reset(&world->chip, cause & 0x20 ? WATCHDOG : SOFTWARE);
    machine_reset(&world->machine);
}

static uint64_t levels(void *context) { return chip_levels(&of(context)->chip); }
static uint32_t read_bus(void *context, uint32_t address, unsigned size) { return chip_read(&of(context)->chip, address, size); }
static void write_bus(void *context, uint32_t address, unsigned size, uint32_t value)
{
    chip_write(&of(context)->chip, address, size, value);
}

static void sleep_bus(void *context)
{
    rules_sleep(&of(context)->chip);
}

/* ---- files ---- */

static uint8_t *read_all(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    if (!file)
        return NULL;
    fseek(file, 0, SEEK_END);
    *size = (size_t)ftell(file);
    rewind(file);
    uint8_t *bytes = calloc(1, *size + 1);
    const bool is_read = bytes && fread(bytes, 1, *size, file) == *size;
    fclose(file);
    return is_read ? bytes : NULL;
}

/* Three tables, each behind its length (8 bytes): 8 bytes of time with 12 and 6 of values, padded to 24 and 16; 8 bytes of
 * time and 512 of text. */
static int read_stimulus(world_t *world, const char *path)
{
    size_t size = 0;
    uint64_t counts[3];
    uint8_t *bytes = read_all(path, &size);
    if (!bytes || size < sizeof counts)
        return -1;
    memcpy(counts, bytes, sizeof counts);
    const size_t text = 520, needed = sizeof counts + counts[0] * sizeof(motion_t) + counts[1] * sizeof(field_t) + counts[2] * text;
    if (size != needed)
        return -1;
    const uint8_t *fixes = bytes + needed - counts[2] * text;
    world->motions = (motion_t *)(void *)(bytes + sizeof counts);
    world->fields = (field_t *)(void *)(world->motions + counts[0]);
    world->fixes = calloc(counts[2] + 1, sizeof *world->fixes);
    world->motion_count = counts[0];
    world->field_count = counts[1];
    world->fix_count = counts[2];
    for (size_t i = 0; world->fixes && i < counts[2]; i++) {
        memcpy(&world->fixes[i].time_us, fixes + i * text, 8);
        world->fixes[i].text = (const char *)fixes + i * text + 8;
    }
    return world->fixes ? 0 : -1;
}

static FILE *open_in(const char *folder, const char *name)
{
    char path[LONGEST_PATH];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return fopen(path, "w");
}

/* Settings stand before what happens: "set NAME VALUE"; then "TIME_US VERB VALUE" in order of time. */
static bool apply_setting(world_t *world, const char *name, uint64_t value)
{
    const struct {
        const char *name;
        uint32_t *place;
    } places[] = {{"busy_us", &world->delays.busy_us},           {"stall_us", &world->delays.stall_us},
                  {"stall_pause_us", &world->delays.stall_pause_us}, {"stall_rest_us", &world->delays.stall_rest_us},
                  {"cache", &world->cache},                      {"flip_every", &world->flip_every},
                                      {"spurious_us", &world->spurious_us},
                  {"clusters", &world->plan.clusters},           {"free_clusters", &world->plan.free_clusters},
                  {"free_run", &world->plan.free_run},           {"blank", &world->plan.is_blank}};
    for (size_t i = 0; i < sizeof places / sizeof *places; i++)
        if (strcmp(places[i].name, name) == 0) {
            *places[i].place = (uint32_t)value;
            return true;
        }
    if (strcmp(name, "seed") == 0)
        world->random = value;
    else if (strcmp(name, "probes") == 0)
        world->machine.probes = (unsigned)value;
    else if (strcmp(name, "list_writes") == 0)
        world->writes = open_in(world->out, "writes.txt");
    else
        return false;
    return true;
}

static int read_script(world_t *world, const char *path)
{
    char *config = world->plan.config;
    char line[LONGEST_LINE], name[LONGEST_LINE];
    uint64_t value;
    FILE *file = fopen(path, "r");
    if (!file)
        return -1;
    while (fgets(line, sizeof line, file)) {
        int at = 0;
        line[strcspn(line, "\n")] = 0;
        if (strncmp(line, "config ", 7) == 0) {
            (void)sscanf(line + 7, "stream_baud=%u", &world->stream_baud);
            strncat(config, line + 7, sizeof world->plan.config - strlen(config) - 2);
            strcat(config, "\n");
        } else if (sscanf(line, "set %119s %" SCNu64, name, &value) == 2) {
            if (!apply_setting(world, name, value))
                return -1;
        } else if (sscanf(line, "%" SCNu64 " %n", &value, &at) == 1) {
            world->actions = realloc(world->actions, (world->action_count + 1) * sizeof *world->actions);
            action_t *action = &world->actions[world->action_count++];
            action->time_us = value;
            snprintf(action->line, sizeof action->line, "%s", line + at);
        }
    }
    fclose(file);
    return 0;
}

static void make_card(world_t *world, sd_model_t *card)
{
    const card_plan_t *plan = &world->plan;
    const uint32_t sectors = first_file_sector(world) + (plan->clusters - 1) * CARD_CLUSTER_SECTORS;
    const fat_image_t layout = {.bits = 32, .cluster_sectors = CARD_CLUSTER_SECTORS, .free_clusters = plan->free_clusters,
                                .free_run = plan->free_run};
    sd_model_init(card, SD_MODEL_HC, sectors, &world->now_us);
    if (plan->is_blank)
        return;
    fat_format(card, &layout);
    fat_add_file(card, "MAG00001KLG", "calibrated before\n");
    if (*plan->config)
        fat_add_file(card, "CONFIG  TXT", plan->config);
}

int world_init(world_t *world, const char *image, const char *stimulus, const char *script, const char *out)
{
    size_t size = 0;
    uint8_t *bytes = read_all(image, &size);
    const pins_t pins = {world, card_byte, card_select, imu_transfer, to_receiver, to_serial, led, is_button_pressed, is_supply_low};
    memset(world, 0, sizeof *world);
    world->out = out;
    world->plan.clusters = USUAL_CLUSTERS;
    world->stream_baud = MESSAGES_BAUD;
    world->delays = (delays_t){.busy_us = 300, .stall_pause_us = 3000000, .stall_rest_us = 500000};
    if (!bytes || machine_init(&world->machine, bytes, size) || read_stimulus(world, stimulus) ||
        read_script(world, script))
        return -1;
    world->machine.bus = (bus_t){world, advance, levels, read_bus, write_bus, reset, sleep_bus};
    chip_init(&world->chip, &world->machine, &pins);
    make_card(world, &world->card);
    make_card(world, &world->other_card);
    neo_model_init(&world->receiver, &world->now_us);
    world->receiver.fixes = world->fixes;
    world->receiver.fix_count = world->fix_count;
    world->feed = (mpu_feed_t){world, next_sample_us, motion, next_mag_us, field};
    power_on(world);
    return 0;
}

static bool is_untouched(const sd_model_t *card, uint32_t sector)
{
    return !card->pages[(size_t)sector * SD_MODEL_SECTOR / SD_MODEL_PAGE];
}

/* Sparse, as the volume is. */
static int save_file(const sd_model_t *card, const char *path, const fat_file_t *file)
{
    FILE *to = fopen(path, "wb");
    if (!to)
        return -1;
    for (uint32_t done = 0; done < file->bytes; done += SD_MODEL_SECTOR) {
        const uint32_t left = file->bytes - done, sector = file->first_sector + done / SD_MODEL_SECTOR;
        if (is_untouched(card, sector))
            continue;
        fseek(to, (long)done, SEEK_SET);
        fwrite(sd_model_view(card, sector), 1, left < SD_MODEL_SECTOR ? left : SD_MODEL_SECTOR, to);
    }
    const int result = fflush(to) || ftruncate(fileno(to), (off_t)file->bytes);
    return fclose(to) || result ? -1 : 0;
}

/* Sparse: sectors of zeros are left out. */
static int save_volume(const sd_model_t *card, const char *path)
{
    static const uint8_t zeros[SD_MODEL_SECTOR];
    FILE *file = fopen(path, "wb");
    if (!file)
        return -1;
    for (uint32_t sector = PARTITION; sector < card->sectors; sector++) {
        if (is_untouched(card, sector))
            continue;
        const uint8_t *data = sd_model_view(card, sector);
        if (memcmp(data, zeros, sizeof zeros) == 0)
            continue;
        fseek(file, (long)(sector - PARTITION) * SD_MODEL_SECTOR, SEEK_SET);
        fwrite(data, SD_MODEL_SECTOR, 1, file);
    }
    const int result = ftruncate(fileno(file), (off_t)(card->sectors - PARTITION) * SD_MODEL_SECTOR);
    return fclose(file) || result ? -1 : 0;
}

/* A line for each file: name and length; and the recordings themselves. */
static int save_files(const sd_model_t *card, const char *out)
{
    char path[LONGEST_PATH];
    fat_file_t files[MOST_FILES];
    const size_t count = fat_list(card, files, MOST_FILES);
    FILE *list = open_in(out, "files.txt");
    int result = list ? 0 : -1;
    for (size_t i = 0; i < count && list; i++) {
        fprintf(list, "%s %u\n", files[i].name, files[i].bytes);
        if (strncmp(files[i].name + 8, "KLG", 3) != 0 || files[i].bytes == 0)
            continue;
        snprintf(path, sizeof path, "%s/%.8s.KLG", out, files[i].name);
        result |= save_file(card, path, &files[i]);
    }
    return list && fclose(list) == 0 ? result : -1;
}

static int save_card(const world_t *world, const sd_model_t *card, const char *out)
{
    char path[LONGEST_PATH];
    snprintf(path, sizeof path, "%s/card.img", out);
    mkdir(out, 0777);
    return (world->plan.is_blank ? 0 : save_files(card, out)) | save_volume(card, path);
}

int world_save(const world_t *world, const char *out)
{
    char path[LONGEST_PATH];
    const int result = save_card(world, &world->card, out);
    if (!world->is_other_card)
        return result;
    snprintf(path, sizeof path, "%s/other", out);
    return result | save_card(world, &world->other_card, path);
}

void world_report(const world_t *world)
{
    const machine_t *machine = &world->machine;
    const double us = CYCLES_PER_US, measured = (double)((world->is_measuring ? machine->cycles : world->measured_until) - world->measured_from);
    uint32_t word, free_words = 0, top;
    memcpy(&top, machine->flash, 4);
    for (; RAM_AT + 4 * free_words < top; free_words++) {
        memcpy(&word, machine->ram + 4 * free_words, 4);
        if (word != 0xC0FFEE11u)
            break;
    }
    const uint64_t slept = world->is_measuring ? machine->slept - world->measured_slept : world->measured_slept;
    unsigned executed, interrupted;
    machine_count_places(machine, &executed, &interrupted);
    printf("simulated_s=%.3f\n", (double)machine->cycles / us / 1e6);
    printf("places=%u\nplaces_interrupted=%u\nasked=%" PRIu64 "\n", executed, interrupted, machine->asked);
    printf("instructions=%" PRIu64 "\n", machine->instructions);
    printf("load=%.4f\n", measured > 0 ? 1.0 - (double)slept / measured : 0.0);
    printf("stack_used=%u\nstack_size=%u\n", top - RAM_AT - 4 * free_words, top - RAM_AT);
    printf("nested=%u\n", machine->deepest);
    for (int irq = 0; irq < IRQS; irq++)
        if (machine->irqs[irq].entries)
            printf("irq%d_entries=%" PRIu64 "\nirq%d_wait_us=%.2f\n", irq, machine->irqs[irq].entries, irq,
                   (double)machine->irqs[irq].worst_wait / us);
    printf("resets=%u\nwatchdog_resets=%u\nlongest_unfed_us=%.0f\n", world->resets, world->chip.watchdog_resets,
           (double)world->chip.longest_unfed / us);
    printf("watchdog_us=%.0f\n", (double)world->chip.watchdog_period / us);
    printf("writes=%u\nstalls=%u\nlongest_stall_us=%u\n", world->card.writes, world->stalls, world->longest_stall_us);
    printf("metadata_writes=%u\n", world->metadata_writes);
    printf("protocol_errors=%u\ncrc_errors=%u\nflips=%u\ncard_hz=%u\n", world->card.protocol_errors, world->card.crc_errors,
           world->card.flips, world->card.clock_hz);
    printf("imu_samples=%u\nimu_overruns=%u\nimu_fast_accesses=%u\n", world->imu.sample_number, world->imu.overruns,
           world->imu.fast_accesses);
    printf("sentences=%u\nspurious=%u\nled_changes=%u\ncuts=%u\n", world->receiver.sentences, world->spurious, world->led_changes, world->cuts);
    printf("fault=%s\nfault_pc=%08x\n", machine->fault, machine->fault_pc);
}
