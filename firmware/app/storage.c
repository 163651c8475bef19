#include "storage.h"

#include "block.h"
#include "error.h"
#include "recovery.h"

enum { NUMBER_LAST = 99999 };

/* Results of volume.h in the words of this file. */
static int translate(storage_t *storage, int result)
{
    switch (result) {
    case VOLUME_OK:
        return STORAGE_OK;
    case VOLUME_UNKNOWN:
        return STORAGE_FORMAT;
    case VOLUME_FULL:
        return STORAGE_FULL;
    case VOLUME_NOT_FOUND:
        return STORAGE_MISSING;
    default:
        storage->card_error = storage->card.error;
        storage->state = STORAGE_CLOSED;
        return STORAGE_CARD;
    }
}

static int fail(storage_t *storage, int card_error)
{
    storage->card_error = card_error;
    storage->state = STORAGE_CLOSED;
    return STORAGE_CARD;
}

static bool is_unfinished_size(uint32_t bytes)
{
    return bytes != 0 && bytes % STORAGE_STEP == 0;
}

/* ---- the spare file ---- */

static int finish_spare(storage_t *storage, file_t *file)
{
    const int result = volume_set_kind(&storage->volume, file, FILE_SPARE);
    storage->spare = *file;
    storage->has_spare = result == VOLUME_OK;
    return result;
}

/* Give an empty file its room, as much as there is. */
static int fill_spare(storage_t *storage, file_t *file)
{
    volume_t *volume = &storage->volume;
    int result = volume_reserve(volume, file, STORAGE_LARGEST, STORAGE_STEP);
    if (result == VOLUME_FULL) {
        storage->is_full = true;
        return volume_delete(volume, file);
    }
    if (result == VOLUME_OK)
        result = volume_link(volume, file);
    if (result == VOLUME_OK)
        result = volume_note_free(volume, -(int32_t)(file->bytes / volume_cluster_bytes(volume)));
    return result == VOLUME_OK ? finish_spare(storage, file) : result;
}

static int make_spare(storage_t *storage)
{
    file_t file;
    storage->is_full = storage->last_number >= NUMBER_LAST;
    if (storage->has_spare || storage->is_full)
        return VOLUME_OK;
    int result = volume_create(&storage->volume, storage->last_number + 1, &file);
    if (result == VOLUME_FULL) {
        storage->is_full = true;
        return VOLUME_OK;
    }
    if (result == VOLUME_OK) {
        storage->last_number++;
        result = fill_spare(storage, &file);
    }
    return result;
}

/* ---- putting right ---- */

typedef struct {
    storage_t *storage;
    file_t newest, temporary; /* number 0: none */
} survey_t;

static int look_at(void *context, const file_t *file)
{
    survey_t *survey = context;
    storage_t *storage = survey->storage;
    if (file->number > storage->last_number)
        storage->last_number = file->number;
    if (file->kind == FILE_TEMPORARY) {
        survey->temporary = *file;
    } else if (file->kind == FILE_SPARE) {
        storage->spare = *file;
        storage->has_spare = true;
    } else {
        storage->is_calibrated = storage->is_calibrated || file->is_calibration;
        if (file->number > survey->newest.number)
            survey->newest = *file;
    }
    return VOLUME_OK;
}

/* A spare file that was being made: go on where it stopped. */
static int resume_temporary(storage_t *storage, file_t *file)
{
    volume_t *volume = &storage->volume;
    if (!is_unfinished_size(file->bytes))
        return fill_spare(storage, file);
    int result = volume_link(volume, file);
    if (result == VOLUME_CONFLICT)
        return volume_delete(volume, file); /* something else was written there since: it has the right to it */
    if (result == VOLUME_OK)
        result = volume_count_free(volume);
    return result == VOLUME_OK ? finish_spare(storage, file) : result;
}

static int read_block(void *context, uint32_t index, uint8_t *block)
{
    storage_t *storage = context;
    return sd_read(&storage->card, volume_first_sector(&storage->volume, &storage->current) + index, block, 1);
}

/* The buffer all of this works in. */
static uint8_t *scratch(storage_t *storage)
{
    storage->volume.fs.winsect = (LBA_t)0 - 1;
    return storage->volume.fs.win;
}

static bool read_head(storage_t *storage, uint32_t index, block_head_t *head)
{
    uint8_t *block = scratch(storage);
    return read_block(storage, index, block) == SD_OK && block_read_head(block, head) == CORE_OK;
}

/* A file that was closed ends with a block of its recording. */
static bool is_finished(storage_t *storage)
{
    block_head_t first, last;
    const uint32_t blocks = storage->current.bytes / BLOCK_BYTES;
    if (storage->current.bytes % BLOCK_BYTES != 0 || blocks == 0 || is_unfinished_size(storage->current.bytes))
        return false;
    return read_head(storage, 0, &first) && read_head(storage, blocks - 1, &last) && first.session == last.session;
}

