#include "internal.h"

/* For rare parts of a step: inlined, they would slow down the other parts. */
#if defined(__GNUC__)
#define OUT_OF_LINE __attribute__((noinline, cold))
#else
#define OUT_OF_LINE
#endif

const char *dehyst_version(void) { return DEHYST_VERSION; }

const char *dehyst_status_text(dehyst_status status)
{
    switch (status) {
    case DEHYST_OK: return "done";
    case DEHYST_ERR_SIZE: return "fewer than two knots, or arrays of different lengths";
    case DEHYST_ERR_FINITE: return "a value that is not finite, or too large";
    case DEHYST_ERR_ORDER: return "knots, spring voltages, breakaway elongations and limits must strictly increase";
    case DEHYST_ERR_SIGN: return "stiffnesses must be >= 0 and breakaway elongations > 0";
    case DEHYST_ERR_STATE:
        return "a cart lies farther from the displacement than its breakaway elongation, or a smooth element is longer "
               "than its length";
    case DEHYST_ERR_CAPACITY: return "the stack of reversals is too short";
    case DEHYST_ERR_UNREACHABLE: return "no history from rest leaves carts like these";
    case DEHYST_ERR_LENGTH: return "the block is cut off or too long";
    case DEHYST_ERR_KIND: return "the bytes are not a block of this kind";
    case DEHYST_ERR_FORMAT: return "the block has another format than this version reads";
    case DEHYST_ERR_CHECKSUM: return "the checksum of the block does not fit: it has changed";
    case DEHYST_ERR_ROOM: return "there is less room than the block needs";
    case DEHYST_ERR_MODEL: return "the model has another shape: sizes, elements, time constants, amplifier or period";
    }
    return "unknown status";
}

dehyst_status dehyst_output_tabulate(dehyst_output *output)
{
    int k;
    output->at_rest = output->at_once = 1;
    for (k = 0; k < output->branches; k++) {
        const dehyst_real gain = output->gain[k], decay = output->decay[k], rise = output->rise[k];
        if (!is_finite(gain) || !is_finite(decay) || !is_finite(rise)) { return DEHYST_ERR_FINITE; }
        if ((gain < 0) || (decay < 0) || (decay > 1) || (rise < 0) || (rise > 1)) { return DEHYST_ERR_SIGN; }
        output->at_rest += gain;
        output->at_once += gain * (1 - rise);
    }
    return within_reach(output->at_rest) ? DEHYST_OK : DEHYST_ERR_FINITE;
}

dehyst_status dehyst_model_tabulate(dehyst_model *model)
{
    const dehyst_model *c = model;
    int m;
    if ((c->taps < 1) || (c->tap == NULL)) { return DEHYST_ERR_SIZE; }
    for (m = 0; m < c->taps; m++) {
        if (!is_finite(c->tap[m])) { return DEHYST_ERR_FINITE; }
    }
    if (!is_finite(c->low) || !is_finite(c->high) || !is_finite(c->lag)) { return DEHYST_ERR_FINITE; }
    if (!(c->high > c->low)) { return DEHYST_ERR_ORDER; }
    if (!(c->change > 0) || (c->lag < 0)) { return DEHYST_ERR_SIGN; }
    model->stiffness = dehyst_step_stiffness(&c->actuator, &c->step);
    return is_finite(model->stiffness) ? dehyst_output_tabulate(&model->output) : DEHYST_ERR_FINITE;
}

static dehyst_real nearest_allowed(const dehyst_model *model, dehyst_real v)
{
    v = (v < model->low) ? model->low : v;
    return (v > model->high) ? model->high : v;
}

unsigned long dehyst_memory_size(const dehyst_model *model)
{
    const dehyst_actuator *a = &model->actuator;
    return (unsigned long)DEHYST_MEMORY(a->plain.slip.size, a->smooth.size, model->output.branches, model->taps);
}

/* Return the state of a loop, and set `inputs` to its wanted displacements; the strains of creep behind the elements
 * lie before them. */
