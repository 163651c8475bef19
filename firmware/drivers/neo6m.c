#include "neo6m.h"

/* NMEA messages have class F0 in CFG-MSG */
enum { NMEA_CLASS = 0xF0, NMEA_GGA = 0, NMEA_GLL = 1, NMEA_GSA = 2, NMEA_GSV = 3, NMEA_RMC = 4, NMEA_VTG = 5, NMEA_GST = 7 };
enum { SETTING_PORT, SETTING_RATE, SETTING_MODEL, SETTING_POWER, SETTING_MESSAGES };
enum { ALL_REFUSED = (1 << NEO6M_SETTINGS) - 1, CHUNK = 32 };

static const struct {
    uint8_t class, id, each;
    uint32_t key;
} messages[] = {{NMEA_CLASS, NMEA_RMC, 1, UBX_KEY_RMC}, {NMEA_CLASS, NMEA_GGA, 1, UBX_KEY_GGA},
                {NMEA_CLASS, NMEA_GST, 1, UBX_KEY_GST}, {UBX_CLASS_NAV, UBX_NAV_VELNED, 1, UBX_KEY_VELNED},
                {NMEA_CLASS, NMEA_GLL, 0, UBX_KEY_GLL}, {NMEA_CLASS, NMEA_GSA, 0, UBX_KEY_GSA},
                {NMEA_CLASS, NMEA_GSV, 0, UBX_KEY_GSV}, {NMEA_CLASS, NMEA_VTG, 0, UBX_KEY_VTG}};

/* Rates to try in turn, after each the one of power-on again: that is what a receiver has when its supply comes back,
 * while it is being looked for. First the one it had if only we were reset. */
static const uint32_t candidates[] = {0 /* the wanted one */, 38400, 115200, 57600, 19200, 4800};
enum { BAUD_AT_POWER_ON = 9600, CANDIDATES = 2 * sizeof candidates / sizeof *candidates };

static uint32_t candidate_baud(const neo6m_t *gps)
{
    const uint32_t baud = gps->candidate % 2 ? candidates[gps->candidate / 2] : BAUD_AT_POWER_ON;
    return baud ? baud : gps->settings.baud;
}

static void set_baud(neo6m_t *gps, uint32_t baud)
{
    gps->baud = baud;
    gps->port->set_baud(gps->port->context, baud);
    nmea_init(&gps->framer);
    gps->dropped = 0;
    ubx_init(&gps->parser);
}

static void enter(neo6m_t *gps, neo6m_state_t state, uint64_t now_us)
{
    gps->state = state;
    gps->since_us = now_us;
    gps->tries = 0;
    gps->is_waiting = gps->is_heard = false;
}

/* ---- commands ---- */

static size_t modern_frame(const neo6m_t *gps, uint8_t setting, uint8_t *frame)
{
    switch (setting) {
    case SETTING_PORT:
        return ubx_set_value(frame, UBX_KEY_BAUD, gps->settings.baud);
    case SETTING_RATE:
        return ubx_set_value(frame, UBX_KEY_PERIOD, gps->settings.period_ms);
    case SETTING_MODEL:
        return ubx_set_value(frame, UBX_KEY_MODEL, UBX_AUTOMOTIVE);
    case SETTING_POWER:
        return ubx_set_value(frame, UBX_KEY_POWER, UBX_CONTINUOUS);
    default:
        return ubx_set_value(frame, messages[setting - SETTING_MESSAGES].key, messages[setting - SETTING_MESSAGES].each);
    }
}

static size_t setting_frame(const neo6m_t *gps, uint8_t setting, uint8_t *frame)
{
    if (gps->is_modern)
        return modern_frame(gps, setting, frame);
    switch (setting) {
    case SETTING_PORT:
        return ubx_set_port(frame, gps->settings.baud);
    case SETTING_RATE:
        return ubx_set_rate(frame, gps->settings.period_ms);
    case SETTING_MODEL:
        return ubx_set_automotive(frame);
    case SETTING_POWER:
        return ubx_set_continuous(frame);
    default:
        return ubx_set_message(frame, messages[setting - SETTING_MESSAGES].class, messages[setting - SETTING_MESSAGES].id,
                               messages[setting - SETTING_MESSAGES].each);
    }
}

static uint8_t setting_id(const neo6m_t *gps, uint8_t setting)
{
    static const uint8_t ids[] = {UBX_CFG_PRT, UBX_CFG_RATE, UBX_CFG_NAV5, UBX_CFG_RXM};
    if (gps->is_modern)
        return UBX_CFG_VALSET;
    return setting < SETTING_MESSAGES ? ids[setting] : UBX_CFG_MSG;
}

static int send_setting(neo6m_t *gps, uint8_t setting)
{
    uint8_t frame[UBX_FRAME_LONGEST];
    return gps->port->write(gps->port->context, frame, setting_frame(gps, setting, frame));
}

