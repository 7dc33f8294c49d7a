/* Models and snapshots as blocks: what was saved is loaded bit for bit; what was broken is refused, or computes what is
 * finite and within limits. dehyst_blocks [CASES [SEED]]; run it under sanitizers. */
#include "dehyst_model.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ELEMENTS 9
#define KNOTS 6
#define GRADES 3
#define BENDS 4
#define SMOOTH 2
#define OUTPUT 2
#define TAPS 3
#define STEPS 60
#define HEADER 64

static unsigned long long seed = 1;

/* splitmix64 */
static unsigned long long bits(void)
{
    unsigned long long z = (seed += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static unsigned long below(unsigned long n) { return (unsigned long)(bits() % n); }
static double between(double low, double high) { return low + (high - low) * ((double)(bits() >> 11) * 0x1p-53); }

static void demand(int holds, const char *what, long got)
{
    if (holds) return;
    printf("%s: %ld\n", what, got);
    exit(1);
}

static void *room(size_t bytes)
{
    void *found = malloc(bytes + 1);
    demand(found != NULL, "no memory", (long)bytes);
    return found;
}

/* All arrays of a model that is written by hand. */
typedef struct bench {
    dehyst_real rho[ELEMENTS], kappa[ELEMENTS], knot[KNOTS], value[KNOTS], slope[KNOTS];
    dehyst_real grade_knot[GRADES + 1], grade_slope[(ELEMENTS + 1) * GRADES];
    dehyst_real grade_value[(ELEMENTS + 1) * (GRADES + 1)];
    dehyst_real volts[BENDS], drive[BENDS], tau[BENDS], inverse[BENDS];
    dehyst_real length[SMOOTH], back[SMOOTH], smooth[SMOOTH];
    dehyst_real output_gain[OUTPUT], output_decay[OUTPUT], output_rise[OUTPUT], crept[OUTPUT];
    dehyst_real tap[TAPS], cart[ELEMENTS], elongation[SMOOTH];
    dehyst_model model;
} bench;

static void fill(dehyst_real *x, int n, double low, double high)
{
    while (n-- > 0) *x++ = (dehyst_real)between(low, high);
}

static void rise(dehyst_real *x, int n, double from, double by)
{
    int i;
    for (i = 0; i < n; i++) x[i] = (dehyst_real)(from + by * (i + between(0.1, 0.9)));
}

static void give_curve(dehyst_curve *curve, int size, const dehyst_real *knot, const dehyst_real *value,
                       dehyst_real *slope)
{
    curve->size = size;
    curve->knot = knot;
    curve->value = value;
    curve->slope = slope;
    demand(dehyst_curve_tabulate(size, knot, value, slope) == DEHYST_OK, "a curve", size);
}

static void give_motion(bench *b, dehyst_model *m)
{
    const dehyst_real closing[SMOOTH] = {1, (dehyst_real)0.6};
    dehyst_actuator *a = &m->actuator;
    fill(b->length, SMOOTH, 0.05, 0.5);
    fill(b->smooth, SMOOTH, 0, 1);
    demand(dehyst_smooth_tabulate(SMOOTH, b->length, closing, b->back) == DEHYST_OK, "smooth elements", SMOOTH);
    a->smooth.size = SMOOTH;
    a->smooth.length = b->length;
    a->smooth.back = b->back;
    a->smooth.stiffness = b->smooth;
}

/* A random model with random parts. */
static void make(bench *b)
{
    dehyst_model *m = &b->model;
    dehyst_actuator *a = &m->actuator;
    int i;
    memset(b, 0, sizeof *b);
    rise(b->rho, ELEMENTS, 0, 0.5 / ELEMENTS);
    fill(b->kappa, ELEMENTS, 0, 2);
    rise(b->knot, KNOTS, 0, 1.0 / KNOTS);
    rise(b->value, KNOTS, 0, 10.0 / KNOTS);
    a->plain.slip.size = ELEMENTS;
    a->plain.slip.rho = b->rho;
    a->plain.slip.kappa = b->kappa;
    give_curve(&a->plain.spring, KNOTS, b->knot, b->value, b->slope);
    if (bits() & 1) {
        rise(b->grade_knot, GRADES + 1, 0, 1.0 / GRADES);
        for (i = 0; i < ELEMENTS * GRADES; i++) b->grade_slope[i] = (dehyst_real)(0.1 + 0.01 * (i % GRADES));
        demand(dehyst_grades_tabulate(ELEMENTS, GRADES, b->grade_knot, b->grade_slope, b->grade_value) == DEHYST_OK,
               "grades", GRADES);
        a->grades.size = GRADES;
        a->grades.knot = b->grade_knot;
        a->grades.slope = b->grade_slope;
        a->grades.value = b->grade_value;
    }
    if (bits() & 1) {
        rise(b->volts, BENDS, -1, 3);
        rise(b->drive, BENDS, -1, 3);
        give_curve(&a->transformer, BENDS, b->volts, b->drive, b->tau);
        give_curve(&a->inverse_transformer, BENDS, b->drive, b->volts, b->inverse);
    }
    if (bits() & 1) give_motion(b, m);
    fill(b->output_gain, OUTPUT, 0, 0.2);
    fill(b->output_decay, OUTPUT, 0.2, 0.99);
    fill(b->output_rise, OUTPUT, 0.5, 1);
    fill(b->crept, OUTPUT, -0.1, 0.1);
    m->output.branches = bits() & 1 ? OUTPUT : 0;
    m->output.gain = b->output_gain;
    m->output.decay = b->output_decay;
    m->output.rise = b->output_rise;
    m->low = 2;
    m->high = 7;
    m->change = bits() & 1 ? DEHYST_LARGEST : 2;
    m->taps = bits() & 1 ? 1 : TAPS;
    m->tap = b->tap;
    fill(b->tap, TAPS, 0, 0.1);
    b->tap[0] = 1;
    m->from_new = 1;
    m->period = (dehyst_real)1e-3;
    m->ahead = m->taps / 2;
    for (i = 0; i < ELEMENTS; i++) b->cart[i] = (dehyst_real)0.5;
    m->start.w = m->start.y = (dehyst_real)0.5;
    m->start.cart = b->cart;
    m->start.elongation = b->elongation;
    m->start.crept = b->crept;
    demand(dehyst_model_tabulate(m) == DEHYST_OK, "a model", m->taps);
}

static unsigned char *saved(dehyst_model *model, unsigned long *size)
{
    unsigned char *bytes;
    *size = dehyst_model_save(model, NULL, 0);
    bytes = room(*size);
    demand(dehyst_model_save(model, bytes, *size) == *size, "a block has another size", (long)*size);
    return bytes;
}

/* Load a block and, if it is accepted, make steps; return the status. */
static dehyst_status run(const unsigned char *bytes, unsigned long size, dehyst_real *volts)
{
    /* Sanitizers see a byte beyond: the block is copied to its exact size. */
    unsigned char *copy = room(size);
    unsigned long count, i;
    dehyst_status status;
    dehyst_model model;
    dehyst_loop loop;
    dehyst_real *tables, *memory;
    memcpy(copy, bytes, size);
    status = dehyst_model_room(copy, size, &count);
    if (status == DEHYST_OK) {
        tables = malloc(count * sizeof *tables);
        demand(tables != NULL, "no memory", (long)count);
        demand(dehyst_model_load(copy, size, tables, count - 1, &model) == DEHYST_ERR_ROOM, "room", (long)count);
        status = dehyst_model_load(copy, size, tables, count, &model);
        if (status == DEHYST_OK) {
            memory = room(dehyst_memory_size(&model) * sizeof *memory);
            demand(dehyst_loop_begin(&model, &loop, memory) == DEHYST_OK, "an accepted block does not begin", 0);
            for (i = 0; i < STEPS; i++) {
                volts[i] = dehyst_loop_step(&model, &loop, memory, (dehyst_real)(0.5 + 0.6 * sin(0.3 * (double)i)));
                demand(volts[i] >= model.low && volts[i] <= model.high, "a voltage outside the limits", (long)i);
            }
            free(memory);
        }
        free(tables);
    }
    free(copy);
    return status;
}

/* CRC-32 as the core's, so that a changed block is not refused for its checksum. */
static void seal(unsigned char *bytes, unsigned long size)
{
    unsigned long sum = 0xFFFFFFFFul, i;
    int k;
    for (i = 16; i < size; i++) {
        sum ^= bytes[i];
        for (k = 0; k < 8; k++) sum = sum >> 1 ^ (sum & 1 ? 0xEDB88320ul : 0);
    }
    sum = ~sum & 0xFFFFFFFFul;
    for (k = 0; k < 4; k++) bytes[12 + k] = (unsigned char)(sum >> 8 * k);
}

static void load_what_was_saved(bench *b, const unsigned char *bytes, unsigned long size)
{
    dehyst_real got[STEPS], memory[DEHYST_MEMORY(ELEMENTS, SMOOTH, OUTPUT, TAPS)];
    dehyst_loop loop;
    int i;
    demand(run(bytes, size, got) == DEHYST_OK, "a sound block is refused", (long)run(bytes, size, got));
    demand(dehyst_loop_begin(&b->model, &loop, memory) == DEHYST_OK, "begin", 0);
    for (i = 0; i < STEPS; i++)
        demand(dehyst_loop_step(&b->model, &loop, memory, (dehyst_real)(0.5 + 0.6 * sin(0.3 * i))) == got[i],
               "another voltage than before", i);
}

static void refuse_what_was_broken(const unsigned char *bytes, unsigned long size, unsigned char *broken)
{
    static const unsigned char strange[][8] = {{0, 0, 0, 0, 0, 0, 0xF8, 0x7F}, {0, 0, 0, 0, 0, 0, 0xF0, 0xFF},
                                               {255, 255, 255, 255, 255, 255, 0xEF, 0x7F}, {1, 0, 0, 0, 0, 0, 0, 0},
                                               {0, 0, 0, 0, 0, 0, 0, 0x80}};
    dehyst_real volts[STEPS];
    unsigned long at;
    memcpy(broken, bytes, size);
    at = below(8 * size);
    broken[at / 8] ^= (unsigned char)(1u << at % 8);
    demand(run(broken, size, volts) != DEHYST_OK, "a changed bit is accepted", (long)at);
    demand(run(bytes, below(size), volts) != DEHYST_OK, "a block that is cut off is accepted", (long)size);
    /* With a checksum that fits: refused, or a model that keeps to its limits. */
    seal(broken, size);
    run(broken, size, volts);
    memcpy(broken, bytes, size);
    memcpy(broken + HEADER + 8 * below((size - HEADER) / 8), strange[below(5)], 8);
    seal(broken, size);
    run(broken, size, volts);
    memcpy(broken, bytes, size);
    for (at = 0; at < 4; at++) broken[16 + 4 * below(12) + at] = (unsigned char)(bits() % 7 == 0 ? bits() : 0);
    seal(broken, size);
    run(broken, size, volts);
}

static void go_on_from_snapshots(bench *b)
{
    unsigned char kept[DEHYST_SNAPSHOT(ELEMENTS, SMOOTH, OUTPUT, TAPS)];
    dehyst_real memory[DEHYST_MEMORY(ELEMENTS, SMOOTH, OUTPUT, TAPS)], fresh[sizeof memory / sizeof *memory];
    const dehyst_model *m = &b->model;
    dehyst_loop loop, other;
    unsigned long size, at;
    int i;
    dehyst_loop_begin(m, &loop, memory);
    demand(dehyst_loop_scale(&loop, 0, 0) == DEHYST_ERR_SIGN, "a gain of 0", 0);
    demand(dehyst_loop_scale(&loop, 1, (dehyst_real)NAN) == DEHYST_ERR_FINITE, "an offset that is not a number", 0);
    if (bits() & 1) demand(dehyst_loop_scale(&loop, (dehyst_real)1.1, (dehyst_real)0.05) == DEHYST_OK, "a scale", 0);
    for (i = 0; i < STEPS; i++) dehyst_loop_step(m, &loop, memory, (dehyst_real)between(-0.2, 1.2));
    size = dehyst_loop_save(m, &loop, memory, kept, sizeof kept);
    dehyst_loop_begin(m, &other, fresh);
    at = below(8 * size);
    kept[at / 8] ^= (unsigned char)(1u << at % 8);
    demand(dehyst_loop_restore(m, &other, fresh, kept, size) != DEHYST_OK, "a changed snapshot", (long)at);
    demand(other.sent == other.voltage && other.w == m->start.w, "a refused snapshot has changed the loop", (long)at);
    kept[at / 8] ^= (unsigned char)(1u << at % 8);
    demand(dehyst_loop_restore(m, &other, fresh, kept, below(size)) != DEHYST_OK, "a snapshot cut off", (long)size);
    demand(dehyst_loop_save(m, &loop, memory, NULL, 0) == 0, "a snapshot to nowhere", 0);
    demand(dehyst_loop_restore(m, &other, fresh, NULL, size) != DEHYST_OK, "a snapshot from nowhere", 0);
    demand(dehyst_loop_restore(m, &other, fresh, kept, size) == DEHYST_OK, "a snapshot", (long)size);
    for (i = 0; i < STEPS; i++) {
        const dehyst_real u = (dehyst_real)between(-0.2, 1.2);
        demand(dehyst_loop_step(m, &loop, memory, u) == dehyst_loop_step(m, &other, fresh, u), "other bits", i);
        demand(dehyst_loop_displacement(m, &loop, memory) == dehyst_loop_displacement(m, &other, fresh), "elsewhere", i);
    }
    b->model.id++;
    demand(dehyst_loop_restore(m, &other, fresh, kept, size) == DEHYST_OK, "a snapshot of other weights", 0);
    b->model.shape++;
    demand(dehyst_loop_restore(m, &other, fresh, kept, size) == DEHYST_ERR_MODEL, "another shape's snapshot", 0);
    b->model.shape--;
}

/* Change number `at` of a block by one part in 4096 or less. */
static void change(unsigned char *bytes, unsigned long size, int at)
{
    bytes[HEADER + 8 * at + 5] ^= 1;
    seal(bytes, size);
}

static void load(const unsigned char *bytes, unsigned long size, dehyst_real *tables, dehyst_model *model)
{
    unsigned long count;
    demand(dehyst_model_room(bytes, size, &count) == DEHYST_OK, "room", (long)size);
    demand(dehyst_model_load(bytes, size, tables, count, model) == DEHYST_OK, "a block", (long)count);
}

/* A loop that goes on from the snapshot of a model of other stiffnesses changes its voltage no faster than the slew rate. A
 * snapshot of another breakaway elongation is refused. */
static void go_on_with_another_model(bench *b, unsigned char *bytes, unsigned long size)
{
    unsigned char kept[DEHYST_SNAPSHOT(ELEMENTS, SMOOTH, OUTPUT, TAPS)];
    dehyst_real memory[DEHYST_MEMORY(ELEMENTS, SMOOTH, OUTPUT, TAPS)], fresh[sizeof memory / sizeof *memory];
    dehyst_real *tables = room(2 * size * sizeof *tables), last;
    dehyst_model stranger, loaded;
    const dehyst_model *now = &b->model, *next = &loaded;
    dehyst_loop loop, other;
    unsigned long count;
    int i, k;
    change(bytes, size, 0);
    load(bytes, size, tables, &stranger);
    change(bytes, size, 0);
    for (i = 0; i < ELEMENTS; i++) change(bytes, size, ELEMENTS + i);
    change(bytes, size, 2 * ELEMENTS + KNOTS + 1);
    load(bytes, size, tables + size, &loaded);
    demand(loaded.id != now->id && loaded.shape == now->shape, "the id or the shape", 0);
    demand(dehyst_loop_begin(now, &loop, memory) == DEHYST_OK, "begin", 0);
    count = dehyst_loop_save(now, &loop, memory, kept, sizeof kept);
    dehyst_loop_begin(&stranger, &other, fresh);
    demand(dehyst_loop_restore(&stranger, &other, fresh, kept, count) != DEHYST_OK, "another shape is accepted", 0);
    last = loop.sent;
    for (k = 0; k < STEPS; k++) {
        const dehyst_model *before = now;
        count = dehyst_loop_save(now, &loop, memory, kept, sizeof kept);
        now = next;
        next = before;
        demand(dehyst_loop_restore(now, &loop, memory, kept, count) == DEHYST_OK, "a snapshot", k);
        for (i = 0; i < k % 5; i++) {
            const dehyst_real v = dehyst_loop_step(now, &loop, memory, (dehyst_real)between(-0.2, 1.2));
            demand(fabs((double)(v - last)) <= (double)now->change * (1 + 1e-6), "faster than the slew rate", k);
            last = v;
        }
    }
    free(tables);
}

/* Whatever a sensor says, the correction stays within its bound and voltages within limits and slew rate; a sensor that is not
 * believed loses its correction. */
static void feed_back(bench *b)
{
    static const dehyst_real wild[] = {(dehyst_real)NAN, (dehyst_real)INFINITY, (dehyst_real)1e30, (dehyst_real)-1e30, 0};
    dehyst_real memory[DEHYST_MEMORY(ELEMENTS, SMOOTH, OUTPUT, TAPS)], last;
    const dehyst_real bound = (dehyst_real)between(0.001, 0.5), gain = (dehyst_real)between(0.001, 1);
    const double scale = between(-1, 2), share = between(0, 1), pace = between(0.01, 3);
    const dehyst_model *m = &b->model;
    dehyst_feedback feedback;
    dehyst_loop loop;
    int k;
    dehyst_loop_begin(m, &loop, memory);
    demand(dehyst_feedback_begin(m, &loop, memory, -1, 1, 0, &feedback) == DEHYST_ERR_SIGN, "a gain below 0", 0);
    demand(dehyst_feedback_begin(m, &loop, memory, 0, (dehyst_real)NAN, 0, &feedback) == DEHYST_ERR_FINITE,
           "a bound that is not a number", 0);
    demand(dehyst_feedback_begin(m, &loop, memory, 0, 1, DEHYST_FEEDBACK_LATE + 1, &feedback) == DEHYST_ERR_SIZE,
           "a longer delay than there is room for", 0);
    demand(dehyst_feedback_begin(m, &loop, memory, gain, bound, (int)below(5), &feedback) == DEHYST_OK, "to feed back", 0);
    for (k = 0; k < 10 * STEPS; k++) {
        const dehyst_real place = dehyst_loop_displacement(m, &loop, memory), before = feedback.correction;
        const dehyst_real said = between(0, 1) < share ? (dehyst_real)(scale * place) : wild[below(5)];
        const int believed = feedback.fault == DEHYST_BELIEVED;
        last = loop.sent;
        dehyst_feedback_step(m, &loop, memory, &feedback, (dehyst_real)(0.5 + 0.7 * sin(pace * k)), said);
        demand(fabs((double)feedback.correction) <= (double)bound * (1 + 1e-6), "a correction beyond its bound", k);
        demand(believed || fabs((double)feedback.correction) <= fabs((double)before), "a correction by a sensor of no credit", k);
        demand(believed || feedback.fault != DEHYST_BELIEVED, "a sensor that is believed again", k);
        demand(loop.sent >= m->low && loop.sent <= m->high, "a voltage beyond the limits", k);
        demand(fabs((double)(loop.sent - last)) <= (double)m->change * (1 + 1e-6), "faster than the slew rate", k);
    }
}

int main(int count, char **word)
{
    const long cases = count > 1 ? atol(word[1]) : 300;
    bench *b = room(sizeof *b);
    long n;
    if (count > 2) seed = strtoull(word[2], NULL, 10);
    for (n = 0; n < cases; n++) {
        unsigned long size;
        unsigned char *bytes, *broken;
        int k;
        make(b);
        bytes = saved(&b->model, &size);
        broken = room(size);
        load_what_was_saved(b, bytes, size);
        for (k = 0; k < 20; k++) refuse_what_was_broken(bytes, size, broken);
        go_on_from_snapshots(b);
        go_on_with_another_model(b, bytes, size);
        for (k = 0; k < 20; k++) feed_back(b);
        free(broken);
        free(bytes);
    }
    free(b);
    printf("%ld models, saved, broken and loaded\n", cases);
    return 0;
}
