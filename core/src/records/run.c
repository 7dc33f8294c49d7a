#include "branch.h"
#include "reversals.h"

/* Number of samples of a block: it fits into the first-level cache and the stack of a small processor. */
#define BLOCK 64
/* Runs shorter than this are not worth a stack of reversals. */
#define SHORT 12

long dehyst_equal_steps(const dehyst_real *time, long first, long n)
{
    const dehyst_real step = time[first] - time[first - 1], begin = magnitude(time[0]), end = magnitude(time[n - 1]);
    const dehyst_real allowance = (dehyst_real)1e-9 * step + 4 * DEHYST_EPSILON * (begin > end ? begin : end);
    long t = first + 1;
    while (t < n && time[t] > time[t - 1] && magnitude(time[t] - time[t - 1] - step) <= allowance) t++;
    return t;
}

/* Replace n values by their values on a curve. */
static void map(const dehyst_curve *curve, dehyst_real *a, long n)
{
    int j = curve->size / 2;
    long t;
    for (t = 0; t < n; t++) {
        j = segment(curve, a[t], j);
        a[t] = on_segment(curve, j, a[t]);
    }
}

/* Compute the voltages of the elements and the spring along the path w. */
static void slip_and_spring(const dehyst_actuator *actuator, dehyst_plain_state *memory, dehyst_workspace *workspace,
                            const dehyst_real *w, dehyst_real *drive, long n)
{
    long t;
    if (actuator->grades.size > 0)
        dehyst_grades_compensate(actuator, memory, workspace->at_cart, workspace->segment, w, drive, n);
    else if (workspace->stack.reversal != NULL && n >= SHORT)
        dehyst_plain_compensate_run(&actuator->plain, memory, &workspace->stack, w, drive, n);
    else
        for (t = 0; t < n; t++) drive[t] = dehyst_plain_compensate(&actuator->plain, memory, w[t]);
}

void dehyst_compensate_run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_workspace *workspace,
                           const dehyst_real *w, const dehyst_real *extra_voltage, dehyst_real *v, long n)
{
    const dehyst_real begin = state->memory.y;
    long t;
    slip_and_spring(actuator, &state->memory, workspace, w, v, n);
    if (actuator->smooth.size > 0) dehyst_smooth_compensate(&actuator->smooth, state->elongation, begin, w, v, n);
    if (extra_voltage != NULL)
        for (t = 0; t < n; t++) v[t] += extra_voltage[t];
    if (actuator->inverse_transformer.size > 0) map(&actuator->inverse_transformer, v, n);
}

/* The equations at the end of a step: R(w) + known + stiffness (w - w_old) = tau(v), R the voltage of the elements and
 * the spring, and y = offset + gain w. Without inertia all are 0. */
typedef struct step_terms {
    dehyst_real stiffness, gain, known, offset;
} step_terms;

static step_terms step_terms_of(const dehyst_actuator *actuator, const dehyst_transition *step)
{
    step_terms terms = {0, 0, 0, 0};
    if (actuator->inertia) {
        terms.gain = gain_of(actuator, step);
        terms.stiffness = actuator->series * (1 - terms.gain);
    }
    return terms;
}

static void begin_step(const dehyst_actuator *actuator, const dehyst_transition *step, const dehyst_state *state,
                       dehyst_real w, dehyst_real load, step_terms *terms)
{
    terms->offset = offset_of(actuator, step, state, load);
    terms->known = actuator->series * ((1 - terms->gain) * w - terms->offset);
}

/* Move a mass to the end of a step, and return the displacement y. */
static dehyst_real end_step(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                            dehyst_real w, dehyst_real load, const step_terms *terms)
{
    move_mass(actuator, step, state, w, terms->offset + terms->gain * w, load);
    return state->y;
}

/* On the stack, a mass is a spring beside eta: R(w) + stiffness (w - knot_0) has reversals and branches like
 * R. On entry y holds tau(v). Return 0, with nothing done, if the carts have no stack. */
static int simulate_on_stack(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                             dehyst_workspace *workspace, const dehyst_real *load, dehyst_real *y, long n)
{
    const dehyst_curve *spring = &actuator->plain.spring;
    const dehyst_real base = spring->knot[0];
    step_terms terms = step_terms_of(actuator, step);
    dehyst_plain stiff = actuator->plain;
    dehyst_walk walk;
    int j;
    long t;
    for (j = 0; j < spring->size; j++)
        workspace->value[j] = spring->value[j] + terms.stiffness * (spring->knot[j] - base);
    for (j = 0; j + 1 < spring->size; j++) workspace->slope[j] = spring->slope[j] + terms.stiffness;
    stiff.spring.value = workspace->value;
    stiff.spring.slope = workspace->slope;
    if (dehyst_stack_encode(&stiff, &state->memory, &workspace->stack) != DEHYST_OK) return 0;
    dehyst_walk_begin(&walk, &stiff, &workspace->stack);
    for (t = 0; t < n; t++) {
        const dehyst_real before = walk.y, force = load != NULL ? load[t] : 0;
        dehyst_real w;
        begin_step(actuator, step, state, before, force, &terms);
        w = dehyst_walk_to(&walk, y[t] - terms.known + terms.stiffness * (before - base));
        y[t] = end_step(actuator, step, state, w, force, &terms);
    }
    dehyst_walk_end(&walk);
    dehyst_stack_decode(&stiff, &workspace->stack, &state->memory);
    return 1;
}

