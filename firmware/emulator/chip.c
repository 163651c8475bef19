#include "chip.h"

#include <string.h>

#define BASE 0x40000000u
enum {
    TIM2 = 0x00000,
    IWDG = 0x03000,
    SPI2 = 0x03800,
    USART2 = 0x04400,
    BKP = 0x06C00,
    PWR = 0x07000,
    AFIO = 0x10000,
    EXTI = 0x10400,
    GPIOA = 0x10800,
    GPIOB = 0x10C00,
    GPIOC = 0x11000,
    SPI1 = 0x13000,
    USART1 = 0x13800,
    DMA1 = 0x20000,
    RCC = 0x21000
};
/* registers of a timer, an SPI, a USART, a DMA channel */
enum { T_CR1 = 0x00, T_DIER = 0x0C, T_SR = 0x10, T_EGR = 0x14, T_CCER = 0x20, T_CNT = 0x24, T_PSC = 0x28, T_CCR1 = 0x34, T_CCR2 = 0x38 };
enum { S_CR1 = 0x00, S_CR2 = 0x04, S_SR = 0x08, S_DR = 0x0C };
enum { U_SR = 0x00, U_DR = 0x04, U_BRR = 0x08, U_CR1 = 0x0C, U_CR3 = 0x14 };
enum { D_CCR = 0x00, D_CNDTR = 0x04, D_CMAR = 0x0C };
enum { G_IDR = 0x08, G_ODR = 0x0C, G_BSRR = 0x10, G_BRR = 0x14 };
enum { E_IMR = 0x00, E_RTSR = 0x08, E_PR = 0x14 };

enum { TIMER_COUNTS = 65536 };
enum { UIF = 1, CC1IF = 2, CC2IF = 4, CC2OF = 0x200 << 1 };
enum { TXE = 0x80, RXNE_U = 0x20, IDLE = 0x10, ORE = 0x08, TC = 0x40 };
enum { CCR_EN = 1, CCR_TCIE = 2, CCR_HTIE = 4, CCR_TEIE = 8, CCR_DIR = 0x10, CCR_CIRC = 0x20, CCR_MINC = 0x80 };
enum { SPI_RX_DMA = 1, SPI_TX_DMA = 2, SPI_ON = 0x40 };
enum { IRQ_EXTI0 = 6, IRQ_DMA1 = 11, IRQ_TIM2 = 28, IRQ_USART1 = 37, IRQ_USART2 = 38 };
enum { BITS_A_BYTE = 10, INTERNAL_MHZ = 64, LSI_HZ = 40000, WATCHDOG_CAUSE = 0x20, SOFTWARE_CAUSE = 0x10 };

static const struct {
    uint32_t base;
    unsigned bus_divider, receive, transmit; /* channels */
} spis[SPIS] = {{SPI1, 1, 2, 3}, {SPI2, 2, 4, 5}};
enum { CARD, IMU, GPS_IN = 6, GPS_OUT = 7 };

static uint32_t *at(chip_t *chip, uint32_t offset)
{
    return &chip->registers[offset / 4];
}

static uint32_t look(const chip_t *chip, uint32_t offset)
{
    return chip->registers[offset / 4];
}

static uint32_t channel_at(unsigned channel)
{
    return DMA1 + 8 + 20 * (channel - 1);
}

static uint64_t now(const chip_t *chip)
{
    return chip->machine->cycles;
}

