#include "internal.h"

/* The curvature is below rounding if the rest of the motion is shorter than this part of the shortest element. */
#define SHARE ((dehyst_real)(1.0 / 16))
/* A motion in lengths whose ninth power is below rounding relative to the motion. */
#define SHORT_WAY ((dehyst_real)(1.0 / 64))
/* Largest number of Newton steps of a solution, without steps that pass events. From below they never go too far. For a
 * sliding element they need ln(stiffness of the element / remaining stiffness) steps. */
#define TRIES 200

/* The series x - x^2 / 2 + ... of 1 - exp(-x) to its eighth power, in an order with few dependent sums. */
static dehyst_real short_decay(dehyst_real x)
{
    const dehyst_real t = x * x;
    const dehyst_real low =
        (1 - (x * (dehyst_real)0.5)) + (t * ((dehyst_real)(1.0 / 6) - (x * (dehyst_real)(1.0 / 24))));
    const dehyst_real high = ((dehyst_real)(1.0 / 120) - (x * (dehyst_real)(1.0 / 720))) +
                             (t * ((dehyst_real)(1.0 / 5040) - (x * (dehyst_real)(1.0 / 40320))));
    return x * (low + (t * t * high));
}

/* Exact to a few units in the last place, however small x is. With f = n ln 2 - x, exp(f) - 1 = f + f c / (2 - c) where
 * c = f + 2 - f coth(f / 2) = f - f^2 / 6 + f^4 / 360 - ... (Bernoulli's numbers). */
dehyst_real dehyst_decay(dehyst_real x)
{
    static const dehyst_real half[] = {(dehyst_real)0x1p-1, (dehyst_real)0x1p-2,  (dehyst_real)0x1p-4,
                                       (dehyst_real)0x1p-8, (dehyst_real)0x1p-16, (dehyst_real)0x1p-32};
    const dehyst_real high = (dehyst_real)6.93147180369123816490e-01, low = (dehyst_real)1.90821492927058770002e-10;
    dehyst_real f, t, c, rest, scale = 1;
    int n, i;
    if (x > 40) { return 1; }
    /* NaN must not be converted to int. */
    if (!(x > 0)) { return 0; }
    if (x < SHORT_WAY) { return short_decay(x); }
    n = (int)((x * (dehyst_real)1.4426950408889634) + (dehyst_real)0.5);
    f = ((dehyst_real)n * high) - x + ((dehyst_real)n * low);
    t = f * f;
    c = f -
        (t *
         ((dehyst_real)(1.0 / 6) -
          (t * ((dehyst_real)(1.0 / 360) -
                (t * ((dehyst_real)(1.0 / 15120) -
                      (t * ((dehyst_real)(1.0 / 604800) -
                            (t * ((dehyst_real)(1.0 / 23950080) - (t * (dehyst_real)(691.0 / 653837184000.0))))))))))));
    rest = f + (f * c / (2 - c));
    for (i = 0; i < 6; i++) {
        if ((n >> i) & 1) { scale *= half[i]; }
    }
    return (1 - scale) - (scale * rest);
}

/* 2 artanh(s) with s = a / (2 + a); if (1 + a) / 2 is nearer to 1, for this number. */
dehyst_real dehyst_log1p(dehyst_real a)
{
    static const dehyst_real term[] = {(dehyst_real)(2.0 / 3),  (dehyst_real)(2.0 / 5),  (dehyst_real)(2.0 / 7),
                                       (dehyst_real)(2.0 / 9),  (dehyst_real)(2.0 / 11), (dehyst_real)(2.0 / 13),
                                       (dehyst_real)(2.0 / 15), (dehyst_real)(2.0 / 17), (dehyst_real)(2.0 / 19),
                                       (dehyst_real)(2.0 / 21)};
    const int upper = a > (dehyst_real)0.4142;
    const dehyst_real b = upper ? ((a - 1) / 2) : a, s = b / (2 + b), t = s * s;
    dehyst_real sum = (dehyst_real)(2.0 / 23);
    int m;
    for (m = 9; m >= 0; m--) { sum = (sum * t) + term[m]; }
    sum = (s * t * sum) + (2 * s);
    return upper ? (sum + (dehyst_real)0.69314718055994530942) : sum;
}

