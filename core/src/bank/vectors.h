/* DEHYST_LANES numbers at once, in registers of AVX2 or in an array: the same operations in both.
 *
 * A mask holds in some lanes. `least(a, b)` is b where a < b does not hold, `most(a, b)` is b where a > b does not: the
 * order of operands counts for signed zeros and NaN. No comparison with NaN holds. Bit l of `bits_of` is lane l. */
#ifndef DEHYST_BANK_VECTORS_H
#define DEHYST_BANK_VECTORS_H

#include "tables.h"

/* A call would pass lanes through memory. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define fetch(address) __builtin_prefetch(address)
#define fetch_to_write(address) __builtin_prefetch(address, 1)
#else
#define INLINE static inline
#define fetch(address) ((void)(address))
#define fetch_to_write(address) ((void)(address))
#endif

#if defined(__AVX2__)
#include <immintrin.h>

/* Two registers: while one waits, the other goes on. */
typedef struct lanes {
    __m256d a, b;
} lanes;
typedef struct counts {
    __m256i a, b;
} counts;

#define OPERATION(name, operation)                                                                                     \
    INLINE lanes name(lanes x, lanes y)                                                                         \
    {                                                                                                                  \
        const lanes result = {operation(x.a, y.a), operation(x.b, y.b)};                                               \
        return result;                                                                                                 \
    }
#define BELOW(x, y) _mm256_cmp_pd(x, y, _CMP_LT_OQ)
#define BELOW_OR_AT(x, y) _mm256_cmp_pd(x, y, _CMP_LE_OQ)
#define AT(x, y) _mm256_cmp_pd(x, y, _CMP_EQ_OQ)
OPERATION(plus, _mm256_add_pd)
OPERATION(minus, _mm256_sub_pd)
OPERATION(times, _mm256_mul_pd)
OPERATION(over, _mm256_div_pd)
OPERATION(least, _mm256_min_pd)
OPERATION(most, _mm256_max_pd)
OPERATION(less, BELOW)
OPERATION(at_most, BELOW_OR_AT)
OPERATION(equal, AT)
OPERATION(both, _mm256_and_pd)
OPERATION(either, _mm256_or_pd)
OPERATION(where, _mm256_and_pd)
#undef OPERATION
#undef BELOW
#undef BELOW_OR_AT
#undef AT

INLINE lanes load(const dehyst_real *from)
{
    const lanes result = {_mm256_loadu_pd(from), _mm256_loadu_pd(from + 4)};
    return result;
}

INLINE void store(dehyst_real *to, lanes x)
{
    _mm256_storeu_pd(to, x.a);
    _mm256_storeu_pd(to + 4, x.b);
}

INLINE lanes all_of(dehyst_real number)
{
    const lanes result = {_mm256_set1_pd(number), _mm256_set1_pd(number)};
    return result;
}

INLINE __m256d blended(__m256d y, __m256d x, __m256d mask)
{
#if defined(__GNUC__)
    /* GCC makes a comparison with zero of the intrinsic function. */
    __m256d result;
    __asm__("vblendvpd %3, %2, %1, %0" : "=x"(result) : "x"(y), "xm"(x), "x"(mask));
    return result;
#else
    return _mm256_blendv_pd(y, x, mask);
#endif
}

INLINE lanes choose(lanes mask, lanes x, lanes y)
{
    const lanes result = {blended(y.a, x.a, mask.a), blended(y.b, x.b, mask.b)};
    return result;
}

INLINE lanes size_of(lanes x)
{
    const __m256d sign = _mm256_set1_pd(-0.0);
    const lanes result = {_mm256_andnot_pd(sign, x.a), _mm256_andnot_pd(sign, x.b)};
    return result;
}

INLINE int bits_of(lanes mask) { return _mm256_movemask_pd(mask.a) | _mm256_movemask_pd(mask.b) << 4; }

INLINE counts no_counts(void)
{
    const counts number = {_mm256_setzero_si256(), _mm256_setzero_si256()};
    return number;
}

INLINE counts count_where(counts number, lanes mask)
{
    number.a = _mm256_sub_epi64(number.a, _mm256_castpd_si256(mask.a));
    number.b = _mm256_sub_epi64(number.b, _mm256_castpd_si256(mask.b));
    return number;
}

INLINE void store_counts(long long *to, counts number)
{
    _mm256_storeu_si256((__m256i *)to, number.a);
    _mm256_storeu_si256((__m256i *)(to + 4), number.b);
}

