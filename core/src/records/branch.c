#include "branch.h"

/* Largest number of steps of a solution, without steps that pass events. */
#define TRIES 200
/* With more events in a sample, Newton steps from the start are faster. */
#define FEW_EVENTS 2
/* A step over the length of the shortest smooth element whose third power is below rounding. */
#define LAST_STEP (DEHYST_EPSILON < (dehyst_real)1e-9 ? (dehyst_real)4e-6 : (dehyst_real)2e-3)

/* Compute the elastic way back of the segment ahead. */
static void describe(dehyst_branch *b)
{
    const dehyst_slip *slip = &b->actuator->plain.slip;
    const dehyst_real d = b->direction;
    int i;
    b->width = DEHYST_LARGEST;
    b->bottom = -DEHYST_LARGEST;
    b->elastic = b->ahead.slope;
    for (i = 0; i < slip->size; i++) {
        const dehyst_real cart = b->memory->cart[i], rho = slip->rho[i];
        if (d * (cart + d * rho - b->from) > 0) {
            if (d * cart - rho > b->bottom) b->bottom = d * cart - rho;
        } else {
            if (2 * rho < b->width) b->width = 2 * rho;
            b->elastic += b->actuator->grades.size > 0 ? dehyst_grades_stiffness(b->actuator, i, b->from, d)
                                                       : slip->kappa[i];
        }
    }
    if (d * b->from > b->bottom) b->bottom = d * b->from;
}

static void put(dehyst_branch *b, dehyst_real from)
{
    b->from = from;
    b->ahead = look_ahead(b->actuator, b->memory, from, b->direction);
}

/* Move the carts to the farthest point. */
static void settle(dehyst_branch *b)
{
    dehyst_slip_move(&b->actuator->plain.slip, b->memory->cart, b->far);
    b->memory->y = b->far;
}

/* Turn at the farthest point. */
static void turn(dehyst_branch *b)
{
    settle(b);
    b->direction = -b->direction;
    put(b, b->far);
    describe(b);
}

void dehyst_branch_begin(dehyst_branch *branch, const dehyst_actuator *actuator, dehyst_plain_state *memory)
{
    branch->actuator = actuator;
    branch->memory = memory;
    branch->direction = 1;
    branch->w = branch->far = memory->y;
    put(branch, memory->y);
    describe(branch);
}

void dehyst_branch_end(dehyst_branch *branch)
{
    settle(branch);
    branch->memory->y = branch->w;
}

/* Return the end of the elastic way back, times the direction. */
static inline dehyst_real way_back(const dehyst_branch *b)
{
    const dehyst_real back = b->direction * b->far - b->width;
    return back > b->bottom ? back : b->bottom;
}

static inline dehyst_real voltage_at_far(const dehyst_branch *b)
{
    return b->ahead.v + b->ahead.slope * (b->far - b->from);
}

/* Pass the events between the segment and the solution by Newton steps; if such a step is too far, pass one event.
 * Return the solution, which then lies on the segment. */
static dehyst_real pass_events(dehyst_branch *b, dehyst_real drive, dehyst_real stiffness)
{
    const dehyst_real d = b->direction, start = b->w;
    const int grades = b->actuator->grades.size > 0 ? b->actuator->grades.size : 1;
    int tries = TRIES + (b->actuator->plain.slip.size + 1) * grades + b->actuator->plain.spring.size;
    dehyst_real beyond = d * DEHYST_LARGEST, goal = b->far;
    while (tries-- > 0) {
        const dehyst_real event = b->ahead.event;
        dehyst_real there;
        goal = b->from + (drive - b->ahead.v - stiffness * (b->from - start)) / (b->ahead.slope + stiffness);
        if (d * (goal - event) <= 0) break;
        there = d * (goal - beyond) < 0 ? goal : event + (beyond - event) / 2;
        if (!within_reach(there)) return there;
        put(b, there);
        if (d * (drive - b->ahead.v - stiffness * (there - start)) < 0) {
            beyond = there;
            put(b, event);
        }
    }
    return goal;
}

dehyst_real dehyst_branch_solve(dehyst_branch *b, dehyst_real drive, dehyst_real stiffness)
{
    dehyst_branch before;
    dehyst_real d = b->direction, w;
    if (!is_finite(drive)) return b->w;
    w = b->from + (drive - b->ahead.v - stiffness * (b->from - b->w)) / (b->ahead.slope + stiffness);
    if (d * (w - b->far) >= 0) {
        if (d * (w - b->ahead.event) <= 0) return b->w = b->far = w;
        before = *b;
    } else {
        w = b->far + (drive - voltage_at_far(b) - stiffness * (b->far - b->w)) / (b->elastic + stiffness);
        if (d * w >= way_back(b)) return b->w = w;
        before = *b;
        turn(b);
    }
    w = pass_events(b, drive, stiffness);
    if (!within_reach(w)) {
        if (b->direction == before.direction) *b = before;
        return w;
    }
    b->w = b->far = w;
    describe(b);
    return w;
}

/* Return the straight parts at the present w, ahead in a direction. */
static branch_segment line(const dehyst_branch *b, dehyst_real direction)
{
    branch_segment segment = {voltage_at_far(b) + b->elastic * (b->w - b->far), b->elastic, b->far};
    if (direction != b->direction) {
        segment.event = b->direction * way_back(b);
    } else if (b->w == b->far) {
        segment.slope = b->ahead.slope;
        segment.event = b->ahead.event;
    }
    return segment;
}

