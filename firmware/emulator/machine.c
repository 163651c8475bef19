#include "machine.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rules.h"

enum {
    OPCODE_WFI = 0xBF30,
    OPCODE_SELF = 0xE7FE, /* a branch to itself */
    EXCEPTION_EXIT = 8, /* Unicorn's number for a branch to EXC_RETURN */
    ENTRY_CYCLES = 12,
    CHAIN_CYCLES = 6,
    EXIT_CYCLES = 10,
    COST_MASK = 0x3F,
    COST_MASKING = 0x40, /* changes what interrupts may come: look again after it */
    COST_IT = 0x80,
    HIT = 1,
    FIRST_IRQ = 16,
    NO_IRQ = -1
};
static const uint32_t NOWHERE = 0x60000000u;
static const uint32_t SYSTEM_AT = 0xE000E000u, PERIPHERALS_AT = 0x40000000u, ID_AT = 0x1FFFF000u;
enum { SYSTEM_BYTES = 0x1000, PERIPHERAL_BYTES = 0x24000, ID_BYTES = 0x1000, ID_OFFSET = 0x7E8 };
enum { ISER = 0x100, ICER = 0x180, ISPR = 0x200, ICPR = 0x280, IPR = 0x400, VTOR = 0xD08, AIRCR = 0xD0C, CFSR = 0xD28, HFSR = 0xD2C, SYSTEM_RESET = 4 };
enum { HARD_FAULT = 3, PRECISE_BUS_FAULT = 0x8200 };
enum { TABLE_BYTES = 512, FIRST_WORDS = 2 };

/* ---- what an instruction costs ---- */

static unsigned bits_set(uint32_t value)
{
    return (unsigned)__builtin_popcount(value);
}

static unsigned cost_of_short(uint16_t op)
{
    if (op >= 0x4700 && op < 0x4800)
        return 3; /* BX, BLX */
    if ((op & 0xF800) == 0x4800 || (op >= 0x5000 && op < 0xA000))
        return 2; /* one load or store */
    if ((op & 0xFE00) == 0xB400)
        return 1 + bits_set(op & 0x1FF); /* PUSH */
    if ((op & 0xFE00) == 0xBC00)
        return 1 + bits_set(op & 0x1FF) + (op & 0x100 ? 3 : 0); /* POP */
    if ((op & 0xF000) == 0xC000)
        return 1 + bits_set(op & 0xFF);
    if ((op & 0xF500) == 0xB100)
        return 2; /* CBZ: taken or not */
    if ((op & 0xF000) == 0xD000)
        return 2; /* a branch with a condition: half of them taken */
    if ((op & 0xF800) == 0xE000)
        return 3;
    return 1;
}

static unsigned cost_of_long(uint16_t op, uint16_t second)
{
    if ((op & 0xFE40) == 0xE800)
        return 1 + bits_set(second) + (second & 0x8000 && op & 0x10 ? 3 : 0); /* LDM, STM */
    if ((op & 0xFE40) == 0xE840)
        return 3; /* LDRD, STRD, TBB */
    if ((op & 0xFE00) == 0xF800)
        return 2;
    if ((op & 0xFFD0) == 0xFB90)
        return 8; /* SDIV, UDIV: 2 to 12 */
    if ((op & 0xFF80) == 0xFB80)
        return 4; /* long multiplication: 3 to 7 */
    if ((op & 0xFF80) == 0xFB00)
        return 2;
    if ((op & 0xF800) == 0xF000 && (second & 0x8000))
        return (op & 0xFFE0) == 0xF3A0 ? 4 : 3; /* branches, barriers */
    return 1;
}

static uint8_t look_at(const machine_t *machine, uint32_t at)
{
    uint16_t op, second = 0;
    memcpy(&op, machine->flash + at, 2);
    if (at + 4 <= FLASH_BYTES)
        memcpy(&second, machine->flash + at + 2, 2);
    if ((op & 0xFF00) == 0xBF00 && (op & 0x000F))
        return COST_IT | 1;
    if ((op & 0xFFE8) == 0xB660)
        return COST_MASKING | 1; /* CPS */
    if ((op & 0xFFF0) == 0xF380 && (second & 0xFF00) == 0x8800)
        return COST_MASKING | 4; /* MSR, with the barrier that follows */
    const unsigned cycles = op >= 0xE800 ? cost_of_long(op, second) : cost_of_short(op);
    return (uint8_t)(cycles < COST_MASK ? cycles : COST_MASK);
}

