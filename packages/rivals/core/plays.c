#include "plays.h"

#include <math.h>

static double clipped(double z, double low, double high) { return z < low ? low : z > high ? high : z; }

static double curve_at(const plays_model *m, int i, int j, double z)
{
    /* Segment j ends at knot j and begins at knot j - 1. */
    int first = m->first[i], base = first + (j > 0 ? j - 1 : 0);
    return m->value[base] + m->slope[first + i + j] * (z - m->knot[base]);
}

static int segment_of(const plays_model *m, int i, int j, double z)
{
    const double *knot = m->knot + m->first[i];
    int knots = m->first[i + 1] - m->first[i];
    while (j < knots && z >= knot[j]) j++;
    while (j > 0 && z < knot[j - 1]) j--;
    return j;
}

static void move(const plays_model *m, plays_state *s, double v)
{
    int i;
    for (i = 0; i < m->plays; i++) {
        double z = clipped(s->z[i], v - m->r[i], v + m->r[i]);
        if (z != s->z[i]) {
            s->z[i] = z;
            s->at[i] = segment_of(m, i, s->at[i], z);
            s->held[i] = curve_at(m, i, s->at[i], z);
        }
    }
    s->v = v;
}

static void set_step(const plays_model *m, plays_state *s, double dt)
{
    int k;
    if (dt == s->dt) return;
    s->dt = dt;
    for (k = 0; k < m->passes; k++) {
        double ratio = dt / m->tau[k];
        s->kept[k] = exp(-ratio);
        s->gain[k] = ratio < 1e-4 ? ratio * (0.5 - ratio / 6) : 1 + expm1(-ratio) / ratio;
    }
}

static void pass(const plays_model *m, plays_state *s, double before, double now)
{
    int k;
    for (k = 0; k < m->passes; k++)
        s->q[k] = s->kept[k] * s->q[k] + (1 - s->kept[k]) * before + s->gain[k] * (now - before);
}

void plays_begin(const plays_model *m, plays_state *s)
{
    int i, k;
    s->dt = 0;
    for (k = 0; k < m->passes; k++) s->kept[k] = 1, s->gain[k] = 0;
    for (i = 0; i < m->plays; i++) {
        s->at[i] = segment_of(m, i, 0, s->z[i]);
        s->held[i] = curve_at(m, i, s->at[i], s->z[i]);
    }
}

double plays_level(const plays_model *m, const plays_state *s)
{
    double y = m->offset;
    int i, k;
    for (i = 0; i < m->plays; i++) y += s->held[i];
    for (k = 0; k < m->passes; k++) y += m->share[k] * s->q[k];
    return y;
}

void plays_simulate(const plays_model *m, plays_state *s, const double *v, const double *dt, double *y, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        set_step(m, s, dt ? dt[t] : 0);
        pass(m, s, s->v, v[t]);
        move(m, s, v[t]);
        y[t] = plays_level(m, s);
    }
}

/* The slope dy/dv of play i at v when v goes up (side 1) or down (side -1), and the place where it changes next. All
 * places are compared as voltages made by one expression, so that a place once reached counts as passed. */
static double slope_and_next(const plays_model *m, const plays_state *s, int i, int *j, double v, int side, double *next)
{
    const double *knot = m->knot + m->first[i];
    const double r = side * m->r[i], begins = s->z[i] + r;
    const int knots = m->first[i + 1] - m->first[i];
    if (side > 0 ? v < begins : v > begins) {
        *next = begins;
        return 0;
    }
    if (side > 0) {
        while (*j < knots && v >= knot[*j] + r) ++*j;
        *next = *j < knots ? knot[*j] + r : HUGE_VAL;
    } else {
        while (*j > 0 && v <= knot[*j - 1] + r) --*j;
        *next = *j > 0 ? knot[*j - 1] + r : -HUGE_VAL;
    }
    return m->slope[m->first[i] + i + *j];
}

/* Walks until `rest` of displacement is used up; 0 if the model ends before. */
static int walk(const plays_model *m, const plays_state *s, double rest, double passing, double *voltage)
{
    const int side = rest > 0 ? 1 : -1;
    double v = *voltage;
    while (rest != 0) {
        double slope = passing, nearest = side * HUGE_VAL;
        int i;
        for (i = 0; i < m->plays; i++) {
            double next;
            int j = s->at[i];
            slope += slope_and_next(m, s, i, &j, v, side, &next);
            if (side > 0 ? next < nearest : next > nearest) nearest = next;
        }
        if (slope > 0 && side * (nearest - v) * slope >= side * rest) {
            v += rest / slope;
            rest = 0;
        } else if (fabs(nearest) == HUGE_VAL) {
            break;
        } else {
            rest -= slope * (nearest - v);
            v = nearest;
            if (rest * side < 0) rest = 0;
        }
    }
    *voltage = v;
    return rest == 0;
}

long plays_compensate(const plays_model *m, plays_state *s, const double *y, const double *dt, double *v, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        const double before = s->v;
        double now = before, passing = 0;
        int k;
        set_step(m, s, dt ? dt[t] : 0);
        pass(m, s, before, before);
        for (k = 0; k < m->passes; k++) passing += m->share[k] * s->gain[k];
        if (!walk(m, s, y[t] - plays_level(m, s), passing, &now)) return t;
        for (k = 0; k < m->passes; k++) s->q[k] += s->gain[k] * (now - before);
        move(m, s, now);
        v[t] = now;
    }
    return n;
}

void plays_outputs(int plays, const double *r, double *z, const double *v, double *out, long n)
{
    long t;
    int i;
    for (t = 0; t < n; t++)
        for (i = 0; i < plays; i++) out[t * plays + i] = z[i] = clipped(z[i], v[t] - r[i], v[t] + r[i]);
}
