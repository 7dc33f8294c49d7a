#include "internal.h"

static int is_increasing(const dehyst_real *a, int n)
{
    int i;
    for (i = 1; i < n; i++) {
        if (!(a[i] > a[i - 1])) { return 0; }
    }
    return 1;
}

static int all_finite(const dehyst_real *a, int n)
{
    int i;
    for (i = 0; i < n; i++) {
        if (!is_finite(a[i])) { return 0; }
    }
    return 1;
}

dehyst_status dehyst_curve_tabulate(int size, const dehyst_real *knot, const dehyst_real *value, dehyst_real *slope)
{
    int j;
    if ((size < 2) || (knot == NULL) || (value == NULL) || (slope == NULL)) { return DEHYST_ERR_SIZE; }
    if (!all_finite(knot, size) || !all_finite(value, size)) { return DEHYST_ERR_FINITE; }
    if (!is_increasing(knot, size) || !is_increasing(value, size)) { return DEHYST_ERR_ORDER; }
    for (j = 0; (j + 1) < size; j++) {
        slope[j] = (value[j + 1] - value[j]) / (knot[j + 1] - knot[j]);
        if (!is_finite(slope[j])) { return DEHYST_ERR_FINITE; }
        if (!(slope[j] > 0)) { return DEHYST_ERR_ORDER; }
    }
    return DEHYST_OK;
}

dehyst_status dehyst_slip_check(int n, const dehyst_real *rho, const dehyst_real *kappa)
{
    dehyst_real voltage = 0, stiffness = 0;
    int i;
    if ((n < 0) || ((n > 0) && ((rho == NULL) || (kappa == NULL)))) { return DEHYST_ERR_SIZE; }
    if (!all_finite(rho, n) || !all_finite(kappa, n)) { return DEHYST_ERR_FINITE; }
    for (i = 0; i < n; i++) {
        if (!(rho[i] > 0) || (kappa[i] < 0)) { return DEHYST_ERR_SIGN; }
        voltage += 2 * kappa[i] * rho[i];
    }
    if (!is_increasing(rho, n)) { return DEHYST_ERR_ORDER; }
    for (i = n - 1; i >= 0; i--) { stiffness += kappa[i]; }
    return (is_finite(voltage) && is_finite(stiffness)) ? DEHYST_OK : DEHYST_ERR_FINITE;
}

dehyst_status dehyst_slip_tabulate(int n, const dehyst_real *rho, const dehyst_real *kappa, dehyst_real *edge,
                                   dehyst_real *intercept, dehyst_real *stiffness, dehyst_real *inverse_step)
{
    const dehyst_status status = dehyst_slip_check(n, rho, kappa);
    int i;
    if (status != DEHYST_OK) { return status; }
    if ((edge == NULL) || (intercept == NULL) || (stiffness == NULL) || (inverse_step == NULL)) {
        return DEHYST_ERR_SIZE;
    }
    edge[n] = DEHYST_LARGEST;
    stiffness[n] = 0;
    for (i = n - 1; i >= 0; i--) {
        edge[i] = 2 * rho[i];
        stiffness[i] = stiffness[i + 1] + kappa[i];
    }
    intercept[0] = 0;
    for (i = 0; i < n; i++) { intercept[i + 1] = intercept[i] + (2 * kappa[i] * rho[i]); }
    *inverse_step = (n > 0) ? (1 / edge[0]) : 0;
    for (i = 0; i < n; i++) {
        if (magnitude(edge[i] - ((dehyst_real)(i + 1) * edge[0])) > ((dehyst_real)1e-6 * edge[0])) {
            *inverse_step = 0;
        }
    }
    return DEHYST_OK;
}

dehyst_status dehyst_plain_check(const dehyst_plain *plain, const dehyst_plain_state *state)
{
    const dehyst_slip *slip = &plain->slip;
    int i;
    if ((slip->size > 0) && (state->cart == NULL)) { return DEHYST_ERR_SIZE; }
    if (!is_finite(state->y) || !all_finite(state->cart, slip->size)) { return DEHYST_ERR_FINITE; }
    for (i = 0; i < slip->size; i++) {
        dehyst_real allowance = 8 * DEHYST_EPSILON * (magnitude(state->y) + slip->rho[i]);
        if (magnitude(state->y - state->cart[i]) > (slip->rho[i] + allowance)) { return DEHYST_ERR_STATE; }
    }
    return DEHYST_OK;
}

