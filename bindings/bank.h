// Many actuators at once.
#ifndef DEHYST_BANK_BINDING_H
#define DEHYST_BANK_BINDING_H

#include "arrays.h"

void bind_bank(nb::module_ &m);

#endif
