/* Paths that turn at most of their samples, and their evaluation in lanes. */
#ifndef DEHYST_TURNING_H
#define DEHYST_TURNING_H

#include "dehyst_model.h"

/* Largest number of elements for which lanes are faster. */
#define DEHYST_MOST_LANED 128
#define DEHYST_SPRING_CELLS 256

typedef void dehyst_elements_run(const dehyst_plain *plain, dehyst_plain_state *state, const dehyst_real *in,
                                 dehyst_real *out, long n);

/* Return whether carts are faster than a stack of reversals on a path [n]; smaller reversals than `small` are elastic.
 * The answer depends on the path and the actuator only, never on the processor. */
int dehyst_turns_often(const dehyst_plain *plain, const dehyst_real *path, long n, dehyst_real small);

/* Displacements to voltages, and voltages to displacements, on the carts. Both builds give the same bits. */
dehyst_elements_run dehyst_elements_compensate, dehyst_elements_simulate;
dehyst_elements_run dehyst_elements_compensate_baseline, dehyst_elements_simulate_baseline;
dehyst_elements_run dehyst_elements_compensate_avx2, dehyst_elements_simulate_avx2;

#endif