static uint64_t sooner(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* So many cycles of the core's clock: 64 MHz when the PLL runs from the internal oscillator. */
static uint64_t core_cycles(const chip_t *chip, uint64_t cycles)
{
    const uint32_t config = look(chip, RCC + 4);
    const bool is_internal = (config & 3) == 2 && !(config & 1u << 16);
    return is_internal ? cycles * CYCLES_PER_US / INTERNAL_MHZ : cycles;
}

/* ---- TIM2 ---- */

static uint64_t count_cycles(const chip_t *chip)
{
    return core_cycles(chip, look(chip, TIM2 + T_PSC) + 1u);
}

static uint32_t timer_count(const chip_t *chip)
{
    if (!(look(chip, TIM2 + T_CR1) & 1))
        return chip->timer_offset;
    return (uint32_t)((now(chip) - chip->timer_began) / count_cycles(chip) + chip->timer_offset) % TIMER_COUNTS;
}

/* When the counter will next become `count`. */
static uint64_t when_count(const chip_t *chip, uint32_t count)
{
    if (!(look(chip, TIM2 + T_CR1) & 1))
        return NEVER;
    const uint64_t counted = (now(chip) - chip->timer_began) / count_cycles(chip);
    uint64_t more = (count - (uint32_t)(counted + chip->timer_offset)) % TIMER_COUNTS;
    if (more == 0)
        more = TIMER_COUNTS;
    return chip->timer_began + (counted + more) * count_cycles(chip);
}

static void plan_timer(chip_t *chip)
{
    chip->overflow_at = when_count(chip, 0);
    chip->compare_at = when_count(chip, look(chip, TIM2 + T_CCR1) & 0xFFFF);
}

static void step_timer(chip_t *chip)
{
    if (now(chip) >= chip->overflow_at) {
        *at(chip, TIM2 + T_SR) |= UIF;
        chip->overflow_at += TIMER_COUNTS * count_cycles(chip);
    }
    if (now(chip) >= chip->compare_at) {
        *at(chip, TIM2 + T_SR) |= CC1IF;
        chip->compare_at += TIMER_COUNTS * count_cycles(chip);
    }
}

void chip_pulse(chip_t *chip)
{
    if (!(look(chip, TIM2 + T_CCER) & 0x10))
        return;
    *at(chip, TIM2 + T_SR) |= look(chip, TIM2 + T_SR) & CC2IF ? CC2IF | CC2OF : CC2IF;
    *at(chip, TIM2 + T_CCR2) = timer_count(chip);
    machine_attend(chip->machine);
}

static void write_timer(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg == T_SR) {
        *at(chip, TIM2 + T_SR) &= value;
        return;
    }
    if (reg == T_CR1 && (value & 1) && !(look(chip, TIM2 + T_CR1) & 1))
        chip->timer_began = now(chip);
    *at(chip, TIM2 + reg) = reg == T_EGR ? 0 : value;
    plan_timer(chip);
}

/* ---- DMA ---- */

/* Address in RAM that the next transfer of a channel uses; NULL outside of it. */
static uint8_t *dma_place(chip_t *chip, unsigned channel)
{
    const uint32_t base = channel_at(channel), left = look(chip, base + D_CNDTR);
    const uint32_t done = look(chip, base + D_CCR) & CCR_MINC ? chip->dma_length[channel] - left : 0;
    const uint32_t address = look(chip, base + D_CMAR) + done;
    if (address >= RAM_AT && address < RAM_AT + RAM_BYTES)
        return chip->machine->ram + (address - RAM_AT);
    if (address >= FLASH_AT && address < FLASH_AT + FLASH_BYTES && (look(chip, base + D_CCR) & CCR_DIR))
        return chip->machine->flash + (address - FLASH_AT);
    return NULL;
}

static bool is_dma_on(const chip_t *chip, unsigned channel)
{
    return (look(chip, channel_at(channel) + D_CCR) & CCR_EN) && look(chip, channel_at(channel) + D_CNDTR);
}

static void raise(chip_t *chip, unsigned channel, uint32_t flag)
{
    *at(chip, DMA1) |= (flag | 1u) << 4 * (channel - 1);
}

/* One byte: memory to `byte` or the other way round. */
static void dma_move(chip_t *chip, unsigned channel, uint8_t *byte)
{
    const uint32_t base = channel_at(channel), control = look(chip, base + D_CCR);
    uint8_t *place = dma_place(chip, channel);
    chip->dma_bytes++;
    if (!place) { /* a bus error ends the channel */
        raise(chip, channel, CCR_TEIE);
        *at(chip, base + D_CCR) &= ~(uint32_t)CCR_EN;
        return;
    }
    if (control & CCR_DIR)
        *byte = *place;
    else
        *place = *byte;
    const uint32_t left = --*at(chip, base + D_CNDTR);
    if (left == chip->dma_length[channel] / 2u)
        raise(chip, channel, CCR_HTIE);
    if (left)
        return;
    raise(chip, channel, CCR_TCIE);
    if (control & CCR_CIRC)
        *at(chip, base + D_CNDTR) = chip->dma_length[channel];
}

