/* Steppers of rival models that follow fields: Preisach's plane, Bouc and Wen's and Duhem's differential equations.
 * They are in the extension for comparisons, and never exported.
 *
 *   Preisach    y = y_R + E(v, v_R) rising from the last reversal R,  y = y_R - E(v_R, v) falling; a staircase of nested
 *               reversals, wiped out in pairs. E is a table on a uniform grid, bilinear in squares and linear in the
 *               triangles on the diagonal: along a branch y is piecewise linear, so that its inverse is exact.
 *   Bouc-Wen    h' = alpha v' - beta |v'| h - gamma v' |h|,  w = v - h,  y = p(w): exact while v is monotone.
 *   Duhem       y' = a |v'| (f(v) - y) + v' g(v) (Coleman and Hodgdon) with polynomials f and g: exact while v is
 *               monotone, y = P(v) + (y_0 - P(v_0)) exp(-a |v - v_0|), P one polynomial rising and another one falling.
 *
 * Beyond the identified voltages y goes on linearly and nothing is remembered. Every array belongs to the caller.
 */
#ifndef DEHYST_FIELDS_H
#define DEHYST_FIELDS_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct preisach_plane {
    int cells;             /* n >= 1 */
    double low, step;      /* nodes at low + i step, i = 0..n */
    const double *everett; /* [(n + 1)(n + 1)] E(node i, node j), 0 for i <= j, increasing in i and decreasing in j */
    double bottom;         /* y with every relay down */
    double below, above;   /* slopes beyond the grid */
} preisach_plane;

typedef struct preisach_turn {
    double v, y;
} preisach_turn;

/* Nested reversals, outermost first: a minimum (the grid's low end), a maximum, a minimum, ... An odd depth rises. */
typedef struct preisach_stairs {
    int depth;           /* >= 1; a sample adds one at most */
    double v, y;
    preisach_turn *turn; /* [depth before + samples] */
} preisach_stairs;

double preisach_everett(const preisach_plane *plane, double high, double low);
void preisach_simulate(const preisach_plane *plane, preisach_stairs *stairs, const double *v, double *y, long n);
void preisach_compensate(const preisach_plane *plane, preisach_stairs *stairs, const double *y, double *v, long n);
/* out [rows (cells + 1)^2] from zeros: what each node of the table counts in y - bottom at some samples of the path. */
void preisach_counts(const preisach_plane *plane, preisach_stairs *stairs, const double *v, const long *sample,
                     double *out, long rows);

/* y = c_0 + c_1 t + c_2 t^2 + c_3 t^3 with t = (w - low) / span, which increases for 0 <= t <= 1, and linear beyond. */
typedef struct cubic_map {
    double low, span;
    double c[4];
} cubic_map;

double cubic_at(const cubic_map *map, double w);
double cubic_inverse(const cubic_map *map, double y);

typedef struct boucwen {
    double alpha, beta, gamma; /* alpha < 1, beta > 0, beta + gamma > 0, 2 alpha beta < beta + gamma: w follows v */
    cubic_map map;
} boucwen;

typedef struct boucwen_state {
    double v, h;
} boucwen_state;

void boucwen_simulate(const boucwen *model, boucwen_state *state, const double *v, double *y, long n);
void boucwen_compensate(const boucwen *model, boucwen_state *state, const double *y, double *v, long n);
/* The same without the map: out receives w. */
void boucwen_lag(const boucwen *model, boucwen_state *state, const double *v, double *w, long n);

typedef struct duhem {
    double low, span;           /* t = (v - low) / span from 0 to 1 */
    double rate;                /* a span > 0 */
    int size;                   /* coefficients of a polynomial */
    const double *rise, *fall;  /* [size] of t, the constant first */
    double below, above;        /* slopes beyond */
} duhem;

typedef struct duhem_state {
    double v, y;
} duhem_state;

void duhem_simulate(const duhem *model, duhem_state *state, const double *v, double *y, long n);
void duhem_compensate(const duhem *model, duhem_state *state, const double *y, double *v, long n);

#ifdef __cplusplus
}
#endif
#endif
