/* Recordings on the card: a spare file made beforehand, filled by one long write, cut to length at the end, and put
 * right at the next start when there was no end. Blocks come from the log writer's ring and leave it when the card has
 * taken them. Everything but storage_step may take a second or more; the bus' wait is called meanwhile. */
#ifndef APP_STORAGE_H
#define APP_STORAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "log_writer.h"
#include "sdcard.h"
#include "volume.h"

enum {
    STORAGE_OK = 0,
    STORAGE_CARD = -1,    /* no card, or it failed: card_error says how */
    STORAGE_FORMAT = -2,  /* the card is not FAT16 or FAT32 */
    STORAGE_FULL = -3,
    STORAGE_MISSING = -4, /* no such file */
    STORAGE_OTHER = -5    /* another card than before */
};

enum {
    STORAGE_LARGEST = 512 << 20, /* of one file: 8 hours at 17 kB/s */
    STORAGE_STEP = 16 << 20,     /* sizes of unfinished files are multiples of this; DESIGN.md section 5 */
    STORAGE_RESERVE = 64         /* blocks before the end of a file when the next one is made: more than the ring holds */
};

typedef enum { STORAGE_CLOSED, STORAGE_READY, STORAGE_RECORDING } storage_state_t;

typedef struct {
    const sd_bus_t *bus;
    storage_state_t state;
    sd_card_t card;
    volume_t volume;
    file_t current, spare;
    bool has_spare;
    bool is_full;          /* no room for another file */
    bool is_calibrated;    /* there is a recording of the magnetometer's calibration */
    bool is_block_sent;    /* the oldest block of the ring is on its way */
    uint32_t blocks, next_block; /* of the current file */
    uint32_t session;
    uint32_t last_number;
    uint32_t recovered;    /* blocks of the file that was left unfinished, at storage_open */
    int card_error;
} storage_t;

/* Open the card, put right what a power cut left, see to it that there is a spare file. The state is STORAGE_READY
 * afterwards, or STORAGE_CLOSED; a full card is ready, without a spare. */
int storage_open(storage_t *storage, const sd_bus_t *bus);

/* Read a text file whole: its length, at most `size` bytes, goes to *length. */
int storage_read_file(storage_t *storage, const char *name, char *text, size_t size, size_t *length);

/* Make the spare file a recording, and begin to write. The same session may go on in another file. */
int storage_begin(storage_t *storage, uint32_t session, bool is_calibration);

/* Move the ring's blocks on by one step, without waiting (but about once in 8 hours, when a new file is due): 1 something
 * was done, 0 nothing to do, or an error: then storage_resume or storage_open. */
int storage_step(storage_t *storage, log_writer_t *writer);

/* Whether every committed block is on the card. */
bool storage_is_drained(const storage_t *storage, log_writer_t *writer);

/* After an error: start the card again and go on with the block that failed. */
int storage_resume(storage_t *storage);

/* End the recording: cut the file to length, make the next spare. */
int storage_end(storage_t *storage);

/* Let go of the card as it is: the supply fails. The next storage_open ends the recording. */
int storage_halt(storage_t *storage);

/* How fast the card writes: so many blocks go to the spare file, whose content counts for nothing. The time they took,
 * and the longest that the card was busy with one, in us. STORAGE_FULL without a spare file. */
int storage_measure(storage_t *storage, const uint8_t *block, uint32_t blocks, uint32_t *took_us, uint32_t *longest_us);

/* Ask whether the card is still there, while nothing is recorded. */
int storage_check(storage_t *storage);

#endif
