/* The card: SPI1 on PA5 to PA7, chip select PA4. */
#include "port.h"

enum { SELECT_PIN = 4 };

/* 72 MHz / 2^(n + 1): 18 MHz, the most SPI1 can do, 9 and 4.5 MHz, 281 kHz. */
static const uint8_t dividers[] = {[SD_FAST] = 1, [SD_HALF] = 2, [SD_QUARTER] = 3, [SD_START_UP] = 7};

static volatile bool is_over;
static volatile int outcome;

static void select_card(void *context, bool is_selected)
{
    (void)context;
    if (is_selected)
        GPIOA->BRR = 1u << SELECT_PIN;
    else
        GPIOA->BSRR = 1u << SELECT_PIN;
}

static void set_speed(void *context, sd_speed_t speed)
{
    (void)context;
    spi_stop(&spi_card);
    spi_init(&spi_card, dividers[speed]);
}

static int exchange(void *context, const uint8_t *out, uint8_t *in, size_t length)
{
    (void)context;
    return spi_exchange(&spi_card, out, in, length);
}

static int start(void *context, const uint8_t *out, uint8_t *in, size_t length)
{
    (void)context;
    is_over = false;
    spi_start(&spi_card, out, in, length, true);
    return 0;
}

static int is_done(void *context)
{
    (void)context;
    return is_over ? outcome : 0;
}

void DMA1_Channel2_IRQHandler(void);
void DMA1_Channel2_IRQHandler(void)
{
    const int result = spi_is_done(&spi_card);
    if (result == 0)
        return;
    outcome = result;
    is_over = true;
}

static uint64_t now_us(void *context)
{
    (void)context;
    return time_us();
}

/* The pull-up of MISO makes a missing card read as FF; modules without one of their own need it. */
void card_init(board_t *board)
{
    RCC->APB2ENR |= RCC_APB2ENR_SPI1EN;
    GPIOA->BSRR = 1u << SELECT_PIN | 1u << 6;
    gpio_configure(GPIOA, SELECT_PIN, GPIO_OUTPUT_50MHZ);
    gpio_configure(GPIOA, 5, GPIO_ALTERNATE_50MHZ);
    gpio_configure(GPIOA, 6, GPIO_PULLED);
    gpio_configure(GPIOA, 7, GPIO_ALTERNATE_50MHZ);
    spi_init(&spi_card, dividers[SD_START_UP]);
    nvic_enable(IRQ_DMA1_CHANNEL2, PRIORITY_CARD);
    board->card = (sd_bus_t){.select = select_card,
                             .set_speed = set_speed,
                             .exchange = exchange,
                             .start = start,
                             .is_done = is_done,
                             .now_us = now_us};
}
