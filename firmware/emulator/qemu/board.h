/* As much of an LM3S6965 as a card needs: SSI0 with the card's chip select on PD0, UART0 for words, SysTick for time.
 *
 * Not a board to build: QEMU's machine lm3s6965evb has a model of a card on that SSI which others wrote, and so judges
 * the driver and the file system layer as a stranger. Source: Luminary Micro, LM3S6965 data sheet. */
#ifndef PORT_BOARD_H
#define PORT_BOARD_H

#include <stdint.h>

#include "sdcard.h"

/* The card's bus; what is sent "in the background" is over at once. */
const sd_bus_t *board_init(void);

void board_print(const char *text);
void board_print_number(uint32_t number);

/* Ask QEMU to end, by semihosting: exit code 0, or 1. */
_Noreturn void board_exit(int is_bad);

#endif