/* Continue beyond an event at the present w. At the farthest point, the segment ahead is known. */
static void pass_event(dehyst_branch *b, dehyst_real direction)
{
    if (direction != b->direction)
        turn(b);
    else if (b->w == b->far)
        return;
    b->far = b->w;
    put(b, b->w);
    describe(b);
}

/* Smooth elements after a motion: voltage, slope, and change of slope, ahead in the direction of motion. */
typedef struct smooth_parts {
    dehyst_real v, slope, bend;
} smooth_parts;

/* Return the fall of the slope of an element with r; `inverse` [L]: 1 / length. */
static inline dehyst_real rate_of(const dehyst_smooth *smooth, const dehyst_real *inverse, int l, dehyst_real r)
{
    return r < 0 ? smooth->back[l] : inverse[l];
}

/* @param after [L] the result: elongations, positive in the direction of motion; behind them [L] inverse lengths */
static smooth_parts smooth_after(const dehyst_smooth *smooth, const dehyst_real *elongation, dehyst_real direction,
                                 dehyst_real by, dehyst_real *after)
{
    const dehyst_real *inverse = after + smooth->size;
    smooth_parts sum = {0, 0, 0};
    int l;
    for (l = 0; l < smooth->size; l++) {
        const dehyst_real k = smooth->stiffness[l], q = direction * elongation[l];
        const dehyst_real r = by != 0 ? dehyst_smooth_moved(smooth, l, q, direction * by) : q;
        const dehyst_real rate = rate_of(smooth, inverse, l, r), slope = k * (1 - r * rate);
        after[l] = r;
        sum.v += k * direction * r;
        sum.slope += slope;
        sum.bend -= slope * rate;
    }
    return sum;
}

/* Move elongations over a short last step whose third power is below rounding. */
static void last_step(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real direction, dehyst_real by,
                      const dehyst_real *after)
{
    const dehyst_real way = direction * by;
    int l;
    for (l = 0; l < smooth->size; l++) {
        const dehyst_real q = after[l], rate = rate_of(smooth, after + smooth->size, l, q), slope = 1 - q * rate;
        dehyst_real r = q + slope * way * (1 - rate * way / 2);
        if (way < 0 ? q >= 0 && r < 0 : q < 0 && r > 0) r = way > 0 ? dehyst_smooth_moved(smooth, l, q, way) : 0;
        elongation[l] = direction * (r < smooth->length[l] ? r : smooth->length[l]);
    }
}

void dehyst_smooth_prepare(const dehyst_smooth *smooth, dehyst_real *work)
{
    dehyst_real *inverse = work + smooth->size, *largest = inverse + smooth->size;
    int l;
    *largest = 0;
    for (l = 0; l < smooth->size; l++) {
        inverse[l] = 1 / smooth->length[l];
        if (inverse[l] > *largest) *largest = inverse[l];
    }
}

/* Move along the straight parts by a parabola through value, slope and bend, until a step is short. Between events the
 * curve is concave along the motion, because smooth elements only get softer: if a Newton step passes an event, so does
 * the solution. Return 0 if this path passes many events, or does not end.
 * @param after [2 L + 1] from dehyst_smooth_prepare */
static int along(dehyst_branch *b, dehyst_real *elongation, dehyst_real drive, dehyst_real stiffness,
                 dehyst_real direction, dehyst_real *after)
{
    const dehyst_smooth *smooth = &b->actuator->smooth;
    const dehyst_real start = b->w, last = LAST_STEP / after[2 * smooth->size];
    branch_segment straight = line(b, direction);
    dehyst_real w = start, origin = start;
    int tries, events = 0;
    for (tries = 0; tries < TRIES; tries++) {
        const smooth_parts parts = smooth_after(smooth, elongation, direction, w - start, after);
        /* This division does not depend on the drive and runs in parallel. */
        const dehyst_real softness = 1 / (straight.slope + stiffness + parts.slope);
        const dehyst_real rest =
            drive - (straight.v + straight.slope * (w - origin)) - stiffness * (w - start) - parts.v;
        const dehyst_real step = rest * softness;
        const dehyst_real more = step * (-direction * parts.bend * softness / 2);
        const dehyst_real at = w;
        if (direction * (w + step - straight.event) > 0) {
            if (!within_reach(straight.event) || ++events > FEW_EVENTS) return 0;
            w = origin = b->w = straight.event;
            pass_event(b, direction);
            straight = line(b, direction);
            continue;
        }
        w += step * (more < (dehyst_real)0.5 ? 1 + more : 1);
        if (direction * (w - straight.event) > 0) w = straight.event;
        if (direction * (w - origin) < 0) w = origin;
        if (magnitude(step) <= last) {
            last_step(smooth, elongation, direction, w - at, after);
            b->w = w;
            if (b->direction * (w - b->far) > 0) b->far = w;
            return 1;
        }
    }
    return 0;
}

dehyst_real dehyst_branch_solve_smooth(dehyst_branch *b, dehyst_state *state, dehyst_real drive, dehyst_real stiffness,
                                       dehyst_real *after)
{
    const dehyst_branch before = *b;
    dehyst_real direction = b->direction, w;
    if (!is_finite(drive)) return b->w;
    if (direction * (drive - line(b, direction).v - dehyst_smooth_voltage(&b->actuator->smooth, state->elongation)) < 0)
        direction = -direction;
    if (along(b, state->elongation, drive, stiffness, direction, after)) return b->w;
    /* No cart has gone farther than before. */
    *b = before;
    dehyst_branch_end(b);
    w = dehyst_solve(b->actuator, state, drive, stiffness, &direction);
    dehyst_branch_begin(b, b->actuator, b->memory);
    return w;
}
