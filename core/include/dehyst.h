/* dehyst: hysteresis of a piezoelectric actuator, voltage <-> displacement, exact in both directions.
 *
 * With y the displacement and v the voltage (the paper's F = T v seen at the terminals, y = (keq/km) x):
 *
 *     v = sum_i kappa_i s_i + eta(y),      s_i = y - b_i,      b_i <- min(max(b_i, y - rho_i), y + rho_i)
 *
 *   kappa_i  stiffness of Maxwell-slip element i [V/m], >= 0      rho_i  its breakaway elongation [m], > 0, increasing
 *   b_i      position of cart i [m]                               eta    the parallel spring [V], increasing, piecewise
 *                                                                        linear, continued so beyond its knots
 *
 * y -> v (compensate) is explicit; v -> y (simulate) has exactly one solution and is solved segment by segment, with
 * neither tolerance nor time step: N clips a sample, constant memory, any state.
 *
 * No heap, no input or output, no globals. Every array belongs to the caller; parameters are const and may live in
 * flash. Checks may fail, steps cannot; a step takes bounded time. A sample that is not a number moves nothing.
 */
#ifndef DEHYST_H
#define DEHYST_H

#include "dehyst_config.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum dehyst_status {
    DEHYST_OK = 0,
    DEHYST_ERR_SIZE = -1,        /* fewer than two knots, a negative count, or a null array */
    DEHYST_ERR_FINITE = -2,      /* not a number, or infinite */
    DEHYST_ERR_ORDER = -3,       /* knots, spring voltages or breakaway elongations not strictly increasing */
    DEHYST_ERR_SIGN = -4,        /* a negative stiffness, or a breakaway elongation that is not positive */
    DEHYST_ERR_STATE = -5,       /* a cart farther from y than its breakaway elongation, or a smooth element longer
                                  * than its length */
    DEHYST_ERR_CAPACITY = -6,    /* fewer reversals than DEHYST_STACK_CAPACITY(N) */
    DEHYST_ERR_UNREACHABLE = -7  /* carts that no history from rest leaves: use the carts until they are wiped out */
} dehyst_status;

/* A strictly increasing piecewise-linear curve, continued linearly beyond its ends. */
typedef struct dehyst_curve {
    int size;                 /* knots, >= 2 */
    const dehyst_real *knot;  /* [size] */
    const dehyst_real *value; /* [size] */
    const dehyst_real *slope; /* [size - 1] */
} dehyst_curve;

/* N Maxwell-slip elements in parallel. The last three arrays are made by dehyst_slip_tabulate. */
typedef struct dehyst_slip {
    int size;                     /* N >= 0 */
    const dehyst_real *rho;       /* [N] breakaway elongations */
    const dehyst_real *kappa;     /* [N] stiffnesses */
    const dehyst_real *edge;      /* [N + 1] 2 rho_i, then the largest number */
    const dehyst_real *intercept; /* [N + 1] 2 phi(u / 2) = intercept_i + stiffness_i u between edges i - 1 and i */
    const dehyst_real *stiffness; /* [N + 1] */
    dehyst_real inverse_step;     /* 1 / edge_0 on a uniform grid, else 0 */
} dehyst_slip;

typedef struct dehyst_actuator {
    dehyst_slip slip;
    dehyst_curve spring;
} dehyst_actuator;

typedef struct dehyst_state {
    dehyst_real y;
    dehyst_real *cart; /* [N] */
} dehyst_state;

/* Graded elements: psi_i(y) - psi_i(b_i) in place of kappa_i s_i, the stiffness depends on where the cart sits. The
 * psi_i bend at common knots and go on beyond them; the last rows and the values are made by dehyst_grades_tabulate. */
typedef struct dehyst_grades {
    int size;                 /* M segments; 0: the elements are plain */
    const dehyst_real *knot;  /* [M + 1] */
    const dehyst_real *value; /* [(N + 1) (M + 1)] psi_i at the knots, 0 at the first; then their sum */
    const dehyst_real *slope; /* [(N + 1) M] kappa_im >= 0; then their sum */
} dehyst_grades;

/* Smooth elements: k_l q_l, dq = dy (1 - |q / length| (closing sgn(q dy) + 1 - closing)), |q_l| <= length_l, closing 1/2
 * to 1 (Dahl; Bouc and Wen). `back` is made by dehyst_smooth_tabulate. */
typedef struct dehyst_smooth {
    int size;                     /* L; 0: none */
    const dehyst_real *length;    /* [L] > 0 */
    const dehyst_real *back;      /* [L] (2 closing - 1) / length */
    const dehyst_real *stiffness; /* [L] k_l [V/m], >= 0 */
} dehyst_smooth;

