/* UBX frames of u-blox receivers: encoding commands, and finding ACK and NAK in what comes back. */
#ifndef CORE_UBX_H
#define CORE_UBX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    UBX_SYNC_0 = 0xB5,
    UBX_SYNC_1 = 0x62,
    UBX_OVERHEAD = 8,       /* sync, class, id, length, checksum */
    UBX_PAYLOAD_LONGEST = 44, /* of the frames written and understood here; longer ones are skipped */
    UBX_FRAME_LONGEST = UBX_OVERHEAD + UBX_PAYLOAD_LONGEST
};

enum { UBX_CLASS_ACK = 0x05, UBX_CLASS_CFG = 0x06, UBX_ACK_NAK = 0x00, UBX_ACK_ACK = 0x01 };
enum { UBX_CFG_PRT = 0x00, UBX_CFG_MSG = 0x01, UBX_CFG_RATE = 0x08, UBX_CFG_RXM = 0x11, UBX_CFG_NAV5 = 0x24 };

/* Write a whole frame into `out` (UBX_OVERHEAD + length bytes); returns its length. */
size_t ubx_frame(uint8_t *out, uint8_t class, uint8_t id, const uint8_t *payload, size_t length);

/* The logger's commands, each into UBX_FRAME_LONGEST bytes; each returns the length. */
size_t ubx_set_port(uint8_t *out, uint32_t baud);                           /* UART 1: 8N1, UBX and NMEA in and out */
size_t ubx_set_rate(uint8_t *out, uint16_t period_ms);                      /* CFG-RATE */
size_t ubx_set_automotive(uint8_t *out);                                    /* CFG-NAV5, dynamic model 4 */
size_t ubx_set_message(uint8_t *out, uint8_t class, uint8_t id, uint8_t each); /* CFG-MSG on this port; 0: off */
size_t ubx_set_continuous(uint8_t *out);                                    /* CFG-RXM: no power save */

typedef struct {
    uint8_t state;
    uint8_t class;
    uint8_t id;
    uint8_t sum_a;
    uint8_t sum_b;
    uint16_t length;
    uint16_t taken;
    uint8_t payload[UBX_PAYLOAD_LONGEST];
} ubx_parser_t;

void ubx_init(ubx_parser_t *parser);

/* Take one byte; true when it ends a good frame: class, id, length and payload are then in the parser. */
bool ubx_push(ubx_parser_t *parser, uint8_t byte);

typedef enum { UBX_OTHER, UBX_ACKNOWLEDGED, UBX_REFUSED } ubx_answer_t;

/* What the frame just parsed says of the command (class, id). */
ubx_answer_t ubx_answer(const ubx_parser_t *parser, uint8_t class, uint8_t id);

#endif
