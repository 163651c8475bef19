#include "chip.h"

#include <string.h>

#include "chip_registers.h"
#include "clocks.h"
#include "rules.h"

enum { TIMER_COUNTS = 65536 };
enum { IRQ_EXTI0 = 6, IRQ_DMA1 = 11, IRQ_TIM2 = 28, IRQ_USART1 = 37, IRQ_USART2 = 38 };
enum { BITS_A_BYTE = 10, LSI_HZ = 40000, WATCHDOG_CAUSE = 0x20, BACKUP_WORDS = 11 };
enum { HSE_STARTS_US = 2000, PLL_LOCKS_US = 200 };

const spi_place_t spis[SPIS] = {{SPI1, false, 2, 3}, {SPI2, true, 4, 5}};

static uint64_t now(const chip_t *chip)
{
    return chip->machine->cycles;
}

static uint64_t sooner(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* So many periods of a clock, in cycles of 72 MHz. */
static uint64_t cycles_of(uint64_t periods, uint32_t hz)
{
    return periods * CYCLES_PER_US * 1000000ull / hz;
}

/* ---- TIM2 ---- */

static uint64_t count_cycles(const chip_t *chip)
{
    return cycles_of(look(chip, TIM2 + T_PSC) + 1u, chip->clocks.timer_hz);
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
    if (!place) {
        rules_break(chip->machine, RULE_DMA_ADDRESS, "DMA1");
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

uint32_t chip_spi_hz(const chip_t *chip, int which)
{
    const uint32_t bus_hz = spis[which].is_on_apb1 ? chip->clocks.apb1_hz : chip->clocks.apb2_hz;
    return bus_hz / (2u << (look(chip, spis[which].base + S_CR1) >> 3 & 7));
}

static uint64_t spi_byte_cycles(const chip_t *chip, int which)
{
    return cycles_of(8, chip_spi_hz(chip, which));
}

static void imu_bytes(chip_t *chip, const uint8_t *out, uint8_t *in, size_t length)
{
    chip->pins.imu_transfer(chip->pins.context, out, in, length, chip_spi_hz(chip, IMU));
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
        return chip->pins.card_byte(chip->pins.context, out, chip_spi_hz(chip, CARD));
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
    rules_spi_begins(chip, which);
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
    else if (spi->is_received)
        rules_break(chip->machine, RULE_SPI_OVERRUN, which == CARD ? "SPI1" : "SPI2");
    else
        spi->is_received = true;
    begin_spi_dma(chip, which);
}

static void write_spi(chip_t *chip, int which, uint32_t reg, uint32_t value)
{
    spi_state_t *spi = &chip->spi[which];
    if (reg == S_DR) {
        spi->out = (uint8_t)value;
        rules_spi_begins(chip, which);
        spi->done = now(chip) + spi_byte_cycles(chip, which);
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

uint32_t chip_baud(const chip_t *chip, uint32_t usart)
{
    const uint32_t divider = look(chip, usart + U_BRR);
    return divider ? (usart == USART1 ? chip->clocks.apb2_hz : chip->clocks.apb1_hz) / divider : 0;
}

static uint64_t receiver_byte_cycles(const chip_t *chip)
{
    const uint32_t baud = chip_baud(chip, USART2);
    return baud ? cycles_of(BITS_A_BYTE, baud) : NEVER;
}

/* The rate that a divider comes near to: within 2 percent a line works. */
uint32_t chip_receiver_baud(const chip_t *chip)
{
    static const uint32_t known[] = {4800, 9600, 19200, 38400, 57600, 115200};
    const uint32_t baud = chip_baud(chip, USART2), on = U_ON | U_RECEIVES;
    if ((look(chip, USART2 + U_CR1) & on) != on)
        return 0;
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (baud > known[i] - known[i] / 50 && baud < known[i] + known[i] / 50)
            return known[i];
    return baud;
}

void chip_receive(chip_t *chip, uint8_t byte)
{
    if (!chip_receiver_baud(chip))
        return;
    rules_pin_is_pulled(chip, GPIOA, 3, true);
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
        rules_serial_sends(chip, USART2);
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

void chip_hear(chip_t *chip, uint8_t byte)
{
    const uint32_t on = U_ON | U_RECEIVES;
    if ((look(chip, USART1 + U_CR1) & on) != on)
        return;
    rules_pin_is_pulled(chip, GPIOA, 10, true);
    *at(chip, USART1 + U_SR) |= look(chip, USART1 + U_SR) & RXNE_U ? ORE : RXNE_U;
    *at(chip, USART1 + U_DR) = byte;
    machine_attend(chip->machine);
}

static uint32_t read_serial(chip_t *chip, uint32_t reg)
{
    const uint32_t value = look(chip, USART1 + reg);
    if (reg == U_DR)
        *at(chip, USART1 + U_SR) = 0;
    return reg == U_SR && is_serial_free(chip) ? value | TXE | TC : value;
}

static void write_serial(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg != U_DR) {
        *at(chip, USART1 + reg) = value;
        return;
    }
    rules_serial_sends(chip, USART1);
    if (!is_serial_free(chip))
        rules_break(chip->machine, RULE_USART_OVERWRITTEN, "USART1");
    if (chip->machine->is_over)
        return;
    chip->serial_free = now(chip) + cycles_of(BITS_A_BYTE, chip_baud(chip, USART1));
    chip->pins.to_serial(chip->pins.context, (uint8_t)value, chip_baud(chip, USART1));
}

/* ---- pins, interrupt pin, watchdog ---- */

void chip_imu_edge(chip_t *chip)
{
    const bool is_port_b = (look(chip, AFIO + A_EXTICR1) & 15) == 1;
    if (is_port_b && (look(chip, EXTI + E_RTSR) & 1))
        *at(chip, EXTI + E_PR) |= 1;
    machine_attend(chip->machine);
}

static void select_card(chip_t *chip, bool is_selected)
{
    if (is_selected)
        rules_pin_is_output(chip, GPIOA, 4);
    chip->pins.card_select(chip->pins.context, is_selected);
}

static void put_pins(chip_t *chip, uint32_t port, uint32_t to_set, uint32_t to_clear)
{
    const uint32_t before = look(chip, port + G_ODR), after = (before & ~to_clear) | to_set;
    *at(chip, port + G_ODR) = after;
    if (port == GPIOA && ((before ^ after) & 1u << 4))
        select_card(chip, !(after & 1u << 4));
    if (port == GPIOC && ((before ^ after) & 1u << 13))
        chip->pins.led(chip->pins.context, !(after & 1u << 13));
    if (port == GPIOC && to_clear & 1u << 13)
        rules_pin_is_output(chip, GPIOC, 13);
    if (port == GPIOB && ((to_set | to_clear) & 1u << 12))
        chip->spi[IMU].sent = chip->spi[IMU].burst_at = chip->spi[IMU].burst_length = 0;
    if (port == GPIOB && to_clear & 1u << 12)
        rules_pin_is_output(chip, GPIOB, 12);
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
    if (reg == I_KR)
        chip->is_watchdog_unlocked = value == 0x5555;
    if (reg != I_KR || (value != 0xAAAA && value != 0xCCCC))
        return;
    const uint64_t divider = 4ull << (look(chip, IWDG + I_PR) & 7), reload = look(chip, IWDG + I_RLR);
    if (chip->fed && now(chip) - chip->fed > chip->longest_unfed)
        chip->longest_unfed = now(chip) - chip->fed;
    chip->fed = now(chip);
    chip->watchdog_period = cycles_of(divider * (reload + 1), LSI_HZ);
    chip->watchdog_at = now(chip) + chip->watchdog_period;
}

/* ---- the whole ---- */

void chip_init(chip_t *chip, machine_t *machine, const pins_t *pins)
{
    memset(chip, 0, sizeof *chip);
    chip->machine = machine;
    chip->pins = *pins;
    chip->has_crystal = true;
}

static void put_reset_values(chip_t *chip)
{
    *at(chip, RCC) = 0x83;
    *at(chip, RCC + R_AHBENR) = 0x14;
    *at(chip, FLASH) = 0x30;
    *at(chip, TIM2 + T_ARR) = 0xFFFF;
    *at(chip, IWDG + I_RLR) = 0xFFF;
    for (uint32_t port = GPIOA; port <= GPIOC; port += GPIOB - GPIOA)
        *at(chip, port + G_CRL) = *at(chip, port + G_CRH) = 0x44444444;
}

void chip_reset(chip_t *chip, uint8_t cause)
{
    uint32_t backup[BACKUP_WORDS];
    memcpy(backup, &chip->registers[BKP / 4], sizeof backup);
    memset(chip->registers, 0, sizeof chip->registers);
    if (!(cause & 0x08)) /* power-on alone clears them */
        memcpy(&chip->registers[BKP / 4], backup, sizeof backup);
    memset(chip->dma_length, 0, sizeof chip->dma_length);
    for (int i = 0; i < SPIS; i++)
        chip->spi[i] = (spi_state_t){.done = NEVER};
    chip->overflow_at = chip->compare_at = chip->sent_at = chip->idle_at = chip->watchdog_at = NEVER;
    chip->crystal_ready_at = chip->pll_ready_at = NEVER;
    chip->serial_free = chip->fed = 0;
    chip->is_watchdog_unlocked = false;
    put_reset_values(chip);
    *at(chip, RCC + R_CSR) = (uint32_t)cause << 24;
    chip->clocks = clocks_of(0);
    chip->pins.card_select(chip->pins.context, false);
}

uint8_t chip_reset_cause(const chip_t *chip)
{
    return (uint8_t)(look(chip, RCC + R_CSR) >> 24);
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
        *at(chip, RCC + R_CSR) |= (uint32_t)WATCHDOG_CAUSE << 24;
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
    if (look(chip, TIM2 + T_SR) & look(chip, TIM2 + T_DIER) & 3)
        lines |= 1ull << IRQ_TIM2;
    if (look(chip, EXTI + E_PR) & look(chip, EXTI + E_IMR) & 1)
        lines |= 1ull << IRQ_EXTI0;
    const uint32_t flags = look(chip, DMA1);
    for (unsigned channel = 1; flags && channel < DMA_CHANNELS; channel++)
        if (flags >> 4 * (channel - 1) & look(chip, channel_at(channel)) & (CCR_TCIE | CCR_HTIE | CCR_TEIE))
            lines |= 1ull << (IRQ_DMA1 + channel - 1);
    if (((look(chip, USART1 + U_CR1) & TXE) && is_serial_free(chip)) ||
        (look(chip, USART1 + U_SR) & look(chip, USART1 + U_CR1) & RXNE_U))
        lines |= 1ull << IRQ_USART1;
    if (look(chip, USART2 + U_SR) & look(chip, USART2 + U_CR1) & (IDLE | RXNE_U))
        lines |= 1ull << IRQ_USART2;
    return lines;
}

uint32_t chip_clock_control(const chip_t *chip)
{
    uint32_t value = look(chip, RCC + R_CR) | 2;
    value |= now(chip) >= chip->crystal_ready_at ? HSE_READY : 0;
    return value | (now(chip) >= chip->pll_ready_at ? PLL_READY : 0);
}

static void write_clock_control(chip_t *chip, uint32_t value)
{
    const bool has_crystal = value & HSE_ON && chip->has_crystal;
    *at(chip, RCC + R_CR) = value & ~(uint32_t)(HSE_READY | PLL_READY);
    if (!has_crystal)
        chip->crystal_ready_at = NEVER;
    else if (chip->crystal_ready_at == NEVER)
        chip->crystal_ready_at = now(chip) + HSE_STARTS_US * CYCLES_PER_US;
    if (!(value & PLL_ON))
        chip->pll_ready_at = NEVER;
    else if (chip->pll_ready_at == NEVER)
        chip->pll_ready_at = now(chip) + PLL_LOCKS_US * CYCLES_PER_US;
}

static void write_clocks(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg == R_CR)
        write_clock_control(chip, value);
    else
        *at(chip, RCC + reg) = reg == R_CSR && (value & 1u << 24) ? 0 : value;
    chip->clocks = clocks_of(look(chip, RCC + R_CFGR));
}

static uint32_t read_clocks(const chip_t *chip, uint32_t reg)
{
    const uint32_t value = look(chip, RCC + reg);
    if (reg == R_CR)
        return chip_clock_control(chip);
    return reg == R_CFGR ? (value & ~0xCu) | (value & 3) << 2 : value;
}

static uint32_t read_port_a(chip_t *chip, uint32_t reg)
{
    if (reg != G_IDR)
        return look(chip, GPIOA + reg);
    rules_pin_is_pulled(chip, GPIOA, 0, true);
    return 0xFFFEu | !chip->pins.is_button_pressed(chip->pins.context);
}

uint32_t chip_read(chip_t *chip, uint32_t address, unsigned size)
{
    const uint32_t offset = address - BASE, reg = offset & 0x3FF;
    if (!rules_allow(chip, offset, size, false, 0))
        return 0;
    switch (offset & ~0x3FFu) {
    case TIM2:
        step_timer(chip);
        return reg == T_CNT ? timer_count(chip) : look(chip, offset);
    case SPI1:
        return read_spi(chip, CARD, reg);
    case SPI2:
        return read_spi(chip, IMU, reg);
    case USART1:
        return read_serial(chip, reg);
    case USART2:
        return read_receiver(chip, reg);
    case RCC:
        return read_clocks(chip, reg);
    case PWR:
        return reg == 4 ? (chip->pins.is_supply_low(chip->pins.context) ? 4 : 0) : look(chip, offset);
    case GPIOA:
        return read_port_a(chip, reg);
    default:
        return look(chip, offset);
    }
}

void chip_write(chip_t *chip, uint32_t address, unsigned size, uint32_t value)
{
    const uint32_t offset = address - BASE, reg = offset & 0x3FF;
    if (!rules_allow(chip, offset, size, true, value))
        return;
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
        if (reg == E_IMR && value & 1)
            rules_pin_is_pulled(chip, GPIOB, 0, false);
        if (reg == E_PR)
            *at(chip, offset) &= ~value;
        else
            *at(chip, offset) = value;
        break;
    case IWDG:
        write_watchdog(chip, reg, value);
        break;
    case RCC:
        write_clocks(chip, reg, value);
        break;
    default:
        *at(chip, offset) = value;
    }
}
