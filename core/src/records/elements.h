/* The elements of one plain actuator in lanes, for paths that turn at most of their samples: carts are then faster than
 * a stack of reversals. This file is compiled for each instruction set; `BUILD(name)` names a function of a build. */
#ifndef BUILD
#error "define BUILD before including elements.h"
#endif

#include "internal.h"
#include "turning.h"

#define LANES 4
#define EACH(l) for (l = 0; l < LANES; l++)
/* Number of Newton steps after which the scalar core computes a sample. */
#define TRIES 40

/* A load that crosses two cache lines just after they were written is slow. */
#if defined(__GNUC__)
#define ALIGNED __attribute__((aligned(64)))
#else
#define ALIGNED
#endif

/* Tables of the elements, padded with elements that never slide. */
typedef struct element_lanes {
    ALIGNED dehyst_real rho[DEHYST_MOST_LANED + LANES];
    ALIGNED dehyst_real kappa[DEHYST_MOST_LANED + LANES];
    ALIGNED dehyst_real cart[DEHYST_MOST_LANED + LANES];
    int size; /* a multiple of LANES */
} element_lanes;

static void fill_lanes(element_lanes *lanes, const dehyst_slip *slip, const dehyst_real *cart)
{
    int i;
    lanes->size = (slip->size + LANES - 1) / LANES * LANES;
    for (i = 0; i < lanes->size; i++) {
        const int real = i < slip->size;
        lanes->rho[i] = real ? slip->rho[i] : DEHYST_LARGEST / 4;
        lanes->kappa[i] = real ? slip->kappa[i] : 0;
        lanes->cart[i] = real ? cart[i] : 0;
    }
}

static void read_lanes(const element_lanes *lanes, int size, dehyst_real *cart)
{
    int i;
    for (i = 0; i < size; i++) cart[i] = lanes->cart[i];
}

/* Equal cells of the spring, and the number of knots before each: on a random path no last segment helps the search. */
typedef struct spring_cells {
    const dehyst_curve *curve;
    dehyst_real origin, scale;
    int crowded; /* whether a cell has more than one knot */
    unsigned char before[DEHYST_SPRING_CELLS];
} spring_cells;

static inline int cell_at(const spring_cells *cells, dehyst_real x)
{
    const dehyst_real place = (x - cells->origin) * cells->scale;
    return !(place > 0) ? 0 : place >= DEHYST_SPRING_CELLS - 1 ? DEHYST_SPRING_CELLS - 1 : (int)place;
}

static void fill_cells(spring_cells *cells, const dehyst_curve *curve)
{
    int i, j = 1;
    cells->curve = curve;
    cells->origin = curve->knot[1];
    cells->scale = curve->size > 3 ? (DEHYST_SPRING_CELLS - 1) / (curve->knot[curve->size - 2] - curve->knot[1]) : 0;
    if (!is_finite(cells->scale)) cells->scale = 0;
    cells->crowded = 0;
    for (i = 0; i < DEHYST_SPRING_CELLS; i++) {
        while (j + 1 < curve->size && cell_at(cells, curve->knot[j]) < i) j++;
        cells->before[i] = (unsigned char)(j - 1);
        if (i > 0 && cells->before[i] > cells->before[i - 1] + 1) cells->crowded = 1;
    }
    if (j + 2 < curve->size) cells->crowded = 1;
}

static inline int segment_at(const spring_cells *cells, dehyst_real x)
{
    const dehyst_curve *curve = cells->curve;
    int j = cells->before[cell_at(cells, x)];
    /* No branch here: a processor cannot predict the side of a random x. */
    j += (j + 2 < curve->size) & (curve->knot[j + 1] <= x);
    if (cells->crowded)
        while (j + 2 < curve->size && curve->knot[j + 1] <= x) j++;
    return j;
}

void BUILD(dehyst_elements_compensate)(const dehyst_plain *plain, dehyst_plain_state *state, const dehyst_real *y,
                                       dehyst_real *v, long n)
{
    element_lanes lanes;
    spring_cells cells;
    dehyst_real x = state->y;
    long t;
    fill_lanes(&lanes, &plain->slip, state->cart);
    fill_cells(&cells, &plain->spring);
    for (t = 0; t < n; t++) {
        dehyst_real sum[LANES], spring;
        int i, l;
        if (is_finite(y[t])) x = y[t];
        EACH(l) sum[l] = 0;
        for (i = 0; i < lanes.size; i += LANES)
            EACH(l) {
                const dehyst_real now = cart_after(lanes.cart[i + l], x, lanes.rho[i + l]);
                lanes.cart[i + l] = now;
                sum[l] += lanes.kappa[i + l] * (x - now);
            }
        spring = on_segment(&plain->spring, segment_at(&cells, x), x);
        v[t] = ((sum[0] + sum[2]) + (sum[1] + sum[3])) + spring;
    }
    read_lanes(&lanes, plain->slip.size, state->cart);
    state->y = x;
}

