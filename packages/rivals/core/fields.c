#include "fields.h"

#include <math.h>

/* Newton's steps within a bracket that shrinks: 60 halve it to nothing even if every one of them is refused. */
#define MOST_STEPS 120
#define GRAIN 1e-16

static double clipped(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static double top_of(const preisach_plane *plane) { return plane->low + plane->cells * plane->step; }

static int cell_of(const preisach_plane *plane, double u)
{
    const double x = (u - plane->low) / plane->step;
    return !(x > 0) ? 0 : x >= plane->cells ? plane->cells - 1 : (int)x;
}

static double share_of(const preisach_plane *plane, int i, double u)
{
    return clipped((u - plane->low) / plane->step - i, 0, 1);
}

static double node(const preisach_plane *plane, int i, int j) { return plane->everett[i * (plane->cells + 1) + j]; }

double preisach_everett(const preisach_plane *plane, double high, double low)
{
    const int i = cell_of(plane, high), j = cell_of(plane, low);
    const double a = share_of(plane, i, high), b = share_of(plane, j, low);
    double lower, upper;
    if (i == j) return high > low ? node(plane, i + 1, i) * (a - b) : 0;
    lower = (1 - b) * node(plane, i, j) + b * node(plane, i, j + 1);
    upper = (1 - b) * node(plane, i + 1, j) + b * node(plane, i + 1, j + 1);
    return (1 - a) * lower + a * upper;
}

/* Whether the branch rises, and y where it reaches u. */
static int rises(const preisach_stairs *stairs) { return stairs->depth % 2; }

static double on_branch(const preisach_plane *plane, const preisach_stairs *stairs, double u)
{
    const preisach_turn last = stairs->turn[stairs->depth - 1];
    return rises(stairs) ? last.y + preisach_everett(plane, u, last.v) : last.y - preisach_everett(plane, last.v, u);
}

/* Leave the present branch at (u, y) for one that runs the other way; a branch that has not begun is taken back. */
static void turn_round(preisach_stairs *stairs, double u, double y)
{
    if (stairs->depth > 1 && stairs->turn[stairs->depth - 1].v == u) {
        stairs->depth--;
    } else {
        stairs->turn[stairs->depth].v = u;
        stairs->turn[stairs->depth].y = y;
        stairs->depth++;
    }
}

/* Every relay down: the outermost reversal alone. */
static int emptied(const preisach_plane *plane, preisach_stairs *stairs, double u)
{
    if (rises(stairs) || u > plane->low) return 0;
    stairs->depth = 1;
    return 1;
}

static void follow(const preisach_plane *plane, preisach_stairs *stairs, double v)
{
    const double top = top_of(plane), from = clipped(stairs->v, plane->low, top), u = clipped(v, plane->low, top);
    if (rises(stairs) ? u < from : u > from) turn_round(stairs, from, on_branch(plane, stairs, from));
    while (stairs->depth > 2 &&
           (rises(stairs) ? u >= stairs->turn[stairs->depth - 2].v : u <= stairs->turn[stairs->depth - 2].v))
        stairs->depth -= 2;
    emptied(plane, stairs, u);
    stairs->v = v;
    stairs->y = on_branch(plane, stairs, u) + (v < u ? plane->below : plane->above) * (v - u);
}

void preisach_simulate(const preisach_plane *plane, preisach_stairs *stairs, const double *v, double *y, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        follow(plane, stairs, v[t]);
        y[t] = stairs->y;
    }
}

/* u in [low, high] at which the branch reaches y, found among the nodes, between which it is linear. */
static double sought(const preisach_plane *plane, const preisach_stairs *stairs, double y, double low, double high)
{
    int first = cell_of(plane, low), last = cell_of(plane, high) + 1;
    double u0, u1, y0, y1;
    while (last - first > 1) {
        const int middle = first + (last - first) / 2;
        if (on_branch(plane, stairs, plane->low + middle * plane->step) <= y)
            first = middle;
        else
            last = middle;
    }
    u0 = clipped(plane->low + first * plane->step, low, high);
    u1 = clipped(plane->low + last * plane->step, low, high);
    y0 = on_branch(plane, stairs, u0);
    y1 = on_branch(plane, stairs, u1);
    return y1 > y0 ? clipped(u0 + (u1 - u0) * ((y - y0) / (y1 - y0)), u0, u1) : u0;
}

static void aim(const preisach_plane *plane, preisach_stairs *stairs, double y)
{
    const double top = top_of(plane), from = clipped(stairs->v, plane->low, top), here = on_branch(plane, stairs, from);
    const double highest = plane->bottom + preisach_everett(plane, top, plane->low);
    preisach_turn *turn = stairs->turn;
    double u;
    if (y <= plane->bottom || y >= highest) {
        const int low = y <= plane->bottom;
        u = low ? plane->low : top;
        follow(plane, stairs, u + (low ? (y - plane->bottom) / plane->below : (y - highest) / plane->above));
        stairs->y = y;
        return;
    }
    if (rises(stairs) ? y < here : y > here) turn_round(stairs, from, here);
    while (stairs->depth > 2 &&
           (rises(stairs) ? y >= turn[stairs->depth - 2].y : y <= turn[stairs->depth - 2].y))
        stairs->depth -= 2;
    if (rises(stairs))
        u = sought(plane, stairs, y, turn[stairs->depth - 1].v, stairs->depth > 1 ? turn[stairs->depth - 2].v : top);
    else
        u = sought(plane, stairs, y, turn[stairs->depth - 2].v, turn[stairs->depth - 1].v);
    stairs->v = y == here ? from : u;
    stairs->y = y;
}

