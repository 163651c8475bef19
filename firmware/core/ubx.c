#include "ubx.h"

#include <string.h>

#include "bytes.h"

enum { UART1 = 1, MODE_8N1 = 0x8D0, PROTOCOLS_UBX_NMEA = 3, NAV5_DYNAMIC_MODEL = 1,
       TIME_REFERENCE_GPS = 1, RXM_RESERVED = 8, LAYER_RAM = 1, KEY_AT = 4, VALUE_AT = 8, SIZE_BITS_AT = 28 };
enum { PRT_BYTES = 20, RATE_BYTES = 6, NAV5_BYTES = 36, MSG_BYTES = 3, RXM_BYTES = 2, ACK_BYTES = 2 };
enum { LONGEST_SKIPPED = 1024 }; /* payload: a longer one is garbage and must not swallow what follows */
enum { AT_SYNC_0, AT_SYNC_1, AT_CLASS, AT_ID, AT_LENGTH_0, AT_LENGTH_1, AT_PAYLOAD, AT_SUM_A, AT_SUM_B };

static void sum(uint8_t *a, uint8_t *b, uint8_t byte)
{
    *a = (uint8_t)(*a + byte);
    *b = (uint8_t)(*b + *a);
}

size_t ubx_frame(uint8_t *out, uint8_t class, uint8_t id, const uint8_t *payload, size_t length)
{
    out[0] = UBX_SYNC_0;
    out[1] = UBX_SYNC_1;
    out[2] = class;
    out[3] = id;
    bytes_put_u16(out + 4, (uint16_t)length);
    if (length > 0) {
        memcpy(out + UBX_HEAD, payload, length);
    }
    uint8_t a = 0;
    uint8_t b = 0;
    for (size_t i = 2; i < UBX_HEAD + length; i++) {
        sum(&a, &b, out[i]);
    }
    out[UBX_HEAD + length] = a;
    out[UBX_HEAD + length + 1] = b;
    return UBX_OVERHEAD + length;
}

size_t ubx_set_port(uint8_t *out, uint32_t baud)
{
    uint8_t payload[PRT_BYTES] = {UART1};
    bytes_put_u32(payload + 4, MODE_8N1);
    bytes_put_u32(payload + 8, baud);
    bytes_put_u16(payload + 12, PROTOCOLS_UBX_NMEA);
    bytes_put_u16(payload + 14, PROTOCOLS_UBX_NMEA);
    return ubx_frame(out, UBX_CLASS_CFG, UBX_CFG_PRT, payload, sizeof payload);
}

size_t ubx_set_rate(uint8_t *out, uint16_t period_ms)
{
    uint8_t payload[RATE_BYTES] = {0};
    bytes_put_u16(payload, period_ms);
    bytes_put_u16(payload + 2, 1);
    bytes_put_u16(payload + 4, TIME_REFERENCE_GPS);
    return ubx_frame(out, UBX_CLASS_CFG, UBX_CFG_RATE, payload, sizeof payload);
}

size_t ubx_set_automotive(uint8_t *out)
{
    uint8_t payload[NAV5_BYTES] = {0};
    bytes_put_u16(payload, NAV5_DYNAMIC_MODEL); /* mask: nothing else is changed */
    payload[2] = UBX_AUTOMOTIVE;
    return ubx_frame(out, UBX_CLASS_CFG, UBX_CFG_NAV5, payload, sizeof payload);
}

size_t ubx_set_message(uint8_t *out, uint8_t class, uint8_t id, uint8_t each)
{
    const uint8_t payload[MSG_BYTES] = {class, id, each};
    return ubx_frame(out, UBX_CLASS_CFG, UBX_CFG_MSG, payload, sizeof payload);
}

size_t ubx_set_continuous(uint8_t *out)
{
    const uint8_t payload[RXM_BYTES] = {RXM_RESERVED, UBX_CONTINUOUS};
    return ubx_frame(out, UBX_CLASS_CFG, UBX_CFG_RXM, payload, sizeof payload);
}

