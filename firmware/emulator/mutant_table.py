"""The mistakes of mutants.py: what is changed in the sources, and the rule of rules.h that it breaks."""

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from altered import Edit


@dataclass(frozen=True)
class Mutant:
    """A mistake: its name, the rule that must notice it (empty: the drive itself), the edits."""

    name: str
    rule: str
    edits: tuple[Edit, ...]


def _one(name: str, rule: str, file: str, old: str, new: str) -> Mutant:
    return Mutant(name, rule, (Edit(file, old, new),))


def _port(name: str, rule: str, file: str, old: str, new: str) -> Mutant:
    return _one(name, rule, f"port/stm32f103/{file}", old, new)


def _card(name: str, rule: str, old: str, new: str) -> Mutant:
    return _one(name, rule, "drivers/sdcard.c", old, new)


CLOCKS = (
    _port("clock of GPIOA", "NO_CLOCK", "board.c", "RCC_APB2ENR_IOPAEN | ", ""),
    _port("clock of GPIOB", "NO_CLOCK", "board.c", "RCC_APB2ENR_IOPBEN | ", ""),
    _port("clock of GPIOC", "NO_CLOCK", "board.c", " | RCC_APB2ENR_IOPCEN", ""),
    _port("clock of AFIO", "NO_CLOCK", "board.c", "RCC_APB2ENR_AFIOEN | ", ""),
    _port("clock of DMA", "NO_CLOCK", "board.c", "    RCC->AHBENR |= RCC_AHBENR_DMA1EN;\n", ""),
    _port("clock of SPI1", "NO_CLOCK", "card.c", "    RCC->APB2ENR |= RCC_APB2ENR_SPI1EN;\n", ""),
    _port("clock of SPI2", "NO_CLOCK", "imu.c", "    RCC->APB1ENR |= RCC_APB1ENR_SPI2EN;\n", ""),
    _port("clock of USART1", "NO_CLOCK", "uart.c", "    RCC->APB2ENR |= RCC_APB2ENR_USART1EN;\n", ""),
    _port("clock of USART2", "NO_CLOCK", "gps.c", "    RCC->APB1ENR |= RCC_APB1ENR_USART2EN;\n", ""),
    _port("clock of TIM2", "NO_CLOCK", "time.c", "    RCC->APB1ENR |= RCC_APB1ENR_TIM2EN;\n", ""),
    _port("clock of BKP", "NO_CLOCK", "board.c", " | RCC_APB1ENR_BKPEN", ""),
    _port("clock of PWR", "NO_CLOCK", "board.c", "RCC_APB1ENR_PWREN | ", ""),
    _port(
        "PLL before the crystal runs",
        "SOURCE_NOT_READY",
        "clock.c",
        "has_crystal = wait_for(&RCC->CR, RCC_CR_HSERDY, RCC_CR_HSERDY)",
        "has_crystal = true",
    ),
    _port(
        "PLL set up while it is on",
        "PLL_CHANGED",
        "clock.c",
        "    RCC->CFGR = RCC_CFGR_PPRE1_DIV2",
        "    RCC->CR |= RCC_CR_PLLON;\n    RCC->CFGR = RCC_CFGR_PPRE1_DIV2",
    ),
    _port(
        "PLL taken before it has locked",
        "CLOCK_NOT_READY",
        "clock.c",
        "!wait_for(&RCC->CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY)",
        "false",
    ),
    _port("PLL x 16", "PLL_TOO_FAST", "clock.c", "RCC_CFGR_PLLMUL(9u)", "RCC_CFGR_PLLMUL(16u)"),
    _port("PLL x 8, taken for 9", "", "clock.c", "RCC_CFGR_PLLMUL(9u)", "RCC_CFGR_PLLMUL(8u)"),
    _port("APB1 as fast as the core", "APB1_TOO_FAST", "clock.c", "RCC->CFGR = RCC_CFGR_PPRE1_DIV2 |", "RCC->CFGR ="),
    _port(
        "no wait states of the flash",
        "FLASH_TOO_FAST",
        "clock.c",
        "FLASH_ACR_PRFTBE | FLASH_ACR_LATENCY_2",
        "FLASH_ACR_PRFTBE",
    ),
    _port(
        "one wait state of the flash",
        "FLASH_TOO_FAST",
        "stm32f103.h",
        "FLASH_ACR_LATENCY_2 (2u",
        "FLASH_ACR_LATENCY_2 (1u",
    ),
    Mutant(
        "prefetch switched on at full speed",
        "PREFETCH",
        (
            Edit("port/stm32f103/clock.c", "FLASH_ACR_PRFTBE | FLASH_ACR_LATENCY_2", "FLASH_ACR_LATENCY_2"),
            Edit(
                "port/stm32f103/clock.c",
                "    const uint32_t core_hz",
                "    FLASH_ACR |= FLASH_ACR_PRFTBE;\n    const uint32_t core_hz",
            ),
        ),
    ),
    _port("SRAM off in sleep", "SLEEPING_MEMORY", "board.c", "RCC->AHBENR |= RCC_AHBENR", "RCC->AHBENR = RCC_AHBENR"),
)

