#include "sd_model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Latencies of a card as they are sold; the specification allows 1 s, 8 bytes and 100 ms. */
enum { START_US = 50000, LONGEST_ANSWER_BYTES = 8, READ_US = 100, STOP_US = 1000, READY_DELAY_BYTES = 2 };
enum { WAKING_CLOCKS = 74, SLOW_HZ = 400000, FAST_HZ = 25000000 };

/* ---- medium ---- */

static size_t page_count(const sd_model_t *card)
{
    return ((size_t)card->sectors * SD_MODEL_SECTOR + SD_MODEL_PAGE - 1) / SD_MODEL_PAGE;
}

static uint8_t *sector_at(sd_model_t *card, uint32_t sector)
{
    const size_t at = (size_t)sector * SD_MODEL_SECTOR;
    uint8_t **page = &card->pages[at / SD_MODEL_PAGE];
    if (!*page)
        *page = calloc(1, SD_MODEL_PAGE);
    return *page + at % SD_MODEL_PAGE;
}

const uint8_t *sd_model_view(const sd_model_t *card, uint32_t sector)
{
    static const uint8_t empty[SD_MODEL_SECTOR];
    const size_t at = (size_t)sector * SD_MODEL_SECTOR;
    const uint8_t *page = card->pages[at / SD_MODEL_PAGE];
    return page ? page + at % SD_MODEL_PAGE : empty;
}

void sd_model_copy_medium(sd_model_t *card, const sd_model_t *from)
{
    for (size_t i = 0; i < page_count(card); i++) {
        if (from->pages[i]) {
            if (!card->pages[i])
                card->pages[i] = malloc(SD_MODEL_PAGE);
            memcpy(card->pages[i], from->pages[i], SD_MODEL_PAGE);
        } else {
            free(card->pages[i]);
            card->pages[i] = NULL;
        }
    }
}

void sd_model_peek(const sd_model_t *card, uint32_t sector, uint8_t *data)
{
    memcpy(data, sd_model_view(card, sector), SD_MODEL_SECTOR);
}

void sd_model_poke(sd_model_t *card, uint32_t sector, const uint8_t *data)
{
    memcpy(sector_at(card, sector), data, SD_MODEL_SECTOR);
}

int sd_model_save(const sd_model_t *card, const char *path)
{
    FILE *file = fopen(path, "wb");
    if (!file)
        return -1;
    int result = 0;
    for (size_t i = 0; i < page_count(card) && result == 0; i++) {
        if (!card->pages[i])
            continue;
        if (fseek(file, (long)(i * SD_MODEL_PAGE), SEEK_SET) || fwrite(card->pages[i], SD_MODEL_PAGE, 1, file) != 1)
            result = -1;
    }
    if (fseek(file, (long)card->sectors * SD_MODEL_SECTOR - 1, SEEK_SET))
        result = -1;
    const int last = fgetc(file);
    if (last == EOF && (fseek(file, (long)card->sectors * SD_MODEL_SECTOR - 1, SEEK_SET) || fputc(0, file) == EOF))
        result = -1;
    return fclose(file) ? -1 : result;
}

static void blame(sd_model_t *card, sd_model_flaw_t flaw)
{
    const bool is_host_misled = card->flip_every != 0;
    if (is_host_misled || (!card->is_awake && flaw != SD_MODEL_ASLEEP))
        return;
    card->protocol_errors += flaw != SD_MODEL_CHECKSUM;
    if (card->flaw == SD_MODEL_FINE)
        card->flaw = flaw;
}

static void forget_faults(sd_model_t *card)
{
    card->cut_at = card->refuse_at = card->mishear_at = card->hang_at = card->misread_at = SD_MODEL_INFINITE;
    card->torn_bytes = SD_MODEL_SECTOR;
    card->stall_every = SD_MODEL_INFINITE;
    card->busy_us = 300;
    card->read_us = READ_US;
    card->refuse_times = 1;
}

