#include "dehyst_parts.h"

#include <stddef.h>

/* Samples on the carts between two attempts to encode a state that has no stack yet. */
#define BLOCK 256

/* The index of the cell of 2 phi(u / 2) that holds u >= 0. */
static int cell_of(const dehyst_slip *slip, dehyst_real u, int hint)
{
    if (slip->inverse_step > 0) {
        dehyst_real guess = u * slip->inverse_step;
        hint = guess < slip->size ? (int)guess : slip->size;
    }
    return count_below(slip->edge, slip->size, u, hint);
}

static dehyst_real masing(const dehyst_slip *slip, int cell, dehyst_real u)
{
    return slip->intercept[cell] + slip->stiffness[cell] * u;
}

static dehyst_real distance(const dehyst_reversal *a, const dehyst_reversal *b) { return magnitude(a->y - b->y); }

/* Turn round at the present place. A branch that has moved every cart forgets what lies below it. Of three successive
 * nested amplitudes in one cell the two middle reversals bound a loop that no element tells from a straight line. */
static void turn(const dehyst_slip *slip, dehyst_stack *stack, dehyst_real stops)
{
    dehyst_reversal *r = stack->reversal;
    dehyst_reversal here;
    here.y = stack->y;
    here.stops = stops;
    here.v = stack->v;
    if (stack->depth == 2 && cell_of(slip, distance(&here, &r[1]), 0) == slip->size) {
        r[0] = r[1];
        stack->depth = 1;
    }
    /* On an outermost branch every cart slides, wherever it began: its beginning is put where rounding cannot make the
     * amplitude look shorter than it takes to move them all. */
    if (stack->depth == 1 && slip->size > 0) r[0].y = here.y - stack->direction * 2 * slip->edge[slip->size - 1];
    r[stack->depth++] = here;
    stack->direction = -stack->direction;
    if (stack->depth >= 4) {
        dehyst_reversal *last = r + stack->depth - 1;
        int cell = cell_of(slip, distance(last - 3, last - 2), 0);
        if (cell == cell_of(slip, distance(last - 1, last), cell)) {
            last[-2] = *last;
            stack->depth -= 2;
        }
    }
}

/* The reversal at which the present branch joins the outer one again, or NULL on an outermost branch. */
static const dehyst_reversal *joint(const dehyst_stack *stack)
{
    return stack->depth >= 3 ? stack->reversal + stack->depth - 2 : NULL;
}

/* Turn round at y, a point of the present branch in this cell and near this segment of the spring. */
static void turn_at(const dehyst_actuator *actuator, dehyst_stack *stack, dehyst_real y, int cell, int j)
{
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    const dehyst_real stops =
        from->stops + stack->direction * masing(&actuator->slip, cell, magnitude(y - from->y));
    stack->y = y;
    stack->v = stops + on_segment(&actuator->spring, segment(&actuator->spring, y, j), y);
    turn(&actuator->slip, stack, stops);
}