/* How many blocks the file may hold: by its size while that is untouched, else (torn) by its chain. */
static int count_room(storage_t *storage, uint32_t *blocks)
{
    if (is_unfinished_size(storage->current.bytes)) {
        *blocks = storage->current.bytes / BLOCK_BYTES;
        return VOLUME_OK;
    }
    uint32_t clusters = 0;
    const int result = volume_count_chain(&storage->volume, &storage->current, &clusters);
    *blocks = clusters * storage->volume.fs.csize;
    return result;
}

/* The recording that was under way when the power went (storage->current): find its end, cut it there. */
static int finish_recording(storage_t *storage)
{
    const recovery_source_t source = {.read = read_block, .context = storage};
    volume_t *volume = &storage->volume;
    recovery_end_t end = {0};
    uint32_t blocks = 0;
    int result = count_room(storage, &blocks);
    if (result != VOLUME_OK || blocks == 0)
        return result;
    if (recovery_find_end(&source, blocks, scratch(storage), &end) != CORE_OK)
        return VOLUME_CARD;
    storage->recovered = end.blocks;
    if (end.session == 0) /* not one block: it may as well be the spare again */
        return is_unfinished_size(storage->current.bytes) && !storage->has_spare ? finish_spare(storage, &storage->current)
                                                                                : VOLUME_OK;
    if (!is_unfinished_size(storage->current.bytes))
        return volume_set_size(volume, &storage->current, end.blocks * BLOCK_BYTES);
    return end.blocks < blocks ? volume_truncate(volume, &storage->current, end.blocks * BLOCK_BYTES) : VOLUME_OK;
}

static int put_right(storage_t *storage)
{
    survey_t survey = {.storage = storage};
    int result = volume_visit(&storage->volume, look_at, &survey);
    if (result == VOLUME_OK && survey.newest.number != 0) {
        storage->current = survey.newest;
        if (!is_finished(storage))
            result = finish_recording(storage);
    }
    if (result == VOLUME_OK && survey.temporary.number != 0)
        result = resume_temporary(storage, &survey.temporary);
    return result;
}

int storage_open(storage_t *storage, const sd_bus_t *bus)
{
    storage->bus = bus;
    storage->state = STORAGE_CLOSED;
    storage->has_spare = storage->is_full = storage->is_calibrated = storage->is_block_sent = false;
    storage->last_number = storage->recovered = 0;
    storage->card_error = sd_open(&storage->card, bus);
    if (storage->card_error != SD_OK)
        return STORAGE_CARD;
    int result = volume_mount(&storage->volume, &storage->card);
    if (result == VOLUME_OK)
        result = put_right(storage);
    if (result == VOLUME_OK)
        result = make_spare(storage);
    if (result == VOLUME_OK)
        storage->state = STORAGE_READY;
    return translate(storage, result);
}

int storage_read_file(storage_t *storage, const char *name, char *text, size_t size, size_t *length)
{
    FIL file;
    UINT got = 0;
    if (storage->state != STORAGE_READY)
        return STORAGE_MISSING;
    FRESULT result = f_open(&file, name, FA_READ);
    if (result == FR_NO_FILE)
        return STORAGE_MISSING;
    if (result == FR_OK)
        result = f_read(&file, text, (UINT)size, &got);
    *length = got;
    return result == FR_OK && f_close(&file) == FR_OK ? STORAGE_OK : STORAGE_CARD;
}

/* ---- recording ---- */

static int open_stream(storage_t *storage)
{
    const uint32_t sector = volume_first_sector(&storage->volume, &storage->current) + storage->next_block;
    const int result = sd_stream_open(&storage->card, sector);
    return result == SD_OK ? STORAGE_OK : fail(storage, result);
}

/* Turn the spare into the current file. The kind is changed last: before, it is still a spare. */
static int take_spare(storage_t *storage, bool is_calibration)
{
    int result = volume_set_calibration(&storage->volume, &storage->spare, is_calibration);
    if (result == VOLUME_OK)
        result = volume_set_kind(&storage->volume, &storage->spare, FILE_RECORDING);
    if (result != VOLUME_OK)
        return translate(storage, result);
    storage->current = storage->spare;
    storage->has_spare = false;
    storage->blocks = storage->current.bytes / BLOCK_BYTES;
    storage->next_block = 0;
    return open_stream(storage);
}

int storage_begin(storage_t *storage, uint32_t session, bool is_calibration)
{
    if (storage->state != STORAGE_READY || !storage->has_spare)
        return STORAGE_FULL;
    storage->session = session;
    storage->is_block_sent = false;
    storage->next_block = 0;
    const int result = take_spare(storage, is_calibration);
    if (result == STORAGE_OK)
        storage->state = STORAGE_RECORDING;
    return result;
}

static int close_stream(storage_t *storage)
{
    const int result = sd_stream_close(&storage->card);
    return result == SD_OK ? STORAGE_OK : fail(storage, result);
}

/* Near the end of a file: make the next one now, while there is room for a stop record if that fails. */
static int prepare_next(storage_t *storage)
{
    int result = close_stream(storage);
    if (result == STORAGE_OK)
        result = translate(storage, make_spare(storage));
    return result == STORAGE_OK ? open_stream(storage) : result;
}

static int change_file(storage_t *storage)
{
    const int result = close_stream(storage);
    if (result != STORAGE_OK)
        return result;
    return storage->has_spare ? take_spare(storage, storage->current.is_calibration) : STORAGE_FULL;
}

