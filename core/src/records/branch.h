/* The present branch of a path, for plain or graded elements and the spring, kept from sample to sample.
 *
 * Carts are moved when a branch ends. Until then only three things change: the farthest point, the straight segment
 * ahead of it, and the straight segment back from it, on which no cart slides. */
#ifndef DEHYST_BRANCH_H
#define DEHYST_BRANCH_H

#include "internal.h"

typedef struct dehyst_branch {
    const dehyst_actuator *actuator;
    dehyst_plain_state *memory; /* state at the start of the branch */
    dehyst_real direction, w;   /* +1 or -1; the present displacement */
    dehyst_real from, far;      /* start of the segment, and the farthest point, which lies on it */
    branch_segment ahead;       /* the segment: voltage at `from`, slope, event */
    dehyst_real elastic;        /* slope back from the farthest point */
    dehyst_real width, bottom;  /* length of the way back from there, and its end, times the direction */
} dehyst_branch;

/* Begin at a state; the branch uses this state until its end. */
void dehyst_branch_begin(dehyst_branch *branch, const dehyst_actuator *actuator, dehyst_plain_state *memory);
/* Move to the w at which R(w) + stiffness (w - present w) = drive, and return it; nothing changes if it is not within
 * reach. R is the voltage of the elements and the spring. */
dehyst_real dehyst_branch_solve(dehyst_branch *branch, dehyst_real drive, dehyst_real stiffness);
/* The same with smooth elements, which are moved too.
 * @param state the state whose memory the branch uses
 * @param work [2 L + 1] from dehyst_smooth_prepare */
dehyst_real dehyst_branch_solve_smooth(dehyst_branch *branch, dehyst_state *state, dehyst_real drive,
                                       dehyst_real stiffness, dehyst_real *work);
void dehyst_smooth_prepare(const dehyst_smooth *smooth, dehyst_real *work);
/* Move the carts to their places at the end of the path. */
void dehyst_branch_end(dehyst_branch *branch);

#endif
