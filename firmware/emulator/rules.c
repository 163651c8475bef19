#include "rules.h"

#include "chip_registers.h"
#include "clocks.h"

static const char *const texts[RULE_COUNT] = {
#define TEXT_OF(name, text) [RULE_##name] = text,
    RULES(TEXT_OF)
#undef TEXT_OF
};

void rules_break(machine_t *machine, rule_t rule, const char *what)
{
    machine_forbid(machine, texts[rule], what);
}

static bool forbid(chip_t *chip, rule_t rule, const char *what)
{
    rules_break(chip->machine, rule, what);
    return false;
}

/* ---- which registers there are ---- */

enum { NONE = 0 };

typedef struct {
    uint32_t base, enable; /* register of RCC with the bit that switches its clock on; NONE: it always has one */
    unsigned bit;
    bool has_half_words;
    const char *name;
    const uint32_t *bits; /* by register: those that are not reserved; 0: not used by the port */
    unsigned count;
} block_t;

/* Compared with ST's SVD file by tests/firmware/test_registers.py. */
static const uint32_t TIM_BITS[] = {0x3FF, 0xF8, 0xFFF7, 0x5F5F, 0x1E5F, 0x5F, 0xFFFF, 0xFFFF, 0x3333, 0xFFFF, 0xFFFF, 0xFFFF, 0, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF};
static const uint32_t IWDG_BITS[] = {0xFFFF, 0x7, 0xFFF, 0x3};
static const uint32_t SPI_BITS[] = {0xFFFF, 0xE7, 0xFF, 0xFFFF};
static const uint32_t USART_BITS[] = {0x3FF, 0x1FF, 0xFFFF, 0x3FFF, 0x7F6F, 0x7FF};
static const uint32_t BKP_BITS[] = {0, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF};
static const uint32_t PWR_BITS[] = {0x1FF, 0x107};
static const uint32_t AFIO_BITS[] = {0xFF, 0x71FFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF};
static const uint32_t EXTI_BITS[] = {0x7FFFF, 0x7FFFF, 0x7FFFF, 0x7FFFF, 0x7FFFF, 0x7FFFF};
static const uint32_t GPIO_BITS[] = {0xFFFFFFFF, 0xFFFFFFFF, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFF, 0x1FFFF};
static const uint32_t RCC_BITS[] = {0x30FFFFB, 0x77FFFFF, 0x9F1F9F, 0x38FFFD, 0x3AFEC9FF, 0x557, 0x38FFFD, 0x3AFEC9FF, 0x18307, 0xFD000003};
static const uint32_t FLASH_BITS[] = {0x3F};
static const uint32_t DMA_BITS[] = {0xFFFFFFF, 0xFFFFFFF};
static const uint32_t CHANNEL_BITS[] = {0x7FFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0};

#define REGISTERS(bits) bits, sizeof bits / sizeof *bits
static const block_t blocks[] = {
    {TIM2, R_APB1ENR, 0, true, "TIM2", REGISTERS(TIM_BITS)},       {IWDG, NONE, 0, true, "IWDG", REGISTERS(IWDG_BITS)},
    {SPI2, R_APB1ENR, 14, true, "SPI2", REGISTERS(SPI_BITS)},      {USART2, R_APB1ENR, 17, true, "USART2", REGISTERS(USART_BITS)},
    {BKP, R_APB1ENR, 27, true, "BKP", REGISTERS(BKP_BITS)},        {PWR, R_APB1ENR, 28, true, "PWR", REGISTERS(PWR_BITS)},
    {AFIO, R_APB2ENR, 0, false, "AFIO", REGISTERS(AFIO_BITS)},     {EXTI, NONE, 0, false, "EXTI", REGISTERS(EXTI_BITS)},
    {GPIOA, R_APB2ENR, 2, false, "GPIOA", REGISTERS(GPIO_BITS)},   {GPIOB, R_APB2ENR, 3, false, "GPIOB", REGISTERS(GPIO_BITS)},
    {GPIOC, R_APB2ENR, 4, false, "GPIOC", REGISTERS(GPIO_BITS)},   {SPI1, R_APB2ENR, 12, true, "SPI1", REGISTERS(SPI_BITS)},
    {USART1, R_APB2ENR, 14, true, "USART1", REGISTERS(USART_BITS)}, {DMA1, R_AHBENR, 0, false, "DMA1", REGISTERS(DMA_BITS)},
    {RCC, NONE, 0, true, "RCC", REGISTERS(RCC_BITS)},              {FLASH, NONE, 0, false, "FLASH", REGISTERS(FLASH_BITS)},
};

static const block_t *find_block(uint32_t offset)
{
    for (size_t i = 0; i < sizeof blocks / sizeof *blocks; i++)
        if (blocks[i].base == (offset & ~0x3FFu))
            return &blocks[i];
    return NULL;
}

