/* dehyst: whole records, for the Python package. What an export contains is in dehyst.h; nothing here is in an export.
 *
 * A second evaluator of Maxwell-slip elements, which gives the same answer as the carts of dehyst.h:
 *
 *   stack    the reversals that are still remembered, amortised O(1) in N           dehyst_stack
 *            (Masing: F(y) = F_R + sgn 2 phi(|y - y_R| / 2), phi(a) = sum_i kappa_i min(a, rho_i))
 */
#ifndef DEHYST_RECORDS_H
#define DEHYST_RECORDS_H

#include "dehyst.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct dehyst_reversal {
    dehyst_real y;     /* where the motion turned */
    dehyst_real stops; /* sum_i kappa_i s_i there */
    dehyst_real v;     /* voltage there */
} dehyst_reversal;

#define DEHYST_STACK_CAPACITY(n) (2 * (n) + 8)

/* The memory of a history: its nested reversals, outermost first. */
typedef struct dehyst_stack {
    int capacity;
    int depth;
    dehyst_real direction; /* +1 or -1: the present branch runs from the last reversal in this direction */
    dehyst_real y;
    dehyst_real v;
    dehyst_reversal *reversal; /* [capacity] */
} dehyst_stack;

/* Carts <-> reversals; the same memory in two forms. */
dehyst_status dehyst_stack_encode(const dehyst_actuator *actuator, const dehyst_state *state, dehyst_stack *stack);
void dehyst_stack_decode(const dehyst_actuator *actuator, const dehyst_stack *stack, dehyst_state *state);
/* n samples on the stack. Input and output may be the same array. */
void dehyst_stack_compensate(const dehyst_actuator *actuator, dehyst_stack *stack, const dehyst_real *y, dehyst_real *v,
                             long n);
void dehyst_stack_simulate(const dehyst_actuator *actuator, dehyst_stack *stack, const dehyst_real *v, dehyst_real *y,
                           long n);

/* n samples from the carts and back to them: on the stack as soon as the state has one. */
void dehyst_compensate_run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_stack *work,
                           const dehyst_real *y, dehyst_real *v, long n);
void dehyst_simulate_run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_stack *work,
                         const dehyst_real *v, dehyst_real *y, long n);

/* Room that a run of a wide actuator works in. Without reversals it stays on the carts. */
typedef struct dehyst_room {
    dehyst_stack stack;
    dehyst_real *value; /* [spring knots] the spring stiffened by what moves in time */
    dehyst_real *slope; /* [spring knots - 1] */
    dehyst_real *held;  /* [N] with graded elements */
    int *segment;       /* [N] with graded elements */
} dehyst_room;

/* Samples first to its result - 1, first >= 1, lie equal steps of time apart, but for what writing a time down leaves
 * of them. A step that is not positive stands alone. */
long dehyst_equal_steps(const dehyst_real *time, long first, long n);
/* n samples, all the same time after the one before. Input and output are different arrays. `more` [n] is added to
 * tau(v); NULL: nothing. */
void dehyst_wide_compensate(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                            dehyst_room *room, const dehyst_real *w, const dehyst_real *more, dehyst_real *v, long n);
/* Displacements y; those of w without inertia, when `load` is left alone: F_ext/kc [m], [n] or NULL. What w holds and
 * what is left of eta's slopes and moves with it must together rise. */
void dehyst_wide_simulate(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state, dehyst_room *room,
                          const dehyst_real *v, const dehyst_real *load, dehyst_real *y, long n);
/* Strains [n J], a row a sample, along a path of w that starts from `before`. */
void dehyst_strains(int branches, const dehyst_pace *pace, dehyst_real *strain, dehyst_real before,
                    const dehyst_real *w, dehyst_real *out, long n);

#ifdef __cplusplus
}
#endif
#endif
