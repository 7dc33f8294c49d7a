/* The model of a piezoelectric actuator, voltage <-> displacement, exact in both directions.
 *
 * With y the displacement and v the voltage (in the paper F = T v, and y = (keq/km) x):
 *
 *     v = sum_i kappa_i s_i + eta(y),      s_i = y - b_i,      b_i <- min(max(b_i, y - rho_i), y + rho_i)
 *
 *   kappa_i  stiffness of Maxwell-slip element i [V/m], >= 0      rho_i  its breakaway elongation [m], > 0, increasing
 *   b_i      position of cart i [m]                               eta    the parallel spring [V], increasing, piecewise
 *                                                                        linear, continued so beyond its knots
 *
 * y -> v (compensate) is explicit. v -> y (simulate) has exactly one solution and is solved segment by segment, with
 * neither tolerance nor time step: N clips per sample, constant memory, from any state.
 *
 * Steps are in dehyst.h. To fill a dehyst_model by hand, fill its dehyst_actuator, call the functions *_tabulate for
 * its tables, then dehyst_model_tabulate. Every array belongs to the caller; its size is in brackets.
 */
#ifndef DEHYST_MODEL_H
#define DEHYST_MODEL_H

#include "dehyst.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A strictly increasing piecewise-linear curve, continued linearly beyond its ends. */
typedef struct dehyst_curve {
    int size;                 /* knots, >= 2 */
    const dehyst_real *knot;  /* [size] */
    const dehyst_real *value; /* [size] */
    const dehyst_real *slope; /* [size - 1] from dehyst_curve_tabulate */
} dehyst_curve;

/* N Maxwell-slip elements in parallel. The last four members are from dehyst_slip_tabulate; steps do not read them. */
typedef struct dehyst_slip {
    int size;                     /* N >= 0 */
    const dehyst_real *rho;       /* [N] breakaway elongations [m] */
    const dehyst_real *kappa;     /* [N] stiffnesses [V/m] */
    const dehyst_real *edge;      /* [N + 1] 2 rho_i, then the largest number */
    const dehyst_real *intercept; /* [N + 1] 2 phi(u / 2) = intercept_i + stiffness_i u between edges i - 1 and i */
    const dehyst_real *stiffness; /* [N + 1] */
    dehyst_real inverse_step;     /* 1 / edge_0 on a uniform grid, else 0 */
} dehyst_slip;

/* Maxwell-slip elements beside a spring: the plain actuator of the equation above. */
typedef struct dehyst_plain {
    dehyst_slip slip;
    dehyst_curve spring;
} dehyst_plain;

/* Memory of Maxwell-slip elements. */
typedef struct dehyst_plain_state {
    dehyst_real y;     /* [m] */
    dehyst_real *cart; /* [N] [m] */
} dehyst_plain_state;

/* Graded elements: psi_i(y) - psi_i(b_i) in place of kappa_i s_i; the stiffness depends on the place of the cart. The
 * psi_i have common knots and are continued beyond them. */
typedef struct dehyst_grades {
    int size;                 /* M segments; 0: the elements are plain */
    const dehyst_real *knot;  /* [M + 1] */
    const dehyst_real *value; /* [(N + 1) (M + 1)] psi_i at the knots, 0 at the first; the last row is their sum */
    const dehyst_real *slope; /* [(N + 1) M] kappa_im >= 0; the last row is their sum */
} dehyst_grades;

/* Smooth elements (Dahl; Bouc and Wen): k_l q_l with |q_l| <= length_l and, closing from 1/2 to 1,
 * dq = dy (1 - |q / length| (closing sgn(q dy) + 1 - closing)). */
typedef struct dehyst_smooth {
    int size;                     /* L; 0: none */
    const dehyst_real *length;    /* [L] > 0 */
    const dehyst_real *back;      /* [L] (2 closing - 1) / length, from dehyst_smooth_tabulate */
    const dehyst_real *stiffness; /* [L] k_l [V/m], >= 0 */
} dehyst_smooth;

/* The whole actuator: tau(v) = sum_i [psi_i(w) - psi_i(b_i)] + eta(w) + sum_l k_l q_l + beta (w - y).
 *
 * Its slip elements are `plain.slip`. With grades these give only N and the breakaway elongations; kappa is not read.
 * On each branch of the major loop the right-hand side must increase; then it increases on every branch. */
typedef struct dehyst_actuator {
    dehyst_plain plain;
    dehyst_grades grades;
    dehyst_curve transformer;           /* tau; size 0: none */
    dehyst_curve inverse_transformer;   /* the same knots, axes exchanged */
    int inertia;                        /* 0: y is w, and beta and theta are not read */
    dehyst_real series;                 /* beta [V/m], >= 0 */
    dehyst_real share;                  /* theta = beta / (K + beta), K a mean slope of eta */
    dehyst_smooth smooth;
} dehyst_actuator;

