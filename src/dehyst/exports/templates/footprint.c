/* A program that begins and steps, to be measured. */
#include "piezo.h"

static piezo memory;
volatile dehyst_real wanted, sent;

int main(void)
{
#ifdef MODEL_AXES
    dehyst_real given[MODEL_AXES], got[MODEL_AXES];
    int j;
    if (piezo_begin(&memory) != DEHYST_OK) return 1;
    for (;;) {
        for (j = 0; j < MODEL_AXES; j++) given[j] = wanted;
        piezo_step(&memory, given, got);
        for (j = 0; j < MODEL_AXES; j++) sent = got[j];
    }
#else
    if (piezo_begin(&memory) != DEHYST_OK) return 1;
    for (;;) sent = piezo_step(&memory, wanted);
#endif
}
