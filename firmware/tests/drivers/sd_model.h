/* An SD card in SPI mode, byte by byte, as its specification has it: an independent reading of it, not of the driver.
 * Sectors live in pages made on first use, so that cards of gigabytes are cheap. It can be slow, lie, be pulled out, and
 * lose its power at any write, with the sector it was writing torn. */
#ifndef TESTS_SD_MODEL_H
#define TESTS_SD_MODEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum { SD_MODEL_V1, SD_MODEL_V2, SD_MODEL_HC } sd_model_kind_t;

/* What the specification forbids the host; the first such is kept. Nothing counts between power and the first CMD0, or
 * between a restart of the host and its next: the card may have heard half of anything. */
typedef enum {
    SD_MODEL_FINE,
    SD_MODEL_ASLEEP,   /* CMD0 before 74 clocks with CS high, 6.4.1 */
    SD_MODEL_TOO_FAST, /* 400 kHz until ACMD41 is done, then 25 MHz, 4.2.1 */
    SD_MODEL_IN_BUSY,  /* a command but CMD0 while it is busy, 7.2.4 */
    SD_MODEL_DISORDER, /* a command before ACMD41 is done, or within a write, 7.2.1 */
    SD_MODEL_TOKEN,    /* another token than the write's, 7.3.3 */
    SD_MODEL_CHECKSUM, /* a wrong CRC that no disturbance explains, 7.2.2 */
    SD_MODEL_LET_GO    /* CS goes high within a command or a block, 7.2 */
} sd_model_flaw_t;

enum { SD_MODEL_SECTOR = 512, SD_MODEL_PAGE = 65536, SD_MODEL_INFINITE = 0x7FFFFFFF };

typedef struct {
    /* the medium, which outlives the power */
    uint8_t **pages;
    uint32_t sectors;
    sd_model_kind_t kind;
    bool is_protected; /* takes no write any more, as worn-out cards do */

    /* the world around it */
    const uint64_t *now_us;
    uint32_t clock_hz; /* of the byte that is exchanged; 0: not known */
    bool is_absent;

    /* what is to go wrong; counted in sectors written since the start of the model */
    uint32_t cut_at;        /* this write is the last: power goes with it (SD_MODEL_INFINITE: never) */
    uint32_t torn_bytes;    /* so many bytes of it are stored */
    uint32_t stall_every;   /* each so many writes the card is busy for stall_us */
    uint32_t stall_us;
    uint32_t busy_us;       /* after the others */
    uint32_t refuse_at, refuse_times; /* this write is answered with a write error, so often */
    uint32_t mishear_at;    /* a bit of this write is flipped on the way */
    uint32_t hang_at;       /* after this write the card is busy for ever, until CMD0 or power */
    uint32_t misread_at;    /* a bit of this sector read is flipped on the way */
    uint32_t flip_every;    /* of so many bytes on the wires, in both directions, one comes with a flipped bit; 0: none */
    uint32_t flip_above_hz; /* if the clock is faster than this */
    bool is_crc_unknown;    /* CMD59 is not implemented */
    bool is_mute;           /* initialisation never ends */
    uint32_t read_us;       /* before the data of a sector come */

    /* what was seen */
    uint32_t writes, reads, commands, crc_errors, protocol_errors;
    bool is_cut;
    sd_model_flaw_t flaw;
    uint32_t flips;

    /* its state */
    bool is_selected, is_idle, is_ready, has_crc, is_app;
    uint8_t command[6];
    size_t command_length;
    uint8_t out[1024];
    size_t out_length, out_at;
    uint32_t chance;
    size_t held_at; /* from here on the answer comes at held_until_us */
    uint64_t held_until_us;
    uint8_t in[SD_MODEL_SECTOR + 2];
    size_t in_length;
    bool is_receiving, is_waiting_for_token, is_multiple;
    uint32_t address;
    uint64_t busy_until_us;
    uint64_t started_us;  /* the first ACMD41 came then; 0: none yet */
    uint32_t idle_clocks; /* since CS went high, whether the card was there or not */
    bool is_spi;          /* a CMD0 has come since power */
    bool is_awake;        /* a CMD0 has come since power or the host's restart */
    bool is_disturbed;    /* a bit of what is being heard was flipped on the way */
    uint8_t status;       /* second byte of CMD13 */
} sd_model_t;

void sd_model_init(sd_model_t *card, sd_model_kind_t kind, uint32_t sectors, const uint64_t *now_us);
void sd_model_free(sd_model_t *card);

/* Take power away and give it back: the medium stays. What was to go wrong is forgotten. */
void sd_model_power_cycle(sd_model_t *card);

/* The host starts anew, the card keeps its power. */
void sd_model_host_restarts(sd_model_t *card);

void sd_model_select(sd_model_t *card, bool is_selected);
uint8_t sd_model_exchange(sd_model_t *card, uint8_t out);

/* The medium, from outside. */
const uint8_t *sd_model_view(const sd_model_t *card, uint32_t sector);
void sd_model_copy_medium(sd_model_t *card, const sd_model_t *from); /* of the same size */
void sd_model_peek(const sd_model_t *card, uint32_t sector, uint8_t *data);
void sd_model_poke(sd_model_t *card, uint32_t sector, const uint8_t *data);
int sd_model_save(const sd_model_t *card, const char *path);

#endif
