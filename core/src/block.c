/* A model and the memory of a loop as blocks of bytes: little-endian, with IEEE doubles, on every processor.
 *
 * A model: a header of sixteen unsigned of 32 bits - "DHYM", format, bytes, CRC-32 of the bytes after it, N, knots
 * of the spring, grades, knots of tau, zero, L, taps, inertia (0 or 1), ahead, K and two zeros - and the numbers that
 * walk_model names, in its order. Letters are those of dehyst_model.h.
 *
 * A snapshot: ten unsigned - "DHYS", format, bytes, CRC-32, shape and id of the model, samples limited, slewed,
 * refused, zero - and w, y, rate, input, sent, acting, intended [2], gain, offset, driven, carts [N],
 * elongations [L], strains behind the elements [K], wanted displacements [taps]. */
#include "internal.h"

#include <stdint.h>

#define KIND_OF_MODEL 0x4D594844u
#define KIND_OF_SNAPSHOT 0x53594844u
#define HEADER_OF_MODEL 64
#define HEADER_OF_SNAPSHOT 40
#define SCALARS 11
/* Largest allowed size, so that products and sums of sizes do not overflow. */
#define LARGEST_SIZE (1u << 24)

enum { ELEMENTS, KNOTS, GRADES, BENDS, ZERO, SMOOTH, TAPS, INERTIA, AHEAD, OUTPUT, SIZES };

static uint32_t crc32(uint32_t sum, const unsigned char *bytes, unsigned long size)
{
    int bit;
    for (sum = ~sum; size > 0; size--) {
        sum ^= *bytes++;
        for (bit = 0; bit < 8; bit++) { sum = (sum >> 1) ^ ((sum & 1) ? 0xEDB88320u : 0); }
    }
    return ~sum;
}

static uint32_t word_at(const unsigned char *bytes)
{ return bytes[0] | ((uint32_t)bytes[1] << 8) | ((uint32_t)bytes[2] << 16) | ((uint32_t)bytes[3] << 24); }

static void put_word(unsigned char *bytes, uint32_t word)
{
    int i;
    for (i = 0; i < 4; i++) { bytes[i] = (unsigned char)(word >> (8 * i)); }
}

/* Round the bits of a double to the bits of a float, to nearest, ties to even; too large numbers become infinite. */
static uint32_t single_of(uint64_t bits)
{
    const uint32_t sign = (uint32_t)(bits >> 32) & 0x80000000u;
    const int exponent = (int)((bits >> 52) & 0x7FF) - 1023 + 127;
    uint64_t mantissa = bits & 0xFFFFFFFFFFFFFu, half, rest;
    int shift = 29;
    if (exponent >= 255) { return sign | 0x7F800000u | ((bits & 0x7FFFFFFFFFFFFFFFu) > 0x7FF0000000000000u); }
    if (exponent > 0) {
        mantissa |= (uint64_t)exponent << 52;
    } else {
        if (exponent < -24) { return sign; }
        mantissa |= (uint64_t)1 << 52;
        shift += 1 - exponent;
    }
    half = (uint64_t)1 << (shift - 1);
    rest = mantissa & ((2 * half) - 1);
    mantissa >>= shift;
    if ((rest > half) || ((rest == half) && (mantissa & 1))) { mantissa++; }
    return sign | (uint32_t)mantissa;
}

/* Return the bits of a double that is equal to a finite float. */
static uint64_t double_of(uint32_t bits)
{
    const uint64_t sign = (uint64_t)(bits & 0x80000000u) << 32;
    int exponent = (int)((bits >> 23) & 0xFF);
    uint64_t mantissa = bits & 0x7FFFFFu;
    if ((exponent == 0) && (mantissa == 0)) { return sign; }
    if (exponent == 0) {
        for (exponent = 1; !(mantissa & 0x800000u); exponent--) { mantissa <<= 1; }
    }
    return sign | ((uint64_t)(exponent - 127 + 1023) << 52) | ((mantissa & 0x7FFFFFu) << 29);
}

/* A number and its bits. A float uses the first four bytes, so that a conversion needs no arithmetic of doubles. */
typedef union number {
    dehyst_real value;
    uint64_t wide;
    uint32_t narrow;
} number;

/* Code for the largest number of either type. */
#define LARGEST_BITS 0x7FEFFFFFFFFFFFFFu

