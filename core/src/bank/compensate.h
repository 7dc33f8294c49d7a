/* Displacements to voltages in lanes. */
#ifndef DEHYST_BANK_COMPENSATE_H
#define DEHYST_BANK_COMPENSATE_H

#include "lanes.h"

/* Return the voltages after a motion that ends at w, and the carts after it: voltage_after in lanes. */
INLINE lanes voltages_after(const block_tables *t, const dehyst_real *restrict cart, lanes w,
                                   dehyst_real *restrict after)
{
    const dehyst_real *restrict rho = t->rho, *restrict kappa = t->kappa;
    lanes sum[4], piece[4];
    int segment_of[LANES];
    int i, k;
    for (k = 0; k < 4; k++) sum[k] = all_of(0);
#define ELEMENT(place, k)                                                                                              \
    {                                                                                                                  \
        const int at = (place) + (k) * LANES;                                                                          \
        const lanes now = carts_after(load(cart + at), w, load(rho + at));                                             \
        store(after + at, now);                                                                                        \
        sum[k] = plus(sum[k], times(load(kappa + at), minus(w, now)));                                                 \
    }
    for (i = 0; i + 4 * LANES <= t->elements * LANES; i += 4 * LANES) {
        ELEMENT(i, 0)
        ELEMENT(i, 1)
        ELEMENT(i, 2)
        ELEMENT(i, 3)
    }
    if (i < t->elements * LANES) ELEMENT(i, 0)
    if (i + LANES < t->elements * LANES) ELEMENT(i, 1)
    if (i + 2 * LANES < t->elements * LANES) ELEMENT(i, 2)
#undef ELEMENT
    return plus(plus(plus(sum[0], sum[2]), plus(sum[1], sum[3])), look_up(&t->spring, w, segment_of, piece));
}

/* Compensate one sample: u [LANES] to v [LANES]. */
INLINE void compensate_block(const dehyst_bank *bank, const dehyst_bank_state *state, const block_tables *t,
                                    block_memory *memory, int actuator, int width, const dehyst_real *restrict u,
                                    dehyst_real *restrict v, dehyst_real *scratch)
{
    const lanes w = load(u), by = minus(w, load(memory->y));
    lanes drive = voltages_after(t, memory->cart, w, memory->after), mask;
    if (t->branches > 0)
        drive = plus(drive, plus(creep_ahead(t, memory->strain), times(load(t->stiffness), by)));
    if (t->inverse.size > 0) drive = transformed(t, &t->inverse, drive);
    mask = at_most(size_of(minus(drive, load(memory->sent))), load(t->change));
    mask = both(mask, both(at_most(load(t->low), drive), at_most(drive, load(t->high))));
    mask = both(mask, reachable(w));
    if (t->branches > 0) creep_moves(t, memory->strain, by, mask);
    end_block(bank, state, memory, actuator, width, mask, w, drive, drive, u, v, 0, scratch);
}

#endif
