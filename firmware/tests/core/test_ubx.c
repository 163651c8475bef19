#include <string.h>

#include "check.h"
#include "ubx.h"

static void rate(void)
{
    /* from u-blox' own documents and the design notes: 5 Hz */
    const uint8_t want[] = {0xB5, 0x62, 0x06, 0x08, 0x06, 0x00, 0xC8, 0x00, 0x01, 0x00, 0x01, 0x00, 0xDE, 0x6A};
    uint8_t out[UBX_FRAME_LONGEST];
    CHECK_EQUAL(ubx_set_rate(out, 200), sizeof want);
    CHECK_SAME(out, want, sizeof want);
}

static void values(void)
{
    /* as published for the dynamic model 6: key 20110021, one byte */
    const uint8_t want[] = {0xB5, 0x62, 0x06, 0x8A, 0x09, 0x00, 0x00, 0x01, 0x00, 0x00, 0x21, 0x00, 0x11, 0x20, 0x06, 0xF2, 0x4F};
    uint8_t out[UBX_FRAME_LONGEST];
    CHECK_EQUAL(ubx_set_value(out, UBX_KEY_MODEL, 6), sizeof want);
    CHECK_SAME(out, want, sizeof want);
    CHECK_EQUAL(ubx_set_value(out, UBX_KEY_PERIOD, 100), sizeof want + 1);
    CHECK_EQUAL(ubx_set_value(out, UBX_KEY_BAUD, 57600), sizeof want + 3);
}

static bool push_all(ubx_parser_t *parser, const uint8_t *bytes, size_t length)
{
    bool is_whole = false;
    for (size_t i = 0; i < length; i++) {
        is_whole = ubx_push(parser, bytes[i]);
    }
    return is_whole;
}

static void commands(void)
{
    uint8_t out[5][UBX_FRAME_LONGEST];
    const size_t length[5] = {ubx_set_port(out[0], 57600), ubx_set_automotive(out[1]), ubx_set_message(out[2], 0xF0, 7, 1),
                              ubx_set_continuous(out[3]), ubx_set_rate(out[4], 1000)};
    const uint8_t id[5] = {UBX_CFG_PRT, UBX_CFG_NAV5, UBX_CFG_MSG, UBX_CFG_RXM, UBX_CFG_RATE};
    const size_t payload[5] = {20, 36, 3, 2, 6};
    ubx_parser_t parser;
    ubx_init(&parser);
    for (size_t i = 0; i < 5; i++) {
        CHECK_EQUAL(length[i], payload[i] + UBX_OVERHEAD);
        CHECK(push_all(&parser, out[i], length[i]));
        CHECK(parser.class == UBX_CLASS_CFG && parser.id == id[i] && parser.length == payload[i]);
        CHECK_SAME(parser.frame, out[i], length[i]);
    }
    CHECK_SAME(out[0] + 6 + 8, "\x00\xE1\x00\x00", 4); /* 57600 */
    CHECK(out[1][6] == 1 && out[1][8] == 4);
}

static void answers(void)
{
    const uint8_t of_rate[] = {UBX_CLASS_CFG, UBX_CFG_RATE};
    uint8_t out[UBX_FRAME_LONGEST];
    ubx_parser_t parser;
    ubx_init(&parser);
    CHECK(push_all(&parser, out, ubx_frame(out, UBX_CLASS_ACK, UBX_ACK_ACK, of_rate, 2)));
    CHECK_EQUAL(ubx_answer(&parser, UBX_CLASS_CFG, UBX_CFG_RATE), UBX_ACKNOWLEDGED);
    CHECK_EQUAL(ubx_answer(&parser, UBX_CLASS_CFG, UBX_CFG_PRT), UBX_OTHER);
    CHECK(push_all(&parser, out, ubx_frame(out, UBX_CLASS_ACK, UBX_ACK_NAK, of_rate, 2)));
    CHECK_EQUAL(ubx_answer(&parser, UBX_CLASS_CFG, UBX_CFG_RATE), UBX_REFUSED);
}

