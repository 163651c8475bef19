/* NEO-6M and its successors: finds its baud rate, configures it at every start with acknowledge, hands on its sentences and
 * velocities.
 *
 * Source: u-blox 6 Receiver Description including Protocol Specification, GPS.G6-SW-10018; for those that only know
 * CFG-VALSET, u-blox M10 SPG 5.10 Interface Description, UBX-21035062. The receiver forgets its
 * settings without power, and may be reset alone: when it falls silent it is looked for again. Never waits. */
#ifndef DRIVERS_NEO6M_H
#define DRIVERS_NEO6M_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "nmea.h"
#include "ubx.h"

/* What the driver needs of the board. */
typedef struct {
    void *context;
    void (*set_baud)(void *context, uint32_t baud); /* receiving starts afresh */
    /* Queue bytes to send: 0, or negative while those before are on their way. */
    int (*write)(void *context, const uint8_t *data, size_t length);
    /* Fetch received bytes that came without a pause: how many, 0 if none. *first_us is when the first of them began;
     * *lost how many before them were overwritten. */
    size_t (*read)(void *context, uint8_t *data, size_t size, uint64_t *first_us, uint32_t *lost);
} neo6m_port_t;

typedef struct {
    uint32_t baud;
    uint16_t period_ms;
} neo6m_settings_t;

typedef enum { NEO6M_SWITCHING, NEO6M_ASKING, NEO6M_LISTENING, NEO6M_CONFIGURING, NEO6M_RUNNING } neo6m_state_t;

/* What the owner is told. `sentence` is good until the call returns: an NMEA sentence, whose checksum may be wrong, or a
 * whole NAV-VELNED. */
typedef struct {
    void *context;
    void (*on_sentence)(void *context, uint64_t time_us, const uint8_t *sentence, size_t length);
    void (*on_lost)(void *context, uint64_t time_us, uint32_t sentences); /* cut off, too long or overwritten */
    void (*on_configured)(void *context, uint32_t baud, uint32_t refused); /* bit i: setting i not acknowledged */
    void (*on_silent)(void *context, uint32_t silent_ms);
} neo6m_events_t;

typedef struct {
    const neo6m_port_t *port;
    const neo6m_events_t *events;
    neo6m_settings_t settings;
    neo6m_state_t state;
    uint8_t candidate;   /* number of the baud rate being tried */
    uint8_t setting;     /* being sent */
    uint8_t tries;
    bool is_modern;      /* set up by CFG-VALSET */
    bool is_waiting;     /* for the answer to it */
    bool is_heard;       /* an intact sentence, in this state */
    bool is_second_try;  /* of the same baud rate */
    bool is_unanswered;  /* a setting got no answer: it is not known whether it holds */
    uint32_t baud;       /* in use */
    uint32_t refused;
    uint64_t since_us;   /* of the state, or of the last command */
    uint64_t heard_us;   /* last intact sentence */
    uint32_t dropped;    /* by the framer, as told already */
    nmea_framer_t framer;
    ubx_parser_t parser;
} neo6m_t;

enum {
    NEO6M_SETTINGS = 12,          /* sent one after the other, bit numbers of `refused` */
    NEO6M_SWITCH_US = 150000,     /* for the command at the old rate to leave and be obeyed */
    NEO6M_ANSWER_US = 400000,     /* an acknowledge comes within a navigation epoch */
    NEO6M_LISTEN_US = 1300000,    /* a sentence a second is the default */
    NEO6M_SILENT_US = 3000000,
    NEO6M_AGAIN_US = 10000000,    /* then settings that got no answer are sent once more */
    NEO6M_SURE_PERIOD_MS = 200,   /* that every receiver takes; not all are faster */
    NEO6M_TRIES = 3
};

void neo6m_init(neo6m_t *gps, const neo6m_port_t *port, const neo6m_events_t *events,
                const neo6m_settings_t *settings, uint64_t now_us);

/* Call at least every 50 ms. */
void neo6m_step(neo6m_t *gps, uint64_t now_us);

/* Whether intact sentences came within NEO6M_SILENT_US. */
bool neo6m_is_working(const neo6m_t *gps, uint64_t now_us);

#endif