/* The wider actuator: tau(v) = sum_i [psi_i(w) - psi_i(b_i)] + eta(w) + sum_j c_j d_j + sum_l k_l q_l + beta (w - y).
 * Its slip elements, in `plain`, are those of the plain class, or lend the graded ones their size and breakaway
 * elongations; the stiffnesses are then left alone. On every outermost branch the right-hand side must increase: then
 * it does on every other. */
typedef struct dehyst_wide {
    dehyst_actuator plain;
    dehyst_grades grades;
    dehyst_curve drive;           /* tau; size 0: none */
    dehyst_curve voltage;         /* its inverse: the same knots, axes exchanged */
    int branches;                 /* J >= 0 of creep */
    const dehyst_real *stiffness; /* [J] c_j [V/m], >= 0 */
    int inertia;                  /* 0: y is w, and beta is left alone */
    dehyst_real series;           /* beta [V/m], >= 0 */
    dehyst_real share;            /* theta = beta / (K + beta), K a mean slope of eta */
    dehyst_smooth smooth;
} dehyst_wide;

/* One step of y'' + 2 zeta omega y' + omega^2 (1 - theta) y = omega^2 q, exact for q = w - theta y + F_ext/kc linear in
 * time: (y, y'/omega) <- phi (y, y'/omega) + before q_old + after q_new. Without duration phi is 1, the others 0. */
typedef struct dehyst_transition {
    dehyst_real phi[4], before[2], after[2];
} dehyst_transition;

/* What a step of time does, worked out by the caller: d_j <- decay_j d_j + gain_j (w_new - w_old), for w linear in
 * time decay = exp(-dt/tau_j) and gain = (1 - decay) tau_j/dt, both 1 for a step without duration. */
typedef struct dehyst_pace {
    const dehyst_real *decay; /* [J] */
    const dehyst_real *gain;  /* [J] */
    dehyst_transition transition;
} dehyst_pace;

typedef struct dehyst_wide_state {
    dehyst_state memory;     /* w and the carts */
    dehyst_real *strain;     /* [J] d_j [m] */
    dehyst_real *elongation; /* [L] q_l [m] of smooth elements */
    dehyst_real y, rate;     /* with inertia, y and y'/omega [m] */
    dehyst_real input;       /* q [m], made by the first step if that is one without duration */
} dehyst_wide_state;

/* slope [size - 1] from knots and values. */
dehyst_status dehyst_curve_tabulate(int size, const dehyst_real *knot, const dehyst_real *value, dehyst_real *slope);
/* edge, intercept and stiffness [n + 1]; inverse_step [1]. */
dehyst_status dehyst_slip_tabulate(int n, const dehyst_real *rho, const dehyst_real *kappa, dehyst_real *edge,
                                   dehyst_real *intercept, dehyst_real *stiffness, dehyst_real *inverse_step);
dehyst_status dehyst_state_check(const dehyst_actuator *actuator, const dehyst_state *state);

dehyst_real dehyst_curve_at(const dehyst_curve *curve, dehyst_real x);
dehyst_real dehyst_curve_inverse(const dehyst_curve *curve, dehyst_real value);

/* Move every cart to where a displacement of y leaves it. */
void dehyst_slip_move(const dehyst_slip *slip, dehyst_real *cart, dehyst_real y);
/* The same for n samples; out [n N], a row a sample, receives the elongations s_i = y - b_i. */
void dehyst_slip_stops(const dehyst_slip *slip, dehyst_real *cart, const dehyst_real *y, dehyst_real *out, long n);
/* Voltage at the present state. */
dehyst_real dehyst_voltage(const dehyst_actuator *actuator, const dehyst_state *state);
/* The voltage that brings the actuator to y (Eq. 11), the displacement that v brings it to; O(N) and O(N events). */
dehyst_real dehyst_compensate_step(const dehyst_actuator *actuator, dehyst_state *state, dehyst_real y);
dehyst_real dehyst_simulate_step(const dehyst_actuator *actuator, dehyst_state *state, dehyst_real v);

/* The last row of slope, and value, from knots and the first n rows of slope; the sums may be zero in places. */
dehyst_status dehyst_grades_tabulate(int n, int m, const dehyst_real *knot, dehyst_real *slope, dehyst_real *value);
/* back [n] from lengths and closings. */
dehyst_status dehyst_smooth_tabulate(int n, const dehyst_real *length, const dehyst_real *closing, dehyst_real *back);
/* Elongations after a motion by `by`, exact for any; then along a path that begins at y: out [n L], a row a sample. */
void dehyst_smooth_move(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real by);
void dehyst_smooth_elongations(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real y,
                               const dehyst_real *path, dehyst_real *out, long n);