static void write_dma(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg == 4) { /* IFCR; clearing the global flag clears all four */
        for (unsigned i = 0; i < 7; i++)
            *at(chip, DMA1) &= ~((value >> 4 * i & 1) ? 0xFu << 4 * i : value & 0xFu << 4 * i);
        return;
    }
    if (reg < 8)
        return;
    const unsigned channel = (reg - 8) / 20 + 1;
    const uint32_t field = (reg - 8) % 20;
    if (field == D_CNDTR && channel < DMA_CHANNELS)
        chip->dma_length[channel] = (uint16_t)value;
    *at(chip, DMA1 + reg) = value;
}

/* ---- SPI ---- */

static uint64_t spi_byte_cycles(const chip_t *chip, int which)
{
    return core_cycles(chip, 8u * (2u << (look(chip, spis[which].base + S_CR1) >> 3 & 7)) * spis[which].bus_divider);
}

static void imu_bytes(chip_t *chip, const uint8_t *out, uint8_t *in, size_t length)
{
    const uint32_t hz = (uint32_t)(8 * CYCLES_PER_US * 1000000ull / spi_byte_cycles(chip, IMU));
    chip->pins.imu_transfer(chip->pins.context, out, in, length, hz);
}

/* Polled: one byte after the other, each as a transfer of its own register. */
static uint8_t imu_byte(chip_t *chip, uint8_t out)
{
    spi_state_t *spi = &chip->spi[IMU];
    uint8_t sent[2], got[2] = {0xFF, 0xFF};
    if (spi->sent++ == 0) {
        spi->command = out;
        return 0xFF;
    }
    sent[0] = (uint8_t)((spi->command & 0x80) | ((spi->command + spi->sent - 2) & 0x7F));
    sent[1] = out;
    imu_bytes(chip, sent, got, 2);
    return got[1];
}

static uint8_t spi_exchange(chip_t *chip, int which, uint8_t out)
{
    spi_state_t *spi = &chip->spi[which];
    if (which == CARD)
        return chip->pins.card_byte(chip->pins.context, out);
    if (spi->burst_at < spi->burst_length)
        return spi->burst[spi->burst_at++];
    return imu_byte(chip, out);
}

static void begin_imu_burst(chip_t *chip)
{
    spi_state_t *spi = &chip->spi[IMU];
    uint8_t out[LONGEST_BURST];
    const uint8_t *place = dma_place(chip, spis[IMU].transmit);
    const size_t length = look(chip, channel_at(spis[IMU].transmit) + D_CNDTR);
    spi->burst_at = spi->burst_length = 0;
    if (!place || length > LONGEST_BURST || spi->sent)
        return;
    memcpy(out, place, length);
    imu_bytes(chip, out, spi->burst, length);
    spi->burst_length = length;
    spi->sent = length;
}

static bool has_spi_dma(const chip_t *chip, int which)
{
    const uint32_t both = SPI_RX_DMA | SPI_TX_DMA;
    return (look(chip, spis[which].base + S_CR2) & both) == both && (look(chip, spis[which].base + S_CR1) & SPI_ON) &&
           is_dma_on(chip, spis[which].transmit);
}

static void begin_spi_dma(chip_t *chip, int which)
{
    spi_state_t *spi = &chip->spi[which];
    if (spi->done != NEVER || !has_spi_dma(chip, which))
        return;
    if (which == IMU && look(chip, channel_at(spis[IMU].transmit) + D_CNDTR) == chip->dma_length[spis[IMU].transmit])
        begin_imu_burst(chip);
    dma_move(chip, spis[which].transmit, &spi->out);
    spi->done = now(chip) + spi_byte_cycles(chip, which);
}

static void step_spi(chip_t *chip, int which)
{
    spi_state_t *spi = &chip->spi[which];
    if (now(chip) < spi->done)
        return;
    spi->done = NEVER;
    spi->in = spi_exchange(chip, which, spi->out);
    if ((look(chip, spis[which].base + S_CR2) & SPI_RX_DMA) && is_dma_on(chip, spis[which].receive))
        dma_move(chip, spis[which].receive, &spi->in);
    else
        spi->is_received = true;
    begin_spi_dma(chip, which);
}

