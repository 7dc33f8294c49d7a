/* Laws of hysteresis and of the compensator, on random actuators: dehyst_laws [NAME] checks one of them, or all. */
#include "dehyst_records.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ELEMENTS 12
#define KNOTS 7
#define SMOOTH 2
#define OUTPUT 3
#define SAMPLES 400
#define CASES 60

static unsigned long long seed;

/* splitmix64, as a number in [0, 1). */
static double share(void)
{
    unsigned long long z = (seed += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

static double between(double low, double high) { return low + (high - low) * share(); }

/* All memory of a plain actuator: strokes of about 1, voltages of about 10. */
typedef struct bench {
    dehyst_real rho[ELEMENTS], kappa[ELEMENTS], knot[KNOTS], value[KNOTS], slope[KNOTS - 1];
    dehyst_real edge[ELEMENTS + 1], intercept[ELEMENTS + 1], stiffness[ELEMENTS + 1], cart[ELEMENTS], spare[ELEMENTS];
    dehyst_real length[SMOOTH], back[SMOOTH], smooth[SMOOTH], elongation[SMOOTH];
    dehyst_real output_gain[OUTPUT], output_decay[OUTPUT], output_rise[OUTPUT], crept[OUTPUT];
    dehyst_real tap, inputs;
    dehyst_actuator actuator;
    dehyst_state state;
    dehyst_transition step;
} bench;

static void demand(int holds, const char *what, double got, double wanted)
{
    if (holds) return;
    printf("%s: got %.17g, want %.17g\n", what, got, wanted);
    exit(1);
}

static void demand_close(double got, double wanted, double allowance, const char *what)
{
    demand(fabs(got - wanted) <= allowance, what, got, wanted);
}

/* The state's arrays of its own. */
static void point(bench *b)
{
    b->state.memory.cart = b->cart;
    b->state.elongation = b->elongation;
}

/* A random actuator at rest at y = 0.5; with smooth elements if asked for. */
static void make(bench *b, int moving)
{
    const dehyst_real closing[SMOOTH] = {1, (dehyst_real)0.6};
    dehyst_actuator *a = &b->actuator;
    int i;
    memset(b, 0, sizeof *b);
    for (i = 0; i < ELEMENTS; i++) {
        b->rho[i] = (dehyst_real)(0.5 * (i + between(0.6, 1.0)) / ELEMENTS);
        b->kappa[i] = (dehyst_real)between(0, 2);
        b->cart[i] = (dehyst_real)0.5;
    }
    for (i = 0; i < KNOTS; i++) {
        b->knot[i] = (dehyst_real)((i + between(-0.3, 0.3)) / (KNOTS - 1));
        b->value[i] = (dehyst_real)(10.0 * (i + between(-0.3, 0.3)) / (KNOTS - 1));
    }
    a->plain.slip.size = ELEMENTS;
    a->plain.slip.rho = b->rho;
    a->plain.slip.kappa = b->kappa;
    a->plain.slip.edge = b->edge;
    a->plain.slip.intercept = b->intercept;
    a->plain.slip.stiffness = b->stiffness;
    demand(dehyst_slip_tabulate(ELEMENTS, b->rho, b->kappa, b->edge, b->intercept, b->stiffness,
                                &a->plain.slip.inverse_step) == DEHYST_OK, "slip", 0, 0);
    a->plain.spring.size = KNOTS;
    a->plain.spring.knot = b->knot;
    a->plain.spring.value = b->value;
    a->plain.spring.slope = b->slope;
    demand(dehyst_curve_tabulate(KNOTS, b->knot, b->value, b->slope) == DEHYST_OK, "spring", 0, 0);
    b->state.memory.y = (dehyst_real)0.5;
    point(b);
    if (!moving) return;
    for (i = 0; i < SMOOTH; i++) {
        b->length[i] = (dehyst_real)between(0.05, 0.5);
        b->smooth[i] = (dehyst_real)between(0, 2);
    }
    demand(dehyst_smooth_tabulate(SMOOTH, b->length, closing, b->back) == DEHYST_OK, "smooth", 0, 0);
    a->smooth.size = SMOOTH;
    a->smooth.length = b->length;
    a->smooth.back = b->back;
    a->smooth.stiffness = b->smooth;
}

/* The same actuator, whose tables are shared, in the same state. */
static void clone(bench *to, const bench *from)
{
    *to = *from;
    point(to);
}

static void demand_sound(const bench *b)
{
    demand(dehyst_check(&b->actuator, &b->state) == DEHYST_OK, "the state is one of the actuator", 0, 1);
}

/* Where a displacement leads by its own voltage: back to itself. */
static void simulate_undoes_compensate(int moving)
{
    bench there, back;
    dehyst_candidate candidate = {0, 0, NULL, 0};
    int t;
    make(&there, moving);
    clone(&back, &there);
    candidate.cart = there.spare;
    {
        const dehyst_real stiffness = dehyst_step_stiffness(&there.actuator, &there.step);
        for (t = 0; t < SAMPLES; t++) {
            candidate.w = (dehyst_real)between(-0.2, 1.2);
            dehyst_evaluate(&there.actuator, &there.step, &there.state, stiffness, &candidate);
            dehyst_commit(&there.actuator, &there.step, &there.state, &candidate);
            demand_close((double)dehyst_simulate_step(&back.actuator, &back.step, &back.state, stiffness, candidate.v),
                         (double)candidate.w, 1e-12, "simulate(compensate(y))");
        }
    }
    demand_sound(&there);
    demand_sound(&back);
}

static void inverse(void) { simulate_undoes_compensate(0); }
static void inverse_in_time(void) { simulate_undoes_compensate(1); }

/* A loop that is closed leaves no trace: what follows is as if it had never been. */
static void wiping_out(void)
{
    bench with, without;
    int t;
    make(&with, 0);
    for (t = 0; t < 20; t++)
        dehyst_plain_compensate(&with.actuator.plain, &with.state.memory, (dehyst_real)between(0, 1));
    clone(&without, &with);
    {
        const dehyst_real high = with.state.memory.y + 1, low = high - (dehyst_real)between(0, 1);
        dehyst_plain_compensate(&with.actuator.plain, &with.state.memory, high);
        dehyst_plain_compensate(&without.actuator.plain, &without.state.memory, high);
        for (t = 0; t < 10; t++)
            dehyst_plain_compensate(&with.actuator.plain, &with.state.memory,
                                    (dehyst_real)between((double)low, (double)high));
        dehyst_plain_compensate(&with.actuator.plain, &with.state.memory, low);
        dehyst_plain_compensate(&with.actuator.plain, &with.state.memory, high);
    }
    for (t = 0; t < ELEMENTS; t++) demand_close((double)with.cart[t], (double)without.cart[t], 1e-14, "carts");
}

/* Rate independence: samples between two turning points change nothing. */
static void rate_independence(void)
{
    bench slow, fast;
    dehyst_real y;
    int t, k;
    make(&slow, 0);
    clone(&fast, &slow);
    y = slow.state.memory.y;
    for (t = 0; t < 40; t++) {
        const dehyst_real goal = (dehyst_real)between(-0.2, 1.2);
        dehyst_real v = 0;
        for (k = 1; k <= 10; k++)
            v = dehyst_plain_compensate(&slow.actuator.plain, &slow.state.memory,
                                        k < 10 ? y + (goal - y) * k / 10 : goal);
        demand_close((double)dehyst_plain_compensate(&fast.actuator.plain, &fast.state.memory, goal), (double)v, 1e-12,
                     "voltage");
        y = goal;
    }
}

/* A closed loop takes work, never gives any. */
static void dissipation(void)
{
    bench b;
    dehyst_real before, v = 0, work = 0;
    int t, k;
    make(&b, 0);
    before = b.state.memory.y;
    for (k = 0; k < 2; k++) {
        work = 0;
        for (t = 0; t <= SAMPLES; t++) {
            const dehyst_real y = (dehyst_real)(0.5 + 0.4 * sin(6.283185307179586 * t / SAMPLES));
            const dehyst_real next = dehyst_plain_compensate(&b.actuator.plain, &b.state.memory, y);
            if (t > 0) work += (next + v) / 2 * (y - before);
            v = next;
            before = y;
        }
    }
    demand(work > 0, "work of a closed loop", (double)work, 1);
}

/* The stack of reversals gives the answers of the carts. */
static void stack_and_carts(void)
{
    static dehyst_reversal reversal[DEHYST_STACK_CAPACITY(ELEMENTS)];
    dehyst_stack stack = {DEHYST_STACK_CAPACITY(ELEMENTS), 0, 1, 0, 0, NULL};
    dehyst_real y[SAMPLES], v[SAMPLES], back[SAMPLES];
    bench carts, other, third;
    int t;
    make(&carts, 0);
    clone(&other, &carts);
    clone(&third, &carts);
    stack.reversal = reversal;
    for (t = 0; t < SAMPLES; t++) y[t] = (dehyst_real)between(-0.2, 1.2);
    dehyst_plain_compensate_run(&other.actuator.plain, &other.state.memory, &stack, y, v, SAMPLES);
    for (t = 0; t < SAMPLES; t++)
        demand_close((double)v[t], (double)dehyst_plain_compensate(&carts.actuator.plain, &carts.state.memory, y[t]),
                     1e-11, "voltage on the stack");
    dehyst_plain_simulate_run(&third.actuator.plain, &third.state.memory, &stack, v, back, SAMPLES);
    for (t = 0; t < SAMPLES; t++) demand_close((double)back[t], (double)y[t], 1e-12, "displacement on the stack");
    demand_sound(&other);
    demand_sound(&third);
}

#define MEMORY DEHYST_MEMORY(ELEMENTS, SMOOTH, OUTPUT, 1)

/* A loop, its memory, and the model: nothing of it points to the loop, which may be copied by =. */
typedef struct runner {
    dehyst_loop loop;
    dehyst_real memory[MEMORY];
} runner;

static void make_loop(bench *b, dehyst_model *m, runner *r, int moving)
{
    int k;
    make(b, moving);
    memset(m, 0, sizeof *m);
    memset(r, 0, sizeof *r);
    b->tap = 1;
    m->actuator = b->actuator;
    m->step = b->step;
    m->low = 2;
    m->high = 7;
    m->change = 2;
    m->taps = 1;
    m->tap = &b->tap;
    m->start.w = m->start.y = (dehyst_real)0.5;
    m->start.cart = b->cart;
    m->start.elongation = b->elongation;
    for (k = 0; k < OUTPUT; k++) {
        const double periods = exp(6 * between(0, 1));
        b->output_gain[k] = (dehyst_real)between(0, 0.1);
        b->output_decay[k] = (dehyst_real)exp(-1 / periods);
        b->output_rise[k] = (dehyst_real)(-expm1(-1 / periods) * periods);
        b->crept[k] = (dehyst_real)between(-0.1, 0.1);
    }
    m->output.branches = moving ? OUTPUT : 0;
    m->output.gain = b->output_gain;
    m->output.decay = b->output_decay;
    m->output.rise = b->output_rise;
    m->start.crept = b->crept;
    demand(dehyst_model_tabulate(m) == DEHYST_OK, "model", 0, 0);
    demand(dehyst_loop_begin(m, &r->loop, r->memory) == DEHYST_OK, "loop", 0, 0);
}

static dehyst_real step(const dehyst_model *m, runner *r, dehyst_real u)
{
    return dehyst_loop_step(m, &r->loop, r->memory, u);
}

/* Whatever is wanted, voltages stay within their limits and change by what is allowed, and the memory is sound. */
static void limits_and_slew(void)
{
    static const double nonsense[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 1e-320};
    unsigned char bytes[DEHYST_SNAPSHOT(ELEMENTS, SMOOTH, OUTPUT, 1)];
    bench b;
    dehyst_model m;
    runner r;
    unsigned long refused = 0;
    int t;
    make_loop(&b, &m, &r, 1);
    for (t = 0; t < SAMPLES; t++) {
        const int odd = t % 17 == 5;
        const double u = odd ? nonsense[t / 17 % 6] : between(-0.5, 1.5);
        const dehyst_real before = r.loop.sent, v = step(&m, &r, (dehyst_real)u);
        refused += odd && t / 17 % 6 < 3;
        demand(v >= m.low && v <= m.high, "a voltage within the limits", (double)v, (double)m.high);
        demand_close((double)v, (double)before, (double)m.change * (1 + 1e-12), "a voltage within the slew rate");
    }
    demand(r.loop.limited > 0 && r.loop.slewed > 0, "samples clamped", (double)(r.loop.limited + r.loop.slewed), 1);
    demand(r.loop.refused >= refused, "samples refused", (double)r.loop.refused, (double)refused);
    /* A state that is none of the actuator is no snapshot either. */
    demand(dehyst_loop_save(&m, &r.loop, r.memory, bytes, sizeof bytes) == sizeof bytes, "bytes", 0, 1);
    demand(dehyst_loop_restore(&m, &r.loop, r.memory, bytes, sizeof bytes) == DEHYST_OK, "a sound state", 0, 1);
}

/* A clamped voltage moves the memory as the actuator alone moves: the loop knows where it is. */
static void memory_follows_what_is_sent(void)
{
    bench b;
    dehyst_model m;
    runner r, actuator;
    int t;
    make_loop(&b, &m, &r, 1);
    actuator = r;
    for (t = 0; t < SAMPLES; t++) {
        const dehyst_real v = step(&m, &r, (dehyst_real)between(-0.5, 1.5));
        dehyst_loop_play(&m, &actuator.loop, actuator.memory, v);
        demand_close((double)actuator.loop.w, (double)r.loop.w, 1e-11, "displacement");
        demand_close((double)dehyst_loop_displacement(&m, &actuator.loop, actuator.memory),
                     (double)dehyst_loop_displacement(&m, &r.loop, r.memory), 1e-11, "displacement with creep");
    }
}

/* Creep behind the elements, gain and offset are inverted: what is wanted is reached where nothing is clamped. */
static void output_is_inverted(void)
{
    bench b;
    dehyst_model m;
    runner r;
    unsigned long clamped = 0;
    int t;
    make_loop(&b, &m, &r, 1);
    m.change = DEHYST_LARGEST;
    for (t = 0; t < SAMPLES; t++) {
        const dehyst_real u = (dehyst_real)between(0.3, 0.7);
        if (t % 50 == 7) dehyst_loop_scale(&r.loop, (dehyst_real)between(0.9, 1.1), (dehyst_real)between(-0.1, 0.1));
        step(&m, &r, u);
        if (r.loop.limited == clamped)
            demand_close((double)dehyst_loop_displacement(&m, &r.loop, r.memory), (double)u, 1e-12, "displacement");
        clamped = r.loop.limited;
    }
    demand(clamped < 3 * SAMPLES / 4, "samples clamped", (double)clamped, 3 * SAMPLES / 4);
}

/* An offer that is not committed leaves no trace, in a copy of the loop. */
static void offers_leave_no_trace(void)
{
    bench b;
    dehyst_model m;
    runner r, same;
    int t;
    make_loop(&b, &m, &r, 1);
    same = r;
    for (t = 0; t < SAMPLES; t++) {
        const dehyst_real u = (dehyst_real)between(-0.5, 1.5);
        dehyst_loop_offer(&m, &r.loop, r.memory, (dehyst_real)between(-0.5, 1.5));
        demand(step(&m, &r, u) == step(&m, &same, u), "the same bits", 0, 0);
    }
}

typedef struct law {
    const char *name;
    void (*check)(void);
} law;

static const law laws[] = {{"inverse", inverse},
                           {"inverse_in_time", inverse_in_time},
                           {"wiping_out", wiping_out},
                           {"rate_independence", rate_independence},
                           {"dissipation", dissipation},
                           {"stack_and_carts", stack_and_carts},
                           {"limits_and_slew", limits_and_slew},
                           {"memory_follows_what_is_sent", memory_follows_what_is_sent},
                           {"output_is_inverted", output_is_inverted},
                           {"offers_leave_no_trace", offers_leave_no_trace}};

static void check(const law *law)
{
    int n;
    for (n = 0; n < CASES; n++) {
        seed = (unsigned long long)n;
        law->check();
    }
}

int main(int count, char **word)
{
    size_t i, checked = 0;
    for (i = 0; i < sizeof laws / sizeof *laws; i++)
        if (count < 2 || strcmp(word[1], laws[i].name) == 0) {
            check(laws + i);
            checked++;
        }
    printf("%d laws checked\n", (int)checked);
    return checked == 0;
}
