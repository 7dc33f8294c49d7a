// A compensator that Python steps sample by sample.
#ifndef DEHYST_LOOP_H
#define DEHYST_LOOP_H

#include "arrays.h"

void bind_loop(nb::module_ &m);

#endif
