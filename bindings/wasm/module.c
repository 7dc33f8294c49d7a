/* The core for WebAssembly: one module for every model, the sizes come with the numbers.
 *
 * JavaScript calls `reserve`, copies a model's numbers there and calls `open`, which checks sizes and numbers; then
 * `begin`, and a step a period or whole blocks. An instance has one model. If `open` or `begin` does not return
 * DEHYST_OK, nothing else may be called.
 *
 * The numbers, little-endian: ten unsigned (version, N, K, M, B, J, L, taps, inertia, 0), then doubles: rho and kappa
 * [N]; knot and value [K]; with grades knot [M + 1] and slope [N M]; voltage and drive of tau [B]; stiffness, decay and
 * gain of creep [J]; length, back and stiffness of smooth elements [L]; taps; with inertia beta, theta and the
 * transition [8]; low, high, change, lag, keep, from_old, from_new; the start: w, y, y'/omega, carts [N], strains [J],
 * elongations [L]. */
#include "internal.h"

#define VERSION 1
#define HEADER 10
#define MOST_BYTES (1u << 28)
#define PAGE 65536u
#define BLOCK 4096
#define EXPORT(type, name) __attribute__((export_name(#name))) type wasm_##name

extern unsigned char __heap_base;

static dehyst_compensator model;
static dehyst_loop *loop;
static const dehyst_real *begin_place, *begin_cart, *begin_strain, *begin_elongation, *grade_slope;
static dehyst_real *inputs, *voltages, *displacements;
static unsigned char *offers;
static unsigned reserved, state_begin, state_end;
static unsigned long long top;

static unsigned first_byte(void) { return ((unsigned)&__heap_base + 7) / 8 * 8; }

/* Give `bytes` of room; nothing is written there before memory_fits. */
static void *room(unsigned long long bytes)
{
    void *at = (void *)(unsigned)top;
    top += (bytes + 7) / 8 * 8;
    return at;
}

static dehyst_real *reals(unsigned long long n) { return room(8 * n); }

static int memory_fits(void)
{
    const unsigned long long pages = (top + PAGE - 1) / PAGE, present = __builtin_wasm_memory_size(0);
    if (top > 7ull * MOST_BYTES) return 0;
    return pages <= present || __builtin_wasm_memory_grow(0, (unsigned)(pages - present)) != (unsigned)-1;
}

/* Return where to put a model of so many bytes; 0: there is no room. */
EXPORT(unsigned char *, reserve)(unsigned bytes)
{
    unsigned char *at;
    top = first_byte();
    reserved = 0;
    if (bytes > MOST_BYTES) return NULL;
    at = room(bytes);
    if (!memory_fits()) return NULL;
    reserved = bytes;
    return at;
}

/* Return whether the sizes are those of a model that fills the reserved bytes, all of it numbers. */
static dehyst_status check_numbers(const unsigned *size)
{
    const dehyst_real *x;
    unsigned long long n, k, m, b, j, l, t, count;
    int i;
    if (reserved < 4 * HEADER || size[0] != VERSION || size[8] > 1) return DEHYST_ERR_SIZE;
    for (i = 1; i < HEADER; i++)
        if (size[i] > MOST_BYTES / 8) return DEHYST_ERR_SIZE;
    n = size[1], k = size[2], m = size[3], b = size[4], j = size[5], l = size[6], t = size[7];
    count = 3 * n + 2 * k + (m > 0 ? m + 1 : 0) + n * m + 2 * b + 4 * j + 4 * l + t + (size[8] ? 10 : 0) + 10;
    if (k < 2 || b == 1 || t < 1 || 8 * count + 4 * HEADER != reserved) return DEHYST_ERR_SIZE;
    for (x = (const dehyst_real *)(size + HEADER); count > 0; x++, count--)
        if (!is_finite(*x)) return DEHYST_ERR_FINITE;
    return DEHYST_OK;
}

static const dehyst_real *next(const dehyst_real **from, unsigned n)
{
    const dehyst_real *at = *from;
    *from += n;
    return at;
}

static void curve_from(dehyst_curve *curve, unsigned size, const dehyst_real *knot, const dehyst_real *value)
{
    curve->size = (int)size;
    curve->knot = knot;
    curve->value = value;
    curve->slope = reals(size);
}

/* Point into the numbers of the elements and the springs, and give room for their tables. */
static const dehyst_real *place_elements(dehyst_actuator *a, const unsigned *size, const dehyst_real *at)
{
    const unsigned n = size[1], m = size[3];
    const unsigned long long rows = m > 0 ? n + 1ull : 0;
    const dehyst_real *x;
    a->plain.slip.size = (int)n;
    a->plain.slip.rho = next(&at, n);
    a->plain.slip.kappa = next(&at, n);
    a->plain.slip.edge = reals(n + 1ull);
    a->plain.slip.intercept = reals(n + 1ull);
    a->plain.slip.stiffness = reals(n + 1ull);
    x = next(&at, size[2]);
    curve_from(&a->plain.spring, size[2], x, next(&at, size[2]));
    a->grades.size = (int)m;
    a->grades.knot = next(&at, m > 0 ? m + 1 : 0);
    a->grades.value = reals(rows * (m + 1ull));
    a->grades.slope = reals(rows * m);
    grade_slope = next(&at, n * m);
    x = next(&at, size[4]);
    curve_from(&a->transformer, size[4], x, next(&at, size[4]));
    curve_from(&a->inverse_transformer, size[4], a->transformer.value, x);
    return at;
}