void sd_model_init(sd_model_t *card, sd_model_kind_t kind, uint32_t sectors, const uint64_t *now_us)
{
    *card = (sd_model_t){.kind = kind, .sectors = sectors, .now_us = now_us};
    card->pages = calloc(page_count(card), sizeof *card->pages);
    forget_faults(card);
}

void sd_model_free(sd_model_t *card)
{
    for (size_t i = 0; i < page_count(card); i++)
        free(card->pages[i]);
    free(card->pages);
}

void sd_model_power_cycle(sd_model_t *card)
{
    uint8_t **pages = card->pages;
    const uint32_t sectors = card->sectors;
    const sd_model_kind_t kind = card->kind;
    const uint64_t *now_us = card->now_us;
    const bool is_protected = card->is_protected, is_selected = card->is_selected;
    const uint32_t idle_clocks = card->idle_clocks; /* the host's doing: contacts may close in the middle of them */
    *card = (sd_model_t){.kind = kind, .sectors = sectors, .now_us = now_us, .pages = pages, .is_protected = is_protected,
                         .is_selected = is_selected, .idle_clocks = idle_clocks};
    forget_faults(card);
}

/* ---- sums ---- */

static uint8_t sum7(const uint8_t *bytes, size_t length)
{
    uint8_t crc = 0;
    for (size_t i = 0; i < 8 * length; i++) {
        const int bit = (bytes[i / 8] >> (7 - i % 8) & 1) ^ (crc >> 6 & 1);
        crc = (uint8_t)(crc << 1 & 0x7F);
        if (bit)
            crc ^= 0x09;
    }
    return (uint8_t)(crc << 1 | 1);
}

/* A byte at a time, by a table that long division fills on first use. */
static uint16_t sum16(const uint8_t *bytes, size_t length)
{
    static uint16_t table[256];
    if (!table[1])
        for (uint32_t i = 0; i < 256; i++) {
            uint32_t rest = i << 8;
            for (int bit = 0; bit < 8; bit++)
                rest = (rest << 1 ^ (rest & 0x8000 ? 0x1021 : 0)) & 0xFFFF;
            table[i] = (uint16_t)rest;
        }
    uint16_t crc = 0;
    for (size_t i = 0; i < length; i++)
        crc = (uint16_t)(crc << 8 ^ table[crc >> 8 ^ bytes[i]]);
    return crc;
}

/* ---- answers ---- */

static void say(sd_model_t *card, const uint8_t *bytes, size_t length)
{
    memcpy(card->out + card->out_length, bytes, length);
    card->out_length += length;
}

static void say_byte(sd_model_t *card, uint8_t byte)
{
    say(card, &byte, 1);
}

static uint8_t r1(const sd_model_t *card)
{
    return card->is_idle ? 0x01 : 0x00;
}

static void say_data(sd_model_t *card, const uint8_t *data, size_t length)
{
    const uint16_t crc = sum16(data, length);
    const uint8_t tail[2] = {(uint8_t)(crc >> 8), (uint8_t)crc};
    for (int i = 0; i < READY_DELAY_BYTES; i++)
        say_byte(card, 0xFF);
    say_byte(card, 0xFE);
    say(card, data, length);
    say(card, tail, 2);
}

static void say_csd(sd_model_t *card)
{
    uint8_t csd[16] = {0};
    if (card->kind == SD_MODEL_HC) {
        const uint32_t size = card->sectors / 1024 - 1;
        csd[0] = 0x40;
        csd[7] = (uint8_t)(size >> 16 & 0x3F);
        csd[8] = (uint8_t)(size >> 8);
        csd[9] = (uint8_t)size;
    } else { /* blocks of 1024, multiplier 512 */
        const uint32_t size = card->sectors / 1024 - 1;
        csd[5] = 10;
        csd[6] = (uint8_t)(size >> 10 & 3);
        csd[7] = (uint8_t)(size >> 2);
        csd[8] = (uint8_t)(size << 6);
        csd[9] = 7 >> 1;
        csd[10] = (uint8_t)(7 << 7);
    }
    csd[15] = sum7(csd, 15); /* the register has one of its own */
    say_data(card, csd, sizeof csd);
}

