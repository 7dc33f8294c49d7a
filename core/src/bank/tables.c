#include "tables.h"

/* Beside the voltages of an actuator: far more than rounding, also at FAR times its displacements. */
#define TOLERANCE (DEHYST_EPSILON * 4096)
#define FAR 8
/* Beyond every displacement that can be computed with, and short enough to add to. */
#define BEYOND (DEHYST_LARGEST / 4)

/* Beside the length of a segment: far less than 1, more than the rounding of knots. */
#define UNEQUAL ((dehyst_real)1e-4)

/* Fewer knots are counted faster than looked up; more have no place in a byte. */
#define FEW_KNOTS 10
#define MOST_KNOTS 256

#define LANES DEHYST_LANES

/* Return whether a curve has segments of one length; so has the identity. */
static int has_equal_segments(const dehyst_curve *curve)
{
    int j;
    dehyst_real step;
    if (curve == NULL || curve->size < 3) return 1;
    step = (curve->knot[curve->size - 1] - curve->knot[0]) / (curve->size - 1);
    for (j = 1; j < curve->size; j++)
        if (!(magnitude(curve->knot[j] - curve->knot[0] - j * step) < UNEQUAL * step)) return 0;
    return 1;
}

/* Equal cells over the bends of a curve. */
typedef struct cell_grid {
    dehyst_real origin, scale;
} cell_grid;

static cell_grid grid_of(const dehyst_curve *curve, int cells)
{
    cell_grid grid = {0, 0};
    if (curve == NULL || curve->size < 3) return grid;
    grid.origin = curve->knot[1];
    if (curve->size > 3) grid.scale = (dehyst_real)(cells - 1) / (curve->knot[curve->size - 2] - curve->knot[1]);
    if (!is_finite(grid.scale)) grid.scale = 0;
    return grid;
}

/* Return the segments of a curve as cells. */
static cell_grid segments_as_cells(const dehyst_curve *curve)
{
    cell_grid grid = {0, 0};
    if (curve == NULL || curve->size < 2) return grid;
    grid.origin = curve->knot[0];
    grid.scale = (curve->size - 1) / (curve->knot[curve->size - 1] - curve->knot[0]);
    if (!is_finite(grid.scale)) grid.scale = 0;
    return grid;
}

static int rounded_up(int n) { return (n + 3) / 4 * 4; }

static int larger(int a, int b) { return a > b ? a : b; }

/* Return the cell of a bend: the same operations as in a search. */
static int cell_of(const dehyst_curve *curve, int cells, int bend)
{
    const cell_grid grid = grid_of(curve, cells);
    const dehyst_real place = (curve->knot[bend] - grid.origin) * grid.scale;
    return place >= cells - 1 ? cells - 1 : (int)place;
}

/* Return whether each of so many cells has one bend of a curve at most. */
static int cells_fit(const dehyst_curve *curve, int cells)
{
    int j, last = -1;
    for (j = 1; j + 1 < curve->size; j++) {
        const int cell = cell_of(curve, cells, j);
        if (cell == last) return 0;
        last = cell;
    }
    return curve->size <= MOST_KNOTS;
}

/* Return how many cells the curves of a bank need; 0 if few bends are as well counted, or cells do not help. */
static int cells_for(const dehyst_bank_sizes *sizes, const dehyst_model *const *compensator)
{
    const int knots = larger(sizes->knots, sizes->bends);
    int cells, i, fit;
    if (knots < FEW_KNOTS) return 0;
    for (cells = knots; cells <= 8 * knots; cells *= 2) {
        for (i = 0, fit = 1; i < sizes->actuators && fit; i++) {
            const dehyst_actuator *a = &compensator[i]->actuator;
            fit = cells_fit(&a->plain.spring, cells) && cells_fit(&a->transformer, cells) &&
                  cells_fit(&a->inverse_transformer, cells);
        }
        if (fit) return cells;
    }
    return 0;
}

dehyst_bank_sizes dehyst_bank_sizes_of(int m, const dehyst_model *const *compensator)
{
    dehyst_bank_sizes sizes = {m, 0, 2, 0, 0, 0};
    int i;
    for (i = 0; i < m; i++) {
        const dehyst_actuator *actuator = &compensator[i]->actuator;
        sizes.elements = larger(sizes.elements, actuator->plain.slip.size);
        sizes.knots = larger(sizes.knots, actuator->plain.spring.size);
        sizes.branches = larger(sizes.branches, rounded_up(actuator->branches));
        sizes.bends = larger(sizes.bends, actuator->transformer.size);
    }
    sizes.cells = cells_for(&sizes, compensator);
    return sizes;
}

static long blocks_of(const dehyst_bank_sizes *sizes) { return (sizes->actuators + LANES - 1) / LANES; }

static long curve_size(int knots) { return knots > 0 ? LANES * (5L * knots + 4) : 0; }

