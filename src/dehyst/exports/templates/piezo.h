/* An actuator in a loop: wanted displacement [m] in, voltage [V] out, one call every PIEZO_PERIOD seconds.
 *
 * No heap, no library, no globals except constants: a piezo holds all memory; there may be several. Only piezo_begin and
 * piezo_restore can fail; the time of a call is bounded. Two threads or interrupts must not use a piezo at once. */
#ifndef PIEZO_H
#define PIEZO_H

#include "dehyst.h"

/* sizes */

#ifdef __cplusplus
extern "C" {
#endif

/* Everything that changes, without pointers: copy it by = or memcpy at any time. */
typedef struct piezo {
    dehyst_loop loop; /* counts the samples that were limited, slewed and refused */
    dehyst_real memory[DEHYST_MEMORY(PIEZO_ELEMENTS, PIEZO_SMOOTH, PIEZO_OUTPUT, PIEZO_TAPS)];
} piezo;

/* Bytes of a snapshot. */
#define PIEZO_SNAPSHOT DEHYST_SNAPSHOT(PIEZO_ELEMENTS, PIEZO_SMOOTH, PIEZO_OUTPUT, PIEZO_TAPS)

/* Start from the exported state. Call it before every other function. If it does not return DEHYST_OK, do not use p. */
dehyst_status piezo_begin(piezo *p);
/* Return the voltage to send now; it counts as sent. If the displacement is not a number, return the last voltage. */
dehyst_real piezo_step(piezo *p, dehyst_real displacement);
/* Return the voltage to send; the memory does not change until a voltage is committed. */
dehyst_real piezo_offer(piezo *p, dehyst_real displacement);
/* End a period with the voltage that was really sent. */
void piezo_commit(piezo *p, dehyst_real voltage);
/* End a period in which nothing was sent: the last voltage is still on the actuator. */
void piezo_hold(piezo *p);
/* Simulate the actuator: return its displacement after a period with this voltage, or with the last voltage if this is
 * not a number. A voltage whose displacement is too large to compute changes nothing and counts as refused. */
dehyst_real piezo_simulate(piezo *p, dehyst_real voltage);
/* Return the displacement of the actuator, from all voltages that were sent. */
dehyst_real piezo_displacement(const piezo *p);
/* Return the exported model, for the functions of dehyst.h. */
const dehyst_model *piezo_exported(void);
/* Write a snapshot, to continue from it after a reset. */
void piezo_save(const piezo *p, unsigned char bytes[PIEZO_SNAPSHOT]);
/* Continue from a snapshot, instead of piezo_begin. If it does not return DEHYST_OK, the bytes are damaged, or not a
 * snapshot of a model of this shape, and nothing has changed. */
dehyst_status piezo_restore(piezo *p, const unsigned char bytes[PIEZO_SNAPSHOT]);
/* temperature */

#ifdef __cplusplus
}
#endif
#endif