/* The wanted baud rate, in both ways: it is not known yet which one the receiver understands. */
static int send_port(neo6m_t *gps)
{
    uint8_t frames[UBX_FRAME_LONGEST]; /* 28 and 20 bytes */
    size_t length = ubx_set_port(frames, gps->settings.baud);
    length += ubx_set_value(frames + length, UBX_KEY_BAUD, gps->settings.baud);
    return gps->port->write(gps->port->context, frames, length);
}

/* Send gps->setting, unless the line is taken; then the next step tries again. */
static void ask(neo6m_t *gps, uint64_t now_us)
{
    if (send_setting(gps, gps->setting) < 0)
        return;
    gps->is_waiting = true;
    gps->since_us = now_us;
    gps->tries++;
}

/* ---- looking for the receiver ---- */

/* Tell it, at a rate it may have, to take the wanted one. */
static void try_candidate(neo6m_t *gps, uint64_t now_us)
{
    enter(gps, NEO6M_SWITCHING, now_us);
    set_baud(gps, candidate_baud(gps));
    gps->is_waiting = send_port(gps) == 0;
}

static void try_next(neo6m_t *gps, uint64_t now_us)
{
    gps->candidate = (uint8_t)((gps->candidate + 1) % CANDIDATES);
    gps->is_second_try = false;
    try_candidate(gps, now_us);
}

static void begin_asking(neo6m_t *gps, uint64_t now_us)
{
    set_baud(gps, gps->settings.baud);
    enter(gps, NEO6M_ASKING, now_us);
    gps->setting = SETTING_MESSAGES; /* which none of those that understand it refuses */
    gps->is_modern = false;
    ask(gps, now_us);
}

static void begin_configuring(neo6m_t *gps, uint64_t now_us)
{
    enter(gps, NEO6M_CONFIGURING, now_us);
    gps->refused = 0;
    gps->is_unanswered = false;
    gps->setting = SETTING_PORT;
    ask(gps, now_us);
}

static void begin_running(neo6m_t *gps, uint64_t now_us)
{
    enter(gps, NEO6M_RUNNING, now_us);
    gps->heard_us = now_us;
    gps->events->on_configured(gps->events->context, gps->baud, gps->refused);
}

static void next_setting(neo6m_t *gps, bool was_acknowledged, uint64_t now_us)
{
    if (!was_acknowledged && gps->setting == SETTING_RATE && gps->settings.period_ms < NEO6M_SURE_PERIOD_MS) {
        gps->settings.period_ms = NEO6M_SURE_PERIOD_MS;
        gps->tries = 0;
        ask(gps, now_us);
        return;
    }
    if (!was_acknowledged)
        gps->refused |= 1u << gps->setting;
    gps->tries = 0;
    gps->is_waiting = false;
    if (++gps->setting == NEO6M_SETTINGS)
        begin_running(gps, now_us);
    else
        ask(gps, now_us);
}

/* ---- what comes in ---- */

static void take_answer(neo6m_t *gps, uint64_t now_us)
{
    if (!gps->is_waiting || (gps->state != NEO6M_ASKING && gps->state != NEO6M_CONFIGURING))
        return;
    const ubx_answer_t answer = ubx_answer(&gps->parser, UBX_CLASS_CFG, setting_id(gps, gps->setting));
    if (answer == UBX_OTHER)
        return;
    if (gps->state == NEO6M_ASKING) { /* refused or not: it hears and is heard */
        gps->is_modern = gps->is_modern == (answer == UBX_ACKNOWLEDGED);
        begin_configuring(gps, now_us);
    } else {
        next_setting(gps, answer == UBX_ACKNOWLEDGED, now_us);
    }
}

static void take_velocity(neo6m_t *gps, uint64_t last_us)
{
    const size_t length = UBX_OVERHEAD + UBX_VELNED_BYTES;
    const uint64_t first_us = last_us - (length - 1) * 10000000u / gps->baud;
    gps->events->on_sentence(gps->events->context, first_us, gps->parser.frame, length);
}

static void take_sentence(neo6m_t *gps, size_t length, uint64_t now_us)
{
    if (nmea_is_intact(gps->framer.sentence, length)) {
        gps->heard_us = now_us;
        gps->is_heard = true;
    }
    gps->events->on_sentence(gps->events->context, gps->framer.time_us, gps->framer.sentence, length);
}

static void tell_dropped(neo6m_t *gps, uint64_t time_us)
{
    const uint32_t dropped = gps->framer.dropped - gps->dropped;
    gps->dropped = gps->framer.dropped;
    if (dropped && gps->state == NEO6M_RUNNING) /* at a wrong rate everything looks cut off */
        gps->events->on_lost(gps->events->context, time_us, dropped);
}