static dehyst_state state_of(const dehyst_model *model, const dehyst_loop *loop, dehyst_real *memory,
                             dehyst_real **inputs)
{
    const int n = model->actuator.plain.slip.size;
    dehyst_state state;
    state.memory.y = loop->w;
    state.memory.cart = memory + (loop->half ? n : 0);
    state.elongation = memory + (2 * n);
    state.y = loop->y;
    state.rate = loop->rate;
    state.input = loop->input;
    *inputs = state.elongation + model->actuator.smooth.size + model->output.branches;
    return state;
}

/* Copy the changes of a step to the loop; the carts may now be in the other half. */
static void keep_state(dehyst_loop *loop, const dehyst_state *state, const dehyst_real *memory)
{
    loop->w = state->memory.y;
    loop->half = state->memory.cart != memory;
    loop->y = state->y;
    loop->rate = state->rate;
    loop->input = state->input;
}

/* Return the displacement of the model before creep behind the elements. */
static dehyst_real before_creep(const dehyst_model *model, const dehyst_loop *loop)
{ return model->actuator.inertia ? loop->y : loop->w; }

/* Write the start of the model to a loop and its memory. */
static dehyst_state start_state(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real **inputs)
{
    const dehyst_actuator *a = &model->actuator;
    const dehyst_start *start = &model->start;
    const int n = a->plain.slip.size;
    dehyst_state state;
    int i;
    loop->w = start->w;
    loop->y = a->inertia ? start->y : 0;
    loop->rate = a->inertia ? start->rate : 0;
    loop->input = a->inertia ? (start->w - (a->share * start->y)) : 0;
    loop->half = 0;
    for (i = 0; i < n; i++) { memory[i] = memory[n + i] = start->cart[i]; }
    state = state_of(model, loop, memory, inputs);
    for (i = 0; i < a->smooth.size; i++) { state.elongation[i] = start->elongation[i]; }
    for (i = 0; i < model->output.branches; i++) { (*inputs)[i - model->output.branches] = start->crept[i]; }
    loop->gain = 1;
    loop->offset = 0;
    loop->driven = before_creep(model, loop);
    return state;
}

dehyst_status dehyst_start_check(const dehyst_model *model)
{
    int k;
    for (k = 0; k < model->output.branches; k++) {
        if (!within_reach(model->start.crept[k])) { return DEHYST_ERR_FINITE; }
    }
    return DEHYST_OK;
}

dehyst_status dehyst_loop_begin(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory)
{
    dehyst_real *inputs, v;
    const dehyst_state state = start_state(model, loop, memory, &inputs);
    dehyst_status status = dehyst_check(&model->actuator, &state);
    int m;
    if (status == DEHYST_OK) { status = dehyst_start_check(model); }
    if (status != DEHYST_OK) { return status; }
    v = dehyst_voltage(&model->actuator, &state);
    if (!is_finite(v)) { return DEHYST_ERR_FINITE; }
    loop->wanted = loop->driven;
    for (m = 0; m < model->taps; m++) { inputs[m] = loop->wanted; }
    loop->sent = nearest_allowed(model, v);
    loop->acting = loop->intended[0] = loop->intended[1] = loop->candidate = loop->voltage = loop->sent;
    loop->target = loop->w;
    loop->segment = 0;
    loop->offer = DEHYST_NOTHING;
    loop->limited = loop->slewed = loop->refused = 0;
    return DEHYST_OK;
}

dehyst_real dehyst_loop_displacement(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory)
{
    dehyst_real m = before_creep(model, loop);
    if (model->output.branches > 0) {
        m = crept(&model->output, memory + dehyst_memory_size(model) - model->taps - model->output.branches, m);
    }
    return loop->offset + (loop->gain * m);
}

dehyst_status dehyst_loop_scale(dehyst_loop *loop, dehyst_real gain, dehyst_real offset)
{
    if (!within_reach(gain) || !within_reach(offset)) { return DEHYST_ERR_FINITE; }
    if (!(gain > 0)) { return DEHYST_ERR_SIGN; }
    loop->gain = gain;
    loop->offset = offset;
    loop->offer = DEHYST_NOTHING;
    return DEHYST_OK;
}

/* Least motion for a check of a sensor, as a part of the range. */
#define LEAST_MOTION ((dehyst_real)0.01)
/* Least number of readings for this check. */
#define LEAST_READINGS 8
/* A sensor is believed if its motion agrees with the model: bounds of correlation and squared ratio. */
#define CORRELATED ((dehyst_real)0.5)
#define STUCK ((dehyst_real)0.0625)
#define TOO_LITTLE ((dehyst_real)0.25)
#define TOO_MUCH ((dehyst_real)4)

