/* dehyst: whole records, for the Python package. An export contains dehyst.h, but nothing from this file.
 *
 * A second evaluator of Maxwell-slip elements, which gives the same answer as the carts of dehyst.h:
 *
 *   stack    the reversals that still have an effect, amortised O(1) in N           dehyst_stack
 *            (Masing: F(y) = F_R + sgn 2 phi(|y - y_R| / 2), phi(a) = sum_i kappa_i min(a, rho_i))
 */
#ifndef DEHYST_RECORDS_H
#define DEHYST_RECORDS_H

#include "dehyst_model.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct dehyst_reversal {
    dehyst_real y;            /* displacement at which the motion turned */
    dehyst_real slip_voltage; /* sum_i kappa_i s_i there */
    dehyst_real v;            /* voltage there */
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

/* Convert carts to reversals, which hold the same memory. */
dehyst_status dehyst_stack_encode(const dehyst_plain *plain, const dehyst_plain_state *state, dehyst_stack *stack);
/* Convert reversals to carts. */
void dehyst_stack_decode(const dehyst_plain *plain, const dehyst_stack *stack, dehyst_plain_state *state);
/* Compute n samples on the stack, y [n] to v [n]; these may be the same array. */
void dehyst_stack_compensate(const dehyst_plain *plain, dehyst_stack *stack, const dehyst_real *y, dehyst_real *v,
                             long n);
/* Compute n samples on the stack, v [n] to y [n]; these may be the same array. */
void dehyst_stack_simulate(const dehyst_plain *plain, dehyst_stack *stack, const dehyst_real *v, dehyst_real *y,
                           long n);

/* Compute n samples, y [n] to v [n]; the carts hold the state before and after, the stack is used once there is one.
 * @param work a stack to work in */
void dehyst_plain_compensate_run(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_stack *work,
                                 const dehyst_real *y, dehyst_real *v, long n);
/* Compute n samples, v [n] to y [n], in the same way. */
void dehyst_plain_simulate_run(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_stack *work,
                               const dehyst_real *v, dehyst_real *y, long n);

/* Working memory of a run of an actuator. Without reversals, the run uses the carts. */
typedef struct dehyst_workspace {
    dehyst_stack stack;
    dehyst_real *value;   /* [knots of the spring] the spring, stiffened by a mass */
    dehyst_real *slope;   /* [knots of the spring - 1] */
    dehyst_real *at_cart; /* [N] psi_i at the carts, with graded elements */
    int *segment;         /* [N] segments of the carts, with graded elements */
    dehyst_real *smooth;  /* [2 L + 1] with smooth elements */
} dehyst_workspace;

/* Return the end of a run of equal steps: samples `first` >= 1 to end - 1 are equally spaced in time, up to the
 * rounding of written times. A step that is not positive makes a separate run.
 * @param time [n] */
long dehyst_equal_steps(const dehyst_real *time, long first, long n);
/* Compute n samples, w to v; these are different arrays.
 * @param w [n]
 * @param extra_voltage [n] added to tau(v), or NULL
 * @param v [n] the result */
void dehyst_compensate_run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_workspace *workspace,
                           const dehyst_real *w, const dehyst_real *extra_voltage, dehyst_real *v, long n);
/* Compute n samples at equal steps of time, v to y; these are different arrays. The sum of all slopes, of eta, elements
 * and mass, must be positive.
 * @param v [n]
 * @param load F_ext/kc [m], [n] or NULL; not read without inertia
 * @param y [n] the result; w without inertia */
void dehyst_simulate_run(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                         dehyst_workspace *workspace, const dehyst_real *v, const dehyst_real *load, dehyst_real *y,
                         long n);
/* Add creep behind the elements to a path at equal steps of time, m [n] to y [n]; these may be the same array.
 * @param strain [K]
 * @param before m before the first sample */
void dehyst_output_simulate(const dehyst_output *output, dehyst_real *strain, dehyst_real before, const dehyst_real *m,
                            dehyst_real *y, long n);
/* Remove this creep, y [n] to m [n]; these may be the same array. */
void dehyst_output_compensate(const dehyst_output *output, dehyst_real *strain, dehyst_real before,
                              const dehyst_real *y, dehyst_real *m, long n);
/* Change the strains of low-passes along a path at equal steps of time and return them.
 * @param decay, rise [K] as in dehyst_output
 * @param strain [K]
 * @param before w before the first sample
 * @param w [n] the path
 * @param out [n K] the result, one row for each sample */
void dehyst_strains(int branches, const dehyst_real *decay, const dehyst_real *rise, dehyst_real *strain,
                    dehyst_real before, const dehyst_real *w, dehyst_real *out, long n);

#ifdef __cplusplus
}
#endif
#endif