static void take_bytes(neo6m_t *gps, const uint8_t *bytes, size_t count, uint64_t first_us, uint64_t now_us)
{
    for (size_t i = 0; i < count; i++) {
        const uint64_t byte_us = first_us + i * 10000000u / gps->baud;
        const bool is_within = ubx_is_within(&gps->parser);
        const bool is_frame = ubx_push(&gps->parser, bytes[i]);
        const size_t length = is_within ? 0 : nmea_push(&gps->framer, bytes[i], byte_us);
        if (length)
            take_sentence(gps, length, now_us);
        if (is_frame && ubx_is_velocity(&gps->parser))
            take_velocity(gps, byte_us);
        else if (is_frame)
            take_answer(gps, now_us);
    }
    tell_dropped(gps, first_us);
}

static void receive(neo6m_t *gps, uint64_t now_us)
{
    uint8_t bytes[CHUNK];
    uint64_t first_us = 0;
    uint32_t lost = 0;
    for (int i = 0; i < 2048 / CHUNK; i++) { /* a bound, should bytes come faster than they are taken */
        const uint32_t baud = gps->baud;
        const size_t count = gps->port->read(gps->port->context, bytes, sizeof bytes, &first_us, &lost);
        if (lost)
            nmea_break(&gps->framer);
        if (count == 0)
            return;
        take_bytes(gps, bytes, count, first_us, now_us);
        if (gps->baud != baud)
            return;
    }
}

/* ---- time ---- */

static void step_asking(neo6m_t *gps, uint64_t now_us)
{
    if (gps->is_waiting && now_us - gps->since_us < NEO6M_ANSWER_US)
        return;
    if (gps->tries < NEO6M_TRIES - 1) {
        gps->is_modern = !gps->is_modern; /* it may not answer what it does not know */
        ask(gps, now_us);
        return;
    }
    set_baud(gps, candidate_baud(gps));
    enter(gps, NEO6M_LISTENING, now_us);
}

/* It talks. When it was asked it may not have had its supply yet: ask again, once; if it does not obey then either, log
 * what it says. */
static void step_heard(neo6m_t *gps, uint64_t now_us)
{
    if (!gps->is_second_try) {
        gps->is_second_try = true;
        try_candidate(gps, now_us);
        return;
    }
    gps->refused = ALL_REFUSED;
    gps->is_unanswered = false; /* it does not hear */
    begin_running(gps, now_us);
}

static void step_configuring(neo6m_t *gps, uint64_t now_us)
{
    if (gps->is_waiting && now_us - gps->since_us < NEO6M_ANSWER_US)
        return;
    if (gps->is_waiting && gps->tries >= NEO6M_TRIES) {
        gps->is_unanswered = true;
        next_setting(gps, false, now_us);
    } else {
        ask(gps, now_us);
    }
}

static void step_running(neo6m_t *gps, uint64_t now_us)
{
    const uint64_t silent_us = now_us - gps->heard_us;
    if (gps->is_unanswered && now_us - gps->since_us >= NEO6M_AGAIN_US) {
        begin_configuring(gps, now_us); /* it was away, for less than would count as silent */
        return;
    }
    if (silent_us < NEO6M_SILENT_US)
        return;
    gps->events->on_silent(gps->events->context, (uint32_t)(silent_us / 1000));
    gps->candidate = 0;
    gps->is_second_try = false;
    try_candidate(gps, now_us);
}

static void step_time(neo6m_t *gps, uint64_t now_us)
{
    const uint64_t elapsed_us = now_us - gps->since_us;
    switch (gps->state) {
    case NEO6M_SWITCHING:
        if (elapsed_us >= NEO6M_SWITCH_US)
            begin_asking(gps, now_us);
        break;
    case NEO6M_ASKING:
        step_asking(gps, now_us);
        break;
    case NEO6M_LISTENING:
        if (gps->is_heard)
            step_heard(gps, now_us);
        else if (elapsed_us >= NEO6M_LISTEN_US)
            try_next(gps, now_us);
        break;
    case NEO6M_CONFIGURING:
        step_configuring(gps, now_us);
        break;
    case NEO6M_RUNNING:
        step_running(gps, now_us);
        break;
    }
}

void neo6m_init(neo6m_t *gps, const neo6m_port_t *port, const neo6m_events_t *events,
                const neo6m_settings_t *settings, uint64_t now_us)
{
    *gps = (neo6m_t){.port = port, .events = events, .settings = *settings};
    try_candidate(gps, now_us);
}

void neo6m_step(neo6m_t *gps, uint64_t now_us)
{
    receive(gps, now_us);
    step_time(gps, now_us);
}

bool neo6m_is_working(const neo6m_t *gps, uint64_t now_us)
{
    return gps->heard_us != 0 && now_us - gps->heard_us < NEO6M_SILENT_US;
}