dehyst_status dehyst_stack_encode(const dehyst_actuator *actuator, const dehyst_state *state, dehyst_stack *stack)
{
    const dehyst_slip *slip = &actuator->slip;
    dehyst_reversal *r = stack->reversal, swap;
    dehyst_real direction, y = state->y, cart = state->y, rho = 0, total = 0;
    int i, count = 0;
    if (stack->capacity < DEHYST_STACK_CAPACITY(slip->size)) return DEHYST_ERR_CAPACITY;
    /* The carts are points of a memory curve b(rho) of slope -+1; between two of them it has at most one corner, and
     * each of its straight pieces, prolonged to rho = 0, names a reversal. */
    direction = slip->size > 0 && state->cart[0] > state->y ? -1 : 1;
    stack->direction = direction;
    for (i = 0; i < slip->size; i++) {
        dehyst_real width = slip->rho[i] - rho, rise = -direction * (state->cart[i] - cart);
        dehyst_real allowance = 8 * DEHYST_EPSILON * (magnitude(state->y) + slip->rho[i]);
        if (magnitude(rise) > width + allowance) return DEHYST_ERR_UNREACHABLE;
        if (rise < width - allowance) {
            dehyst_real corner = rho + (width + rise) / 2;
            y -= direction * 2 * corner;
            r[count++].y = y;
            direction = -direction;
        }
        rho = slip->rho[i];
        cart = state->cart[i];
        total += slip->kappa[i] * slip->rho[i];
    }
    /* Twice as far as it takes to move every cart: rounding must not make the outermost amplitude look shorter. */
    r[count].y = y - direction * 4 * rho;
    r[count].stops = -direction * total;
    r[count].v = r[count].stops + dehyst_curve_at(&actuator->spring, r[count].y);
    for (i = count - 1; i >= 0; i--) {
        dehyst_real u = distance(&r[i], &r[i + 1]);
        r[i].stops = r[i + 1].stops + direction * masing(slip, cell_of(slip, u, 0), u);
        r[i].v = r[i].stops + dehyst_curve_at(&actuator->spring, r[i].y);
        direction = -direction;
    }
    for (i = 0; i < count - i; i++) {
        swap = r[i];
        r[i] = r[count - i];
        r[count - i] = swap;
    }
    stack->depth = count + 1;
    stack->y = state->y;
    stack->v = dehyst_voltage(actuator, state);
    return DEHYST_OK;
}

void dehyst_stack_decode(const dehyst_actuator *actuator, const dehyst_stack *stack, dehyst_state *state)
{
    const dehyst_slip *slip = &actuator->slip;
    dehyst_real y = stack->y, direction = stack->direction;
    int i, k = stack->depth - 1;
    for (i = 0; i < slip->size; i++) {
        while (k > 0 && slip->edge[i] > magnitude(y - stack->reversal[k].y)) {
            y = stack->reversal[k--].y;
            direction = -direction;
        }
        state->cart[i] = y - direction * slip->rho[i];
    }
    state->y = stack->y;
}

/* While a motion turns back by no more than edge_0 from the farthest point of its branch, nor to where that began, no
 * cart moves, and it need not be told from the branch: noise on a path costs no reversals. */
void dehyst_stack_compensate(const dehyst_actuator *actuator, dehyst_stack *stack, const dehyst_real *y, dehyst_real *v,
                             long n)
{
    const dehyst_slip *slip = &actuator->slip;
    const dehyst_curve *spring = &actuator->spring;
    const dehyst_real elastic = slip->stiffness[0], width = slip->edge[0];
    const dehyst_reversal *from = stack->reversal + stack->depth - 1, *to = joint(stack);
    dehyst_real direction = stack->direction, present = stack->y, voltage = stack->v;
    /* Places times the direction: where the branch began, how far it got, and where it joins the outer one. */
    dehyst_real began = direction * from->y, far = direction * present;
    dehyst_real joins = to != NULL ? direction * to->y : DEHYST_LARGEST;
    int cell = cell_of(slip, far - began, 0), j = segment(spring, present, 0);
    long t;
    for (t = 0; t < n; t++) {
        const dehyst_real goal = is_finite(y[t]) ? y[t] : present;
        dehyst_real place = direction * goal, stops;
        if (far - place > width || place < began) {
            turn_at(actuator, stack, direction * far, cell, j);
            direction = stack->direction;
            from = stack->reversal + stack->depth - 1;
            to = joint(stack);
            began = far = direction * from->y;
            joins = to != NULL ? direction * to->y : DEHYST_LARGEST;
            place = direction * goal;
        }
        far = place > far ? place : far;
        while (far >= joins) {
            stack->depth -= 2;
            from = stack->reversal + stack->depth - 1;
            to = joint(stack);
            began = direction * from->y;
            joins = to != NULL ? direction * to->y : DEHYST_LARGEST;
        }
        if (far - began >= slip->edge[cell] || (cell > 0 && far - began < slip->edge[cell - 1]))
            cell = cell_of(slip, far - began, cell);
        stops = from->stops + direction * (masing(slip, cell, far - began) - elastic * (far - place));
        j = segment(spring, goal, j);
        voltage = stops + on_segment(spring, j, goal);
        v[t] = voltage;
        present = goal;
    }
    if (direction * present < far) turn_at(actuator, stack, direction * far, cell, j);
    stack->y = present;
    stack->v = voltage;
}