static uint64_t bits_at(const unsigned char *bytes) { return word_at(bytes) | ((uint64_t)word_at(bytes + 4) << 32); }

static dehyst_real real_at(const unsigned char *bytes)
{
    const uint64_t bits = bits_at(bytes);
    number x;
    if (bits == LARGEST_BITS) { return DEHYST_LARGEST; }
    if (DEHYST_SINGLE) {
        x.narrow = single_of(bits);
    } else {
        x.wide = bits;
    }
    return x.value;
}

static void put_real(unsigned char *bytes, dehyst_real value)
{
    uint64_t bits;
    number x;
    x.value = value;
    bits = DEHYST_SINGLE ? double_of(x.narrow) : x.wide;
    if (value == DEHYST_LARGEST) { bits = LARGEST_BITS; }
    put_word(bytes, (uint32_t)bits);
    put_word(bytes + 4, (uint32_t)(bits >> 32));
}

/* Check kind, format, length and checksum; a header is at least HEADER_OF_SNAPSHOT long. */
static dehyst_status check_frame(const unsigned char *bytes, unsigned long size, uint32_t kind, uint32_t format,
                                 unsigned long header)
{
    if ((bytes == NULL) || (size < 8)) { return DEHYST_ERR_LENGTH; }
    if (word_at(bytes) != kind) { return DEHYST_ERR_KIND; }
    if (word_at(bytes + 4) != format) { return DEHYST_ERR_FORMAT; }
    if ((size < header) || (word_at(bytes + 8) != size)) { return DEHYST_ERR_LENGTH; }
    return (word_at(bytes + 12) == crc32(0, bytes + 16, size - 16)) ? DEHYST_OK : DEHYST_ERR_CHECKSUM;
}

static void put_frame(unsigned char *bytes, uint32_t kind, uint32_t format, unsigned long size)
{
    put_word(bytes, kind);
    put_word(bytes + 4, format);
    put_word(bytes + 8, (uint32_t)size);
    put_word(bytes + 12, crc32(0, bytes + 16, size - 16));
}

/* A place in the numbers of a block, which is read to `room` or written. */
typedef struct cursor {
    const unsigned char *from; /* NULL: the block is written */
    unsigned char *to;
    dehyst_real *room;
    dehyst_status status;
    uint32_t shape;
} cursor;

static void one(cursor *c, dehyst_real *x)
{
    if (c->from == NULL) {
        put_real(c->to, *x);
        c->to += 8;
        return;
    }
    *x = real_at(c->from);
    c->from += 8;
    if (!is_finite(*x)) { c->status = DEHYST_ERR_FINITE; }
}

/* The same for a bound that rounding must not move outward. */
static void bound(cursor *c, dehyst_real *x, int upper)
{
    const uint64_t exact = (c->from != NULL) ? bits_at(c->from) : 0, size = ~((uint64_t)1 << 63);
    number near;
    one(c, x);
    if (!DEHYST_SINGLE || (c->from == NULL) || (exact == LARGEST_BITS) || !is_finite(*x)) { return; }
    near.value = *x;
    {
        const uint64_t rounded = double_of(near.narrow);
        const int away = (rounded & size) > (exact & size), negative = (int)(exact >> 63);
        if ((rounded == exact) || (away != (upper != negative))) { return; }
        near.narrow += away ? -1u : 1u;
        *x = near.value;
    }
}

static void some(cursor *c, const dehyst_real **x, unsigned long n)
{
    dehyst_real *at = c->room;
    if (c->from == NULL) {
        dehyst_real value;
        const dehyst_real *source = *x;
        for (; n > 0; n--) {
            value = *source++;
            one(c, &value);
        }
        return;
    }
    *x = at;
    c->room += n;
    for (; n > 0; n--) { one(c, at++); }
}

/* The same for numbers on which the memory of a loop depends. */
static void shaping(cursor *c, const dehyst_real **x, unsigned long n)
{
    const unsigned char *first = (c->from != NULL) ? c->from : c->to;
    some(c, x, n);
    c->shape = crc32(c->shape, first, 8 * n);
}

