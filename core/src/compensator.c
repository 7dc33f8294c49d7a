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
    compensator->stiffness = dehyst_wide_stiffness(&c->wide, &c->pace);
    return is_finite(compensator->stiffness) ? DEHYST_OK : DEHYST_ERR_FINITE;
}

static dehyst_real nearest_allowed(const dehyst_compensator *compensator, dehyst_real v)
{
    v = v < compensator->low ? compensator->low : v;
    return v > compensator->high ? compensator->high : v;
}

dehyst_status dehyst_loop_begin(const dehyst_compensator *compensator, dehyst_loop *loop)
{
    const dehyst_wide *wide = &compensator->wide;
    dehyst_status status = dehyst_wide_check(wide, &loop->state);
    dehyst_real y, v;
    int m;
    if (status != DEHYST_OK) return status;
    if (loop->fed == NULL || (wide->plain.slip.size > 0 && loop->wish.cart == NULL)) return DEHYST_ERR_SIZE;
    v = dehyst_wide_voltage(wide, &loop->state);
    if (!is_finite(v)) return DEHYST_ERR_FINITE;
    loop->state.input = wide->inertia ? loop->state.memory.y - wide->share * loop->state.y : 0;
    y = wide->inertia ? loop->state.y : loop->state.memory.y;
    for (m = 0; m < compensator->taps; m++) loop->fed[m] = y;
    loop->sent = nearest_allowed(compensator, v);
    loop->acting = loop->wished[0] = loop->wished[1] = loop->wish.v = loop->voltage = loop->sent;
    loop->asked = y;
    loop->wish.w = loop->state.memory.y;
    loop->wish.hint = 0;
    loop->offer = DEHYST_NOTHING;
    loop->limited = loop->slewed = loop->refused = 0;
    return DEHYST_OK;
}

/* W for u, the newest of what is fed. */
static dehyst_real filtered(const dehyst_compensator *compensator, const dehyst_loop *loop, dehyst_real u)
{
    dehyst_real w = compensator->tap[0] * u;
    int m;
    for (m = 1; m < compensator->taps; m++) w += compensator->tap[m] * loop->fed[m - 1];
    return w;
}

/* What a lagging amplifier must be given to act with `wish`: one period's lag times its slope, by a parabola through the
 * last two. */
static dehyst_real ahead_of_lag(const dehyst_compensator *compensator, const dehyst_loop *loop, dehyst_real wish)
{
    const dehyst_real three = 3 * wish - 4 * loop->wished[0] + loop->wished[1];
    return wish + compensator->lag * (three / 2);
}

/* What of v may be sent. Limits come last: slew may not push a voltage out of them. */
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
    loop->asked = u;
    loop->wish.w = c->taps > 1 ? filtered(c, loop, u) : u;
    loop->voltage = nearest_allowed(c, loop->sent);
    loop->offer = DEHYST_REFUSED;
    if (!is_finite(loop->wish.w)) return loop->voltage;
    dehyst_wide_wish(&c->wide, &c->pace, &loop->state, c->stiffness, &loop->wish);
    v = c->lag > 0 ? ahead_of_lag(c, loop, loop->wish.v) : loop->wish.v;
    if (!is_finite(v)) return loop->voltage;
    loop->offer = DEHYST_WISHED;
    return loop->voltage = allowed(c, loop, v);
}

/* The voltage v, which is not the wish, acts: where it leads is worked out. */
static void follow(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v, int as_wished)
{
    const dehyst_compensator *c = compensator;
    dehyst_real acts = v;
    if (c->lag > 0) {
        acts = c->keep * loop->acting + c->from_old * loop->sent + c->from_new * v;
        loop->acting = acts;
        loop->wished[1] = loop->wished[0];
        loop->wished[0] = as_wished ? loop->wish.v : acts;
    }
    if (!within_reach(dehyst_wide_simulate_step(&c->wide, &c->pace, &loop->state, c->stiffness, acts))) loop->refused++;
}

static void end_period(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v)
{
    int m;
    for (m = compensator->taps - 1; m > 0; m--) loop->fed[m] = loop->fed[m - 1];
    if (loop->offer != DEHYST_NOTHING && is_finite(loop->asked)) loop->fed[0] = loop->asked;
    loop->sent = v;
    loop->offer = DEHYST_NOTHING;
}

int dehyst_loop_believes(const dehyst_compensator *compensator, dehyst_real v)
{
    const dehyst_real range = compensator->high - compensator->low;
    return is_finite(v) && v >= compensator->low - range && v <= compensator->high + range;
}

void dehyst_loop_commit(const dehyst_compensator *compensator, dehyst_loop *loop, dehyst_real v)
{
    const dehyst_compensator *c = compensator;
    const int as_offered = loop->offer != DEHYST_NOTHING && v == loop->voltage;
    const int as_wished = as_offered && loop->offer == DEHYST_WISHED && within_reach(loop->wish.w);
    if (as_wished && !(c->lag > 0)) {
        dehyst_wide_fulfil(&c->wide, &c->pace, &loop->state, &loop->wish);
    } else {
        if (as_offered) {
            loop->limited += loop->offer == DEHYST_LIMITED;
            loop->slewed += loop->offer == DEHYST_SLEWED;
            loop->refused += loop->offer == DEHYST_REFUSED;
        } else if (!dehyst_loop_believes(c, v)) {
            loop->refused++;
            v = loop->sent;
        }
        follow(c, loop, v, as_wished);
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
