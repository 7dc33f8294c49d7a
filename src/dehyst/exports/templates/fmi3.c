/* FMI 3.0 for co-simulation; what it must offer but has not is in fmi3_absent.c. */
#ifdef FMU_STANDARD_HEADERS
#include "fmi3Functions.h"
#else
#include "fmi3.h"
#endif
#include "fmu.h"

#include <stdlib.h>
#include <string.h>

#define FMI(type, name) FMI3_Export type fmi3FullName(fmi3##name)
#define REFERENCES const fmi3ValueReference references[], size_t n

typedef struct instance {
    fmu fmu;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    fmi3Boolean logging;
} instance;

static fmi3Status report(instance *i, fmi3Status status)
{
    const fmi3String category = status == fmi3Error ? "logStatusError" : "logStatusWarning";
    if (i->log != NULL) i->log(i->environment, status, category, i->fmu.message);
    return status;
}

static fmi3Status result(instance *i, int good) { return good ? fmi3OK : report(i, fmi3Error); }

static fmi3Status absent(fmi3Instance c, const char *what)
{
    instance *i = c;
    return result(i, fmu_demand(&i->fmu, 0, what));
}

FMI(const char *, GetVersion)(void) { return "3.0"; }

FMI(fmi3Status, SetDebugLogging)(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)n, (void)categories;
    ((instance *)c)->logging = on;
    return fmi3OK;
}

FMI(fmi3Instance, InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference intermediate[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    instance *i = calloc(1, sizeof *i);
    int good;
    (void)name, (void)resources, (void)visible, (void)early, (void)intermediate, (void)update;
    if (i == NULL) return NULL;
    i->log = log;
    i->environment = environment;
    i->logging = logging;
    good = fmu_begin(&i->fmu) && fmu_matches(&i->fmu, token) &&
           fmu_demand(&i->fmu, !events && n == 0, "Instantiate: there are neither events nor intermediate variables");
    if (good) return i;
    report(i, fmi3Error);
    free(i);
    return NULL;
}

FMI(void, FreeInstance)(fmi3Instance c) { free(c); }

FMI(fmi3Status, EnterInitializationMode)(fmi3Instance c, fmi3Boolean tolerant, fmi3Float64 tolerance,
                                         fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop)
{
    instance *i = c;
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    if (!fmu_enter(&i->fmu, FMU_MADE, FMU_BEGINNING, "EnterInitializationMode")) return report(i, fmi3Error);
    i->fmu.time = start;
    return fmi3OK;
}

FMI(fmi3Status, ExitInitializationMode)(fmi3Instance c)
{
    return result(c, fmu_enter(&((instance *)c)->fmu, FMU_BEGINNING, FMU_RUNNING, "ExitInitializationMode"));
}

FMI(fmi3Status, Terminate)(fmi3Instance c)
{
    return result(c, fmu_enter(&((instance *)c)->fmu, FMU_RUNNING, FMU_ENDED, "Terminate"));
}

FMI(fmi3Status, Reset)(fmi3Instance c) { return result(c, fmu_begin(&((instance *)c)->fmu)); }

FMI(fmi3Status, GetFloat64)(fmi3Instance c, REFERENCES, fmi3Float64 values[], size_t room)
{
    instance *i = c;
    int good = fmu_demand(&i->fmu, room >= n, "GetFloat64: fewer values than references");
    size_t k;
    for (k = 0; k < n && good; k++) good = fmu_get(&i->fmu, references[k], values + k);
    return result(i, good);
}

FMI(fmi3Status, SetFloat64)(fmi3Instance c, REFERENCES, const fmi3Float64 values[], size_t given)
{
    instance *i = c;
    int good = fmu_demand(&i->fmu, given >= n, "SetFloat64: fewer values than references");
    size_t k;
    for (k = 0; k < n && good; k++) good = fmu_set(&i->fmu, references[k], values[k]);
    return result(i, good);
}

FMI(fmi3Status, GetUInt64)(fmi3Instance c, REFERENCES, fmi3UInt64 values[], size_t room)
{
    instance *i = c;
    int good = fmu_demand(&i->fmu, room >= n, "GetUInt64: fewer values than references");
    size_t k;
    for (k = 0; k < n && good; k++) good = fmu_count(&i->fmu, references[k], values + k);
    return result(i, good);
}

/* A state that is there is used again. */
FMI(fmi3Status, GetFMUState)(fmi3Instance c, fmi3FMUState *state)
{
    if (*state == NULL) *state = malloc(sizeof(fmu_memory));
    if (*state == NULL) return absent(c, "GetFMUState: no memory is left");
    fmu_save(&((instance *)c)->fmu, *state);
    return fmi3OK;
}

FMI(fmi3Status, SetFMUState)(fmi3Instance c, fmi3FMUState state)
{
    if (state == NULL) return absent(c, "SetFMUState: got none");
    fmu_restore(&((instance *)c)->fmu, state);
    return fmi3OK;
}

FMI(fmi3Status, FreeFMUState)(fmi3Instance c, fmi3FMUState *state)
{
    (void)c;
    if (state != NULL) free(*state), *state = NULL;
    return fmi3OK;
}

FMI(fmi3Status, SerializedFMUStateSize)(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(fmu_memory);
    return fmi3OK;
}

FMI(fmi3Status, SerializeFMUState)(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (state == NULL || size < sizeof(fmu_memory)) return absent(c, "SerializeFMUState: no state, or no room for it");
    fmu_serialize(state, bytes);
    return fmi3OK;
}

FMI(fmi3Status, DeserializeFMUState)(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    instance *i = c;
    fmu_memory found;
    if (!fmu_deserialize(&i->fmu, bytes, size, &found)) return report(i, fmi3Error);
    if (*state == NULL) *state = malloc(sizeof(fmu_memory));
    if (*state == NULL) return absent(c, "DeserializeFMUState: no memory is left");
    memcpy(*state, &found, sizeof found);
    return fmi3OK;
}

FMI(fmi3Status, DoStep)(fmi3Instance c, fmi3Float64 from, fmi3Float64 by, fmi3Boolean no_way_back, fmi3Boolean *event,
                        fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached)
{
    instance *i = c;
    const int good = fmu_step(&i->fmu, from, by);
    (void)no_way_back;
    *event = *terminate = *early = false;
    *reached = good ? from + by : from;
    if (!good) return report(i, fmi3Error);
    if (fmu_clamped(&i->fmu) && i->logging) report(i, fmi3Warning);
    return fmi3OK;
}