static void walk_elements(cursor *c, dehyst_actuator *a, const uint32_t *size)
{
    shaping(c, &a->plain.slip.rho, size[ELEMENTS]);
    some(c, &a->plain.slip.kappa, size[ELEMENTS]);
    some(c, &a->plain.spring.knot, size[KNOTS]);
    some(c, &a->plain.spring.value, size[KNOTS]);
    some(c, &a->grades.knot, (size[GRADES] > 0) ? (size[GRADES] + 1ul) : 0);
    some(c, &a->grades.slope, (unsigned long)size[ELEMENTS] * size[GRADES]);
    /* The last row is the sum of the others. */
    if (c->from != NULL) { c->room += size[GRADES]; }
    some(c, &a->transformer.knot, size[BENDS]);
    some(c, &a->transformer.value, size[BENDS]);
}

/* Read or write all numbers of a model; `id_end` is the place where the numbers of its loop begin. */
static void walk_model(cursor *c, dehyst_model *m, const uint32_t *size, const unsigned char **id_end)
{
    dehyst_actuator *a = &m->actuator;
    dehyst_transition *to = &m->step;
    const unsigned char *amplifier;
    int i;
    walk_elements(c, a, size);
    shaping(c, &a->smooth.length, size[SMOOTH]);
    shaping(c, &a->smooth.back, size[SMOOTH]);
    some(c, &a->smooth.stiffness, size[SMOOTH]);
    some(c, &m->output.gain, size[OUTPUT]);
    shaping(c, &m->output.decay, size[OUTPUT]);
    shaping(c, &m->output.rise, size[OUTPUT]);
    some(c, &m->tap, size[TAPS]);
    one(c, &a->series);
    one(c, &a->share);
    for (i = 0; i < 4; i++) { one(c, to->phi + i); }
    for (i = 0; i < 2; i++) { one(c, to->before + i); }
    for (i = 0; i < 2; i++) { one(c, to->after + i); }
    amplifier = (c->from != NULL) ? c->from : c->to;
    one(c, &m->lag);
    one(c, &m->keep);
    one(c, &m->from_old);
    one(c, &m->from_new);
    one(c, &m->period);
    *id_end = (c->from != NULL) ? c->from : c->to;
    m->shape = crc32(c->shape, amplifier, (unsigned long)(*id_end - amplifier));
    bound(c, &m->low, 0);
    bound(c, &m->high, 1);
    bound(c, &m->change, 1);
    one(c, &m->start.w);
    one(c, &m->start.y);
    one(c, &m->start.rate);
    some(c, &m->start.cart, size[ELEMENTS]);
    some(c, &m->start.elongation, size[SMOOTH]);
    some(c, &m->start.crept, size[OUTPUT]);
}

/* Begin the shape of a model with the sizes of the memory of its loop. */
static uint32_t shape_of_sizes(const unsigned char *bytes)
{
    const unsigned char *sizes = bytes + 16;
    return crc32(crc32(0, sizes + (4 * ELEMENTS), 4), sizes + (4 * ZERO), 4 * (SIZES - ZERO));
}

static uint64_t numbers_of(const uint32_t *size)
{
    const uint64_t n = size[ELEMENTS], m = size[GRADES];
    return (3 * n) + (2 * (uint64_t)size[KNOTS]) + ((m > 0) ? (m + 1) : 0) + (n * m) + (2 * (uint64_t)size[BENDS]) +
           (4 * ((uint64_t)size[SMOOTH] + size[OUTPUT])) + size[TAPS] + 10 + 5 + 3 + 3;
}

/* Return the count of numbers in a block and in the computed tables. */
static uint64_t room_of(const uint32_t *size)
{
    const uint64_t n = size[ELEMENTS], m = size[GRADES];
    return numbers_of(size) + size[KNOTS] + (2 * (uint64_t)size[BENDS]) + ((m > 0) ? (m + ((n + 1) * (m + 1))) : 0);
}

static dehyst_status read_sizes(const unsigned char *bytes, unsigned long length, uint32_t *size)
{
    const dehyst_status status = check_frame(bytes, length, KIND_OF_MODEL, DEHYST_MODEL_FORMAT, HEADER_OF_MODEL);
    int i;
    if (status != DEHYST_OK) { return status; }
    for (i = 0; i < 12; i++) {
        const uint32_t word = word_at(bytes + 16 + (4 * i));
        if (word > (((i < SIZES) && (i != ZERO)) ? LARGEST_SIZE : 0)) { return DEHYST_ERR_LENGTH; }
        if (i < SIZES) { size[i] = word; }
    }
    if ((size[KNOTS] < 2) || (size[BENDS] == 1) || (size[TAPS] < 1) || (size[INERTIA] > 1)) { return DEHYST_ERR_SIZE; }
    return (((numbers_of(size) * 8) + HEADER_OF_MODEL) == length) ? DEHYST_OK : DEHYST_ERR_LENGTH;
}

