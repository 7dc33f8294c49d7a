#include "fmu.h"

#include <float.h>
#include <stdio.h>
#include <string.h>

/* snprintf may write nan, inf and numbers, none of them with a % sign. */
#define REFUSE(f, ...) (snprintf((f)->message, sizeof(f)->message, __VA_ARGS__), 0)

/* The compensator's output keeps to its limits even before the first step. */
static double within(double v)
{
    if (FMU_ACTUATOR) return v;
    return v < MODEL_LOW ? MODEL_LOW : v > MODEL_HIGH ? MODEL_HIGH : v;
}

int fmu_begin(fmu *f)
{
    const dehyst_status status = piezo_begin(&f->piezo);
    const dehyst_loop *loop = &f->piezo.loop;
    const double y = piezo_displacement(&f->piezo), v = within(loop->sent);
    f->phase = FMU_MADE;
    f->time = 0;
    f->reported = 0;
    f->message[0] = 0;
    f->input = FMU_ACTUATOR ? v : y;
    f->output = FMU_ACTUATOR ? y : v;
    return status == DEHYST_OK ? 1 : REFUSE(f, "the model's numbers are refused (%d): export it again", (int)status);
}

int fmu_demand(fmu *f, int holds, const char *why) { return holds ? 1 : REFUSE(f, "%s", why); }

int fmu_matches(fmu *f, const char *token)
{
    return fmu_demand(f, token != NULL && strcmp(token, FMU_TOKEN) == 0,
                      "Instantiate: the token is not this model's; the description is of another FMU");
}

int fmu_enter(fmu *f, fmu_phase from, fmu_phase to, const char *function)
{
    if (f->phase != from) return REFUSE(f, "%s: not allowed now", function);
    f->phase = to;
    return 1;
}

int fmu_set(fmu *f, uint32_t reference, double value)
{
    if (reference != FMU_INPUT) return REFUSE(f, "variable %u: it is no input of real numbers", (unsigned)reference);
    if (!fmu_finite(value))
        return REFUSE(f, "%s: got %g, need a finite number of %s; the last one stays", FMU_INPUT_NAME, value,
                      FMU_ACTUATOR ? "volts" : "metres");
    f->input = value;
    return 1;
}

int fmu_get(fmu *f, uint32_t reference, double *value)
{
    if (reference == FMU_TIME)
        *value = f->time;
    else if (reference == FMU_INPUT)
        *value = f->input;
    else if (reference == FMU_OUTPUT)
        *value = f->output;
    else
        return REFUSE(f, "variable %u: it is no real number", (unsigned)reference);
    return 1;
}

int fmu_count(fmu *f, uint32_t reference, uint64_t *value)
{
    if (FMU_ACTUATOR || (reference != FMU_LIMITED && reference != FMU_SLEWED))
        return REFUSE(f, "variable %u: it is no whole number", (unsigned)reference);
    *value = reference == FMU_LIMITED ? f->piezo.loop.limited : f->piezo.loop.slewed;
    return 1;
}

/* Whether two times are one: steps are differences of times, each rounded. */
static int alike(double a, double b, double from, double by)
{
    const double off = a < b ? b - a : a - b;
    return off <= 1e-9 * by + 4 * DBL_EPSILON * (from < 0 ? -from : from);
}

/* The periods in a step, or 0. */
static uint32_t periods(double from, double by)
{
    const double ratio = MODEL_PERIOD > 0 ? by / MODEL_PERIOD : 1;
    uint32_t n;
    if (!fmu_finite(from) || !(by > 0) || !(ratio < 1e9)) return 0;
    if (!(MODEL_PERIOD > 0)) return 1;
    n = (uint32_t)(ratio + 0.5);
    return alike(by, n * MODEL_PERIOD, from, by) ? n : 0;
}

static int sample(fmu *f)
{
    piezo *p = &f->piezo;
#if FMU_ACTUATOR
    const unsigned long refused = p->loop.refused;
    f->output = piezo_simulate(p, f->input);
    if (p->loop.refused == refused && fmu_finite(f->output)) return 1;
#else
    f->output = piezo_offer(p, f->input);
    if (p->loop.offer != DEHYST_REFUSED) {
        piezo_commit(p, f->output);
        return 1;
    }
#endif
    return REFUSE(f, "%s: got %g, more than the model can follow", FMU_INPUT_NAME, f->input);
}