block_sizes dehyst_block_sizes_of(const dehyst_bank_sizes *sizes)
{
    block_sizes block;
    block.elements = sizes->elements;
    block.branches = sizes->branches;
    block.memory = LANES * (2L * sizes->elements + sizes->branches + 5);
    block.table = LANES * (2L * sizes->elements + 3L * sizes->branches + 8);
    block.curves = curve_size(sizes->knots) + 2 * curve_size(sizes->bends);
    block.cells = (long)LANES * sizes->cells * (sizes->bends > 0 ? 3 : 1);
    return block;
}

int dehyst_blocks_together(const dehyst_bank_sizes *sizes)
{
    const block_sizes block = dehyst_block_sizes_of(sizes);
    /* Of the curves a sample touches few lines. */
    const long fit = NEAREST / (block.memory + (block.table + block.curves) / 4);
    return fit < 1 ? 1 : fit > GROUP ? GROUP : (int)fit;
}

long dehyst_bank_table_size(const dehyst_bank_sizes *sizes)
{
    const block_sizes block = dehyst_block_sizes_of(sizes);
    return (block.table + block.curves) * blocks_of(sizes);
}

long dehyst_bank_cells_size(const dehyst_bank_sizes *sizes)
{
    return dehyst_block_sizes_of(sizes).cells * blocks_of(sizes);
}

long dehyst_bank_blocks_size(const dehyst_bank_sizes *sizes)
{
    return blocks_of(sizes) * (long)sizeof(block_tables);
}

long dehyst_bank_work_size(const dehyst_bank_sizes *sizes)
{
    return GROUP * dehyst_block_sizes_of(sizes).memory + 2L * sizes->elements + sizes->branches + 1;
}

static block_curve curve_of(int knots, int cells, const dehyst_real **from, const unsigned char **before)
{
    block_curve curve;
    curve.size = knots;
    curve.equal = 0;
    curve.cells = cells;
    curve.bend = *from;
    curve.origin = *from + (long)LANES * knots;
    curve.scale = curve.origin + LANES;
    curve.first = curve.scale + LANES;
    curve.last = curve.first + LANES;
    curve.piece = curve.last + LANES;
    curve.before = *before;
    *from += curve_size(knots);
    *before += (long)LANES * cells;
    return curve;
}

static block_tables block_tables_of(const dehyst_bank *bank, int block)
{
    const dehyst_bank_sizes *sizes = &bank->sizes;
    const block_sizes one = dehyst_block_sizes_of(sizes);
    const dehyst_real *from = bank->table + block * one.table;
    const unsigned char *before = bank->cell + block * one.cells;
    const long elements = (long)LANES * sizes->elements, branches = (long)LANES * sizes->branches;
    block_tables t;
    t.elements = sizes->elements;
    t.branches = sizes->branches;
    t.rho = from;
    t.kappa = t.rho + elements;
    t.creep = t.kappa + elements;
    t.decay = t.creep + branches;
    t.gain = t.decay + branches;
    t.low = t.gain + branches;
    t.high = t.low + LANES;
    t.change = t.high + LANES;
    t.stiffness = t.change + LANES;
    t.bent = t.stiffness + LANES;
    t.tolerance = t.bent + LANES;
    t.far = t.tolerance + LANES;
    t.stiffest = t.far + LANES;
    from = bank->table + blocks_of(sizes) * one.table + block * one.curves;
    t.spring = curve_of(sizes->knots, sizes->cells, &from, &before);
    t.transformer = curve_of(sizes->bends, sizes->bends > 0 ? sizes->cells : 0, &from, &before);
    t.inverse = curve_of(sizes->bends, sizes->bends > 0 ? sizes->cells : 0, &from, &before);
    return t;
}

/* Fill a lane of a curve; NULL or no knots: the identity. Bends that a lane does not have are beyond every value. */
static void fill_curve(const block_curve *to, int l, const dehyst_curve *curve)
{
    dehyst_real *bend = (dehyst_real *)to->bend + l, *piece = (dehyst_real *)to->piece + (long)l * to->size * 4;
    unsigned char *before = (unsigned char *)to->before + (long)l * to->cells;
    const int size = curve != NULL ? curve->size : 0;
    const cell_grid grid = to->equal ? segments_as_cells(curve) : grid_of(curve, to->cells);
    int i, j;
    if (to->size == 0) return;
    for (j = 0; j < to->size; j++, piece += 4) {
        if (j + 2 < to->size) bend[(long)j * LANES] = j + 2 < size ? curve->knot[j + 1] : BEYOND;
        piece[0] = j + 1 < size ? curve->knot[j] : size == 0 ? 0 : BEYOND;
        piece[1] = j < size ? curve->value[j] : 0;
        piece[2] = j + 1 < size ? curve->slope[j] : 1;
        piece[3] = j + 2 < size ? curve->knot[j + 1] : BEYOND;
    }
    ((dehyst_real *)to->origin)[l] = grid.origin;
    ((dehyst_real *)to->scale)[l] = grid.scale;
    ((dehyst_real *)to->first)[l] = size > 0 ? curve->knot[0] : 0;
    ((dehyst_real *)to->last)[l] = size > 2 ? size - 2 : 0;
    for (i = 0; i < to->cells; i++) {
        int number = 0;
        for (j = 1; j + 1 < size; j++) number += cell_of(curve, to->cells, j) < i;
        before[i] = (unsigned char)number;
    }
}

