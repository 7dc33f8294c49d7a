/* Time of single steps of an exported compensator, on a path that reverses at every step.
 *
 * Blocks of steps tell the median; single steps, each between two looks at the clock, tell how far one may be off. */
#include "piezo.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define BLOCK 100

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static int rising(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void tell(const char *name, double *value, long n)
{
    qsort(value, (size_t)n, sizeof *value, rising);
    printf("%s %.17g %.17g %.17g %.17g\n", name, value[n / 2], value[n - n / 100], value[n - n / 10000], value[n - 1]);
}

/* Branches of random lengths, one up, one down; then the same slowly. */
static double wanted(long t, unsigned long *seed, double low, double high, long sweep)
{
    const double u = (double)((*seed = *seed * 6364136223846793005UL + 1442695040888963407UL) >> 11) / 9007199254740992.0;
    const double middle = 0.5 * (low + high);
    if (sweep > 0) return low + (high - low) * (double)(t % (2 * sweep) < sweep ? t % sweep : sweep - t % sweep) / (double)sweep;
    return t % 2 ? middle + u * (high - middle) : middle - u * (middle - low);
}

int main(int argc, char **argv)
{
    const double low = argc > 2 ? atof(argv[1]) : 0, high = argc > 2 ? atof(argv[2]) : 1;
    const long steps = argc > 3 ? atol(argv[3]) : 1000000, blocks = steps / BLOCK;
    double *block = malloc((size_t)blocks * sizeof *block), *single = malloc((size_t)steps * sizeof *single);
    double u[BLOCK], sum = 0;
    unsigned long seed = 1;
    long sweep, b, t;
    piezo stage;
    if (block == NULL || single == NULL || piezo_begin(&stage) != DEHYST_OK) return 1;
    for (t = 0; t < steps; t++) {
        const double begin = now();
        single[t] = now() - begin;
    }
    tell("clock", single, steps);
    for (sweep = 0; sweep <= 10000; sweep += 10000) {
        for (b = 0; b < blocks; b++) {
            double begin;
            for (t = 0; t < BLOCK; t++) u[t] = wanted(b * BLOCK + t, &seed, low, high, sweep);
            begin = now();
            for (t = 0; t < BLOCK; t++) sum += piezo_step(&stage, (dehyst_real)u[t]);
            block[b] = (now() - begin) / BLOCK;
        }
        tell(sweep > 0 ? "swept" : "reversing", block, blocks);
    }
    for (t = 0; t < steps; t++) {
        const dehyst_real y = (dehyst_real)wanted(t, &seed, low, high, 0);
        const double begin = now();
        sum += piezo_step(&stage, y);
        single[t] = now() - begin;
    }
    tell("single", single, steps);
    fprintf(stderr, "%g\n", sum);
    return 0;
}