void preisach_compensate(const preisach_plane *plane, preisach_stairs *stairs, const double *y, double *v, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        aim(plane, stairs, y[t]);
        v[t] = stairs->v;
    }
}

static void count(const preisach_plane *plane, double *out, double sign, double high, double low)
{
    const int i = cell_of(plane, high), j = cell_of(plane, low), wide = plane->cells + 1;
    const double a = share_of(plane, i, high), b = share_of(plane, j, low);
    if (i == j) {
        out[(i + 1) * wide + i] += high > low ? sign * (a - b) : 0;
        return;
    }
    out[i * wide + j] += sign * (1 - a) * (1 - b);
    out[i * wide + j + 1] += sign * (1 - a) * b;
    out[(i + 1) * wide + j] += sign * a * (1 - b);
    out[(i + 1) * wide + j + 1] += sign * a * b;
}

void preisach_counts(const preisach_plane *plane, preisach_stairs *stairs, const double *v, const long *sample,
                     double *out, long rows)
{
    const long wide = (long)(plane->cells + 1) * (plane->cells + 1);
    long t = 0;
    int k;
    for (; rows > 0; rows--, sample++, out += wide) {
        for (; t <= *sample; t++) follow(plane, stairs, v[t]);
        for (k = 1; k <= stairs->depth; k++) {
            const double a = stairs->turn[k - 1].v;
            const double b = k < stairs->depth ? stairs->turn[k].v : clipped(stairs->v, plane->low, top_of(plane));
            if (b > a)
                count(plane, out, 1, b, a);
            else
                count(plane, out, -1, a, b);
        }
    }
}

/* The root of value(x) = goal in [low, high], value increasing; a function returns both value and slope. */
typedef double (*increasing)(const void *what, double x, double *slope);

/* A step shorter than the grain ends the search. */
static double root_of(increasing value, const void *what, double goal, double low, double high, double start,
                      double grain)
{
    double x = clipped(start, low, high);
    int i;
    for (i = 0; i < MOST_STEPS; i++) {
        double slope, miss = value(what, x, &slope) - goal, next;
        if (miss == 0) return x;
        if (miss > 0)
            high = x;
        else
            low = x;
        next = slope > 0 ? x - miss / slope : low;
        if (!(next > low && next < high)) {
            /* A step that rounds to nothing ends at the root; one that leaves the bracket halves it. */
            if (next == x) return x;
            next = low + 0.5 * (high - low);
            if (next <= low || next >= high) return x;
        }
        if (fabs(next - x) <= grain) return next;
        x = next;
    }
    return x;
}

static double cubic_value(const void *what, double t, double *slope)
{
    const double *c = ((const cubic_map *)what)->c;
    *slope = c[1] + t * (2 * c[2] + t * 3 * c[3]);
    return c[0] + t * (c[1] + t * (c[2] + t * c[3]));
}

double cubic_at(const cubic_map *map, double w)
{
    const double t = (w - map->low) / map->span, inside = clipped(t, 0, 1);
    double slope, value = cubic_value(map, inside, &slope);
    return value + slope * (t - inside);
}

double cubic_inverse(const cubic_map *map, double y)
{
    double slope0, slope1, t;
    const double y0 = cubic_value(map, 0, &slope0), y1 = cubic_value(map, 1, &slope1);
    if (y <= y0)
        t = (y - y0) / slope0;
    else if (y >= y1)
        t = 1 + (y - y1) / slope1;
    else
        t = root_of(cubic_value, map, y, 0, 1, (y - y0) / (y1 - y0), GRAIN);
    return map->low + map->span * t;
}

/* h after moving by x >= 0 on a side where h' = alpha - k h. */
static double relaxed(double alpha, double k, double h, double x)
{
    const double z = k * x;
    return h + (alpha - k * h) * (fabs(z) < 1e-12 ? x : -expm1(-z) / k);
}

/* h after v has risen by x, and its slope; falling is the same with both signs turned. */
static double carried(const boucwen *m, double h, double x, double *slope)
{
    const double k = m->beta - m->gamma, ks = m->beta + m->gamma, rest = m->alpha - k * h;
    if (h < 0) {
        /* Way to h = 0, where the other side's equation takes over. */
        const double way = fabs(k * h) < 1e-9 * m->alpha ? -h / m->alpha * (1 + 0.5 * k * h / m->alpha)
                                                         : -log1p(k * h / rest) / k;
        if (x <= way) {
            h = relaxed(m->alpha, k, h, x);
            *slope = m->alpha - k * h;
            return h;
        }
        x -= way;
        h = 0;
    }
    h = relaxed(m->alpha, ks, h, x);
    *slope = m->alpha - ks * h;
    return h;
}

