/* The IMU: SPI2 on PB13 to PB15, chip select PB12, interrupt (if wired) on PB0.
 *
 * A rising edge on PB0 starts a burst. While there are none, the timer's tick does: a wire that is missing or breaks
 * costs accuracy of the time stamps (half a millisecond) and nothing else. Timer, pin and DMA interrupt share one
 * priority, so nothing here runs within anything else here. */
#include "port.h"

enum {
    SELECT_PIN = 12,
    SLOW = 5,             /* 36 MHz / 64 = 562 kHz; registers may be written at 1 MHz at most */
    FAST = 1,             /* 36 MHz / 4 = 9 MHz; samples may be read at 20 MHz */
    EDGE_MISSING_US = 30000, /* longer than the longest period that can be set */
    STUCK_US = 5000 /* a burst takes 30 us */
};

static const board_events_t *volatile events;
static volatile bool is_running;
static volatile uint64_t edge_us;
static uint64_t again_us; /* an edge that came during a burst: its sample may not be in it; 0: none */
static uint64_t burst_us;
static uint8_t out[MPU9250_BURST] = {MPU9250_BURST_COMMAND};
static uint8_t in[MPU9250_BURST];

static void select_imu(bool is_selected)
{
    if (is_selected)
        GPIOB->BRR = 1u << SELECT_PIN;
    else
        GPIOB->BSRR = 1u << SELECT_PIN;
}

static void start_burst(uint64_t time_us_)
{
    if (is_running && time_us_ - burst_us < STUCK_US)
        return;
    is_running = true;
    burst_us = time_us_;
    select_imu(false);
    select_imu(true);
    spi_start(&spi_imu, out, in, MPU9250_BURST, true);
}

void DMA1_Channel4_IRQHandler(void);
void DMA1_Channel4_IRQHandler(void)
{
    const int result = spi_is_done(&spi_imu);
    if (result == 0)
        return;
    select_imu(false);
    is_running = false;
    const board_events_t *to = events;
    if (result == 1 && to)
        to->on_burst(to->context, burst_us, in);
    const uint64_t next_us = again_us;
    again_us = 0;
    if (next_us && to)
        start_burst(next_us);
}

static void on_tick(uint64_t now_us)
{
    if (events && now_us - edge_us > EDGE_MISSING_US)
        start_burst(now_us);
}

void EXTI0_IRQHandler(void);
void EXTI0_IRQHandler(void)
{
    EXTI->PR = EXTI_LINE0;
    edge_us = time_us();
    if (events && is_running)
        again_us = edge_us; /* that burst was started by a glitch, or this edge is one: then there is nothing new */
    if (events)
        start_burst(edge_us);
}

static void stop_sampling(void *context)
{
    (void)context;
    events = 0;
    EXTI->IMR &= ~EXTI_LINE0;
    time_wait_us(1000); /* a burst on its way takes 30 us */
    spi_stop(&spi_imu);
    select_imu(false);
    is_running = false;
    again_us = 0;
    spi_init(&spi_imu, SLOW);
}

static void start_sampling(void *context, const board_events_t *to)
{
    (void)context;
    spi_init(&spi_imu, FAST);
    edge_us = 0;
    events = to;
    EXTI->PR = EXTI_LINE0;
    EXTI->IMR |= EXTI_LINE0;
}

static bool is_sampling_on_pin(void *context)
{
    (void)context;
    uint64_t edge;
    do
        edge = edge_us;
    while (edge != edge_us); /* two words, written by an interrupt */
    return edge != 0 && time_us() - edge < EDGE_MISSING_US;
}

static int transfer(void *context, const uint8_t *bytes_out, uint8_t *bytes_in, size_t length)
{
    (void)context;
    select_imu(true);
    const int result = spi_exchange(&spi_imu, bytes_out, bytes_in, length);
    select_imu(false);
    return result;
}

void imu_init(board_t *board)
{
    RCC->APB1ENR |= RCC_APB1ENR_SPI2EN;
    GPIOB->BSRR = 1u << SELECT_PIN;
    GPIOB->BRR = 1u << 0;
    gpio_configure(GPIOB, SELECT_PIN, GPIO_OUTPUT_50MHZ);
    gpio_configure(GPIOB, 13, GPIO_ALTERNATE_50MHZ);
    gpio_configure(GPIOB, 14, GPIO_FLOATING);
    gpio_configure(GPIOB, 15, GPIO_ALTERNATE_50MHZ);
    gpio_configure(GPIOB, 0, GPIO_PULLED); /* down: nothing wired, no edges */
    AFIO->EXTICR[0] = (AFIO->EXTICR[0] & ~AFIO_EXTICR1_EXTI0_MASK) | AFIO_EXTICR1_EXTI0_PB;
    EXTI->RTSR |= EXTI_LINE0;
    spi_init(&spi_imu, SLOW);
    nvic_enable(IRQ_EXTI0, PRIORITY_SAMPLING);
    nvic_enable(IRQ_DMA1_CHANNEL4, PRIORITY_SAMPLING);
    time_set_tick(on_tick);
    board->imu = (mpu9250_bus_t){.transfer = transfer};
    board->start_sampling = start_sampling;
    board->stop_sampling = stop_sampling;
    board->is_sampling_on_pin = is_sampling_on_pin;
}