static dehyst_real branch_stops(const dehyst_slip *slip, const dehyst_stack *stack, dehyst_real y, int hint)
{
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    dehyst_real u = stack->direction * (y - from->y);
    return from->stops + stack->direction * masing(slip, cell_of(slip, u, hint), u);
}

/* The segment of the spring in which the present branch, beyond y, reaches v. */
static int segment_at_voltage(const dehyst_actuator *actuator, const dehyst_stack *stack, dehyst_real y, dehyst_real v,
                              const piece *last)
{
    const dehyst_curve *spring = &actuator->spring;
    dehyst_real direction = stack->direction;
    int forward = direction > 0, tries = 0;
    int near = segment(spring, y, last->j), far = forward ? spring->size - 2 : 0;
    while (near != far) {
        /* Neighbours first, then bisection: near is passed only when its far end lies before v. */
        int middle = tries++ < 2 ? near : near + (far - near) / 2, knot = middle + forward;
        dehyst_real at = spring->knot[knot];
        dehyst_real reached = direction * (at - y) <= 0
                                  ? direction * -DEHYST_LARGEST
                                  : branch_stops(&actuator->slip, stack, at, last->cell) + spring->value[knot];
        if (direction * (v - reached) >= 0)
            near = middle + (forward ? 1 : -1);
        else
            far = middle;
    }
    return near;
}

/* The cell of the present branch in which, within segment j, it reaches v. */
static int cell_at_voltage(const dehyst_actuator *actuator, const dehyst_stack *stack, dehyst_real v, int j, int hint)
{
    const dehyst_slip *slip = &actuator->slip;
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    int near = hint, far = slip->size, tries = 0;
    while (near < far) {
        int middle = tries++ < 2 ? near : near + (far - near) / 2;
        dehyst_real y = from->y + stack->direction * slip->edge[middle];
        dehyst_real stops = from->stops + stack->direction * slip->intercept[middle] +
                            stack->direction * slip->stiffness[middle] * slip->edge[middle];
        if (stack->direction * (v - stops - on_segment(&actuator->spring, j, y)) >= 0)
            near = middle + 1;
        else
            far = middle;
    }
    return near;
}

/* The piece of the present branch in one cell and one segment. Written in place: pieces returned by value are copied
 * by wider loads than the stores before them, which stalls the processor at every change of piece. */
static void piece_in(const dehyst_actuator *actuator, const dehyst_stack *stack, int cell, int j, piece *found)
{
    const dehyst_slip *slip = &actuator->slip;
    const dehyst_curve *spring = &actuator->spring;
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    const dehyst_real direction = stack->direction, y_from = from->y;
    const dehyst_real slope = slip->stiffness[cell] + spring->slope[j];
    const dehyst_real u = cell > 0 ? slip->edge[cell - 1] : 0, start = y_from + direction * u;
    const dehyst_real v_start = from->stops + direction * masing(slip, cell, u) + on_segment(spring, j, start);
    const int forward = direction > 0, last = forward ? j + 2 == spring->size : j == 0;
    const int first = forward ? j == 0 : j + 2 == spring->size;
    const dehyst_real knot = spring->knot[j + forward], behind = spring->knot[j + !forward];
    dehyst_real end = y_from + direction * slip->edge[cell];
    found->ends_at_knot = !last && direction * (knot - end) < 0;
    if (found->ends_at_knot) end = knot;
    found->cell = cell;
    found->j = j;
    found->start = start;
    found->v_start = v_start;
    found->inverse_slope = 1 / slope;
    found->inverse_elastic = 1 / (slip->stiffness[0] + spring->slope[j]);
    found->bottom = direction * (!first && direction * (behind - y_from) > 0 ? behind : y_from);
    found->v_end = direction * DEHYST_LARGEST;
    if (cell < slip->size || found->ends_at_knot) found->v_end = v_start + slope * (end - start);
    if (stack->depth >= 3 && direction * (from[-1].v - found->v_end) < 0) found->v_end = from[-1].v;
}

