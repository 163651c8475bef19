#include "board.h"

#include <stdbool.h>
#include <stddef.h>

typedef volatile uint32_t reg_t;
#define REG(address) (*(reg_t *)(address))
#define SSI0(offset) REG(0x40008000u + (offset))
#define UART0_DR REG(0x4000C000u)
#define PORT_D(offset) REG(0x40007000u + (offset))
#define RCGC1 REG(0x400FE104u)
#define RCGC2 REG(0x400FE108u)
#define SYST_CSR REG(0xE000E010u)
#define SYST_RVR REG(0xE000E014u)
#define SYST_CVR REG(0xE000E018u)

enum {
    SSI_CR0 = 0x00,
    SSI_CR1 = 0x04,
    SSI_DR = 0x08,
    SSI_SR = 0x0C,
    SSI_CPSR = 0x10,
    CR0_8_BITS = 7,
    CR1_ON = 2,
    SR_RECEIVED = 4,
    GPIO_DIR = 0x400,
    GPIO_DEN = 0x51C,
    PIN_0 = 1,
    PIN_0_DATA = PIN_0 << 2, /* the address says which pins a write changes */
    SYST_ON = 5,
    SYST_LONGEST = 0xFFFFFF,
    CYCLES_PER_US = 12, /* after reset; the time-outs need no better */
    SEMIHOST_EXIT = 0x18,
    EXIT_FINE = 0x20026,
    EXIT_BAD = 0x20023
};

static uint64_t cycles;
static uint32_t last_count = SYST_LONGEST;

static uint64_t now_us(void *context)
{
    (void)context;
    const uint32_t count = SYST_CVR;
    cycles += (last_count - count) & SYST_LONGEST;
    last_count = count;
    return cycles / CYCLES_PER_US;
}

static void select_card(void *context, bool is_selected)
{
    (void)context;
    PORT_D(PIN_0_DATA) = is_selected ? 0 : PIN_0;
}

static void set_speed(void *context, sd_speed_t speed)
{
    (void)context;
    SSI0(SSI_CPSR) = speed == SD_START_UP ? 32 : 2u << speed;
}

static int exchange(void *context, const uint8_t *out, uint8_t *in, size_t length)
{
    (void)context;
    for (size_t i = 0; i < length; i++) {
        SSI0(SSI_DR) = out ? out[i] : 0xFF;
        while (!(SSI0(SSI_SR) & SR_RECEIVED)) {
        }
        const uint8_t byte = (uint8_t)SSI0(SSI_DR);
        if (in)
            in[i] = byte;
    }
    return 0;
}

static int is_done(void *context)
{
    (void)context;
    return 1;
}

static void wait(void *context)
{
    (void)context;
}

const sd_bus_t *board_init(void)
{
    static const sd_bus_t bus = {.select = select_card,
                                 .set_speed = set_speed,
                                 .exchange = exchange,
                                 .start = exchange,
                                 .is_done = is_done,
                                 .now_us = now_us,
                                 .wait = wait};
    RCGC1 |= 1u << 4;
    RCGC2 |= 1u << 3;
    PORT_D(GPIO_DIR) |= PIN_0;
    PORT_D(GPIO_DEN) |= PIN_0;
    select_card(NULL, false);
    SSI0(SSI_CR0) = CR0_8_BITS;
    set_speed(NULL, SD_START_UP);
    SSI0(SSI_CR1) = CR1_ON;
    SYST_RVR = SYST_LONGEST;
    SYST_CVR = 0;
    SYST_CSR = SYST_ON;
    return &bus;
}

void board_print(const char *text)
{
    while (*text)
        UART0_DR = (uint8_t)*text++;
}

void board_print_number(uint32_t number)
{
    char digits[11] = {0};
    size_t at = sizeof digits - 1;
    do
        digits[--at] = (char)('0' + number % 10);
    while ((number /= 10) != 0);
    board_print(digits + at);
}

_Noreturn void board_exit(int is_bad)
{
    register uint32_t operation __asm("r0") = SEMIHOST_EXIT;
    register uint32_t reason __asm("r1") = is_bad ? EXIT_BAD : EXIT_FINE;
    for (;;)
        __asm volatile("bkpt 0xAB" : : "r"(operation), "r"(reason) : "memory");
}

/* ---- start ---- */

extern uint32_t _stack_top[], _data_start[], _data_end[], _bss_start[], _bss_end[];
extern const uint32_t _data_load[];

int main(void);
_Noreturn void Reset_Handler(void);
_Noreturn void Fault_Handler(void);

void Reset_Handler(void)
{
    const uint32_t *from = _data_load;
    for (uint32_t *to = _data_start; to < _data_end; to++)
        *to = *from++;
    for (uint32_t *to = _bss_start; to < _bss_end; to++)
        *to = 0;
    board_exit(main());
}

void Fault_Handler(void)
{
    board_print("fault\n");
    board_exit(1);
}

typedef union {
    void (*handler)(void);
    const void *stack;
} vector_t;

__attribute__((section(".vectors"), used)) static const vector_t vectors[16] = {
    [0] = {.stack = _stack_top}, [1] = {.handler = Reset_Handler}, [2 ... 15] = {.handler = Fault_Handler}};
