#include "reversals.h"

/* Samples that are worked on together: few enough to stay in the nearest cache and on a small processor's stack. */
#define BLOCK 64
/* Branches of creep that are moved together: constant, so that a compiler keeps them in its vector registers. */
#define LANES 8
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

/* Look up n values in place. */
static void map(const dehyst_curve *curve, dehyst_real *a, long n)
{
    int j = curve->size / 2;
    long t;
    for (t = 0; t < n; t++) {
        j = segment(curve, a[t], j);
        a[t] = on_segment(curve, j, a[t]);
    }
}

/* Move LANES branches through n steps of w and add what they hold. */
static void creep_together(const dehyst_real *stiffness, const dehyst_real *decay, const dehyst_real *gain,
                           dehyst_real *strain, const dehyst_real *move, dehyst_real *drive, int n)
{
    dehyst_real c[LANES], a[LANES], g[LANES], d[LANES], held[LANES];
    int j, t;
    for (j = 0; j < LANES; j++) {
        c[j] = stiffness[j];
        a[j] = decay[j];
        g[j] = gain[j];
        d[j] = strain[j];
    }
    for (t = 0; t < n; t++) {
        const dehyst_real by = move[t];
        for (j = 0; j < LANES; j++) d[j] = a[j] * d[j] + g[j] * by;
        for (j = 0; j < LANES; j++) held[j] = c[j] * d[j];
        drive[t] += ((held[0] + held[4]) + (held[2] + held[6])) + ((held[1] + held[5]) + (held[3] + held[7]));
    }
    for (j = 0; j < LANES; j++) strain[j] = d[j];
}

static void creep(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_real *strain, const dehyst_real *move,
                  dehyst_real *drive, int n)
{
    int j = 0, t;
    for (; j + LANES <= wide->branches; j += LANES)
        creep_together(wide->stiffness + j, pace->decay + j, pace->gain + j, strain + j, move, drive, n);
    for (; j < wide->branches; j++) {
        const dehyst_real c = wide->stiffness[j], a = pace->decay[j], g = pace->gain[j];
        dehyst_real d = strain[j];
        for (t = 0; t < n; t++) {
            d = a * d + g * move[t];
            drive[t] += c * d;
        }
        strain[j] = d;
    }
}

/* What the elements and the spring hold, over the path w. */
static void hold(const dehyst_wide *wide, dehyst_state *memory, dehyst_room *room, const dehyst_real *w,
                 dehyst_real *drive, long n)
{
    long t;
    if (wide->grades.size > 0)
        dehyst_grades_compensate(wide, memory, room->held, room->segment, w, drive, n);
    else if (room->stack.reversal != NULL && n >= SHORT)
        dehyst_compensate_run(&wide->plain, memory, &room->stack, w, drive, n);
    else
        for (t = 0; t < n; t++) drive[t] = dehyst_compensate_step(&wide->plain, memory, w[t]);
}

void dehyst_wide_compensate(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                            dehyst_room *room, const dehyst_real *w, const dehyst_real *more, dehyst_real *v, long n)
{
    dehyst_real move[BLOCK], present = state->memory.y;
    long first, t;
    hold(wide, &state->memory, room, w, v, n);
    if (wide->smooth.size > 0) dehyst_smooth_compensate(&wide->smooth, state->elongation, present, w, v, n);
    for (first = 0; first < n; first += BLOCK) {
        const int count = n - first < BLOCK ? (int)(n - first) : BLOCK;
        if (wide->branches > 0) {
            for (t = 0; t < count; t++) {
                const dehyst_real goal = is_finite(w[first + t]) ? w[first + t] : present;
                move[t] = goal - present;
                present = goal;
            }
            creep(wide, pace, state->strain, move, v + first, count);
        }
        if (more != NULL)
            for (t = first; t < first + count; t++) v[t] += more[t];
        if (wide->voltage.size > 0) map(&wide->voltage, v + first, count);
    }
}

/* What a step does, seen from its end: R(w) + known + stiffness (w - w_old) = tau(v), R what the elements and the spring
 * hold, and y = free + lever w. What creep will hold after the next step without motion is `after` + carry (w - w_old):
 * worked out before w is, it need not wait for it. */
typedef struct balance {
    dehyst_real stiffness, lever, carry, creep, after, known, free;
} balance;

static balance balance_of(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_wide_state *state)
{
    balance found = {0, 0, 0, 0, 0, 0, 0};
    int j;
    for (j = 0; j < wide->branches; j++) {
        found.stiffness += wide->stiffness[j] * pace->gain[j];
        found.carry += wide->stiffness[j] * (pace->decay[j] * pace->gain[j]);
    }
    found.creep = held_over(wide, pace, state->strain, 1);
    if (wide->inertia) {
        found.lever = lever_of(wide, &pace->transition);
        found.stiffness += wide->series * (1 - found.lever);
    }
    return found;
}

