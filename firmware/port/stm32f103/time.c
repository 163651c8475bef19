/* TIM2 counts microseconds, free, all 16 bits; software counts its overflows. Channel 1 compares for the polling tick. */
#include "port.h"

enum { TICK_US = 500 };

static volatile uint32_t overflows;
static void (*volatile on_tick)(uint64_t);

void time_init(uint32_t timer_hz)
{
    RCC->APB1ENR |= RCC_APB1ENR_TIM2EN;
    TIM2->PSC = timer_hz / 1000000 - 1;
    TIM2->ARR = 0xFFFF;
    TIM2->CR1 = TIM_CR1_URS; /* loading the prescaler is no overflow */
    TIM2->EGR = TIM_EGR_UG;
    TIM2->CCR[0] = TICK_US;
    TIM2->SR = 0;
    TIM2->DIER = TIM_DIER_UIE | TIM_DIER_CC1IE;
    nvic_enable(IRQ_TIM2, PRIORITY_SAMPLING);
    TIM2->CR1 = TIM_CR1_URS | TIM_CR1_CEN;
}

/* The time when the counter stood at `count`, a moment ago. An overflow that is pending happened before a small count
 * and after a large one. */
static uint64_t time_of(uint32_t high, uint32_t count, bool is_overflow_pending)
{
    if (is_overflow_pending && count < 0x8000)
        high++;
    return (uint64_t)high << 16 | count;
}

uint64_t time_us(void)
{
    uint32_t high, count;
    bool is_pending;
    do {
        high = overflows;
        count = TIM2->CNT & 0xFFFF;
        is_pending = (TIM2->SR & TIM_SR_UIF) != 0;
    } while (high != overflows);
    return time_of(high, count, is_pending);
}

void time_set_tick(void (*handler)(uint64_t))
{
    on_tick = handler;
}

void time_wait_us(uint32_t duration_us)
{
    const uint64_t since = time_us();
    while (time_us() - since < duration_us)
        __asm volatile("wfi");
}

/* SR bits are cleared by writing 0; writing 1 to the others leaves them. */
static void clear(uint32_t flags)
{
    TIM2->SR = ~flags;
}

static void take_tick(void)
{
    clear(TIM_SR_CC1IF);
    TIM2->CCR[0] = (TIM2->CNT + TICK_US) & 0xFFFF;
    if (on_tick)
        on_tick(time_us());
}

void TIM2_IRQHandler(void);
void TIM2_IRQHandler(void)
{
    const uint32_t flags = TIM2->SR;
    if (flags & TIM_SR_UIF) {
        clear(TIM_SR_UIF);
        overflows++;
    }
    if (flags & TIM_SR_CC1IF)
        take_tick();
}
