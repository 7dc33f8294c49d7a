/* Replays the calls that Python made with the same model: prints the differences, and returns 0 if there is none. */
#include "piezo.h"
#include "trace.h"

#include <float.h>
#include <math.h>
#include <stdio.h>

#define MOST_PRINTED 5

static double magnitude_of(double a) { return a < 0 ? -a : a; }

/* Make the call of a row and return its result. */
static double answer(const trace_row *row, piezo *loop, piezo *actuator)
{
    const dehyst_real given = (dehyst_real)row->given;
    switch (row->what) {
    case TRACE_STEP: return piezo_step(loop, given);
    case TRACE_OFFER: return piezo_offer(loop, given);
    case TRACE_COMMIT: piezo_commit(loop, given); return piezo_displacement(loop);
    case TRACE_ACCEPT: piezo_commit(loop, loop->loop.voltage); return piezo_displacement(loop);
    case TRACE_HOLD: piezo_hold(loop); return piezo_displacement(loop);
    case TRACE_NONSENSE: return piezo_step(loop, (dehyst_real)NAN);
    default: return piezo_simulate(actuator, given);
    }
}

/* Return the error as a share of the voltage limits, or of the displacements between them. */
static double error_of(const trace_row *row, double got)
{
    const int displaces = row->what >= TRACE_COMMIT && row->what != TRACE_NONSENSE;
    return magnitude_of(got - row->answer) / (displaces ? TRACE_STROKE : TRACE_VOLTS);
}

/* A snapshot does not keep an offer. */
static int row_is_offer(const trace_row *row) { return row->what == TRACE_OFFER; }

static int counts_differ(const piezo *loop)
{
    const dehyst_loop *l = &loop->loop;
    if (l->limited == TRACE_LIMITED && l->slewed == TRACE_SLEWED && l->refused == TRACE_REFUSED) return 0;
    printf("counts: got %lu limited, %lu slewed, %lu refused; want %lu, %lu, %lu\n", l->limited, l->slewed, l->refused,
           TRACE_LIMITED, TRACE_SLEWED, TRACE_REFUSED);
    return 1;
}

static int conclude(int differing, double largest, const piezo *loop)
{
    if (sizeof(dehyst_real) == sizeof(double)) {
        differing += counts_differ(loop);
        if (differing > 0 && FLT_EVAL_METHOD != 0) printf("this compiler computes in another precision\n");
        printf("double: %d of %d answers differ from Python's\n", differing, TRACE_SIZE);
        return differing > 0;
    }
    printf("float: largest error %.3e of the range, to be above %.0e and below %.1e\n", largest, TRACE_LEAST,
           TRACE_MOST);
    /* An error as small as with double shows that the number type was not changed everywhere. */
    return !(largest > TRACE_LEAST && largest < TRACE_MOST);
}

int main(void)
{
    static piezo loop, actuator;
    static unsigned char kept[PIEZO_SNAPSHOT];
    double largest = 0;
    int differing = 0, i;
    if (piezo_begin(&loop) != DEHYST_OK || piezo_begin(&actuator) != DEHYST_OK) {
        printf("piezo_begin: the state does not belong to this model\n");
        return 1;
    }
    for (i = 0; i < TRACE_SIZE; i++) {
        const double got = answer(trace + i, &loop, &actuator), error = error_of(trace + i, got);
        if (error > largest || error != error) largest = error;
        if (got != trace[i].answer && differing++ < MOST_PRINTED && sizeof(dehyst_real) == sizeof(double))
            printf("row %d: got %.17g, want %.17g\n", i, got, trace[i].answer);
        /* Neither a reset nor the address of a piezo may change the results. */
        if (i == TRACE_SIZE / 2) {
            const piezo copy = loop;
            piezo_save(&copy, kept);
            piezo_begin(&loop);
            if (row_is_offer(trace + i)) {
                loop = copy;
            } else if (piezo_restore(&loop, kept) != DEHYST_OK) {
                printf("piezo_restore: a snapshot was refused\n");
                return 1;
            }
        }
    }
    return conclude(differing, largest, &loop);
}
