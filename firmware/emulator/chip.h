/* The parts of an STM32F103C8 that the port uses, in cycles of 72 MHz: TIM2, SPI1 and 2, USART1 and 2, DMA1, GPIO, EXTI,
 * RCC, PWR, BKP, IWDG, the flash's wait states. What the manual forbids ends the run (rules.h). Timer and buses run at what the
 * clocks are set to; instructions cost what they do at 72 MHz. Source: ST RM0008. */
#ifndef EMULATOR_CHIP_H
#define EMULATOR_CHIP_H

#include "machine.h"

enum { CHIP_REGISTERS = 0x24000 / 4, DMA_CHANNELS = 8, SPIS = 2, LONGEST_BURST = 64 };

/* Hz. */
typedef struct {
    uint32_t system_hz, core_hz, apb1_hz, apb2_hz, timer_hz;
} clocks_t;

/* What hangs on the pins. */
typedef struct {
    void *context;
    uint8_t (*card_byte)(void *context, uint8_t out, uint32_t clock_hz);
    void (*card_select)(void *context, bool is_selected);
    void (*imu_transfer)(void *context, const uint8_t *out, uint8_t *in, size_t length, uint32_t clock_hz);
    void (*to_receiver)(void *context, uint8_t byte, uint32_t baud);
    void (*to_serial)(void *context, uint8_t byte, uint32_t baud);
    void (*led)(void *context, bool is_on);
    bool (*is_button_pressed)(void *context);
    bool (*is_supply_low)(void *context);
} pins_t;

typedef struct {
    uint64_t done; /* when the byte on its way is over; NEVER: none */
    uint8_t out, in;
    bool is_received;
    /* the IMU's registers are latched for the length of a burst, so one by DMA is exchanged as a whole */
    uint8_t burst[LONGEST_BURST];
    size_t burst_at, burst_length;
    uint8_t command;  /* first byte since the chip was selected */
    size_t sent;
} spi_state_t;

typedef struct {
    machine_t *machine;
    pins_t pins;
    uint32_t registers[CHIP_REGISTERS];

    uint64_t timer_began, overflow_at, compare_at;
    uint32_t timer_offset;
    spi_state_t spi[SPIS];
    uint16_t dma_length[DMA_CHANNELS]; /* as written, for circular channels and addresses */
    uint64_t serial_free;              /* USART1's shift register */
    uint64_t sent_at;                  /* USART2's byte by DMA is out */
    uint64_t idle_at;
    bool was_status_read;
    uint64_t watchdog_at;
    bool is_watchdog_unlocked;
    bool has_crystal;
    clocks_t clocks;
    uint64_t crystal_ready_at, pll_ready_at;

    /* seen */
    uint64_t longest_unfed, fed, watchdog_period;
    uint32_t watchdog_resets, overruns, dma_bytes;
} chip_t;

void chip_init(chip_t *chip, machine_t *machine, const pins_t *pins);

/* As after power-on, or after another reset: `cause` is what RCC_CSR shows in its upper byte. */
void chip_reset(chip_t *chip, uint8_t cause);

uint8_t chip_reset_cause(const chip_t *chip);

uint64_t chip_advance(chip_t *chip); /* when something is due next */
uint64_t chip_levels(const chip_t *chip);
uint32_t chip_read(chip_t *chip, uint32_t address, unsigned size);
void chip_write(chip_t *chip, uint32_t address, unsigned size, uint32_t value);

/* From outside. */
void chip_imu_edge(chip_t *chip);
void chip_hear(chip_t *chip, uint8_t byte); /* on USART1, at its rate */
void chip_receive(chip_t *chip, uint8_t byte);
uint32_t chip_receiver_baud(const chip_t *chip); /* 0: switched off */

/* For rules.c: RCC_CR as it reads, the clock of an SPI, the rate of a USART. */
uint32_t chip_clock_control(const chip_t *chip);
uint32_t chip_spi_hz(const chip_t *chip, int which);
uint32_t chip_baud(const chip_t *chip, uint32_t usart);

#endif
