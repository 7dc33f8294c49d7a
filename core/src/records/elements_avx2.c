/* The lanes for x86-64 processors with AVX2. Without fused multiply-add: the bits are those of the other build. */
#if defined(__AVX2__)
#define BUILD(name) name##_avx2
#include "elements.h"
#else
typedef int dehyst_no_avx2;
#endif
