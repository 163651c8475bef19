#include "clocks.h"

enum { OSCILLATOR_HZ = 8000000, SW_HSE = 1, SW_PLL = 2 };

uint32_t clocks_pll_hz(uint32_t cfgr)
{
    const bool is_crystal = (cfgr & 1u << 16) != 0, is_halved = !is_crystal || (cfgr & 1u << 17);
    const uint32_t field = cfgr >> 18 & 15, factor = field == 15 ? 16 : field + 2;
    return OSCILLATOR_HZ / (is_halved ? 2 : 1) * factor;
}

/* A divider of an APB bus: 1, 2, 4, 8, 16. */
static uint32_t bus_divider(uint32_t field)
{
    return field & 4 ? 2u << (field & 3) : 1;
}

/* Of the AHB: 1, 2, 4, 8, 16, 64, 128, 256, 512. */
static uint32_t core_divider(uint32_t field)
{
    const uint32_t power = field & 7;
    return field & 8 ? 2u << (power < 4 ? power : power + 1) : 1;
}

clocks_t clocks_of(uint32_t cfgr)
{
    const uint32_t system_hz = (cfgr & 3) == SW_PLL ? clocks_pll_hz(cfgr) : OSCILLATOR_HZ;
    const uint32_t core_hz = system_hz / core_divider(cfgr >> 4 & 15);
    const uint32_t apb1 = bus_divider(cfgr >> 8 & 7), apb2 = bus_divider(cfgr >> 11 & 7);
    return (clocks_t){.system_hz = system_hz,
                      .core_hz = core_hz,
                      .apb1_hz = core_hz / apb1,
                      .apb2_hz = core_hz / apb2,
                      .timer_hz = core_hz / apb1 * (apb1 == 1 ? 1 : 2)};
}
