/* What the Rust side needs of the card's model, and a clock for it: each byte takes its time on the wires. */
#include "sd_model.h"

enum { SLOW_HZ = 281250, FAST_HZ = 18000000 };

static sd_model_t card;
static uint64_t now_us, now_ns;

void card_wait_ns(uint32_t duration_ns)
{
    now_ns += duration_ns;
    now_us = now_ns / 1000;
}

void card_open(int32_t kind, uint32_t sectors, uint32_t flip_every)
{
    sd_model_free(&card);
    sd_model_init(&card, (sd_model_kind_t)kind, sectors, &now_us);
    card.flip_every = flip_every;
    card.clock_hz = SLOW_HZ;
}

void card_select(bool is_selected)
{
    sd_model_select(&card, is_selected);
}

void card_speed_up(void)
{
    card.clock_hz = FAST_HZ;
}

uint8_t card_exchange(uint8_t out)
{
    card_wait_ns((uint32_t)(8000000000ull / card.clock_hz));
    return sd_model_exchange(&card, out);
}

int32_t card_flaw(void)
{
    return (int32_t)card.flaw;
}

uint32_t card_flips(void)
{
    return card.flips;
}

uint32_t card_wrong_sums(void)
{
    return card.crc_errors;
}