CORE = (
    _port("VTOR left at 0", "VECTORS_AT_ZERO", "startup.c", "    SCB_VTOR = (uint32_t)vectors;", "    (void)vectors;"),
    _port("VTOR beside the table", "VECTOR_TABLE", "startup.c", "(uint32_t)vectors", "(uint32_t)&vectors[1]"),
    _port(
        "an interrupt's vector forgotten",
        "VECTOR",
        "startup.c",
        "    [AT + IRQ_TIM2] = {.handler = TIM2_IRQHandler},\n",
        "",
    ),
    _port("stack top not on 8", "STACK", "stm32f103c8.ld", "_stack_top = .;", "_stack_top = . - 4;"),
    _port("stack of 512 bytes", "STACK", "stm32f103c8.ld", "_stack_size : 2152", "_stack_size : 512"),
    _port("priorities in the lower bits", "PRIORITY", "stm32f103.h", "(priority << 4)", "priority"),
    _port(
        ".data copied backwards",
        "FLASH_WRITTEN",
        "startup.c",
        "    (void)main();",
        "    *(volatile uint32_t *)(uint32_t)_data_load = 0;\n    (void)main();",
    ),
    _port(
        "SPI2 where SPI3 would be",
        "NOTHING_THERE",
        "stm32f103.h",
        "SPI2 ((spi_t *)0x40003800u)",
        "SPI2 ((spi_t *)0x40003C00u)",
    ),
    _port(
        "a port written by half words",
        "WIDTH",
        "board.c",
        "    else\n        GPIOC->BSRR = 1u << LED_PIN;",
        "    else\n        *(volatile uint16_t *)&GPIOC->BSRR = 1u << LED_PIN;",
    ),
    _port(
        "bits of the voltage detector shifted",
        "RESERVED_BITS",
        "stm32f103.h",
        "PWR_CR_PLS_2V9 (7u << 5)",
        "PWR_CR_PLS_2V9 (7u << 8)",
    ),
    _port("backup domain locked", "BACKUP_LOCKED", "board.c", "PWR_CR_DBP | ", ""),
    _port("watchdog never unlocked", "WATCHDOG_LOCKED", "board.c", "    IWDG->KR = IWDG_KR_UNLOCK;\n", ""),
    _port(
        "watchdog fed before it is set up",
        "WATCHDOG_LOCKED",
        "board.c",
        "    IWDG->PR = IWDG_PR_DIV64;",
        "    IWDG->KR = IWDG_KR_FEED;\n    IWDG->PR = IWDG_PR_DIV64;",
    ),
    _port("watchdog never started", "", "board.c", "    watchdog_init();\n    if", "    (void)watchdog_init;\n    if"),
    _port(
        "watchdog never fed",
        "",
        "board.c",
        "{\n    (void)context;\n    IWDG->KR = IWDG_KR_FEED;",
        "{\n    (void)context;",
    ),
    _port("DMA interrupt of the IMU off", "", "imu.c", "    nvic_enable(IRQ_DMA1_CHANNEL4, PRIORITY_SAMPLING);\n", ""),
    _port("DMA interrupt of the card off", "", "card.c", "    nvic_enable(IRQ_DMA1_CHANNEL2, PRIORITY_CARD);\n", ""),
)