/* ---- interrupts ---- */

static uint32_t get(machine_t *machine, int reg)
{
    uint32_t value = 0;
    uc_reg_read(machine->uc, reg, &value);
    return value;
}

static void set(machine_t *machine, int reg, uint32_t value)
{
    uc_reg_write(machine->uc, reg, &value);
}

void machine_forbid(machine_t *machine, const char *rule, const char *what)
{
    if (!*machine->fault) {
        snprintf(machine->fault, sizeof machine->fault, "%s (%s)", rule, what);
        machine->fault_pc = machine->at;
    }
    machine->is_over = true;
    uc_emu_stop(machine->uc);
}

void machine_attend(machine_t *machine)
{
    machine->is_attention = true;
}

/* A line that is high makes its interrupt pending, unless that is being served. */
static void latch(machine_t *machine)
{
    uint64_t fresh = machine->bus.levels(machine->bus.context) & ~machine->pending;
    for (unsigned i = 0; i < machine->depth; i++)
        fresh &= ~(1ull << machine->active[i]);
    machine->pending |= fresh;
    for (; fresh; fresh &= fresh - 1)
        machine->pending_since[__builtin_ctzll(fresh)] = machine->cycles;
}

static int find_urgent(const machine_t *machine)
{
    int best = NO_IRQ;
    for (uint64_t left = machine->pending & machine->enabled; left; left &= left - 1) {
        const int irq = __builtin_ctzll(left);
        if (best == NO_IRQ || machine->priority[irq] < machine->priority[best])
            best = irq;
    }
    return best;
}

/* The interrupt to serve now. */
static int find_deliverable(machine_t *machine)
{
    latch(machine);
    const int irq = find_urgent(machine);
    if (irq == NO_IRQ || machine->is_in_fault)
        return NO_IRQ;
    const unsigned priority = machine->priority[irq];
    if (machine->depth && priority >= machine->priority[machine->active[machine->depth - 1]])
        return NO_IRQ;
    const uint32_t base = get(machine, UC_ARM_REG_BASEPRI);
    if ((base && priority >= base) || (get(machine, UC_ARM_REG_PRIMASK) & 1))
        return NO_IRQ;
    return irq;
}

static const int frame_registers[8] = {UC_ARM_REG_R0,  UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3,
                                       UC_ARM_REG_R12, UC_ARM_REG_LR, UC_ARM_REG_PC, UC_ARM_REG_XPSR};

static uint32_t *stack_at(machine_t *machine, uint32_t address)
{
    if (address < RAM_AT || address + 32 > RAM_AT + RAM_BYTES) {
        rules_break(machine, RULE_STACK, "an interrupt's frame");
        return (uint32_t *)(void *)machine->ram;
    }
    return (uint32_t *)(void *)(machine->ram + (address - RAM_AT));
}

/* Address of an exception's handler. */
static uint32_t vector(machine_t *machine, unsigned number)
{
    uint32_t handler = 0;
    const uint8_t *table = machine->flash + (machine->vectors - FLASH_AT);
    if (machine->vectors == 0) {
        rules_break(machine, RULE_VECTORS_AT_ZERO, "VTOR");
        return FLASH_AT;
    }
    if (machine->vectors >= RAM_AT)
        table = machine->ram + (machine->vectors - RAM_AT);
    memcpy(&handler, table + 4 * number, 4);
    if (!(handler & 1) || handler < FLASH_AT || handler >= FLASH_AT + FLASH_BYTES)
        rules_break(machine, RULE_VECTOR, "of an interrupt");
    return handler;
}

static void set_vectors(machine_t *machine, uint32_t address)
{
    const bool is_flash = address >= FLASH_AT && address < FLASH_AT + FLASH_BYTES;
    const bool is_ram = address >= RAM_AT && address < RAM_AT + RAM_BYTES;
    if (address % TABLE_BYTES || !(is_flash || is_ram))
        rules_break(machine, RULE_VECTOR_TABLE, "VTOR");
    else
        machine->vectors = address;
}