dehyst_status dehyst_smooth_tabulate(int n, const dehyst_real *length, const dehyst_real *closing, dehyst_real *back)
{
    int l;
    if ((n < 0) || ((n > 0) && ((length == NULL) || (closing == NULL) || (back == NULL)))) { return DEHYST_ERR_SIZE; }
    for (l = 0; l < n; l++) {
        if (!is_finite(length[l]) || !is_finite(closing[l])) { return DEHYST_ERR_FINITE; }
        if (!(length[l] > 0) || ((2 * closing[l]) < 1) || (closing[l] > 1)) { return DEHYST_ERR_SIGN; }
        back[l] = ((2 * closing[l]) - 1) / length[l];
        if (!is_finite(back[l])) { return DEHYST_ERR_FINITE; }
    }
    return DEHYST_OK;
}

dehyst_status dehyst_smooth_check(const dehyst_smooth *smooth, const dehyst_real *elongation)
{
    int l;
    if (smooth->size < 0) { return DEHYST_ERR_SIZE; }
    if ((smooth->size > 0) && ((smooth->length == NULL) || (smooth->back == NULL) || (smooth->stiffness == NULL))) {
        return DEHYST_ERR_SIZE;
    }
    if ((smooth->size > 0) && (elongation == NULL)) { return DEHYST_ERR_SIZE; }
    for (l = 0; l < smooth->size; l++) {
        if (!is_finite(smooth->stiffness[l]) || !is_finite(elongation[l])) { return DEHYST_ERR_FINITE; }
        if (smooth->stiffness[l] < 0) { return DEHYST_ERR_SIGN; }
        if (magnitude(elongation[l]) > (smooth->length[l] * (1 + (8 * DEHYST_EPSILON)))) { return DEHYST_ERR_STATE; }
    }
    return DEHYST_OK;
}

/* While an element returns against its elongation, r' = 1 - back r, which is above 1, until r is 0; then
 * r' = 1 - r / length. */
dehyst_real dehyst_smooth_moved(const dehyst_smooth *smooth, int l, dehyst_real r, dehyst_real way)
{
    const dehyst_real length = smooth->length[l], back = smooth->back[l];
    if (r < 0) {
        const dehyst_real end = r + ((back > 0) ? ((1 - (back * r)) * dehyst_decay(back * way) / back) : way);
        if (end <= 0) { return end; }
        way -= (back > 0) ? (dehyst_log1p(-back * r) / back) : -r;
        if (way < 0) { way = 0; }
        r = 0;
    }
    r += (length - r) * dehyst_decay(way / length);
    return (r < length) ? r : length;
}

void dehyst_smooth_move(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real by)
{
    const dehyst_real direction = (by < 0) ? -1 : 1;
    int l;
    if (!(by != 0)) { return; }
    for (l = 0; l < smooth->size; l++) {
        elongation[l] = direction * dehyst_smooth_moved(smooth, l, direction * elongation[l], direction * by);
    }
}

void dehyst_smooth_elongations(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real y,
                               const dehyst_real *path, dehyst_real *out, long n)
{
    long t;
    int l;
    for (t = 0; t < n; t++) {
        if (is_finite(path[t])) {
            dehyst_smooth_move(smooth, elongation, path[t] - y);
            y = path[t];
        }
        for (l = 0; l < smooth->size; l++) { *out++ = elongation[l]; }
    }
}

dehyst_real dehyst_smooth_voltage(const dehyst_smooth *smooth, const dehyst_real *elongation)
{
    dehyst_real sum = 0;
    int l;
    for (l = 0; l < smooth->size; l++) { sum += smooth->stiffness[l] * elongation[l]; }
    return sum;
}

dehyst_real dehyst_smooth_voltage_after(const dehyst_smooth *smooth, const dehyst_real *elongation, dehyst_real by)
{
    const dehyst_real direction = (by < 0) ? -1 : 1;
    dehyst_real sum = 0;
    int l;
    for (l = 0; l < smooth->size; l++) {
        sum += smooth->stiffness[l] *
               (direction * dehyst_smooth_moved(smooth, l, direction * elongation[l], direction * by));
    }
    return sum;
}

