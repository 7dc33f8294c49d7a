/* The branch of plain or graded elements and the spring on which a path runs, kept from sample to sample.
 *
 * Carts are moved when a branch ends. Until then three numbers hold all that changes: the farthest point, and the
 * straight segments that lead onward from it and back, on which no cart slides. */
#ifndef DEHYST_BRANCH_H
#define DEHYST_BRANCH_H

#include "internal.h"

typedef struct dehyst_branch {
    const dehyst_actuator *actuator;
    dehyst_plain_state *memory; /* where the branch begins */
    dehyst_real direction, w;   /* +1 or -1; the present displacement */
    dehyst_real from, far;      /* where the segment begins, and the farthest point, which lies on it */
    branch_segment ahead;       /* the segment: voltage at `from`, slope, event */
    dehyst_real elastic;        /* slope back from the farthest point */
    dehyst_real width, bottom;  /* how far back from there, and how far in all, times the direction */
} dehyst_branch;

/* Begin at the state, which belongs to the branch until its end. */
void dehyst_branch_begin(dehyst_branch *branch, const dehyst_actuator *actuator, dehyst_plain_state *memory);
/* Move to the w at which R(w) + stiffness (w - present w) = drive, and return it; nothing moves if it is not within
 * reach. R is the voltage of the elements and the spring. */
dehyst_real dehyst_branch_solve(dehyst_branch *branch, dehyst_real drive, dehyst_real stiffness);
/* Do the same where there are smooth elements, and move them.
 * @param state to which the memory of the branch belongs
 * @param work [2 L + 1] from dehyst_smooth_prepare */
dehyst_real dehyst_branch_solve_smooth(dehyst_branch *branch, dehyst_state *state, dehyst_real drive,
                                       dehyst_real stiffness, dehyst_real *work);
void dehyst_smooth_prepare(const dehyst_smooth *smooth, dehyst_real *work);
/* Move the carts to where the path leaves them. */
void dehyst_branch_end(dehyst_branch *branch);

#endif