static void between_sentences(void)
{
    uint8_t line[64] = "$GPRMC,1\r\n\xB5";
    const uint8_t payload[] = {UBX_CLASS_CFG, UBX_CFG_RATE};
    ubx_parser_t parser;
    ubx_init(&parser);
    const size_t length = 11 + ubx_frame(line + 11, UBX_CLASS_ACK, UBX_ACK_ACK, payload, 2); /* a sync byte too many */
    CHECK(push_all(&parser, line, length));
}

static void damage(void)
{
    const uint8_t payload[] = {UBX_CLASS_CFG, UBX_CFG_RATE};
    uint8_t frame[UBX_FRAME_LONGEST];
    uint8_t after[UBX_FRAME_LONGEST];
    const size_t length = ubx_frame(frame, UBX_CLASS_ACK, UBX_ACK_ACK, payload, 2);
    for (size_t i = 0; i < length * 8; i++) {
        ubx_parser_t parser;
        ubx_init(&parser);
        frame[i / 8] ^= (uint8_t)(1U << i % 8);
        CHECK(!push_all(&parser, frame, length));
        frame[i / 8] ^= (uint8_t)(1U << i % 8);
        memset(after, 0, sizeof after);
        for (size_t n = 0; n < 1100; n += sizeof after) { /* whatever length it claims, it ends */
            push_all(&parser, after, sizeof after);
        }
        CHECK(push_all(&parser, frame, length));
    }
}

/* What may be in a frame that is understood is in no sentence; what only looks like one keeps nothing from them. */
static void within(void)
{
    const uint8_t payload[UBX_VELNED_BYTES] = {'$'};
    uint8_t frame[UBX_FRAME_LONGEST];
    ubx_parser_t parser;
    ubx_init(&parser);
    const size_t length = ubx_frame(frame, UBX_CLASS_NAV, UBX_NAV_VELNED, payload, sizeof payload);
    for (size_t i = 0; i < length; i++) {
        CHECK_EQUAL(ubx_is_within(&parser), i >= 2);
        CHECK_EQUAL(ubx_push(&parser, frame[i]), i + 1 == length);
    }
    CHECK(ubx_is_velocity(&parser) && !ubx_is_within(&parser));
    CHECK_SAME(parser.frame, frame, length);
    const uint8_t noise[] = {UBX_SYNC_0, UBX_SYNC_1, '$', 'G', 'P'};
    (void)push_all(&parser, noise, sizeof noise);
    CHECK(!ubx_is_within(&parser));
    ubx_init(&parser);
    const uint8_t long_one[] = {UBX_SYNC_0, UBX_SYNC_1, UBX_CLASS_NAV, 7, 92, 0, 1};
    (void)push_all(&parser, long_one, sizeof long_one);
    CHECK(!ubx_is_within(&parser));
}

static void longer_than_kept(void)
{
    uint8_t frame[200 + UBX_OVERHEAD];
    uint8_t payload[200];
    memset(payload, 7, sizeof payload);
    ubx_parser_t parser;
    ubx_init(&parser);
    CHECK(push_all(&parser, frame, ubx_frame(frame, 0x0A, 0x04, payload, sizeof payload)));
    CHECK_EQUAL(parser.length, 200);
}

const suite_t ubx_suite = {"ubx",
                           (const test_t[]){{"the 5 Hz command has the bytes of u-blox", rate},
                                            {"a value has the bytes that others published", values},
                                            {"a frame that is understood is in no sentence", within},
                                            {"every command is a good frame with its values", commands},
                                            {"answers are told apart", answers},
                                            {"a frame is found between sentences", between_sentences},
                                            {"a damaged frame is none, and the next one is found", damage},
                                            {"a frame longer than kept is skipped whole", longer_than_kept},
                                            {0}}};
