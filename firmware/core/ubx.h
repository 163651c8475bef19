/* UBX frames of u-blox receivers: encoding commands, and finding answers and velocities in what comes back. Two ways to
 * set a receiver up: by a message for each subject (u-blox 5 to 9), and by CFG-VALSET (9 and later), key by key. */
#ifndef CORE_UBX_H
#define CORE_UBX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    UBX_SYNC_0 = 0xB5,
    UBX_SYNC_1 = 0x62,
    UBX_HEAD = 6,           /* sync, class, id, length */
    UBX_OVERHEAD = 8,       /* with the checksum */
    UBX_PAYLOAD_LONGEST = 44, /* of the frames written and understood here; longer ones are skipped */
    UBX_FRAME_LONGEST = UBX_OVERHEAD + UBX_PAYLOAD_LONGEST
};

enum { UBX_CLASS_ACK = 0x05, UBX_CLASS_CFG = 0x06, UBX_ACK_NAK = 0x00, UBX_ACK_ACK = 0x01 };
enum { UBX_CLASS_NAV = 0x01, UBX_NAV_VELNED = 0x12, UBX_VELNED_BYTES = 36 }; /* velocity and its accuracy, u-blox 5 to 10 */
enum { UBX_CFG_PRT = 0x00, UBX_CFG_MSG = 0x01, UBX_CFG_RATE = 0x08, UBX_CFG_RXM = 0x11, UBX_CFG_NAV5 = 0x24,
       UBX_CFG_VALSET = 0x8A };

/* Keys of CFG-VALSET; bits 28 to 30 say how long the value is. u-blox M10 SPG 5.10 Interface Description. */
enum {
    UBX_KEY_BAUD = 0x40520001,      /* CFG-UART1-BAUDRATE */
    UBX_KEY_PERIOD = 0x30210001,    /* CFG-RATE-MEAS, ms */
    UBX_KEY_MODEL = 0x20110021,     /* CFG-NAVSPG-DYNMODEL */
    UBX_KEY_POWER = 0x20D00001,     /* CFG-PM-OPERATEMODE */
    UBX_KEY_VELNED = 0x20910043,    /* CFG-MSGOUT-.. for UART1 */
    UBX_KEY_RMC = 0x209100AC,
    UBX_KEY_GGA = 0x209100BB,
    UBX_KEY_GST = 0x209100D4,
    UBX_KEY_GLL = 0x209100CA,
    UBX_KEY_GSA = 0x209100C0,
    UBX_KEY_GSV = 0x209100C5,
    UBX_KEY_VTG = 0x209100B1
};
enum { UBX_AUTOMOTIVE = 4, UBX_CONTINUOUS = 0 }; /* values of the dynamic model and of the power mode */

/* Write a whole frame into `out` (UBX_OVERHEAD + length bytes); returns its length. */
size_t ubx_frame(uint8_t *out, uint8_t class, uint8_t id, const uint8_t *payload, size_t length);

/* The logger's commands, each into UBX_FRAME_LONGEST bytes; each returns the length. */
size_t ubx_set_port(uint8_t *out, uint32_t baud);                           /* UART 1: 8N1, UBX and NMEA in and out */
size_t ubx_set_rate(uint8_t *out, uint16_t period_ms);                      /* CFG-RATE */
size_t ubx_set_automotive(uint8_t *out);                                    /* CFG-NAV5, dynamic model 4 */
size_t ubx_set_message(uint8_t *out, uint8_t class, uint8_t id, uint8_t each); /* CFG-MSG on this port; 0: off */
size_t ubx_set_continuous(uint8_t *out);                                    /* CFG-RXM: no power save */
size_t ubx_set_value(uint8_t *out, uint32_t key, uint32_t value);           /* CFG-VALSET, in RAM */

typedef struct {
    uint8_t state;
    uint8_t class;
    uint8_t id;
    uint8_t sum_a;
    uint8_t sum_b;
    uint16_t length;
    uint16_t at; /* where in the frame the newest byte belongs */
    uint8_t frame[UBX_FRAME_LONGEST]; /* from the sync to the sum, if it is not longer */
} ubx_parser_t;

void ubx_init(ubx_parser_t *parser);

/* Take one byte; true when it ends a good frame: class, id, length and frame are then in the parser. */
bool ubx_push(ubx_parser_t *parser, uint8_t byte);

/* Whether the next byte is within a frame of those that are understood here, and so part of no sentence. */
bool ubx_is_within(const ubx_parser_t *parser);

/* Whether the frame just parsed is a NAV-VELNED. */
bool ubx_is_velocity(const ubx_parser_t *parser);

typedef enum { UBX_OTHER, UBX_ACKNOWLEDGED, UBX_REFUSED } ubx_answer_t;

/* What the frame just parsed says of the command (class, id). */
ubx_answer_t ubx_answer(const ubx_parser_t *parser, uint8_t class, uint8_t id);

#endif
