#include "reversals.h"
#include "turning.h"

/* Number of samples on the carts between two attempts to convert a state to a stack. */
#define BLOCK 256

static dehyst_real distance(const dehyst_reversal *a, const dehyst_reversal *b) { return magnitude(a->y - b->y); }

/* A branch that has moved every cart deletes the reversals below it. If three successive nested amplitudes lie in one
 * cell, the two middle reversals bound a loop that is a straight line for every element. */
void dehyst_stack_turn(const dehyst_slip *slip, dehyst_stack *stack, dehyst_real slip_voltage)
{
    dehyst_reversal *r = stack->reversal;
    dehyst_reversal here;
    here.y = stack->y;
    here.slip_voltage = slip_voltage;
    here.v = stack->v;
    if (stack->depth == 2 && cell_of(slip, distance(&here, &r[1]), 0) == slip->size) {
        r[0] = r[1];
        stack->depth = 1;
    }
    /* On an outermost branch every cart slides. Its start is set far away, so that rounding cannot make the amplitude
     * too short to move all carts. */
    if (stack->depth == 1 && slip->size > 0) r[0].y = here.y - stack->direction * 2 * slip->edge[slip->size - 1];
    /* Amplitudes out of order due to rounding would need more room than nested ones: the innermost loop is deleted. */
    if (stack->depth >= stack->capacity) stack->depth -= 2;
    r[stack->depth++] = here;
    stack->direction = -stack->direction;
    if (stack->depth >= 4) {
        dehyst_reversal *last = r + stack->depth - 1;
        int cell = cell_of(slip, distance(last - 3, last - 2), 0);
        if (cell == cell_of(slip, distance(last - 1, last), cell)) {
            last[-2] = *last;
            stack->depth -= 2;
        }
    }
}

/* Turn at y, a point of the present branch in this cell and near segment j of the spring. */
static void turn_at(const dehyst_plain *plain, dehyst_stack *stack, dehyst_real y, int cell, int j)
{
    const dehyst_reversal *from = stack->reversal + stack->depth - 1;
    const dehyst_real slip_voltage =
        from->slip_voltage + stack->direction * masing_branch(&plain->slip, cell, magnitude(y - from->y));
    stack->y = y;
    stack->v = slip_voltage + on_segment(&plain->spring, segment(&plain->spring, y, j), y);
    dehyst_stack_turn(&plain->slip, stack, slip_voltage);
}

dehyst_status dehyst_stack_encode(const dehyst_plain *plain, const dehyst_plain_state *state, dehyst_stack *stack)
{
    const dehyst_slip *slip = &plain->slip;
    dehyst_reversal *r = stack->reversal, swap;
    dehyst_real direction, y = state->y, cart = state->y, rho = 0, total = 0;
    int i, count = 0;
    if (stack->capacity < DEHYST_STACK_CAPACITY(slip->size)) return DEHYST_ERR_CAPACITY;
    /* The carts are points of a memory curve b(rho) of slope -+1; between two of them it has at most one corner, and
     * each of its straight pieces, prolonged to rho = 0, names a reversal. */
    direction = slip->size > 0 && state->cart[0] > state->y ? -1 : 1;
    stack->direction = direction;
    for (i = 0; i < slip->size; i++) {
        dehyst_real width = slip->rho[i] - rho, rise = -direction * (state->cart[i] - cart);
        dehyst_real allowance = 8 * DEHYST_EPSILON * (magnitude(state->y) + slip->rho[i]);
        if (magnitude(rise) > width + allowance) return DEHYST_ERR_UNREACHABLE;
        if (rise < width - allowance) {
            dehyst_real corner = rho + (width + rise) / 2;
            y -= direction * 2 * corner;
            r[count++].y = y;
            direction = -direction;
        }
        rho = slip->rho[i];
        cart = state->cart[i];
        total += slip->kappa[i] * slip->rho[i];
    }
    /* Twice the distance that moves every cart, so that rounding cannot make the outermost amplitude too short. */
    r[count].y = y - direction * 4 * rho;
    r[count].slip_voltage = -direction * total;
    r[count].v = r[count].slip_voltage + dehyst_curve_at(&plain->spring, r[count].y);
    for (i = count - 1; i >= 0; i--) {
        dehyst_real u = distance(&r[i], &r[i + 1]);
        r[i].slip_voltage = r[i + 1].slip_voltage + direction * masing_branch(slip, cell_of(slip, u, 0), u);
        r[i].v = r[i].slip_voltage + dehyst_curve_at(&plain->spring, r[i].y);
        direction = -direction;
    }
    for (i = 0; i < count - i; i++) {
        swap = r[i];
        r[i] = r[count - i];
        r[count - i] = swap;
    }
    stack->depth = count + 1;
    stack->y = state->y;
    stack->v = dehyst_plain_voltage(plain, state);
    return DEHYST_OK;
}

void dehyst_stack_decode(const dehyst_plain *plain, const dehyst_stack *stack, dehyst_plain_state *state)
{
    const dehyst_slip *slip = &plain->slip;
    dehyst_real y = stack->y, direction = stack->direction;
    int i, k = stack->depth - 1;
    for (i = 0; i < slip->size; i++) {
        while (k > 0 && slip->edge[i] > magnitude(y - stack->reversal[k].y)) {
            y = stack->reversal[k--].y;
            direction = -direction;
        }
        state->cart[i] = y - direction * slip->rho[i];
    }
    state->y = stack->y;
}

