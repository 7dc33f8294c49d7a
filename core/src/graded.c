#include "internal.h"

dehyst_status dehyst_grades_tabulate(int n, int m, const dehyst_real *knot, dehyst_real *slope, dehyst_real *value)
{
    int i, j;
    if ((n < 0) || (m < 1) || (knot == NULL) || (slope == NULL) || (value == NULL)) { return DEHYST_ERR_SIZE; }
    for (j = 0; j <= m; j++) {
        if (!is_finite(knot[j])) { return DEHYST_ERR_FINITE; }
        if ((j > 0) && !(knot[j] > knot[j - 1])) { return DEHYST_ERR_ORDER; }
    }
    for (j = 0; j < m; j++) { slope[(n * m) + j] = 0; }
    for (i = 0; i < n; i++) {
        for (j = 0; j < m; j++) {
            if (!is_finite(slope[(i * m) + j])) { return DEHYST_ERR_FINITE; }
            if (slope[(i * m) + j] < 0) { return DEHYST_ERR_SIGN; }
            slope[(n * m) + j] += slope[(i * m) + j];
        }
    }
    for (i = 0; i <= n; i++) {
        dehyst_real *row = value + (i * (m + 1));
        row[0] = 0;
        for (j = 0; j < m; j++) { row[j + 1] = row[j] + (slope[(i * m) + j] * (knot[j + 1] - knot[j])); }
        if (!is_finite(row[m])) { return DEHYST_ERR_FINITE; }
    }
    return DEHYST_OK;
}

/* Return psi_i at b, which lies in segment j; row N is the sum of all. */
static dehyst_real psi(const dehyst_grades *grades, int i, int j, dehyst_real b)
{
    return grades->value[(i * (grades->size + 1)) + j] +
           (grades->slope[(i * grades->size) + j] * (b - grades->knot[j]));
}

static int grade(const dehyst_grades *grades, dehyst_real b, int hint)
{ return count_below(grades->knot + 1, grades->size - 1, b, hint); }

/* Return the segment in which a cart slides in `direction`, `lead` behind y, and the y at which it meets the next knot.
 * The events at knots use the same comparison, so that no event occurs twice. */
static int grade_ahead(const dehyst_grades *grades, dehyst_real y, dehyst_real lead, dehyst_real direction, int hint,
                       dehyst_real *event)
{
    const dehyst_real *knot = grades->knot;
    const int last = grades->size - 1;
    int j = grade(grades, y - lead, hint);
    if (direction > 0) {
        while ((j > 0) && (y < (knot[j] + lead))) { j--; }
        while ((j < last) && (y >= (knot[j + 1] + lead))) { j++; }
        *event = (j < last) ? (knot[j + 1] + lead) : DEHYST_LARGEST;
    } else {
        while ((j < last) && (y > (knot[j + 1] + lead))) { j++; }
        while ((j > 0) && (y <= (knot[j] + lead))) { j--; }
        *event = (j > 0) ? (knot[j] + lead) : -DEHYST_LARGEST;
    }
    return j;
}

static void nearer(branch_segment *ahead, dehyst_real direction, dehyst_real event)
{
    if ((direction * (event - ahead->event)) < 0) { ahead->event = event; }
}

branch_segment dehyst_grades_look_ahead(const dehyst_actuator *actuator, const dehyst_plain_state *state, dehyst_real y,
                                        dehyst_real direction)
{
    const dehyst_slip *slip = &actuator->plain.slip;
    const dehyst_curve *spring = &actuator->plain.spring;
    const dehyst_grades *grades = &actuator->grades;
    branch_segment ahead;
    dehyst_real event;
    int i, j = segment(spring, y, spring->size / 2), hint;
    if ((direction < 0) && (j > 0) && (y <= spring->knot[j])) { j--; }
    ahead.event = direction * DEHYST_LARGEST;
    if ((direction > 0) && ((j + 2) < spring->size)) { ahead.event = spring->knot[j + 1]; }
    if ((direction < 0) && (j > 0)) { ahead.event = spring->knot[j]; }
    ahead.v = on_segment(spring, j, y);
    ahead.slope = spring->slope[j];
    hint = grade_ahead(grades, y, 0, direction, grades->size / 2, &event);
    nearer(&ahead, direction, event);
    ahead.v += psi(grades, slip->size, hint, y);
    ahead.slope += grades->slope[(slip->size * grades->size) + hint];
    for (i = 0; i < slip->size; i++) {
        dehyst_real lead = direction * slip->rho[i], breakaway = state->cart[i] + lead;
        if ((direction * (breakaway - y)) > 0) {
            hint = grade(grades, state->cart[i], hint);
            ahead.v -= psi(grades, i, hint, state->cart[i]);
            nearer(&ahead, direction, breakaway);
        } else {
            hint = grade_ahead(grades, y, lead, direction, hint, &event);
            ahead.v -= psi(grades, i, hint, y - lead);
            ahead.slope -= grades->slope[(i * grades->size) + hint];
            nearer(&ahead, direction, event);
        }
    }
    return ahead;
}

dehyst_real dehyst_grades_stiffness(const dehyst_actuator *actuator, int i, dehyst_real y, dehyst_real direction)
{
    const dehyst_grades *grades = &actuator->grades;
    dehyst_real event;
    const int j = grade_ahead(grades, y, direction * actuator->plain.slip.rho[i], direction, grades->size / 2, &event);
    return grades->slope[(i * grades->size) + j];
}

dehyst_real dehyst_grades_voltage(const dehyst_actuator *actuator, const dehyst_plain_state *state)
{
    const dehyst_grades *grades = &actuator->grades;
    int i, n = actuator->plain.slip.size, hint = grade(grades, state->y, grades->size / 2);
    dehyst_real v = dehyst_curve_at(&actuator->plain.spring, state->y) + psi(grades, n, hint, state->y);
    for (i = 0; i < n; i++) {
        hint = grade(grades, state->cart[i], hint);
        v -= psi(grades, i, hint, state->cart[i]);
    }
    return v;
}

/* The segment is searched for moving carts only. */
void dehyst_grades_compensate(const dehyst_actuator *actuator, dehyst_plain_state *state, dehyst_real *at_cart,
                              int *where, const dehyst_real *y, dehyst_real *v, long n)
{
    const dehyst_slip *slip = &actuator->plain.slip;
    const dehyst_curve *spring = &actuator->plain.spring;
    const dehyst_grades *grades = &actuator->grades;
    dehyst_real *cart = state->cart, present = state->y;
    int i, j = segment(spring, present, 0), k = grade(grades, present, 0);
    long t;
    for (i = 0; i < slip->size; i++) {
        where[i] = grade(grades, cart[i], k);
        at_cart[i] = psi(grades, i, where[i], cart[i]);
    }
    for (t = 0; t < n; t++) {
        dehyst_real sum = 0;
        if (is_finite(y[t])) { present = y[t]; }
        for (i = 0; i < slip->size; i++) {
            dehyst_real low = present - slip->rho[i], high = present + slip->rho[i];
            if ((cart[i] < low) || (cart[i] > high)) {
                cart[i] = (cart[i] < low) ? low : high;
                where[i] = grade(grades, cart[i], where[i]);
                at_cart[i] = psi(grades, i, where[i], cart[i]);
            }
            sum += at_cart[i];
        }
        j = segment(spring, present, j);
        k = grade(grades, present, k);
        v[t] = on_segment(spring, j, present) + psi(grades, slip->size, k, present) - sum;
    }
    state->y = present;
}
