/* A Cortex-M3 with its interrupt controller, on libunicorn: instructions are Unicorn's, exceptions and time are ours.
 *
 * Time is counted in cycles of 72 MHz, by the table of the core's manual (ARM DDI 0337, section 18) without the waits of
 * the flash. Interrupts come between any two instructions but those of an IT block. Source: ARM DDI 0403, B1.5. */
#ifndef EMULATOR_MACHINE_H
#define EMULATOR_MACHINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <unicorn/unicorn.h>

enum {
    CYCLES_PER_US = 72,
    FLASH_BYTES = 64 * 1024,
    RAM_BYTES = 20 * 1024,
    IRQS = 64,
    DEEPEST = 16 /* levels of exceptions */
};
#define FLASH_AT 0x08000000u
#define RAM_AT 0x20000000u
#define NEVER UINT64_MAX

typedef struct machine machine_t;

/* What is around the core. `advance` lets everything happen that is due by now and returns when the next is. */
typedef struct {
    void *context;
    uint64_t (*advance)(void *context);
    uint64_t (*levels)(void *context); /* interrupt lines that are high */
    uint32_t (*read)(void *context, uint32_t address, unsigned size);
    void (*write)(void *context, uint32_t address, unsigned size, uint32_t value);
    void (*reset)(void *context); /* asked for by the core */
    void (*sleep)(void *context); /* the core goes to sleep */
} bus_t;

typedef struct {
    uint64_t entries, worst_wait; /* cycles from the line to the handler's first instruction */
} irq_stats_t;

struct machine {
    uc_engine *uc;
    bus_t bus;
    uint8_t *flash, *ram;
    uint8_t *cost; /* cycles of the instruction at each half word, 0: not looked at yet */
    uint64_t cycles, next_event;
    bool is_attention;   /* the interrupts have to be looked at before the next instruction */
    bool is_attention_after;
    unsigned in_it_block;
    bool is_waiting;     /* a WFI was met */
    bool is_returning;   /* an exception return was met */
    bool is_reset_wanted, is_over;
    bool is_stuck_wanted; /* the main loop shall not come back from where it is */
    bool is_lost_wanted;  /* the main loop shall jump to where nothing is */
    bool is_fault_delivered; /* to the image's handler, in place of ending the run */
    uint32_t fault_status;   /* CFSR */
    bool is_in_fault;
    unsigned probes;      /* so many times ask for an interrupt before each instruction, until one comes */
    char fault[160]; /* why the run ended; empty: it was let end */
    uint32_t fault_pc;
    uint32_t at; /* the instruction that is executed */
    uint32_t vectors; /* VTOR */

    uint64_t enabled, pending;
    uint8_t priority[IRQS];
    uint8_t active[DEEPEST];
    unsigned depth, deepest;
    uint64_t pending_since[IRQS];

    /* seen */
    uint64_t instructions, slept, starts;
    irq_stats_t irqs[IRQS];
    uint32_t lowest_stack;
    uint8_t *interrupted; /* at each half word of the flash: whether an interrupt came before it */
    uint8_t *probed;      /* how many times one was asked for there */
    uint64_t asked;
};

int machine_init(machine_t *machine, const uint8_t *image, size_t size);

/* Begin at the reset vector; RAM keeps what it holds. */
void machine_reset(machine_t *machine);

/* Run until is_over or a fault. */
void machine_run(machine_t *machine);

/* How many of the image's instructions were executed, and before how many of them an interrupt has come. */
void machine_count_places(const machine_t *machine, unsigned *executed, unsigned *interrupted);

/* End the run with a text: what the manual forbids, and by which part it was done. The first counts. */
void machine_forbid(machine_t *machine, const char *rule, const char *what);

/* A line may have changed, or an event come nearer. */
void machine_attend(machine_t *machine);

#endif
