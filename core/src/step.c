#include "internal.h"

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
    if (!within_reach(state->y) || !within_reach(state->rate)) return DEHYST_ERR_FINITE;
    return wide->series < 0 || wide->share < 0 || wide->share > 1 ? DEHYST_ERR_SIGN : DEHYST_OK;
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

dehyst_real dehyst_wide_solve(const dehyst_wide *wide, dehyst_wide_state *state, dehyst_real drive,
                              dehyst_real stiffness, dehyst_real *likely)
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
    if (!within_reach(w)) return w;
    dehyst_slip_move(&wide->plain.slip, memory->cart, w);
    memory->y = w;
    return w;
}

dehyst_real dehyst_wide_stiffness(const dehyst_wide *wide, const dehyst_pace *pace)
{
    dehyst_real sum = 0;
    int j;
    for (j = 0; j < wide->branches; j++) sum += wide->stiffness[j] * pace->gain[j];
    return wide->inertia ? sum + wide->series * (1 - lever_of(wide, &pace->transition)) : sum;
}

/* R(w) + known + stiffness (w - w_old) = tau(v) at the end of a step. */
static dehyst_real known_of(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_wide_state *state)
{
    const dehyst_transition *to = &pace->transition;
    const dehyst_real creep = held_over(wide, pace, state->strain, 1);
    if (!wide->inertia) return creep;
    return creep + wide->series * ((1 - lever_of(wide, to)) * state->memory.y - free_of(wide, to, state, 0));
}

/* What the memory does when w has been reached. */
static dehyst_real arrive(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                          dehyst_real before, dehyst_real w)
{
    const dehyst_transition *to = &pace->transition;
    creep_on(wide, pace, state->strain, w - before);
    if (!wide->inertia) return w;
    swing_on(wide, to, state, w, free_of(wide, to, state, 0) + lever_of(wide, to) * w, 0);
    return state->y;
}

void dehyst_wide_wish(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_wide_state *state,
                      dehyst_real stiffness, dehyst_wish *wish)
{
    const dehyst_state *memory = &state->memory;
    const dehyst_real w = wish->w, by = w - memory->y;
    dehyst_real drive = wide->grades.size > 0
                            ? dehyst_grades_look_ahead(wide, memory, w, by < 0 ? -1 : 1).v
                            : voltage_after(&wide->plain, memory->cart, w, wish->cart, &wish->hint);
    if (wide->branches > 0 || wide->inertia) drive += known_of(wide, pace, state) + stiffness * by;
    if (wide->smooth.size > 0) drive += dehyst_smooth_held_after(&wide->smooth, state->elongation, by);
    wish->v = wide->voltage.size > 0 ? dehyst_curve_at(&wide->voltage, drive) : drive;
}

dehyst_real dehyst_wide_fulfil(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                               dehyst_wish *wish)
{
    dehyst_real *cart = state->memory.cart;
    const dehyst_real before = state->memory.y;
    if (wide->grades.size > 0) {
        dehyst_slip_move(&wide->plain.slip, cart, wish->w);
    } else {
        state->memory.cart = wish->cart;
        wish->cart = cart;
    }
    if (wide->smooth.size > 0) dehyst_smooth_move(&wide->smooth, state->elongation, wish->w - before);
    state->memory.y = wish->w;
    return arrive(wide, pace, state, before, wish->w);
}

dehyst_real dehyst_wide_simulate_step(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_wide_state *state,
                                      dehyst_real stiffness, dehyst_real v)
{
    const dehyst_real before = state->memory.y, known = known_of(wide, pace, state);
    dehyst_real likely = 1, w, y;
    if (wide->drive.size > 0) v = dehyst_curve_at(&wide->drive, v);
    w = dehyst_wide_solve(wide, state, v - known, stiffness, &likely);
    y = arrive(wide, pace, state, before, state->memory.y);
    return within_reach(w) ? y : w;
}
