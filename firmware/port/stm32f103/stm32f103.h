/* Registers of the STM32F103C8 that this port uses, and no others.
 *
 * Addresses, offsets and bits: ST RM0008 (reference manual) and DS5319 (data sheet). All of them are compared with ST's
 * SVD file and with what is made from it, by tests/firmware/test_registers.py; interrupt numbers, DMA channels and pins
 * with the machine-readable device description of `modm-devices`, by tests/firmware/test_build.py.
 */
#ifndef PORT_STM32F103_H
#define PORT_STM32F103_H

#include <stdint.h>

typedef volatile uint32_t reg_t;

/* ---- reset and clock control, RM0008 section 7 ---- */
typedef struct {
    reg_t CR, CFGR, CIR, APB2RSTR, APB1RSTR, AHBENR, APB2ENR, APB1ENR, BDCR, CSR;
} rcc_t;
#define RCC ((rcc_t *)0x40021000u)
#define RCC_CR_HSION (1u << 0)
#define RCC_CR_HSIRDY (1u << 1)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_CFGR_SW_PLL (2u << 0)
#define RCC_CFGR_SWS_MASK (3u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_PPRE1_DIV2 (4u << 8)
#define RCC_CFGR_PLLSRC_HSE (1u << 16)
#define RCC_CFGR_PLLMUL(n) (((n)-2u) << 18)
#define RCC_AHBENR_DMA1EN (1u << 0)
#define RCC_APB2ENR_AFIOEN (1u << 0)
#define RCC_APB2ENR_IOPAEN (1u << 2)
#define RCC_APB2ENR_IOPBEN (1u << 3)
#define RCC_APB2ENR_IOPCEN (1u << 4)
#define RCC_APB2ENR_SPI1EN (1u << 12)
#define RCC_APB2ENR_USART1EN (1u << 14)
#define RCC_APB1ENR_TIM2EN (1u << 0)
#define RCC_APB1ENR_SPI2EN (1u << 14)
#define RCC_APB1ENR_USART2EN (1u << 17)
#define RCC_APB1ENR_BKPEN (1u << 27)
#define RCC_APB1ENR_PWREN (1u << 28)
#define RCC_CSR_RMVF (1u << 24)

/* ---- flash interface, PM0075 section 3 ---- */
#define FLASH_ACR (*(reg_t *)0x40022000u)
#define FLASH_ACR_LATENCY_2 (2u << 0)
#define FLASH_ACR_PRFTBE (1u << 4)

/* ---- power control and backup registers, RM0008 sections 5 and 6 ---- */
typedef struct {
    reg_t CR, CSR;
} pwr_t;
#define PWR ((pwr_t *)0x40007000u)
#define PWR_CR_PVDE (1u << 4)
#define PWR_CR_PLS_2V9 (7u << 5)
#define PWR_CR_DBP (1u << 8)
#define PWR_CSR_PVDO (1u << 2)
typedef struct {
    reg_t reserved, DR[10];
} bkp_t;
#define BKP ((bkp_t *)0x40006C00u)

/* ---- ports, RM0008 section 9 ---- */
typedef struct {
    reg_t CRL, CRH, IDR, ODR, BSRR, BRR, LCKR;
} gpio_t;
#define GPIOA ((gpio_t *)0x40010800u)
#define GPIOB ((gpio_t *)0x40010C00u)
#define GPIOC ((gpio_t *)0x40011000u)
/* the four configuration bits of a pin: mode (output speed) and function */
#define GPIO_FLOATING 0x4u
#define GPIO_PULLED 0x8u       /* the ODR bit says up or down */
#define GPIO_OUTPUT_2MHZ 0x2u  /* push-pull */
#define GPIO_OUTPUT_50MHZ 0x3u /* push-pull */
#define GPIO_ALTERNATE_2MHZ 0xAu
#define GPIO_ALTERNATE_50MHZ 0xBu

typedef struct {
    reg_t EVCR, MAPR, EXTICR[4];
} afio_t;
#define AFIO ((afio_t *)0x40010000u)
#define AFIO_EXTICR1_EXTI0_PB (1u << 0)
#define AFIO_EXTICR1_EXTI0_MASK (15u << 0)

/* ---- external interrupts, RM0008 section 10 ---- */
typedef struct {
    reg_t IMR, EMR, RTSR, FTSR, SWIER, PR;
} exti_t;
#define EXTI ((exti_t *)0x40010400u)
#define EXTI_LINE0 (1u << 0)

/* ---- DMA, RM0008 section 13 ---- */
typedef struct {
    reg_t CCR, CNDTR, CPAR, CMAR, reserved;
} dma_channel_t;
typedef struct {
    reg_t ISR, IFCR;
    dma_channel_t channel[7]; /* channel n is channel[n - 1] */
} dma_t;
#define DMA1 ((dma_t *)0x40020000u)
#define DMA_CCR_EN (1u << 0)
#define DMA_CCR_TCIE (1u << 1)
#define DMA_CCR_HTIE (1u << 2)
#define DMA_CCR_TEIE (1u << 3)
#define DMA_CCR_DIR_FROM_MEMORY (1u << 4)
#define DMA_CCR_CIRC (1u << 5)
#define DMA_CCR_MINC (1u << 7)
#define DMA_CCR_PRIORITY(n) ((uint32_t)(n) << 12)
#define DMA_FLAGS(channel) (0xFu << (4u * ((channel)-1u)))
#define DMA_TC(channel) (0x2u << (4u * ((channel)-1u)))
#define DMA_TE(channel) (0x8u << (4u * ((channel)-1u)))