PINS = (
    _port(
        "SCK of the card a plain output", "PIN_FUNCTION", "card.c", "5, GPIO_ALTERNATE_50MHZ", "5, GPIO_OUTPUT_50MHZ"
    ),
    _port("MISO of the card an output", "PIN_FUNCTION", "card.c", "6, GPIO_PULLED", "6, GPIO_ALTERNATE_50MHZ"),
    _port(
        "MOSI of the card never configured",
        "PIN_FUNCTION",
        "card.c",
        "    gpio_configure(GPIOA, 7, GPIO_ALTERNATE_50MHZ);\n",
        "",
    ),
    _port(
        "CS of the card never configured",
        "PIN_FUNCTION",
        "card.c",
        "    gpio_configure(GPIOA, SELECT_PIN, GPIO_OUTPUT_50MHZ);\n",
        "",
    ),
    _port(
        "CS of the IMU an alternate output",
        "PIN_FUNCTION",
        "imu.c",
        "SELECT_PIN, GPIO_OUTPUT_50MHZ",
        "SELECT_PIN, GPIO_ALTERNATE_50MHZ",
    ),
    _port(
        "SCK of the IMU never configured",
        "PIN_FUNCTION",
        "imu.c",
        "    gpio_configure(GPIOB, 13, GPIO_ALTERNATE_50MHZ);\n",
        "",
    ),
    _port("MISO and MOSI of the IMU swapped", "PIN_FUNCTION", "imu.c", "14, GPIO_FLOATING", "14, GPIO_ALTERNATE_50MHZ"),
    _port(
        "TX of the receiver never configured",
        "PIN_FUNCTION",
        "gps.c",
        "    gpio_configure(GPIOA, 2, GPIO_ALTERNATE_2MHZ);\n",
        "",
    ),
    _port(
        "TX of the stream a plain output", "PIN_FUNCTION", "uart.c", "9, GPIO_ALTERNATE_50MHZ", "9, GPIO_OUTPUT_50MHZ"
    ),
    _port(
        "LED never configured", "PIN_FUNCTION", "board.c", "    gpio_configure(GPIOC, LED_PIN, GPIO_OUTPUT_2MHZ);\n", ""
    ),
    _port("SCK of the card at 2 MHz", "PIN_TOO_SLOW", "card.c", "5, GPIO_ALTERNATE_50MHZ", "5, GPIO_ALTERNATE_2MHZ"),
    _port("LED at 50 MHz", "PIN_PC13", "board.c", "LED_PIN, GPIO_OUTPUT_2MHZ", "LED_PIN, GPIO_OUTPUT_50MHZ"),
    _port("button floating", "PIN_FLOATING", "board.c", "BUTTON_PIN, GPIO_PULLED", "BUTTON_PIN, GPIO_FLOATING"),
    _port("button pulled down", "PIN_FLOATING", "board.c", "    GPIOA->BSRR = 1u << BUTTON_PIN;\n", ""),
    _port("interrupt pin floating", "PIN_FLOATING", "imu.c", "0, GPIO_PULLED", "0, GPIO_FLOATING"),
    _port("RX of the receiver floating", "PIN_FLOATING", "gps.c", "3, GPIO_PULLED", "3, GPIO_FLOATING"),
    _port(
        "interrupt's port written to MAPR",
        "PIN_REMAPPED",
        "imu.c",
        "    AFIO->EXTICR[0] = (AFIO->EXTICR[0] & ~AFIO_EXTICR1_EXTI0_MASK) |",
        "    AFIO->MAPR =",
    ),
    _port("interrupt on PA0", "", "imu.c", " | AFIO_EXTICR1_EXTI0_PB;", ";"),
    _port("interrupt without an edge", "", "imu.c", "    EXTI->RTSR |= EXTI_LINE0;\n", ""),
)

