#include "piezo.h"

#include "dehyst_model.h"

/* numbers */

dehyst_status piezo_begin(piezo *p) { return dehyst_loop_begin(&piezo_model, &p->loop, p->memory); }

dehyst_real piezo_step(piezo *p, dehyst_real displacement)
{
    return dehyst_loop_step(&piezo_model, &p->loop, p->memory, displacement);
}

dehyst_real piezo_offer(piezo *p, dehyst_real displacement)
{
    return dehyst_loop_offer(&piezo_model, &p->loop, p->memory, displacement);
}

void piezo_commit(piezo *p, dehyst_real voltage) { dehyst_loop_commit(&piezo_model, &p->loop, p->memory, voltage); }

void piezo_hold(piezo *p) { piezo_commit(p, p->loop.sent); }

dehyst_real piezo_simulate(piezo *p, dehyst_real voltage)
{
    dehyst_loop_play(&piezo_model, &p->loop, p->memory, voltage);
    return piezo_displacement(p);
}

dehyst_real piezo_displacement(const piezo *p) { return dehyst_loop_displacement(&piezo_model, &p->loop, p->memory); }

const dehyst_model *piezo_exported(void) { return &piezo_model; }

void piezo_save(const piezo *p, unsigned char bytes[PIEZO_SNAPSHOT])
{
    dehyst_loop_save(&piezo_model, &p->loop, p->memory, bytes, PIEZO_SNAPSHOT);
}

dehyst_status piezo_restore(piezo *p, const unsigned char bytes[PIEZO_SNAPSHOT])
{
    return dehyst_loop_restore(&piezo_model, &p->loop, p->memory, bytes, PIEZO_SNAPSHOT);
}
/* temperature */
