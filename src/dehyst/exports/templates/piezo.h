/* A piezo actuator in a loop: wanted displacement [m] in, voltage [V] out, one call every MODEL_PERIOD seconds.
 *
 * No heap, no library, no globals but constants: a piezo is all memory, and there may be many. No call can fail but
 * piezo_begin, each takes bounded time. Not for two threads or interrupts at once on one piezo. */
#ifndef PIEZO_H
#define PIEZO_H

#include "dehyst.h"

/* sizes */

#ifdef __cplusplus
extern "C" {
#endif

typedef struct piezo {
    dehyst_loop loop; /* how many samples were limited, slewed and refused is told by its counts */
    dehyst_real cart[MODEL_ROOM(MODEL_ELEMENTS)], spare[MODEL_ROOM(MODEL_ELEMENTS)];
    dehyst_real strain[MODEL_ROOM(MODEL_BRANCHES)];
    dehyst_real elongation[MODEL_ROOM(MODEL_SMOOTH)];
    dehyst_real fed[MODEL_TAPS];
} piezo;

/* Comes before every other call: start from the state that was exported. DEHYST_OK, or the memory is not to be used. */
dehyst_status piezo_begin(piezo *p);
/* The voltage to send now; the memory takes it to be sent. If the displacement is not a number, the last voltage. */
dehyst_real piezo_step(piezo *p, dehyst_real displacement);
/* The same in two: nothing moves until the voltage that was really sent is committed. */
dehyst_real piezo_offer(piezo *p, dehyst_real displacement);
void piezo_commit(piezo *p, dehyst_real voltage);
/* A period has passed in which nothing was sent: the last voltage acts on. */
void piezo_hold(piezo *p);
/* The actuator itself: its displacement after a period with this voltage; if that is not a number, with the last. One
 * that leads farther than can be computed moves nothing and is counted as refused. */
dehyst_real piezo_simulate(piezo *p, dehyst_real voltage);
/* Where the actuator is, by all that was sent. */
dehyst_real piezo_displacement(const piezo *p);
/* A piezo points into itself: it is copied by piezo_copy, not by assignment. If the bytes of such a copy were moved,
 * piezo_point puts its pointers right. */
void piezo_copy(piezo *to, const piezo *from);
void piezo_point(piezo *p);

#ifdef __cplusplus
}
#endif
#endif
