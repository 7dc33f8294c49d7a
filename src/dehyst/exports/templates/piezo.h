/* A piezo actuator in a loop: wanted displacement [m] in, voltage [V] out, one call every MODEL_PERIOD seconds.
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

typedef struct piezo {
    dehyst_loop loop; /* its counts: how many samples were limited, slewed and refused */
    dehyst_real cart[MODEL_ROOM(MODEL_ELEMENTS)], spare[MODEL_ROOM(MODEL_ELEMENTS)];
    dehyst_real strain[MODEL_ROOM(MODEL_BRANCHES)];
    dehyst_real elongation[MODEL_ROOM(MODEL_SMOOTH)];
    dehyst_real inputs[MODEL_TAPS];
} piezo;

/* Start from the exported state. Call it before every other function. If it does not return DEHYST_OK, do not use p. */
dehyst_status piezo_begin(piezo *p);
/* Return the voltage to send now, which then counts as sent. If the displacement is not a number, it is the last one. */
dehyst_real piezo_step(piezo *p, dehyst_real displacement);
/* Return the voltage to send; nothing moves until a voltage is committed. */
dehyst_real piezo_offer(piezo *p, dehyst_real displacement);
/* End a period with the voltage that was really sent. */
void piezo_commit(piezo *p, dehyst_real voltage);
/* End a period in which nothing was sent: the last voltage acts on. */
void piezo_hold(piezo *p);
/* The actuator itself: return its displacement after a period with this voltage, or with the last one if this is not a
 * number. A voltage that leads farther than can be computed moves nothing and counts as refused. */
dehyst_real piezo_simulate(piezo *p, dehyst_real voltage);
/* Return the displacement of the actuator, from all voltages that were sent. */
dehyst_real piezo_displacement(const piezo *p);
/* Copy a piezo. It points into itself: an assignment would not do. */
void piezo_copy(piezo *to, const piezo *from);
/* Correct the pointers of a piezo after its bytes were moved. */
void piezo_point(piezo *p);

#ifdef __cplusplus
}
#endif
#endif