static void begin_readings(dehyst_sensor *sensor, dehyst_real expected, dehyst_real miss)
{
    sensor->expected = expected;
    sensor->miss = miss;
    sensor->way = sensor->missed = sensor->moved = sensor->common = sensor->spread = 0;
    sensor->near_count = sensor->far_count = 0;
}

/* Add a reading and the expected reading; return whether the reading counts: it is a number within the bound. */
static inline int take_reading(dehyst_sensor *s, dehyst_real bound, dehyst_real expected, dehyst_real reading)
{
    dehyst_real way, missed = reading - expected;
    if (!(magnitude(missed) <= bound)) {
        s->far_count += (unsigned long)is_finite(reading);
        return 0;
    }
    way = expected - s->expected;
    missed -= s->miss;
    s->way += way;
    s->missed += missed;
    s->moved += way * way;
    s->common += way * missed;
    s->spread += missed * missed;
    s->near_count++;
    return 1;
}

/* Return whether the sensor is believed after a cycle; set its mean error, and the squares of errors about the mean. */
static dehyst_fault judge_readings(dehyst_sensor *s)
{
    dehyst_real way, moved, common, seen;
    if ((s->near_count + s->far_count) < LEAST_READINGS) { return DEHYST_BELIEVED; }
    if ((3 * s->far_count) > s->near_count) { return DEHYST_FAR; }
    way = s->way / (dehyst_real)s->near_count;
    s->spread -= s->missed * (s->missed / (dehyst_real)s->near_count);
    s->miss += s->missed / (dehyst_real)s->near_count;
    moved = s->moved - (way * s->way);
    common = moved + (s->common - (way * s->missed));
    seen = common + (s->common - (way * s->missed)) + s->spread;
    if (seen < (STUCK * moved)) { return DEHYST_STUCK; }
    if ((seen < (TOO_LITTLE * moved)) || (seen > (TOO_MUCH * moved))) { return DEHYST_SCALED; }
    return ((common > 0) && ((common * common) > (CORRELATED * CORRELATED * moved * seen))) ? DEHYST_BELIEVED
                                                                                           : DEHYST_CONTRADICTS;
}

dehyst_fault dehyst_sensor_judge(const dehyst_real *expected, const dehyst_real *reading, long n, dehyst_real bound)
{
    dehyst_sensor sensor;
    long t;
    begin_readings(&sensor, (n > 0) ? expected[0] : 0, 0);
    for (t = 0; t < n; t++) { (void)take_reading(&sensor, bound, expected[t], reading[t]); }
    return judge_readings(&sensor);
}

/* Return the displacement that a sensor without delay should show now. With preview it is the newest wanted
 * displacement, minus the part that limits or slew rate prevented. */
static dehyst_real meant(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory)
{
    const dehyst_real *inputs;
    if (model->taps == 1) { return dehyst_loop_displacement(model, loop, memory); }
    inputs = memory + dehyst_memory_size(model) - model->taps;
    return loop->offset + (loop->gain * (crept(&model->output, inputs - model->output.branches, inputs[0]) +
                                         (loop->w - loop->target)));
}

dehyst_status dehyst_feedback_begin(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                                    dehyst_real gain, dehyst_real bound, int late, dehyst_feedback *feedback)
{
    const dehyst_plain *plain = &model->actuator.plain;
    const dehyst_real range = plain->spring.knot[plain->spring.size - 1] - plain->spring.knot[0];
    int k;
    if (!is_finite(gain) || !within_reach(bound)) { return DEHYST_ERR_FINITE; }
    if (!(gain >= 0) || (gain > 1) || (bound < 0)) { return DEHYST_ERR_SIGN; }
    if ((late < 0) || (late > DEHYST_FEEDBACK_LATE)) { return DEHYST_ERR_SIZE; }
    feedback->gain = gain;
    feedback->bound = bound;
    feedback->least = LEAST_MOTION * range;
    feedback->correction = feedback->rest = feedback->back = feedback->sum = feedback->travelled = feedback->heard = 0;
    feedback->low = feedback->high = feedback->last = meant(model, loop, memory);
    for (k = 0; k <= late; k++) { feedback->past[k] = feedback->last; }
    feedback->late = late;
    feedback->at = 0;
    feedback->samples = feedback->lasted = 0;
    feedback->usual = feedback->moved = 0;
    feedback->trial = feedback->up = 0;
    feedback->fault = DEHYST_BELIEVED;
    begin_readings(&feedback->sensor, feedback->last, 0);
    return DEHYST_OK;
}

