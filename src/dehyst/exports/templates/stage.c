#include "piezo.h"

#include "dehyst_model.h"

/* numbers */

/* Return where a voltage on offer leads: it is committed on a copy of the loop, field by field: all of dehyst_loop, as
   a compiler may call memcpy for a whole struct, and there may be no library. */
static dehyst_real reached_by(piezo *p, int axis, dehyst_real voltage)
{
    const dehyst_loop *from = &p->loop[axis];
    const dehyst_real *numbers = p->memory + begins[axis];
    const unsigned long size = dehyst_memory_size(models[axis]);
    dehyst_loop loop;
    unsigned long i;
    loop.w = from->w;
    loop.y = from->y;
    loop.rate = from->rate;
    loop.input = from->input;
    loop.gain = from->gain;
    loop.offset = from->offset;
    loop.driven = from->driven;
    loop.sent = from->sent;
    loop.acting = from->acting;
    loop.intended[0] = from->intended[0];
    loop.intended[1] = from->intended[1];
    loop.wanted = from->wanted;
    loop.target = from->target;
    loop.candidate = from->candidate;
    loop.voltage = from->voltage;
    loop.offer = from->offer;
    loop.segment = from->segment;
    loop.half = from->half;
    loop.limited = loop.slewed = loop.refused = 0;
    for (i = 0; i < size; i++) { p->spare[i] = numbers[i]; }
    dehyst_loop_commit(models[axis], &loop, p->spare, voltage);
    return loop.offset + (loop.gain * loop.w);
}

/* Return the sum of products, from the first axis to the last. */
static dehyst_real dot(const dehyst_real row[PIEZO_AXES], const dehyst_real values[PIEZO_AXES])
{
    dehyst_real total = row[0] * values[0];
    int j;
    for (j = 1; j < PIEZO_AXES; j++) { total += row[j] * values[j]; }
    return total;
}

/* Solve the rows of w = decoupling y of the clamped axes, whose w are known, for their y; the others keep theirs.
 * Elimination without pivoting, in the order of the axes. */
static void solve_reachable(const int known[PIEZO_AXES], const dehyst_real reached[PIEZO_AXES],
                            dehyst_real y[PIEZO_AXES])
{
    dehyst_real rows[PIEZO_AXES][PIEZO_AXES], right[PIEZO_AXES], factor;
    int axes[PIEZO_AXES], size = 0, p, q, r, f;
    for (p = 0; p < PIEZO_AXES; p++) {
        if (known[p]) { axes[size++] = p; }
    }
    for (p = 0; p < size; p++) {
        right[p] = reached[axes[p]];
        for (f = 0; f < PIEZO_AXES; f++) {
            if (!known[f]) { right[p] -= decoupling[axes[p]][f] * y[f]; }
        }
        for (q = 0; q < size; q++) { rows[p][q] = decoupling[axes[p]][axes[q]]; }
    }
    /* A compiler does not see that size is PIEZO_AXES at most. */
    for (p = 0; p < size; p++) {
        for (q = p + 1; (q < size) && (q < PIEZO_AXES); q++) {
            factor = rows[q][p] / rows[p][p];
            for (r = p; r < size; r++) { rows[q][r] -= factor * rows[p][r]; }
            right[q] -= factor * right[p];
        }
    }
    for (p = size - 1; p >= 0; p--) {
        for (q = p + 1; (q < size) && (q < PIEZO_AXES); q++) { right[p] -= rows[p][q] * right[q]; }
        right[p] /= rows[p][p];
    }
    for (p = 0; p < size; p++) { y[axes[p]] = right[p]; }
}

dehyst_status piezo_begin(piezo *p)
{
    dehyst_status status = DEHYST_OK;
    int j;
    for (j = 0; (j < PIEZO_AXES) && (status == DEHYST_OK); j++) {
        status = dehyst_loop_begin(models[j], &p->loop[j], p->memory + begins[j]);
        p->clamped[j] = 0;
    }
    return status;
}

void piezo_offer(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES])
{
    dehyst_real moved[PIEZO_AXES], reached[PIEZO_AXES], beyond[PIEZO_AXES], target;
    int passed = 0, changed, i, j;
    for (j = 0; j < PIEZO_AXES; j++) {
        moved[j] = displacement[j];
        reached[j] = beyond[j] = 0;
        p->clamped[j] = 0;
    }
    do {
        changed = 0;
        for (j = 0; j < PIEZO_AXES; j++) {
            if (p->clamped[j]) {
                /* An axis that moves past what is wanted of it need not be clamped. */
                if ((passed < (2 * PIEZO_AXES)) && ((beyond[j] * (displacement[j] - moved[j])) < 0)) {
                    p->clamped[j] = 0;
                    changed = 1;
                }
                continue;
            }
            target = dot(decoupling[j], moved);
            voltage[j] = dehyst_loop_offer(models[j], &p->loop[j], p->memory + begins[j], target);
            if ((p->loop[j].offer != DEHYST_LIMITED) && (p->loop[j].offer != DEHYST_SLEWED)) { continue; }
            reached[j] = reached_by(p, j, voltage[j]);
            beyond[j] = target - reached[j];
            p->clamped[j] = changed = 1;
        }
        if (changed) {
            for (i = 0; i < PIEZO_AXES; i++) { moved[i] = displacement[i]; }
            solve_reachable(p->clamped, reached, moved);
        }
        passed++;
    } while (changed);
}

void piezo_commit(piezo *p, const dehyst_real voltage[PIEZO_AXES])
{
    int j;
    for (j = 0; j < PIEZO_AXES; j++) { dehyst_loop_commit(models[j], &p->loop[j], p->memory + begins[j], voltage[j]); }
}

void piezo_step(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES])
{
    piezo_offer(p, displacement, voltage);
    piezo_commit(p, voltage);
}

void piezo_hold(piezo *p)
{
    int j;
    for (j = 0; j < PIEZO_AXES; j++) {
        dehyst_loop_commit(models[j], &p->loop[j], p->memory + begins[j], p->loop[j].sent);
    }
}

void piezo_displacement(const piezo *p, dehyst_real displacement[PIEZO_AXES])
{
    dehyst_real moved[PIEZO_AXES];
    int j;
    for (j = 0; j < PIEZO_AXES; j++) { moved[j] = p->loop[j].offset + (p->loop[j].gain * p->loop[j].w); }
    for (j = 0; j < PIEZO_AXES; j++) { displacement[j] = dot(coupling[j], moved); }
}

void piezo_simulate(piezo *p, const dehyst_real voltage[PIEZO_AXES], dehyst_real displacement[PIEZO_AXES])
{
    int j;
    for (j = 0; j < PIEZO_AXES; j++) { dehyst_loop_play(models[j], &p->loop[j], p->memory + begins[j], voltage[j]); }
    piezo_displacement(p, displacement);
}
/* temperature */
