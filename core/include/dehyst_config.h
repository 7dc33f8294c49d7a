/* The number type of the core. An export of floats changes these lines and nothing else. Every translation unit
 * includes them: a type chosen by macro in one unit only would compile without a warning and return garbage. */
#ifndef DEHYST_CONFIG_H
#define DEHYST_CONFIG_H

#include <float.h>

typedef double dehyst_real;
#define DEHYST_EPSILON DBL_EPSILON
#define DEHYST_LARGEST DBL_MAX

#endif
