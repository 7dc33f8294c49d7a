/* The bank for every processor that the compiler builds for. */
#define BUILD(name) name##_baseline
#include "run.h"