/* A branch at a place: voltage, slope, and the length of the straight segment ahead. */
typedef struct place_on_branch {
    dehyst_real v, slope, room;
} place_on_branch;

/* @param x a place beyond the present one in a direction */
static inline place_on_branch branch_at(const element_lanes *lanes, const spring_cells *cells, dehyst_real x,
                                        dehyst_real direction)
{
    const dehyst_curve *curve = cells->curve;
    const int j = segment_at(cells, x);
    place_on_branch at;
    dehyst_real v[LANES], slope[LANES], room[LANES];
    int i, l;
    EACH(l) v[l] = slope[l] = 0;
    EACH(l) room[l] = DEHYST_LARGEST;
    for (i = 0; i < lanes->size; i += LANES)
        EACH(l) {
            const dehyst_real rho = lanes->rho[i + l], kappa = lanes->kappa[i + l];
            const dehyst_real long_ = direction * (x - lanes->cart[i + l]), left = rho - long_;
            const int sticks = left > 0;
            v[l] += kappa * (sticks ? long_ : rho);
            slope[l] += sticks ? kappa : 0;
            room[l] = sticks && left < room[l] ? left : room[l];
        }
    at.v = direction * ((v[0] + v[2]) + (v[1] + v[3])) + on_segment(curve, j, x);
    at.slope = ((slope[0] + slope[2]) + (slope[1] + slope[3])) + curve->slope[j];
    at.room = direction > 0 ? (j + 2 < curve->size ? curve->knot[j + 1] - x : DEHYST_LARGEST)
                            : (j > 0 ? x - curve->knot[j] : DEHYST_LARGEST);
    EACH(l) at.room = room[l] < at.room ? room[l] : at.room;
    return at;
}

void BUILD(dehyst_elements_simulate)(const dehyst_plain *plain, dehyst_plain_state *state, const dehyst_real *v,
                                     dehyst_real *y, long n)
{
    element_lanes lanes;
    spring_cells cells;
    dehyst_real x = state->y, held = dehyst_plain_voltage(plain, state), last = 1, slope, stiffest;
    long t;
    int i, l;
    fill_lanes(&lanes, &plain->slip, state->cart);
    fill_cells(&cells, &plain->spring);
    stiffest = (plain->spring.value[plain->spring.size - 1] - plain->spring.value[0]) /
               (plain->spring.knot[plain->spring.size - 1] - plain->spring.knot[0]);
    for (i = 0; i < lanes.size; i++) stiffest += lanes.kappa[i];
    slope = stiffest;
    for (t = 0; t < n; t++) {
        const dehyst_real given = v[t], d = given < held ? -1 : 1; /* v and y may be one array */
        dehyst_real low = 0, high = DEHYST_LARGEST, way, goal = x;
        int tries;
        if (!(given != held) || !is_finite(given)) {
            y[t] = x;
            continue;
        }
        /* At a turn of the motion, all elements stick. */
        way = d * (given - held) / (d == last ? slope : stiffest);
        for (tries = 0; tries < TRIES; tries++) {
            const place_on_branch at = branch_at(&lanes, &cells, x + d * way, d);
            const dehyst_real rest = d * (given - at.v);
            dehyst_real next = way + rest / at.slope;
            slope = at.slope;
            if (rest >= 0 && next - way <= at.room) {
                goal = x + d * next;
                break;
            }
            if (rest >= 0)
                low = way;
            else
                high = way;
            way = next > low && next < high ? next : low + (high - low) / 2;
        }
        if (tries == TRIES || !within_reach(goal)) {
            dehyst_plain_state by_itself;
            by_itself.y = x;
            by_itself.cart = lanes.cart;
            goal = dehyst_plain_simulate(plain, &by_itself, given);
            if (!within_reach(goal)) {
                y[t] = goal;
                continue;
            }
        }
        for (i = 0; i < lanes.size; i += LANES)
            EACH(l) lanes.cart[i + l] = cart_after(lanes.cart[i + l], goal, lanes.rho[i + l]);
        y[t] = x = goal;
        held = given;
        last = d;
    }
    read_lanes(&lanes, plain->slip.size, state->cart);
    state->y = x;
}
