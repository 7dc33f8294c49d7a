#include "piezo.h"

/* numbers */

void piezo_point(piezo *p)
{
    p->loop.state.memory.cart = p->cart;
    p->loop.state.strain = p->strain;
    p->loop.state.elongation = p->elongation;
    p->loop.inputs = p->inputs;
    p->loop.candidate.cart = p->spare;
}

dehyst_status piezo_begin(piezo *p)
{
    dehyst_state *state = &p->loop.state;
    int i;
    piezo_point(p);
    for (i = 0; i < MODEL_ELEMENTS; i++) p->cart[i] = p->spare[i] = model_cart[i];
    for (i = 0; i < MODEL_BRANCHES; i++) p->strain[i] = model_strain[i];
    for (i = 0; i < MODEL_SMOOTH; i++) p->elongation[i] = model_elongation[i];
    state->memory.y = model_place[0];
    state->y = model_place[1];
    state->rate = model_place[2];
    state->input = 0;
    return dehyst_loop_begin(&model, &p->loop);
}

dehyst_real piezo_step(piezo *p, dehyst_real displacement) { return dehyst_loop_step(&model, &p->loop, displacement); }

dehyst_real piezo_offer(piezo *p, dehyst_real displacement) { return dehyst_loop_offer(&model, &p->loop, displacement); }

void piezo_commit(piezo *p, dehyst_real voltage) { dehyst_loop_commit(&model, &p->loop, voltage); }

void piezo_hold(piezo *p) { dehyst_loop_commit(&model, &p->loop, p->loop.sent); }

dehyst_real piezo_simulate(piezo *p, dehyst_real voltage)
{
    dehyst_loop_play(&model, &p->loop, voltage);
    return piezo_displacement(p);
}

dehyst_real piezo_displacement(const piezo *p)
{
    return model.actuator.inertia ? p->loop.state.y : p->loop.state.memory.y;
}

/* Member by member: an assignment of this size would call memcpy, which a bare machine may lack. */
static void copy_loop(dehyst_loop *to, const dehyst_loop *from)
{
    to->state.memory.y = from->state.memory.y;
    to->state.y = from->state.y;
    to->state.rate = from->state.rate;
    to->state.input = from->state.input;
    to->sent = from->sent;
    to->acting = from->acting;
    to->intended[0] = from->intended[0];
    to->intended[1] = from->intended[1];
    to->wanted = from->wanted;
    to->candidate.w = from->candidate.w;
    to->candidate.v = from->candidate.v;
    to->candidate.hint = from->candidate.hint;
    to->voltage = from->voltage;
    to->offer = from->offer;
    to->limited = from->limited;
    to->slewed = from->slewed;
    to->refused = from->refused;
}

void piezo_copy(piezo *to, const piezo *from)
{
    int i;
    if (to == from) return;
    piezo_point(to);
    copy_loop(&to->loop, &from->loop);
    for (i = 0; i < MODEL_ELEMENTS; i++) {
        to->cart[i] = from->loop.state.memory.cart[i];
        to->spare[i] = from->loop.candidate.cart[i];
    }
    for (i = 0; i < MODEL_BRANCHES; i++) to->strain[i] = from->strain[i];
    for (i = 0; i < MODEL_SMOOTH; i++) to->elongation[i] = from->elongation[i];
    for (i = 0; i < MODEL_TAPS; i++) to->inputs[i] = from->inputs[i];
}
