/* Play operators with curves on them, and low-passes: what Prandtl's, Kuhnen's, the generalised and Krasnosel'skii's
 * models are made of. For comparison only, never exported.
 *
 *     y = c + sum_i phi_i(z_i) + sum_k c_k q_k,      z_i <- min(max(z_i, v - r_i), v + r_i),      tau_k q_k' = v - q_k
 *
 *   z_i  output of the play of threshold r_i >= 0 [V]     phi_i  nondecreasing, piecewise linear, knots of its own [m]
 *   q_k  low-pass of the voltage [V], exact where v is linear between samples     c_k  its share [m/V], >= 0
 *
 * v -> y (simulate) is explicit. y -> v (compensate) walks from where v is to the next place where a play begins to
 * move or passes a knot, until y is met: exact, with neither tolerance nor iteration.
 */
#ifndef DEHYST_PLAYS_H
#define DEHYST_PLAYS_H

#ifdef __cplusplus
extern "C" {
#endif

typedef struct plays_model {
    int plays;
    const double *r;     /* [plays] */
    const int *first;    /* [plays + 1] where the knots of phi_i begin; its slopes begin at first_i + i */
    const double *knot;  /* [first_plays] increasing within each phi_i, one at least */
    const double *value; /* [first_plays] phi_i there */
    const double *slope; /* [first_plays + plays] of phi_i: below its first knot, between knots, beyond the last */
    int passes;
    const double *tau;   /* [passes] */
    const double *share; /* [passes] c_k */
    double offset;       /* c */
} plays_model;

typedef struct plays_state {
    double v;
    double *z;    /* [plays] */
    double *q;    /* [passes] */
    double *held; /* [plays] phi_i(z_i), made by plays_begin */
    int *at;      /* [plays] the segment of phi_i that holds z_i, made by plays_begin */
    double dt;    /* the time step of the next two, made by plays_begin */
    double *kept; /* [passes] what q_k keeps of itself over dt */
    double *gain; /* [passes] what it takes of a voltage that rises in a straight line to the end of dt */
} plays_state;

/* Fills what depends on z, and sets the time step to 0. */
void plays_begin(const plays_model *m, plays_state *s);

/* The displacement in a state. */
double plays_level(const plays_model *m, const plays_state *s);

/* n voltages to displacements; dt [n] is the time before each sample, null if there are no low-passes. */
void plays_simulate(const plays_model *m, plays_state *s, const double *v, const double *dt, double *y, long n);

/* n displacements to voltages. Returns how many were met: less than n if one lies beyond what the model can reach. */
long plays_compensate(const plays_model *m, plays_state *s, const double *y, const double *dt, double *v, long n);

/* Outputs z, n rows of `plays`, of the plays alone. */
void plays_outputs(int plays, const double *r, double *z, const double *v, double *out, long n);

#ifdef __cplusplus
}
#endif
#endif
