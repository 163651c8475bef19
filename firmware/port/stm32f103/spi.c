#include "port.h"

enum {
    EXCHANGE_TRIES = 20000, /* a byte at the slowest clock takes 2,000 core cycles */
    ANY_BYTE = 0xFF
};

const spi_port_t spi_card = {
    .registers = SPI1,
    .receive = &DMA1->channel[DMA_SPI1_RX - 1],
    .transmit = &DMA1->channel[DMA_SPI1_TX - 1],
    .flags = DMA_FLAGS(DMA_SPI1_RX) | DMA_FLAGS(DMA_SPI1_TX),
    .done = DMA_TC(DMA_SPI1_RX),
    .failed = DMA_TE(DMA_SPI1_RX) | DMA_TE(DMA_SPI1_TX),
    .mode = 0, /* SD: mode 0 */
};

const spi_port_t spi_imu = {
    .registers = SPI2,
    .receive = &DMA1->channel[DMA_SPI2_RX - 1],
    .transmit = &DMA1->channel[DMA_SPI2_TX - 1],
    .flags = DMA_FLAGS(DMA_SPI2_RX) | DMA_FLAGS(DMA_SPI2_TX),
    .done = DMA_TC(DMA_SPI2_RX),
    .failed = DMA_TE(DMA_SPI2_RX) | DMA_TE(DMA_SPI2_TX),
    .mode = SPI_CR1_CPOL | SPI_CR1_CPHA, /* the MPU9250 takes 0 and 3 */
};

void spi_init(const spi_port_t *spi, unsigned divider_power)
{
    spi->registers->CR1 = 0;
    spi->registers->CR2 = 0;
    spi->registers->CR1 = SPI_CR1_MSTR | SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_BR(divider_power) | spi->mode;
    spi->registers->CR1 |= SPI_CR1_SPE;
}

static int wait_for(const spi_port_t *spi, uint32_t mask, uint32_t value)
{
    for (int i = 0; i < EXCHANGE_TRIES; i++)
        if ((spi->registers->SR & mask) == value)
            return 0;
    return -1;
}

int spi_exchange(const spi_port_t *spi, const uint8_t *out, uint8_t *in, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        if (wait_for(spi, SPI_SR_TXE, SPI_SR_TXE) < 0)
            return -1;
        spi->registers->DR = out ? out[i] : ANY_BYTE;
        if (wait_for(spi, SPI_SR_RXNE, SPI_SR_RXNE) < 0)
            return -1;
        const uint8_t byte = (uint8_t)spi->registers->DR;
        if (in)
            in[i] = byte;
    }
    return 0;
}

void spi_stop(const spi_port_t *spi)
{
    spi->registers->CR2 = 0;
    spi->receive->CCR = 0;
    spi->transmit->CCR = 0;
    DMA1->IFCR = spi->flags;
}

/* The receiving channel is the more urgent one: a byte not fetched in time would be lost. */
void spi_start(const spi_port_t *spi, const uint8_t *out, uint8_t *in, size_t length, bool has_interrupt)
{
    static const uint8_t any_byte = ANY_BYTE;
    static uint8_t dropped;
    spi_stop(spi);
    spi->receive->CNDTR = length;
    spi->receive->CPAR = (uint32_t)&spi->registers->DR;
    spi->receive->CMAR = (uint32_t)(in ? in : &dropped);
    spi->receive->CCR = DMA_CCR_EN | DMA_CCR_PRIORITY(3) | (in ? DMA_CCR_MINC : 0) |
                        (has_interrupt ? DMA_CCR_TCIE | DMA_CCR_TEIE : 0);
    spi->transmit->CNDTR = length;
    spi->transmit->CPAR = (uint32_t)&spi->registers->DR;
    spi->transmit->CMAR = (uint32_t)(out ? out : &any_byte);
    spi->transmit->CCR =
        DMA_CCR_EN | DMA_CCR_DIR_FROM_MEMORY | DMA_CCR_PRIORITY(2) | (out ? DMA_CCR_MINC : 0);
    spi->registers->CR2 = SPI_CR2_RXDMAEN | SPI_CR2_TXDMAEN;
}

int spi_is_done(const spi_port_t *spi)
{
    const uint32_t flags = DMA1->ISR;
    if (flags & spi->failed) {
        spi_stop(spi);
        return -1;
    }
    if (!(flags & spi->done))
        return 0;
    spi_stop(spi);
    return 1;
}