void boucwen_lag(const boucwen *model, boucwen_state *state, const double *v, double *w, long n)
{
    double slope;
    long t;
    for (t = 0; t < n; t++) {
        const double x = v[t] - state->v, sign = x < 0 ? -1 : 1;
        state->h = sign * carried(model, sign * state->h, sign * x, &slope);
        state->v = v[t];
        w[t] = state->v - state->h;
    }
}

void boucwen_simulate(const boucwen *model, boucwen_state *state, const double *v, double *y, long n)
{
    long t;
    for (t = 0; t < n; t++) {
        boucwen_lag(model, state, v + t, y + t, 1);
        y[t] = cubic_at(&model->map, y[t]);
    }
}

typedef struct boucwen_branch {
    const boucwen *model;
    double h;
} boucwen_branch;

/* By how much w has moved when v has moved by x. */
static double boucwen_moved(const void *what, double x, double *slope)
{
    const boucwen_branch *branch = what;
    const double h = carried(branch->model, branch->h, x, slope);
    *slope = 1 - *slope;
    return x - (h - branch->h);
}

void boucwen_compensate(const boucwen *model, boucwen_state *state, const double *y, double *v, long n)
{
    const double steepest = 2 * model->alpha * model->beta / (model->beta + model->gamma);
    const double least = 1 - (model->alpha > steepest ? model->alpha : steepest);
    double slope;
    long t;
    for (t = 0; t < n; t++) {
        const double way = cubic_inverse(&model->map, y[t]) - (state->v - state->h), sign = way < 0 ? -1 : 1;
        const boucwen_branch branch = {model, sign * state->h};
        double x;
        boucwen_moved(&branch, 0, &slope);
        x = root_of(boucwen_moved, &branch, fabs(way), 0, 2 * fabs(way) / least, fabs(way) / slope,
                    GRAIN * (fabs(branch.h) + fabs(way)));
        state->h = sign * carried(model, branch.h, x, &slope);
        state->v += sign * x;
        v[t] = state->v;
    }
}

static double polynomial(const double *c, int size, double t, double *slope)
{
    double value = 0;
    *slope = 0;
    while (size--) {
        *slope = *slope * t + value;
        value = value * t + c[size];
    }
    return value;
}

typedef struct duhem_branch {
    const double *c;
    int size;
    double t, beyond, rate; /* where it began, y - P there, and the rate with the sign of the direction */
} duhem_branch;

static double duhem_value(const void *what, double t, double *slope)
{
    const duhem_branch *b = what;
    const double left = b->beyond * exp(-b->rate * (t - b->t)), value = polynomial(b->c, b->size, t, slope) + left;
    *slope -= b->rate * left;
    return value;
}

static duhem_branch branch_of(const duhem *model, double t, double y, int rises)
{
    duhem_branch branch = {rises ? model->rise : model->fall, model->size, t, 0, rises ? model->rate : -model->rate};
    double slope;
    branch.beyond = y - polynomial(branch.c, branch.size, t, &slope);
    return branch;
}

/* The state's place within the identified voltages: t and y there. */
static double within(const duhem *model, const duhem_state *state, double *y)
{
    const double t = clipped((state->v - model->low) / model->span, 0, 1), at = model->low + model->span * t;
    *y = state->y;
    if (t == 0) *y -= model->below * (state->v - at);
    if (t == 1) *y -= model->above * (state->v - at);
    return t;
}

void duhem_simulate(const duhem *model, duhem_state *state, const double *v, double *y, long n)
{
    long i;
    for (i = 0; i < n; i++) {
        double here, slope, t0 = within(model, state, &here), way = (v[i] - model->low) / model->span;
        const double t = clipped(way, 0, 1);
        if (t != t0) {
            const duhem_branch branch = branch_of(model, t0, here, t > t0);
            here = duhem_value(&branch, t, &slope);
        }
        state->v = v[i];
        state->y = here + (way < t ? model->below : model->above) * model->span * (way - t);
        y[i] = state->y;
    }
}

void duhem_compensate(const duhem *model, duhem_state *state, const double *y, double *v, long n)
{
    long i;
    for (i = 0; i < n; i++) {
        double here, slope, t0 = within(model, state, &here), end, t;
        const int rises = y[i] > here;
        if (y[i] != here) {
            const duhem_branch branch = branch_of(model, t0, here, rises);
            const double edge = rises ? 1 : 0, beyond = rises ? model->above : model->below;
            end = duhem_value(&branch, edge, &slope);
            if (rises ? y[i] >= end : y[i] <= end) {
                state->v = model->low + model->span * edge + (y[i] - end) / beyond;
            } else {
                duhem_value(&branch, t0, &slope);
                t = root_of(duhem_value, &branch, y[i], rises ? t0 : 0, rises ? 1 : t0,
                            t0 + (y[i] - here) / slope, GRAIN);
                state->v = model->low + model->span * t;
            }
        } else {
            state->v = model->low + model->span * t0;
        }
        state->y = y[i];
        v[i] = state->v;
    }
}