dehyst_status dehyst_model_room(const unsigned char *bytes, unsigned long size, unsigned long *room)
{
    uint32_t sizes[SIZES];
    const dehyst_status status = read_sizes(bytes, size, sizes);
    *room = (status == DEHYST_OK) ? (unsigned long)room_of(sizes) : 0;
    return status;
}

/* Write the sizes to the model, and place the tables to compute in the room. */
static dehyst_status tabulate(cursor *c, dehyst_model *m, const uint32_t *size)
{
    dehyst_actuator *a = &m->actuator;
    dehyst_curve *spring = &a->plain.spring, *tau = &a->transformer, *inverse = &a->inverse_transformer;
    dehyst_real *slope = c->room, *tau_slope = slope + size[KNOTS], *tau_inverse = tau_slope + size[BENDS];
    dehyst_real *value = tau_inverse + size[BENDS];
    dehyst_status status;
    a->plain.slip.size = (int)size[ELEMENTS];
    a->plain.slip.edge = a->plain.slip.intercept = a->plain.slip.stiffness = NULL;
    a->plain.slip.inverse_step = 0;
    spring->size = (int)size[KNOTS];
    spring->slope = slope;
    a->grades.size = (int)size[GRADES];
    a->grades.value = value;
    tau->size = inverse->size = (int)size[BENDS];
    inverse->knot = tau->value;
    inverse->value = tau->knot;
    tau->slope = tau_slope;
    inverse->slope = tau_inverse;
    a->smooth.size = (int)size[SMOOTH];
    a->inertia = (int)size[INERTIA];
    m->output.branches = (int)size[OUTPUT];
    m->taps = (int)size[TAPS];
    m->ahead = (int)size[AHEAD];
    status = dehyst_slip_check(a->plain.slip.size, a->plain.slip.rho, a->plain.slip.kappa);
    if (status == DEHYST_OK) { status = dehyst_curve_tabulate(spring->size, spring->knot, spring->value, slope); }
    if ((status == DEHYST_OK) && (a->grades.size > 0)) {
        status = dehyst_grades_tabulate(a->plain.slip.size, a->grades.size, a->grades.knot,
                                        (dehyst_real *)a->grades.slope, value);
    }
    if ((status == DEHYST_OK) && (tau->size > 0)) {
        status = dehyst_curve_tabulate(tau->size, tau->knot, tau->value, tau_slope);
    }
    if ((status == DEHYST_OK) && (tau->size > 0)) {
        status = dehyst_curve_tabulate(inverse->size, inverse->knot, inverse->value, tau_inverse);
    }
    return (status != DEHYST_OK) ? status : dehyst_model_tabulate(m);
}

/* Check the numbers that Python computed from others; no other function of the core checks them. */
static dehyst_status check_motion(const dehyst_model *m)
{
    const dehyst_actuator *a = &m->actuator;
    int i;
    for (i = 0; i < a->smooth.size; i++) {
        const dehyst_real share = a->smooth.back[i] * a->smooth.length[i];
        if (!(a->smooth.length[i] > 0) || !((share >= 0) && (share <= (1 + (8 * DEHYST_EPSILON))))) {
            return DEHYST_ERR_SIGN;
        }
    }
    if ((m->keep < 0) || (m->keep > 1) || (m->from_old < 0) || (m->from_new < 0) || (m->period < 0)) {
        return DEHYST_ERR_SIGN;
    }
    return DEHYST_OK;
}

