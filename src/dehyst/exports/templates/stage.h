/* Coupled axes of one body in a loop: wanted displacements [m] of all axes in, their voltages [V] out, one call every
 * period. Axes are in the order of the model; arrays have one number for each, PIEZO_AXES.
 *
 * No heap, no library, no globals but constants: a piezo holds all memory, and there may be many. Only piezo_begin can
 * fail; every call takes bounded time. Two threads or interrupts must not use one piezo at the same time. */
#ifndef PIEZO_H
#define PIEZO_H

#include "dehyst.h"

/* sizes */

#ifdef __cplusplus
extern "C" {
#endif

/* All that changes, without pointers: copy it by = or memcpy as you like. */
typedef struct piezo {
    dehyst_loop loop[PIEZO_AXES];      /* their counts: how many samples were limited, slewed and refused */
    dehyst_real memory[PIEZO_MEMORY];  /* of the axes, one after the other */
} piezo;

/* Start from the exported states. Call it before every other function. If it does not return DEHYST_OK, do not use p. */
dehyst_status piezo_begin(piezo *p);
/* Compute the voltages to send now, which then count as sent. If a displacement is not a number, they are the last. */
void piezo_step(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES]);
/* Compute the voltages to send; nothing moves until voltages are committed. What an axis that is clamped misses moves
 * the others by their coupling. */
void piezo_offer(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES]);
/* End a period with the voltages that were really sent. */
void piezo_commit(piezo *p, const dehyst_real voltage[PIEZO_AXES]);
/* End a period in which nothing was sent: the last voltages act on. */
void piezo_hold(piezo *p);
/* The body itself: compute its displacements after a period with these voltages. */
void piezo_simulate(piezo *p, const dehyst_real voltage[PIEZO_AXES], dehyst_real displacement[PIEZO_AXES]);
/* Compute the displacements of the body from all voltages that were sent; without the delay of a mass. */
void piezo_displacement(const piezo *p, dehyst_real displacement[PIEZO_AXES]);
/* temperature */
#ifdef __cplusplus
}
#endif
#endif