static void write_spi(chip_t *chip, int which, uint32_t reg, uint32_t value)
{
    spi_state_t *spi = &chip->spi[which];
    if (reg == S_DR) {
        if (spi->done == NEVER && (look(chip, spis[which].base + S_CR1) & SPI_ON)) {
            spi->out = (uint8_t)value;
            spi->is_received = false;
            spi->done = now(chip) + spi_byte_cycles(chip, which);
        }
        return;
    }
    *at(chip, spis[which].base + reg) = value;
    if (reg == S_CR1 && !(value & SPI_ON))
        spi->done = NEVER;
    if (reg == S_CR2)
        begin_spi_dma(chip, which);
}

static uint32_t read_spi(chip_t *chip, int which, uint32_t reg)
{
    spi_state_t *spi = &chip->spi[which];
    step_spi(chip, which);
    if (reg == S_SR)
        return (spi->done == NEVER ? 2u : 0x80u) | (spi->is_received ? 1u : 0u);
    if (reg != S_DR)
        return look(chip, spis[which].base + reg);
    spi->is_received = false;
    return spi->in;
}

/* ---- USARTs ---- */

static uint64_t receiver_byte_cycles(const chip_t *chip)
{
    return core_cycles(chip, 2ull * BITS_A_BYTE * look(chip, USART2 + U_BRR)); /* on the slower bus */
}

/* The rate that a divider comes near to: within 2 percent a line works. */
uint32_t chip_receiver_baud(const chip_t *chip)
{
    static const uint32_t known[] = {4800, 9600, 19200, 38400, 57600, 115200};
    const uint32_t divider = look(chip, USART2 + U_BRR);
    if (!divider || (look(chip, USART2 + U_CR1) & 0x2004) != 0x2004)
        return 0;
    const uint32_t baud = (uint32_t)(CYCLES_PER_US * 1000000ull / core_cycles(chip, 2ull * divider));
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (baud > known[i] - known[i] / 50 && baud < known[i] + known[i] / 50)
            return known[i];
    return baud;
}

void chip_receive(chip_t *chip, uint8_t byte)
{
    if (!chip_receiver_baud(chip))
        return;
    if ((look(chip, USART2 + U_CR3) & 0x40) && is_dma_on(chip, GPS_IN)) {
        dma_move(chip, GPS_IN, &byte);
    } else {
        if (look(chip, USART2 + U_SR) & RXNE_U) {
            *at(chip, USART2 + U_SR) |= ORE;
            chip->overruns++;
        }
        *at(chip, USART2 + U_SR) |= RXNE_U;
        *at(chip, USART2 + U_DR) = byte;
    }
    chip->idle_at = now(chip) + receiver_byte_cycles(chip);
    machine_attend(chip->machine);
}

static void begin_sending(chip_t *chip)
{
    if (chip->sent_at == NEVER && is_dma_on(chip, GPS_OUT) && (look(chip, USART2 + U_CR3) & 0x80))
        chip->sent_at = now(chip) + receiver_byte_cycles(chip);
}

static void step_receiver(chip_t *chip)
{
    if (now(chip) >= chip->idle_at) {
        chip->idle_at = NEVER;
        *at(chip, USART2 + U_SR) |= IDLE;
    }
    if (now(chip) < chip->sent_at)
        return;
    chip->sent_at = NEVER;
    if (is_dma_on(chip, GPS_OUT)) {
        uint8_t byte = 0;
        dma_move(chip, GPS_OUT, &byte);
        chip->pins.to_receiver(chip->pins.context, byte, chip_receiver_baud(chip));
    }
    begin_sending(chip);
}

static uint32_t read_receiver(chip_t *chip, uint32_t reg)
{
    const uint32_t value = look(chip, USART2 + reg);
    if (reg == U_SR)
        chip->was_status_read = true;
    if (reg == U_DR) {
        *at(chip, USART2 + U_SR) &= ~(uint32_t)RXNE_U;
        if (chip->was_status_read)
            *at(chip, USART2 + U_SR) &= ~(uint32_t)(IDLE | ORE);
        chip->was_status_read = false;
    }
    return reg == U_SR ? value | TXE | TC : value;
}

static void write_receiver(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg == U_SR || reg == U_DR)
        return;
    *at(chip, USART2 + reg) = value;
    if (reg == U_CR1 && !(value & 0x2000)) {
        *at(chip, USART2 + U_SR) = 0;
        chip->idle_at = chip->sent_at = NEVER;
    }
    begin_sending(chip);
}

static bool is_serial_free(const chip_t *chip)
{
    return now(chip) >= chip->serial_free;
}

