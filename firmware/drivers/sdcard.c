#include "sdcard.h"

enum {
    CMD_GO_IDLE = 0,
    CMD_SEND_IF_COND = 8,
    CMD_SEND_CSD = 9,
    CMD_STOP_TRANSMISSION = 12,
    CMD_SEND_STATUS = 13,
    CMD_SET_BLOCKLEN = 16,
    CMD_READ_SINGLE = 17,
    CMD_WRITE_SINGLE = 24,
    CMD_WRITE_MULTIPLE = 25,
    CMD_APP = 55,
    CMD_READ_OCR = 58,
    CMD_CRC_ON_OFF = 59,
    ACMD_SEND_OP_COND = 41,
};

enum {
    R1_IDLE = 0x01,
    R1_ILLEGAL = 0x04,
    R1_CRC = 0x08,
    TOKEN_SINGLE = 0xFE, /* before the data of CMD9, 17, 24 */
    TOKEN_MULTIPLE = 0xFC,
    TOKEN_STOP = 0xFD,
    RESPONSE_MASK = 0x1F,
    RESPONSE_ACCEPTED = 0x05,
    RESPONSE_BAD_CRC = 0x0B,
    READY = 0xFF,
    ANSWER_BYTES = 10,   /* a command is answered within 8 */
    RESPONSE_BYTES = 4,  /* a data block is answered at once; leave room for a slow one */
    GO_IDLE_TRIES = 10,
    SPIN_US = 300,       /* most cards have a sector ready by then, and a sleep may last 500 */
    POLL_BYTES = 8,      /* looked at by one sd_stream_poll */
    STRAIN_OF_DAMAGE = 16, /* one block in seventeen may be damaged for ever */
    STRAIN_MOST = 100,
    OCR_HIGH_CAPACITY = 0x40,
    CHECK_PATTERN = 0x1AA /* 2.7-3.6 V, and a pattern to come back */
};

uint8_t sd_crc7(const uint8_t *data, size_t length)
{
    uint8_t crc = 0;
    for (size_t i = 0; i < length; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (uint8_t)(crc & 0x80 ? crc << 1 ^ 0x09 << 1 : crc << 1);
    }
    return crc | 1;
}

/* Eight steps of the division at once: the polynomial has so few bits that their sum is three shifts. */
uint16_t sd_crc16(const uint8_t *data, size_t length)
{
    uint32_t crc = 0;
    for (size_t i = 0; i < length; i++) {
        uint32_t x = (crc >> 8 ^ data[i]) & 0xFF;
        x ^= x >> 4;
        crc = (crc << 8 ^ x << 12 ^ x << 5 ^ x) & 0xFFFF;
    }
    return (uint16_t)crc;
}

/* ---- bytes ---- */

static int receive(sd_card_t *card, uint8_t *in, size_t length)
{
    return card->bus->exchange(card->bus->context, NULL, in, length) < 0 ? SD_BUS : SD_OK;
}

static int send(sd_card_t *card, const uint8_t *out, size_t length)
{
    return card->bus->exchange(card->bus->context, out, NULL, length) < 0 ? SD_BUS : SD_OK;
}

static uint64_t now(const sd_card_t *card)
{
    return card->bus->now_us(card->bus->context);
}

/* Receive until a byte is (is_wanted) or is not FF; the byte goes to *found. */
static int receive_until(sd_card_t *card, bool is_ready_wanted, uint32_t longest_us, uint8_t *found)
{
    const uint64_t since = now(card);
    for (;;) {
        const bool is_last = now(card) - since > longest_us;
        uint8_t bytes[POLL_BYTES];
        for (size_t i = 0; i < sizeof bytes; i++) {
            if (receive(card, found, 1) < 0)
                return SD_BUS;
            if ((*found == READY) == is_ready_wanted)
                return SD_OK;
        }
        if (is_last)
            return SD_TIMEOUT;
        if (now(card) - since > SPIN_US)
            card->bus->wait(card->bus->context);
    }
}

/* Run one background transfer to its end. */
static int transfer(sd_card_t *card, const uint8_t *out, uint8_t *in, size_t length)
{
    const sd_bus_t *bus = card->bus;
    if (bus->start(bus->context, out, in, length) < 0)
        return SD_BUS;
    const uint64_t since = now(card);
    for (;;) {
        const bool is_last = now(card) - since > SD_READ_LONGEST_US;
        const int done = bus->is_done(bus->context);
        if (done != 0)
            return done < 0 ? SD_BUS : SD_OK;
        if (is_last)
            return SD_BUS;
        bus->wait(bus->context);
    }
}

