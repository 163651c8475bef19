/* Everything put together, and the small parts: panel, supply, watchdog, reset cause, backup registers, stack. */
#include "port.h"

#include <string.h>

enum {
    LED_PIN = 13,            /* PC13, lights when low */
    BUTTON_PIN = 0,          /* PA0, to ground */
    WATCHDOG_RELOAD = 2500,  /* 40 kHz / 64: 4 s; the oscillator spreads from 30 to 60 kHz, so 2.7 to 5.3 s */
    BASEPRI_SAMPLING = PRIORITY_SAMPLING << 4
};

static board_t board;
static uint32_t lock_depth;

static uint64_t now_us(void *context)
{
    (void)context;
    return time_us();
}

static void set_led(void *context, bool is_on)
{
    (void)context;
    if (is_on)
        GPIOC->BRR = 1u << LED_PIN;
    else
        GPIOC->BSRR = 1u << LED_PIN;
}

static bool is_pressed(void *context)
{
    (void)context;
    return !(GPIOA->IDR & 1u << BUTTON_PIN);
}

static void set_basepri(uint32_t value)
{
    __asm volatile("msr basepri, %0" : : "r"(value) : "memory");
}

/* Only the main loop locks, so a plain counter will do. */
static void lock(void *context)
{
    (void)context;
    set_basepri(BASEPRI_SAMPLING);
    lock_depth++;
}

static void unlock(void *context)
{
    (void)context;
    if (--lock_depth == 0)
        set_basepri(0);
}

static bool is_supply_low(void *context)
{
    (void)context;
    return (PWR->CSR & PWR_CSR_PVDO) != 0;
}

static void feed_watchdog(void *context)
{
    (void)context;
    IWDG->KR = IWDG_KR_FEED;
}

static void sleep(void *context)
{
    (void)context;
    __asm volatile("wfi");
}

static void (*idle)(void *);
static void *idle_context;

static void set_idle(void *context, void (*function)(void *), void *function_context)
{
    (void)context;
    idle_context = function_context;
    idle = function;
}

static void wait(void *context)
{
    sleep(context);
    if (idle)
        idle(idle_context);
}

static void wait_us(void *context, uint32_t duration_us)
{
    const uint64_t since = time_us();
    while (time_us() - since < duration_us)
        wait(context);
}

static void restart(void *context)
{
    (void)context;
    SCB_AIRCR = SCB_AIRCR_SYSRESET;
    for (;;) {
    }
}

static void set_mark(void *context, uint16_t mark)
{
    (void)context;
    BKP->DR[BACKUP_MARK] = mark;
}

extern const uint32_t _stack_bottom[], _stack_top[];

static uint32_t stack_free(void *context)
{
    (void)context;
    const uint32_t *word = _stack_bottom;
    while (word < _stack_top && *word == STACK_PAINT)
        word++;
    return (uint32_t)(word - _stack_bottom) * sizeof *word;
}

static void panel_pins_init(void)
{
    GPIOC->BSRR = 1u << LED_PIN;
    gpio_configure(GPIOC, LED_PIN, GPIO_OUTPUT_2MHZ);
    GPIOA->BSRR = 1u << BUTTON_PIN;
    gpio_configure(GPIOA, BUTTON_PIN, GPIO_PULLED); /* up */
}

/* The detector only has to be asked: the main loop does so every half millisecond. */
static void power_init(void)
{
    RCC->APB1ENR |= RCC_APB1ENR_PWREN | RCC_APB1ENR_BKPEN;
    PWR->CR = PWR_CR_DBP | PWR_CR_PLS_2V9 | PWR_CR_PVDE;
    BKP->DR[BACKUP_BOOTS] = (BKP->DR[BACKUP_BOOTS] + 1) & 0xFFFF;
}

static void watchdog_init(void)
{
    IWDG->KR = IWDG_KR_START;
    IWDG->KR = IWDG_KR_UNLOCK;
    IWDG->PR = IWDG_PR_DIV64;
    IWDG->RLR = WATCHDOG_RELOAD;
    IWDG->KR = IWDG_KR_FEED;
}

static uint32_t backup_word(unsigned first)
{
    return BKP->DR[first] | BKP->DR[first + 1] << 16;
}

static void remember_fault(void)
{
    board.fault = (board_fault_t){.is_fault = BKP->DR[BACKUP_IS_FAULT] == 1,
                                  .pc = backup_word(BACKUP_FAULT),
                                  .lr = backup_word(BACKUP_FAULT + 2),
                                  .status = backup_word(BACKUP_FAULT + 4)};
    BKP->DR[BACKUP_IS_FAULT] = 0;
}

static void remember_reset(void)
{
    board.reset_cause = (uint8_t)(RCC->CSR >> 24);
    RCC->CSR |= RCC_CSR_RMVF;
    board.boot_number = BKP->DR[BACKUP_BOOTS];
    board.mark_before_reset = (uint16_t)BKP->DR[BACKUP_MARK];
    memcpy(board.device, UNIQUE_ID, sizeof board.device);
    remember_fault();
}

const board_t *board_init(void)
{
    const clocks_t clocks = clock_init();
    RCC->AHBENR |= RCC_AHBENR_DMA1EN;
    RCC->APB2ENR |= RCC_APB2ENR_AFIOEN | RCC_APB2ENR_IOPAEN | RCC_APB2ENR_IOPBEN | RCC_APB2ENR_IOPCEN;
    panel_pins_init();
    power_init();
    remember_reset();
    time_init(clocks.core_hz); /* timers on APB1 run at twice its clock */
    board.now_us = now_us;
    board.panel = (panel_pins_t){.set_led = set_led, .is_pressed = is_pressed};
    board.lock = lock;
    board.unlock = unlock;
    board.is_supply_low = is_supply_low;
    board.feed_watchdog = feed_watchdog;
    board.sleep = sleep;
    board.restart = restart;
    board.set_mark = set_mark;
    board.stack_free = stack_free;
    board.set_idle = set_idle;
    card_init(&board);
    board.card.wait = wait;
    imu_init(&board);
    board.imu.wait_us = wait_us;
    gps_init(&board, clocks.apb1_hz);
    uart_init(&board, clocks.core_hz);
    watchdog_init();
    if (!clocks.has_crystal)
        (void)serial_print(board.serial, "crystal does not start: internal oscillator\n");
    return &board;
}