/* Round towards zero. */
INLINE void store_whole(int *to, lanes x)
{
    _mm_storeu_si128((__m128i *)to, _mm256_cvttpd_epi32(x.a));
    _mm_storeu_si128((__m128i *)(to + 4), _mm256_cvttpd_epi32(x.b));
}

/* Read four rows of four numbers, and exchange rows and columns. */
INLINE void four_columns(const dehyst_real *const row[4], __m256d column[4])
{
    const __m256d a = _mm256_loadu_pd(row[0]), b = _mm256_loadu_pd(row[1]);
    const __m256d c = _mm256_loadu_pd(row[2]), d = _mm256_loadu_pd(row[3]);
    const __m256d even_ab = _mm256_unpacklo_pd(a, b), odd_ab = _mm256_unpackhi_pd(a, b);
    const __m256d even_cd = _mm256_unpacklo_pd(c, d), odd_cd = _mm256_unpackhi_pd(c, d);
    column[0] = _mm256_permute2f128_pd(even_ab, even_cd, 0x20);
    column[1] = _mm256_permute2f128_pd(odd_ab, odd_cd, 0x20);
    column[2] = _mm256_permute2f128_pd(even_ab, even_cd, 0x31);
    column[3] = _mm256_permute2f128_pd(odd_ab, odd_cd, 0x31);
}

INLINE void load_pieces(const dehyst_real *const row[DEHYST_LANES], lanes piece[4])
{
    __m256d column[4];
    int k;
    four_columns(row, column);
    for (k = 0; k < 4; k++) piece[k].a = column[k];
    four_columns(row + 4, column);
    for (k = 0; k < 4; k++) piece[k].b = column[k];
}

#else

typedef struct lanes {
    dehyst_real of[DEHYST_LANES];
} lanes;
typedef struct counts {
    long long of[DEHYST_LANES];
} counts;

#define EACH_LANE for (int l = 0; l < DEHYST_LANES; l++)
#define OPERATION(name, expression)                                                                                    \
    INLINE lanes name(lanes a, lanes b)                                                                         \
    {                                                                                                                  \
        EACH_LANE a.of[l] = (expression);                                                                              \
        return a;                                                                                                      \
    }
OPERATION(plus, a.of[l] + b.of[l])
OPERATION(minus, a.of[l] - b.of[l])
OPERATION(times, a.of[l] * b.of[l])
OPERATION(least, a.of[l] < b.of[l] ? a.of[l] : b.of[l])
OPERATION(most, a.of[l] > b.of[l] ? a.of[l] : b.of[l])
/* Masks are 1 and 0. */
OPERATION(less, a.of[l] < b.of[l])
OPERATION(at_most, a.of[l] <= b.of[l])
OPERATION(both, a.of[l] != 0 && b.of[l] != 0)
OPERATION(either, a.of[l] != 0 || b.of[l] != 0)
#undef OPERATION

INLINE lanes load(const dehyst_real *from)
{
    lanes a;
    EACH_LANE a.of[l] = from[l];
    return a;
}

INLINE void store(dehyst_real *to, lanes a) { EACH_LANE to[l] = a.of[l]; }

INLINE lanes all_of(dehyst_real number)
{
    lanes a;
    EACH_LANE a.of[l] = number;
    return a;
}

INLINE lanes choose(lanes mask, lanes a, lanes b)
{
    EACH_LANE a.of[l] = mask.of[l] != 0 ? a.of[l] : b.of[l];
    return a;
}

INLINE lanes size_of(lanes a)
{
    EACH_LANE a.of[l] = magnitude(a.of[l]);
    return a;
}

INLINE int bits_of(lanes mask)
{
    int bits = 0;
    EACH_LANE bits |= (mask.of[l] != 0) << l;
    return bits;
}

INLINE counts no_counts(void)
{
    counts number = {{0}};
    return number;
}

INLINE counts count_where(counts number, lanes mask)
{
    EACH_LANE number.of[l] += mask.of[l] != 0;
    return number;
}

INLINE void store_counts(long long *to, counts number) { EACH_LANE to[l] = number.of[l]; }

INLINE void store_whole(int *to, lanes x) { EACH_LANE to[l] = (int)x.of[l]; }

INLINE void load_pieces(const dehyst_real *const row[DEHYST_LANES], lanes piece[4])
{
    for (int k = 0; k < 4; k++) EACH_LANE piece[k].of[l] = row[l][k];
}

#endif
#endif