static void begin_step(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_wide_state *state, dehyst_real w,
                       dehyst_real load, balance *step)
{
    step->known = step->creep;
    step->after = held_over(wide, pace, state->strain, 2);
    if (wide->inertia) {
        step->free = free_of(wide, &pace->transition, state, load);
        step->known += wide->series * ((1 - step->lever) * w - step->free);
    }
}

/* Returns the displacement that is seen. */
static dehyst_real end_step(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                            dehyst_real before, dehyst_real w, dehyst_real load, balance *step)
{
    step->creep = step->after + step->carry * (w - before);
    creep_on(wide, pace, state->strain, w - before);
    if (!wide->inertia) return w;
    swing_on(wide, &pace->transition, state, w, step->free + step->lever * w, load);
    return state->y;
}

/* On the stack, what moves in time is a spring beside eta: R(w) + stiffness (w - knot_0) has reversals and branches like
 * R. y holds tau(v) on entry. */
static int simulate_on_stack(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                             dehyst_room *room, const dehyst_real *load, dehyst_real *y, long n)
{
    const dehyst_curve *spring = &wide->plain.spring;
    const dehyst_real base = spring->knot[0];
    balance step = balance_of(wide, pace, state);
    dehyst_actuator stiff = wide->plain;
    dehyst_walk walk;
    int j;
    long t;
    for (j = 0; j < spring->size; j++) room->value[j] = spring->value[j] + step.stiffness * (spring->knot[j] - base);
    for (j = 0; j + 1 < spring->size; j++) room->slope[j] = spring->slope[j] + step.stiffness;
    stiff.spring.value = room->value;
    stiff.spring.slope = room->slope;
    if (dehyst_stack_encode(&stiff, &state->memory, &room->stack) != DEHYST_OK) return 0;
    dehyst_walk_begin(&walk, &stiff, &room->stack);
    for (t = 0; t < n; t++) {
        const dehyst_real before = walk.y, force = load != NULL ? load[t] : 0;
        dehyst_real w;
        begin_step(wide, pace, state, before, force, &step);
        w = dehyst_walk_to(&walk, y[t] - step.known + step.stiffness * (before - base));
        y[t] = end_step(wide, pace, state, before, w, force, &step);
    }
    dehyst_walk_end(&walk);
    dehyst_stack_decode(&stiff, &room->stack, &state->memory);
    return 1;
}

/* y holds tau(v) on entry. */
static void simulate_in_time(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                             dehyst_room *room, const dehyst_real *load, dehyst_real *y, long n)
{
    balance step = balance_of(wide, pace, state);
    const int stack = room->stack.reversal != NULL && wide->grades.size == 0 && wide->smooth.size == 0;
    dehyst_real likely = 1;
    long t;
    for (t = 0; t < n; t++) {
        const dehyst_real before = state->memory.y, force = load != NULL ? load[t] : 0;
        dehyst_real w;
        if (stack && n - t >= SHORT && t % BLOCK == 0 &&
            simulate_on_stack(wide, pace, state, room, load != NULL ? load + t : NULL, y + t, n - t))
            return;
        begin_step(wide, pace, state, before, force, &step);
        w = dehyst_wide_solve(wide, state, y[t] - step.known, step.stiffness, &likely);
        y[t] = end_step(wide, pace, state, before, w, force, &step);
    }
}

void dehyst_wide_simulate(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state, dehyst_room *room,
                          const dehyst_real *v, const dehyst_real *load, dehyst_real *y, long n)
{
    dehyst_real likely = 1;
    long t;
    for (t = 0; t < n; t++) y[t] = v[t];
    if (wide->drive.size > 0) map(&wide->drive, y, n);
    if (wide->branches > 0 || wide->inertia)
        simulate_in_time(wide, pace, state, room, load, y, n);
    else if (wide->grades.size == 0 && wide->smooth.size == 0 && room->stack.reversal != NULL)
        dehyst_simulate_run(&wide->plain, &state->memory, &room->stack, y, y, n);
    else
        for (t = 0; t < n; t++) y[t] = dehyst_wide_solve(wide, state, y[t], 0, &likely);
}

void dehyst_strains(int branches, const dehyst_pace *pace, dehyst_real *strain, dehyst_real before,
                    const dehyst_real *w, dehyst_real *out, long n)
{
    long t;
    int j;
    for (t = 0; t < n; t++) {
        const dehyst_real move = is_finite(w[t]) ? w[t] - before : 0;
        before += move;
        for (j = 0; j < branches; j++) {
            strain[j] = pace->decay[j] * strain[j] + pace->gain[j] * move;
            *out++ = strain[j];
        }
    }
}
