/* Replays the calls that Python made with the same stage: prints the differences, and returns 0 if there is none. */
#include "piezo.h"
#include "trace.h"

#include <float.h>
#include <math.h>
#include <stdio.h>

#define MOST_PRINTED 5

/* Make the call of a row and write its result. */
static void answer(const trace_row *row, piezo *loop, piezo *body, dehyst_real got[PIEZO_AXES])
{
    dehyst_real given[PIEZO_AXES];
    int j;
    for (j = 0; j < PIEZO_AXES; j++) given[j] = (dehyst_real)row->given[j];
    switch (row->what) {
    case TRACE_STEP: piezo_step(loop, given, got); return;
    case TRACE_OFFER: piezo_offer(loop, given, got); return;
    case TRACE_COMMIT: piezo_commit(loop, given); piezo_displacement(loop, got); return;
    case TRACE_ACCEPT:
        for (j = 0; j < PIEZO_AXES; j++) given[j] = loop->loop[j].voltage;
        piezo_commit(loop, given);
        piezo_displacement(loop, got);
        return;
    case TRACE_HOLD: piezo_hold(loop); piezo_displacement(loop, got); return;
    case TRACE_NONSENSE: given[0] = (dehyst_real)NAN; piezo_step(loop, given, got); return;
    default: piezo_simulate(body, given, got); return;
    }
}

static int counts_differ(const piezo *loop)
{
    int j, differing = 0;
    for (j = 0; j < PIEZO_AXES; j++) {
        const dehyst_loop *l = &loop->loop[j];
        if (l->limited == trace_limited[j] && l->slewed == trace_slewed[j]) continue;
        printf("axis %d: got %lu limited, %lu slewed; want %lu, %lu\n", j, l->limited, l->slewed, trace_limited[j],
               trace_slewed[j]);
        differing++;
    }
    return differing;
}

int main(void)
{
    static piezo loop, body;
    int differing = 0, i, j;
    if (piezo_begin(&loop) != DEHYST_OK || piezo_begin(&body) != DEHYST_OK) {
        printf("piezo_begin: a state does not belong to its model\n");
        return 1;
    }
    for (i = 0; i < TRACE_SIZE; i++) {
        dehyst_real got[PIEZO_AXES];
        answer(trace + i, &loop, &body, got);
        for (j = 0; j < PIEZO_AXES; j++)
            if (got[j] != trace[i].answer[j] && differing++ < MOST_PRINTED)
                printf("row %d, axis %d: got %.17g, want %.17g\n", i, j, got[j], trace[i].answer[j]);
        /* The address of a piezo may not change the results. */
        if (i == TRACE_SIZE / 2) {
            const piezo copy = loop;
            piezo_begin(&loop);
            loop = copy;
        }
    }
    differing += counts_differ(&loop);
    if (differing > 0 && FLT_EVAL_METHOD != 0) printf("this compiler computes in another precision\n");
    printf("double: %d of %d answers differ from Python's\n", differing, TRACE_SIZE * PIEZO_AXES);
    return differing > 0;
}