/* Point into the numbers of creep, smooth elements, taps and a mass. */
static const dehyst_real *place_motion(dehyst_actuator *a, const unsigned *size, const dehyst_real *at)
{
    dehyst_transition *to = &model.step.transition;
    int i;
    a->branches = (int)size[5];
    a->creep_stiffness = next(&at, size[5]);
    model.step.decay = next(&at, size[5]);
    model.step.gain = next(&at, size[5]);
    a->smooth.size = (int)size[6];
    a->smooth.length = next(&at, size[6]);
    a->smooth.back = next(&at, size[6]);
    a->smooth.stiffness = next(&at, size[6]);
    model.taps = (int)size[7];
    model.tap = next(&at, size[7]);
    a->inertia = (int)size[8];
    if (!a->inertia) return at;
    a->series = *at++;
    a->share = *at++;
    for (i = 0; i < 4; i++) to->phi[i] = *at++;
    for (i = 0; i < 2; i++) to->before[i] = *at++;
    for (i = 0; i < 2; i++) to->after[i] = *at++;
    return at;
}

static void place_loop(const unsigned *size, const dehyst_real *at)
{
    model.low = *at++;
    model.high = *at++;
    model.change = *at++;
    model.lag = *at++;
    model.keep = *at++;
    model.from_old = *at++;
    model.from_new = *at++;
    begin_place = next(&at, 3);
    begin_cart = next(&at, size[1]);
    begin_strain = next(&at, size[5]);
    begin_elongation = next(&at, size[6]);
}

/* Give room for blocks of samples and, in one piece so that it can be saved and put back, for all that changes. */
static dehyst_status place_memory(const unsigned *size)
{
    const unsigned long long n = size[1], j = size[5], l = size[6];
    dehyst_real *x;
    inputs = reals(BLOCK);
    voltages = reals(BLOCK);
    displacements = reals(BLOCK);
    offers = room(BLOCK);
    state_begin = (unsigned)top;
    loop = room(sizeof *loop);
    x = reals(2 * n + j + l + size[7]);
    state_end = (unsigned)top;
    if (!memory_fits()) return DEHYST_ERR_SIZE;
    loop->state.memory.cart = x;
    loop->candidate.cart = x + n;
    loop->state.strain = x + 2 * n;
    loop->state.elongation = x + 2 * n + j;
    loop->inputs = x + 2 * n + j + l;
    return DEHYST_OK;
}

static dehyst_status tabulate_curve(dehyst_curve *curve)
{
    if (curve->size == 0) return DEHYST_OK;
    return dehyst_curve_tabulate(curve->size, curve->knot, curve->value, (dehyst_real *)curve->slope);
}

static dehyst_status tabulate_grades(int n, dehyst_grades *grades)
{
    dehyst_real *slope = (dehyst_real *)grades->slope;
    long i;
    if (grades->size == 0) return DEHYST_OK;
    for (i = 0; i < (long)n * grades->size; i++) slope[i] = grade_slope[i];
    return dehyst_grades_tabulate(n, grades->size, grades->knot, slope, (dehyst_real *)grades->value);
}

/* Check what no function of the core checks: numbers of which Python has made other ones. */
static dehyst_status check_motion(const dehyst_actuator *a)
{
    int i;
    for (i = 0; i < a->branches; i++)
        if (model.step.decay[i] < 0 || model.step.decay[i] > 1 || model.step.gain[i] < 0) return DEHYST_ERR_SIGN;
    for (i = 0; i < a->smooth.size; i++) {
        const dehyst_real share = a->smooth.back[i] * a->smooth.length[i];
        if (!(a->smooth.length[i] > 0) || !(share >= 0 && share <= 1 + 8 * DEHYST_EPSILON)) return DEHYST_ERR_SIGN;
    }
    return DEHYST_OK;
}

/* Read the model that was copied to the reserved place. The core computes its tables, bit for bit Python's. */
EXPORT(dehyst_status, open)(void)
{
    const unsigned *size = (const unsigned *)first_byte();
    dehyst_actuator *a = &model.actuator;
    dehyst_slip *slip = &a->plain.slip;
    dehyst_status status = check_numbers(size);
    if (status != DEHYST_OK) return status;
    place_loop(size, place_motion(a, size, place_elements(a, size, (const dehyst_real *)(size + HEADER))));
    if ((status = place_memory(size)) != DEHYST_OK) return status;
    status = dehyst_slip_tabulate(slip->size, slip->rho, slip->kappa, (dehyst_real *)slip->edge,
                                  (dehyst_real *)slip->intercept, (dehyst_real *)slip->stiffness, &slip->inverse_step);
    if (status == DEHYST_OK) status = tabulate_curve(&a->plain.spring);
    if (status == DEHYST_OK) status = tabulate_grades(slip->size, &a->grades);
    if (status == DEHYST_OK) status = tabulate_curve(&a->transformer);
    if (status == DEHYST_OK) status = tabulate_curve(&a->inverse_transformer);
    if (status == DEHYST_OK) status = check_motion(a);
    return status == DEHYST_OK ? dehyst_compensator_tabulate(&model) : status;
}

