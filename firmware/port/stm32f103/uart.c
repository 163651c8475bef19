/* Stream, text and the command: USART1, TX on PA9, RX on PA10. Its DMA channel serves SPI2 already, so bytes go out by interrupt, the last in
 * priority. */
#include "port.h"

static serial_t serial;
static uint32_t bus_hz;

static void kick(void *context)
{
    (void)context;
    USART1->CR1 |= USART_CR1_TXEIE;
}

void USART1_IRQHandler(void);
void USART1_IRQHandler(void)
{
    const uint32_t status = USART1->SR;
    if (status & USART_SR_RXNE) /* reading SR, then DR clears an overrun too */
        serial_hear(&serial, (uint8_t)USART1->DR);
    if (!(status & USART_SR_TXE))
        return;
    const int byte = serial_take(&serial);
    if (byte < 0)
        USART1->CR1 &= ~USART_CR1_TXEIE;
    else
        USART1->DR = (uint32_t)byte;
}

static void set_baud(void *context, uint32_t baud)
{
    (void)context;
    USART1->BRR = (bus_hz + baud / 2) / baud;
}

void uart_init(board_t *board, uint32_t apb2_hz)
{
    bus_hz = apb2_hz;
    RCC->APB2ENR |= RCC_APB2ENR_USART1EN;
    gpio_configure(GPIOA, 9, GPIO_ALTERNATE_50MHZ);
    GPIOA->BSRR = 1u << 10;
    gpio_configure(GPIOA, 10, GPIO_PULLED); /* up: without an adapter the line is idle */
    set_baud(0, 115200);
    USART1->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    nvic_enable(IRQ_USART1, PRIORITY_SERIAL);
    serial.kick = kick;
    board->serial = &serial;
    board->set_serial_baud = set_baud;
}
