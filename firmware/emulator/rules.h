/* What the manuals forbid. The first rule that an image breaks ends the run, with its text and the program counter.
 *
 * Each is the mistake of a real board: the emulated chip itself would forgive most of them. mutants.py has for every rule
 * at least one change of the sources that breaks it. RM0008: reference manual; PM0056: programming manual of the core;
 * PM0075: of the flash; DS5319: data sheet; SD: physical layer specification; PS: product specification of the MPU-9250. */
#ifndef EMULATOR_RULES_H
#define EMULATOR_RULES_H

#include "chip.h"

#define RULES(RULE) \
    RULE(NO_CLOCK, "RM0008 7.3.6-7.3.8: a peripheral is used without its clock") \
    RULE(SOURCE_NOT_READY, "RM0008 7.2.3: the PLL is switched on before its source is ready") \
    RULE(PLL_CHANGED, "RM0008 7.3.2: the PLL's source or factor is changed while it is on") \
    RULE(CLOCK_NOT_READY, "RM0008 7.2.6: the core is switched to a clock that is not ready") \
    RULE(PLL_TOO_FAST, "RM0008 7.3.2: the PLL makes more than 72 MHz") \
    RULE(APB1_TOO_FAST, "RM0008 7.3.2: APB1 runs at more than 36 MHz") \
    RULE(FLASH_TOO_FAST, "RM0008 3.3.3: too few wait states of the flash for the clock") \
    RULE(PREFETCH, "RM0008 3.3.3: the prefetch buffer is switched while the clock is above 24 MHz") \
    RULE(SLEEPING_MEMORY, "RM0008 7.3.6: the core sleeps while DMA needs the SRAM, whose clock stops then") \
    RULE(BACKUP_LOCKED, "RM0008 6.1: the backup domain is written without PWR_CR_DBP") \
    RULE(WATCHDOG_LOCKED, "RM0008 19.3.2: the watchdog is set up while it is locked") \
    RULE(FLASH_WRITTEN, "PM0075 2.3.2: the flash is written while it is locked") \
    RULE(NOTHING_THERE, "RM0008 3.3: no memory or register that the port uses is at this address") \
    RULE(WIDTH, "RM0008 9.2, 13.4, ..: a register is accessed by another width than a word") \
    RULE(RESERVED_BITS, "RM0008 2.1: reserved bits of a register are written") \
    RULE(PIN_FUNCTION, "RM0008 9.1.11: a pin is not configured as its peripheral needs it") \
    RULE(PIN_TOO_SLOW, "RM0008 9.2.1: a pin's output is slower than its signal") \
    RULE(PIN_PC13, "RM0008 5.1.2: PC13 is switched at more than 2 MHz") \
    RULE(PIN_FLOATING, "RM0008 9.1.7: an input that nothing need drive is not pulled") \
    RULE(PIN_REMAPPED, "RM0008 9.3: the pins of a peripheral in use are moved elsewhere") \
    RULE(SPI_NOT_MASTER, "RM0008 25.3.3: a byte is sent by an SPI that is not master") \
    RULE(SPI_MODE_FAULT, "RM0008 25.3.10: NSS is low in master mode (MODF)") \
    RULE(SPI_OFF, "RM0008 25.3.3: a byte is written to an SPI that is off") \
    RULE(SPI_FORMAT, "RM0008 25.5.1: not bytes in both directions, highest bit first") \
    RULE(SPI_CHANGED, "RM0008 25.3.8: the SPI is changed or switched off while a byte is on its way") \
    RULE(SPI_OVERWRITTEN, "RM0008 25.3.7: a byte is written while TXE is 0") \
    RULE(SPI_OVERRUN, "RM0008 25.3.10: a received byte was not read before the next (OVR)") \
    RULE(SPI_TOO_FAST, "DS5319 5.3.16: SCK is faster than 18 MHz") \
    RULE(SPI_MODE, "SD 7.2, PS 6.5: card and IMU take SPI modes 0 and 3") \
    RULE(DMA_CHANNEL, "RM0008 13.3.7: the channel's peripheral makes its requests to another one") \
    RULE(DMA_CHANGED, "RM0008 13.4.4-13.4.6: count or address is written while the channel is on") \
    RULE(DMA_ADDRESS, "RM0008 13.3.5: the channel leaves the memory (TEIF)") \
    RULE(DMA_WIDTH, "RM0008 13.3.4: not bytes from or to one register") \
    RULE(USART_OFF, "RM0008 27.3.2: a byte is sent while UE or TE is off") \
    RULE(USART_FORMAT, "RM0008 27.6.4: not 8 bits without parity, one stop bit") \
    RULE(USART_RATE, "RM0008 27.3.5: the rate is farther than 2 % from the other side's") \
    RULE(USART_OVERWRITTEN, "RM0008 27.3.2: a byte is written while TXE is 0") \
    RULE(VECTOR, "PM0056 2.3.4: a vector is even, or not in the flash") \
    RULE(VECTOR_TABLE, "PM0056 4.4.4: VTOR is no multiple of 512 in flash or RAM") \
    RULE(VECTORS_AT_ZERO, "RM0008 3.4: an interrupt before VTOR is set: BOOT0 says what lies at 0") \
    RULE(STACK, "PM0056 2.1.2: the stack is outside of the RAM, or no multiple of 8 at the start") \
    RULE(PRIORITY, "PM0056 4.3.7: bits of a priority that this core has not") \
    RULE(CARD_ASLEEP, "SD 6.4.1: a command before 74 clocks with CS high") \
    RULE(CARD_TOO_FAST, "SD 4.2.1: more than 400 kHz before ACMD41 is done, or more than 25 MHz") \
    RULE(CARD_BUSY, "SD 7.2.4: a command to a card that is busy") \
    RULE(CARD_ORDER, "SD 7.2.1: a command before ACMD41 is done, or within a write") \
    RULE(CARD_TOKEN, "SD 7.3.3: another token than the command wants") \
    RULE(CARD_CHECKSUM, "SD 7.2.2: a wrong CRC where it is on") \
    RULE(CARD_SELECT, "SD 7.2: CS is let go within a command or block") \
    RULE(IMU_TOO_FAST, "PS 6.5: registers at more than 1 MHz, or samples at more than 20 MHz") \
    RULE(IMU_SLAVE, "RM-MPU-9250A 4.12: slave 4 is set up while its transfer is on its way")

typedef enum {
#define NAME_OF(name, text) RULE_##name,
    RULES(NAME_OF)
#undef NAME_OF
    RULE_COUNT
} rule_t;

/* End the run: `what` says by which part. */
void rules_break(machine_t *machine, rule_t rule, const char *what);

/* Ask before a register is read or written; false: a rule is broken. */
bool rules_allow(chip_t *chip, uint32_t offset, unsigned size, bool is_write, uint32_t value);

/* As a byte begins on an SPI, or is given to a USART. */
void rules_spi_begins(chip_t *chip, int which);
void rules_serial_sends(chip_t *chip, uint32_t usart);
/* Of the pins: a chip select moves, the button is asked, the receiver's line or the IMU's interrupt is listened to. */
void rules_pin_is_output(chip_t *chip, uint32_t port, unsigned pin);
void rules_pin_is_pulled(chip_t *chip, uint32_t port, unsigned pin, bool is_up);
/* As the core goes to sleep. */
void rules_sleep(chip_t *chip);

#endif
