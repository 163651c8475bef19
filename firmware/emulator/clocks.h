/* The clock tree of RM0008 section 7.2, as its registers say: from oscillator and PLL to the core, buses and timers. */
#ifndef EMULATOR_CLOCKS_H
#define EMULATOR_CLOCKS_H

#include "chip.h"

/* As RCC_CFGR has them now; the PLL's output also when it drives nothing. */
clocks_t clocks_of(uint32_t cfgr);
uint32_t clocks_pll_hz(uint32_t cfgr);

#endif
