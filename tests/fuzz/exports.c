/* Hostile calls on an export, compiled with its files under sanitizers: exports SEED STEPS. It ends with 1 and a sentence
 * if a voltage lies outside the limits or changes by more than CHANGE, or where the actuator is becomes no number. */
#include "piezo.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static uint64_t state64;

/* splitmix64 */
static uint64_t bits(void)
{
    uint64_t z = (state64 += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static double share(void) { return (double)(bits() >> 11) * 0x1p-53; }

static double hostile(double size)
{
    static const double nonsense[] = {NAN,  INFINITY, -INFINITY, 1.7e308, -1.7e308, 1e281, -1e281, 1e100, -1e100,
                                      1e38, -1e38,    1e30,      -1e16,   5e-324,   1e-310, -0.0,  0.0};
    const double choice = share();
    if (choice < 0.2) return nonsense[bits() % (sizeof nonsense / sizeof *nonsense)];
    if (choice < 0.3) return size * (share() - 0.5) * pow(10, 300 * share());
    return size * (3 * share() - 1.5);
}

static double before;
static int from_outside;

static int is_wrong(const piezo *p, double v, const char *call, long t)
{
    const double change = v > before ? v - before : before - v;
    const int leaves = !(v >= (double)PIEZO_LOW && v <= (double)PIEZO_HIGH);
    const double most = CHANGE * (1 + 8 * DEHYST_EPSILON) + 8 * DEHYST_EPSILON * fabs(before);
    const int jumps = !from_outside && !(change <= most);
    if (leaves || jumps || !isfinite((double)piezo_displacement(p)) || !isfinite((double)p->loop.w)) {
        printf("%s %ld: %.17g V after %.17g V, at %.17g m\n", call, t, v, before, (double)piezo_displacement(p));
        return 1;
    }
    before = v;
    from_outside = 0;
    return 0;
}

static int act(piezo *p, piezo *kept, long t)
{
    double v;
    switch (bits() % 16) {
    case 0:
    case 1:
        piezo_offer(p, (dehyst_real)hostile(SPAN));
        v = piezo_offer(p, (dehyst_real)hostile(SPAN));
        piezo_commit(p, (dehyst_real)v);
        return is_wrong(p, v, "offer", t);
    case 2:
        piezo_commit(p, (dehyst_real)hostile((double)PIEZO_HIGH - (double)PIEZO_LOW));
        before = p->loop.sent;
        from_outside = !(before >= (double)PIEZO_LOW && before <= (double)PIEZO_HIGH);
        return !isfinite((double)piezo_displacement(p));
    case 3: piezo_hold(p); return !isfinite((double)piezo_displacement(p));
    case 4: *kept = *p; return 0;
    case 5:
        if (bits() % 8 > 0) return 0;
        *p = *kept;
        before = p->loop.sent;
        from_outside = 1;
        return 0;
    default: v = piezo_step(p, (dehyst_real)hostile(SPAN)); return is_wrong(p, v, "step", t);
    }
}

int main(int count, char **word)
{
    static piezo loop, kept, actuator;
    const long steps = count > 2 ? atol(word[2]) : 1000;
    long t;
    state64 = count > 1 ? strtoull(word[1], NULL, 10) : 1;
    if (piezo_begin(&loop) != DEHYST_OK || piezo_begin(&kept) != DEHYST_OK) return 2;
    if (piezo_begin(&actuator) != DEHYST_OK) return 2;
    before = loop.loop.sent;
    for (t = 0; t < steps; t++) {
        if (act(&loop, &kept, t)) return 1;
        if (t % 10 == 0 && !isfinite((double)piezo_simulate(&actuator, (dehyst_real)hostile((double)PIEZO_HIGH)))) {
            printf("simulate %ld: a displacement that is no number\n", t);
            return 1;
        }
    }
    return 0;
}