static bool find_sector(const sd_model_t *card, uint32_t argument, uint32_t *sector)
{
    *sector = card->kind == SD_MODEL_HC ? argument : argument / SD_MODEL_SECTOR;
    return *sector < card->sectors && (card->kind == SD_MODEL_HC || argument % SD_MODEL_SECTOR == 0);
}

static void read_sector(sd_model_t *card, uint32_t argument)
{
    uint8_t data[SD_MODEL_SECTOR];
    uint32_t sector;
    if (!find_sector(card, argument, &sector)) {
        say_byte(card, 0x40);
        return;
    }
    say_byte(card, 0x00);
    sd_model_peek(card, sector, data);
    card->held_at = card->out_length;
    card->held_until_us = *card->now_us + card->read_us;
    say_data(card, data, sizeof data);
    if (card->reads++ == card->misread_at)
        card->out[card->out_length - 100] ^= 0x10;
}

static void begin_write(sd_model_t *card, uint32_t argument, bool is_multiple)
{
    if (!find_sector(card, argument, &card->address)) {
        say_byte(card, 0x40);
        return;
    }
    say_byte(card, 0x00);
    card->is_multiple = is_multiple;
    card->is_waiting_for_token = true;
}

/* ---- commands ---- */

static void go_idle(sd_model_t *card)
{
    card->is_idle = true;
    if (!card->is_awake && card->idle_clocks < WAKING_CLOCKS)
        blame(card, SD_MODEL_ASLEEP);
    card->is_awake = true;
    card->is_ready = card->has_crc = false;
    card->started_us = 0;
    card->busy_until_us = 0;
    card->status = 0;
    card->is_waiting_for_token = card->is_receiving = false;
    say_byte(card, 0x01);
}

static void run_app_command(sd_model_t *card, uint8_t index, uint32_t argument)
{
    if (index != 41) {
        say_byte(card, r1(card) | 0x04);
        return;
    }
    const bool wants_hc = (argument & 0x40000000) != 0;
    if (card->started_us == 0)
        card->started_us = *card->now_us + 1;
    const bool has_started = *card->now_us >= card->started_us + START_US && !card->is_mute;
    if (has_started && (card->kind != SD_MODEL_HC || wants_hc))
        card->is_idle = false;
    card->is_ready = !card->is_idle;
    say_byte(card, r1(card));
}

static void run_command(sd_model_t *card, uint8_t index, uint32_t argument)
{
    const uint8_t ocr[4] = {card->kind == SD_MODEL_HC && card->is_ready ? 0xC0 : 0x80, 0xFF, 0x80, 0x00};
    const uint8_t echo[4] = {0, 0, (uint8_t)(argument >> 8 & 15), (uint8_t)argument};
    if (card->is_waiting_for_token && index != 0 && index != 12 && index != 13)
        blame(card, SD_MODEL_DISORDER);
    if (index >= 9 && index < 41 && index != 12 && !card->is_ready) {
        blame(card, SD_MODEL_DISORDER);
        say_byte(card, 0x05); /* illegal in the idle state */
        return;
    }
    switch (index) {
    case 0:
        card->is_spi = true;
        go_idle(card);
        break;
    case 8:
        say_byte(card, card->kind == SD_MODEL_V1 ? r1(card) | 0x04 : r1(card));
        if (card->kind != SD_MODEL_V1)
            say(card, echo, 4);
        break;
    case 9:
        say_byte(card, r1(card));
        say_csd(card);
        break;
    case 12:
        card->is_waiting_for_token = false;
        card->out_length = card->out_at = 0;
        say_byte(card, 0xFF);
        say_byte(card, r1(card));
        break;
    case 13:
        say_byte(card, r1(card));
        say_byte(card, card->status);
        card->status = 0;
        break;
    case 16:
        say_byte(card, argument == SD_MODEL_SECTOR ? r1(card) : 0x40);
        break;
    case 17:
        read_sector(card, argument);
        break;
    case 24:
    case 25:
        begin_write(card, argument, index == 25);
        break;
    case 55:
        card->is_app = true;
        say_byte(card, r1(card));
        break;
    case 58:
        say_byte(card, r1(card));
        say(card, ocr, 4);
        break;
    case 59:
        card->has_crc = !card->is_crc_unknown && (argument & 1);
        say_byte(card, card->is_crc_unknown ? r1(card) | 0x04 : r1(card));
        break;
    default:
        say_byte(card, r1(card) | 0x04);
        break;
    }
}

