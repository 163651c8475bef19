/* Vector table, and what happens before main(): .data is copied, .bss cleared, the free stack painted. */
#include "stm32f103.h"

extern uint32_t _stack_bottom[], _stack_top[], _data_start[], _data_end[], _bss_start[], _bss_end[];
extern const uint32_t _data_load[];

int main(void);
void Reset_Handler(void);
void Fault_Handler(void);

/* Written over the stack at reset; what is still there at the end was never used (board_stack_free). */
#define STACK_PAINT 0xC0FFEE11u

void Reset_Handler(void)
{
    uint32_t *here = (uint32_t *)__builtin_frame_address(0) - 16; /* leave this function's own frame alone */
    for (uint32_t *word = _stack_bottom; word < here; word++)
        *word = STACK_PAINT;
    const uint32_t *from = _data_load;
    for (uint32_t *to = _data_start; to < _data_end; to++)
        *to = *from++;
    for (uint32_t *to = _bss_start; to < _bss_end; to++)
        *to = 0;
    (void)main();
    SCB_AIRCR = SCB_AIRCR_SYSRESET;
    for (;;) {
    }
}

/* A fault or an interrupt nobody asked for: start again. The recording is on the card up to the last whole block. */
void Fault_Handler(void)
{
    SCB_AIRCR = SCB_AIRCR_SYSRESET;
    for (;;) {
    }
}

#define WEAK __attribute__((weak, alias("Fault_Handler")))
void PVD_IRQHandler(void) WEAK;
void EXTI0_IRQHandler(void) WEAK;
void DMA1_Channel2_IRQHandler(void) WEAK;
void DMA1_Channel4_IRQHandler(void) WEAK;
void DMA1_Channel6_IRQHandler(void) WEAK;
void TIM2_IRQHandler(void) WEAK;
void USART1_IRQHandler(void) WEAK;
void USART2_IRQHandler(void) WEAK;

typedef union {
    void (*handler)(void);
    const void *stack;
} vector_t;

__attribute__((section(".vectors"), used)) static const vector_t vectors[16 + IRQ_COUNT] = {
    [0] = {.stack = _stack_top},
    [1] = {.handler = Reset_Handler},
    [2 ... 15 + IRQ_COUNT] = {.handler = Fault_Handler},
};