dehyst_real dehyst_curve_at(const dehyst_curve *curve, dehyst_real x)
{ return on_segment(curve, segment(curve, x, curve->size / 2), x); }

dehyst_real dehyst_curve_inverse(const dehyst_curve *curve, dehyst_real value)
{
    int j = count_below(curve->value + 1, curve->size - 2, value, curve->size / 2);
    return curve->knot[j] + ((value - curve->value[j]) / curve->slope[j]);
}

void dehyst_slip_move(const dehyst_slip *slip, dehyst_real *cart, dehyst_real y)
{
    int i;
    for (i = 0; i < slip->size; i++) { cart[i] = cart_after(cart[i], y, slip->rho[i]); }
}

void dehyst_slip_elongations(const dehyst_slip *slip, dehyst_real *cart, const dehyst_real *y, dehyst_real *out, long n)
{
    long t;
    int i;
    for (t = 0; t < n; t++) {
        dehyst_slip_move(slip, cart, y[t]);
        for (i = 0; i < slip->size; i++) { *out++ = y[t] - cart[i]; }
    }
}

dehyst_real dehyst_plain_voltage(const dehyst_plain *plain, const dehyst_plain_state *state)
{
    const dehyst_slip *slip = &plain->slip;
    dehyst_real v = 0;
    int i;
    for (i = 0; i < slip->size; i++) { v += slip->kappa[i] * (state->y - state->cart[i]); }
    return v + dehyst_curve_at(&plain->spring, state->y);
}

dehyst_real dehyst_plain_compensate(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_real y)
{
    if (is_finite(y)) {
        dehyst_slip_move(&plain->slip, state->cart, y);
        state->y = y;
    }
    return dehyst_plain_voltage(plain, state);
}

branch_segment dehyst_plain_look_ahead(const dehyst_plain *plain, const dehyst_plain_state *state, dehyst_real y,
                                       dehyst_real direction)
{
    const dehyst_slip *slip = &plain->slip;
    const dehyst_curve *spring = &plain->spring;
    branch_segment ahead = {0, 0, 0};
    int i, j = segment(spring, y, spring->size / 2);
    if ((direction < 0) && (j > 0) && (y <= spring->knot[j])) { j--; }
    ahead.event = direction * DEHYST_LARGEST;
    if ((direction > 0) && ((j + 2) < spring->size)) { ahead.event = spring->knot[j + 1]; }
    if ((direction < 0) && (j > 0)) { ahead.event = spring->knot[j]; }
    for (i = 0; i < slip->size; i++) {
        dehyst_real breakaway = state->cart[i] + (direction * slip->rho[i]);
        if ((direction * (breakaway - y)) > 0) {
            ahead.v += slip->kappa[i] * (y - state->cart[i]);
            ahead.slope += slip->kappa[i];
            if ((direction * (breakaway - ahead.event)) < 0) { ahead.event = breakaway; }
        } else {
            ahead.v += direction * slip->kappa[i] * slip->rho[i];
        }
    }
    ahead.v += on_segment(spring, j, y);
    ahead.slope += spring->slope[j];
    return ahead;
}

dehyst_real dehyst_plain_simulate(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_real v)
{
    dehyst_real y = state->y, direction = 1;
    int changes = plain->slip.size + plain->spring.size;
    branch_segment ahead;
    if (!is_finite(v)) { return y; }
    ahead = dehyst_plain_look_ahead(plain, state, y, direction);
    if (v < ahead.v) {
        direction = -1;
        ahead = dehyst_plain_look_ahead(plain, state, y, direction);
    }
    while (changes-- > 0) {
        dehyst_real goal = y + ((v - ahead.v) / ahead.slope);
        if ((direction * (goal - ahead.event)) <= 0) {
            y = goal;
            break;
        }
        y = ahead.event;
        ahead = dehyst_plain_look_ahead(plain, state, y, direction);
    }
    if (!within_reach(y)) { return y; }
    dehyst_slip_move(&plain->slip, state->cart, y);
    state->y = y;
    return y;
}