static void confirm_block(storage_t *storage, log_writer_t *writer)
{
    log_writer_release(writer);
    storage->is_block_sent = false;
    storage->next_block++;
}

static int send_block(storage_t *storage, const uint8_t *block)
{
    const int result = sd_stream_put(&storage->card, block);
    if (result != SD_OK)
        return fail(storage, result);
    storage->is_block_sent = true;
    return 1;
}

int storage_step(storage_t *storage, log_writer_t *writer)
{
    if (storage->state != STORAGE_RECORDING)
        return STORAGE_CARD;
    const int ready = sd_stream_poll(&storage->card);
    if (ready < 0)
        return fail(storage, ready);
    if (ready == 0)
        return 0;
    if (storage->is_block_sent)
        confirm_block(storage, writer);
    const uint8_t *block = log_writer_front(writer, 0);
    if (block == NULL)
        return 0;
    int result = STORAGE_OK;
    if (storage->next_block == storage->blocks)
        result = change_file(storage);
    else if (storage->blocks - storage->next_block == STORAGE_RESERVE && !storage->has_spare && !storage->is_full)
        result = prepare_next(storage);
    return result == STORAGE_OK ? send_block(storage, block) : result;
}

bool storage_is_drained(const storage_t *storage, log_writer_t *writer)
{
    return !storage->is_block_sent && log_writer_count(writer) == 0;
}

/* ---- errors ---- */

/* Whether the card that answers is the one the current file is on: same entry, same last block. */
static int check_same_card(storage_t *storage)
{
    block_head_t head;
    file_t found;
    const int result = volume_reload(&storage->volume, &storage->current, &found);
    if (result != VOLUME_OK)
        return result == VOLUME_CARD ? STORAGE_CARD : STORAGE_OTHER;
    if (found.number != storage->current.number || found.kind != FILE_RECORDING ||
        found.first_cluster != storage->current.first_cluster || found.bytes != storage->current.bytes)
        return STORAGE_OTHER;
    if (storage->next_block == 0)
        return STORAGE_OK;
    return read_head(storage, storage->next_block - 1, &head) && head.session == storage->session ? STORAGE_OK
                                                                                                 : STORAGE_OTHER;
}

int storage_resume(storage_t *storage)
{
    storage->is_block_sent = false;
    storage->card_error = sd_open_again(&storage->card);
    if (storage->card_error != SD_OK)
        return STORAGE_CARD;
    int result = check_same_card(storage);
    if (result == STORAGE_OK)
        result = open_stream(storage);
    if (result == STORAGE_OK)
        storage->state = STORAGE_RECORDING;
    return result;
}

/* ---- the end ---- */

int storage_end(storage_t *storage)
{
    if (storage->state != STORAGE_RECORDING)
        return STORAGE_CARD;
    int result = close_stream(storage);
    if (result != STORAGE_OK)
        return result;
    storage->state = STORAGE_READY;
    if (storage->next_block == 0)
        return translate(storage, finish_spare(storage, &storage->current));
    storage->is_calibrated = storage->is_calibrated || storage->current.is_calibration;
    result = volume_truncate(&storage->volume, &storage->current, storage->next_block * BLOCK_BYTES);
    if (result == VOLUME_OK)
        result = make_spare(storage);
    return translate(storage, result);
}

int storage_halt(storage_t *storage)
{
    const int result = storage->state == STORAGE_RECORDING ? sd_stream_halt(&storage->card) : SD_OK;
    storage->state = STORAGE_CLOSED;
    return result == SD_OK ? STORAGE_OK : fail(storage, result);
}

int storage_check(storage_t *storage)
{
    if (storage->state != STORAGE_READY)
        return STORAGE_CARD;
    const int result = sd_check(&storage->card);
    return result == SD_OK ? STORAGE_OK : fail(storage, result);
}

/* ---- a test of the card ---- */

static int write_blocks(sd_card_t *card, const uint8_t *block, uint32_t blocks)
{
    int result = SD_OK;
    for (uint32_t i = 0; i < blocks && result >= 0; i++) {
        while ((result = sd_stream_poll(card)) == 0)
            card->bus->wait(card->bus->context);
        if (result > 0)
            result = sd_stream_put(card, block);
    }
    return result < 0 ? result : sd_stream_close(card);
}

int storage_measure(storage_t *storage, const uint8_t *block, uint32_t blocks, uint32_t *took_us, uint32_t *longest_us)
{
    sd_card_t *card = &storage->card;
    const uint64_t began_us = card->bus->now_us(card->bus->context);
    if (storage->state != STORAGE_READY || !storage->has_spare)
        return STORAGE_FULL;
    card->longest_busy_us = 0;
    int result = sd_stream_open(card, volume_first_sector(&storage->volume, &storage->spare));
    if (result == SD_OK)
        result = write_blocks(card, block, blocks);
    *took_us = (uint32_t)(card->bus->now_us(card->bus->context) - began_us);
    *longest_us = card->longest_busy_us;
    return result == SD_OK ? STORAGE_OK : fail(storage, result);
}