static void write_serial(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg != U_DR) {
        *at(chip, USART1 + reg) = value;
        return;
    }
    chip->serial_free = now(chip) + core_cycles(chip, (uint64_t)BITS_A_BYTE * look(chip, USART1 + U_BRR));
    chip->pins.to_serial(chip->pins.context, (uint8_t)value);
}

/* ---- pins, interrupt pin, watchdog ---- */

void chip_imu_edge(chip_t *chip)
{
    const bool is_port_b = (look(chip, AFIO + 8) & 15) == 1;
    if (is_port_b && (look(chip, EXTI + E_RTSR) & 1))
        *at(chip, EXTI + E_PR) |= 1;
    machine_attend(chip->machine);
}

static void put_pins(chip_t *chip, uint32_t port, uint32_t to_set, uint32_t to_clear)
{
    const uint32_t before = look(chip, port + G_ODR), after = (before & ~to_clear) | to_set;
    *at(chip, port + G_ODR) = after;
    if (port == GPIOA && ((before ^ after) & 1u << 4))
        chip->pins.card_select(chip->pins.context, !(after & 1u << 4));
    if (port == GPIOC && ((before ^ after) & 1u << 13))
        chip->pins.led(chip->pins.context, !(after & 1u << 13));
    if (port == GPIOB && ((to_set | to_clear) & 1u << 12))
        chip->spi[IMU].sent = chip->spi[IMU].burst_at = chip->spi[IMU].burst_length = 0;
}

static void write_port(chip_t *chip, uint32_t port, uint32_t reg, uint32_t value)
{
    if (reg == G_BSRR)
        put_pins(chip, port, value & 0xFFFF, value >> 16);
    else if (reg == G_BRR)
        put_pins(chip, port, 0, value);
    else if (reg == G_ODR)
        put_pins(chip, port, value, ~value);
    else
        *at(chip, port + reg) = value;
}

static void write_watchdog(chip_t *chip, uint32_t reg, uint32_t value)
{
    *at(chip, IWDG + reg) = value;
    if (reg != 0 || (value != 0xAAAA && value != 0xCCCC))
        return;
    const uint64_t divider = 4ull << (look(chip, IWDG + 4) & 7), reload = look(chip, IWDG + 8) & 0xFFF;
    if (chip->fed && now(chip) - chip->fed > chip->longest_unfed)
        chip->longest_unfed = now(chip) - chip->fed;
    chip->fed = now(chip);
    chip->watchdog_at = now(chip) + divider * (reload ? reload : 0xFFF) * CYCLES_PER_US * 1000000ull / LSI_HZ;
}

/* ---- the whole ---- */

void chip_init(chip_t *chip, machine_t *machine, const pins_t *pins)
{
    memset(chip, 0, sizeof *chip);
    chip->machine = machine;
    chip->pins = *pins;
    chip->has_crystal = true;
}

void chip_reset(chip_t *chip, uint8_t cause)
{
    uint32_t backup[16];
    memcpy(backup, &chip->registers[BKP / 4], sizeof backup);
    memset(chip->registers, 0, sizeof chip->registers);
    if (!(cause & 0x08)) /* power-on alone clears them */
        memcpy(&chip->registers[BKP / 4], backup, sizeof backup);
    memset(chip->dma_length, 0, sizeof chip->dma_length);
    for (int i = 0; i < SPIS; i++)
        chip->spi[i] = (spi_state_t){.done = NEVER};
    chip->overflow_at = chip->compare_at = chip->sent_at = chip->idle_at = chip->watchdog_at = NEVER;
    chip->serial_free = chip->fed = 0;
    *at(chip, RCC) = 0x83;
    *at(chip, RCC + 0x24) = (uint32_t)cause << 24;
    *at(chip, GPIOA + G_ODR) = *at(chip, GPIOC + G_ODR) = 0;
    chip->pins.card_select(chip->pins.context, false);
}

uint64_t chip_advance(chip_t *chip)
{
    step_timer(chip);
    step_spi(chip, CARD);
    step_spi(chip, IMU);
    step_receiver(chip);
    if (now(chip) >= chip->watchdog_at) {
        chip->watchdog_at = NEVER;
        chip->watchdog_resets++;
        *at(chip, RCC + 0x24) |= (uint32_t)WATCHDOG_CAUSE << 24;
        chip->machine->is_reset_wanted = true;
    }
    uint64_t next = sooner(sooner(chip->overflow_at, chip->compare_at), sooner(chip->sent_at, chip->idle_at));
    next = sooner(next, sooner(chip->spi[CARD].done, chip->spi[IMU].done));
    if (!is_serial_free(chip))
        next = sooner(next, chip->serial_free);
    return sooner(next, chip->watchdog_at);
}

