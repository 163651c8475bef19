#include "neo_model.h"

#include <stdio.h>
#include <string.h>

static void power_on(neo_model_t *receiver)
{
    receiver->baud = 9600;
    receiver->period_ms = 1000;
    receiver->dynamic_model = 0;
    receiver->power_mode = 0;
    receiver->has_velocity = false;
    for (int i = 0; i < 16; i++)
        receiver->messages[i] = i < 6; /* GGA GLL GSA GSV RMC VTG */
    receiver->in_length = 0;
    receiver->out_put = receiver->out_taken = 0;
    receiver->next_epoch_us = *receiver->now_us + 300000;
}

void neo_model_init(neo_model_t *receiver, const uint64_t *now_us)
{
    *receiver = (neo_model_t){.now_us = now_us, .has_fix = true, .shortest_ms = 200};
    power_on(receiver);
}

void neo_model_power_cycle(neo_model_t *receiver)
{
    power_on(receiver);
}

static uint64_t byte_us(const neo_model_t *receiver)
{
    return 10000000u / receiver->baud;
}

static void say(neo_model_t *receiver, const uint8_t *bytes, size_t length)
{
    if (receiver->out_put == receiver->out_taken)
        receiver->out_us = *receiver->now_us;
    for (size_t i = 0; i < length; i++)
        receiver->out[receiver->out_put++ % NEO_QUEUE] = bytes[i];
}

static void sentence(neo_model_t *receiver, const char *body)
{
    char text[120];
    uint8_t sum = 0;
    for (const char *c = body; *c; c++)
        sum ^= (uint8_t)*c;
    const int length = snprintf(text, sizeof text, "$%s*%02X\r\n", body, sum);
    say(receiver, (const uint8_t *)text, (size_t)length);
    receiver->sentences++;
}

static void say_frame(neo_model_t *receiver, uint8_t class, uint8_t id, const uint8_t *payload, uint8_t length)
{
    uint8_t frame[64] = {0xB5, 0x62, class, id, length, 0};
    memcpy(frame + 6, payload, length);
    uint8_t *sum = frame + 6 + length;
    for (int i = 2; i < 6 + length; i++) {
        sum[0] = (uint8_t)(sum[0] + frame[i]);
        sum[1] = (uint8_t)(sum[1] + sum[0]);
    }
    say(receiver, frame, 8u + length);
}

static void say_velocity(neo_model_t *receiver, const uint8_t payload[36])
{
    if (!receiver->has_velocity)
        return;
    say_frame(receiver, 1, 0x12, payload, 36);
    receiver->velocities++;
}

/* Bytes in hex, as the text of a fix has them. */
static void say_hex(neo_model_t *receiver, const char *hex)
{
    uint8_t payload[36];
    unsigned byte;
    for (size_t i = 0; i < sizeof payload; i++) {
        if (sscanf(hex + 2 * i, "%2x", &byte) != 1)
            return;
        payload[i] = (uint8_t)byte;
    }
    say_velocity(receiver, payload);
}

static const char *const message_names[] = {"GGA", "GLL", "GSA", "GSV", "RMC", "VTG", "", "GST"};

static bool is_wanted(const neo_model_t *receiver, const char *sentence)
{
    for (int i = 0; i < 8; i++)
        if (receiver->messages[i] && strncmp(sentence + 3, message_names[i], 3) == 0)
            return true;
    return false;
}

/* Say those sentences of a text that are switched on. */
static void say_wanted(neo_model_t *receiver, const char *text)
{
    while (*text) {
        const char *end = strchr(text, '\n');
        const size_t length = end ? (size_t)(end + 1 - text) : strlen(text);
        if (strncmp(text, "$UBX,", 5) == 0) {
            say_hex(receiver, text + 5);
        } else if (is_wanted(receiver, text)) {
            say(receiver, (const uint8_t *)text, length);
            receiver->sentences++;
        }
        text += length;
    }
}

