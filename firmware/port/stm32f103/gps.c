/* The receiver: USART2, TX on PA2, RX on PA3. Receiving is a circular DMA; half, full and idle line each leave a stamp
 * (how many bytes by when), from which the time of every byte between two stamps follows at the line's rate. */
#include "port.h"

#include <string.h>

enum {
    RECEIVED = 256, /* a power of two; a quarter of a second of sentences, 22 ms of a line that never pauses at 115200 */
    STAMPS = 8,
    SENT = 48 /* the longest: the baud rate in both ways */
};

typedef struct {
    uint32_t total;  /* bytes received by then */
    uint64_t end_us; /* when the last of them ended */
} stamp_t;

static uint8_t received[RECEIVED];
static stamp_t stamps[STAMPS];
static volatile uint32_t stamps_put; /* by the interrupt */
static uint32_t stamps_taken;        /* by the main loop */
static volatile uint32_t total;      /* bytes the interrupt has seen */
static uint32_t consumed;            /* bytes handed on */
static uint32_t byte_ns = 1;
static uint32_t bus_hz;

static dma_channel_t *const receive = &DMA1->channel[DMA_USART2_RX - 1];
static dma_channel_t *const transmit = &DMA1->channel[DMA_USART2_TX - 1];

/* Each call comes before another half buffer has arrived, so the count is never ambiguous. */
static void stamp(uint64_t end_us)
{
    const uint32_t position = (RECEIVED - receive->CNDTR) % RECEIVED;
    const uint32_t more = (position - total) % RECEIVED;
    if (more == 0)
        return;
    total += more;
    /* a full queue: the newest stamp takes in the bytes of the one before; their times shift by what the pause was */
    const uint32_t slot = stamps_put - stamps_taken < STAMPS ? stamps_put : stamps_put - 1;
    stamps[slot % STAMPS] = (stamp_t){total, end_us};
    stamps_put = slot + 1;
}

void DMA1_Channel6_IRQHandler(void);
void DMA1_Channel6_IRQHandler(void)
{
    DMA1->IFCR = DMA_FLAGS(DMA_USART2_RX);
    stamp(time_us());
}

void USART2_IRQHandler(void);
void USART2_IRQHandler(void)
{
    /* RM0008 27.6.1: reading SR, then DR clears IDLE and the errors */
    const uint32_t status = USART2->SR;
    (void)USART2->DR;
    if (status & USART_SR_IDLE)
        stamp(time_us() - byte_ns / 1000); /* the line has been idle for one character */
}

static void set_baud(void *context, uint32_t baud)
{
    (void)context;
    USART2->CR1 = 0;
    USART2->CR3 = 0;
    receive->CCR = 0;
    DMA1->IFCR = DMA_FLAGS(DMA_USART2_RX);
    byte_ns = 1000000000u / baud * 10;
    total = consumed = 0;
    stamps_put = stamps_taken = 0;
    receive->CNDTR = RECEIVED;
    receive->CCR = DMA_CCR_EN | DMA_CCR_MINC | DMA_CCR_CIRC | DMA_CCR_HTIE | DMA_CCR_TCIE | DMA_CCR_PRIORITY(1);
    USART2->BRR = (bus_hz + baud / 2) / baud;
    USART2->CR3 = USART_CR3_DMAR | USART_CR3_DMAT;
    USART2->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_IDLEIE;
}

static int write(void *context, const uint8_t *data, size_t length)
{
    static uint8_t sent[SENT];
    (void)context;
    if (length > SENT || ((transmit->CCR & DMA_CCR_EN) && transmit->CNDTR != 0))
        return -1;
    memcpy(sent, data, length);
    transmit->CCR = 0;
    DMA1->IFCR = DMA_FLAGS(DMA_USART2_TX);
    transmit->CMAR = (uint32_t)sent;
    transmit->CNDTR = length;
    transmit->CCR = DMA_CCR_EN | DMA_CCR_MINC | DMA_CCR_DIR_FROM_MEMORY;
    return 0;
}

/* Drop what the DMA has written over since. */
static uint32_t drop_overwritten(void)
{
    const uint32_t waiting = total - consumed;
    if (waiting <= RECEIVED - RECEIVED / 4) /* the last quarter may be being written just now */
        return 0;
    const uint32_t lost = waiting - RECEIVED / 4;
    consumed += lost;
    return lost;
}

static size_t read(void *context, uint8_t *data, size_t size, uint64_t *first_us, uint32_t *lost)
{
    (void)context;
    *lost = drop_overwritten();
    while (stamps_taken != stamps_put && (int32_t)(stamps[stamps_taken % STAMPS].total - consumed) <= 0)
        stamps_taken++;
    if (stamps_taken == stamps_put)
        return 0;
    const stamp_t to = stamps[stamps_taken % STAMPS];
    const uint32_t waiting = to.total - consumed;
    const uint32_t count = waiting < size ? waiting : (uint32_t)size;
    for (uint32_t i = 0; i < count; i++)
        data[i] = received[(consumed + i) % RECEIVED];
    *first_us = to.end_us - (uint64_t)waiting * byte_ns / 1000;
    consumed += count;
    return count;
}

void gps_init(board_t *board, uint32_t apb1_hz)
{
    bus_hz = apb1_hz;
    RCC->APB1ENR |= RCC_APB1ENR_USART2EN;
    gpio_configure(GPIOA, 2, GPIO_ALTERNATE_2MHZ);
    GPIOA->BSRR = 1u << 3;
    gpio_configure(GPIOA, 3, GPIO_PULLED); /* up: a missing receiver is an idle line */
    receive->CPAR = (uint32_t)&USART2->DR;
    receive->CMAR = (uint32_t)received;
    transmit->CPAR = (uint32_t)&USART2->DR;
    nvic_enable(IRQ_DMA1_CHANNEL6, PRIORITY_GPS);
    nvic_enable(IRQ_USART2, PRIORITY_GPS);
    set_baud(0, 9600);
    board->gps = (neo6m_port_t){.set_baud = set_baud, .write = write, .read = read};
}
