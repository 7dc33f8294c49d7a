/* What a step of time does to creep and to a mass, seen from its end: shared by runs and single steps, private. */
#ifndef DEHYST_BALANCE_H
#define DEHYST_BALANCE_H

#include "dehyst_parts.h"

/* What creep would hold at the end of so many steps without motion, one or two. */
static inline dehyst_real held_over(const dehyst_wide *wide, const dehyst_pace *pace, const dehyst_real *strain,
                                    int steps)
{
    dehyst_real sum[4];
    int j, i;
    sum[0] = sum[1] = sum[2] = sum[3] = 0;
    for (j = 0; j + 4 <= wide->branches; j += 4)
        for (i = 0; i < 4; i++) {
            const dehyst_real once = pace->decay[j + i] * strain[j + i];
            sum[i] += wide->stiffness[j + i] * (steps > 1 ? pace->decay[j + i] * once : once);
        }
    for (i = 0; j < wide->branches; j++, i++) {
        const dehyst_real once = pace->decay[j] * strain[j];
        sum[i] += wide->stiffness[j] * (steps > 1 ? pace->decay[j] * once : once);
    }
    return (sum[0] + sum[2]) + (sum[1] + sum[3]);
}

static inline void creep_on(const dehyst_wide *wide, const dehyst_pace *pace, dehyst_real *strain, dehyst_real by)
{
    int j;
    for (j = 0; j < wide->branches; j++) strain[j] = pace->decay[j] * strain[j] + pace->gain[j] * by;
}

/* Of y = free + lever w at the end of a step: the lever, and what is free of w. */
static inline dehyst_real lever_of(const dehyst_wide *wide, const dehyst_transition *to)
{
    return to->after[0] / (1 + wide->share * to->after[0]);
}

static inline dehyst_real free_of(const dehyst_wide *wide, const dehyst_transition *to, const dehyst_wide_state *state,
                                  dehyst_real load)
{
    return (to->phi[0] * state->y + to->phi[1] * state->rate + to->before[0] * state->input + to->after[0] * load) /
           (1 + wide->share * to->after[0]);
}

static inline void swing_on(const dehyst_wide *wide, const dehyst_transition *to, dehyst_wide_state *state,
                            dehyst_real w, dehyst_real y, dehyst_real load)
{
    const dehyst_real input = w - wide->share * y + load;
    state->rate = to->phi[2] * state->y + to->phi[3] * state->rate + to->before[1] * state->input + to->after[1] * input;
    state->input = input;
    state->y = y;
}

#endif
