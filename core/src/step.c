#include "internal.h"

dehyst_status dehyst_check(const dehyst_actuator *actuator, const dehyst_state *state)
{
    dehyst_status status = dehyst_plain_check(&actuator->plain, &state->memory);
    if (status != DEHYST_OK) { return status; }
    status = dehyst_smooth_check(&actuator->smooth, state->elongation);
    if ((status != DEHYST_OK) || !actuator->inertia) { return status; }
    if (!is_finite(actuator->series) || !is_finite(actuator->share)) { return DEHYST_ERR_FINITE; }
    if (!within_reach(state->y) || !within_reach(state->rate)) { return DEHYST_ERR_FINITE; }
    return ((actuator->series < 0) || (actuator->share < 0) || (actuator->share > 1)) ? DEHYST_ERR_SIGN : DEHYST_OK;
}

dehyst_real dehyst_voltage(const dehyst_actuator *actuator, const dehyst_state *state)
{
    dehyst_real drive = (actuator->grades.size > 0) ? dehyst_grades_voltage(actuator, &state->memory)
                                                    : dehyst_plain_voltage(&actuator->plain, &state->memory);
    drive += dehyst_smooth_voltage(&actuator->smooth, state->elongation);
    if (actuator->inertia) { drive += actuator->series * (state->memory.y - state->y); }
    return (actuator->inverse_transformer.size > 0) ? dehyst_curve_at(&actuator->inverse_transformer, drive) : drive;
}

dehyst_real dehyst_solve(const dehyst_actuator *actuator, dehyst_state *state, dehyst_real drive, dehyst_real stiffness,
                         dehyst_real *likely)
{
    dehyst_plain_state *memory = &state->memory;
    const int size = actuator->plain.slip.size, grades = (actuator->grades.size > 0) ? actuator->grades.size : 1;
    const dehyst_real start = memory->y;
    dehyst_real w = start, direction = *likely;
    int changes = ((size + 1) * grades) + actuator->plain.spring.size;
    branch_segment ahead;
    if (actuator->smooth.size > 0) { return dehyst_smooth_solve(actuator, state, drive, stiffness, likely); }
    if (!is_finite(drive)) { return start; }
    ahead = look_ahead(actuator, memory, w, direction);
    if ((direction * (drive - ahead.v)) < 0) {
        *likely = direction = -direction;
        ahead = look_ahead(actuator, memory, w, direction);
    }
    while (changes-- > 0) {
        dehyst_real goal = w + ((drive - ahead.v - (stiffness * (w - start))) / (ahead.slope + stiffness));
        if ((direction * (goal - ahead.event)) <= 0) {
            w = goal;
            break;
        }
        w = ahead.event;
        ahead = look_ahead(actuator, memory, w, direction);
    }
    if (!within_reach(w)) { return w; }
    dehyst_slip_move(&actuator->plain.slip, memory->cart, w);
    memory->y = w;
    return w;
}

dehyst_real dehyst_step_stiffness(const dehyst_actuator *actuator, const dehyst_transition *step)
{ return actuator->inertia ? (actuator->series * (1 - gain_of(actuator, step))) : 0; }

/* At the end of a step R(w) + known + stiffness (w - w_old) = tau(v); return `known`. */
static dehyst_real known_voltage(const dehyst_actuator *actuator, const dehyst_transition *step,
                                 const dehyst_state *state)
{
    if (!actuator->inertia) { return 0; }
    return actuator->series *
           (((1 - gain_of(actuator, step)) * state->memory.y) - offset_of(actuator, step, state, 0));
}

/* Move a mass through a step that ends at w, and return the displacement y. */
static dehyst_real advance(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                           dehyst_real w)
{
    if (!actuator->inertia) { return w; }
    move_mass(actuator, step, state, w, offset_of(actuator, step, state, 0) + (gain_of(actuator, step) * w), 0);
    return state->y;
}

void dehyst_evaluate(const dehyst_actuator *actuator, const dehyst_transition *step, const dehyst_state *state,
                     dehyst_real stiffness, dehyst_candidate *candidate)
{
    const dehyst_plain_state *memory = &state->memory;
    const dehyst_real w = candidate->w, by = w - memory->y;
    dehyst_real drive = (actuator->grades.size > 0)
                            ? dehyst_grades_look_ahead(actuator, memory, w, (by < 0) ? -1 : 1).v
                            : voltage_after(&actuator->plain, memory->cart, w, candidate->cart, &candidate->hint);
    if (actuator->inertia) { drive += known_voltage(actuator, step, state) + (stiffness * by); }
    if (actuator->smooth.size > 0) { drive += dehyst_smooth_voltage_after(&actuator->smooth, state->elongation, by); }
    candidate->v =
        (actuator->inverse_transformer.size > 0) ? dehyst_curve_at(&actuator->inverse_transformer, drive) : drive;
}

dehyst_real dehyst_commit(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                          dehyst_candidate *candidate)
{
    dehyst_real *cart = state->memory.cart;
    const dehyst_real before = state->memory.y;
    if (actuator->grades.size > 0) {
        dehyst_slip_move(&actuator->plain.slip, cart, candidate->w);
    } else {
        state->memory.cart = candidate->cart;
        candidate->cart = cart;
    }
    if (actuator->smooth.size > 0) { dehyst_smooth_move(&actuator->smooth, state->elongation, candidate->w - before); }
    state->memory.y = candidate->w;
    return advance(actuator, step, state, candidate->w);
}

dehyst_real dehyst_simulate_step(const dehyst_actuator *actuator, const dehyst_transition *step, dehyst_state *state,
                                 dehyst_real stiffness, dehyst_real v)
{
    const dehyst_real known = known_voltage(actuator, step, state);
    dehyst_real likely = 1, w, y;
    if (actuator->transformer.size > 0) { v = dehyst_curve_at(&actuator->transformer, v); }
    w = dehyst_solve(actuator, state, v - known, stiffness, &likely);
    y = advance(actuator, step, state, state->memory.y);
    return within_reach(w) ? y : w;
}
