/* FMI 2.0 for co-simulation. */
#ifdef FMU_STANDARD_HEADERS
#include "fmi2Functions.h"
#else
#include "fmi2.h"
#endif
#include "fmu.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#define FMI(type, name) FMI2_Export type fmi2FullName(fmi2##name)
#define REFERENCES const fmi2ValueReference references[], size_t n

typedef struct instance {
    fmu fmu;
    fmi2CallbackFunctions functions;
    int logging;
    char name[]; /* as long as it was given */
} instance;

/* A message holds no % sign, so it is its own format. */
static fmi2Status report(instance *i, fmi2Status status)
{
    const fmi2String category = status == fmi2Error ? "logStatusError" : "logStatusWarning";
    if (i->functions.logger != NULL)
        i->functions.logger(i->functions.componentEnvironment, i->name, status, category, i->fmu.message);
    return status;
}

static fmi2Status result(instance *i, int good) { return good ? fmi2OK : report(i, fmi2Error); }

static fmi2Status absent(fmi2Component c, const char *what)
{
    instance *i = c;
    return result(i, fmu_demand(&i->fmu, 0, what));
}

FMI(const char *, GetTypesPlatform)(void) { return "default"; }

FMI(const char *, GetVersion)(void) { return "2.0"; }

FMI(fmi2Status, SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)n, (void)categories;
    ((instance *)c)->logging = on;
    return fmi2OK;
}

FMI(fmi2Component, Instantiate)(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    instance *i = calloc(1, sizeof *i + (name == NULL ? 0 : strlen(name)) + 1);
    int good;
    (void)resources, (void)visible;
    if (i == NULL) return NULL;
    if (name != NULL) strcpy(i->name, name);
    if (functions != NULL) i->functions = *functions;
    i->logging = logging;
    good = fmu_begin(&i->fmu) && fmu_matches(&i->fmu, token) &&
           fmu_demand(&i->fmu, type == fmi2CoSimulation, "Instantiate: it is for co-simulation only");
    if (good) return i;
    report(i, fmi2Error);
    free(i);
    return NULL;
}

FMI(void, FreeInstance)(fmi2Component c) { free(c); }

FMI(fmi2Status, SetupExperiment)(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start,
                                 fmi2Boolean stops, fmi2Real stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    ((instance *)c)->fmu.time = start;
    return fmi2OK;
}

FMI(fmi2Status, EnterInitializationMode)(fmi2Component c)
{
    return result(c, fmu_enter(&((instance *)c)->fmu, FMU_MADE, FMU_BEGINNING, "EnterInitializationMode"));
}

FMI(fmi2Status, ExitInitializationMode)(fmi2Component c)
{
    return result(c, fmu_enter(&((instance *)c)->fmu, FMU_BEGINNING, FMU_RUNNING, "ExitInitializationMode"));
}

FMI(fmi2Status, Terminate)(fmi2Component c)
{
    return result(c, fmu_enter(&((instance *)c)->fmu, FMU_RUNNING, FMU_ENDED, "Terminate"));
}

FMI(fmi2Status, Reset)(fmi2Component c) { return result(c, fmu_begin(&((instance *)c)->fmu)); }

FMI(fmi2Status, GetReal)(fmi2Component c, REFERENCES, fmi2Real value[])
{
    instance *i = c;
    int good = 1;
    size_t k;
    for (k = 0; k < n && good; k++) good = fmu_get(&i->fmu, references[k], value + k);
    return result(i, good);
}

FMI(fmi2Status, GetInteger)(fmi2Component c, REFERENCES, fmi2Integer value[])
{
    instance *i = c;
    uint64_t count;
    size_t k;
    for (k = 0; k < n; k++) {
        if (!fmu_count(&i->fmu, references[k], &count)) return report(i, fmi2Error);
        value[k] = count < INT_MAX ? (fmi2Integer)count : INT_MAX;
    }
    return fmi2OK;
}

FMI(fmi2Status, GetBoolean)(fmi2Component c, REFERENCES, fmi2Boolean value[])
{
    (void)references, (void)value;
    return n == 0 ? fmi2OK : absent(c, "GetBoolean: there is no such variable");
}

FMI(fmi2Status, GetString)(fmi2Component c, REFERENCES, fmi2String value[])
{
    (void)references, (void)value;
    return n == 0 ? fmi2OK : absent(c, "GetString: there is no such variable");
}