/* Number of cycles of a trial without a correction; one more cycle has it again. */
#define WITHOUT 3

/* Return whether one mean square of noise exceeds another by a quarter and four standard errors; each has `count`
 * readings. */
static int grew(dehyst_real now, dehyst_real before, dehyst_real count)
{
    const dehyst_real more = now - before;
    return (more > (before / 4)) && ((more * more * count) > (64 * before * before));
}

/* Check the effect of the correction on a path that repeats, where a sensor that is late by whole cycles shows the
 * right motion. The mismatch between model and sensor depends on the correction only if the sensor is late. */
static void judge_answer(dehyst_feedback *f)
{
    const dehyst_real count = (dehyst_real)f->sensor.near_count;
    const dehyst_real mismatch = f->sensor.spread / count, moved = f->high - f->low, before = f->moved;
    const unsigned long off = (f->samples > f->lasted) ? (f->samples - f->lasted) : (f->lasted - f->samples);
    const int repeats = ((20 * off) <= f->samples) && ((8 * moved) <= (9 * before)) && ((8 * before) <= (9 * moved));
    f->lasted = f->samples;
    f->moved = moved;
    if ((!repeats) || (!(f->usual > 0))) {
        f->usual = repeats ? mismatch : 0;
        f->trial = 0;
    } else if (f->trial == 0) {
        f->trial = grew(mismatch, f->usual, count);
    } else {
        /* A mismatch that disappears cycles after the correction, or returns with it, is its echo. */
        const int left = (f->trial > 1) && (f->trial <= WITHOUT) && grew(f->usual, mismatch, count);
        if (left || ((f->trial > WITHOUT) && grew(mismatch, f->usual, count))) { f->fault = DEHYST_CONTRADICTS; }
        f->usual = mismatch;
        f->trial = (f->trial > WITHOUT) ? 0 : (f->trial + 1);
    }
}

/* Return whether the correction must be 0. */
static int takes_back(const dehyst_feedback *f)
{ return (f->fault != DEHYST_BELIEVED) || ((f->trial > 0) && (f->trial <= WITHOUT)); }

/* Check the sensor after each cycle of the displacement without a correction, and begin another cycle. */
static void judge_cycle(dehyst_feedback *f, dehyst_real plain)
{
    const dehyst_real change = plain - f->last;
    dehyst_real range;
    if (f->samples++ == 0) { f->up = change > 0; }
    f->travelled += magnitude(change);
    f->sum += f->correction;
    f->last = plain;
    if (plain < f->low) { f->low = plain; }
    if (plain > f->high) { f->high = plain; }
    range = f->high - f->low;
    if ((range < f->least) || (f->travelled < (2 * range)) || ((change > 0) != f->up)) { return; }
    if ((f->sensor.near_count + f->sensor.far_count) < LEAST_READINGS) { return; }
    f->fault = judge_readings(&f->sensor);
    if ((f->fault == DEHYST_BELIEVED) && (f->sensor.near_count > 0)) { judge_answer(f); }
    /* The correction goes to its new value within a quarter of the cycle, without a jump: to 0, or to the mean. */
    f->back = (4 * f->bound) / (dehyst_real)f->samples;
    f->rest = takes_back(f) ? 0 : (f->sum / (dehyst_real)f->samples);
    f->heard -= f->travelled;
    f->sum = f->travelled = 0;
    f->low = f->high = plain;
    f->samples = 0;
    begin_readings(&f->sensor, plain, f->sensor.miss);
}

