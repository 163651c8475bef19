/* emulator IMAGE STIMULUS SCRIPT OUT: run logger.bin in the world that the files describe, until its script says "end".
 *
 * Leaves the card's volume and its recordings in the folder OUT, what came out of USART1 in serial.txt, the LED's changes
 * in led.txt, and prints what was
 * measured. A power cut of the script runs in a copy of the world, which leaves its own in OUT/cutNNNNN. */
#include "world.h"

#include <stdlib.h>

static world_t world;

static int finish_child(void)
{
    char path[600];
    snprintf(path, sizeof path, "%s/cut%05u", world.out, world.cuts);
    if (*world.machine.fault)
        fprintf(stderr, "%s: %s at %08x\n", path, world.machine.fault, world.machine.fault_pc);
    return world_save(&world, path) || *world.machine.fault ? 1 : 0;
}

int main(int count, char **arguments)
{
    char path[600];
    if (count != 5) {
        fprintf(stderr, "usage: emulator IMAGE STIMULUS SCRIPT OUT\n");
        return 2;
    }
    snprintf(path, sizeof path, "%s/serial.txt", arguments[4]);
    if (world_init(&world, arguments[1], arguments[2], arguments[3], arguments[4])) {
        fprintf(stderr, "emulator: cannot read %s, %s or %s\n", arguments[1], arguments[2], arguments[3]);
        return 2;
    }
    world.serial = fopen(path, "wb");
    snprintf(path, sizeof path, "%s/led.txt", arguments[4]);
    world.panel = fopen(path, "w");
    machine_run(&world.machine);
    if (world.serial)
        fclose(world.serial);
    if (world.is_child)
        _Exit(finish_child());
    if (world.writes)
        fclose(world.writes);
    if (world.panel)
        fclose(world.panel);
    world_report(&world);
    return world_save(&world, arguments[4]) || *world.machine.fault ? 1 : 0;
}