BUSES = (
    _port("SPI not master", "SPI_NOT_MASTER", "spi.c", "SPI_CR1_MSTR | ", ""),
    _port("SPI without SSI", "SPI_MODE_FAULT", "spi.c", "SPI_CR1_SSI | ", ""),
    _port("SPI with NSS by hardware", "SPI_MODE_FAULT", "spi.c", "SPI_CR1_SSM | ", ""),
    _port("SPI never on", "SPI_OFF", "spi.c", "    spi->registers->CR1 |= SPI_CR1_SPE;\n", ""),
    _port("SPI lowest bit first", "SPI_FORMAT", "spi.c", "SPI_CR1_SSM | ", "SPI_CR1_SSM | 1u << 7 | "),
    _port("SPI by 16 bits", "SPI_FORMAT", "spi.c", "SPI_CR1_SSM | ", "SPI_CR1_SSM | 1u << 11 | "),
    _port(
        "SPI off before the last byte is out",
        "SPI_CHANGED",
        "spi.c",
        "        if (wait_for(spi, SPI_SR_RXNE, SPI_SR_RXNE) < 0)",
        "        if (i + 1 == length) {\n            spi->registers->CR1 &= ~SPI_CR1_SPE;\n"
        "            return 0;\n        }\n"
        "        if (wait_for(spi, SPI_SR_RXNE, SPI_SR_RXNE) < 0)",
    ),
    Mutant(
        "SPI written without waiting",
        "SPI_OVERWRITTEN",
        (
            Edit(
                "port/stm32f103/spi.c",
                "        if (wait_for(spi, SPI_SR_TXE, SPI_SR_TXE) < 0)\n            return -1;\n",
                "",
            ),
            Edit(
                "port/stm32f103/spi.c",
                "        if (wait_for(spi, SPI_SR_RXNE",
                "        if (in && wait_for(spi, SPI_SR_RXNE",
            ),
        ),
    ),
    _port(
        "SPI's bytes not read while sending",
        "SPI_OVERRUN",
        "spi.c",
        "        const uint8_t byte = (uint8_t)spi->registers->DR;\n        if (in)\n            in[i] = byte;",
        "        if (in)\n            in[i] = (uint8_t)spi->registers->DR;",
    ),
    _port("card at 36 MHz", "SPI_TOO_FAST", "card.c", "[SD_FAST] = 1,", "[SD_FAST] = 0,"),
    _port("SPI mode 1 for the card", "SPI_MODE", "spi.c", ".mode = 0,", ".mode = SPI_CR1_CPHA,"),
    _port("SPI mode 2 for the IMU", "SPI_MODE", "spi.c", "SPI_CR1_CPOL | SPI_CR1_CPHA", "SPI_CR1_CPOL"),
    _port(
        "DMA channels of SPI1 swapped",
        "DMA_CHANNEL",
        "spi.c",
        "&DMA1->channel[DMA_SPI1_RX - 1]",
        "&DMA1->channel[DMA_SPI1_RX]",
    ),
    _port("DMA channel of SPI1 on USART1's", "DMA_CHANNEL", "stm32f103.h", "DMA_SPI1_TX 3u", "DMA_SPI1_TX 5u"),
    _port("DMA direction wrong", "DMA_CHANNEL", "spi.c", "DMA_CCR_EN | DMA_CCR_DIR_FROM_MEMORY | ", "DMA_CCR_EN | "),
    _port(
        "DMA from SR",
        "DMA_CHANNEL",
        "gps.c",
        "    receive->CPAR = (uint32_t)&USART2->DR;",
        "    receive->CPAR = (uint32_t)&USART2->SR;",
    ),
    _port("DMA channel not switched off", "DMA_CHANGED", "spi.c", "    spi->receive->CCR = 0;\n", ""),
    _port("DMA without an address", "DMA_ADDRESS", "gps.c", "    receive->CMAR = (uint32_t)received;\n", ""),
    _port("DMA that counts registers", "DMA_WIDTH", "stm32f103.h", "DMA_CCR_MINC (1u << 7)", "DMA_CCR_MINC (1u << 6)"),
    _port(
        "DMA of half words",
        "DMA_WIDTH",
        "spi.c",
        "DMA_CCR_EN | DMA_CCR_PRIORITY(3)",
        "DMA_CCR_EN | 1u << 10 | DMA_CCR_PRIORITY(3)",
    ),
    _port("DMA of the receiver not circular", "", "gps.c", "DMA_CCR_CIRC | ", ""),
    _port("stream without TE", "USART_OFF", "uart.c", "USART_CR1_UE | USART_CR1_TE", "USART_CR1_UE"),
    _port("receiver without TE", "USART_OFF", "gps.c", "USART_CR1_UE | USART_CR1_TE | ", "USART_CR1_UE | "),
    _port(
        "nine bits", "USART_FORMAT", "gps.c", "USART_CR1_UE | USART_CR1_TE", "USART_CR1_UE | 1u << 12 | USART_CR1_TE"
    ),
    _port(
        "stream at the other bus's clock",
        "USART_RATE",
        "board.c",
        "uart_init(&board, clocks.core_hz)",
        "uart_init(&board, clocks.apb1_hz)",
    ),
    _port(
        "receiver at the other bus's clock",
        "",
        "board.c",
        "gps_init(&board, clocks.apb1_hz)",
        "gps_init(&board, clocks.core_hz)",
    ),
    _port("receiver without its DMA request", "", "gps.c", "USART_CR3_DMAR | USART_CR3_DMAT", "USART_CR3_DMAT"),
    _port(
        "two bytes at once",
        "USART_OVERWRITTEN",
        "uart.c",
        "    else\n        USART1->DR = (uint32_t)byte;",
        "    else {\n        USART1->DR = (uint32_t)byte;\n"
        "        USART1->DR = (uint32_t)serial_take(&serial) & 255;\n    }",
    ),
    _port("timer counts 73 for a microsecond", "", "time.c", "timer_hz / 1000000 - 1", "timer_hz / 1000000"),
)