static void epoch(neo_model_t *receiver)
{
    char body[100];
    const unsigned tenths = receiver->epochs * receiver->period_ms / 100, seconds = tenths / 10;
    static const uint8_t noise[] = {0x00, 0x80, 0x24, 0x47, 0xFE};
    for (uint32_t i = 0; i < receiver->chatter; i++)
        say(receiver, &noise[i % sizeof noise], 1);
    receiver->epochs++;
    if (receiver->fix_count) { /* whose fixes come from outside has none of its own */
        say_wanted(receiver, "$GPRMC,,V,,,,,,,,,,N*53\r\n$GPGGA,,,,,,0,00,99.99,,,,,,*48\r\n$GPGST,,,,,,,,*57\r\n");
        return;
    }
    for (int i = 0; i < 8; i++) {
        if (!receiver->messages[i])
            continue;
        snprintf(body, sizeof body, "GP%s,%02u%02u%02u.%u0,%c,4124.8963,N,00210.4251,E,%u.5,84.4,230394,,", message_names[i],
                 seconds / 3600, seconds / 60 % 60, seconds % 60, tenths % 10, receiver->has_fix ? 'A' : 'V', receiver->epochs - 1);
        sentence(receiver, body);
    }
    uint8_t velocity[36] = {0};
    memcpy(velocity, &receiver->epochs, 4);
    memset(velocity + 4, '$', 8); /* what begins a sentence too */
    say_velocity(receiver, velocity);
}

/* Fixes come when they come; one that is not due yet at the rate that is set is left out. */
static void step_fixes(neo_model_t *receiver)
{
    while (receiver->fix_at < receiver->fix_count && receiver->fixes[receiver->fix_at].time_us <= *receiver->now_us) {
        const bool is_first = receiver->fix_at == 0;
        const neo_fix_t *fix = &receiver->fixes[receiver->fix_at++];
        if (receiver->is_absent)
            continue;
        if (!is_first && fix->time_us + 500u * receiver->period_ms < receiver->next_epoch_us)
            continue;
        const bool is_line_free = receiver->out_put == receiver->out_taken;
        say_wanted(receiver, fix->text);
        if (is_line_free)
            receiver->out_us = fix->time_us;
        receiver->next_epoch_us = fix->time_us + 1000u * receiver->period_ms;
        receiver->epochs++;
    }
}

/* When it speaks of its own accord; among fixes it waits for one that is late. */
static uint64_t own_epoch_us(const neo_model_t *receiver)
{
    return receiver->next_epoch_us + (receiver->fix_at ? 1500u * receiver->period_ms : 0);
}

uint64_t neo_model_due_us(const neo_model_t *receiver)
{
    uint64_t due = own_epoch_us(receiver);
    if (receiver->fix_at < receiver->fix_count && receiver->fixes[receiver->fix_at].time_us < due)
        due = receiver->fixes[receiver->fix_at].time_us;
    if (receiver->out_put != receiver->out_taken && receiver->out_us + byte_us(receiver) < due)
        due = receiver->out_us + byte_us(receiver);
    return due;
}

static void step(neo_model_t *receiver)
{
    step_fixes(receiver);
    while (!receiver->is_absent && own_epoch_us(receiver) <= *receiver->now_us) {
        const bool is_line_free = receiver->out_put == receiver->out_taken;
        const uint64_t began_us = own_epoch_us(receiver);
        epoch(receiver);
        if (is_line_free)
            receiver->out_us = began_us;
        receiver->next_epoch_us += (uint64_t)receiver->period_ms * 1000;
    }
}

bool neo_model_next(neo_model_t *receiver, uint32_t baud, uint8_t *byte, uint64_t *began_us)
{
    step(receiver);
    if (receiver->is_absent || receiver->out_taken == receiver->out_put || receiver->out_us + byte_us(receiver) > *receiver->now_us)
        return false;
    *byte = receiver->out[receiver->out_taken++ % NEO_QUEUE];
    if (receiver->is_garbled)
        *byte = (uint8_t)((*byte * 73 + receiver->out_taken * 29) ^ receiver->out_taken >> 5);
    else if (baud != receiver->baud)
        *byte = (uint8_t)(*byte * 37 + 11); /* what a wrong rate makes of it */
    *began_us = receiver->out_us;
    receiver->out_us += byte_us(receiver);
    return true;
}

/* ---- commands ---- */

static void answer(neo_model_t *receiver, uint8_t class, uint8_t id, bool is_good)
{
    const uint8_t of[2] = {class, id};
    say_frame(receiver, 5, is_good ? 1 : 0, of, sizeof of);
}

static bool set_period(neo_model_t *receiver, unsigned period_ms)
{
    if (period_ms < receiver->shortest_ms)
        return false;
    receiver->period_ms = (uint16_t)period_ms;
    return true;
}

