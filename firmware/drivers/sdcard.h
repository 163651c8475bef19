/* A microSD card in SPI mode: start-up, single sectors, and one long multi-block write that never makes the caller wait.
 *
 * Source: SD Specifications Part 1, Physical Layer Simplified Specification 6.00, chapters 4.3.14, 4.6 and 7. CRCs are
 * switched on (CMD59): a bit flipped on a loose wire is then refused by the card and sent again instead of stored.
 * Cards of the SD family only (v1, v2, HC, XC); MMC is refused. Owns the protocol, knows nothing of file systems. */
#ifndef DRIVERS_SDCARD_H
#define DRIVERS_SDCARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { SD_SECTOR = 512 };

enum {
    SD_OK = 0,
    SD_NO_ANSWER = -1,   /* no card, or it has gone */
    SD_TIMEOUT = -2,     /* busy for longer than SD_BUSY_LONGEST_US, or no data in time */
    SD_REFUSED = -3,     /* a command was answered with an error */
    SD_BAD_CRC = -4,     /* data were damaged on the wire, in either direction */
    SD_WRITE_FAILED = -5, /* the card could not program a sector */
    SD_UNSUPPORTED = -6, /* not a card of this family */
    SD_BUS = -7,         /* the bus itself failed */
    SD_MISUSE = -8       /* a call out of order, or a sector beyond the card */
};

enum {
    SD_START_LONGEST_US = 1000000, /* initialisation, 4.2.3 */
    SD_BUSY_LONGEST_US = 1000000,  /* 250 ms by specification, 500 ms SDXC, 900 ms seen */
    SD_READ_LONGEST_US = 300000,   /* 100 ms by specification */
    SD_TRIES = 5,                  /* of a command, a sector, a block: the first and four more */
    SD_STREAM_LONGEST_US = 1000000 /* then a stream is stopped and opened again: a card may hold back what it was sent */
};

/* Clocks: 18, 9, 4.5 MHz, and at most 400 kHz. A card whose wires disturb every tenth block or so is used more slowly. */
typedef enum { SD_FAST, SD_HALF, SD_QUARTER, SD_START_UP } sd_speed_t;

/* What the driver needs of the board. All return 0, or negative when the bus failed; none waits without a bound. */
typedef struct {
    void *context;
    void (*select)(void *context, bool is_selected);
    void (*set_speed)(void *context, sd_speed_t speed);
    /* Send `out` (NULL: FF) and receive into `in` (NULL: dropped), some bytes, at once. */
    int (*exchange)(void *context, const uint8_t *out, uint8_t *in, size_t length);
    /* The same in the background; at most one at a time. Buffers stay untouched until it is done. */
    int (*start)(void *context, const uint8_t *out, uint8_t *in, size_t length);
    int (*is_done)(void *context); /* 1 done, 0 running */
    uint64_t (*now_us)(void *context);
    void (*wait)(void *context); /* called again and again while the card works: sleep, serve others */
} sd_bus_t;

typedef enum { SD_CLOSED, SD_IDLE, SD_STREAM_READY, SD_STREAM_SENDING, SD_STREAM_BUSY, SD_STREAM_STOPPING } sd_state_t;

typedef struct {
    const sd_bus_t *bus;
    sd_state_t state;
    bool has_sector_addresses; /* SDHC and later; older cards count bytes */
    bool has_crc;              /* CMD59 was accepted */
    uint32_t sectors;
    uint32_t longest_busy_us;  /* since sd_open */
    int error;                 /* the last, whether another try mended it or not */

    sd_speed_t speed;
    uint8_t strain;   /* how often tries fail of late */
    uint32_t retries; /* since sd_open */

    /* the stream */
    uint32_t sector;      /* of the next block */
    const uint8_t *block; /* that is not taken yet, or NULL */
    uint16_t crc;         /* of it */
    uint8_t tries;        /* in a row that failed */
    uint64_t since_us;    /* when it was started, or sent, or the stream was stopped */
    uint64_t opened_us;
} sd_card_t;

/* Reset and identify the card. Blocks, with bus->wait, for at most about SD_START_LONGEST_US. */
int sd_open(sd_card_t *card, const sd_bus_t *bus);

/* The same for a card that was used already: at the speed that was found for it. */
int sd_open_again(sd_card_t *card);

/* Read or write whole sectors; blocks with bus->wait until the card has them. What fails is tried again with a new command. */
int sd_read(sd_card_t *card, uint32_t sector, uint8_t *data, uint32_t count);
int sd_write(sd_card_t *card, uint32_t sector, const uint8_t *data, uint32_t count);

/* Ask the card for its state (CMD13): SD_OK if it is still there and well. */
int sd_check(sd_card_t *card);

/* A multi-block write that goes on from `sector`: open, then again and again {put a block when poll says 1; poll},
 * then close. `block` must stay untouched until poll says 1 again: only then has the card taken it. A block that is
 * refused or misheard is sent again with a new command, and about once a second the write is stopped and opened again,
 * all within poll. */
int sd_stream_open(sd_card_t *card, uint32_t sector);
int sd_stream_put(sd_card_t *card, const uint8_t *block);
int sd_stream_poll(sd_card_t *card); /* 1 ready for a block, 0 working, or negative; never waits */
int sd_stream_close(sd_card_t *card); /* blocks like sd_write */
int sd_stream_halt(sd_card_t *card);  /* the block on its way and the stop token, nothing else: the supply fails */

/* CRC of data blocks: CCITT polynomial 1021, start 0. CRC of commands: polynomial 09, with the end bit. */
uint16_t sd_crc16(const uint8_t *data, size_t length);
uint8_t sd_crc7(const uint8_t *data, size_t length);

#endif
