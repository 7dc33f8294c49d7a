#include "piezo.h"

#include "dehyst_model.h"

/* numbers */

/* Return the sum of products, from the first axis to the last. */
static dehyst_real dot(const dehyst_real row[PIEZO_AXES], const dehyst_real values[PIEZO_AXES])
{
    dehyst_real total = row[0] * values[0];
    int j;
    for (j = 1; j < PIEZO_AXES; j++) { total += row[j] * values[j]; }
    return total;
}

dehyst_status piezo_begin(piezo *p)
{
    dehyst_status status = DEHYST_OK;
    int j;
    for (j = 0; (j < PIEZO_AXES) && (status == DEHYST_OK); j++) {
        status = dehyst_loop_begin(models[j], &p->loop[j], p->memory + begins[j]);
    }
    return status;
}

void piezo_offer(piezo *p, const dehyst_real displacement[PIEZO_AXES], dehyst_real voltage[PIEZO_AXES])
{
    int j;
    for (j = 0; j < PIEZO_AXES; j++) {
        voltage[j] = dehyst_loop_offer(models[j], &p->loop[j], p->memory + begins[j], dot(decoupling[j], displacement));
    }
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