/* Fill a row [LANES apart] with n values, and the rest of it with another. */
static void fill(const dehyst_real *to, int l, const dehyst_real *from, int n, int rows, dehyst_real rest)
{
    dehyst_real *row = (dehyst_real *)to + l;
    int i;
    for (i = 0; i < rows; i++) row[(long)i * LANES] = i < n ? from[i] : rest;
}

/* What a search goes by. */
typedef struct search_limits {
    dehyst_real tolerance, far, stiffest;
} search_limits;

static search_limits search_limits_of(const dehyst_model *c)
{
    const dehyst_slip *slip = &c->actuator.plain.slip;
    const dehyst_curve *spring = &c->actuator.plain.spring;
    const dehyst_real *value = spring->value, *knot = spring->knot;
    const int last = spring->size - 1;
    const dehyst_real length = slip->size > 0 ? slip->rho[slip->size - 1] : 0;
    search_limits limits;
    dehyst_real scale = magnitude(value[0]) + magnitude(value[last]);
    int i;
    limits.stiffest = c->stiffness + (value[last] - value[0]) / (knot[last] - knot[0]);
    for (i = 0; i < slip->size; i++) {
        scale += slip->kappa[i] * slip->rho[i];
        limits.stiffest += slip->kappa[i];
    }
    limits.tolerance = TOLERANCE * scale;
    limits.far = FAR * (magnitude(knot[0]) + magnitude(knot[last]) + length);
    return limits;
}

static void fill_lane(const block_tables *t, int l, const dehyst_model *c)
{
    const dehyst_slip *slip = c != NULL ? &c->actuator.plain.slip : NULL;
    const int n = c != NULL ? slip->size : 0, branches = c != NULL ? c->actuator.branches : 0;
    const dehyst_real most = DEHYST_LARGEST, zero = 0, one = 1;
    search_limits limits = {1, 1, 1};
    dehyst_real low = c != NULL ? c->low : -most, bent = c != NULL && c->actuator.transformer.size > 0 ? one : zero;
    if (c != NULL) limits = search_limits_of(c);
    fill(t->rho, l, n > 0 ? slip->rho : NULL, n, t->elements, BEYOND);
    fill(t->kappa, l, n > 0 ? slip->kappa : NULL, n, t->elements, 0);
    fill(t->creep, l, branches > 0 ? c->actuator.creep_stiffness : NULL, branches, t->branches, 0);
    fill(t->decay, l, branches > 0 ? c->step.decay : NULL, branches, t->branches, 0);
    fill(t->gain, l, branches > 0 ? c->step.gain : NULL, branches, t->branches, 0);
    fill(t->low, l, &low, 1, 1, 0);
    fill(t->high, l, c != NULL ? &c->high : &most, 1, 1, 0);
    fill(t->change, l, c != NULL ? &c->change : &most, 1, 1, 0);
    fill(t->stiffness, l, c != NULL ? &c->stiffness : &zero, 1, 1, 0);
    fill(t->bent, l, &bent, 1, 1, 0);
    fill(t->tolerance, l, &limits.tolerance, 1, 1, 0);
    fill(t->far, l, &limits.far, 1, 1, 0);
    fill(t->stiffest, l, &limits.stiffest, 1, 1, 0);
    fill_curve(&t->spring, l, c != NULL ? &c->actuator.plain.spring : NULL);
    fill_curve(&t->transformer, l, c != NULL ? &c->actuator.transformer : NULL);
    fill_curve(&t->inverse, l, c != NULL ? &c->actuator.inverse_transformer : NULL);
}

void dehyst_bank_tabulate(dehyst_bank *bank, dehyst_real *table, unsigned char *cell, void *block)
{
    const int m = bank->sizes.actuators;
    block_tables *t = block;
    int b, l;
    bank->table = table;
    bank->cell = cell;
    bank->block = t;
    for (b = 0; b * LANES < m; b++, t++) {
        *t = block_tables_of(bank, b);
        t->spring.equal = t->spring.size >= FEW_KNOTS;
        for (l = b * LANES; l < m && l < (b + 1) * LANES; l++)
            t->spring.equal = t->spring.equal && has_equal_segments(&bank->compensator[l]->actuator.plain.spring);
        for (l = 0; l < LANES; l++) fill_lane(t, l, b * LANES + l < m ? bank->compensator[b * LANES + l] : NULL);
    }
}
