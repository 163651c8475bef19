/* The receiver: what it says goes to the log and to the stream; what it needs comes from the settings. */
#include "app.h"

static void on_sentence(void *context, uint64_t time_us, const uint8_t *sentence, size_t length)
{
    app_t *app = context;
    const nmea_fix_t fix = nmea_fix(sentence, length);
    if (fix != NMEA_SAYS_NOTHING) {
        app->gps.has_fix = fix == NMEA_FIX;
        app->gps.fix_us = time_us;
    }
    const uint32_t fat_time = nmea_fat_time(sentence, length);
    if (fat_time)
        app->storage.volume.fat_time = fat_time;
    if (app->recording.is_open && !app->recording.is_stopping) {
        app->board->lock(app->board->context);
        (void)log_writer_gps(&app->writer, time_us, sentence, length); /* a loss is counted in there */
        app->board->unlock(app->board->context);
    }
    if (app->settings.config.stream)
        stream_sentence(&app->stream, time_us, sentence, length);
}

static void on_lost(void *context, uint64_t time_us, uint32_t sentences)
{
    app_t *app = context;
    if (!app->recording.is_open || app->recording.is_stopping)
        return;
    app->board->lock(app->board->context);
    log_writer_lose(&app->writer, RECORD_GPS, GAP_SERIAL, time_us, time_us, sentences);
    app->board->unlock(app->board->context);
}

static void on_configured(void *context, uint32_t baud, uint32_t refused)
{
    app_t *app = context;
    app->gps.baud = baud;
    app->gps.refused = refused;
    app_event(app, refused ? EVENT_GPS_NOT_CONFIGURED : EVENT_GPS_CONFIGURED, refused ? refused : baud);
}

static void on_silent(void *context, uint32_t silent_ms)
{
    app_t *app = context;
    app->gps.baud = 0;
    app->gps.has_fix = false;
    app_event(app, EVENT_GPS_SILENT, silent_ms);
}

void app_start_gps(app_t *app, uint64_t now_us)
{
    const config_t *config = &app->settings.config;
    const neo6m_settings_t settings = {.baud = config->gps_baud, .period_ms = (uint16_t)(1000 / config->gps_rate)};
    app->gps.events = (neo6m_events_t){.context = app,
                                       .on_sentence = on_sentence,
                                       .on_lost = on_lost,
                                       .on_configured = on_configured,
                                       .on_silent = on_silent};
    neo6m_init(&app->gps.receiver, &app->board->gps, &app->gps.events, &settings, now_us);
}