/* CFG-VALSET of one key: version, layers, two reserved, key, value. */
static bool set_value(neo_model_t *receiver, const uint8_t *p, size_t length)
{
    static const uint32_t keys[8] = {0x209100BB, 0x209100CA, 0x209100C0, 0x209100C5, 0x209100AC, 0x209100B1, 0, 0x209100D4};
    static const uint8_t sizes[8] = {0, 1, 1, 2, 4, 8};
    const uint32_t key = p[4] | (uint32_t)p[5] << 8 | (uint32_t)p[6] << 16 | (uint32_t)p[7] << 24;
    if (length != 8u + sizes[key >> 28 & 7] || p[0] != 0 || p[1] != 1)
        return false;
    for (int i = 0; i < 8; i++)
        if (key == keys[i]) {
            receiver->messages[i] = p[8] != 0;
            return true;
        }
    switch (key) {
    case 0x40520001:
        receiver->baud = (uint32_t)(p[8] | p[9] << 8 | p[10] << 16);
        return true;
    case 0x30210001:
        return set_period(receiver, p[8] | (unsigned)p[9] << 8);
    case 0x20110021:
        receiver->dynamic_model = p[8];
        return true;
    case 0x20D00001:
        receiver->power_mode = p[8];
        return true;
    case 0x20910043:
        receiver->has_velocity = p[8] != 0;
        return true;
    default:
        return false;
    }
}

static bool obey(neo_model_t *receiver, uint8_t id, const uint8_t *p, size_t length)
{
    switch (id) {
    case 0x00: /* the answer goes out at the old rate, and is lost with it: as the real one has it */
        if (length != 20 || p[0] != 1)
            return false;
        receiver->baud = (uint32_t)(p[8] | p[9] << 8 | p[10] << 16);
        return true;
    case 0x01:
        if (length == 3 && p[0] == 1 && p[1] == 0x12) {
            receiver->has_velocity = p[2] != 0;
            return true;
        }
        if (length != 3 || p[0] != 0xF0 || p[1] > 15)
            return false;
        receiver->messages[p[1]] = p[2] != 0;
        return true;
    case 0x08:
        return length == 6 && set_period(receiver, p[0] | (unsigned)p[1] << 8);
    case 0x11:
        receiver->power_mode = p[1];
        return length == 2;
    case 0x24:
        receiver->dynamic_model = p[2];
        return length == 36 && (p[0] & 1);
    default:
        return false;
    }
}

static void take_frame(neo_model_t *receiver, const uint8_t *frame, size_t length)
{
    const uint8_t class = frame[2], id = frame[3];
    const bool is_refused = receiver->refuse_class_id == (uint32_t)(class << 8 | id);
    const uint32_t baud = receiver->baud;
    const bool is_known = receiver->is_modern == (id == 0x8A);
    const bool is_good = class == 6 && is_known && !is_refused &&
                         (id == 0x8A ? set_value(receiver, frame + 6, length - 8) : obey(receiver, id, frame + 6, length - 8));
    if (receiver->baud != baud)
        receiver->out_taken = receiver->out_put;
    if (!is_known && receiver->is_mute_to_old)
        return;
    answer(receiver, class, id, is_good);
}

static bool is_sum_right(const uint8_t *frame, size_t length)
{
    uint8_t a = 0, b = 0;
    for (size_t i = 2; i < length - 2; i++) {
        a = (uint8_t)(a + frame[i]);
        b = (uint8_t)(b + a);
    }
    return frame[length - 2] == a && frame[length - 1] == b;
}

static void take_byte(neo_model_t *receiver, uint8_t byte)
{
    if (receiver->in_length == sizeof receiver->in)
        receiver->in_length = 0;
    receiver->in[receiver->in_length++] = byte;
    if (receiver->in[0] != 0xB5 || (receiver->in_length > 1 && receiver->in[1] != 0x62))
        receiver->in_length = 0;
    if (receiver->in_length < 8)
        return;
    const size_t length = 8u + receiver->in[4] + ((size_t)receiver->in[5] << 8);
    if (receiver->in_length < length)
        return;
    if (is_sum_right(receiver->in, length))
        take_frame(receiver, receiver->in, length);
    receiver->in_length = 0;
}

void neo_model_receive(neo_model_t *receiver, const uint8_t *bytes, size_t length, uint32_t baud)
{
    if (receiver->is_absent || receiver->is_deaf || baud != receiver->baud)
        return;
    for (size_t i = 0; i < length; i++)
        take_byte(receiver, bytes[i]);
}
