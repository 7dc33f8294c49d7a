/* What compensation and simulation in lanes share: curves, creep, and lanes that go by themselves. */
#ifndef DEHYST_BANK_LANES_H
#define DEHYST_BANK_LANES_H

#include "vectors.h"

#include <string.h>

#define LANES DEHYST_LANES

typedef struct block_memory block_memory;

/* Take one sample of a block, of which `width` lanes have an actuator. */
typedef void block_step(const dehyst_bank *bank, const dehyst_bank_state *state, const block_tables *t,
                        block_memory *memory, int actuator, int width, const dehyst_real *restrict in,
                        dehyst_real *restrict out, dehyst_real *scratch);

/* What a block works in. */
struct block_memory {
    dehyst_real *cart, *after;  /* [N LANES] carts now and after the step; exchanged */
    dehyst_real *strain;        /* [J LANES] */
    dehyst_real *y, *sent;      /* [LANES] */
    /* [LANES] of the last motion, if `holds`: voltage of the elements and the spring at its end; slope; +1 or -1 */
    dehyst_real *held, *slope, *direction;
    int holds;
};

INLINE void exchange(block_memory *memory)
{
    dehyst_real *cart = memory->cart;
    memory->cart = memory->after;
    memory->after = cart;
}

/* Find cells of equal size, from 0 to `last`; what is not a number goes to the first. */
INLINE void cells_of(const block_curve *curve, lanes x, lanes last, int cell[LANES])
{
    const lanes place = times(minus(x, load(curve->origin)), load(curve->scale));
    store_whole(cell, least(most(place, all_of(0)), last));
}

/* Fetch segments: where they begin, their values there, their slopes, and the bends that end them. */
INLINE void pieces_of(const block_curve *curve, const int segment_of[LANES], lanes piece[4])
{
    const dehyst_real *row[LANES];
    int l;
    for (l = 0; l < LANES; l++) row[l] = curve->piece + 4 * (l * (long)curve->size + segment_of[l]);
    load_pieces(row, piece);
}

/* Find the segments of LANES curves that hold x, where these are equal, and fetch them. */
INLINE void equal_pieces_at(const block_curve *curve, lanes x, int segment_of[LANES], lanes piece[4])
{
    lanes beside;
    cells_of(curve, x, load(curve->last), segment_of);
    pieces_of(curve, segment_of, piece);
    beside = either(at_most(piece[3], x), both(less(x, piece[0]), less(load(curve->first), piece[0])));
    if (bits_of(beside)) {
        /* Rounding, beside a bend. */
        dehyst_real at[LANES];
        int l;
        store(at, x);
        for (l = 0; l < LANES; l++) {
            const dehyst_real *row = curve->piece + 4 * (l * (long)curve->size);
            while (segment_of[l] > 0 && at[l] < row[4 * segment_of[l]]) segment_of[l]--;
            while (row[4 * segment_of[l] + 3] <= at[l]) segment_of[l]++;
        }
        pieces_of(curve, segment_of, piece);
    }
}

/* Find the segments of LANES curves that hold x, and fetch them. */
INLINE void pieces_at(const block_curve *curve, lanes x, int segment_of[LANES], lanes piece[4])
{
    int l;
    if (curve->equal) {
        equal_pieces_at(curve, x, segment_of, piece);
        return;
    }
    if (curve->cells > 0) {
        dehyst_real at[LANES];
        int cell[LANES];
        cells_of(curve, x, all_of(curve->cells - 1), cell);
        store(at, x);
        for (l = 0; l < LANES; l++) {
            const int j = curve->before[(long)l * curve->cells + cell[l]];
            segment_of[l] = j + (curve->piece[((long)l * curve->size + j) * 4 + 3] <= at[l]);
        }
    } else {
        long long count[LANES];
        counts j = no_counts();
        int k;
        for (k = 0; k < (curve->size - 2) * LANES; k += LANES) j = count_where(j, at_most(load(curve->bend + k), x));
        store_counts(count, j);
        for (l = 0; l < LANES; l++) segment_of[l] = (int)count[l];
    }
    pieces_of(curve, segment_of, piece);
}

/* Return LANES curves at x, and the segments that hold it. */
INLINE lanes look_up(const block_curve *curve, lanes x, int segment_of[LANES], lanes piece[4])
{
    pieces_at(curve, x, segment_of, piece);
    return plus(piece[1], times(piece[2], minus(x, piece[0])));
}