static void hear_wrong(sd_model_t *card)
{
    card->crc_errors++;
    if (!card->is_disturbed)
        blame(card, SD_MODEL_CHECKSUM);
}

static void take_command(sd_model_t *card)
{
    const uint8_t index = card->command[0] & 0x3F;
    const uint32_t argument = (uint32_t)card->command[1] << 24 | (uint32_t)card->command[2] << 16 |
                              (uint32_t)card->command[3] << 8 | card->command[4];
    const bool is_sum_wrong = sum7(card->command, 5) != card->command[5];
    const bool is_app = card->is_app;
    card->command_length = 0;
    if (!card->is_spi && (index != 0 || is_sum_wrong))
        return; /* until its first CMD0 it listens on other wires */
    card->commands++;
    card->out_length = card->out_at = 0;
    card->held_until_us = 0;
    card->is_app = false;
    for (uint32_t i = 0; i <= card->commands % LONGEST_ANSWER_BYTES; i++) /* N_CR */
        say_byte(card, 0xFF);
    if (is_sum_wrong && (card->has_crc || index == 0 || index == 8)) {
        hear_wrong(card);
        say_byte(card, r1(card) | 0x08);
    } else if (is_app) {
        run_app_command(card, index, argument);
    } else {
        run_command(card, index, argument);
    }
    card->is_disturbed = false;
}

/* ---- writing ---- */

static void lose_power(sd_model_t *card)
{
    uint8_t *stored = sector_at(card, card->address);
    memcpy(stored, card->in, card->torn_bytes);
    card->is_cut = true;
}

static uint8_t store(sd_model_t *card)
{
    if (card->is_protected) {
        card->status = 0x20; /* write protect violation */
        return 0x0D;
    }
    const uint32_t number = card->writes++;
    if (number >= card->refuse_at && number < card->refuse_at + card->refuse_times) {
        card->status = 0x04; /* error */
        return 0x0D;
    }
    if (number == card->cut_at) {
        lose_power(card);
        return 0xFF;
    }
    memcpy(sector_at(card, card->address), card->in, SD_MODEL_SECTOR);
    const bool is_stalled = (number + 1) % card->stall_every == 0;
    card->busy_until_us = *card->now_us + (is_stalled ? card->stall_us : card->busy_us);
    if (number == card->hang_at)
        card->busy_until_us = UINT64_MAX;
    card->address++;
    return 0x05;
}

static void take_block(sd_model_t *card)
{
    card->is_receiving = false;
    card->is_waiting_for_token = card->is_multiple;
    if (card->writes == card->mishear_at) {
        card->mishear_at = SD_MODEL_INFINITE;
        card->in[77] ^= 4;
        card->is_disturbed = true;
    }
    const uint16_t sent = (uint16_t)(card->in[SD_MODEL_SECTOR] << 8 | card->in[SD_MODEL_SECTOR + 1]);
    card->out_length = card->out_at = 0;
    const bool is_sum_wrong = card->has_crc && sent != sum16(card->in, SD_MODEL_SECTOR);
    if (is_sum_wrong) {
        hear_wrong(card);
        say_byte(card, 0xEB);
    }
    card->is_disturbed = false;
    if (is_sum_wrong)
        return;
    if (card->address >= card->sectors) {
        card->status = 0x80;
        say_byte(card, 0xED);
        return;
    }
    say_byte(card, (uint8_t)(0xE0 | store(card)));
}