int fmu_step(fmu *f, double from, double by)
{
    uint32_t n = periods(from, by);
    const piezo before = f->piezo;
    const double output = f->output;
    if (f->phase != FMU_RUNNING) return REFUSE(f, "DoStep: not allowed now; end the initialization first");
    if (n == 0) {
        if (MODEL_PERIOD > 0)
            return REFUSE(f, "communication step: got %.17g s at %.17g s, need a whole multiple of %.17g s", by, from,
                          MODEL_PERIOD);
        return REFUSE(f, "communication step: got %.17g s at %.17g s, need a positive number", by, from);
    }
    if (!alike(from, f->time, from, by))
        return REFUSE(f, "communication point: got %.17g s, need %.17g s, where the last step ended", from, f->time);
    while (n-- > 0)
        if (!sample(f)) {
            f->piezo = before;
            f->output = output;
            return 0;
        }
    f->time = from + by;
    return 1;
}

int fmu_clamped(fmu *f)
{
    const dehyst_loop *loop = &f->piezo.loop;
    const int now = (loop->limited > 0) + 2 * (loop->slewed > 0), news = now & ~f->reported;
    f->reported |= now;
    if (FMU_ACTUATOR || !news) return 0;
    (void)REFUSE(f, "CLAMPED: %.6g um wanted, %.6g V sent: %s", f->input * 1e6, f->output,
                 news & 1 ? "that is a limit" : "the slew rate allows no more");
    return 1;
}

void fmu_save(const fmu *f, fmu_memory *memory)
{
    memset(memory, 0, sizeof *memory);
    memcpy(memory->token, FMU_TOKEN, sizeof FMU_TOKEN);
    memory->number[FMU_GIVEN] = f->input;
    memory->number[FMU_SHOWN] = f->output;
    memory->number[FMU_NOW] = f->time;
    memory->state = (uint64_t)f->phase * 4 + (uint64_t)f->reported;
    piezo_save(&f->piezo, memory->loop);
}

/* Nothing is ever on offer between two steps. */
int fmu_restore(fmu *f, const fmu_memory *memory)
{
    if (piezo_restore(&f->piezo, memory->loop) != DEHYST_OK) return fmu_demand(f, 0, "state: it is damaged");
    f->input = memory->number[FMU_GIVEN];
    f->output = memory->number[FMU_SHOWN];
    f->time = memory->number[FMU_NOW];
    f->phase = (fmu_phase)(memory->state / 4);
    f->reported = (int)(memory->state % 4);
    return 1;
}

/* FNV-1a of 64 bits, over all behind `check`. */
static uint64_t checksum(const fmu_memory *memory)
{
    const unsigned char *at = (const unsigned char *)&memory->state, *end = (const unsigned char *)(memory + 1);
    uint64_t sum = 14695981039346656037u;
    while (at < end) sum = (sum ^ *at++) * 1099511628211u;
    return sum;
}

/* What no FMU of this model has written, though its checksum may fit. */
static const char *flaw(const fmu_memory *memory)
{
    piezo found;
    int i;
    for (i = 0; i < FMU_NUMBERS; i++)
        if (!fmu_finite(memory->number[i])) return "state: a number of it is not finite";
    if (memory->state / 4 > FMU_ENDED) return "state: it is in no phase of an FMU's life";
    if (piezo_restore(&found, memory->loop) != DEHYST_OK) return "state: the actuator cannot be in it";
    if (within(found.loop.sent) != found.loop.sent || (!FMU_ACTUATOR && within(memory->number[FMU_SHOWN]) != memory->number[FMU_SHOWN]))
        return "state: its voltage lies outside the limits";
    return NULL;
}

void fmu_serialize(const fmu_memory *memory, void *bytes)
{
    fmu_memory sealed = *memory;
    sealed.check = checksum(&sealed);
    memcpy(bytes, &sealed, sizeof sealed);
}

int fmu_deserialize(fmu *f, const void *bytes, size_t size, fmu_memory *memory)
{
    const char *why;
    if (bytes == NULL || size != sizeof *memory || memcmp(bytes, FMU_TOKEN, sizeof FMU_TOKEN) != 0)
        return fmu_demand(f, 0, "state: it is of another model");
    memcpy(memory, bytes, sizeof *memory);
    if (memory->check != checksum(memory))
        return fmu_demand(f, 0, "state: its checksum does not fit; it is not what was serialized");
    why = flaw(memory);
    return fmu_demand(f, why == NULL, why);
}