/* Move to the piece of the present branch, at or beyond the present place, that holds v. */
static void find_piece(const dehyst_actuator *actuator, const dehyst_stack *stack, dehyst_real v, piece *now)
{
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    int j = segment_at_voltage(actuator, stack, stack->y, v, now);
    int cell = cell_of(&actuator->slip, stack->direction * (stack->y - from->y), now->cell);
    piece_in(actuator, stack, cell_at_voltage(actuator, stack, v, j, cell), j, now);
}

/* Work out the piece that follows `now` on its branch, if one does. Done ahead of need, it costs no waiting. */
static void look_beyond(const dehyst_actuator *actuator, const dehyst_stack *stack, const piece *now, piece *ahead)
{
    int forward = stack->direction > 0 ? 1 : -1;
    if (now->ends_at_knot || now->cell < actuator->slip.size)
        piece_in(actuator, stack, now->cell + !now->ends_at_knot, now->j + forward * now->ends_at_knot, ahead);
}

void dehyst_walk_begin(dehyst_walk *walk, const dehyst_actuator *actuator, dehyst_stack *stack)
{
    static const piece nowhere = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    walk->actuator = actuator;
    walk->stack = stack;
    walk->pieces[0] = walk->pieces[1] = nowhere;
    walk->now = walk->pieces;
    walk->ahead = walk->pieces + 1;
    walk->on_piece = 0;
    walk->y = stack->y;
    walk->v = stack->v;
}

/* Put the walk on the piece that holds v, from the farthest point of the stack's branch. */
static void find_way(dehyst_walk *walk, dehyst_real v)
{
    const dehyst_actuator *actuator = walk->actuator;
    dehyst_stack *stack = walk->stack;
    piece *now = walk->now;
    const dehyst_reversal *to;
    dehyst_real direction = stack->direction;
    if (direction * (v - stack->v) < 0) {
        turn(&actuator->slip, stack, branch_stops(&actuator->slip, stack, stack->y, now->cell));
        direction = stack->direction;
        walk->on_piece = 0;
    }
    while ((to = joint(stack)) != NULL && direction * (v - to->v) >= 0) {
        stack->y = to->y;
        stack->depth -= 2;
        walk->on_piece = 0;
    }
    if (walk->on_piece && direction * (v - now->v_end) >= 0 && direction * (v - walk->ahead->v_end) < 0) {
        walk->now = walk->ahead;
        walk->ahead = now;
    } else {
        find_piece(actuator, stack, v, now);
    }
    look_beyond(actuator, stack, walk->now, walk->ahead);
    walk->on_piece = 1;
}

/* Where the piece or the elastic way back from the farthest point of its branch, at `far` times the direction, leads to.
 * Returns whether it does: on the way back no cart moves, and it need not be told from the branch, as in
 * dehyst_stack_compensate. */
static inline int onward(const piece *now, dehyst_real direction, dehyst_real width, dehyst_real place, dehyst_real *far,
                         dehyst_real *y_far, dehyst_real *y)
{
    const dehyst_real ahead = place > *far ? place : *far;
    const dehyst_real y_ahead = now->start + (direction * ahead - now->v_start) * now->inverse_slope;
    const dehyst_real back = (ahead - place) * now->inverse_elastic;
    /* Of comparisons with what is not a number none holds. */
    if (!(ahead < direction * now->v_end && back <= width && direction * y_ahead - back >= now->bottom)) return 0;
    *far = ahead;
    *y_far = y_ahead;
    *y = y_ahead - direction * back;
    return 1;
}

