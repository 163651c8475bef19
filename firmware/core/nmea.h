/* From received bytes to whole NMEA sentences: framing, checksum and the few fields the logger itself looks at. */
#ifndef CORE_NMEA_H
#define CORE_NMEA_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "records.h"

typedef struct {
    uint8_t sentence[RECORD_GPS_LONGEST];
    size_t length;    /* bytes so far, 0 between sentences */
    bool is_whole;
    uint64_t time_us; /* of the `$` */
    uint32_t dropped; /* sentences cut off or too long, since the start */
    uint32_t noise;   /* bytes outside of sentences, UBX frames included, since the start */
} nmea_framer_t;

void nmea_init(nmea_framer_t *framer);

/* Take one byte, received at time_us (start of the byte). Returns the length when it ends a sentence, which is then in
 * framer->sentence from `$` to LF until the next byte; 0 else. */
size_t nmea_push(nmea_framer_t *framer, uint8_t byte, uint64_t time_us);

/* Bytes were lost: what is begun is given up and counted. */
void nmea_break(nmea_framer_t *framer);

/* Whether the checksum is there and right. */
bool nmea_is_intact(const uint8_t *sentence, size_t length);

/* What an intact sentence says of the fix. */
typedef enum { NMEA_SAYS_NOTHING, NMEA_NO_FIX, NMEA_FIX } nmea_fix_t;
nmea_fix_t nmea_fix(const uint8_t *sentence, size_t length);

/* The date and time (UTC) of an intact RMC with a fix, as a FAT directory entry has them: time in the lower half, date in
 * the upper. 0 if the sentence says none. */
uint32_t nmea_fat_time(const uint8_t *sentence, size_t length);

#endif