static void release(sd_card_t *card)
{
    uint8_t last;
    card->bus->select(card->bus->context, false);
    (void)receive(card, &last, 1); /* eight clocks let the card go of its output; nothing is expected, so no error either */
}

/* ---- commands ---- */

/* Send a command to the selected card; its R1 goes to *r1. */
static int command(sd_card_t *card, uint8_t index, uint32_t argument, uint8_t *r1)
{
    uint8_t frame[7] = {READY, (uint8_t)(0x40 | index), (uint8_t)(argument >> 24), (uint8_t)(argument >> 16),
                        (uint8_t)(argument >> 8), (uint8_t)argument};
    frame[6] = sd_crc7(frame + 1, 5);
    if (send(card, frame, sizeof frame) < 0)
        return SD_BUS;
    if (index == CMD_STOP_TRANSMISSION && receive(card, r1, 1) < 0)
        return SD_BUS;
    for (int i = 0; i < ANSWER_BYTES; i++) {
        if (receive(card, r1, 1) < 0)
            return SD_BUS;
        if (!(*r1 & 0x80))
            return SD_OK;
    }
    return SD_NO_ANSWER;
}

/* ---- trying again ---- */

/* What was disturbed on the wire or refused may go well the next time; a card that is silent for long will not. */
static bool is_worth_another(int result)
{
    return result == SD_BAD_CRC || result == SD_NO_ANSWER || result == SD_REFUSED || result == SD_WRITE_FAILED;
}

static void note_success(sd_card_t *card)
{
    if (card->strain > 0)
        card->strain--;
}

static bool slow_down(sd_card_t *card)
{
    card->strain = 0;
    if (card->speed >= SD_QUARTER)
        return false;
    card->speed++;
    card->bus->set_speed(card->bus->context, card->speed);
    return true;
}

/* Whether to try again what failed. Where damaged bytes come faster than successes forgive them, or nothing else comes, the
 * clock is too fast for the wires. */
static bool may_try_again(sd_card_t *card, int error, uint8_t *tries)
{
    if (!is_worth_another(error))
        return false;
    card->error = error;
    card->retries++;
    ++*tries;
    if (error == SD_BAD_CRC)
        card->strain += STRAIN_OF_DAMAGE;
    const bool is_slowed = error == SD_BAD_CRC && (card->strain > STRAIN_MOST || *tries >= SD_TRIES) && slow_down(card);
    if (is_slowed)
        *tries = 0;
    return *tries < SD_TRIES;
}

/* A command without data, while the card starts. */
static int ask(sd_card_t *card, uint8_t index, uint32_t argument, uint8_t *r1)
{
    int result = SD_NO_ANSWER;
    for (int i = 0; i < SD_TRIES && is_worth_another(result); i++) {
        result = command(card, index, argument, r1);
        if (result == SD_OK && *r1 & R1_CRC)
            result = SD_BAD_CRC;
    }
    return result;
}

/* Select the card, wait until it is not busy, send a command that must be answered with 0. */
static int command_ok(sd_card_t *card, uint8_t index, uint32_t argument)
{
    uint8_t byte;
    card->bus->select(card->bus->context, true);
    int result = receive_until(card, true, SD_BUSY_LONGEST_US, &byte);
    if (result == SD_OK)
        result = command(card, index, argument, &byte);
    if (result != SD_OK)
        return result;
    if (byte & R1_CRC)
        return SD_BAD_CRC;
    return byte == 0 ? SD_OK : SD_REFUSED;
}

/* Receive a data block of `length` bytes (16 or 512) with its token and CRC. */
static int receive_data(sd_card_t *card, uint8_t *data, size_t length)
{
    uint8_t byte, crc[2];
    int result = receive_until(card, false, SD_READ_LONGEST_US, &byte);
    if (result != SD_OK)
        return result;
    if (byte != TOKEN_SINGLE)
        return SD_REFUSED;
    result = transfer(card, NULL, data, length);
    if (result == SD_OK)
        result = receive(card, crc, sizeof crc);
    if (result != SD_OK)
        return result;
    if (card->has_crc && sd_crc16(data, length) != (uint16_t)(crc[0] << 8 | crc[1]))
        return SD_BAD_CRC;
    return SD_OK;
}

