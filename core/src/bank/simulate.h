/* Voltages to displacements in lanes. */
#ifndef DEHYST_BANK_SIMULATE_H
#define DEHYST_BANK_SIMULATE_H

#include "lanes.h"

/* Newton's steps before a lane is left to the scalar core. */
#define TRIES 40

/* A motion: where it starts, its direction, and the carts [elements LANES] times the direction. In the direction of
 * motion carts are only ever pulled, so that one comparison tells which of them slide; signs are exact. */
typedef struct lane_motion {
    lanes start, direction;
    const dehyst_real *cart;
} lane_motion;

INLINE lane_motion motion_of(const block_tables *t, const dehyst_real *restrict cart, lanes start, lanes direction,
                             dehyst_real *restrict turned)
{
    const lane_motion motion = {start, direction, turned};
    int i;
    for (i = 0; i < t->elements * LANES; i += LANES) store(turned + i, times(direction, load(cart + i)));
    return motion;
}

/* Return voltages R(w) + stiffness (w - start) on the branches, and their slopes; the order of summation is free. */
INLINE lanes branch_at(const block_tables *t, const lane_motion *motion, lanes w, lanes *slope)
{
    const dehyst_real *restrict rho = t->rho, *restrict kappa = t->kappa, *restrict cart = motion->cart;
    const lanes stiffness = load(t->stiffness), place = times(motion->direction, w);
    lanes value[2], sum[2], spring, piece[4];
    int segment_of[LANES];
    int i, k;
    for (k = 0; k < 2; k++) value[k] = sum[k] = all_of(0);
#define ELEMENT(at, k)                                                                                                 \
    {                                                                                                                  \
        const lanes length = load(rho + (at)), stiff = load(kappa + (at)), whole = minus(place, load(cart + (at)));    \
        value[k] = plus(value[k], times(stiff, least(whole, length)));                                                 \
        sum[k] = plus(sum[k], where(less(whole, length), stiff));                                                      \
    }
    for (i = 0; i + 2 * LANES <= t->elements * LANES; i += 2 * LANES) {
        ELEMENT(i, 0)
        ELEMENT(i + LANES, 1)
    }
    if (i < t->elements * LANES) ELEMENT(i, 0)
#undef ELEMENT
    spring = look_up(&t->spring, w, segment_of, piece);
    *slope = plus(plus(sum[0], sum[1]), plus(piece[2], stiffness));
    return plus(plus(times(motion->direction, plus(value[0], value[1])), spring),
                times(stiffness, minus(w, motion->start)));
}

/* Return where segments begin; below every value where there is no bend. */
INLINE lanes bend_below(const block_curve *curve, const lanes piece[4])
{
    return choose(less(load(curve->first), piece[0]), piece[0], all_of(-DEHYST_LARGEST));
}

/* Return the last bend that a motion to w passes, or its start. */
INLINE lanes last_event(const block_tables *t, const lane_motion *motion, lanes w)
{
    const lanes direction = motion->direction, goal = times(direction, w), begin = times(direction, motion->start);
    lanes place = begin, piece[4];
    int segment_of[LANES];
    int i;
#define BEND(expression)                                                                                               \
    {                                                                                                                  \
        const lanes bend = (expression);                                                                               \
        place = most(choose(at_most(bend, goal), bend, begin), place);                                                 \
    }
    for (i = 0; i < t->elements * LANES; i += LANES) BEND(plus(load(motion->cart + i), load(t->rho + i)))
    pieces_at(&t->spring, w, segment_of, piece);
    BEND(times(direction, choose(less(direction, all_of(0)), piece[3], bend_below(&t->spring, piece))))
#undef BEND
    return times(direction, place);
}

/* Solve the straight segment that begins at `from` as dehyst_solve does, operation by operation. A lane that it would
 * not end there, or that may not reach that segment there, is taken out of the mask. */
