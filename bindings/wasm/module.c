/* The core for WebAssembly: one module for every model, which comes as a block (dehyst_model_load).
 *
 * JavaScript calls `reserve`, copies the block there and calls `open`, which checks it; then `begin`, and a step a period
 * or whole blocks. An instance has one model. If `open` or `begin` does not return DEHYST_OK, nothing else may be
 * called. */
#include "internal.h"

#define MOST_BYTES (1u << 28)
#define PAGE 65536u
#define BLOCK 4096
#define EXPORT(type, name) __attribute__((export_name(#name))) type wasm_##name

extern unsigned char __heap_base;

static dehyst_model model;
static dehyst_loop *loop;
static dehyst_real *memory;
static dehyst_feedback *sensor;
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

/* Give room for blocks of samples and, in one piece so that it can be saved and put back, for all that changes. */
static dehyst_status place_memory(void)
{
    inputs = reals(BLOCK);
    voltages = reals(BLOCK);
    displacements = reals(BLOCK);
    offers = room(BLOCK);
    state_begin = (unsigned)top;
    loop = room(sizeof *loop);
    memory = reals(dehyst_memory_size(&model));
    sensor = room(sizeof *sensor);
    state_end = (unsigned)top;
    return memory_fits() ? DEHYST_OK : DEHYST_ERR_ROOM;
}

/* Read the block that was copied to the reserved place. The core computes its tables, bit for bit Python's. */
EXPORT(dehyst_status, open)(void)
{
    const unsigned char *block = (const unsigned char *)first_byte();
    unsigned long count;
    dehyst_real *tables;
    dehyst_status status = dehyst_model_room(block, reserved, &count);
    if (status != DEHYST_OK) return status;
    tables = reals(count);
    if (!memory_fits()) return DEHYST_ERR_ROOM;
    status = dehyst_model_load(block, reserved, tables, count, &model);
    return status == DEHYST_OK ? place_memory() : status;
}

/* Return a status in words, which end with a 0. */
EXPORT(const char *, words)(dehyst_status status) { return dehyst_status_text(status); }

/* Replace limits and largest change of a period; `begin` is to follow. */
EXPORT(dehyst_status, limit)(dehyst_real low, dehyst_real high, dehyst_real change)
{
    model.low = low;
    model.high = high;
    model.change = change;
    return dehyst_model_tabulate(&model);
}

/* Begin from the model's own start. */
EXPORT(dehyst_status, begin)(void) { return dehyst_loop_begin(&model, loop, memory); }

EXPORT(dehyst_status, scale)(dehyst_real gain, dehyst_real offset) { return dehyst_loop_scale(loop, gain, offset); }
EXPORT(dehyst_real, gain)(void) { return loop->gain; }
EXPORT(dehyst_real, offset)(void) { return loop->offset; }
/* Begin to feed back a sensor; `correct` returns the correction of a period, `fault` why the sensor is not believed. */
EXPORT(dehyst_status, feedback)(dehyst_real gain, dehyst_real bound, int late)
{
    return dehyst_feedback_begin(&model, loop, memory, gain, bound, late, sensor);
}
EXPORT(dehyst_real, correct)(dehyst_real measured)
{
    return dehyst_feedback_correct(&model, loop, memory, sensor, measured);
}
EXPORT(dehyst_fault, fault)(void) { return sensor->fault; }

EXPORT(dehyst_real, displacement)(void) { return dehyst_loop_displacement(&model, loop, memory); }

/* Return the voltage for u; not a number if u is refused, and then nothing is on offer. */
EXPORT(dehyst_real, offer)(dehyst_real u)
{
    const dehyst_real v = dehyst_loop_offer(&model, loop, memory, u);
    if (loop->offer != DEHYST_REFUSED) return v;
    loop->offer = DEHYST_NOTHING;
    return __builtin_nan("");
}

/* Offer and commit; if u is refused, nothing moves. */
EXPORT(dehyst_real, step)(dehyst_real u)
{
    const dehyst_real v = wasm_offer(u);
    if (v == v) dehyst_loop_commit(&model, loop, memory, v);
    return v;
}

EXPORT(int, accepts)(dehyst_real v) { return dehyst_loop_accepts(&model, v); }
EXPORT(void, commit)(dehyst_real v) { dehyst_loop_commit(&model, loop, memory, v); }

/* Move the actuator by any voltage and return its displacement; not a number if v is not one: nothing moves. */
EXPORT(dehyst_real, play)(dehyst_real v)
{
    if (!is_finite(v)) return __builtin_nan("");
    dehyst_loop_play(&model, loop, memory, v);
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

/* Take n steps. */
EXPORT(void, run)(unsigned n)
{
    unsigned t;
    for (t = 0; t < within_block(n); t++) {
        voltages[t] = dehyst_loop_offer(&model, loop, memory, inputs[t]);
        offers[t] = (unsigned char)(loop->offer - DEHYST_CANDIDATE);
        dehyst_loop_commit(&model, loop, memory, voltages[t]);
        displacements[t] = wasm_displacement();
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
