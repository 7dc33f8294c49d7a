/* Functions that the sources of the core share; private to them. */
#ifndef DEHYST_INTERNAL_H
#define DEHYST_INTERNAL_H

#include "dehyst_model.h"

#include <stddef.h>

/* With such flags the compiler assumes that there is no NaN: is_finite would be 1, and a NaN could become a voltage. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || defined(_M_FP_FAST)
#error "dehyst: leave out -ffast-math, -Ofast, -ffinite-math-only, /fp:fast: with them a NaN is not refused"
#endif

static inline int is_finite(dehyst_real a) { return (a - a) == 0; }

static inline dehyst_real magnitude(dehyst_real a) { return (a < 0) ? -a : a; }

/* Return whether a displacement is small enough that products with stiffnesses do not overflow; 0 for NaN. */
#define DEHYST_FARTHEST (1 / DEHYST_EPSILON / DEHYST_EPSILON)
static inline int within_reach(dehyst_real a) { return (a >= -DEHYST_FARTHEST) && (a <= DEHYST_FARTHEST); }

/* Return the number of entries of the increasing a [n] that are <= u; search near the hint first (negative: n). */
static inline int count_below(const dehyst_real *a, int n, dehyst_real u, int hint)
{
    int low = 0, high = n, i = ((unsigned)hint < (unsigned)n) ? hint : n, tries;
    for (tries = 0; tries < 2; tries++) {
        if ((i < n) && (a[i] <= u)) {
            low = ++i;
        } else if ((i > 0) && (a[i - 1] > u)) {
            high = --i;
        } else {
            return i;
        }
    }
    while (low < high) {
        /* No branch here: a processor cannot predict the side of a far u. */
        const int middle = low + ((high - low) / 2), below = -(a[middle] <= u);
        low += below & (middle + 1 - low);
        high += ~below & (middle - high);
    }
    return low;
}

/* Return the segment of the curve that holds x: knot_j <= x < knot_{j+1}; the end segments are unbounded. */
static inline int segment(const dehyst_curve *curve, dehyst_real x, int hint)
{ return count_below(curve->knot + 1, curve->size - 2, x, hint); }

static inline dehyst_real on_segment(const dehyst_curve *curve, int j, dehyst_real x)
{ return curve->value[j] + (curve->slope[j] * (x - curve->knot[j])); }

/* The straight segment of a branch at y, for a motion in one direction: voltage, slope, and its end. */
typedef struct branch_segment {
    dehyst_real v, slope, event;
} branch_segment;

/* Check n elements as dehyst_slip_tabulate does, without its tables. */
dehyst_status dehyst_slip_check(int n, const dehyst_real *rho, const dehyst_real *kappa);
branch_segment dehyst_plain_look_ahead(const dehyst_plain *plain, const dehyst_plain_state *state, dehyst_real y,
                                       dehyst_real direction);
dehyst_real dehyst_grades_voltage(const dehyst_actuator *actuator, const dehyst_plain_state *state);
void dehyst_grades_compensate(const dehyst_actuator *actuator, dehyst_plain_state *state, dehyst_real *at_cart,
                              int *where, const dehyst_real *y, dehyst_real *v, long n);
branch_segment dehyst_grades_look_ahead(const dehyst_actuator *actuator, const dehyst_plain_state *state, dehyst_real y,
                                        dehyst_real direction);

/* Return the stiffness of a graded element whose cart slides with y in a direction. */
dehyst_real dehyst_grades_stiffness(const dehyst_actuator *actuator, int i, dehyst_real y, dehyst_real direction);

/* Return the segment of the plain or graded elements and the spring that begins at w. */
static inline branch_segment look_ahead(const dehyst_actuator *actuator, const dehyst_plain_state *memory,
                                        dehyst_real w, dehyst_real direction)
{
    return (actuator->grades.size > 0) ? dehyst_grades_look_ahead(actuator, memory, w, direction)
                                       : dehyst_plain_look_ahead(&actuator->plain, memory, w, direction);
}

/* Return the place of a cart, before at b, after a motion that ends at y. */
static inline dehyst_real cart_after(dehyst_real b, dehyst_real y, dehyst_real rho)
{
    const dehyst_real low = y - rho, high = y + rho;
    b = (b < low) ? low : b;
    return (b > high) ? high : b;
}