/* One step of y'' + 2 zeta omega y' + omega^2 (1 - theta) y = omega^2 q, exact for q = w - theta y + F_ext/kc linear in
 * time: (y, y'/omega) <- phi (y, y'/omega) + before q_old + after q_new. For duration 0 phi is 1, the others are 0. */
typedef struct dehyst_transition {
    dehyst_real phi[4], before[2], after[2];
} dehyst_transition;

typedef struct dehyst_state {
    dehyst_plain_state memory; /* w and the carts */
    dehyst_real *elongation;   /* [L] q_l [m] of smooth elements */
    dehyst_real y, rate;       /* with inertia, y and y'/omega [m] */
    dehyst_real input;         /* q [m]; a first step of duration 0 computes it */
} dehyst_state;

/* Check a curve and compute its slopes.
 * @param slope [size - 1] the result */
dehyst_status dehyst_curve_tabulate(int size, const dehyst_real *knot, const dehyst_real *value, dehyst_real *slope);
/* Check n elements and compute the tables that dehyst_records.h reads.
 * @param edge, intercept, stiffness [n + 1] the results
 * @param inverse_step [1] the result */
dehyst_status dehyst_slip_tabulate(int n, const dehyst_real *rho, const dehyst_real *kappa, dehyst_real *edge,
                                   dehyst_real *intercept, dehyst_real *stiffness, dehyst_real *inverse_step);
/* Check n graded elements of m segments and compute their values.
 * @param slope [(n + 1) m] its first n rows are read, its last row is a result; sums may be zero in some segments
 * @param value [(n + 1) (m + 1)] the result */
dehyst_status dehyst_grades_tabulate(int n, int m, const dehyst_real *knot, dehyst_real *slope, dehyst_real *value);
/* Check n smooth elements and compute `back`.
 * @param closing [n]
 * @param back [n] the result */
dehyst_status dehyst_smooth_tabulate(int n, const dehyst_real *length, const dehyst_real *closing, dehyst_real *back);

/* Check that a state is possible for the plain actuator. */
dehyst_status dehyst_plain_check(const dehyst_plain *plain, const dehyst_plain_state *state);
/* Check the numbers of smooth elements and mass, and that a state is possible for the actuator. */
dehyst_status dehyst_check(const dehyst_actuator *actuator, const dehyst_state *state);

/* Return the value of a curve at x. */
dehyst_real dehyst_curve_at(const dehyst_curve *curve, dehyst_real x);
/* Return the x at which a curve has a value. */
dehyst_real dehyst_curve_inverse(const dehyst_curve *curve, dehyst_real value);

/* Move the carts [N] to their places after a displacement to y. */
void dehyst_slip_move(const dehyst_slip *slip, dehyst_real *cart, dehyst_real y);
/* Move the carts along a path and return the elongations s_i = y - b_i.
 * @param y [n] the path
 * @param out [n N] the result, one row for each sample */
void dehyst_slip_elongations(const dehyst_slip *slip, dehyst_real *cart, const dehyst_real *y, dehyst_real *out,
                             long n);
/* Change elongations [L] by a motion over `by`, exact for a motion of any length. */
void dehyst_smooth_move(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real by);
/* Change elongations along a path that begins at y and return them.
 * @param path [n]
 * @param out [n L] the result, one row for each sample */
void dehyst_smooth_elongations(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real y,
                               const dehyst_real *path, dehyst_real *out, long n);

/* Return the voltage that holds a plain actuator in its state. */
dehyst_real dehyst_plain_voltage(const dehyst_plain *plain, const dehyst_plain_state *state);
/* Move a plain actuator to y and return the voltage for this motion (Eq. 11), in O(N). */
dehyst_real dehyst_plain_compensate(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_real y);
/* Apply a voltage to a plain actuator and return its displacement, in O(N) for each change of slope on the path. */
dehyst_real dehyst_plain_simulate(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_real v);

/* A displacement, the voltage of a step to it, and the memory after that step. */
typedef struct dehyst_candidate {
    dehyst_real w;     /* [m], given */
    dehyst_real v;     /* [V] */
    dehyst_real *cart; /* [N] carts after the step; dehyst_commit exchanges it with the array of the state */
    int hint;          /* segment of the spring; 0 at the start */
} dehyst_candidate;

/* Return the voltage that holds an actuator in its state. */
dehyst_real dehyst_voltage(const dehyst_actuator *actuator, const dehyst_state *state);
/* Return the part of a mass in the slope of the voltage over w within a step [V/m]. */
dehyst_real dehyst_step_stiffness(const dehyst_actuator *actuator, const dehyst_transition *step);
/* Compute the voltage of a candidate; the state does not change.
 * @param stiffness from dehyst_step_stiffness
 * @param candidate its w is read, the rest is the result */
void dehyst_evaluate(const dehyst_actuator *actuator, const dehyst_transition *step, const dehyst_state *state,
                     dehyst_real stiffness, dehyst_candidate *candidate);
