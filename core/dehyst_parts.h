/* What the two evaluators share: private to the core. */
#ifndef DEHYST_PARTS_H
#define DEHYST_PARTS_H

#include "dehyst.h"

static inline int is_finite(dehyst_real a) { return a - a == 0; }

static inline dehyst_real magnitude(dehyst_real a) { return a < 0 ? -a : a; }

/* The number of entries of a[0..n-1], increasing, that are <= u; the answer is sought near the hint first. */
static inline int count_below(const dehyst_real *a, int n, dehyst_real u, int hint)
{
    int low = 0, high = n, i = hint < n ? hint : n, tries;
    for (tries = 0; tries < 3; tries++) {
        if (i < n && a[i] <= u)
            low = ++i;
        else if (i > 0 && a[i - 1] > u)
            high = --i;
        else
            return i;
    }
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (a[middle] <= u)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The segment of the curve that holds x: knot_j <= x < knot_{j+1}, the end segments being unbounded. */
static inline int segment(const dehyst_curve *curve, dehyst_real x, int hint)
{
    return count_below(curve->knot + 1, curve->size - 2, x, hint);
}

static inline dehyst_real on_segment(const dehyst_curve *curve, int j, dehyst_real x)
{
    return curve->value[j] + curve->slope[j] * (x - curve->knot[j]);
}

#endif
