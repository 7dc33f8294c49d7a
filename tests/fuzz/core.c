/* Random models and lives on the C core, hostile numbers among them, to be compiled with the core's own sources under
 * sanitizers: core SEED FIRST COUNT prints the first case that fails and ends with 1. Every array has its exact size.
 */
#include "dehyst_records.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static uint64_t state64;
static long now;

/* splitmix64 */
static uint64_t bits(void)
{
    uint64_t z = (state64 += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static double share(void) { return (double)(bits() >> 11) * 0x1p-53; }
static double between(double low, double high) { return low + (high - low) * share(); }
static int below(int n) { return (int)(bits() % (uint64_t)n); }
static int chance(double p) { return share() < p; }

static const double NONSENSE[] = {NAN,    INFINITY, -INFINITY, 1.7e308, -1.7e308, 1e281, -1e281, 1e100, -1e100, 1e30,
                                  -1e30,  1e16,     -1e16,     5e-324,  -5e-324,  1e-310, 1e-200, 0.0,   -0.0};
#define KINDS_OF_NONSENSE (int)(sizeof NONSENSE / sizeof *NONSENSE)
static dehyst_real nonsense(void) { return (dehyst_real)NONSENSE[below(KINDS_OF_NONSENSE)]; }

static void fail(const char *what, double a, double b)
{
    printf("case %ld: %s (%.17g, %.17g)\n", now, what, a, b);
    exit(1);
}

static void *room(size_t count, size_t size)
{
    void *found = malloc(count * size);
    if (found == NULL && count > 0) exit(3);
    return found;
}

#define MOST_ARRAYS 96
static void *owned[MOST_ARRAYS];
static int arrays;

static dehyst_real *numbers(int n)
{
    dehyst_real *found = room((size_t)n, sizeof(dehyst_real));
    int i;
    for (i = 0; i < n; i++) found[i] = 0;
    if (arrays == MOST_ARRAYS) exit(4);
    owned[arrays++] = found;
    return found;
}

static void release(void)
{
    while (arrays > 0) free(owned[--arrays]);
}

/* Strictly rising; hostile ones span all exponents. */
static dehyst_real *rising(int n, double first, double span, int hostile)
{
    dehyst_real *found = numbers(n);
    int i;
    found[0] = (dehyst_real)first;
    for (i = 1; i < n; i++) {
        double step = span / n * between(0.2, 2);
        if (hostile && chance(0.3)) step = span * pow(10, between(-200, 200));
        found[i] = found[i - 1] + (dehyst_real)step;
    }
    return found;
}

typedef struct model {
    int hostile;
    double span, volts;
    dehyst_actuator actuator;
    dehyst_transition step;
} model;

static int make_plain(model *m)
{
    const int n = below(12), k = 2 + below(10), uniform = chance(0.6);
    dehyst_slip *slip = &m->actuator.plain.slip;
    dehyst_curve *spring = &m->actuator.plain.spring;
    dehyst_real *rho = rising(n > 0 ? n : 1, m->span * between(0.01, 0.2), m->span, m->hostile), *kappa = numbers(n);
    dehyst_real *edge = numbers(n + 1), *intercept = numbers(n + 1), *stiffness = numbers(n + 1);
    dehyst_real *slope = numbers(k - 1);
    dehyst_real *knot = rising(k, -m->span * share(), m->span, m->hostile);
    dehyst_real *value = rising(k, -m->volts * share(), m->volts, m->hostile);
    int i;
    for (i = 0; i < n; i++) {
        if (uniform) rho[i] = rho[0] * (dehyst_real)(i + 1);
        kappa[i] = (dehyst_real)(chance(0.2) ? 0 : between(0, 2) * m->volts / m->span / n);
        if (m->hostile && chance(0.1)) kappa[i] *= (dehyst_real)pow(10, between(-300, 100));
    }
    slip->size = n, slip->rho = rho, slip->kappa = kappa;
    slip->edge = edge, slip->intercept = intercept, slip->stiffness = stiffness;
    spring->size = k, spring->knot = knot, spring->value = value, spring->slope = slope;
    return dehyst_curve_tabulate(k, knot, value, slope) == DEHYST_OK &&
           dehyst_slip_tabulate(n, rho, kappa, edge, intercept, stiffness, &slip->inverse_step) == DEHYST_OK;
}

static int make_grades(model *m)
{
    const int n = m->actuator.plain.slip.size, parts = 1 + below(6);
    dehyst_real *knot = rising(parts + 1, -m->span * share(), m->span, m->hostile);
    dehyst_real *slope = numbers((n + 1) * parts), *value = numbers((n + 1) * (parts + 1));
    double least = m->actuator.plain.spring.slope[0];
    int i;
    for (i = 1; i + 1 < m->actuator.plain.spring.size; i++)
        if (m->actuator.plain.spring.slope[i] < least) least = m->actuator.plain.spring.slope[i];
    for (i = 0; i < n * parts; i++) slope[i] = (dehyst_real)(0.8 * least / n * share());
    m->actuator.grades.size = parts, m->actuator.grades.knot = knot;
    m->actuator.grades.slope = slope, m->actuator.grades.value = value;
    return dehyst_grades_tabulate(n, parts, knot, slope, value) == DEHYST_OK;
}

static int make_transformer(model *m)
{
    const int n = 2 + below(8);
    dehyst_real *v = rising(n, -m->volts * share(), m->volts, m->hostile);
    dehyst_real *drive = rising(n, -m->volts * share(), m->volts, m->hostile);
    dehyst_real *slope = numbers(n - 1), *inverse = numbers(n - 1);
    m->actuator.transformer.size = m->actuator.inverse_transformer.size = n;
    m->actuator.transformer.knot = m->actuator.inverse_transformer.value = v;
    m->actuator.transformer.value = m->actuator.inverse_transformer.knot = drive;
    m->actuator.transformer.slope = slope, m->actuator.inverse_transformer.slope = inverse;
    return dehyst_curve_tabulate(n, v, drive, slope) == DEHYST_OK &&
           dehyst_curve_tabulate(n, drive, v, inverse) == DEHYST_OK;
}

/* One step of a mass, by many small ones. */
static void make_inertia(model *m)
{
    const double mean = m->volts / m->span, beta = mean * between(0, 3), theta = beta / (mean + beta);
    const double zeta = between(0.005, 1), by = pow(10, between(-4, 0.3)) / 2000;
    double column[4][2] = {{1, 0}, {0, 1}, {0, 0}, {0, 0}};
    int c, t;
    for (c = 0; c < 4; c++)
        for (t = 0; t < 2000; t++) {
            const double q = c == 2 ? 1 - (t + 0.5) / 2000 : c == 3 ? (t + 0.5) / 2000 : 0;
            double *x = column[c];
            x[1] += by * (q - (1 - theta) * x[0] - 2 * zeta * x[1]);
            x[0] += by * x[1];
        }
    m->actuator.inertia = 1, m->actuator.series = (dehyst_real)beta, m->actuator.share = (dehyst_real)theta;
    for (c = 0; c < 2; c++) {
        m->step.phi[2 * c] = (dehyst_real)column[0][c];
        m->step.phi[2 * c + 1] = (dehyst_real)column[1][c];
        m->step.before[c] = (dehyst_real)column[2][c];
        m->step.after[c] = (dehyst_real)column[3][c];
    }
}

static int make_smooth(model *m)
{
    const int n = 1 + below(4);
    dehyst_real *length = numbers(n), *closing = numbers(n), *back = numbers(n), *stiffness = numbers(n);
    int l;
    for (l = 0; l < n; l++) {
        length[l] = (dehyst_real)(m->span * pow(10, between(-2, 0)));
        if (m->hostile && chance(0.3)) length[l] *= (dehyst_real)pow(10, between(-250, 200));
        closing[l] = (dehyst_real)(chance(0.3) ? 0.5 : between(0.5, 1));
        stiffness[l] = (dehyst_real)(m->volts / m->span * between(0, 0.4));
    }
    m->actuator.smooth.size = n, m->actuator.smooth.length = length;
    m->actuator.smooth.back = back, m->actuator.smooth.stiffness = stiffness;
    return dehyst_smooth_tabulate(n, length, closing, back) == DEHYST_OK;
}

/* Whether the core takes it. */
static int make_model(model *m)
{
    static const model nothing;
    *m = nothing;
    m->hostile = chance(0.3);
    m->span = pow(10, between(-7, -3)), m->volts = pow(10, between(0, 3));
    m->step.phi[0] = m->step.phi[3] = 1;
    if (!make_plain(m)) return 0;
    if (chance(0.3) && !make_grades(m)) return 0;
    if (chance(0.4) && !make_transformer(m)) return 0;
    if (chance(0.25)) make_inertia(m);
    return chance(0.3) ? make_smooth(m) : 1;
}

static void make_state(const model *m, dehyst_state *state)
{
    const dehyst_slip *slip = &m->actuator.plain.slip;
    const double y = m->span * between(-1.5, 1.5);
    const int extreme = chance(0.3);
    int i;
    state->memory.cart = numbers(slip->size);
    state->elongation = numbers(m->actuator.smooth.size);
    state->memory.y = state->y = (dehyst_real)y;
    state->rate = state->input = 0;
    for (i = 0; i < slip->size; i++) {
        const double s = extreme ? (chance(0.5) ? 1 : -1) : between(-1, 1);
        state->memory.cart[i] = (dehyst_real)(y - s * slip->rho[i]);
    }
    for (i = 0; i < m->actuator.smooth.size; i++)
        state->elongation[i] = (dehyst_real)(m->actuator.smooth.length[i] * between(-1, 1));
}

static int all_numbers(const dehyst_real *a, int n)
{
    while (n-- > 0)
        if (!(a[n] - a[n] == 0)) return 0;
    return 1;
}

static int is_sound(const model *m, const dehyst_state *s)
{
    return all_numbers(&s->memory.y, 1) && all_numbers(s->memory.cart, m->actuator.plain.slip.size) &&
           all_numbers(s->elongation, m->actuator.smooth.size) &&
           (!m->actuator.inertia || (all_numbers(&s->y, 1) && all_numbers(&s->rate, 1) && all_numbers(&s->input, 1)));
}

/* A path or a voltage: near, far, and nonsense. */
static dehyst_real *make_input(double size, int n, double strange)
{
    dehyst_real *found = numbers(n);
    int t;
    for (t = 0; t < n; t++) {
        found[t] = (dehyst_real)(size * between(-1.5, 1.5));
        if (chance(strange)) found[t] *= (dehyst_real)pow(10, between(0, chance(0.5) ? 20 : 300));
        if (chance(strange)) found[t] = nonsense();
    }
    return found;
}

static void play_records(const model *m)
{
    const int n = below(150), size = m->actuator.plain.slip.size, knots = m->actuator.plain.spring.size;
    const double strange = chance(0.5) ? 0 : share();
    dehyst_state s;
    dehyst_workspace work;
    dehyst_real *y = make_input(m->span, n, strange), *v = make_input(m->volts, n, strange), *out = numbers(n);
    dehyst_reversal *reversals = room(DEHYST_STACK_CAPACITY(size), sizeof *reversals);
    int *segment = room((size_t)size, sizeof *segment);
    const int stack = chance(0.7);
    work.stack.capacity = DEHYST_STACK_CAPACITY(size), work.stack.reversal = stack ? reversals : NULL;
    /* Paths that turn at most samples leave the stack as it is. */
    work.stack.depth = 0;
    work.value = numbers(knots), work.slope = numbers(knots - 1), work.at_cart = numbers(size), work.segment = segment;
    work.smooth = numbers(2 * m->actuator.smooth.size + 1);
    make_state(m, &s);
    if (dehyst_check(&m->actuator, &s) == DEHYST_OK) {
        dehyst_compensate_run(&m->actuator, &s, &work, y, chance(0.2) ? v : NULL, out, n);
        dehyst_simulate_run(&m->actuator, &m->step, &s, &work, v, chance(0.2) ? y : NULL, out, n);
    }
    make_state(m, &s);
    if (stack && dehyst_plain_check(&m->actuator.plain, &s.memory) == DEHYST_OK) {
        dehyst_plain_compensate_run(&m->actuator.plain, &s.memory, &work.stack, y, out, n);
        dehyst_plain_simulate_run(&m->actuator.plain, &s.memory, &work.stack, v, out, n);
        if (work.stack.depth > work.stack.capacity) fail("stack too deep", work.stack.depth, work.stack.capacity);
    }
    free(reversals);
    free(segment);
}

typedef struct life {
    dehyst_model c;
    dehyst_loop loop;
    dehyst_real *memory;
    dehyst_state start; /* a state of its own, from which the model begins */
    dehyst_real before;
    int free;
} life;

static int is_sound_now(const model *m, const life *l)
{
    const int n = m->actuator.plain.slip.size;
    dehyst_state now;
    now.memory.y = l->loop.w, now.memory.cart = l->memory + (l->loop.half ? n : 0);
    now.elongation = l->memory + 2 * n;
    now.y = l->loop.y, now.rate = l->loop.rate, now.input = l->loop.input;
    return is_sound(m, &now);
}

static dehyst_status begin(life *l)
{
    const dehyst_state *s = &l->start;
    l->c.start.w = s->memory.y, l->c.start.y = s->y, l->c.start.rate = s->rate;
    l->c.start.cart = s->memory.cart, l->c.start.elongation = s->elongation;
    return dehyst_loop_begin(&l->c, &l->loop, l->memory);
}

static void was_sent(const model *m, life *l, dehyst_real v)
{
    const dehyst_model *c = &l->c;
    const dehyst_real change = v > l->before ? v - l->before : l->before - v;
    if (!(v >= c->low && v <= c->high)) fail("outside the limits", (double)v, (double)(v < c->low ? c->low : c->high));
    /* After a voltage from outside the limits the way back to them is free. */
    if (!l->free && !(change <= c->change + 4 * DEHYST_EPSILON * (c->change + (dehyst_real)fabs(l->before))))
        fail("over the slew rate", (double)change, (double)c->change);
    if (!m->hostile && !is_sound_now(m, l)) fail("a state that is no number", l->loop.w, v);
    l->before = v;
    l->free = 0;
}

static dehyst_real wanted(const model *m)
{
    if (chance(0.1)) return nonsense();
    return (dehyst_real)(m->span * between(-1.5, 1.5) * (chance(0.1) ? pow(10, between(0, 300)) : 1));
}

static void commit_other(const model *m, life *l)
{
    const dehyst_model *c = &l->c;
    const dehyst_real v = chance(0.5) ? nonsense() : (dehyst_real)between(2 * c->low - c->high, 2 * c->high - c->low);
    dehyst_loop_commit(c, &l->loop, l->memory, v);
    if (!m->hostile && !is_sound_now(m, l)) fail("a state that is no number after a commit", v, 0);
    l->before = l->loop.sent;
    l->free = !(l->before >= c->low && l->before <= c->high);
    if (!dehyst_loop_accepts(c, l->before)) fail("a voltage is accepted that is none", l->before, v);
}

/* A state that comes from outside is checked, and begins anew. */
static void damage(const model *m, life *l)
{
    dehyst_state *s = &l->start;
    dehyst_real *const one[] = {&s->memory.y, &s->y, &s->rate};
    *one[below(3)] = nonsense();
    if (m->actuator.plain.slip.size > 0 && chance(0.3)) s->memory.cart[below(m->actuator.plain.slip.size)] = nonsense();
    if (m->actuator.smooth.size > 0 && chance(0.3)) s->elongation[below(m->actuator.smooth.size)] = nonsense();
    if (begin(l) != DEHYST_OK) {
        make_state(m, s);
        if (begin(l) != DEHYST_OK) fail("a sound state is refused", s->memory.y, 0);
    }
    l->before = l->loop.sent;
    l->free = 0;
}

/* A snapshot of which a bit has changed, or that is cut off, is refused; a whole one goes on. */
static void reset_by_snapshot(const model *m, life *l)
{
    const dehyst_actuator *a = &m->actuator;
    const int size = DEHYST_SNAPSHOT(a->plain.slip.size, a->smooth.size, l->c.output.branches, l->c.taps);
    unsigned char *bytes = room((size_t)size, 1);
    const int bit = below(8 * size);
    dehyst_status status;
    if (dehyst_loop_save(&l->c, &l->loop, l->memory, bytes, (unsigned long)size) != (unsigned long)size)
        fail("a snapshot has another size", size, 0);
    bytes[bit / 8] ^= (unsigned char)(1 << bit % 8);
    if (dehyst_loop_restore(&l->c, &l->loop, l->memory, bytes, (unsigned long)size) == DEHYST_OK)
        fail("a changed snapshot is accepted", bit, 0);
    bytes[bit / 8] ^= (unsigned char)(1 << bit % 8);
    if (dehyst_loop_restore(&l->c, &l->loop, l->memory, bytes, (unsigned long)below(size)) == DEHYST_OK)
        fail("a snapshot that is cut off is accepted", size, 0);
    status = dehyst_loop_restore(&l->c, &l->loop, l->memory, bytes, (unsigned long)size);
    /* A mass may have come to move faster than can be computed with. */
    if (status != DEHYST_OK && status != DEHYST_ERR_FINITE && !m->hostile)
        fail("a snapshot is refused", (double)status, (double)l->loop.sent);
    free(bytes);
}

static void act(const model *m, life *l)
{
    const int what = below(21);
    if (what < 9) {
        was_sent(m, l, dehyst_loop_step(&l->c, &l->loop, l->memory, wanted(m)));
    } else if (what < 12) {
        const dehyst_real v = dehyst_loop_offer(&l->c, &l->loop, l->memory, wanted(m));
        if (chance(0.3)) return;
        dehyst_loop_commit(&l->c, &l->loop, l->memory, v);
        was_sent(m, l, v);
    } else if (what < 15) {
        commit_other(m, l);
    } else if (what < 17) {
        dehyst_loop_commit(&l->c, &l->loop, l->memory, l->loop.sent);
    } else if (what < 19) {
        const dehyst_real kept = l->loop.sent;
        dehyst_loop_play(&l->c, &l->loop, l->memory, chance(0.5) ? nonsense() : (dehyst_real)(m->volts * between(-2, 2)));
        if (!m->hostile && !is_sound_now(m, l)) fail("no state after a play", l->loop.sent, 0);
        l->loop.sent = l->before = kept;
    } else if (what < 20) {
        damage(m, l);
    } else {
        reset_by_snapshot(m, l);
    }
}

static void play_life(const model *m)
{
    static const life nothing;
    life l = nothing;
    const int taps = chance(0.7) ? 1 : 2 + below(6);
    dehyst_real *tap = numbers(taps);
    const double low = m->volts * between(-1, 1), width = m->volts * pow(10, between(-2, 0.3));
    int t, calls = 10 + below(80);
    for (t = 0; t < taps; t++) tap[t] = (dehyst_real)(taps == 1 ? 1 : between(-2, 2));
    l.c.actuator = m->actuator, l.c.step = m->step;
    l.c.low = (dehyst_real)low, l.c.high = (dehyst_real)(low + width);
    l.c.change = chance(0.3) ? DEHYST_LARGEST : (dehyst_real)(width * pow(10, between(-3, 0.5)));
    l.c.taps = taps, l.c.tap = tap;
    if (chance(0.3)) {
        const double steps = pow(10, between(-3, 3)), mean = -expm1(-steps) / steps;
        l.c.lag = (dehyst_real)(1 / steps), l.c.keep = (dehyst_real)exp(-steps);
        l.c.from_old = (dehyst_real)(mean - exp(-steps)), l.c.from_new = (dehyst_real)(1 - mean);
    }
    if (dehyst_model_tabulate(&l.c) != DEHYST_OK) return;
    make_state(m, &l.start);
    l.memory = numbers((int)dehyst_memory_size(&l.c));
    if (begin(&l) != DEHYST_OK) return;
    l.before = l.loop.sent;
    was_sent(m, &l, l.loop.sent);
    while (calls-- > 0) act(m, &l);
}

int main(int count, char **word)
{
    const uint64_t seed = count > 1 ? strtoull(word[1], NULL, 10) : 1;
    const long first = count > 2 ? atol(word[2]) : 0, cases = count > 3 ? atol(word[3]) : 1000;
    long made = 0;
    for (now = first; now < first + cases; now++) {
        model m;
        state64 = seed * 0xD1342543DE82EF95u + (uint64_t)now * 0x9E3779B97F4A7C15u;
        if (make_model(&m)) {
            made++;
            play_records(&m);
            play_life(&m);
        }
        release();
    }
    printf("%ld cases, %ld models\n", cases, made);
    return 0;
}
