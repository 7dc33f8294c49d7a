/* Loads a model that Python wrote, replays its calls, and goes on from its snapshot: the bits are Python's. */
#include "dehyst_model.h"

#include <stdio.h>

#include "golden.h"

static int differs(const char *what, long at, double got, double want)
{
    if (got == want) return 0;
    printf("%s %ld: got %.17g, want %.17g\n", what, at, got, want);
    return 1;
}

int main(void)
{
    static dehyst_real tables[4096], memory[256];
    unsigned char bytes[sizeof snapshot];
    unsigned long room, i;
    dehyst_model model;
    dehyst_loop loop;
    dehyst_status status = dehyst_model_room(block, sizeof block, &room);
    if (status == DEHYST_OK) status = dehyst_model_load(block, sizeof block, tables, 4096, &model);
    if (status == DEHYST_OK) status = dehyst_loop_begin(&model, &loop, memory);
    if (status != DEHYST_OK || dehyst_memory_size(&model) > 256) {
        printf("the block is refused: %s\n", dehyst_status_text(status));
        return 1;
    }
    for (i = 0; i < sizeof wanted / sizeof *wanted; i++) {
        if (i == SAVED_AT) {
            dehyst_loop_save(&model, &loop, memory, bytes, sizeof bytes);
            for (room = 0; room < sizeof bytes; room++)
                if (bytes[room] != snapshot[room]) return differs("byte of the snapshot", (long)room, 0, 1);
            dehyst_loop_begin(&model, &loop, memory);
            status = dehyst_loop_restore(&model, &loop, memory, snapshot, sizeof snapshot);
            if (status != DEHYST_OK) return differs("restore", status, 0, 1);
        }
        if (differs("voltage", (long)i, dehyst_loop_step(&model, &loop, memory, wanted[i]), sent[i])) return 1;
    }
    printf("%lu voltages are Python's\n", i);
    return 0;
}