/* which channel serves what, RM0008 table 78 */
#define DMA_SPI1_RX 2u
#define DMA_SPI1_TX 3u
#define DMA_SPI2_RX 4u
#define DMA_SPI2_TX 5u
#define DMA_USART2_RX 6u
#define DMA_USART2_TX 7u

/* ---- SPI, RM0008 section 25 ---- */
typedef struct {
    reg_t CR1, CR2, SR, DR, CRCPR, RXCRCR, TXCRCR;
} spi_t;
#define SPI1 ((spi_t *)0x40013000u)
#define SPI2 ((spi_t *)0x40003800u)
#define SPI_CR1_CPHA (1u << 0)
#define SPI_CR1_CPOL (1u << 1)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_BR(n) ((uint32_t)(n) << 3) /* clock / 2^(n+1) */
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI_CR2_RXDMAEN (1u << 0)
#define SPI_CR2_TXDMAEN (1u << 1)
#define SPI_SR_RXNE (1u << 0)
#define SPI_SR_TXE (1u << 1)
#define SPI_SR_BSY (1u << 7)

/* ---- USART, RM0008 section 27 ---- */
typedef struct {
    reg_t SR, DR, BRR, CR1, CR2, CR3, GTPR;
} usart_t;
#define USART1 ((usart_t *)0x40013800u)
#define USART2 ((usart_t *)0x40004400u)
#define USART_SR_ERRORS (0xFu) /* parity, framing, noise, overrun */
#define USART_SR_IDLE (1u << 4)
#define USART_SR_RXNE (1u << 5)
#define USART_SR_TXE (1u << 7)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_IDLEIE (1u << 4)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_TXEIE (1u << 7)
#define USART_CR1_UE (1u << 13)
#define USART_CR3_DMAR (1u << 6)
#define USART_CR3_DMAT (1u << 7)

/* ---- general-purpose timer, RM0008 section 15 ---- */
typedef struct {
    reg_t CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, reserved, CCR[4];
} tim_t;
#define TIM2 ((tim_t *)0x40000000u)
#define TIM_CR1_CEN (1u << 0)
#define TIM_CR1_URS (1u << 2)
#define TIM_DIER_UIE (1u << 0)
#define TIM_DIER_CC1IE (1u << 1)
#define TIM_SR_UIF (1u << 0)
#define TIM_SR_CC1IF (1u << 1)
#define TIM_EGR_UG (1u << 0)

/* ---- independent watchdog, RM0008 section 19 ---- */
typedef struct {
    reg_t KR, PR, RLR, SR;
} iwdg_t;
#define IWDG ((iwdg_t *)0x40003000u)
#define IWDG_KR_START 0xCCCCu
#define IWDG_KR_UNLOCK 0x5555u
#define IWDG_KR_FEED 0xAAAAu
#define IWDG_PR_DIV64 4u

/* ---- the core: interrupt controller and system control, PM0056 section 4 ---- */
#define NVIC_ISER(n) (((reg_t *)0xE000E100u)[n])
#define NVIC_IPR(irq) (((volatile uint8_t *)0xE000E400u)[irq])
#define SCB_VTOR (*(reg_t *)0xE000ED08u)
#define SCB_AIRCR (*(reg_t *)0xE000ED0Cu)
#define SCB_CFSR (*(reg_t *)0xE000ED28u)
#define SCB_AIRCR_SYSRESET 0x05FA0004u
#define UNIQUE_ID ((const uint32_t *)0x1FFFF7E8u) /* 96 bits, RM0008 section 30.2 */

/* interrupt numbers, RM0008 table 63 */
enum {
    IRQ_EXTI0 = 6,
    IRQ_DMA1_CHANNEL2 = 12,
    IRQ_DMA1_CHANNEL4 = 14,
    IRQ_DMA1_CHANNEL6 = 16,
    IRQ_TIM2 = 28,
    IRQ_USART1 = 37,
    IRQ_USART2 = 38,
    IRQ_COUNT = 43, /* of a medium-density device */
};

/* Let interrupt `irq` through with `priority` 0 (first) to 15. */
static inline void nvic_enable(int irq, unsigned priority)
{
    NVIC_IPR(irq) = (uint8_t)(priority << 4); /* the F1 has the upper four bits only */
    NVIC_ISER(irq / 32) = 1u << (irq % 32);
}

/* Give pin `pin` of `port` its four configuration bits. */
static inline void gpio_configure(gpio_t *port, unsigned pin, uint32_t bits)
{
    reg_t *half = pin < 8 ? &port->CRL : &port->CRH;
    unsigned shift = 4 * (pin % 8);
    *half = (*half & ~(15u << shift)) | bits << shift;
}

#endif
