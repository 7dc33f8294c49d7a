#include "internal.h"

dehyst_status dehyst_compensator_tabulate(dehyst_compensator *compensator)
{
    const dehyst_compensator *c = compensator;
    int m;
    if (c->taps < 1 || c->tap == NULL) return DEHYST_ERR_SIZE;
    for (m = 0; m < c->taps; m++)
        if (!is_finite(c->tap[m])) return DEHYST_ERR_FINITE;
    if (!is_finite(c->low) || !is_finite(c->high) || !is_finite(c->lag)) return DEHYST_ERR_FINITE;
    if (!(c->high > c->low)) return DEHYST_ERR_ORDER;
    if (!(c->change > 0) || c->lag < 0) return DEHYST_ERR_SIGN;
    compensator->stiffness = dehyst_step_stiffness(&c->actuator, &c->step);
    return is_finite(compensator->stiffness) ? DEHYST_OK : DEHYST_ERR_FINITE;
}

static dehyst_real nearest_allowed(const dehyst_compensator *compensator, dehyst_real v)
{
    v = v < compensator->low ? compensator->low : v;
    return v > compensator->high ? compensator->high : v;
}

dehyst_status dehyst_loop_begin(const dehyst_compensator *compensator, dehyst_loop *loop)
{
    const dehyst_actuator *actuator = &compensator->actuator;
    dehyst_status status = dehyst_check(actuator, &loop->state);
    dehyst_real y, v;
    int m;
    if (status != DEHYST_OK) return status;
    if (loop->inputs == NULL || (actuator->plain.slip.size > 0 && loop->candidate.cart == NULL)) return DEHYST_ERR_SIZE;
    v = dehyst_voltage(actuator, &loop->state);
    if (!is_finite(v)) return DEHYST_ERR_FINITE;
    loop->state.input = actuator->inertia ? loop->state.memory.y - actuator->share * loop->state.y : 0;
    y = actuator->inertia ? loop->state.y : loop->state.memory.y;
    for (m = 0; m < compensator->taps; m++) loop->inputs[m] = y;
    loop->sent = nearest_allowed(compensator, v);
    loop->acting = loop->intended[0] = loop->intended[1] = loop->candidate.v = loop->voltage = loop->sent;
    loop->wanted = y;
    loop->candidate.w = loop->state.memory.y;
    loop->candidate.hint = 0;
    loop->offer = DEHYST_NOTHING;
    loop->limited = loop->slewed = loop->refused = 0;
    return DEHYST_OK;
}

/* Return the target of w for u, the newest input. */
static dehyst_real filtered(const dehyst_compensator *compensator, const dehyst_loop *loop, dehyst_real u)
{
    dehyst_real w = compensator->tap[0] * u;
    int m;
    for (m = 1; m < compensator->taps; m++) w += compensator->tap[m] * loop->inputs[m - 1];
    return w;
}

/* Return the voltage with which a lagging amplifier acts with `acting`: lag times slope more, the slope by a parabola
 * through the last two. */
static dehyst_real ahead_of_lag(const dehyst_compensator *compensator, const dehyst_loop *loop, dehyst_real acting)
{
    const dehyst_real three = 3 * acting - 4 * loop->intended[0] + loop->intended[1];
    return acting + compensator->lag * (three / 2);
}

/* Return v within slew rate and limits. Limits come last: the slew rate must not push a voltage out of them. */
static dehyst_real allowed(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v)
{
    const dehyst_compensator *c = compensator;
    if (magnitude(v - loop->sent) > c->change) {
        loop->offer = DEHYST_SLEWED;
        v = v > loop->sent ? loop->sent + c->change : loop->sent - c->change;
    }
    if (nearest_allowed(c, v) != v) loop->offer = DEHYST_LIMITED;
    return nearest_allowed(c, v);
}

dehyst_real dehyst_loop_offer(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real u)
{
    const dehyst_compensator *c = compensator;
    dehyst_real v;
    loop->wanted = u;
    loop->candidate.w = c->taps > 1 ? filtered(c, loop, u) : u;
    loop->voltage = nearest_allowed(c, loop->sent);
    loop->offer = DEHYST_REFUSED;
    if (!is_finite(loop->candidate.w)) return loop->voltage;
    dehyst_evaluate(&c->actuator, &c->step, &loop->state, c->stiffness, &loop->candidate);
    v = c->lag > 0 ? ahead_of_lag(c, loop, loop->candidate.v) : loop->candidate.v;
    if (!is_finite(v)) return loop->voltage;
    loop->offer = DEHYST_CANDIDATE;
    return loop->voltage = allowed(c, loop, v);
}

/* Move by the voltage v, which is not the candidate's. */
static void follow(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v, int as_wanted)
{
    const dehyst_compensator *c = compensator;
    dehyst_real acts = v;
    if (c->lag > 0) {
        acts = c->keep * loop->acting + c->from_old * loop->sent + c->from_new * v;
        loop->acting = acts;
        loop->intended[1] = loop->intended[0];
        loop->intended[0] = as_wanted ? loop->candidate.v : acts;
    }
    if (!within_reach(dehyst_simulate_step(&c->actuator, &c->step, &loop->state, c->stiffness, acts))) loop->refused++;
}

static void end_period(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v)
{
    int m;
    for (m = compensator->taps - 1; m > 0; m--) loop->inputs[m] = loop->inputs[m - 1];
    if (loop->offer != DEHYST_NOTHING && is_finite(loop->wanted)) loop->inputs[0] = loop->wanted;
    loop->sent = v;
    loop->offer = DEHYST_NOTHING;
}

int dehyst_loop_accepts(const dehyst_compensator *compensator, dehyst_real v)
{
    const dehyst_real range = compensator->high - compensator->low;
    return is_finite(v) && v >= compensator->low - range && v <= compensator->high + range;
}

void dehyst_loop_commit(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v)
{
    const dehyst_compensator *c = compensator;
    const int as_offered = loop->offer != DEHYST_NOTHING && v == loop->voltage;
    const int as_wanted = as_offered && loop->offer == DEHYST_CANDIDATE && within_reach(loop->candidate.w);
    if (as_wanted && !(c->lag > 0)) {
        dehyst_commit(&c->actuator, &c->step, &loop->state, &loop->candidate);
    } else {
        if (as_offered) {
            loop->limited += loop->offer == DEHYST_LIMITED;
            loop->slewed += loop->offer == DEHYST_SLEWED;
            loop->refused += loop->offer == DEHYST_REFUSED;
        } else if (!dehyst_loop_accepts(c, v)) {
            loop->refused++;
            v = loop->sent;
        }
        follow(c, loop, v, as_wanted);
    }
    end_period(c, loop, v);
}

void dehyst_loop_play(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v)
{
    loop->offer = DEHYST_NOTHING;
    if (!is_finite(v)) v = loop->sent;
    follow(compensator, loop, v, 0);
    end_period(compensator, loop, v);
}

dehyst_real dehyst_loop_step(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real u)
{
    const dehyst_real v = dehyst_loop_offer(compensator, loop, u);
    dehyst_loop_commit(compensator, loop, v);
    return v;
}

void dehyst_loop_run(const dehyst_compensator *compensator, dehyst_loop *loop, const dehyst_real *u, dehyst_real *v,
                     long n)
{
    long t;
    for (t = 0; t < n; t++) v[t] = dehyst_loop_step(compensator, loop, u[t]);
}