uint64_t chip_levels(const chip_t *chip)
{
    uint64_t lines = 0;
    if (look(chip, TIM2 + T_SR) & look(chip, TIM2 + T_DIER) & 7)
        lines |= 1ull << IRQ_TIM2;
    if (look(chip, EXTI + E_PR) & look(chip, EXTI + E_IMR) & 1)
        lines |= 1ull << IRQ_EXTI0;
    const uint32_t flags = look(chip, DMA1);
    for (unsigned channel = 1; flags && channel < DMA_CHANNELS; channel++)
        if (flags >> 4 * (channel - 1) & look(chip, channel_at(channel)) & (CCR_TCIE | CCR_HTIE | CCR_TEIE))
            lines |= 1ull << (IRQ_DMA1 + channel - 1);
    if ((look(chip, USART1 + U_CR1) & TXE) && is_serial_free(chip))
        lines |= 1ull << IRQ_USART1;
    if (look(chip, USART2 + U_SR) & look(chip, USART2 + U_CR1) & (IDLE | RXNE_U))
        lines |= 1ull << IRQ_USART2;
    return lines;
}

static uint32_t read_clocks(const chip_t *chip, uint32_t reg)
{
    uint32_t value = look(chip, RCC + reg);
    if (reg == 0) {
        value |= 2;
        value |= value & 1u << 16 && chip->has_crystal ? 1u << 17 : 0;
        value |= value & 1u << 24 ? 1u << 25 : 0;
    }
    return reg == 4 ? (value & ~0xCu) | (value & 3) << 2 : value;
}

uint32_t chip_read(chip_t *chip, uint32_t address, unsigned size)
{
    const uint32_t offset = address - BASE, reg = offset & 0x3FF;
    (void)size;
    switch (offset & ~0x3FFu) {
    case TIM2:
        step_timer(chip);
        if (reg == T_CCR2)
            *at(chip, TIM2 + T_SR) &= ~(uint32_t)CC2IF;
        return reg == T_CNT ? timer_count(chip) : look(chip, offset);
    case SPI1:
        return read_spi(chip, CARD, reg);
    case SPI2:
        return read_spi(chip, IMU, reg);
    case USART1:
        return reg == U_SR ? (is_serial_free(chip) ? TXE | TC : 0) : look(chip, offset);
    case USART2:
        return read_receiver(chip, reg);
    case RCC:
        return read_clocks(chip, reg);
    case PWR:
        return reg == 4 ? (chip->pins.is_supply_low(chip->pins.context) ? 4 : 0) : look(chip, offset);
    case GPIOA:
        return reg == G_IDR ? 0xFFFEu | !chip->pins.is_button_pressed(chip->pins.context) : look(chip, offset);
    default:
        return look(chip, offset);
    }
}

void chip_write(chip_t *chip, uint32_t address, unsigned size, uint32_t value)
{
    const uint32_t offset = address - BASE, reg = offset & 0x3FF;
    (void)size;
    switch (offset & ~0x3FFu) {
    case TIM2:
        write_timer(chip, reg, value);
        break;
    case SPI1:
        write_spi(chip, CARD, reg, value);
        break;
    case SPI2:
        write_spi(chip, IMU, reg, value);
        break;
    case USART1:
        write_serial(chip, reg, value);
        break;
    case USART2:
        write_receiver(chip, reg, value);
        break;
    case DMA1:
        write_dma(chip, reg, value);
        begin_sending(chip);
        break;
    case GPIOA:
    case GPIOB:
    case GPIOC:
        write_port(chip, offset & ~0x3FFu, reg, value);
        break;
    case EXTI:
        if (reg == E_PR)
            *at(chip, offset) &= ~value;
        else
            *at(chip, offset) = value;
        break;
    case IWDG:
        write_watchdog(chip, reg, value);
        break;
    case RCC:
        *at(chip, offset) = reg == 0x24 && (value & 1u << 24) ? 0 : value;
        break;
    default:
        *at(chip, offset) = value;
    }
}