static uint32_t address(const sd_card_t *card, uint32_t sector)
{
    return card->has_sector_addresses ? sector : sector * SD_SECTOR;
}

/* ---- start-up ---- */

/* A controller that was reset in the middle of a write left the card waiting for the rest: give it that, and the end. */
static int finish_old_write(sd_card_t *card)
{
    static const uint8_t stop[2] = {TOKEN_STOP, READY};
    uint8_t byte;
    card->bus->select(card->bus->context, true);
    for (int i = 0; i < SD_SECTOR + 8; i++)
        if (receive(card, &byte, 1) < 0)
            return SD_BUS;
    if (send(card, stop, sizeof stop) < 0)
        return SD_BUS;
    return receive_until(card, true, SD_BUSY_LONGEST_US, &byte);
}

static int go_idle(sd_card_t *card)
{
    uint8_t byte;
    for (int i = 0; i < GO_IDLE_TRIES; i++) {
        card->bus->select(card->bus->context, false);
        for (int clocks = 0; clocks < 80; clocks += 8)
            if (receive(card, &byte, 1) < 0)
                return SD_BUS;
        card->bus->select(card->bus->context, true);
        int result = command(card, CMD_GO_IDLE, 0, &byte);
        if (result == SD_OK && byte == R1_IDLE)
            return SD_OK;
        if (result == SD_BUS)
            return result;
        if (i == 1) { /* not at the first: most often there is just no card */
            result = finish_old_write(card);
            if (result != SD_OK)
                return result;
        }
        card->bus->wait(card->bus->context);
    }
    return SD_NO_ANSWER;
}

/* CMD8: tells v2 cards from v1, which do not know it. */
static int ask_version(sd_card_t *card, bool *is_v2)
{
    uint8_t r1, echo[4];
    int result = ask(card, CMD_SEND_IF_COND, CHECK_PATTERN, &r1);
    if (result != SD_OK)
        return result;
    *is_v2 = !(r1 & R1_ILLEGAL);
    if (!*is_v2)
        return SD_OK;
    result = receive(card, echo, sizeof echo);
    if (result != SD_OK)
        return result;
    return (echo[2] & 15) == (CHECK_PATTERN >> 8) && echo[3] == (CHECK_PATTERN & 0xFF) ? SD_OK : SD_UNSUPPORTED;
}

/* Switch the CRCs on. One "illegal" may be a flipped bit, five are a card that has none. */
static int switch_crc_on(sd_card_t *card)
{
    uint8_t r1 = R1_ILLEGAL;
    int result = SD_OK;
    for (int i = 0; i < SD_TRIES && result == SD_OK && r1 & R1_ILLEGAL; i++)
        result = ask(card, CMD_CRC_ON_OFF, 1, &r1);
    card->has_crc = !(r1 & R1_ILLEGAL);
    return result;
}

/* ACMD41 until the card has started. */
static int start_up(sd_card_t *card, bool is_v2)
{
    const uint64_t since = now(card);
    for (;;) {
        const bool is_last = now(card) - since > SD_START_LONGEST_US;
        uint8_t r1;
        int result = ask(card, CMD_APP, 0, &r1);
        if (result == SD_OK)
            result = command(card, ACMD_SEND_OP_COND, is_v2 ? 0x40000000 : 0, &r1);
        if (result == SD_OK && r1 == 0)
            return SD_OK;
        if (result == SD_OK && is_last)
            return r1 & R1_ILLEGAL ? SD_UNSUPPORTED : SD_TIMEOUT;
        if (result == SD_BUS || is_last)
            return result;
        card->bus->wait(card->bus->context);
    }
}

static int ask_addressing(sd_card_t *card)
{
    uint8_t r1, ocr[4];
    int result = ask(card, CMD_READ_OCR, 0, &r1);
    if (result == SD_OK)
        result = receive(card, ocr, sizeof ocr);
    if (result != SD_OK)
        return result;
    card->has_sector_addresses = (ocr[0] & OCR_HIGH_CAPACITY) != 0;
    return card->has_sector_addresses ? SD_OK : command_ok(card, CMD_SET_BLOCKLEN, SD_SECTOR);
}

static int receive_csd(sd_card_t *card, uint8_t csd[16])
{
    int result = command_ok(card, CMD_SEND_CSD, 0);
    if (result == SD_OK)
        result = receive_data(card, csd, 16);
    release(card);
    return result;
}