/* On entry y holds tau(v). The elements are computed by carts; samples on one straight segment move no cart. */
static void simulate_on_branches(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                                 dehyst_workspace *workspace, const dehyst_real *load, dehyst_real *y, long n)
{
    step_terms terms = step_terms_of(actuator, step);
    dehyst_branch branch;
    long t;
    dehyst_branch_begin(&branch, actuator, &state->memory);
    if (actuator->smooth.size > 0) dehyst_smooth_prepare(&actuator->smooth, workspace->smooth);
    for (t = 0; t < n; t++) {
        const dehyst_real before = branch.w, force = load != NULL ? load[t] : 0;
        dehyst_real drive = y[t], w;
        if (actuator->inertia) {
            begin_step(actuator, step, state, before, force, &terms);
            drive -= terms.known;
        }
        w = actuator->smooth.size > 0
                ? dehyst_branch_solve_smooth(&branch, state, drive, terms.stiffness, workspace->smooth)
                : dehyst_branch_solve(&branch, drive, terms.stiffness);
        y[t] = actuator->inertia ? end_step(actuator, step, state, w, force, &terms) : w;
    }
    dehyst_branch_end(&branch);
}

/* On entry y holds tau(v). */
static void simulate_in_time(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                             dehyst_workspace *workspace, const dehyst_real *load, dehyst_real *y, long n)
{
    step_terms terms = step_terms_of(actuator, step);
    dehyst_real likely = 1;
    long t;
    for (t = 0; t < n; t++) {
        const dehyst_real before = state->memory.y, force = load != NULL ? load[t] : 0;
        dehyst_real w;
        if (workspace != NULL && workspace->stack.reversal != NULL && n - t >= SHORT && t % BLOCK == 0 &&
            simulate_on_stack(actuator, step, state, workspace, load != NULL ? load + t : NULL, y + t, n - t))
            return;
        begin_step(actuator, step, state, before, force, &terms);
        w = dehyst_solve(actuator, state, y[t] - terms.known, terms.stiffness, &likely);
        y[t] = end_step(actuator, step, state, w, force, &terms);
    }
}

void dehyst_simulate_run(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                         dehyst_workspace *workspace, const dehyst_real *v, const dehyst_real *load, dehyst_real *y,
                         long n)
{
    const int alone = actuator->grades.size > 0 || actuator->smooth.size > 0;
    dehyst_real likely = 1;
    long t;
    for (t = 0; t < n; t++) y[t] = v[t];
    if (actuator->transformer.size > 0) map(&actuator->transformer, y, n);
    if (alone && n >= SHORT && workspace->stack.reversal != NULL)
        simulate_on_branches(actuator, step, state, workspace, load, y, n);
    else if (actuator->inertia)
        simulate_in_time(actuator, step, state, alone ? NULL : workspace, load, y, n);
    else if (!alone && workspace->stack.reversal != NULL)
        dehyst_plain_simulate_run(&actuator->plain, &state->memory, &workspace->stack, y, y, n);
    else
        for (t = 0; t < n; t++) y[t] = dehyst_solve(actuator, state, y[t], 0, &likely);
}

void dehyst_strains(int branches, const dehyst_real *decay, const dehyst_real *rise, dehyst_real *strain,
                    dehyst_real before, const dehyst_real *w, dehyst_real *out, long n)
{
    long t;
    int j;
    for (t = 0; t < n; t++) {
        const dehyst_real move = is_finite(w[t]) ? w[t] - before : 0;
        before += move;
        for (j = 0; j < branches; j++) {
            strain[j] = decay[j] * strain[j] + rise[j] * move;
            *out++ = strain[j];
        }
    }
}

void dehyst_output_simulate(const dehyst_output *output, dehyst_real *strain, dehyst_real before, const dehyst_real *m,
                            dehyst_real *y, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        const dehyst_real now = m[t];
        creep_on(output, strain, now - before);
        before = now;
        y[t] = crept(output, strain, now);
    }
}

void dehyst_output_compensate(const dehyst_output *output, dehyst_real *strain, dehyst_real before,
                              const dehyst_real *y, dehyst_real *m, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        const dehyst_real now = not_crept(output, strain, before, y[t]);
        creep_on(output, strain, now - before);
        before = m[t] = now;
    }
}