/* The frame of an exception goes onto the stack, and its handler begins. */
static void enter_exception(machine_t *machine, unsigned number)
{
    const uint32_t stack = get(machine, UC_ARM_REG_SP), at = (stack - 32) & ~7u;
    uint32_t *frame = stack_at(machine, at);
    for (int i = 0; i < 8; i++)
        frame[i] = get(machine, frame_registers[i]);
    frame[6] &= ~1u;
    frame[7] = (frame[7] & ~0x200u) | (stack & 4 ? 0x200u : 0) | 0x01000000u;
    set(machine, UC_ARM_REG_SP, at);
    set(machine, UC_ARM_REG_LR, machine->depth ? 0xFFFFFFF1u : 0xFFFFFFF9u);
    set(machine, UC_ARM_REG_XPSR, (frame[7] & 0xF8000000u) | 0x01000000u | number);
    set(machine, UC_ARM_REG_PC, vector(machine, number) | 1);
    if (at < machine->lowest_stack)
        machine->lowest_stack = at;
}

/* PM0056 2.4: a bus fault that has no handler of its own becomes a hard fault, above every interrupt. */
static void enter_fault(machine_t *machine)
{
    machine->fault_status = PRECISE_BUS_FAULT;
    machine->is_in_fault = true;
    enter_exception(machine, HARD_FAULT);
}

static void enter(machine_t *machine, int irq)
{
    const uint32_t from = get(machine, UC_ARM_REG_PC) - FLASH_AT;
    if (from < FLASH_BYTES)
        machine->interrupted[from / 2] = HIT;
    enter_exception(machine, (unsigned)(FIRST_IRQ + irq));
    machine->pending &= ~(1ull << irq);
    machine->active[machine->depth++] = (uint8_t)irq;
    if (machine->depth > machine->deepest)
        machine->deepest = machine->depth;
}

/* Count how long the interrupt waited, with the cycles of the entry. */
static void serve(machine_t *machine, int irq, unsigned cycles)
{
    irq_stats_t *stats = &machine->irqs[irq];
    machine->cycles += cycles;
    const uint64_t waited = machine->cycles - machine->pending_since[irq];
    stats->entries++;
    if (waited > stats->worst_wait)
        stats->worst_wait = waited;
    enter(machine, irq);
}

static void leave(machine_t *machine)
{
    const uint32_t at = get(machine, UC_ARM_REG_SP);
    const uint32_t *frame = stack_at(machine, at);
    machine->depth--;
    const uint32_t under = machine->depth ? (uint32_t)FIRST_IRQ + machine->active[machine->depth - 1] : 0u;
    for (int i = 0; i < 6; i++)
        set(machine, frame_registers[i], frame[i]);
    set(machine, UC_ARM_REG_XPSR, (frame[7] & 0xFF00FC00u & ~0x200u) | 0x01000000u | under);
    set(machine, UC_ARM_REG_SP, at + 32 + (frame[7] & 0x200 ? 4 : 0));
    set(machine, UC_ARM_REG_PC, frame[6] | 1);
    const int next = find_deliverable(machine);
    if (next != NO_IRQ)
        serve(machine, next, CHAIN_CYCLES);
    else
        machine->cycles += EXIT_CYCLES;
}

/* ---- hooks ---- */

static void let_happen(machine_t *machine)
{
    while (machine->cycles >= machine->next_event && !machine->is_over)
        machine->next_event = machine->bus.advance(machine->bus.context);
    machine->is_attention = true;
}

/* Make one of the interrupts that are switched on pending, each in turn: some are more urgent than what runs. */
static void probe(machine_t *machine, uint32_t place)
{
    const unsigned count = bits_set((uint32_t)machine->enabled) + bits_set((uint32_t)(machine->enabled >> 32));
    uint64_t left = machine->enabled;
    if (count == 0)
        return;
    for (unsigned i = machine->probed[place]++ % count; i > 0; i--)
        left &= left - 1;
    const int irq = __builtin_ctzll(left);
    machine->pending |= 1ull << irq;
    machine->pending_since[irq] = machine->cycles;
    machine->is_attention = true;
    machine->asked++;
}

