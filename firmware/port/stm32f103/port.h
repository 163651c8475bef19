/* The parts of this port, one file each; board.c puts them together. Priorities and pins are in DESIGN.md. */
#ifndef PORT_PORT_H
#define PORT_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "stm32f103.h"

enum {
    PRIORITY_SAMPLING = 1, /* timer, IMU pin, IMU DMA: one level, so that they never run within each other */
    PRIORITY_GPS = 2,
    PRIORITY_CARD = 3,
    PRIORITY_SERIAL = 5,
};

/* clock.c: 72 MHz from the crystal, or 64 MHz from the internal oscillator when that does not start. */
typedef struct {
    uint32_t core_hz; /* also APB2 and the timers */
    uint32_t apb1_hz;
    bool has_crystal;
} clocks_t;
clocks_t clock_init(void);

/* time.c: microseconds since start, and the polling tick, which hangs on the same timer. */
void time_init(uint32_t timer_hz);
uint64_t time_us(void);
void time_set_tick(void (*on_tick)(uint64_t time_us));
void time_wait_us(uint32_t duration_us); /* asleep; some microseconds longer */

/* spi.c: both buses, polled and by DMA. */
typedef struct {
    spi_t *registers;
    dma_channel_t *receive, *transmit;
    uint32_t flags; /* of both channels in DMA1->ISR */
    uint32_t done;  /* transfer complete of the receiving one */
    uint32_t failed;
    uint32_t mode;  /* CPOL, CPHA */
} spi_port_t;
extern const spi_port_t spi_card, spi_imu;
void spi_init(const spi_port_t *spi, unsigned divider_power); /* clock / 2^(divider_power + 1) */
int spi_exchange(const spi_port_t *spi, const uint8_t *out, uint8_t *in, size_t length);
void spi_start(const spi_port_t *spi, const uint8_t *out, uint8_t *in, size_t length, bool has_interrupt);
int spi_is_done(const spi_port_t *spi); /* 1, 0 or negative; stops the channels when it is over */
void spi_stop(const spi_port_t *spi);

/* card.c, imu.c, gps.c, uart.c: fill in the board's structs, but for the waiting. */
void card_init(board_t *board);
void imu_init(board_t *board);
void gps_init(board_t *board, uint32_t apb1_hz);
void uart_init(board_t *board, uint32_t apb2_hz);

/* board.c: everything. Never fails: what does not work says so when it is used. */
const board_t *board_init(void);

/* Backup registers, which keep their content over every reset but that of the supply: BKP->DR[n]. */
enum { BACKUP_BOOTS = 0, BACKUP_MARK = 1, BACKUP_IS_FAULT = 2, BACKUP_FAULT = 3 /* six: PC, LR, CFSR */ };

/* startup.c writes this over the stack; what is still there was never used. */
#define STACK_PAINT 0xC0FFEE11u

#endif
