/* Paths that turn at most samples, and the lanes that such paths run in. */
#ifndef DEHYST_TURNING_H
#define DEHYST_TURNING_H

#include "dehyst_model.h"

/* More elements are not worth it. */
#define DEHYST_MOST_LANED 128
#define DEHYST_SPRING_CELLS 256

typedef void dehyst_elements_run(const dehyst_plain *plain, dehyst_plain_state *state, const dehyst_real *in,
                                 dehyst_real *out, long n);

/* Return whether carts are faster than a stack of reversals on a path [n] in which `small` turns back elastically. The
 * answer depends on the path and the actuator only, never on the processor. */
int dehyst_turns_often(const dehyst_plain *plain, const dehyst_real *path, long n, dehyst_real small);

/* Displacements to voltages and back, on the carts. Both builds give the same bits. */
dehyst_elements_run dehyst_elements_compensate, dehyst_elements_simulate;
dehyst_elements_run dehyst_elements_compensate_baseline, dehyst_elements_simulate_baseline;
dehyst_elements_run dehyst_elements_compensate_avx2, dehyst_elements_simulate_avx2;

#endif