DEVICES = (
    _card("card not woken", "CARD_ASLEEP", "clocks < 80", "clocks < 16"),
    _port("card started at 1.1 MHz", "CARD_TOO_FAST", "card.c", "[SD_START_UP] = 7", "[SD_START_UP] = 5"),
    _card(
        "card not waited for",
        "CARD_BUSY",
        "    if (byte != READY)\n        return busy_us",
        "    if (byte != READY && busy_us > SD_BUSY_LONGEST_US)\n        return busy_us",
    ),
    _card(
        "ACMD41 once",
        "CARD_ORDER",
        "        if (result == SD_OK && r1 == 0)\n            return SD_OK;",
        "        if (result == SD_OK && r1 <= R1_IDLE)\n            return SD_OK;",
    ),
    _card("token of a single block", "CARD_TOKEN", "TOKEN_MULTIPLE = 0xFC", "TOKEN_MULTIPLE = 0xFE"),
    _card("block without its CRC", "CARD_CHECKSUM", "card->crc = sd_crc16(card->block, SD_SECTOR);", "card->crc = 0;"),
    _card("command without its CRC", "CARD_CHECKSUM", "frame[6] = sd_crc7(frame + 1, 5);", "frame[6] = 0x95;"),
    _card(
        "CS let go within a block",
        "CARD_SELECT",
        "    card->state = SD_STREAM_SENDING;",
        "    card->bus->select(card->bus->context, false);\n    card->state = SD_STREAM_SENDING;",
    ),
    _port("IMU's registers at 1.1 MHz", "IMU_TOO_FAST", "imu.c", "SLOW = 5,", "SLOW = 4,"),
    _one(
        "magnetometer's transfer started twice",
        "IMU_SLAVE",
        "drivers/mpu9250.c",
        "    int result = write_blind(bus, REG_I2C_SLV4_CTRL, SLAVE_ENABLE);",
        "    int result = write_blind(bus, REG_I2C_SLV4_CTRL, SLAVE_ENABLE);\n"
        "    result = result == MPU9250_OK ? write_blind(bus, REG_I2C_SLV4_CTRL, SLAVE_ENABLE) : result;",
    ),
    _one(
        "magnetometer never read",
        "",
        "drivers/mpu9250.c",
        "{REG_I2C_SLV0_CTRL, SLAVE_ENABLE | AK_SHADOW_BYTES}",
        "{REG_I2C_SLV0_CTRL, AK_SHADOW_BYTES}",
    ),
)

MUTANTS = CLOCKS + CORE + PINS + BUSES + DEVICES