static void on_instruction(uc_engine *uc, uint64_t address, uint32_t size, void *user)
{
    machine_t *machine = user;
    const uint32_t at = (uint32_t)address - FLASH_AT;
    (void)size;
    machine->at = (uint32_t)address;
    if (at >= FLASH_BYTES)
        return;
    uint8_t cost = machine->cost[at / 2];
    if (!cost)
        cost = machine->cost[at / 2] = look_at(machine, at);
    if (machine->cycles >= machine->next_event)
        let_happen(machine);
    if (machine->probed[at / 2] < machine->probes && !machine->interrupted[at / 2])
        probe(machine, at / 2);
    if (machine->in_it_block) {
        machine->in_it_block--;
    } else if (machine->is_attention) {
        machine->is_attention = false;
        const bool is_to_stick = (machine->is_stuck_wanted || machine->is_lost_wanted) && machine->depth == 0;
        if (machine->is_over || machine->is_reset_wanted || is_to_stick || find_deliverable(machine) != NO_IRQ) {
            machine->is_attention = true;
            uc_emu_stop(uc); /* before this instruction */
            return;
        }
    }
    machine->is_attention |= machine->is_attention_after;
    machine->is_attention_after = (cost & COST_MASKING) != 0;
    machine->cycles += cost & COST_MASK;
    machine->instructions++;
    if (cost & COST_IT)
        machine->in_it_block = 4u - (unsigned)__builtin_ctz(machine->flash[at]);
    else if (cost == 1 && machine->flash[at] == (OPCODE_WFI & 0xFF) && machine->flash[at + 1] == OPCODE_WFI >> 8)
        machine->is_waiting = true;
}

static void on_exception(uc_engine *uc, uint32_t number, void *user)
{
    machine_t *machine = user;
    machine->is_returning = number == EXCEPTION_EXIT;
    if (!machine->is_returning)
        machine_forbid(machine, "exception", "of an instruction");
    uc_emu_stop(uc);
}

/* A write to what is mapped to be read: the flash; below the RAM, where a stack that is too small runs into it, the ROM. */
static bool on_protected(uc_engine *uc, uc_mem_type type, uint64_t address, int size, int64_t value, void *user)
{
    const bool is_flash = address >= FLASH_AT && address < FLASH_AT + FLASH_BYTES;
    (void)uc;
    (void)type;
    (void)size;
    (void)value;
    rules_break(user, is_flash ? RULE_FLASH_WRITTEN : RULE_STACK, is_flash ? "flash" : "below the RAM");
    return false;
}

static uint64_t read_peripheral(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
    machine_t *machine = user;
    (void)uc;
    return machine->bus.read(machine->bus.context, PERIPHERALS_AT + (uint32_t)offset, size);
}

static void write_peripheral(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
    machine_t *machine = user;
    (void)uc;
    machine->bus.write(machine->bus.context, PERIPHERALS_AT + (uint32_t)offset, size, (uint32_t)value);
    machine->next_event = 0; /* what is due may have changed */
}

static uint64_t read_system(uc_engine *uc, uint64_t offset, unsigned size, void *user)
{
    const machine_t *machine = user;
    (void)uc;
    (void)size;
    if (offset >= ISER && offset < ISER + 8)
        return (uint32_t)(machine->enabled >> 8 * (offset - ISER));
    if (offset >= ISPR && offset < ISPR + 8)
        return (uint32_t)(machine->pending >> 8 * (offset - ISPR));
    if (offset >= IPR && offset < IPR + IRQS)
        return machine->priority[offset - IPR];
    if (offset == VTOR)
        return machine->vectors;
    if (offset == CFSR)
        return machine->fault_status;
    if (offset != HFSR && offset != AIRCR)
        rules_break(user, RULE_NOTHING_THERE, "core");
    return 0;
}

