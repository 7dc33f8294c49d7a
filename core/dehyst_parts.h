/* What the evaluators share: private to the core. */
#ifndef DEHYST_PARTS_H
#define DEHYST_PARTS_H

#include "dehyst.h"

#include <stddef.h>

static inline int is_finite(dehyst_real a) { return a - a == 0; }

static inline dehyst_real magnitude(dehyst_real a) { return a < 0 ? -a : a; }

/* Whether a displacement can be computed with: beyond, products with stiffnesses overflow. Not a number is not. */
#define DEHYST_FARTHEST (1 / DEHYST_EPSILON / DEHYST_EPSILON)
static inline int within_reach(dehyst_real a) { return a >= -DEHYST_FARTHEST && a <= DEHYST_FARTHEST; }

/* The number of entries of a[0..n-1], increasing, that are <= u; the answer is sought near the hint first. A negative
 * hint counts as n. */
static inline int count_below(const dehyst_real *a, int n, dehyst_real u, int hint)
{
    int low = 0, high = n, i = (unsigned)hint < (unsigned)n ? hint : n, tries;
    for (tries = 0; tries < 3; tries++) {
        if (i < n && a[i] <= u)
            low = ++i;
        else if (i > 0 && a[i - 1] > u)
            high = --i;
        else
            return i;
    }
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (a[middle] <= u)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The segment of the curve that holds x: knot_j <= x < knot_{j+1}, the end segments being unbounded. */
static inline int segment(const dehyst_curve *curve, dehyst_real x, int hint)
{
    return count_below(curve->knot + 1, curve->size - 2, x, hint);
}

static inline dehyst_real on_segment(const dehyst_curve *curve, int j, dehyst_real x)
{
    return curve->value[j] + curve->slope[j] * (x - curve->knot[j]);
}

/* The index of the cell of 2 phi(u / 2) that holds u >= 0. Rounding of huge displacements may leave any u, also one that
 * is not a number: a conversion to int is defined only where it fits. */
static inline int cell_of(const dehyst_slip *slip, dehyst_real u, int hint)
{
    if (slip->inverse_step > 0) {
        const dehyst_real guess = u * slip->inverse_step;
        hint = !(guess < slip->size) ? slip->size : guess > 0 ? (int)guess : 0;
    }
    return count_below(slip->edge, slip->size, u, hint);
}

static inline dehyst_real masing(const dehyst_slip *slip, int cell, dehyst_real u)
{
    return slip->intercept[cell] + slip->stiffness[cell] * u;
}

/* The reversal at which the present branch joins the outer one again, or NULL on an outermost branch. */
static inline const dehyst_reversal *joint(const dehyst_stack *stack)
{
    return stack->depth >= 3 ? stack->reversal + stack->depth - 2 : NULL;
}

/* Turn round at the stack's place, where the elements hold `stops`. */
void dehyst_stack_turn(const dehyst_slip *slip, dehyst_stack *stack, dehyst_real stops);

/* What a motion in one direction meets at y: voltage, slope, and the place of the next change of slope. */
typedef struct outlook {
    dehyst_real v, slope, event;
} outlook;

outlook dehyst_look_ahead(const dehyst_actuator *actuator, const dehyst_state *state, dehyst_real y,
                          dehyst_real direction);
dehyst_real dehyst_grades_voltage(const dehyst_wide *wide, const dehyst_state *state);
void dehyst_grades_compensate(const dehyst_wide *wide, dehyst_state *state, dehyst_real *held, int *where,
                              const dehyst_real *y, dehyst_real *v, long n);
outlook dehyst_grades_look_ahead(const dehyst_wide *wide, const dehyst_state *state, dehyst_real y,
                                 dehyst_real direction);

/* In a direction from w, of the plain or the graded elements and the spring. */
static inline outlook look_ahead(const dehyst_wide *wide, const dehyst_state *memory, dehyst_real w,
                                 dehyst_real direction)
{
    return wide->grades.size > 0 ? dehyst_grades_look_ahead(wide, memory, w, direction)
                                 : dehyst_look_ahead(&wide->plain, memory, w, direction);
}

/* Where a cart at b is left by a motion that ends at y. */
static inline dehyst_real dragged(dehyst_real b, dehyst_real y, dehyst_real rho)
{
    const dehyst_real low = y - rho, high = y + rho;
    b = b < low ? low : b;
    return b > high ? high : b;
}

/* Voltage after a motion that ends at y, and where the carts are then. */
static inline dehyst_real voltage_after(const dehyst_actuator *actuator, const dehyst_real *restrict cart, dehyst_real y,
                                        dehyst_real *restrict after, int *restrict hint)
{
    const dehyst_slip *slip = &actuator->slip;
    const dehyst_real *restrict rho = slip->rho, *restrict kappa = slip->kappa;
    /* Sums side by side need not wait for one another. */
    dehyst_real sum[4];
    int i = 0, k;
    /* Not an initialiser: that may call memset. */
    sum[0] = sum[1] = sum[2] = sum[3] = 0;
    for (; i + 4 <= slip->size; i += 4)
        for (k = 0; k < 4; k++) {
            after[i + k] = dragged(cart[i + k], y, rho[i + k]);
            sum[k] += kappa[i + k] * (y - after[i + k]);
        }
    for (k = 0; i < slip->size; i++, k++) {
        after[i] = dragged(cart[i], y, rho[i]);
        sum[k] += kappa[i] * (y - after[i]);
    }
    *hint = segment(&actuator->spring, y, *hint);
    return ((sum[0] + sum[2]) + (sum[1] + sum[3])) + on_segment(&actuator->spring, *hint, y);
}

/* Move the carts and smooth elements to the w at which G(w) + stiffness (w - w_old) = drive, G what they and the spring
 * hold. The likely direction is tried first, and is put right. Returns w; nothing moves if it is not within reach. */
dehyst_real dehyst_wide_solve(const dehyst_wide *wide, dehyst_wide_state *state, dehyst_real drive,
                              dehyst_real stiffness, dehyst_real *likely);
/* What smooth elements would hold after a motion by `by`. */
dehyst_real dehyst_smooth_held_after(const dehyst_smooth *smooth, const dehyst_real *elongation, dehyst_real by);

/* 1 - exp(-x) for x >= 0, ln(1 + a) for 0 <= a <= 1: without a mathematics library. */
dehyst_real dehyst_decay(dehyst_real x);
dehyst_real dehyst_log1p(dehyst_real a);
dehyst_status dehyst_smooth_check(const dehyst_smooth *smooth, const dehyst_real *elongation);
dehyst_real dehyst_smooth_held(const dehyst_smooth *smooth, const dehyst_real *elongation);
/* Add what smooth elements hold along a path that begins at y. */
void dehyst_smooth_compensate(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real y,
                              const dehyst_real *path, dehyst_real *v, long n);
/* Move everything but creep to the w at which G(w) + sum_l k_l q_l + stiffness (w - w_old) = drive. */
dehyst_real dehyst_smooth_solve(const dehyst_wide *wide, dehyst_wide_state *state, dehyst_real drive,
                                dehyst_real stiffness, dehyst_real *likely);

/* A straight piece of the present branch: y = start + (v - v_start) / slope until v reaches v_end; and the way back from
 * any of its points while no cart moves, down to `bottom`, which is a place times the direction. */
typedef struct piece {
    dehyst_real start, v_start, inverse_slope, v_end, inverse_elastic, bottom;
    int cell, j;
    int ends_at_knot; /* the next piece lies in the next segment of the spring; else in the next cell */
} piece;

/* A simulation on the stack whose voltages are not known ahead. Until it ends, the stack holds the farthest point of its
 * branch. */
typedef struct dehyst_walk {
    const dehyst_actuator *actuator;
    dehyst_stack *stack;
    dehyst_real y, v;
    piece *now, *ahead;
    int on_piece;
    piece pieces[2];
} dehyst_walk;

void dehyst_walk_begin(dehyst_walk *walk, const dehyst_actuator *actuator, dehyst_stack *stack);
dehyst_real dehyst_walk_to(dehyst_walk *walk, dehyst_real v);
void dehyst_walk_end(dehyst_walk *walk);

#endif
