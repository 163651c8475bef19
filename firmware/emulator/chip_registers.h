/* Where the registers of the parts that chip.c has lie, as offsets from the start of the peripherals. Source: ST RM0008. */
#ifndef EMULATOR_CHIP_REGISTERS_H
#define EMULATOR_CHIP_REGISTERS_H

#include "chip.h"

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
    RCC = 0x21000,
    FLASH = 0x22000
};
/* registers of a timer, an SPI, a USART, a DMA channel, a port, the clocks */
enum {
    T_CR1 = 0x00,
    T_DIER = 0x0C,
    T_SR = 0x10,
    T_EGR = 0x14,
    T_CCMR1 = 0x18,
    T_CCER = 0x20,
    T_CNT = 0x24,
    T_PSC = 0x28,
    T_ARR = 0x2C,
    T_CCR1 = 0x34,
    T_CCR2 = 0x38
};
enum { S_CR1 = 0x00, S_CR2 = 0x04, S_SR = 0x08, S_DR = 0x0C };
enum { U_SR = 0x00, U_DR = 0x04, U_BRR = 0x08, U_CR1 = 0x0C, U_CR2 = 0x10, U_CR3 = 0x14 };
enum { D_ISR = 0x00, D_IFCR = 0x04, D_CCR = 0x00, D_CNDTR = 0x04, D_CPAR = 0x08, D_CMAR = 0x0C };
enum { G_CRL = 0x00, G_CRH = 0x04, G_IDR = 0x08, G_ODR = 0x0C, G_BSRR = 0x10, G_BRR = 0x14 };
enum { E_IMR = 0x00, E_RTSR = 0x08, E_PR = 0x14 };
enum { R_CR = 0x00, R_CFGR = 0x04, R_AHBENR = 0x14, R_APB2ENR = 0x18, R_APB1ENR = 0x1C, R_CSR = 0x24 };
enum { I_KR = 0x00, I_PR = 0x04, I_RLR = 0x08 };
enum { A_MAPR = 0x04, A_EXTICR1 = 0x08 };

enum { UIF = 1, CC1IF = 2 };
enum { TXE = 0x80, RXNE_U = 0x20, IDLE = 0x10, ORE = 0x08, TC = 0x40, U_ON = 0x2000, U_TRANSMITS = 0x08, U_RECEIVES = 0x04 };
enum {
    CCR_EN = 1,
    CCR_TCIE = 2,
    CCR_HTIE = 4,
    CCR_TEIE = 8,
    CCR_DIR = 0x10,
    CCR_CIRC = 0x20,
    CCR_PINC = 0x40,
    CCR_MINC = 0x80,
    CCR_SIZES = 0xF00,
    CCR_MEM2MEM = 0x4000
};
enum {
    SPI_RX_DMA = 1,
    SPI_TX_DMA = 2,
    SPI_CPHA = 0x01,
    SPI_CPOL = 0x02,
    SPI_MASTER = 0x04,
    SPI_BR = 0x38,
    SPI_ON = 0x40,
    SPI_LSB_FIRST = 0x80,
    SPI_SSI = 0x100,
    SPI_SSM = 0x200,
    SPI_ODD_FORMATS = 0xFC80 /* LSBFIRST, RXONLY, DFF, CRCNEXT, CRCEN, BIDIOE, BIDIMODE */
};
enum { HSE_ON = 1 << 16, HSE_READY = 1 << 17, PLL_ON = 1 << 24, PLL_READY = 1 << 25, PLL_BITS = 0x3F << 16 };

enum { CARD, IMU, GPS_IN = 6, GPS_OUT = 7 };

/* Both SPIs: where, on which bus, which DMA channels. */
typedef struct {
    uint32_t base;
    bool is_on_apb1;
    unsigned receive, transmit;
} spi_place_t;
extern const spi_place_t spis[SPIS];

static inline uint32_t *at(chip_t *chip, uint32_t offset)
{
    return &chip->registers[offset / 4];
}

static inline uint32_t look(const chip_t *chip, uint32_t offset)
{
    return chip->registers[offset / 4];
}

static inline uint32_t channel_at(unsigned channel)
{
    return DMA1 + 8 + 20 * (channel - 1);
}

#endif