dehyst_real dehyst_feedback_correct(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                                    dehyst_feedback *feedback, dehyst_real measured)
{
    dehyst_feedback *f = feedback;
    dehyst_real expected;
    int near;
    f->past[f->at] = meant(model, loop, memory);
    f->at = (f->at < f->late) ? (f->at + 1) : 0;
    expected = f->past[f->at];
    near = (f->fault == DEHYST_BELIEVED) && take_reading(&f->sensor, f->bound, expected, measured);
    if (near) { f->heard = f->travelled; }
    if (takes_back(f) || (!near && (f->moved > 0) && ((f->travelled - f->heard) > (2 * f->moved)))) {
        const dehyst_real left = f->rest - f->correction;
        const dehyst_real step = (left > f->back) ? f->back : ((left < -f->back) ? -f->back : left);
        f->correction += step;
    } else if (near) {
        /* Integrate the error, without the part that limits or slew rate cause. */
        f->correction -= f->gain * (measured - expected + f->correction);
    }
    if (f->fault == DEHYST_BELIEVED) { judge_cycle(f, expected - f->correction); }
    return f->correction;
}

dehyst_real dehyst_feedback_step(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory,
                                 dehyst_feedback *feedback, dehyst_real wanted, dehyst_real measured)
{
    const dehyst_real correction = dehyst_feedback_correct(model, loop, memory, feedback, measured);
    return dehyst_loop_step(model, loop, memory, wanted + correction);
}

/* Return the displacement of the elements or the mass for u: without creep behind them, gain and offset. */
OUT_OF_LINE static dehyst_real without_output(const dehyst_model *model, const dehyst_loop *loop,
                                              const dehyst_real *inputs, dehyst_real u)
{
    const dehyst_real m = (u - loop->offset) / loop->gain;
    return not_crept(&model->output, inputs - model->output.branches, loop->driven, m);
}

/* Return the target of w for u, the newest input. */
static dehyst_real filtered(const dehyst_model *model, const dehyst_real *inputs, dehyst_real u)
{
    dehyst_real w = model->tap[0] * u;
    int m;
    for (m = 1; m < model->taps; m++) { w += model->tap[m] * inputs[m - 1]; }
    return w;
}

/* Return the command with which a lagging amplifier puts out `acting`: acting + lag times its slope. The slope comes
 * from a parabola through this and the last two acting voltages. */
static dehyst_real ahead_of_lag(const dehyst_model *model, const dehyst_loop *loop, dehyst_real acting)
{
    const dehyst_real three = (3 * acting) - (4 * loop->intended[0]) + loop->intended[1];
    return acting + (model->lag * (three / 2));
}

/* Return v within slew rate and limits. Limits come last: the slew rate must not move a voltage beyond them. */
static dehyst_real allowed(const dehyst_model *model, dehyst_loop *loop, dehyst_real v)
{
    const dehyst_model *c = model;
    if (magnitude(v - loop->sent) > c->change) {
        loop->offer = DEHYST_SLEWED;
        v = (v > loop->sent) ? (loop->sent + c->change) : (loop->sent - c->change);
    }
    if (nearest_allowed(c, v) != v) { loop->offer = DEHYST_LIMITED; }
    return nearest_allowed(c, v);
}

dehyst_real dehyst_loop_offer(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real u)
{
    dehyst_real *inputs, v;
    const dehyst_state state = state_of(model, loop, memory, &inputs);
    dehyst_candidate candidate;
    if ((model->output.branches > 0) || (loop->gain != 1) || (loop->offset != 0)) {
        u = without_output(model, loop, inputs, u);
    }
    candidate.w = (model->taps > 1) ? filtered(model, inputs, u) : u;
    loop->wanted = u;
    loop->target = candidate.w;
    loop->voltage = nearest_allowed(model, loop->sent);
    loop->offer = DEHYST_REFUSED;
    if (!is_finite(candidate.w)) { return loop->voltage; }
    candidate.cart = memory + (loop->half ? 0 : model->actuator.plain.slip.size);
    candidate.hint = loop->segment;
    dehyst_evaluate(&model->actuator, &model->step, &state, model->stiffness, &candidate);
    loop->candidate = candidate.v;
    loop->segment = candidate.hint;
    v = (model->lag > 0) ? ahead_of_lag(model, loop, candidate.v) : candidate.v;
    if (!is_finite(v)) { return loop->voltage; }
    loop->offer = DEHYST_CANDIDATE;
    return loop->voltage = allowed(model, loop, v);
}

