#include "reversals.h"

/* Voltage to displacement on the stack: along straight pieces of the present branch, one after another. */

static dehyst_real branch_voltage(const dehyst_slip *slip, const dehyst_stack *stack, dehyst_real y, int hint)
{
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    dehyst_real u = stack->direction * (y - from->y);
    return from->slip_voltage + stack->direction * masing_branch(slip, cell_of(slip, u, hint), u);
}

/* Return the segment of the spring in which the present branch, beyond y, reaches v. */
static int segment_at_voltage(const dehyst_plain *plain, const dehyst_stack *stack, dehyst_real y, dehyst_real v,
                              const piece *last)
{
    const dehyst_curve *spring = &plain->spring;
    dehyst_real direction = stack->direction;
    int forward = direction > 0, tries = 0;
    int near = segment(spring, y, last->j), far = forward ? spring->size - 2 : 0;
    while (near != far) {
        /* Neighbours are tried first, then bisection; `near` advances only if its far end lies before v. */
        int middle = tries++ < 2 ? near : near + (far - near) / 2, knot = middle + forward;
        dehyst_real at = spring->knot[knot];
        dehyst_real reached = direction * (at - y) <= 0
                                  ? direction * -DEHYST_LARGEST
                                  : branch_voltage(&plain->slip, stack, at, last->cell) + spring->value[knot];
        if (direction * (v - reached) >= 0)
            near = middle + (forward ? 1 : -1);
        else
            far = middle;
    }
    return near;
}

/* Return the cell in which the present branch, within segment j, reaches v. */
static int cell_at_voltage(const dehyst_plain *plain, const dehyst_stack *stack, dehyst_real v, int j, int hint)
{
    const dehyst_slip *slip = &plain->slip;
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    int near = hint, far = slip->size, tries = 0;
    while (near < far) {
        int middle = tries++ < 2 ? near : near + (far - near) / 2;
        dehyst_real y = from->y + stack->direction * slip->edge[middle];
        dehyst_real slip_voltage = from->slip_voltage + stack->direction * slip->intercept[middle] +
                            stack->direction * slip->stiffness[middle] * slip->edge[middle];
        if (stack->direction * (v - slip_voltage - on_segment(&plain->spring, j, y)) >= 0)
            near = middle + 1;
        else
            far = middle;
    }
    return near;
}

/* Compute the piece of the present branch in one cell and one segment. It is written in place: a returned piece would
 * be copied by wider loads than the stores before them, which stalls the processor at every change of piece. */
static void piece_in(const dehyst_plain *plain, const dehyst_stack *stack, int cell, int j, piece *found)
{
    const dehyst_slip *slip = &plain->slip;
    const dehyst_curve *spring = &plain->spring;
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    const dehyst_real direction = stack->direction, y_from = from->y;
    const dehyst_real slope = slip->stiffness[cell] + spring->slope[j];
    const dehyst_real u = cell > 0 ? slip->edge[cell - 1] : 0, start = y_from + direction * u;
    const dehyst_real v_start =
        from->slip_voltage + direction * masing_branch(slip, cell, u) + on_segment(spring, j, start);
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

/* Move to the piece of the present branch that holds v; it lies at or beyond the present place. */
static void find_piece(const dehyst_plain *plain, const dehyst_stack *stack, dehyst_real v, piece *now)
{
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    int j = segment_at_voltage(plain, stack, stack->y, v, now);
    int cell = cell_of(&plain->slip, stack->direction * (stack->y - from->y), now->cell);
    piece_in(plain, stack, cell_at_voltage(plain, stack, v, j, cell), j, now);
}

/* Compute the piece that follows `now` on its branch, if there is one, in advance: nothing waits for it later. */
static void look_beyond(const dehyst_plain *plain, const dehyst_stack *stack, const piece *now, piece *ahead)
{
    int forward = stack->direction > 0 ? 1 : -1;
    if (now->ends_at_knot || now->cell < plain->slip.size)
        piece_in(plain, stack, now->cell + !now->ends_at_knot, now->j + forward * now->ends_at_knot, ahead);
}

void dehyst_walk_begin(dehyst_walk *walk, const dehyst_plain *plain, dehyst_stack *stack)
{
    static const piece nowhere = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    walk->plain = plain;
    walk->stack = stack;
    walk->pieces[0] = walk->pieces[1] = nowhere;
    walk->now = walk->pieces;
    walk->ahead = walk->pieces + 1;
    walk->on_piece = 0;
    walk->y = stack->y;
    walk->v = stack->v;
}

/* Move the walk to the piece that holds v, at or beyond the farthest point of the branch. */
static void find_way(dehyst_walk *walk, dehyst_real v)
{
    const dehyst_plain *plain = walk->plain;
    dehyst_stack *stack = walk->stack;
    piece *now = walk->now;
    const dehyst_reversal *to;
    dehyst_real direction = stack->direction;
    if (direction * (v - stack->v) < 0) {
        dehyst_stack_turn(&plain->slip, stack, branch_voltage(&plain->slip, stack, stack->y, now->cell));
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
        find_piece(plain, stack, v, now);
    }
    look_beyond(plain, stack, walk->now, walk->ahead);
    walk->on_piece = 1;
}

/* Return whether the piece, or the elastic way back from the farthest point of its branch, reaches v; set y there.
 * `place` and `far` are v and the voltage of that point, times the direction. On the way back no cart moves: the motion
 * stays on the branch, as in dehyst_stack_compensate. */
static inline int onward(const piece *now, dehyst_real direction, dehyst_real width, dehyst_real place,
                         dehyst_real *far, dehyst_real *y_far, dehyst_real *y)
{
    const dehyst_real ahead = place > *far ? place : *far;
    const dehyst_real y_ahead = now->start + (direction * ahead - now->v_start) * now->inverse_slope;
    const dehyst_real back = (ahead - place) * now->inverse_elastic;
    /* Every comparison with NaN is false. */
    if (!(ahead < direction * now->v_end && back <= width && direction * y_ahead - back >= now->bottom)) return 0;
    *far = ahead;
    *y_far = y_ahead;
    *y = y_ahead - direction * back;
    return 1;
}

/* Move to another piece, which holds v. */
static void leap(dehyst_walk *walk, dehyst_real v)
{
    find_way(walk, v);
    walk->stack->v = walk->v = v;
    walk->stack->y = walk->y = walk->now->start + (v - walk->now->v_start) * walk->now->inverse_slope;
}

dehyst_real dehyst_walk_to(dehyst_walk *walk, dehyst_real v)
{
    dehyst_stack *stack = walk->stack;
    const dehyst_real direction = stack->direction, width = walk->plain->slip.edge[0];
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
    const dehyst_slip *slip = &walk->plain->slip;
    if (stack->direction * (walk->v - stack->v) < 0)
        dehyst_stack_turn(slip, stack, branch_voltage(slip, stack, stack->y, walk->now->cell));
    stack->y = walk->y;
    stack->v = walk->v;
}

void dehyst_stack_simulate(const dehyst_plain *plain, dehyst_stack *stack, const dehyst_real *v, dehyst_real *y, long n)
{
    const dehyst_real width = plain->slip.edge[0];
    dehyst_walk walk;
    long t = 0;
    dehyst_walk_begin(&walk, plain, stack);
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