/* Go on to a piece that holds v, which the present one does not. */
static void leap(dehyst_walk *walk, dehyst_real v)
{
    find_way(walk, v);
    walk->stack->v = walk->v = v;
    walk->stack->y = walk->y = walk->now->start + (v - walk->now->v_start) * walk->now->inverse_slope;
}

dehyst_real dehyst_walk_to(dehyst_walk *walk, dehyst_real v)
{
    dehyst_stack *stack = walk->stack;
    const dehyst_real direction = stack->direction, width = walk->actuator->slip.edge[0];
    dehyst_real far = direction * stack->v;
    if (walk->on_piece && onward(walk->now, direction, width, direction * v, &far, &stack->y, &walk->y)) {
        stack->v = direction * far;
        walk->v = v;
    } else if (is_finite(v)) {
        leap(walk, v);
    }
    return walk->y;
}

void dehyst_walk_end(dehyst_walk *walk)
{
    dehyst_stack *stack = walk->stack;
    const dehyst_slip *slip = &walk->actuator->slip;
    if (stack->direction * (walk->v - stack->v) < 0)
        turn(slip, stack, branch_stops(slip, stack, stack->y, walk->now->cell));
    stack->y = walk->y;
    stack->v = walk->v;
}

void dehyst_stack_simulate(const dehyst_actuator *actuator, dehyst_stack *stack, const dehyst_real *v, dehyst_real *y,
                           long n)
{
    const dehyst_real width = actuator->slip.edge[0];
    dehyst_walk walk;
    long t = 0;
    dehyst_walk_begin(&walk, actuator, stack);
    while (t < n) {
        if (!is_finite(v[t])) {
            y[t++] = walk.y;
            continue;
        }
        leap(&walk, v[t]);
        y[t++] = walk.y;
        {
            const piece now = *walk.now;
            const dehyst_real direction = stack->direction;
            dehyst_real far = direction * stack->v, y_far = stack->y, present = walk.y, voltage = walk.v;
            for (; t < n; t++) {
                const dehyst_real goal = v[t];
                if (!onward(&now, direction, width, direction * goal, &far, &y_far, &present)) break;
                voltage = goal;
                y[t] = present;
            }
            stack->v = direction * far;
            stack->y = y_far;
            walk.y = present;
            walk.v = voltage;
        }
    }
    dehyst_walk_end(&walk);
}

typedef dehyst_real step_function(const dehyst_actuator *, dehyst_state *, dehyst_real);
typedef void stack_function(const dehyst_actuator *, dehyst_stack *, const dehyst_real *, dehyst_real *, long);

static void run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_stack *work, const dehyst_real *in,
                dehyst_real *out, long n, step_function *step, stack_function *on_stack)
{
    long t = 0, stop;
    while (t < n && dehyst_stack_encode(actuator, state, work) != DEHYST_OK)
        for (stop = n - t < BLOCK ? n : t + BLOCK; t < stop; t++) out[t] = step(actuator, state, in[t]);
    if (t < n) {
        on_stack(actuator, work, in + t, out + t, n - t);
        dehyst_stack_decode(actuator, work, state);
    }
}

void dehyst_compensate_run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_stack *work,
                           const dehyst_real *y, dehyst_real *v, long n)
{
    run(actuator, state, work, y, v, n, dehyst_compensate_step, dehyst_stack_compensate);
}

void dehyst_simulate_run(const dehyst_actuator *actuator, dehyst_state *state, dehyst_stack *work,
                         const dehyst_real *v, dehyst_real *y, long n)
{
    run(actuator, state, work, v, y, n, dehyst_simulate_step, dehyst_stack_simulate);
}