/* Bits of a register that are not reserved; 0 if there is none. */
static uint32_t bits_of(const block_t *block, uint32_t reg)
{
    const unsigned number = reg / 4;
    if (number < block->count)
        return block->bits[number];
    if (block->base == DMA1 && number < 2 + 5 * (DMA_CHANNELS - 1))
        return CHANNEL_BITS[(number - 2) % 5];
    return 0;
}

static bool has_clock(const chip_t *chip, const block_t *block)
{
    return block->enable == NONE || (look(chip, RCC + block->enable) >> block->bit & 1);
}

/* ---- clocks and memories ---- */

static uint32_t wait_states_for(uint32_t hz)
{
    return hz > 48000000 ? 2 : hz > 24000000 ? 1 : 0;
}

static bool allow_clock_tree(chip_t *chip, uint32_t cfgr, uint32_t flash)
{
    const clocks_t clocks = clocks_of(cfgr);
    if (clocks.system_hz > 72000000)
        return forbid(chip, RULE_PLL_TOO_FAST, "core");
    if (clocks.apb1_hz > 36000000)
        return forbid(chip, RULE_APB1_TOO_FAST, "APB1");
    if ((flash & 7) < wait_states_for(clocks.system_hz))
        return forbid(chip, RULE_FLASH_TOO_FAST, "FLASH_ACR");
    return true;
}

static bool allow_clock_config(chip_t *chip, uint32_t value)
{
    const uint32_t control = chip_clock_control(chip), before = look(chip, RCC + R_CFGR);
    const bool is_pll_on = (control & PLL_ON) != 0;
    if (is_pll_on && (value ^ before) & PLL_BITS)
        return forbid(chip, RULE_PLL_CHANGED, "RCC_CFGR");
    if (((value & 3) == 2 && !(control & PLL_READY)) || ((value & 3) == 1 && !(control & HSE_READY)))
        return forbid(chip, RULE_CLOCK_NOT_READY, "RCC_CFGR");
    return allow_clock_tree(chip, value, look(chip, FLASH));
}

static bool allow_clock_control(chip_t *chip, uint32_t value)
{
    const uint32_t control = chip_clock_control(chip), cfgr = look(chip, RCC + R_CFGR);
    if (!(value & PLL_ON) || control & PLL_ON)
        return true;
    if (cfgr & 1u << 16 && !(control & HSE_READY))
        return forbid(chip, RULE_SOURCE_NOT_READY, "HSE");
    return clocks_pll_hz(cfgr) <= 72000000 || forbid(chip, RULE_PLL_TOO_FAST, "PLL");
}

static bool allow_flash_control(chip_t *chip, uint32_t value)
{
    const bool is_switched = (value ^ look(chip, FLASH)) & 0x10;
    if (is_switched && chip->clocks.system_hz > 24000000)
        return forbid(chip, RULE_PREFETCH, "FLASH_ACR");
    return allow_clock_tree(chip, look(chip, RCC + R_CFGR), value);
}

void rules_sleep(chip_t *chip)
{
    if (look(chip, RCC + R_AHBENR) & 1u << 2)
        return;
    for (unsigned channel = 1; channel < DMA_CHANNELS; channel++)
        if (look(chip, channel_at(channel) + D_CCR) & CCR_EN && look(chip, channel_at(channel) + D_CNDTR)) {
            forbid(chip, RULE_SLEEPING_MEMORY, "RCC_AHBENR");
            return;
        }
}

/* ---- pins ---- */

enum { PORT_BYTES = 0x400 };
static const uint32_t PIN_HZ[4] = {0, 10000000, 2000000, 50000000};

static uint32_t pin_bits(const chip_t *chip, uint32_t port, unsigned pin)
{
    return look(chip, port + (pin < 8 ? G_CRL : G_CRH)) >> 4 * (pin % 8) & 15;
}

static bool is_alternate_output(uint32_t bits)
{
    return (bits & 3) != 0 && bits >> 2 == 2;
}

static bool is_input(uint32_t bits)
{
    return (bits & 3) == 0 && (bits >> 2 == 1 || bits >> 2 == 2);
}

static const char *pin_name(uint32_t port, unsigned pin)
{
    static char name[8];
    const char digits[] = "0123456789";
    size_t length = 0;
    name[length++] = 'P';
    name[length++] = (char)('A' + (port - GPIOA) / PORT_BYTES);
    if (pin > 9)
        name[length++] = '1';
    name[length++] = digits[pin % 10];
    name[length] = 0;
    return name;
}

static bool need_alternate(chip_t *chip, uint32_t port, unsigned pin, uint32_t hz)
{
    const uint32_t bits = pin_bits(chip, port, pin);
    if (!is_alternate_output(bits))
        return forbid(chip, RULE_PIN_FUNCTION, pin_name(port, pin));
    return hz <= PIN_HZ[bits & 3] || forbid(chip, RULE_PIN_TOO_SLOW, pin_name(port, pin));
}