/* CSD, 5.3: the size of the card. Its version says once more, and under a CRC, how sectors are addressed: a flipped bit
 * of the OCR, which has none, would write all over the card. */
static int ask_size(sd_card_t *card)
{
    uint8_t csd[16];
    uint8_t tries = 0;
    int result = receive_csd(card, csd);
    while (may_try_again(card, result, &tries))
        result = receive_csd(card, csd);
    if (result != SD_OK)
        return result;
    if ((csd[0] >> 6 == 1) != card->has_sector_addresses)
        return SD_BAD_CRC;
    if (csd[0] >> 6) {
        card->sectors = (((csd[7] & 0x3Fu) << 16 | (uint32_t)csd[8] << 8 | csd[9]) + 1) * 1024;
        return SD_OK;
    }
    const uint32_t size = (csd[6] & 3u) << 10 | (uint32_t)csd[7] << 2 | csd[8] >> 6;
    const uint32_t shift = ((csd[9] & 3u) << 1 | csd[10] >> 7) + 2u + (csd[5] & 15u);
    if (shift < 9 || shift > 9 + 12)
        return SD_UNSUPPORTED;
    card->sectors = (size + 1) << (shift - 9);
    return SD_OK;
}

static int identify(sd_card_t *card)
{
    bool is_v2 = false;
    int result = go_idle(card);
    if (result == SD_OK)
        result = switch_crc_on(card);
    if (result == SD_OK)
        result = ask_version(card, &is_v2);
    if (result == SD_OK)
        result = start_up(card, is_v2);
    if (result != SD_OK)
        return result;
    card->has_sector_addresses = false;
    if (is_v2)
        result = ask_addressing(card);
    else
        result = command_ok(card, CMD_SET_BLOCKLEN, SD_SECTOR);
    if (result != SD_OK)
        return result;
    card->bus->set_speed(card->bus->context, card->speed);
    return ask_size(card);
}

static int fail(sd_card_t *card, int error)
{
    if (error != SD_OK)
        card->error = error;
    return error;
}

int sd_open_again(sd_card_t *card)
{
    int result = SD_BAD_CRC;
    card->state = SD_CLOSED;
    card->block = NULL;
    for (int i = 0; i < 2 && is_worth_another(result); i++) {
        card->bus->set_speed(card->bus->context, SD_START_UP);
        result = identify(card);
        release(card);
    }
    if (result == SD_OK)
        card->state = SD_IDLE;
    return fail(card, result);
}

int sd_open(sd_card_t *card, const sd_bus_t *bus)
{
    *card = (sd_card_t){.bus = bus, .speed = SD_FAST};
    return sd_open_again(card);
}

/* ---- sectors ---- */

static int check_range(const sd_card_t *card, uint32_t sector, uint32_t count)
{
    const bool is_inside = sector < card->sectors && count <= card->sectors - sector;
    return card->state == SD_IDLE && is_inside ? SD_OK : SD_MISUSE;
}

static int read_one(sd_card_t *card, uint32_t sector, uint8_t *data)
{
    int result = command_ok(card, CMD_READ_SINGLE, address(card, sector));
    if (result == SD_OK)
        result = receive_data(card, data, SD_SECTOR);
    release(card);
    return result;
}

int sd_read(sd_card_t *card, uint32_t sector, uint8_t *data, uint32_t count)
{
    int result = check_range(card, sector, count);
    for (uint32_t i = 0; i < count && result == SD_OK; i++) {
        uint8_t tries = 0;
        result = read_one(card, sector + i, data + (size_t)i * SD_SECTOR);
        while (may_try_again(card, result, &tries))
            result = read_one(card, sector + i, data + (size_t)i * SD_SECTOR);
        note_success(card);
    }
    return fail(card, result);
}

/* Send what stands after the data of a block and read what the card makes of it. */
static int finish_block(sd_card_t *card, uint16_t crc)
{
    const uint8_t sent[2] = {(uint8_t)(crc >> 8), (uint8_t)crc};
    uint8_t byte = READY;
    if (send(card, sent, sizeof sent) < 0)
        return SD_BUS;
    for (int i = 0; i < RESPONSE_BYTES && byte == READY; i++)
        if (receive(card, &byte, 1) < 0)
            return SD_BUS;
    if (byte == READY)
        return SD_NO_ANSWER;
    switch (byte & RESPONSE_MASK) {
    case RESPONSE_ACCEPTED:
        return SD_OK;
    case RESPONSE_BAD_CRC:
        return SD_BAD_CRC;
    default:
        return SD_WRITE_FAILED;
    }
}

