/* Functions that the evaluators on the stack of reversals share; private to them. */
#ifndef DEHYST_REVERSALS_H
#define DEHYST_REVERSALS_H

#include "dehyst_records.h"
#include "internal.h"

/* Return the cell of 2 phi(u / 2) that holds u >= 0. Rounding of huge displacements may give any u, even NaN, and a
 * conversion to int is defined only for values that fit. */
static inline int cell_of(const dehyst_slip *slip, dehyst_real u, int hint)
{
    if (slip->inverse_step > 0) {
        const dehyst_real guess = u * slip->inverse_step;
        hint = !(guess < slip->size) ? slip->size : guess > 0 ? (int)guess : 0;
    }
    return count_below(slip->edge, slip->size, u, hint);
}

/* Return 2 phi(u / 2): the change of the slip voltage on a branch of length u (Masing). */
static inline dehyst_real masing_branch(const dehyst_slip *slip, int cell, dehyst_real u)
{
    return slip->intercept[cell] + slip->stiffness[cell] * u;
}

/* Return the reversal at which the present branch joins the outer one again, or NULL on an outermost branch. */
static inline const dehyst_reversal *joint(const dehyst_stack *stack)
{
    return stack->depth >= 3 ? stack->reversal + stack->depth - 2 : NULL;
}

/* Turn at the present place of the stack; `slip_voltage` is the voltage of the elements there. */
void dehyst_stack_turn(const dehyst_slip *slip, dehyst_stack *stack, dehyst_real slip_voltage);

/* A straight piece of the present branch: y = start + (v - v_start) / slope until v reaches v_end. From each of its
 * points the way back is elastic and moves no cart, down to `bottom`, which is a place times the direction. */
typedef struct piece {
    dehyst_real start, v_start, inverse_slope, v_end, inverse_elastic, bottom;
    int cell, j;
    int ends_at_knot; /* the next piece lies in the next segment of the spring; else in the next cell */
} piece;

/* A simulation on the stack that gets its voltages one by one. Until it ends, the stack holds the farthest point of
 * the branch. */
typedef struct dehyst_walk {
    const dehyst_plain *plain;
    dehyst_stack *stack;
    dehyst_real y, v;
    piece *now, *ahead;
    int on_piece;
    piece pieces[2];
} dehyst_walk;

void dehyst_walk_begin(dehyst_walk *walk, const dehyst_plain *plain, dehyst_stack *stack);
dehyst_real dehyst_walk_to(dehyst_walk *walk, dehyst_real v);
void dehyst_walk_end(dehyst_walk *walk);

#endif