static bool need_input(chip_t *chip, uint32_t port, unsigned pin)
{
    return is_input(pin_bits(chip, port, pin)) || forbid(chip, RULE_PIN_FUNCTION, pin_name(port, pin));
}

void rules_pin_is_output(chip_t *chip, uint32_t port, unsigned pin)
{
    const uint32_t bits = pin_bits(chip, port, pin);
    if ((bits & 3) == 0 || bits >> 2 != 0)
        forbid(chip, RULE_PIN_FUNCTION, pin_name(port, pin));
}

void rules_pin_is_pulled(chip_t *chip, uint32_t port, unsigned pin, bool is_up)
{
    const bool is_pulled = pin_bits(chip, port, pin) == 8 && (look(chip, port + G_ODR) >> pin & 1) == is_up;
    if (need_input(chip, port, pin) && !is_pulled)
        forbid(chip, RULE_PIN_FLOATING, pin_name(port, pin));
}

/* RM0008 9.3.7 to 9.3.10: bits of AFIO_MAPR for SPI1, USART1, USART2, TIM2. */
static bool need_own_pins(chip_t *chip, uint32_t mapr_bits, const char *what)
{
    return !(look(chip, AFIO + A_MAPR) & mapr_bits) || forbid(chip, RULE_PIN_REMAPPED, what);
}

/* PC13 to PC15 hang on a weak switch. */
static bool allow_port_c(chip_t *chip, uint32_t reg, uint32_t value)
{
    const uint32_t mode = value >> 20 & 3;
    return reg != G_CRH || (mode & 1) == 0 || forbid(chip, RULE_PIN_PC13, "GPIOC_CRH");
}

/* ---- SPI ---- */

static const char *spi_name(int which)
{
    return which == CARD ? "SPI1" : "SPI2";
}

static bool allow_spi_control(chip_t *chip, int which, uint32_t value)
{
    const uint32_t before = look(chip, spis[which].base + S_CR1);
    const bool is_master = (value & (SPI_ON | SPI_MASTER)) == (SPI_ON | SPI_MASTER);
    if (chip->spi[which].done != NEVER && value != before)
        return forbid(chip, RULE_SPI_CHANGED, spi_name(which));
    if (is_master && (value & (SPI_SSM | SPI_SSI)) != (SPI_SSM | SPI_SSI))
        return forbid(chip, RULE_SPI_MODE_FAULT, spi_name(which));
    return true;
}

static bool allow_spi_data(chip_t *chip, int which)
{
    if (!(look(chip, spis[which].base + S_CR1) & SPI_ON))
        return forbid(chip, RULE_SPI_OFF, spi_name(which));
    return chip->spi[which].done == NEVER || forbid(chip, RULE_SPI_OVERWRITTEN, spi_name(which));
}

void rules_spi_begins(chip_t *chip, int which)
{
    const uint32_t control = look(chip, spis[which].base + S_CR1), hz = chip_spi_hz(chip, which);
    const bool is_half_mode = !(control & SPI_CPOL) != !(control & SPI_CPHA);
    const uint32_t port = which == CARD ? GPIOA : GPIOB;
    const unsigned clock = which == CARD ? 5 : 13;
    if (!(control & SPI_MASTER))
        forbid(chip, RULE_SPI_NOT_MASTER, spi_name(which));
    else if (control & SPI_ODD_FORMATS)
        forbid(chip, RULE_SPI_FORMAT, spi_name(which));
    else if (is_half_mode)
        forbid(chip, RULE_SPI_MODE, spi_name(which));
    else if (hz > 18000000)
        forbid(chip, RULE_SPI_TOO_FAST, spi_name(which));
    else if (need_own_pins(chip, which == CARD ? 1u : 0u, "SPI1") && need_alternate(chip, port, clock, hz) &&
             need_input(chip, port, clock + 1))
        (void)need_alternate(chip, port, clock + 2, hz);
}

/* ---- DMA ---- */

/* RM0008 table 78: the register whose requests come over a channel, and in which direction. */
static const struct {
    uint32_t data;
    bool is_from_memory;
} requests[DMA_CHANNELS] = {[2] = {SPI1 + S_DR, false}, [3] = {SPI1 + S_DR, true},   [4] = {SPI2 + S_DR, false},
                            [5] = {SPI2 + S_DR, true},  [6] = {USART2 + U_DR, false}, [7] = {USART2 + U_DR, true}};

