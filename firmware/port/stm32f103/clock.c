#include "port.h"

enum { READY_TRIES = 200000 }; /* a crystal needs some 2 ms, a loop of this takes over 100 ms at 8 MHz */

static bool wait_for(const reg_t *reg, uint32_t mask, uint32_t value)
{
    for (int i = 0; i < READY_TRIES; i++)
        if ((*reg & mask) == value)
            return true;
    return false;
}

/* RM0008 7.3.2: PLL from the crystal x 9, or from half the internal 8 MHz x 16; APB1 must stay below 36 MHz. */
clocks_t clock_init(void)
{
    RCC->CR |= RCC_CR_HSEON;
    const bool has_crystal = wait_for(&RCC->CR, RCC_CR_HSERDY, RCC_CR_HSERDY);
    FLASH_ACR = FLASH_ACR_PRFTBE | FLASH_ACR_LATENCY_2;
    RCC->CFGR = RCC_CFGR_PPRE1_DIV2 |
                (has_crystal ? RCC_CFGR_PLLSRC_HSE | RCC_CFGR_PLLMUL(9u) : RCC_CFGR_PLLMUL(16u));
    RCC->CR |= RCC_CR_PLLON;
    if (!wait_for(&RCC->CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY))
        return (clocks_t){.core_hz = 8000000, .apb1_hz = 4000000, .has_crystal = false};
    RCC->CFGR |= RCC_CFGR_SW_PLL;
    if (!wait_for(&RCC->CFGR, RCC_CFGR_SWS_MASK, RCC_CFGR_SWS_PLL))
        return (clocks_t){.core_hz = 8000000, .apb1_hz = 4000000, .has_crystal = false};
    const uint32_t core_hz = has_crystal ? 72000000 : 64000000;
    return (clocks_t){.core_hz = core_hz, .apb1_hz = core_hz / 2, .has_crystal = has_crystal};
}