static void set_priorities(machine_t *machine, unsigned first, unsigned count, uint32_t value)
{
    for (unsigned i = 0; i < count; i++) {
        const uint8_t priority = (uint8_t)(value >> 8 * i);
        if (priority & 0x0F)
            rules_break(machine, RULE_PRIORITY, "NVIC_IPR");
        machine->priority[first + i] = priority & 0xF0;
    }
}

static void write_system(uc_engine *uc, uint64_t offset, unsigned size, uint64_t value, void *user)
{
    machine_t *machine = user;
    (void)uc;
    if (offset >= ISER && offset < ISER + 8)
        machine->enabled |= value << 8 * (offset - ISER);
    else if (offset >= ICER && offset < ICER + 8)
        machine->enabled &= ~(value << 8 * (offset - ICER));
    else if (offset >= ISPR && offset < ISPR + 8)
        machine->pending |= value << 8 * (offset - ISPR);
    else if (offset >= ICPR && offset < ICPR + 8)
        machine->pending &= ~(value << 8 * (offset - ICPR));
    else if (offset >= IPR && offset + size <= IPR + IRQS)
        set_priorities(machine, (unsigned)offset - IPR, size, (uint32_t)value);
    else if (offset == VTOR)
        set_vectors(machine, (uint32_t)value);
    else if (offset == AIRCR && (value >> 16) == 0x05FA && (value & SYSTEM_RESET))
        machine->is_reset_wanted = true;
    else if (offset != CFSR && offset != HFSR)
        rules_break(machine, RULE_NOTHING_THERE, "core");
    machine->is_attention = true;
}

/* ---- running ---- */

int machine_init(machine_t *machine, const uint8_t *image, size_t size)
{
    uc_hook hooks[3];
    memset(machine, 0, sizeof *machine);
    machine->flash = calloc(1, FLASH_BYTES);
    machine->ram = calloc(1, RAM_BYTES);
    machine->cost = calloc(1, FLASH_BYTES / 2);
    machine->interrupted = calloc(1, FLASH_BYTES / 2);
    machine->probed = calloc(1, FLASH_BYTES / 2);
    uint8_t *id = calloc(1, ID_BYTES);
    if (!machine->flash || !machine->ram || !machine->cost || !machine->interrupted || !machine->probed || !id || size > FLASH_BYTES)
        return -1;
    memcpy(machine->flash, image, size);
    memcpy(id + ID_OFFSET, "emulated, no", 12);
    uc_err error = uc_open(UC_ARCH_ARM, (uc_mode)(UC_MODE_THUMB | UC_MODE_MCLASS), &machine->uc);
    uc_engine *uc = machine->uc;
    if (!error)
        error = uc_ctl_set_cpu_model(uc, UC_CPU_ARM_CORTEX_M3);
    if (!error)
        error = uc_mem_map_ptr(uc, FLASH_AT, FLASH_BYTES, UC_PROT_READ | UC_PROT_EXEC, machine->flash);
    if (!error)
        error = uc_mem_map_ptr(uc, RAM_AT, RAM_BYTES, UC_PROT_READ | UC_PROT_WRITE, machine->ram);
    if (!error)
        error = uc_mem_map_ptr(uc, ID_AT, ID_BYTES, UC_PROT_READ, id);
    if (!error)
        error = uc_mmio_map(uc, PERIPHERALS_AT, PERIPHERAL_BYTES, read_peripheral, machine, write_peripheral, machine);
    if (!error)
        error = uc_mmio_map(uc, SYSTEM_AT, SYSTEM_BYTES, read_system, machine, write_system, machine);
    if (!error)
        error = uc_hook_add(uc, &hooks[0], UC_HOOK_CODE, (void *)on_instruction, machine, 1, 0);
    if (!error)
        error = uc_hook_add(uc, &hooks[1], UC_HOOK_INTR, (void *)on_exception, machine, 1, 0);
    if (!error)
        error = uc_hook_add(uc, &hooks[2], UC_HOOK_MEM_WRITE_PROT, (void *)on_protected, machine, 1, 0);
    machine->lowest_stack = RAM_AT + RAM_BYTES;
    return error ? -1 : 0;
}