/* While a motion goes back by at most edge_0 from the farthest point of its branch, and not to the start of the branch,
 * no cart moves and the motion stays on the branch: noise on a path makes no reversals. */
void dehyst_stack_compensate(const dehyst_plain *plain, dehyst_stack *stack, const dehyst_real *y, dehyst_real *v,
                             long n)
{
    const dehyst_slip *slip = &plain->slip;
    const dehyst_curve *spring = &plain->spring;
    const dehyst_real elastic = slip->stiffness[0], width = slip->edge[0];
    dehyst_reversal from = stack->reversal[stack->depth - 1];
    dehyst_real direction = stack->direction, present = stack->y, voltage = stack->v;
    /* Start and farthest point of the branch, times the direction. */
    dehyst_real began = direction * from.y, far = direction * present;
    int cell = cell_of(slip, far - began, 0), j = segment(spring, present, 0);
    long t = 0;
    while (t < n) {
        dehyst_real goal = is_finite(y[t]) ? y[t] : present, place = direction * goal, ahead, joins;
        const dehyst_reversal *to;
        if (far - place > width || place < began) {
            turn_at(plain, stack, direction * far, cell, j);
            direction = stack->direction;
            far = direction * stack->reversal[stack->depth - 1].y;
            place = direction * goal;
        }
        ahead = place > far ? place : far;
        while ((to = joint(stack)) != NULL && ahead >= direction * to->y) stack->depth -= 2;
        joins = to != NULL ? direction * to->y : DEHYST_LARGEST;
        from = stack->reversal[stack->depth - 1];
        began = direction * from.y;
        cell = cell_of(slip, ahead - began, cell);
        j = segment(spring, goal, j);
        {
            /* This loop runs in registers until a sample leaves the branch, the cell or the segment. */
            const dehyst_real intercept = slip->intercept[cell], stiffness = slip->stiffness[cell];
            const dehyst_real edge = slip->edge[cell];
            const dehyst_real knot = spring->knot[j], value = spring->value[j], slope = spring->slope[j];
            const dehyst_real low = j > 0 ? knot : -DEHYST_LARGEST;
            const dehyst_real high = j + 2 < spring->size ? spring->knot[j + 1] : DEHYST_LARGEST;
            do {
                far = ahead;
                present = goal;
                voltage = from.slip_voltage +
                          direction * (intercept + stiffness * (far - began) - elastic * (far - place)) +
                          (value + slope * (goal - knot));
                v[t] = voltage;
                if (++t == n) break;
                goal = y[t];
                place = direction * goal;
                ahead = place > far ? place : far;
            } while (ahead - place <= width && place >= began && ahead < joins && ahead - began < edge && goal >= low &&
                     goal < high);
        }
    }
    if (direction * present < far) turn_at(plain, stack, direction * far, cell, j);
    stack->y = present;
    stack->v = voltage;
}

typedef dehyst_real step_function(const dehyst_plain *, dehyst_plain_state *, dehyst_real);
typedef void stack_function(const dehyst_plain *, dehyst_stack *, const dehyst_real *, dehyst_real *, long);

static void run(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_stack *work, const dehyst_real *in,
                dehyst_real *out, long n, step_function *step, stack_function *on_stack)
{
    long t = 0, stop;
    while (t < n && dehyst_stack_encode(plain, state, work) != DEHYST_OK)
        for (stop = n - t < BLOCK ? n : t + BLOCK; t < stop; t++) out[t] = step(plain, state, in[t]);
    if (t < n) {
        on_stack(plain, work, in + t, out + t, n - t);
        dehyst_stack_decode(plain, work, state);
    }
}

/* Least number of samples that show how often a path turns. */
#define FEW 64
/* Largest number of elements that are faster on carts than on the stack. */
#define MOST_SOLVED 32

void dehyst_plain_compensate_run(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_stack *work,
                                 const dehyst_real *y, dehyst_real *v, long n)
{
    const dehyst_slip *slip = &plain->slip;
    if (n >= FEW && slip->size > 0 && dehyst_turns_often(plain, y, n, 2 * slip->rho[0]))
        dehyst_elements_compensate(plain, state, y, v, n);
    else
        run(plain, state, work, y, v, n, dehyst_plain_compensate, dehyst_stack_compensate);
}

void dehyst_plain_simulate_run(const dehyst_plain *plain, dehyst_plain_state *state, dehyst_stack *work,
                               const dehyst_real *v, dehyst_real *y, long n)
{
    const dehyst_slip *slip = &plain->slip;
    const dehyst_curve *spring = &plain->spring;
    const int last = spring->size - 1;
    if (n >= FEW && slip->size > 0 && slip->size <= MOST_SOLVED) {
        /* A motion back over twice the shortest breakaway elongation, in which all elements stick. */
        const dehyst_real slope = (spring->value[last] - spring->value[0]) / (spring->knot[last] - spring->knot[0]);
        if (dehyst_turns_often(plain, v, n, 2 * slip->rho[0] * (slope + slip->stiffness[0]))) {
            dehyst_elements_simulate(plain, state, v, y, n);
            return;
        }
    }
    run(plain, state, work, v, y, n, dehyst_plain_simulate, dehyst_stack_simulate);
}