dehyst_status dehyst_wide_check(const dehyst_wide *wide, const dehyst_wide_state *state);
/* Voltage at the present state. */
dehyst_real dehyst_wide_voltage(const dehyst_wide *wide, const dehyst_wide_state *state);
/* What a step would lead to: w, its voltage, and the carts there, which are exchanged with the state's when it is
 * fulfilled. The hint is the spring's segment, 0 at first. */
typedef struct dehyst_wish {
    dehyst_real w, v;
    dehyst_real *cart; /* [N] */
    int hint;
} dehyst_wish;

/* A step as above alone. `stiffness` is what moves in time adds to the slope of voltage over w within a step. A wish, whose
 * w is given, moves nothing. The others move, to the wish just made or to where v leads, and return the displacement that
 * is seen. If v leads farther than can be computed, nothing but time moves, and that far place or not a number returns. */
dehyst_real dehyst_wide_stiffness(const dehyst_wide *wide, const dehyst_pace *pace);
void dehyst_wide_wish(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_wide_state *state,
                      dehyst_real stiffness, dehyst_wish *wish);
dehyst_real dehyst_wide_fulfil(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                               dehyst_wish *wish);
dehyst_real dehyst_wide_simulate_step(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                                      dehyst_real stiffness, dehyst_real v);
/* A compensator in a loop: a wanted displacement in, a voltage within limits out, equal times apart. w is asked to be
 * sum_m tap_m u_(t-m), u the displacements fed, newest first: with what a delay and a mass ask for, u runs ahead.
 * An amplifier that lags by `lag` periods acts with a_t = keep a_(t-1) + from_old v_(t-1) + from_new v_t. `stiffness` is made by
 * dehyst_compensator_tabulate, which also checks. */
typedef struct dehyst_compensator {
    dehyst_wide wide;
    dehyst_pace pace;       /* of one period */
    dehyst_real low, high;  /* limits of v */
    dehyst_real change;     /* largest change of v in a period; DEHYST_LARGEST: any */
    int taps;               /* >= 1 */
    const dehyst_real *tap; /* [taps] */
    dehyst_real lag;        /* 0: none, and the three are left alone */
    dehyst_real keep, from_old, from_new;
    dehyst_real stiffness;
} dehyst_compensator;

typedef enum dehyst_offer {
    DEHYST_NOTHING = 0, /* nothing is on offer: the last voltage is held */
    DEHYST_WISHED = 1,
    DEHYST_LIMITED = 2, /* cut at a limit */
    DEHYST_SLEWED = 3,  /* held back by the slew rate */
    DEHYST_REFUSED = 4  /* not a number was asked for: the last voltage is held */
} dehyst_offer;

typedef struct dehyst_loop {
    dehyst_wide_state state;
    dehyst_real *fed;      /* [taps], newest first */
    dehyst_real sent;      /* the last voltage */
    dehyst_real acting;    /* what the amplifier makes of it */
    dehyst_real wished[2]; /* the last two voltages that were to act */
    dehyst_real asked;     /* on offer: u, the wish it stands for, and what of that may be sent */
    dehyst_wish wish;
    dehyst_real voltage;
    dehyst_offer offer;
    unsigned long limited, slewed, refused; /* samples committed */
} dehyst_loop;

dehyst_status dehyst_compensator_tabulate(dehyst_compensator *compensator);
/* Start from loop->state, at rest at the voltage that holds it, as if its displacement had been fed for ever. If that
 * voltage lies outside the limits the nearest of them is taken to have been sent. */
dehyst_status dehyst_loop_begin(const dehyst_compensator *compensator, dehyst_loop *loop);
/* The voltage for u. Nothing moves until it is committed: a voltage that was not sent leaves no trace. */
dehyst_real dehyst_loop_offer(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real u);
/* Whether v may have been sent: it lies no farther outside the limits than they are apart. */
int dehyst_loop_believes(const dehyst_compensator *compensator, dehyst_real v);
/* A period has passed with the voltage v: what is on offer, or another that was really sent; one that is not believed is
 * counted as refused, and the last one is taken to act on. */
void dehyst_loop_commit(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v);
/* A period has passed with any voltage: the actuator alone, without limits. One that leads farther than can be computed
 * moves nothing and is counted as refused. */
void dehyst_loop_play(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v);
/* Offer and commit; then n of them. */
dehyst_real dehyst_loop_step(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real u);
void dehyst_loop_run(const dehyst_compensator *compensator, dehyst_loop *loop, const dehyst_real *u, dehyst_real *v,
                     long n);

#ifdef __cplusplus
}
#endif
#endif