/* Return the voltage after a motion that ends at y, and the carts after it. */
static inline dehyst_real voltage_after(const dehyst_plain *plain, const dehyst_real *restrict cart, dehyst_real y,
                                        dehyst_real *restrict after, int *restrict hint)
{
    const dehyst_slip *slip = &plain->slip;
    const dehyst_real *restrict rho = slip->rho, *restrict kappa = slip->kappa;
    /* Four independent sums run in parallel. */
    dehyst_real sum[4];
    int i = 0, k;
    /* No initialiser: it might call memset. */
    sum[0] = sum[1] = sum[2] = sum[3] = 0;
    for (; (i + 4) <= slip->size; i += 4) {
        for (k = 0; k < 4; k++) {
            after[i + k] = cart_after(cart[i + k], y, rho[i + k]);
            sum[k] += kappa[i + k] * (y - after[i + k]);
        }
    }
    for (k = 0; i < slip->size; i++, k++) {
        after[i] = cart_after(cart[i], y, rho[i]);
        sum[k] += kappa[i] * (y - after[i]);
    }
    *hint = segment(&plain->spring, y, *hint);
    return ((sum[0] + sum[2]) + (sum[1] + sum[3])) + on_segment(&plain->spring, *hint, y);
}

/* Move carts and smooth elements to the w at which G(w) + stiffness (w - w_old) = drive, G the voltage of these and the
 * spring, and return w. Nothing changes if w is not within reach.
 * @param likely direction to try first; the direction of the motion is written back */
dehyst_real dehyst_solve(const dehyst_actuator *actuator, dehyst_state *state, dehyst_real drive, dehyst_real stiffness,
                         dehyst_real *likely);
/* Return the voltage of smooth elements after a motion over `by`, without a change of their state. */
dehyst_real dehyst_smooth_voltage_after(const dehyst_smooth *smooth, const dehyst_real *elongation, dehyst_real by);

/* Return the displacement with creep behind the elements; m is the displacement without it. */
static inline dehyst_real crept(const dehyst_output *output, const dehyst_real *strain, dehyst_real m)
{
    dehyst_real y = output->at_rest * m;
    int k;
    for (k = 0; k < output->branches; k++) { y -= output->gain[k] * strain[k]; }
    return y;
}

/* Return the m that leads to y at the end of a step that begins at `before`. */
static inline dehyst_real not_crept(const dehyst_output *output, const dehyst_real *strain, dehyst_real before,
                                    dehyst_real y)
{
    int k;
    for (k = 0; k < output->branches; k++) {
        y += output->gain[k] * ((output->decay[k] * strain[k]) - (output->rise[k] * before));
    }
    return y / output->at_once;
}

/* Move creep behind the elements through a step in which m moves over `by`. */
static inline void creep_on(const dehyst_output *output, dehyst_real *strain, dehyst_real by)
{
    int k;
    for (k = 0; k < output->branches; k++) { strain[k] = (output->decay[k] * strain[k]) + (output->rise[k] * by); }
}

/* Check the strains of creep behind the elements at the start of a loop. */
dehyst_status dehyst_start_check(const dehyst_model *model);

/* Return 1 - exp(-x) for x >= 0, without a mathematics library. */
dehyst_real dehyst_decay(dehyst_real x);
/* Return ln(1 + a) for 0 <= a <= 1. */
dehyst_real dehyst_log1p(dehyst_real a);
dehyst_status dehyst_smooth_check(const dehyst_smooth *smooth, const dehyst_real *elongation);
/* Return the elongation r of element l, positive in the direction of motion, after a motion over `way` >= 0. */
dehyst_real dehyst_smooth_moved(const dehyst_smooth *smooth, int l, dehyst_real r, dehyst_real way);
dehyst_real dehyst_smooth_voltage(const dehyst_smooth *smooth, const dehyst_real *elongation);
/* Add the voltages of smooth elements along a path [n] that begins at y to v [n]. */
void dehyst_smooth_compensate(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real y,
                              const dehyst_real *path, dehyst_real *v, long n);
/* The same as dehyst_solve, with smooth elements. */
dehyst_real dehyst_smooth_solve(const dehyst_actuator *actuator, dehyst_state *state, dehyst_real drive,
                                dehyst_real stiffness, dehyst_real *likely);

/* At the end of a step y = offset + gain w; return the gain. */
static inline dehyst_real gain_of(const dehyst_actuator *actuator, const dehyst_transition *to)
{ return to->after[0] / (1 + (actuator->share * to->after[0])); }

/* Return the offset in the same equation. */
static inline dehyst_real offset_of(const dehyst_actuator *actuator, const dehyst_transition *to,
                                    const dehyst_state *state, dehyst_real load)
{
    return ((to->phi[0] * state->y) + (to->phi[1] * state->rate) + (to->before[0] * state->input) +
            (to->after[0] * load)) /
           (1 + (actuator->share * to->after[0]));
}

/* Move a mass through a step that ends at w and y. */
static inline void move_mass(const dehyst_actuator *actuator, const dehyst_transition *to, dehyst_state *state,
                             dehyst_real w, dehyst_real y, dehyst_real load)
{
    const dehyst_real input = w - (actuator->share * y) + load;
    state->rate =
        (to->phi[2] * state->y) + (to->phi[3] * state->rate) + (to->before[1] * state->input) + (to->after[1] * input);
    state->input = input;
    state->y = y;
}

#endif
