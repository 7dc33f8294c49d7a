/* Coupled axes of one body in a loop: wanted displacements [m] of all axes in, their voltages [V] out, one call every
 * period. Axes are in the order of the model; arrays have one number for each, PIEZO_AXES.
 *
 * No heap, no library, no globals except constants: a piezo holds all memory; there may be several. Only piezo_begin can
 * fail; the time of a call is bounded. Two threads or interrupts must not use a piezo at once. */
#ifndef PIEZO_H
#define PIEZO_H

#include "dehyst.h"

/* sizes */

#ifdef __cplusplus
extern "C" {
#endif

/* Everything that changes, without pointers: copy it by = or memcpy at any time. */
typedef struct piezo {
    dehyst_loop loop[PIEZO_AXES];      /* they count the samples that were limited, slewed and refused */
    dehyst_real memory[PIEZO_MEMORY];  /* of the axes, one after the other */
} piezo;

/* Start from the exported states. Call it before every other function. If it does not return DEHYST_OK, do not use p. */
dehyst_status piezo_begin(piezo *p);
/* Compute the voltages to send now; they count as sent. If a displacement is not a number, repeat the last voltages. */
void piezo_step(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES]);
/* Compute the voltages to send; the memory does not change until voltages are committed. The error of a clamped axis
 * moves the other axes by their coupling. */
void piezo_offer(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES]);
/* End a period with the voltages that were really sent. */
void piezo_commit(piezo *p, const dehyst_real voltage[PIEZO_AXES]);
/* End a period in which nothing was sent: the last voltages are still on the actuators. */
void piezo_hold(piezo *p);
/* Simulate the body: compute its displacements after a period with these voltages. */
void piezo_simulate(piezo *p, const dehyst_real voltage[PIEZO_AXES], dehyst_real displacement[PIEZO_AXES]);
/* Compute the displacements of the body from all voltages that were sent, without the dynamics of a mass. */
void piezo_displacement(const piezo *p, dehyst_real displacement[PIEZO_AXES]);
/* temperature */
#ifdef __cplusplus
}
#endif
#endif
