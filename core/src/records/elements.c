#define BUILD(name) name##_baseline
#include "elements.h"

/* Number of samples to check, and the least share of them that turn. */
#define LOOK 512
#define OFTEN 6

int dehyst_turns_often(const dehyst_plain *plain, const dehyst_real *path, long n, dehyst_real small)
{
    const long count = n < LOOK ? n : LOOK;
    long t, turns = 0;
    if (plain->slip.size > DEHYST_MOST_LANED || plain->spring.size > DEHYST_SPRING_CELLS / 2) return 0;
    for (t = 2; t < count; t++) {
        const dehyst_real before = path[t - 1] - path[t - 2], now = path[t] - path[t - 1];
        turns += before * now < 0 && magnitude(before) > small && magnitude(now) > small;
    }
    return OFTEN * turns > count;
}

static int has_avx2(void)
{
#if defined(DEHYST_BUILD_AVX2) && defined(__GNUC__)
    return __builtin_cpu_supports("avx2") != 0;
#else
    return 0;
#endif
}

#if !defined(DEHYST_BUILD_AVX2)
#define dehyst_elements_compensate_avx2 dehyst_elements_compensate_baseline
#define dehyst_elements_simulate_avx2 dehyst_elements_simulate_baseline
#endif

void dehyst_elements_compensate(const dehyst_plain *plain, dehyst_plain_state *state, const dehyst_real *y,
                                dehyst_real *v, long n)
{
    (has_avx2() ? dehyst_elements_compensate_avx2 : dehyst_elements_compensate_baseline)(plain, state, y, v, n);
}

void dehyst_elements_simulate(const dehyst_plain *plain, dehyst_plain_state *state, const dehyst_real *v,
                              dehyst_real *y, long n)
{
    (has_avx2() ? dehyst_elements_simulate_avx2 : dehyst_elements_simulate_baseline)(plain, state, v, y, n);
}