/* Move to the candidate; its carts are in the other half of the memory. */
static void move_as_offered(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_state *state)
{
    dehyst_candidate candidate;
    candidate.w = loop->target;
    candidate.v = loop->candidate;
    candidate.cart = memory + (loop->half ? 0 : model->actuator.plain.slip.size);
    candidate.hint = loop->segment;
    dehyst_commit(&model->actuator, &model->step, state, &candidate);
}

/* Apply the voltage v, which differs from the voltage of the candidate. */
static void follow(const dehyst_model *model, dehyst_loop *loop, dehyst_state *state, dehyst_real v, int as_wanted)
{
    dehyst_real acts = v;
    if (model->lag > 0) {
        acts = (model->keep * loop->acting) + (model->from_old * loop->sent) + (model->from_new * v);
        loop->acting = acts;
        loop->intended[1] = loop->intended[0];
        loop->intended[0] = as_wanted ? loop->candidate : acts;
    }
    if (!within_reach(dehyst_simulate_step(&model->actuator, &model->step, state, model->stiffness, acts))) {
        loop->refused++;
    }
}

OUT_OF_LINE static void move_output(const dehyst_model *model, dehyst_loop *loop, dehyst_real *inputs, dehyst_real m)
{
    creep_on(&model->output, inputs - model->output.branches, m - loop->driven);
    loop->driven = m;
}

/* End a period in which v was sent. The wanted displacement drives creep behind the elements, if v leads to it, or else
 * the displacement reached. */
static void end_period(const dehyst_model *model, dehyst_loop *loop, dehyst_real *inputs, dehyst_real v, int as_wanted)
{
    int m;
    for (m = model->taps - 1; m > 0; m--) { inputs[m] = inputs[m - 1]; }
    if ((loop->offer != DEHYST_NOTHING) && within_reach(loop->wanted)) { inputs[0] = loop->wanted; }
    if (model->output.branches > 0) {
        move_output(model, loop, inputs, as_wanted ? inputs[0] : before_creep(model, loop));
    }
    loop->sent = v;
    loop->offer = DEHYST_NOTHING;
}

int dehyst_loop_accepts(const dehyst_model *model, dehyst_real v)
{
    const dehyst_real range = model->high - model->low;
    return is_finite(v) && (v >= (model->low - range)) && (v <= (model->high + range));
}

void dehyst_loop_commit(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real v)
{
    const int as_offered = (loop->offer != DEHYST_NOTHING) && (v == loop->voltage);
    const int as_wanted = as_offered && (loop->offer == DEHYST_CANDIDATE) && within_reach(loop->target);
    dehyst_real *inputs;
    dehyst_state state = state_of(model, loop, memory, &inputs);
    if (as_wanted && !(model->lag > 0)) {
        move_as_offered(model, loop, memory, &state);
    } else {
        if (as_offered) {
            loop->limited += loop->offer == DEHYST_LIMITED;
            loop->slewed += loop->offer == DEHYST_SLEWED;
            loop->refused += loop->offer == DEHYST_REFUSED;
        } else if (!dehyst_loop_accepts(model, v)) {
            loop->refused++;
            v = loop->sent;
        }
        follow(model, loop, &state, v, as_wanted);
    }
    keep_state(loop, &state, memory);
    end_period(model, loop, inputs, v, as_wanted);
}

void dehyst_loop_play(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real v)
{
    dehyst_real *inputs;
    dehyst_state state = state_of(model, loop, memory, &inputs);
    loop->offer = DEHYST_NOTHING;
    if (!is_finite(v)) { v = loop->sent; }
    follow(model, loop, &state, v, 0);
    keep_state(loop, &state, memory);
    end_period(model, loop, inputs, v, 0);
}

dehyst_real dehyst_loop_step(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, dehyst_real u)
{
    const dehyst_real v = dehyst_loop_offer(model, loop, memory, u);
    dehyst_loop_commit(model, loop, memory, v);
    return v;
}

void dehyst_loop_run(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory, const dehyst_real *u,
                     dehyst_real *v, long n)
{
    long t;
    for (t = 0; t < n; t++) { v[t] = dehyst_loop_step(model, loop, memory, u[t]); }
}