static void take_token(sd_model_t *card, uint8_t byte)
{
    if (byte == 0xFF)
        return;
    if (card->is_multiple && byte == 0xFD) {
        card->is_waiting_for_token = false;
        card->busy_until_us = *card->now_us + STOP_US;
        card->out_length = card->out_at = 0;
        say_byte(card, 0xFF); /* one byte, then busy */
    } else if (byte == (card->is_multiple ? 0xFC : 0xFE)) {
        card->is_receiving = true;
        card->in_length = 0;
    } else {
        blame(card, SD_MODEL_TOKEN);
    }
}

/* ---- the wire ---- */

void sd_model_host_restarts(sd_model_t *card)
{
    card->is_awake = false;
    sd_model_select(card, false);
    card->idle_clocks = 0;
}

void sd_model_select(sd_model_t *card, bool is_selected)
{
    const bool is_within = card->command_length || (card->is_receiving && card->in_length < sizeof card->in);
    if (card->is_selected && !is_selected && is_within && !card->is_absent)
        blame(card, SD_MODEL_LET_GO);
    if (card->is_selected && !is_selected)
        card->idle_clocks = 0;
    card->is_selected = is_selected;
    if (!is_selected) {
        card->command_length = 0;
        card->out_length = card->out_at = 0;
    }
}

static uint8_t answer(sd_model_t *card)
{
    if (card->out_at < card->out_length && card->out_at == card->held_at && *card->now_us < card->held_until_us)
        return 0xFF;
    if (card->out_at < card->out_length)
        return card->out[card->out_at++];
    if (!card->is_receiving && *card->now_us < card->busy_until_us)
        return 0x00;
    return 0xFF;
}

/* What becomes of a byte on the way: xorshift says whether one bit of it is flipped, and which. */
static uint8_t carry(sd_model_t *card, uint8_t byte)
{
    if (card->flip_every == 0 || card->clock_hz <= card->flip_above_hz)
        return byte;
    card->chance = card->chance ? card->chance : 2463534242u;
    card->chance ^= card->chance << 13;
    card->chance ^= card->chance >> 17;
    card->chance ^= card->chance << 5;
    if (card->chance % card->flip_every)
        return byte;
    card->flips++;
    return byte ^ (uint8_t)(1u << (card->chance >> 24 & 7));
}

/* The card hears a byte. */
static void hear(sd_model_t *card, uint8_t out)
{
    const bool is_busy = *card->now_us < card->busy_until_us;
    if (card->is_receiving) {
        card->in[card->in_length++] = out;
        if (card->in_length == sizeof card->in)
            take_block(card);
    } else if (card->is_waiting_for_token && !is_busy && !card->command_length && (out & 0xC0) != 0x40) {
        take_token(card, out);
    } else if (card->command_length || (out & 0xC0) == 0x40) {
        if (is_busy && (card->command_length ? card->command[0] : out) != 0x40)
            blame(card, SD_MODEL_IN_BUSY); /* only a reset may be sent to a busy card */
        card->command[card->command_length++] = out;
        if (card->command_length == sizeof card->command)
            take_command(card);
    }
}

uint8_t sd_model_exchange(sd_model_t *card, uint8_t out)
{
    card->idle_clocks += card->is_selected ? 0 : 8;
    if (card->is_absent || card->is_cut || !card->is_selected)
        return 0xFF;
    if (card->clock_hz > (card->is_ready ? FAST_HZ : SLOW_HZ))
        blame(card, SD_MODEL_TOO_FAST);
    const uint8_t in = answer(card);
    hear(card, carry(card, out));
    return carry(card, in);
}
