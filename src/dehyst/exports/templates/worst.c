/* Counts the instructions of the longest step on a Cortex-M4F that QEMU emulates. It tries the steps of the trace, jumps
 * of all axes far beyond their reach, so that every element breaks away and every knot is passed, and steps to random
 * places within reach, whose voltages are not clamped. */
#include "piezo.h"
#include "trace.h"

#include <stdint.h>
#include <stdio.h>

/* The board's timer counts at 25 MHz, and an instruction takes 2^6 ns of QEMU's clock: 8 counts are 5 instructions. */
#define CONTROL (*(volatile uint32_t *)0xE000E010u)
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define COUNT (*(volatile uint32_t *)0xE000E018u)
#define JUMPS 400
#define RANDOM 4000

#ifdef PIEZO_AXES
#define AXES PIEZO_AXES
#define GIVEN(row, axis) ((row)->given[axis])
#else
#define AXES 1
#define GIVEN(row, axis) ((row)->given)
#endif

static piezo p;
static unsigned long longest;

static void measure(const dehyst_real wanted[AXES])
{
    volatile dehyst_real sent;
    unsigned long instructions;
    uint32_t begin, end;
    COUNT = 0;
    begin = COUNT;
#ifdef PIEZO_AXES
    {
        dehyst_real voltage[AXES];
        piezo_step(&p, wanted, voltage);
        sent = voltage[0];
    }
#else
    sent = piezo_step(&p, wanted[0]);
#endif
    end = COUNT;
    (void)sent;
    instructions = (unsigned long)((begin - end) & 0xFFFFFFu) * 5 / 8;
    if (instructions > longest) { longest = instructions; }
}

int main(void)
{
    dehyst_real low[AXES], high[AXES], wanted[AXES];
    uint32_t random = 1u;
    int steps = 0, i, j;
    CONTROL = 0;
    RELOAD = 0xFFFFFFu;
    COUNT = 0;
    CONTROL = 5;
    if (piezo_begin(&p) != DEHYST_OK) { return 1; }
    for (j = 0; j < AXES; j++) { low[j] = high[j] = (dehyst_real)GIVEN(&trace[0], j); }
    for (i = 0; i < TRACE_SIZE; i++) {
        if (trace[i].what != TRACE_STEP) { continue; }
        for (j = 0; j < AXES; j++) {
            wanted[j] = (dehyst_real)GIVEN(&trace[i], j);
            low[j] = (wanted[j] < low[j]) ? wanted[j] : low[j];
            high[j] = (wanted[j] > high[j]) ? wanted[j] : high[j];
        }
        measure(wanted);
        steps++;
    }
    for (i = 0; i < JUMPS; i++) {
        for (j = 0; j < AXES; j++) {
            /* All axes jump in phase, then in opposite phase. */
            const int up = (i + ((i < (JUMPS / 2)) ? 0 : j)) % 2;
            const dehyst_real far = 10 * (high[j] - low[j]);
            wanted[j] = up ? (high[j] + far) : (low[j] - far);
        }
        measure(wanted);
    }
    for (i = 0; i < RANDOM; i++) {
        for (j = 0; j < AXES; j++) {
            random = 1664525u * random + 1013904223u;
            wanted[j] = low[j] + ((high[j] - low[j]) * ((dehyst_real)(random >> 8) / (dehyst_real)16777216));
        }
        measure(wanted);
    }
    printf("longest of %d steps: %lu instructions\n", steps + JUMPS + RANDOM, longest);
    return 0;
}