/* Move to a candidate that was just evaluated in this state, and return the displacement y. */
dehyst_real dehyst_commit(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                          dehyst_candidate *candidate);
/* Apply a voltage and return the displacement y. If it is too large to compute, only time advances; the result is then
 * this displacement, or not a number.
 * @param stiffness from dehyst_step_stiffness */
dehyst_real dehyst_simulate_step(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                                 dehyst_real stiffness, dehyst_real v);

/* Creep in displacement, behind the elements and the mass: with m their displacement, w or y,
 *
 *     y = offset + gain ((1 + G) m - sum_k g_k e_k),   G = sum_k g_k,   e_k <- decay_k e_k + rise_k (m_new - m_old)
 *
 * so that e_k is m minus its low-pass, and m + sum_k g_k lowpass_k(m) creeps. Gain and offset belong to the loop. */
typedef struct dehyst_output {
    int branches;             /* K >= 0 */
    const dehyst_real *gain;  /* [K] g_k >= 0 */
    const dehyst_real *decay; /* [K] decay in a period, exp(-dt/tau_k) */
    const dehyst_real *rise;  /* [K] (1 - decay) tau_k/dt */
    dehyst_real at_rest;      /* 1 + G, from dehyst_output_tabulate */
    dehyst_real at_once;      /* 1 + G - sum_k g_k rise_k, from dehyst_output_tabulate */
} dehyst_output;

/* The start of a loop. */
typedef struct dehyst_start {
    dehyst_real w, y, rate;        /* [m] as in dehyst_state */
    const dehyst_real *cart;       /* [N] */
    const dehyst_real *elongation; /* [L] */
    const dehyst_real *crept;      /* [K] e_k of creep behind the elements */
} dehyst_start;

/* A compensator in a loop: wanted displacement in, voltage within limits out, at equal steps of time.
 *
 * The target of w is sum_m tap_m u_(t-m), with u the wanted displacements, newest first. The taps compensate a delay
 * and a mass; u is then given ahead of its time. An amplifier that lags by `lag` periods puts out
 * a_t = keep a_(t-1) + from_old v_(t-1) + from_new v_t. */
struct dehyst_model {
    dehyst_actuator actuator;
    dehyst_transition step; /* of one period */
    dehyst_output output;
    dehyst_real low, high;  /* limits of v [V] */
    dehyst_real change;     /* largest change of v in a period [V]; DEHYST_LARGEST: any */
    int taps;               /* >= 1 */
    const dehyst_real *tap; /* [taps] */
    dehyst_real lag;        /* 0: none, and the next three are not read */
    dehyst_real keep, from_old, from_new;
    dehyst_real stiffness; /* from dehyst_model_tabulate */
    dehyst_start start;
    dehyst_real period; /* [s]; 0: the model does not depend on time */
    int ahead;          /* number of samples by which a displacement is given before its time */
    unsigned long id;    /* checksum of all numbers except limits and start */
    unsigned long shape; /* checksum of the numbers that the memory depends on; snapshots hold it */
};

/* Check creep behind the elements and compute `at_rest` and `at_once`. */
dehyst_status dehyst_output_tabulate(dehyst_output *output);
/* Check a model, and compute its `stiffness` and the members of `output` that dehyst_output_tabulate computes. */
dehyst_status dehyst_model_tabulate(dehyst_model *model);
/* Return the count of numbers in the memory of a loop. */
unsigned long dehyst_memory_size(const dehyst_model *model);
/* Return whether v is plausible as a sent voltage: it exceeds the limits by at most the distance between them. */
int dehyst_loop_accepts(const dehyst_model *model, dehyst_real v);
/* Take n steps: u [n] to v [n]. */
void dehyst_loop_run(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, const dehyst_real *u,
                     dehyst_real *v, long n);

/* A model as one block of bytes, the same for every processor and both number types: `dehyst.exports.model_block`
 * writes it, and firmware, WebAssembly and Python load it. Little-endian; see core/src/block.c. */

/* Check the frame of a block: kind, format, length, checksum, sizes.
 * @param room [1] the result: count of numbers that dehyst_model_load needs */
dehyst_status dehyst_model_room(const unsigned char *bytes, unsigned long size, unsigned long *room);
/* Load a block: check every value, and compute the tables. Floats are rounded once, limits inward.
 * @param room [count] numbers that belong to the model after this call; the bytes are no longer needed
 * @param model the result; not to be used if the block is refused */
dehyst_status dehyst_model_load(const unsigned char *bytes, unsigned long size, dehyst_real *room, unsigned long count,
                                dehyst_model *model);
/* Write a block, and set the `id` and the `shape` of the model.
 * @return the number of bytes; nothing is written if `size` is smaller */
unsigned long dehyst_model_save(dehyst_model *model, unsigned char *bytes, unsigned long size);

#ifdef __cplusplus
}
#endif
#endif