size_t ubx_set_value(uint8_t *out, uint32_t key, uint32_t value)
{
    uint8_t payload[VALUE_AT + sizeof value] = {0, LAYER_RAM};
    static const uint8_t sizes[] = {1, 1, 1, 2, 4, 4, 4, 4}; /* by the key's bits 28 to 30; 8 bytes are not set here */
    bytes_put_u32(payload + KEY_AT, key);
    bytes_put_u32(payload + VALUE_AT, value);
    return ubx_frame(out, UBX_CLASS_CFG, UBX_CFG_VALSET, payload, VALUE_AT + sizes[key >> SIZE_BITS_AT & 7]);
}

void ubx_init(ubx_parser_t *parser)
{
    memset(parser, 0, sizeof *parser);
}

static uint8_t after_length(const ubx_parser_t *parser)
{
    if (parser->length > LONGEST_SKIPPED) {
        return AT_SYNC_0;
    }
    return parser->length > 0 ? AT_PAYLOAD : AT_SUM_A;
}

static uint8_t after_sync(uint8_t state, uint8_t byte)
{
    if (byte == UBX_SYNC_0) {
        return AT_SYNC_1;
    }
    return state == AT_SYNC_1 && byte == UBX_SYNC_1 ? AT_CLASS : AT_SYNC_0;
}

static void take(ubx_parser_t *parser, uint8_t byte)
{
    switch (parser->state) {
    case AT_CLASS:
        parser->sum_a = 0;
        parser->sum_b = 0;
        parser->class = byte;
        parser->state = AT_ID;
        break;
    case AT_ID:
        parser->id = byte;
        parser->state = AT_LENGTH_0;
        break;
    case AT_LENGTH_0:
        parser->length = byte;
        parser->state = AT_LENGTH_1;
        break;
    case AT_LENGTH_1:
        parser->length = (uint16_t)(parser->length | byte << 8);
        parser->state = after_length(parser);
        break;
    default:
        parser->state = parser->at + 1 < UBX_HEAD + parser->length ? AT_PAYLOAD : AT_SUM_A;
        break;
    }
    sum(&parser->sum_a, &parser->sum_b, byte);
}

static void keep(ubx_parser_t *parser, uint8_t byte)
{
    const bool is_sync = parser->state == AT_SYNC_0 || parser->state == AT_SYNC_1;
    parser->at = is_sync ? parser->state : (uint16_t)(parser->at + 1);
    if (parser->at < UBX_FRAME_LONGEST) {
        parser->frame[parser->at] = byte;
    }
}

bool ubx_push(ubx_parser_t *parser, uint8_t byte)
{
    keep(parser, byte);
    switch (parser->state) {
    case AT_SYNC_0:
    case AT_SYNC_1:
        parser->state = after_sync(parser->state, byte);
        return false;
    case AT_SUM_A:
        parser->state = byte == parser->sum_a ? AT_SUM_B : after_sync(AT_SYNC_0, byte);
        return false;
    case AT_SUM_B:
        parser->state = AT_SYNC_0;
        return byte == parser->sum_b;
    default:
        take(parser, byte);
        return false;
    }
}

bool ubx_is_within(const ubx_parser_t *parser)
{
    const bool is_class_known = parser->state > AT_CLASS;
    const bool is_length_known = parser->state >= AT_PAYLOAD;
    const bool is_other = is_class_known && parser->class != UBX_CLASS_NAV && parser->class != UBX_CLASS_ACK;
    return parser->state >= AT_CLASS && !is_other && (!is_length_known || parser->length <= UBX_PAYLOAD_LONGEST);
}

bool ubx_is_velocity(const ubx_parser_t *parser)
{
    return parser->class == UBX_CLASS_NAV && parser->id == UBX_NAV_VELNED && parser->length == UBX_VELNED_BYTES;
}

ubx_answer_t ubx_answer(const ubx_parser_t *parser, uint8_t class, uint8_t id)
{
    const bool is_answer = parser->class == UBX_CLASS_ACK && parser->length == ACK_BYTES &&
                           parser->frame[UBX_HEAD] == class && parser->frame[UBX_HEAD + 1] == id;
    if (!is_answer) {
        return UBX_OTHER;
    }
    return parser->id == UBX_ACK_ACK ? UBX_ACKNOWLEDGED : parser->id == UBX_ACK_NAK ? UBX_REFUSED : UBX_OTHER;
}