static int write_one(sd_card_t *card, uint32_t sector, const uint8_t *data)
{
    static const uint8_t start[2] = {READY, TOKEN_SINGLE};
    uint8_t byte;
    int result = command_ok(card, CMD_WRITE_SINGLE, address(card, sector));
    if (result == SD_OK)
        result = send(card, start, sizeof start);
    if (result == SD_OK)
        result = transfer(card, data, NULL, SD_SECTOR);
    if (result == SD_OK)
        result = finish_block(card, sd_crc16(data, SD_SECTOR));
    if (result == SD_OK)
        result = receive_until(card, true, SD_BUSY_LONGEST_US, &byte);
    release(card);
    return result == SD_OK ? sd_check(card) : result;
}

int sd_write(sd_card_t *card, uint32_t sector, const uint8_t *data, uint32_t count)
{
    int result = check_range(card, sector, count);
    for (uint32_t i = 0; i < count && result == SD_OK; i++) {
        uint8_t tries = 0;
        result = write_one(card, sector + i, data + (size_t)i * SD_SECTOR);
        while (may_try_again(card, result, &tries))
            result = write_one(card, sector + i, data + (size_t)i * SD_SECTOR);
        note_success(card);
    }
    return fail(card, result);
}

/* CMD13: reading the state clears it, so a state that was read is not asked for again. */
static int ask_status(sd_card_t *card)
{
    int result = SD_NO_ANSWER;
    uint8_t second = 0;
    for (int i = 0; i < SD_TRIES && is_worth_another(result); i++) {
        result = command_ok(card, CMD_SEND_STATUS, 0);
        if (result == SD_OK)
            result = receive(card, &second, 1);
        release(card);
    }
    if (result == SD_OK && second != 0)
        result = second == READY ? SD_NO_ANSWER : SD_WRITE_FAILED;
    return result;
}

int sd_check(sd_card_t *card)
{
    return card->state == SD_IDLE ? fail(card, ask_status(card)) : SD_MISUSE;
}

/* ---- the stream ---- */

/* Give up a stream: the card is to be opened anew. */
static int stream_fail(sd_card_t *card, int error)
{
    release(card);
    card->state = SD_CLOSED;
    card->block = NULL;
    return fail(card, error);
}

static int begin_write(sd_card_t *card)
{
    const int result = command_ok(card, CMD_WRITE_MULTIPLE, address(card, card->sector));
    if (result != SD_OK)
        return result;
    card->state = SD_STREAM_READY;
    card->opened_us = now(card);
    return SD_OK;
}

int sd_stream_open(sd_card_t *card, uint32_t sector)
{
    int result = check_range(card, sector, 1);
    if (result != SD_OK)
        return result;
    card->sector = sector;
    card->block = NULL;
    card->tries = 0;
    result = begin_write(card);
    while (may_try_again(card, result, &card->tries)) {
        release(card);
        result = begin_write(card);
    }
    card->tries = 0;
    return result == SD_OK ? SD_OK : stream_fail(card, result);
}

static int send_block(sd_card_t *card)
{
    static const uint8_t start[2] = {READY, TOKEN_MULTIPLE};
    if (send(card, start, sizeof start) < 0 || card->bus->start(card->bus->context, card->block, NULL, SD_SECTOR) < 0)
        return stream_fail(card, SD_BUS);
    card->crc = sd_crc16(card->block, SD_SECTOR); /* while the block is on its way */
    card->state = SD_STREAM_SENDING;
    card->since_us = now(card);
    return SD_OK;
}

int sd_stream_put(sd_card_t *card, const uint8_t *block)
{
    if (card->state != SD_STREAM_READY)
        return SD_MISUSE;
    card->block = block;
    return send_block(card);
}

/* 4.12.5.1: after an error within a multi-block write the card wants CMD12. What it answers does not matter: if it did
 * not hear it, the next try fails too. */
static int try_again(sd_card_t *card, int error)
{
    uint8_t r1;
    if (!may_try_again(card, error, &card->tries))
        return stream_fail(card, error);
    if (command(card, CMD_STOP_TRANSMISSION, 0, &r1) == SD_BUS)
        return stream_fail(card, SD_BUS);
    card->state = SD_STREAM_STOPPING;
    card->since_us = now(card);
    return 0;
}

