/* What the sources of the core share: private to them. */
#ifndef DEHYST_INTERNAL_H
#define DEHYST_INTERNAL_H

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

/* What creep would hold at the end of so many steps without motion, one or two. */
static inline dehyst_real held_over(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_real *strain,
                                    int steps)
{
    dehyst_real sum[4];
    int j, i;
    sum[0] = sum[1] = sum[2] = sum[3] = 0;
    for (j = 0; j + 4 <= wide->branches; j += 4)
        for (i = 0; i < 4; i++) {
            const dehyst_real once = pace->decay[j + i] * strain[j + i];
            sum[i] += wide->stiffness[j + i] * (steps > 1 ? pace->decay[j + i] * once : once);
        }
    for (i = 0; j < wide->branches; j++, i++) {
        const dehyst_real once = pace->decay[j] * strain[j];
        sum[i] += wide->stiffness[j] * (steps > 1 ? pace->decay[j] * once : once);
    }
    return (sum[0] + sum[2]) + (sum[1] + sum[3]);
}

static inline void creep_on(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_real *strain, dehyst_real by)
{
    int j;
    for (j = 0; j < wide->branches; j++) strain[j] = pace->decay[j] * strain[j] + pace->gain[j] * by;
}

/* Of y = free + lever w at the end of a step: the lever, and what is free of w. */
static inline dehyst_real lever_of(const dehyst_wide *wide, const dehyst_transition *to)
{
    return to->after[0] / (1 + wide->share * to->after[0]);
}

static inline dehyst_real free_of(const dehyst_wide *wide, const dehyst_transition *to, const dehyst_wide_state *state,
                                  dehyst_real load)
{
    return (to->phi[0] * state->y + to->phi[1] * state->rate + to->before[0] * state->input + to->after[0] * load) /
           (1 + wide->share * to->after[0]);
}

static inline void swing_on(const dehyst_wide *wide, const dehyst_transition *to, dehyst_wide_state *state,
                            dehyst_real w, dehyst_real y, dehyst_real load)
{
    const dehyst_real input = w - wide->share * y + load;
    state->rate = to->phi[2] * state->y + to->phi[3] * state->rate + to->before[1] * state->input + to->after[1] * input;
    state->input = input;
    state->y = y;
}

#endif