/* Replace limits and largest change of a period; `begin` is to follow. */
EXPORT(dehyst_status, limit)(dehyst_real low, dehyst_real high, dehyst_real change)
{
    model.low = low;
    model.high = high;
    model.change = change;
    return dehyst_compensator_tabulate(&model);
}

/* Begin from the model's own start. */
EXPORT(dehyst_status, begin)(void)
{
    const dehyst_actuator *a = &model.actuator;
    dehyst_state *state = &loop->state;
    int i;
    for (i = 0; i < a->plain.slip.size; i++) state->memory.cart[i] = loop->candidate.cart[i] = begin_cart[i];
    for (i = 0; i < a->branches; i++) state->strain[i] = begin_strain[i];
    for (i = 0; i < a->smooth.size; i++) state->elongation[i] = begin_elongation[i];
    state->memory.y = begin_place[0];
    state->y = begin_place[1];
    state->rate = begin_place[2];
    state->input = 0;
    return dehyst_loop_begin(&model, loop);
}

EXPORT(dehyst_real, displacement)(void)
{
    return model.actuator.inertia ? loop->state.y : loop->state.memory.y;
}

/* Return the voltage for u; not a number if u is refused, and then nothing is on offer. */
EXPORT(dehyst_real, offer)(dehyst_real u)
{
    const dehyst_real v = dehyst_loop_offer(&model, loop, u);
    if (loop->offer != DEHYST_REFUSED) return v;
    loop->offer = DEHYST_NOTHING;
    return __builtin_nan("");
}

/* Offer and commit; if u is refused, nothing moves. */
EXPORT(dehyst_real, step)(dehyst_real u)
{
    const dehyst_real v = wasm_offer(u);
    if (v == v) dehyst_loop_commit(&model, loop, v);
    return v;
}

EXPORT(int, accepts)(dehyst_real v) { return dehyst_loop_accepts(&model, v); }
EXPORT(void, commit)(dehyst_real v) { dehyst_loop_commit(&model, loop, v); }

/* Move the actuator by any voltage and return its displacement; not a number if v is not one: nothing moves. */
EXPORT(dehyst_real, play)(dehyst_real v)
{
    if (!is_finite(v)) return __builtin_nan("");
    dehyst_loop_play(&model, loop, v);
    return wasm_displacement();
}

EXPORT(dehyst_real, sent)(void) { return loop->sent; }
EXPORT(unsigned long, limited)(void) { return loop->limited; }
EXPORT(unsigned long, slewed)(void) { return loop->slewed; }
EXPORT(unsigned long, refused)(void) { return loop->refused; }

/* Where inputs [block] are given, and voltages, displacements [block] and offers [block bytes] are found; an offer is
 * 0 as wanted, 1 limited, 2 slewed, 3 refused. */
EXPORT(unsigned, block)(void) { return BLOCK; }
EXPORT(dehyst_real *, inputs)(void) { return inputs; }
EXPORT(dehyst_real *, voltages)(void) { return voltages; }
EXPORT(dehyst_real *, displacements)(void) { return displacements; }
EXPORT(unsigned char *, offers)(void) { return offers; }
/* All that changes: copy these bytes to save it, and back. */
EXPORT(unsigned, state_begin)(void) { return state_begin; }
EXPORT(unsigned, state_end)(void) { return state_end; }

static unsigned within_block(unsigned n) { return n < BLOCK ? n : BLOCK; }

/* Take n steps; with `jump` the first voltage may differ from the last one by any amount. */
EXPORT(void, run)(unsigned n, int jump)
{
    const dehyst_real change = model.change;
    unsigned t;
    if (jump && n > 0) model.change = DEHYST_LARGEST;
    for (t = 0; t < within_block(n); t++) {
        voltages[t] = dehyst_loop_offer(&model, loop, inputs[t]);
        offers[t] = (unsigned char)(loop->offer - DEHYST_CANDIDATE);
        dehyst_loop_commit(&model, loop, voltages[t]);
        displacements[t] = wasm_displacement();
        model.change = change;
    }
}

/* Play n voltages on the actuator, without limits; one that is not a number is refused. */
EXPORT(void, simulate)(unsigned n)
{
    unsigned t;
    for (t = 0; t < within_block(n); t++) {
        displacements[t] = wasm_play(inputs[t]);
        loop->refused += !is_finite(inputs[t]);
    }
}