INLINE lanes solve_segment(const block_tables *t, const lane_motion *motion, lanes drive, lanes from, lanes *slope,
                           lanes *found)
{
    const dehyst_real *restrict rho = t->rho, *restrict kappa = t->kappa, *restrict cart = motion->cart;
    const lanes direction = motion->direction, stiffness = load(t->stiffness), zero = all_of(0);
    const lanes place = times(direction, from), down = less(direction, zero), never = all_of(DEHYST_LARGEST);
    lanes v = zero, sum = zero, event = never, piece[4], rest, goal;
    lanes below;
    int segment_of[LANES];
    int i, l, back;
    for (i = 0; i < t->elements * LANES; i += LANES) {
        const lanes stiff = load(kappa + i), length = load(rho + i), b = load(cart + i);
        const lanes reach = plus(b, length), sticks = less(place, reach);
        v = plus(v, times(stiff, choose(sticks, minus(place, b), length)));
        sum = plus(sum, where(sticks, stiff));
        event = least(choose(sticks, reach, never), event);
    }
    v = times(direction, v);
    pieces_at(&t->spring, from, segment_of, piece);
    below = bend_below(&t->spring, piece);
    /* Downwards, the segment that ends at a bend is the one below it. */
    back = bits_of(both(down, at_most(from, below)));
    if (back) {
        for (l = 0; l < LANES; l++) segment_of[l] -= back >> l & 1;
        pieces_of(&t->spring, segment_of, piece);
        below = bend_below(&t->spring, piece);
    }
    event = least(times(direction, choose(down, below, piece[3])), event);
    v = plus(v, plus(piece[1], times(piece[2], minus(from, piece[0]))));
    *slope = plus(plus(sum, piece[2]), stiffness);
    rest = minus(minus(drive, v), times(stiffness, minus(from, motion->start)));
    goal = plus(from, over(rest, *slope));
    *found = both(less(times(all_of(4), load(t->tolerance)), times(direction, rest)),
                  both(at_most(times(direction, goal), event), at_most(size_of(goal), load(t->far))));
    return goal;
}

/* Return where the branches from the present state have the voltage `drive`: Newton's steps within a bracket, until the
 * straight segment that they lead to holds the solution.
 * @param slope, direction of the last motion, and of this one; they are where the search begins
 * @param turned [elements LANES] to work in
 * @param found the result, a mask: the others must go by themselves */
INLINE lanes search(const block_tables *t, const dehyst_real *restrict cart, lanes start, lanes held, lanes drive,
                    lanes *slope, lanes *direction, dehyst_real *restrict turned, lanes *found)
{
    const lanes zero = all_of(0), rise = minus(drive, held), to = choose(less(rise, zero), all_of(-1), all_of(1));
    const lane_motion motion = motion_of(t, cart, start, to, turned);
    lanes low = zero, high = all_of(DEHYST_LARGEST), way, w = start, rest = times(to, rise), moves;
    int tries;
    moves = both(both(less(times(all_of(4), load(t->tolerance)), rest), at_most(size_of(start), load(t->far))),
                 at_most(size_of(drive), all_of(DEHYST_FARTHEST)));
    /* Where a motion turns, all elements stick. */
    way = where(moves, over(rest, choose(equal(to, *direction), *slope, load(t->stiffest))));
    for (tries = 0; tries < TRIES; tries++) {
        lanes next;
        rest = times(to, minus(drive, branch_at(t, &motion, plus(start, times(to, way)), slope)));
        low = choose(less(zero, rest), way, low);
        high = choose(less(zero, rest), high, way);
        next = plus(way, over(rest, *slope));
        way = choose(both(at_most(low, next), at_most(next, high)), next,
                     times(all_of((dehyst_real)0.5), plus(low, high)));
        /* Often two steps are enough, seldom one. */
        if (tries == 0) continue;
        w = solve_segment(t, &motion, drive, last_event(t, &motion, plus(start, times(to, way))), slope, found);
        if ((bits_of(moves) & ~bits_of(*found)) == 0) break;
    }
    *direction = to;
    *found = both(*found, moves);
    return w;
}

/* Simulate one sample: v [LANES] to y [LANES]. */
INLINE void simulate_block(const dehyst_bank *bank, const dehyst_bank_state *state, const block_tables *t,
                                  block_memory *memory, int actuator, int width, const dehyst_real *restrict v,
                                  dehyst_real *restrict y, dehyst_real *scratch)
{
    const dehyst_real *restrict cart = memory->cart;
    const lanes start = load(memory->y), played = load(v);
    lanes drive = played, slope = load(memory->slope), direction = load(memory->direction), found, w;
    int i;
    if (t->transformer.size > 0) drive = transformed(t, &t->transformer, drive);
    if (t->branches > 0) drive = minus(drive, creep_ahead(t, memory->strain));
    if (!memory->holds) {
        const lane_motion rest = motion_of(t, cart, start, all_of(1), memory->after);
        store(memory->held, branch_at(t, &rest, start, &slope));
    }
    w = search(t, cart, start, load(memory->held), drive, &slope, &direction, memory->after, &found);
    memory->holds = (~bits_of(found) & ((1 << width) - 1)) == 0;
    store(memory->held, minus(drive, times(load(t->stiffness), minus(w, start))));
    store(memory->slope, slope);
    store(memory->direction, direction);
    for (i = 0; i < t->elements * LANES; i += LANES)
        store(memory->after + i, carts_after(load(cart + i), w, load(t->rho + i)));
    if (t->branches > 0) creep_moves(t, memory->strain, minus(w, start), found);
    end_block(bank, state, memory, actuator, width, found, w, played, w, v, y, 1, scratch);
}

#endif
