#include "dehyst_parts.h"

#include <stddef.h>

/* Samples that are worked on together: few enough to stay in the nearest cache and on a small processor's stack. */
#define BLOCK 64
/* Branches of creep that are moved together: constant, so that a compiler keeps them in its vector registers. */
#define LANES 8
/* Runs shorter than this are not worth a stack of reversals. */
#define SHORT 12

dehyst_status dehyst_wide_check(const dehyst_wide *wide, const dehyst_wide_state *state)
{
    dehyst_status status = dehyst_state_check(&wide->plain, &state->memory);
    int j;
    if (status != DEHYST_OK) return status;
    if (wide->branches < 0 || (wide->branches > 0 && (wide->stiffness == NULL || state->strain == NULL)))
        return DEHYST_ERR_SIZE;
    for (j = 0; j < wide->branches; j++) {
        if (!is_finite(wide->stiffness[j]) || !is_finite(state->strain[j])) return DEHYST_ERR_FINITE;
        if (wide->stiffness[j] < 0) return DEHYST_ERR_SIGN;
    }
    status = dehyst_smooth_check(&wide->smooth, state->elongation);
    if (status != DEHYST_OK || !wide->inertia) return status;
    if (!is_finite(wide->series) || !is_finite(wide->share)) return DEHYST_ERR_FINITE;
    if (!is_finite(state->y) || !is_finite(state->rate)) return DEHYST_ERR_FINITE;
    return wide->series < 0 || wide->share < 0 || wide->share > 1 ? DEHYST_ERR_SIGN : DEHYST_OK;
}

long dehyst_equal_steps(const dehyst_real *time, long first, long n)
{
    const dehyst_real step = time[first] - time[first - 1], begin = magnitude(time[0]), end = magnitude(time[n - 1]);
    const dehyst_real allowance = (dehyst_real)1e-9 * step + 4 * DEHYST_EPSILON * (begin > end ? begin : end);
    long t = first + 1;
    while (t < n && time[t] > time[t - 1] && magnitude(time[t] - time[t - 1] - step) <= allowance) t++;
    return t;
}

dehyst_real dehyst_wide_voltage(const dehyst_wide *wide, const dehyst_wide_state *state)
{
    dehyst_real drive = wide->grades.size > 0 ? dehyst_grades_voltage(wide, &state->memory)
                                              : dehyst_voltage(&wide->plain, &state->memory);
    int j;
    for (j = 0; j < wide->branches; j++) drive += wide->stiffness[j] * state->strain[j];
    drive += dehyst_smooth_held(&wide->smooth, state->elongation);
    if (wide->inertia) drive += wide->series * (state->memory.y - state->y);
    return wide->voltage.size > 0 ? dehyst_curve_at(&wide->voltage, drive) : drive;
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

/* Move the carts to the w at which G(w) + stiffness (w - w_old) = drive, G what the elements and the spring hold. The
 * likely direction is tried first, and is put right. */
static dehyst_real solve(const dehyst_wide *wide, dehyst_wide_state *state, dehyst_real drive, dehyst_real stiffness,
                         dehyst_real *likely)
{
    dehyst_state *memory = &state->memory;
    const int size = wide->plain.slip.size, grades = wide->grades.size > 0 ? wide->grades.size : 1;
    const dehyst_real start = memory->y;
    dehyst_real w = start, direction = *likely;
    int changes = (size + 1) * grades + wide->plain.spring.size;
    outlook ahead;
    if (wide->smooth.size > 0) return dehyst_smooth_solve(wide, state, drive, stiffness, likely);
    if (!is_finite(drive)) return start;
    ahead = look_ahead(wide, memory, w, direction);
    if (direction * (drive - ahead.v) < 0) {
        *likely = direction = -direction;
        ahead = look_ahead(wide, memory, w, direction);
    }
    while (changes-- > 0) {
        dehyst_real goal = w + (drive - ahead.v - stiffness * (w - start)) / (ahead.slope + stiffness);
        if (direction * (goal - ahead.event) <= 0) {
            w = goal;
            break;
        }
        w = ahead.event;
        ahead = look_ahead(wide, memory, w, direction);
    }
    dehyst_slip_move(&wide->plain.slip, memory->cart, w);
    memory->y = w;
    return w;
}

/* What creep would hold at the end of so many steps without motion, one or two. */
static dehyst_real held_over(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_real *strain, int steps)
{
    dehyst_real sum[4] = {0, 0, 0, 0};
    int j, i;
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
        found.lever = pace->transition.after[0] / (1 + wide->share * pace->transition.after[0]);
        found.stiffness += wide->series * (1 - found.lever);
    }
    return found;
}

static void begin_step(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_wide_state *state, dehyst_real w,
                       dehyst_real load, balance *step)
{
    const dehyst_transition *to = &pace->transition;
    step->known = step->creep;
    step->after = held_over(wide, pace, state->strain, 2);
    if (wide->inertia) {
        step->free = (to->phi[0] * state->y + to->phi[1] * state->rate + to->before[0] * state->input + to->after[0] * load) /
                     (1 + wide->share * to->after[0]);
        step->known += wide->series * ((1 - step->lever) * w - step->free);
    }
}

/* Returns the displacement that is seen. */
static dehyst_real end_step(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                            dehyst_real before, dehyst_real w, dehyst_real load, balance *step)
{
    const dehyst_transition *to = &pace->transition;
    const dehyst_real by = w - before;
    dehyst_real y, input;
    int j;
    step->creep = step->after + step->carry * by;
    for (j = 0; j < wide->branches; j++) state->strain[j] = pace->decay[j] * state->strain[j] + pace->gain[j] * by;
    if (!wide->inertia) return w;
    y = step->free + step->lever * w;
    input = w - wide->share * y + load;
    state->rate = to->phi[2] * state->y + to->phi[3] * state->rate + to->before[1] * state->input + to->after[1] * input;
    state->input = input;
    state->y = y;
    return y;
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
        w = solve(wide, state, y[t] - step.known, step.stiffness, &likely);
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
        for (t = 0; t < n; t++) y[t] = solve(wide, state, y[t], 0, &likely);
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