void dehyst_smooth_compensate(const dehyst_smooth *smooth, dehyst_real *elongation, dehyst_real y,
                              const dehyst_real *path, dehyst_real *v, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        if (is_finite(path[t])) {
            dehyst_smooth_move(smooth, elongation, path[t] - y);
            y = path[t];
        }
        v[t] += dehyst_smooth_voltage(smooth, elongation);
    }
}

/* Return the whole right-hand side at w without changing the state: value, slope ahead, and the next change of slope of
 * its straight parts. Between such changes it is concave along the motion, because smooth elements only get softer. */
static branch_segment meet(const dehyst_actuator *actuator, const dehyst_state *state, dehyst_real stiffness,
                           dehyst_real w, dehyst_real direction)
{
    const dehyst_smooth *smooth = &actuator->smooth;
    const dehyst_real by = w - state->memory.y;
    branch_segment ahead = look_ahead(actuator, &state->memory, w, direction);
    int l;
    ahead.v += stiffness * by;
    ahead.slope += stiffness;
    for (l = 0; l < smooth->size; l++) {
        const dehyst_real k = smooth->stiffness[l];
        const dehyst_real r = dehyst_smooth_moved(smooth, l, direction * state->elongation[l], direction * by);
        ahead.v += k * direction * r;
        ahead.slope += k * ((r < 0) ? (1 - (smooth->back[l] * r)) : (1 - (r / smooth->length[l])));
    }
    return ahead;
}

/* Step over several events; if this would pass the solution, over the next event. `beyond` lies past the solution. */
static branch_segment hop(const dehyst_actuator *actuator, const dehyst_state *state, dehyst_real drive,
                          dehyst_real stiffness, dehyst_real direction, dehyst_real goal, dehyst_real event,
                          dehyst_real *w, dehyst_real *beyond)
{
    const dehyst_real far = ((direction * (goal - *beyond)) < 0) ? goal : (event + ((*beyond - event) / 2));
    const branch_segment there = meet(actuator, state, stiffness, far, direction);
    *w = far;
    if ((direction * (drive - there.v)) >= 0) { return there; }
    *beyond = far;
    *w = event;
    return meet(actuator, state, stiffness, event, direction);
}

dehyst_real dehyst_smooth_solve(const dehyst_actuator *actuator, dehyst_state *state, dehyst_real drive,
                                dehyst_real stiffness, dehyst_real *likely)
{
    const dehyst_smooth *smooth = &actuator->smooth;
    const int grades = (actuator->grades.size > 0) ? actuator->grades.size : 1;
    int tries = TRIES + ((actuator->plain.slip.size + 1) * grades) + actuator->plain.spring.size, l;
    dehyst_real w = state->memory.y, direction = *likely, shortest = smooth->length[0], beyond;
    branch_segment ahead;
    if (!is_finite(drive)) { return w; }
    for (l = 1; l < smooth->size; l++) {
        if (smooth->length[l] < shortest) { shortest = smooth->length[l]; }
    }
    ahead = meet(actuator, state, stiffness, w, direction);
    if ((direction * (drive - ahead.v)) < 0) {
        *likely = direction = -direction;
        ahead = meet(actuator, state, stiffness, w, direction);
    }
    beyond = direction * DEHYST_LARGEST;
    while ((tries-- > 0) && ((direction * (drive - ahead.v)) > 0)) {
        const dehyst_real goal = w + ((drive - ahead.v) / ahead.slope), step = (goal - w) / shortest;
        if ((direction * (goal - ahead.event)) > 0) {
            ahead = hop(actuator, state, drive, stiffness, direction, goal, ahead.event, &w, &beyond);
            continue;
        }
        w = goal;
        /* The next correction is proportional to the square of this step. */
        if ((step * step) <= (SHARE * DEHYST_EPSILON)) { break; }
        ahead = meet(actuator, state, stiffness, w, direction);
    }
    if (!within_reach(w)) { return w; }
    dehyst_slip_move(&actuator->plain.slip, state->memory.cart, w);
    dehyst_smooth_move(smooth, state->elongation, w - state->memory.y);
    state->memory.y = w;
    return w;
}