static bool allow_switching_on(chip_t *chip, unsigned channel, uint32_t control)
{
    const bool is_from_memory = (control & CCR_DIR) != 0;
    if (!requests[channel].data || look(chip, channel_at(channel) + D_CPAR) != BASE + requests[channel].data ||
        is_from_memory != requests[channel].is_from_memory)
        return forbid(chip, RULE_DMA_CHANNEL, "DMA1");
    return !(control & (CCR_SIZES | CCR_PINC | CCR_MEM2MEM)) || forbid(chip, RULE_DMA_WIDTH, "DMA1");
}

static bool allow_channel(chip_t *chip, uint32_t reg, uint32_t value)
{
    if (reg < 8)
        return true;
    const unsigned channel = (reg - 8) / 20 + 1;
    const uint32_t control = look(chip, channel_at(channel) + D_CCR);
    const bool is_control = (reg - 8) % 20 == D_CCR;
    if (control & CCR_EN && (!is_control || (value & CCR_EN && value != control)))
        return forbid(chip, RULE_DMA_CHANGED, "DMA1");
    return !is_control || !(value & CCR_EN) || allow_switching_on(chip, channel, value);
}

/* ---- USARTs ---- */

static const char *usart_name(uint32_t usart)
{
    return usart == USART1 ? "USART1" : "USART2";
}

static bool is_usual_rate(uint32_t baud)
{
    static const uint32_t usual[] = {4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800};
    for (size_t i = 0; i < sizeof usual / sizeof *usual; i++)
        if (baud > usual[i] - usual[i] / 50 && baud < usual[i] + usual[i] / 50)
            return true;
    return false;
}

static bool allow_usart_on(chip_t *chip, uint32_t usart, uint32_t control)
{
    const uint32_t odd = 1u << 12 | 1u << 10; /* M, PCE */
    if (!(control & U_ON))
        return true;
    if (control & odd || look(chip, usart + U_CR2) & 3u << 12)
        return forbid(chip, RULE_USART_FORMAT, usart_name(usart));
    return is_usual_rate(chip_baud(chip, usart)) || forbid(chip, RULE_USART_RATE, usart_name(usart));
}

void rules_serial_sends(chip_t *chip, uint32_t usart)
{
    const uint32_t control = look(chip, usart + U_CR1), on = U_ON | U_TRANSMITS;
    if ((control & on) != on)
        forbid(chip, RULE_USART_OFF, usart_name(usart));
    else if (need_own_pins(chip, usart == USART1 ? 4u : 8u, usart_name(usart)) && allow_usart_on(chip, usart, control))
        (void)need_alternate(chip, GPIOA, usart == USART1 ? 9 : 2, chip_baud(chip, usart));
}

/* ---- the rest ---- */

static bool allow_watchdog(chip_t *chip, uint32_t reg)
{
    return reg == I_KR || chip->is_watchdog_unlocked || forbid(chip, RULE_WATCHDOG_LOCKED, "IWDG");
}

static bool allow_backup(chip_t *chip)
{
    return look(chip, PWR) & 1u << 8 || forbid(chip, RULE_BACKUP_LOCKED, "BKP");
}

static bool allow_write(chip_t *chip, uint32_t base, uint32_t reg, uint32_t value)
{
    switch (base) {
    case RCC:
        return reg == R_CR ? allow_clock_control(chip, value) : reg != R_CFGR || allow_clock_config(chip, value);
    case FLASH:
        return allow_flash_control(chip, value);
    case GPIOC:
        return allow_port_c(chip, reg, value);
    case SPI1:
    case SPI2:
        if (reg == S_DR)
            return allow_spi_data(chip, base == SPI1 ? CARD : IMU);
        return reg != S_CR1 || allow_spi_control(chip, base == SPI1 ? CARD : IMU, value);
    case DMA1:
        return allow_channel(chip, reg, value);
    case USART1:
    case USART2:
        return reg != U_CR1 || allow_usart_on(chip, base, value);
    case IWDG:
        return allow_watchdog(chip, reg);
    case BKP:
        return allow_backup(chip);
    default:
        return true;
    }
}

bool rules_allow(chip_t *chip, uint32_t offset, unsigned size, bool is_write, uint32_t value)
{
    const block_t *block = find_block(offset);
    const uint32_t reg = offset & 0x3FF, bits = block ? bits_of(block, reg) : 0;
    if (!bits)
        return forbid(chip, RULE_NOTHING_THERE, block ? block->name : "peripherals");
    if (size == 1 || offset % size || (size == 2 && !block->has_half_words))
        return forbid(chip, RULE_WIDTH, block->name);
    if (!has_clock(chip, block))
        return forbid(chip, RULE_NO_CLOCK, block->name);
    const bool is_cleared_by_zero = block->base == TIM2 && reg == T_SR; /* ones leave what they are written to */
    if (is_write && value & ~bits && !is_cleared_by_zero)
        return forbid(chip, RULE_RESERVED_BITS, block->name);
    return !is_write || allow_write(chip, block->base, reg, value);
}
