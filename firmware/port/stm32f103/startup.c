/* Vector table, and what happens before main(): .data is copied, .bss cleared, the free stack painted. */
#include "port.h"

extern uint32_t _stack_bottom[], _stack_top[], _data_start[], _data_end[], _bss_start[], _bss_end[];
extern const uint32_t _data_load[];

int main(void);
void Reset_Handler(void);
void Fault_Handler(void);
void EXTI0_IRQHandler(void);
void DMA1_Channel2_IRQHandler(void);
void DMA1_Channel4_IRQHandler(void);
void DMA1_Channel6_IRQHandler(void);
void TIM2_IRQHandler(void);
void USART1_IRQHandler(void);
void USART2_IRQHandler(void);

typedef union {
    void (*handler)(void);
    const void *stack;
} vector_t;

enum { FRAME_LR = 5, FRAME_PC = 6, FRAME_WORDS = 8 }; /* of an exception's frame, PM0056 2.3.7 */
enum { AT = 16 }; /* the core's own exceptions come first */
#define UNUSED {.handler = Fault_Handler}

__attribute__((section(".vectors"), used)) static const vector_t vectors[AT + IRQ_COUNT] = {
    [0] = {.stack = _stack_top},
    [1] = {.handler = Reset_Handler},
    [2 ... AT + IRQ_EXTI0 - 1] = UNUSED,
    [AT + IRQ_EXTI0] = {.handler = EXTI0_IRQHandler},
    [AT + IRQ_EXTI0 + 1 ... AT + IRQ_DMA1_CHANNEL2 - 1] = UNUSED,
    [AT + IRQ_DMA1_CHANNEL2] = {.handler = DMA1_Channel2_IRQHandler},
    [AT + IRQ_DMA1_CHANNEL2 + 1] = UNUSED,
    [AT + IRQ_DMA1_CHANNEL4] = {.handler = DMA1_Channel4_IRQHandler},
    [AT + IRQ_DMA1_CHANNEL4 + 1] = UNUSED,
    [AT + IRQ_DMA1_CHANNEL6] = {.handler = DMA1_Channel6_IRQHandler},
    [AT + IRQ_DMA1_CHANNEL6 + 1 ... AT + IRQ_TIM2 - 1] = UNUSED,
    [AT + IRQ_TIM2] = {.handler = TIM2_IRQHandler},
    [AT + IRQ_TIM2 + 1 ... AT + IRQ_USART1 - 1] = UNUSED,
    [AT + IRQ_USART1] = {.handler = USART1_IRQHandler},
    [AT + IRQ_USART2] = {.handler = USART2_IRQHandler},
    [AT + IRQ_USART2 + 1 ... AT + IRQ_COUNT - 1] = UNUSED,
};

void Reset_Handler(void)
{
    SCB_VTOR = (uint32_t)vectors; /* BOOT0 says what lies at 0: after a serial loader's "go" that is the loader */
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

/* What the next start tells of a fault: where it was, where that was called from, and why. Backup registers have 16 bits. */
static void remember_fault(const uint32_t *frame)
{
    const bool is_frame = frame >= _stack_bottom && frame + FRAME_WORDS <= _stack_top; /* else the stack is what failed */
    const uint32_t words[] = {is_frame ? frame[FRAME_PC] : 0, is_frame ? frame[FRAME_LR] : 0, SCB_CFSR};
    for (unsigned i = 0; i < sizeof words / sizeof *words; i++) {
        BKP->DR[BACKUP_FAULT + 2 * i] = words[i] & 0xFFFF;
        BKP->DR[BACKUP_FAULT + 2 * i + 1] = words[i] >> 16;
    }
    BKP->DR[BACKUP_IS_FAULT] = 1;
}

/* A fault or an interrupt nobody asked for: start again. The recording is on the card up to the last whole block. */
void take_fault(const uint32_t *frame);
void take_fault(const uint32_t *frame)
{
    remember_fault(frame);
    SCB_AIRCR = SCB_AIRCR_SYSRESET;
    for (;;) {
    }
}

/* The frame lies where the stack pointer is at entry: nothing may be pushed before that is read. */
__attribute__((naked)) void Fault_Handler(void)
{
    __asm volatile("mrs r0, msp\n\tb take_fault");
}
