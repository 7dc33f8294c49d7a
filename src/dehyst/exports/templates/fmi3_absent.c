/* What a library for FMI 3.0 must offer, of things that this FMU has not: other types of variables and interfaces,
 * clocks, events, derivatives. They do nothing and return a status that states it. */
#ifdef FMU_STANDARD_HEADERS
#include "fmi3Functions.h"
#else
#include "fmi3.h"
#endif

#define ABSENT(type, name) FMI3_Export type fmi3FullName(fmi3##name)
#define WHICH const fmi3ValueReference r[], size_t n

/* To ask for no variable at all is allowed. */
#define NO_SETTER(type)                                                                                     \
    ABSENT(fmi3Status, Set##type)(fmi3Instance c, WHICH, const fmi3##type values[], size_t given)         \
    {                                                                                                       \
        (void)c, (void)r, (void)values, (void)given;                                                        \
        return n == 0 ? fmi3OK : fmi3Error;                                                                 \
    }
#define NO_TYPE(type)                                                                                       \
    ABSENT(fmi3Status, Get##type)(fmi3Instance c, WHICH, fmi3##type values[], size_t room)                \
    {                                                                                                       \
        (void)c, (void)r, (void)values, (void)room;                                                         \
        return n == 0 ? fmi3OK : fmi3Error;                                                                 \
    }                                                                                                       \
    NO_SETTER(type)

NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_SETTER(UInt64)
NO_TYPE(Boolean)
NO_TYPE(String)

#define NO_MODE(name)                                                                                       \
    ABSENT(fmi3Status, name)(fmi3Instance c)                                                                   \
    {                                                                                                       \
        (void)c;                                                                                            \
        return fmi3Error;                                                                                   \
    }

NO_MODE(EnterEventMode)
NO_MODE(EnterConfigurationMode)
NO_MODE(ExitConfigurationMode)
NO_MODE(EvaluateDiscreteStates)
NO_MODE(EnterContinuousTimeMode)
NO_MODE(EnterStepMode)

/* One and two arrays of results or values beside the references. */
#define NO_ONE(name, type)                                                                                  \
    ABSENT(fmi3Status, name)(fmi3Instance c, WHICH, type a[])                                             \
    {                                                                                                       \
        (void)c, (void)r, (void)a;                                                                          \
        return n == 0 ? fmi3OK : fmi3Error;                                                                 \
    }
#define NO_TWO(name, type, other)                                                                           \
    ABSENT(fmi3Status, name)(fmi3Instance c, WHICH, type a[], other b[])                                  \
    {                                                                                                       \
        (void)c, (void)r, (void)a, (void)b;                                                                 \
        return n == 0 ? fmi3OK : fmi3Error;                                                                 \
    }

NO_ONE(GetClock, fmi3Clock)
NO_ONE(SetClock, const fmi3Clock)
NO_ONE(GetShiftDecimal, fmi3Float64)
NO_ONE(SetShiftDecimal, const fmi3Float64)
NO_ONE(SetIntervalDecimal, const fmi3Float64)
NO_TWO(GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
NO_TWO(GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_TWO(SetShiftFraction, const fmi3UInt64, const fmi3UInt64)
NO_TWO(SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)

/* The states, derivatives and event indicators of model exchange. */
#define NO_VECTOR(name, type)                                                                               \
    ABSENT(fmi3Status, name)(fmi3Instance c, type x[], size_t n)                                               \
    {                                                                                                       \
        (void)c, (void)x, (void)n;                                                                          \
        return fmi3Error;                                                                                   \
    }
#define NO_SIZE(name)                                                                                       \
    ABSENT(fmi3Status, name)(fmi3Instance c, size_t *n)                                                        \
    {                                                                                                       \
        (void)c, (void)n;                                                                                   \
        return fmi3Error;                                                                                   \
    }

NO_VECTOR(SetContinuousStates, const fmi3Float64)
NO_VECTOR(GetContinuousStates, fmi3Float64)
NO_VECTOR(GetContinuousStateDerivatives, fmi3Float64)
NO_VECTOR(GetNominalsOfContinuousStates, fmi3Float64)
NO_VECTOR(GetEventIndicators, fmi3Float64)
NO_SIZE(GetNumberOfEventIndicators)
NO_SIZE(GetNumberOfContinuousStates)

#define NO_DERIVATIVE(name)                                                                                 \
    ABSENT(fmi3Status, name)(fmi3Instance c, const fmi3ValueReference unknown[], size_t unknowns,              \
                          const fmi3ValueReference known[], size_t n, const fmi3Float64 seed[],             \
                          size_t seeds, fmi3Float64 out[], size_t room)                                     \
    {                                                                                                       \
        (void)c, (void)unknown, (void)unknowns, (void)known, (void)n, (void)seed, (void)seeds, (void)out,   \
            (void)room;                                                                                     \
        return fmi3Error;                                                                                   \
    }

NO_DERIVATIVE(GetDirectionalDerivative)
NO_DERIVATIVE(GetAdjointDerivative)

ABSENT(fmi3Instance, InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return NULL;
}

ABSENT(fmi3Instance, InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}

ABSENT(fmi3Status, GetBinary)(fmi3Instance c, WHICH, size_t sizes[], fmi3Binary values[], size_t room)
{
    (void)c, (void)r, (void)sizes, (void)values, (void)room;
    return n == 0 ? fmi3OK : fmi3Error;
}

ABSENT(fmi3Status, SetBinary)(fmi3Instance c, WHICH, const size_t sizes[], const fmi3Binary values[], size_t given)
{
    (void)c, (void)r, (void)sizes, (void)values, (void)given;
    return n == 0 ? fmi3OK : fmi3Error;
}

ABSENT(fmi3Status, GetIntervalFraction)(fmi3Instance c, WHICH, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                        fmi3IntervalQualifier qualifiers[])
{
    (void)c, (void)r, (void)counters, (void)resolutions, (void)qualifiers;
    return n == 0 ? fmi3OK : fmi3Error;
}

ABSENT(fmi3Status, GetNumberOfVariableDependencies)(fmi3Instance c, fmi3ValueReference dependent, size_t *n)
{
    (void)c, (void)dependent, (void)n;
    return fmi3Error;
}

ABSENT(fmi3Status, GetVariableDependencies)(fmi3Instance c, fmi3ValueReference dependent, size_t elements[],
                                            fmi3ValueReference independents[], size_t others[],
                                            fmi3DependencyKind kinds[], size_t n)
{
    (void)c, (void)dependent, (void)elements, (void)independents, (void)others, (void)kinds, (void)n;
    return fmi3Error;
}

ABSENT(fmi3Status, UpdateDiscreteStates)(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
                                         fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined,
                                         fmi3Float64 *next)
{
    (void)c, (void)again, (void)terminate, (void)nominals, (void)values, (void)defined, (void)next;
    return fmi3Error;
}

ABSENT(fmi3Status, CompletedIntegratorStep)(fmi3Instance c, fmi3Boolean no_way_back, fmi3Boolean *event,
                                            fmi3Boolean *terminate)
{
    (void)c, (void)no_way_back, (void)event, (void)terminate;
    return fmi3Error;
}

ABSENT(fmi3Status, SetTime)(fmi3Instance c, fmi3Float64 time)
{
    (void)c, (void)time;
    return fmi3Error;
}

ABSENT(fmi3Status, GetOutputDerivatives)(fmi3Instance c, WHICH, const fmi3Int32 orders[], fmi3Float64 values[],
                                         size_t room)
{
    (void)c, (void)r, (void)orders, (void)values, (void)room;
    return n == 0 ? fmi3OK : fmi3Error;
}

ABSENT(fmi3Status, ActivateModelPartition)(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)c, (void)clock, (void)time;
    return fmi3Error;
}