void machine_reset(machine_t *machine)
{
    uint32_t vectors[FIRST_WORDS];
    memcpy(vectors, machine->flash, sizeof vectors);
    machine->vectors = 0;
    if (vectors[0] % 8 || vectors[0] <= RAM_AT || vectors[0] > RAM_AT + RAM_BYTES)
        rules_break(machine, RULE_STACK, "first word");
    if (!(vectors[1] & 1) || vectors[1] < FLASH_AT || vectors[1] >= FLASH_AT + FLASH_BYTES)
        rules_break(machine, RULE_VECTOR, "of the reset");
    for (int i = 0; i < 6; i++)
        set(machine, frame_registers[i], 0);
    set(machine, UC_ARM_REG_XPSR, 0x01000000u);
    set(machine, UC_ARM_REG_BASEPRI, 0);
    set(machine, UC_ARM_REG_PRIMASK, 0);
    set(machine, UC_ARM_REG_SP, vectors[0]);
    set(machine, UC_ARM_REG_PC, vectors[1] | 1);
    machine->enabled = machine->pending = 0;
    memset(machine->priority, 0, sizeof machine->priority);
    machine->is_in_fault = false;
    machine->depth = machine->in_it_block = 0;
    machine->is_waiting = machine->is_returning = machine->is_reset_wanted = machine->is_attention_after = false;
    machine->next_event = 0;
    machine->is_attention = true;
}

static void sleep_until_interrupt(machine_t *machine)
{
    machine->is_waiting = false;
    machine->bus.sleep(machine->bus.context);
    for (;;) {
        if (machine->cycles >= machine->next_event)
            let_happen(machine);
        latch(machine);
        if (machine->is_over || machine->is_reset_wanted || (machine->pending & machine->enabled))
            return;
        machine->slept += machine->next_event - machine->cycles;
        machine->cycles = machine->next_event;
    }
}

/* Let the main loop turn on the spot, with its stack as it is; interrupts go on. */
static void stick(machine_t *machine)
{
    machine->is_stuck_wanted = false;
    for (uint32_t at = 0; at < FLASH_BYTES; at += 2) {
        uint16_t op;
        memcpy(&op, machine->flash + at, 2);
        if (op == OPCODE_SELF) {
            set(machine, UC_ARM_REG_PC, (FLASH_AT + at) | 1);
            return;
        }
    }
}

static void step(machine_t *machine)
{
    machine->starts++;
    if (machine->is_stuck_wanted && machine->depth == 0)
        stick(machine);
    if (machine->is_lost_wanted && machine->depth == 0) {
        machine->is_lost_wanted = false;
        set(machine, UC_ARM_REG_PC, NOWHERE | 1);
    }
    const uc_err error = uc_emu_start(machine->uc, get(machine, UC_ARM_REG_PC) | 1, 0xFFFFFFFEu, 0, 0);
    if (machine->is_returning) {
        machine->is_returning = false;
        leave(machine);
        return;
    }
    if (error && machine->is_fault_delivered && !machine->is_in_fault && !*machine->fault) {
        enter_fault(machine);
        return;
    }
    if (error == UC_ERR_READ_UNMAPPED || error == UC_ERR_WRITE_UNMAPPED || error == UC_ERR_FETCH_UNMAPPED)
        rules_break(machine, RULE_NOTHING_THERE, uc_strerror(error));
    else if (error)
        machine_forbid(machine, "instruction", uc_strerror(error));
    if (*machine->fault)
        return;
    if (machine->is_waiting)
        sleep_until_interrupt(machine);
    if (machine->is_reset_wanted) {
        machine->is_reset_wanted = false;
        machine->bus.reset(machine->bus.context);
        return;
    }
    const int irq = find_deliverable(machine);
    if (irq != NO_IRQ && !machine->is_over)
        serve(machine, irq, ENTRY_CYCLES);
}

void machine_count_places(const machine_t *machine, unsigned *executed, unsigned *interrupted)
{
    *executed = *interrupted = 0;
    for (size_t i = 0; i < FLASH_BYTES / 2; i++) {
        *executed += machine->cost[i] != 0;
        *interrupted += machine->interrupted[i] != 0;
    }
}

void machine_run(machine_t *machine)
{
    while (!machine->is_over)
        step(machine);
}