/* cart_after in lanes. */
INLINE lanes carts_after(lanes cart, lanes y, lanes rho)
{
    return least(plus(y, rho), most(minus(y, rho), cart));
}

/* Return the voltages of creep at the end of a step without motion: creep_after in lanes. */
INLINE lanes creep_ahead(const block_tables *t, const dehyst_real *restrict strain)
{
    lanes sum[4];
    int j, k;
    for (k = 0; k < 4; k++) sum[k] = all_of(0);
    for (j = 0; j < t->branches * LANES; j += 4 * LANES)
        for (k = 0; k < 4; k++) {
            const int at = j + k * LANES;
            sum[k] = plus(sum[k], times(load(t->creep + at), times(load(t->decay + at), load(strain + at))));
        }
    return plus(plus(sum[0], sum[2]), plus(sum[1], sum[3]));
}

/* Move creep through a step in which w moves over `by`, in the lanes of a mask. */
INLINE void creep_moves(const block_tables *t, dehyst_real *restrict strain, lanes by, lanes mask)
{
    int at;
    for (at = 0; at < t->branches * LANES; at += LANES) {
        const lanes old = load(strain + at);
        const lanes moved = plus(times(load(t->decay + at), old), times(load(t->gain + at), by));
        store(strain + at, choose(mask, moved, old));
    }
}

/* Map through a transformer the lanes that have one. */
INLINE lanes transformed(const block_tables *t, const block_curve *curve, lanes x)
{
    int segment_of[LANES];
    lanes piece[4];
    const lanes mapped = look_up(curve, x, segment_of, piece);
    return choose(less(all_of(0), load(t->bent)), mapped, x);
}

/* Return where numbers can be computed with: within_reach in lanes. */
INLINE lanes reachable(lanes a) { return at_most(size_of(a), all_of(DEHYST_FARTHEST)); }

/* Take one sample of a lane in the scalar core: `plays` voltages, or compensates. */
static dehyst_real by_itself(const dehyst_bank *bank, const dehyst_bank_state *state, const block_memory *memory,
                             int actuator, int l, dehyst_real in, int plays, dehyst_real *scratch)
{
    const dehyst_model *c = bank->compensator[actuator];
    const int n = c->actuator.plain.slip.size, branches = c->actuator.branches;
    dehyst_real *strain = scratch + 2 * n;
    dehyst_loop loop;
    dehyst_real out;
    int i;
    memset(&loop, 0, sizeof loop);
    loop.gain = 1;
    for (i = 0; i < n; i++) scratch[i] = memory->cart[i * LANES + l];
    for (i = 0; i < branches; i++) strain[i] = memory->strain[i * LANES + l];
    strain[branches] = loop.w = memory->y[l];
    loop.sent = loop.acting = memory->sent[l];
    if (plays) {
        dehyst_loop_play(c, &loop, scratch, in);
        out = loop.w;
    } else {
        out = dehyst_loop_step(c, &loop, scratch, in);
    }
    for (i = 0; i < n; i++) memory->after[i * LANES + l] = scratch[(loop.half ? n : 0) + i];
    for (i = 0; i < branches; i++) memory->strain[i * LANES + l] = strain[i];
    memory->y[l] = loop.w;
    memory->sent[l] = loop.sent;
    state->limited[actuator] += (long long)loop.limited;
    state->slewed[actuator] += (long long)loop.slewed;
    state->refused[actuator] += (long long)loop.refused;
    return out;
}

/* End a step: lanes of the mask at w, with voltages `sent`; the others, as far as they have an actuator, by themselves.
 * @param shown what the lanes of the mask return */
INLINE void end_block(const dehyst_bank *bank, const dehyst_bank_state *state,
                             block_memory *memory, int actuator, int width, lanes mask, lanes w, lanes sent,
                             lanes shown, const dehyst_real *restrict in, dehyst_real *restrict out, int plays,
                             dehyst_real *scratch)
{
    const int left = ~bits_of(mask) & ((1 << width) - 1);
    int l;
    store(out, shown);
    if (!left) {
        store(memory->y, w);
        store(memory->sent, sent);
    } else {
        store(memory->y, choose(mask, w, load(memory->y)));
        store(memory->sent, choose(mask, sent, load(memory->sent)));
        for (l = 0; l < LANES; l++)
            if (left >> l & 1) out[l] = by_itself(bank, state, memory, actuator + l, l, in[l], plays, scratch);
    }
    exchange(memory);
}

#endif