dehyst_status dehyst_model_load(const unsigned char *bytes, unsigned long size, dehyst_real *room, unsigned long count,
                                dehyst_model *model)
{
    uint32_t sizes[SIZES];
    const unsigned char *id_end;
    dehyst_state state;
    cursor c;
    dehyst_status status = read_sizes(bytes, size, sizes);
    if (status != DEHYST_OK) { return status; }
    if ((room == NULL) || (room_of(sizes) > count)) { return DEHYST_ERR_ROOM; }
    c.from = bytes + HEADER_OF_MODEL;
    c.to = NULL;
    c.room = room;
    c.status = DEHYST_OK;
    c.shape = shape_of_sizes(bytes);
    walk_model(&c, model, sizes, &id_end);
    if (c.status != DEHYST_OK) { return c.status; }
    model->id = crc32(0, bytes + 16, (unsigned long)(id_end - (bytes + 16)));
    status = tabulate(&c, model, sizes);
    if (status == DEHYST_OK) { status = check_motion(model); }
    if (status != DEHYST_OK) { return status; }
    state.memory.y = model->start.w;
    state.memory.cart = (dehyst_real *)model->start.cart;
    state.elongation = (dehyst_real *)model->start.elongation;
    state.y = model->start.y;
    state.rate = model->start.rate;
    state.input = 0;
    status = dehyst_check(&model->actuator, &state);
    if (status == DEHYST_OK) { status = dehyst_start_check(model); }
    if (status != DEHYST_OK) { return status; }
    return is_finite(dehyst_voltage(&model->actuator, &state)) ? DEHYST_OK : DEHYST_ERR_FINITE;
}

unsigned long dehyst_model_save(dehyst_model *model, unsigned char *bytes, unsigned long size)
{
    const dehyst_actuator *a = &model->actuator;
    uint32_t sizes[SIZES];
    unsigned long total;
    const unsigned char *id_end;
    cursor c;
    int i;
    sizes[ELEMENTS] = (uint32_t)a->plain.slip.size;
    sizes[KNOTS] = (uint32_t)a->plain.spring.size;
    sizes[GRADES] = (uint32_t)a->grades.size;
    sizes[BENDS] = (uint32_t)a->transformer.size;
    sizes[ZERO] = 0;
    sizes[SMOOTH] = (uint32_t)a->smooth.size;
    sizes[OUTPUT] = (uint32_t)model->output.branches;
    sizes[TAPS] = (uint32_t)model->taps;
    sizes[INERTIA] = (uint32_t)a->inertia;
    sizes[AHEAD] = (uint32_t)model->ahead;
    total = ((unsigned long)numbers_of(sizes) * 8) + HEADER_OF_MODEL;
    if ((bytes == NULL) || (size < total)) { return total; }
    for (i = 0; i < 12; i++) { put_word(bytes + 16 + (4 * i), (i < SIZES) ? sizes[i] : 0); }
    c.from = NULL;
    c.to = bytes + HEADER_OF_MODEL;
    c.room = NULL;
    c.status = DEHYST_OK;
    c.shape = shape_of_sizes(bytes);
    walk_model(&c, model, sizes, &id_end);
    model->id = crc32(0, bytes + 16, (unsigned long)(id_end - (bytes + 16)));
    put_frame(bytes, KIND_OF_MODEL, DEHYST_MODEL_FORMAT, total);
    return total;
}

static unsigned long snapshot_size(const dehyst_model *model)
{
    const dehyst_actuator *a = &model->actuator;
    return (unsigned long)DEHYST_SNAPSHOT(a->plain.slip.size, a->smooth.size, model->output.branches, model->taps);
}

unsigned long dehyst_loop_save(const dehyst_model *model, const dehyst_loop *loop, const dehyst_real *memory,
                               unsigned char *bytes, unsigned long size)
{
    const dehyst_real scalar[SCALARS] = {loop->w,    loop->y,      loop->rate,        loop->input,
                                         loop->sent, loop->acting, loop->intended[0], loop->intended[1],
                                         loop->gain, loop->offset, loop->driven};
    const unsigned long total = snapshot_size(model), all = dehyst_memory_size(model);
    const unsigned long n = (unsigned long)model->actuator.plain.slip.size;
    unsigned char *at;
    unsigned long i;
    if ((bytes == NULL) || (size < total)) { return 0; }
    at = bytes + HEADER_OF_SNAPSHOT;
    for (i = 0; i < SCALARS; i++, at += 8) { put_real(at, scalar[i]); }
    for (i = 0; i < n; i++, at += 8) { put_real(at, memory[(loop->half ? n : 0) + i]); }
    for (i = 2 * n; i < all; i++, at += 8) { put_real(at, memory[i]); }
    put_word(bytes + 16, (uint32_t)model->shape);
    put_word(bytes + 20, (uint32_t)model->id);
    put_word(bytes + 24, (uint32_t)loop->limited);
    put_word(bytes + 28, (uint32_t)loop->slewed);
    put_word(bytes + 32, (uint32_t)loop->refused);
    put_word(bytes + 36, 0);
    put_frame(bytes, KIND_OF_SNAPSHOT, DEHYST_SNAPSHOT_FORMAT, total);
    return total;
}