static int send_stop(sd_card_t *card)
{
    static const uint8_t stop[3] = {READY, TOKEN_STOP, READY};
    card->state = SD_STREAM_STOPPING;
    card->since_us = now(card);
    return send(card, stop, sizeof stop);
}

static int poll_ready(sd_card_t *card)
{
    const bool is_at_the_end = card->sector >= card->sectors; /* where no write can begin */
    if (now(card) - card->opened_us < SD_STREAM_LONGEST_US || is_at_the_end)
        return 1;
    return send_stop(card) < 0 ? stream_fail(card, SD_BUS) : 0;
}

static int poll_sending(sd_card_t *card)
{
    const bool is_late = now(card) - card->since_us > SD_BUSY_LONGEST_US;
    const int done = card->bus->is_done(card->bus->context);
    if (done == 0 && !is_late)
        return 0;
    const int result = done == 1 ? finish_block(card, card->crc) : SD_BUS;
    if (result != SD_OK)
        return try_again(card, result);
    card->state = SD_STREAM_BUSY;
    card->since_us = now(card);
    return 0;
}

/* 1 the card is not busy any more, 0 it is. */
static int look_whether_busy(sd_card_t *card)
{
    const uint64_t busy_us = now(card) - card->since_us;
    uint8_t byte = 0;
    for (int i = 0; i < POLL_BYTES && byte != READY; i++)
        if (receive(card, &byte, 1) < 0)
            return stream_fail(card, SD_BUS);
    if (byte != READY)
        return busy_us > SD_BUSY_LONGEST_US ? stream_fail(card, SD_TIMEOUT) : 0;
    if (busy_us > card->longest_busy_us)
        card->longest_busy_us = (uint32_t)busy_us;
    return 1;
}

static int poll_busy(sd_card_t *card)
{
    const int result = look_whether_busy(card);
    if (result != 1)
        return result;
    note_success(card);
    card->tries = 0;
    card->sector++;
    card->block = NULL;
    card->state = SD_STREAM_READY;
    return poll_ready(card);
}

/* The write goes on with a new command, and with the block that was not taken. The card's state is read in between, which
 * clears it: where nothing had failed yet, it is the only word of a block that was taken and then could not be kept. */
static int poll_stopping(sd_card_t *card)
{
    const int ready = look_whether_busy(card);
    if (ready != 1)
        return ready;
    release(card);
    const int state = ask_status(card);
    if (state == SD_WRITE_FAILED && card->tries == 0)
        return stream_fail(card, state);
    const int result = begin_write(card);
    if (result != SD_OK)
        return try_again(card, result);
    return card->block ? send_block(card) : 1;
}

int sd_stream_poll(sd_card_t *card)
{
    switch (card->state) {
    case SD_STREAM_READY:
        return poll_ready(card);
    case SD_STREAM_SENDING:
        return poll_sending(card);
    case SD_STREAM_BUSY:
        return poll_busy(card);
    case SD_STREAM_STOPPING:
        return poll_stopping(card);
    default:
        return SD_MISUSE;
    }
}

/* The last block has to be taken before the stream can end. */
static int drain(sd_card_t *card)
{
    int ready = card->state == SD_STREAM_READY ? 1 : sd_stream_poll(card);
    while (ready == 0) { /* ends: each state has its time-out */
        card->bus->wait(card->bus->context);
        ready = sd_stream_poll(card);
    }
    return ready < 0 ? ready : SD_OK;
}

int sd_stream_halt(sd_card_t *card)
{
    int result = drain(card);
    if (result != SD_OK)
        return result;
    result = send_stop(card);
    release(card);
    card->state = SD_CLOSED;
    return fail(card, result);
}

int sd_stream_close(sd_card_t *card)
{
    uint8_t byte;
    int result = drain(card);
    if (result != SD_OK)
        return result;
    result = send_stop(card);
    if (result == SD_OK)
        result = receive_until(card, true, SD_BUSY_LONGEST_US, &byte);
    if (result != SD_OK)
        return stream_fail(card, result);
    release(card);
    result = ask_status(card);
    card->state = result == SD_OK ? SD_IDLE : SD_CLOSED;
    return fail(card, result);
}
