/* The few changes to a FAT volume that have to survive a power cut at any moment, one sector at a time.
 *
 * FatFs mounts, reads files and finds free room; it does not promise in what order it writes, so what makes and ends a
 * recording is written here: directory entries by single bytes that decide (a torn sector is then old or new, nothing
 * between), allocation as one contiguous run that can be written again from what the entry says. DESIGN.md section 5
 * has the order of writes and what each cut leaves. FAT16 and FAT32, root directory.
 *
 * Source: Microsoft, FAT32 File System Specification 1.03. */
#ifndef APP_VOLUME_H
#define APP_VOLUME_H

#include <stdbool.h>
#include <stdint.h>

#include "ff.h"

#include "sdcard.h"

enum {
    VOLUME_OK = 0,
    VOLUME_CARD = -1,      /* the card failed */
    VOLUME_UNKNOWN = -2,   /* no FAT16 or FAT32 */
    VOLUME_CONFLICT = -3,  /* clusters belong to somebody else */
    VOLUME_FULL = -4,      /* no free entry, no free run */
    VOLUME_NOT_FOUND = -5
};

typedef struct {
    sd_card_t *card;
    uint32_t fat_time; /* date and time of what is written, as nmea_fat_time has them; 0: not known */
    FATFS fs;
} volume_t;

/* What the logger calls its files: LOG or MAG, a number, and what has become of it. */
typedef enum { FILE_TEMPORARY = 'T', FILE_SPARE = 'S', FILE_RECORDING = 'G' } file_kind_t; /* .KLT .KLS .KLG */

typedef struct {
    uint32_t number;  /* 1 to 99999 */
    file_kind_t kind;
    bool is_calibration; /* MAGnnnnn */
    uint32_t first_cluster;
    uint32_t bytes;
    uint32_t sector;  /* of the directory entry */
    uint16_t offset;  /* in it */
} file_t;

/* Mount the card's first FAT volume. */
int volume_mount(volume_t *volume, sd_card_t *card);

/* Call `visit` for every file of the logger in the root directory, until it returns other than VOLUME_OK. It must not
 * use the volume. */
int volume_visit(volume_t *volume, int (*visit)(void *context, const file_t *file), void *context);

/* Read the entry of `file` again; VOLUME_NOT_FOUND if it is none of the logger's now. */
int volume_reload(volume_t *volume, const file_t *file, file_t *found);

/* Add LOGnnnnn.KLT, empty. */
int volume_create(volume_t *volume, uint32_t number, file_t *file);

/* Find the longest contiguous free run, up to `most_bytes`, and note as much of it as is a multiple of `step_bytes` (16 MB)
 * in the entry of an empty file. */
int volume_reserve(volume_t *volume, file_t *file, uint32_t most_bytes, uint32_t step_bytes);

/* Write the chain of a reserved file. VOLUME_CONFLICT: a cluster is taken by something else, nothing was changed. */
int volume_link(volume_t *volume, const file_t *file);

/* Cut the chain of a file whose clusters are contiguous, then its size, to `bytes`. */
int volume_truncate(volume_t *volume, file_t *file, uint32_t bytes);

int volume_set_kind(volume_t *volume, file_t *file, file_kind_t kind);
int volume_set_calibration(volume_t *volume, file_t *file, bool is_calibration);
int volume_set_size(volume_t *volume, file_t *file, uint32_t bytes);
int volume_delete(volume_t *volume, const file_t *file); /* the entry alone; clusters must be free or noted elsewhere */

/* Clusters in the contiguous chain that begins with the file's first. */
int volume_count_chain(volume_t *volume, const file_t *file, uint32_t *clusters);

/* Bring the count of free clusters up to date: by `change`, or by counting them all (seconds on a large card). */
int volume_note_free(volume_t *volume, int32_t change);
int volume_count_free(volume_t *volume);

uint32_t volume_cluster_bytes(const volume_t *volume);
uint32_t volume_first_sector(const volume_t *volume, const file_t *file);

#endif