/* Check the numbers of a snapshot before anything is changed. */
static dehyst_status check_snapshot(const dehyst_model *model, const unsigned char *first, unsigned long count)
{
    const dehyst_actuator *a = &model->actuator;
    const dehyst_real w = real_at(first);
    const unsigned char *at = first + (8 * SCALARS);
    unsigned long i;
    int k;
    for (i = 0; i < count; i++) {
        if (!is_finite(real_at(first + (8 * i)))) { return DEHYST_ERR_FINITE; }
    }
    for (k = 0; k < 4; k++) {
        if (!within_reach(real_at(first + (8 * k)))) { return DEHYST_ERR_FINITE; }
    }
    for (k = 8; k < SCALARS; k++) {
        if (!within_reach(real_at(first + (8 * k)))) { return DEHYST_ERR_FINITE; }
    }
    if (!(real_at(first + 64) > 0)) { return DEHYST_ERR_SIGN; }
    if (!dehyst_loop_accepts(model, real_at(first + 32))) { return DEHYST_ERR_STATE; }
    for (k = 0; k < a->plain.slip.size; k++, at += 8) {
        const dehyst_real rho = a->plain.slip.rho[k], allowance = 8 * DEHYST_EPSILON * (magnitude(w) + rho);
        if (magnitude(w - real_at(at)) > (rho + allowance)) { return DEHYST_ERR_STATE; }
    }
    for (k = 0; k < a->smooth.size; k++, at += 8) {
        if (magnitude(real_at(at)) > (a->smooth.length[k] * (1 + (8 * DEHYST_EPSILON)))) { return DEHYST_ERR_STATE; }
    }
    return DEHYST_OK;
}

dehyst_status dehyst_loop_restore(const dehyst_model *model, dehyst_loop *loop, dehyst_real *memory,
                                  const unsigned char *bytes, unsigned long size)
{
    dehyst_real *const scalar[SCALARS] = {&loop->w,    &loop->y,      &loop->rate,        &loop->input,
                                          &loop->sent, &loop->acting, &loop->intended[0], &loop->intended[1],
                                          &loop->gain, &loop->offset, &loop->driven};
    const unsigned long all = dehyst_memory_size(model), n = (unsigned long)model->actuator.plain.slip.size;
    dehyst_status status = check_frame(bytes, size, KIND_OF_SNAPSHOT, DEHYST_SNAPSHOT_FORMAT, HEADER_OF_SNAPSHOT);
    const unsigned char *at;
    unsigned long i;
    if (status != DEHYST_OK) { return status; }
    at = bytes + HEADER_OF_SNAPSHOT;
    if (word_at(bytes + 16) != (uint32_t)model->shape) { return DEHYST_ERR_MODEL; }
    if (size != snapshot_size(model)) { return DEHYST_ERR_LENGTH; }
    status = check_snapshot(model, at, SCALARS + all - n);
    if (status != DEHYST_OK) { return status; }
    for (i = 0; i < SCALARS; i++, at += 8) { *scalar[i] = real_at(at); }
    for (i = 0; i < n; i++, at += 8) { memory[i] = memory[n + i] = real_at(at); }
    for (i = 2 * n; i < all; i++, at += 8) { memory[i] = real_at(at); }
    /* The share of w that follows y depends on the spring, which may differ. */
    loop->input = model->actuator.inertia ? (loop->w - (model->actuator.share * loop->y)) : 0;
    loop->wanted = memory[all - (unsigned long)model->taps];
    loop->target = loop->w;
    loop->candidate = loop->voltage = loop->sent;
    loop->offer = DEHYST_NOTHING;
    loop->half = loop->segment = 0;
    loop->limited = word_at(bytes + 24);
    loop->slewed = word_at(bytes + 28);
    loop->refused = word_at(bytes + 32);
    return DEHYST_OK;
}