FMI(fmi2Status, SetReal)(fmi2Component c, REFERENCES, const fmi2Real value[])
{
    instance *i = c;
    int good = 1;
    size_t k;
    for (k = 0; k < n && good; k++) good = fmu_set(&i->fmu, references[k], value[k]);
    return result(i, good);
}

FMI(fmi2Status, SetInteger)(fmi2Component c, REFERENCES, const fmi2Integer value[])
{
    (void)references, (void)value;
    return n == 0 ? fmi2OK : absent(c, "SetInteger: no whole number is an input");
}

FMI(fmi2Status, SetBoolean)(fmi2Component c, REFERENCES, const fmi2Boolean value[])
{
    (void)references, (void)value;
    return n == 0 ? fmi2OK : absent(c, "SetBoolean: there is no such variable");
}

FMI(fmi2Status, SetString)(fmi2Component c, REFERENCES, const fmi2String value[])
{
    (void)references, (void)value;
    return n == 0 ? fmi2OK : absent(c, "SetString: there is no such variable");
}

/* A state that is there is used again. */
FMI(fmi2Status, GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == NULL) *state = malloc(sizeof(fmu_memory));
    if (*state == NULL) return absent(c, "GetFMUstate: no memory is left");
    fmu_save(&((instance *)c)->fmu, *state);
    return fmi2OK;
}

FMI(fmi2Status, SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    if (state == NULL) return absent(c, "SetFMUstate: got none");
    fmu_restore(&((instance *)c)->fmu, state);
    return fmi2OK;
}

FMI(fmi2Status, FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    if (state != NULL) free(*state), *state = NULL;
    return fmi2OK;
}

FMI(fmi2Status, SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(fmu_memory);
    return fmi2OK;
}

FMI(fmi2Status, SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (state == NULL || size < sizeof(fmu_memory)) return absent(c, "SerializeFMUstate: no state, or no room for it");
    fmu_serialize(state, bytes);
    return fmi2OK;
}

FMI(fmi2Status, DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    instance *i = c;
    fmu_memory found;
    if (!fmu_deserialize(&i->fmu, bytes, size, &found)) return report(i, fmi2Error);
    if (*state == NULL) *state = malloc(sizeof(fmu_memory));
    if (*state == NULL) return absent(c, "DeSerializeFMUstate: no memory is left");
    memcpy(*state, &found, sizeof found);
    return fmi2OK;
}

FMI(fmi2Status, GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                          const fmi2ValueReference known[], size_t n, const fmi2Real seed[],
                                          fmi2Real out[])
{
    (void)unknown, (void)unknowns, (void)known, (void)n, (void)seed, (void)out;
    return absent(c, "GetDirectionalDerivative: there is none");
}

FMI(fmi2Status, SetRealInputDerivatives)(fmi2Component c, REFERENCES, const fmi2Integer order[], const fmi2Real value[])
{
    (void)references, (void)order, (void)value;
    return n == 0 ? fmi2OK : absent(c, "SetRealInputDerivatives: the input is held through a step");
}

FMI(fmi2Status, GetRealOutputDerivatives)(fmi2Component c, REFERENCES, const fmi2Integer order[], fmi2Real value[])
{
    (void)references, (void)order, (void)value;
    return n == 0 ? fmi2OK : absent(c, "GetRealOutputDerivatives: there are none");
}

FMI(fmi2Status, DoStep)(fmi2Component c, fmi2Real from, fmi2Real by, fmi2Boolean no_way_back)
{
    instance *i = c;
    (void)no_way_back;
    if (!fmu_step(&i->fmu, from, by)) return report(i, fmi2Error);
    if (fmu_clamped(&i->fmu) && i->logging) report(i, fmi2Warning);
    return fmi2OK;
}

FMI(fmi2Status, CancelStep)(fmi2Component c) { return absent(c, "CancelStep: no step is under way"); }

/* A step is over when DoStep returns: there is nothing to ask for but the time. */
FMI(fmi2Status, GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

FMI(fmi2Status, GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((instance *)c)->fmu.time;
    return fmi2OK;
}

FMI(fmi2Status, GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

FMI(fmi2Status, GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

FMI(fmi2Status, GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
