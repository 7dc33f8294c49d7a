#include "fmu.h"
#include "fmu_block.h"

#include <float.h>
#include <stdio.h>
#include <string.h>

/* snprintf writes nan, inf or numbers here; none has a % sign. */
#define REFUSE(f, ...) (snprintf((f)->message, sizeof(f)->message, __VA_ARGS__), 0)

/* The output of the compensator is within the limits even before the first step. */
static double within(const fmu *f, double v)
{
    if (FMU_ACTUATOR) return v;
    return v < f->model.low ? f->model.low : v > f->model.high ? f->model.high : v;
}

static double displacement(const fmu *f) { return dehyst_loop_displacement(&f->model, &f->now.loop, f->now.memory); }

int fmu_begin(fmu *f)
{
    dehyst_status status = dehyst_model_load(fmu_block, sizeof fmu_block, f->numbers, FMU_ROOM, &f->model);
    double y, v;
    if (status == DEHYST_OK) status = dehyst_loop_begin(&f->model, &f->now.loop, f->now.memory);
    if (status != DEHYST_OK) return REFUSE(f, "the model's numbers are refused (%d): export it again", (int)status);
    y = displacement(f);
    v = within(f, f->now.loop.sent);
    f->phase = FMU_MADE;
    f->time = 0;
    f->reported = 0;
    f->message[0] = 0;
    f->input = FMU_ACTUATOR ? v : y;
    f->output = FMU_ACTUATOR ? y : v;
    return 1;
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

static int scale(fmu *f, double gain, double offset)
{
    if (dehyst_loop_scale(&f->now.loop, gain, offset) == DEHYST_OK) return 1;
    return REFUSE(f, "gain and offset: got %g and %g m, need a positive and a finite number; the last ones stay", gain,
                  offset);
}

int fmu_set(fmu *f, uint32_t reference, double value)
{
    if (reference == FMU_GAIN) return scale(f, value, f->now.loop.offset);
    if (reference == FMU_OFFSET) return scale(f, f->now.loop.gain, value);
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
    else if (reference == FMU_GAIN)
        *value = f->now.loop.gain;
    else if (reference == FMU_OFFSET)
        *value = f->now.loop.offset;
    else
        return REFUSE(f, "variable %u: it is no real number", (unsigned)reference);
    return 1;
}

int fmu_count(fmu *f, uint32_t reference, uint64_t *value)
{
    if (FMU_ACTUATOR || (reference != FMU_LIMITED && reference != FMU_SLEWED))
        return REFUSE(f, "variable %u: it is no whole number", (unsigned)reference);
    *value = reference == FMU_LIMITED ? f->now.loop.limited : f->now.loop.slewed;
    return 1;
}

/* Whether two times are equal up to rounding: steps are differences of rounded times. */
static int alike(double a, double b, double from, double by)
{
    const double off = a < b ? b - a : a - b;
    return off <= 1e-9 * by + 4 * DBL_EPSILON * (from < 0 ? -from : from);
}

/* The periods in a step, or 0. */
static uint32_t periods(double period, double from, double by)
{
    const double ratio = period > 0 ? by / period : 1;
    uint32_t n;
    if (!fmu_finite(from) || !(by > 0) || !(ratio < 1e9)) return 0;
    if (!(period > 0)) return 1;
    n = (uint32_t)(ratio + 0.5);
    return alike(by, n * period, from, by) ? n : 0;
}

static int sample(fmu *f)
{
    const dehyst_model *model = &f->model;
    dehyst_loop *loop = &f->now.loop;
#if FMU_ACTUATOR
    const unsigned long refused = loop->refused;
    dehyst_loop_play(model, loop, f->now.memory, f->input);
    f->output = displacement(f);
    if (loop->refused == refused && fmu_finite(f->output)) return 1;
#else
    f->output = dehyst_loop_offer(model, loop, f->now.memory, f->input);
    if (loop->offer != DEHYST_REFUSED) {
        dehyst_loop_commit(model, loop, f->now.memory, f->output);
        return 1;
    }
#endif
    return REFUSE(f, "%s: got %g, more than the model can follow", FMU_INPUT_NAME, f->input);
}

int fmu_step(fmu *f, double from, double by)
{
    const double period = f->model.period, output = f->output;
    uint32_t n = periods(period, from, by);
    const fmu_loop before = f->now;
    if (f->phase != FMU_RUNNING) return REFUSE(f, "DoStep: not allowed now; end the initialization first");
    if (n == 0) {
        if (period > 0)
            return REFUSE(f, "communication step: got %.17g s at %.17g s, need a whole multiple of %.17g s", by, from,
                          period);
        return REFUSE(f, "communication step: got %.17g s at %.17g s, need a positive number", by, from);
    }
    if (!alike(from, f->time, from, by))
        return REFUSE(f, "communication point: got %.17g s, need %.17g s, where the last step ended", from, f->time);
    while (n-- > 0)
        if (!sample(f)) {
            f->now = before;
            f->output = output;
            return 0;
        }
    f->time = from + by;
    return 1;
}

int fmu_clamped(fmu *f)
{
    const dehyst_loop *loop = &f->now.loop;
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
    dehyst_loop_save(&f->model, &f->now.loop, f->now.memory, memory->loop, FMU_SNAPSHOT);
}

/* No offer is open between two steps. */
int fmu_restore(fmu *f, const fmu_memory *memory)
{
    if (dehyst_loop_restore(&f->model, &f->now.loop, f->now.memory, memory->loop, FMU_SNAPSHOT) != DEHYST_OK)
        return fmu_demand(f, 0, "state: it is damaged");
    f->input = memory->number[FMU_GIVEN];
    f->output = memory->number[FMU_SHOWN];
    f->time = memory->number[FMU_NOW];
    f->phase = (fmu_phase)(memory->state / 4);
    f->reported = (int)(memory->state % 4);
    return 1;
}

/* FNV-1a of 64 bits, over all bytes after `check`. */
static uint64_t checksum(const fmu_memory *memory)
{
    const unsigned char *at = (const unsigned char *)&memory->state, *end = (const unsigned char *)(memory + 1);
    uint64_t sum = 14695981039346656037u;
    while (at < end) sum = (sum ^ *at++) * 1099511628211u;
    return sum;
}

/* Return why no FMU of this model can have written this memory, although its checksum is right; else NULL. */
static const char *flaw(const fmu *f, const fmu_memory *memory)
{
    const double shown = memory->number[FMU_SHOWN];
    fmu_loop found;
    int i;
    for (i = 0; i < FMU_NUMBERS; i++)
        if (!fmu_finite(memory->number[i])) return "state: a number of it is not finite";
    if (memory->state / 4 > FMU_ENDED) return "state: it is in no phase of an FMU's life";
    if (dehyst_loop_restore(&f->model, &found.loop, found.memory, memory->loop, FMU_SNAPSHOT) != DEHYST_OK)
        return "state: the actuator cannot be in it";
    if (within(f, found.loop.sent) != found.loop.sent || (!FMU_ACTUATOR && within(f, shown) != shown))
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
    why = flaw(f, memory);
    return fmu_demand(f, why == NULL, why);
}
