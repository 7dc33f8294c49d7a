/* dehyst: many actuators at once, for the Python package. An export contains dehyst.h, and nothing that is declared
 * here.
 *
 * Plain elements, a spring, a transformer and creep are computed in lanes, an actuator a lane: the same operations in
 * the same order as dehyst_loop_step and dehyst_loop_play, and so the same bits, on every processor. A lane whose
 * voltage is clamped, whose input is not a number, or whose solution lies within rounding of a bend, takes its step in
 * dehyst_loop_step itself.
 */
#ifndef DEHYST_BANK_H
#define DEHYST_BANK_H

#include "dehyst_model.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Actuators that are computed together. */
#define DEHYST_LANES 8

/* Sizes of the largest actuator of a bank. */
typedef struct dehyst_bank_sizes {
    int actuators; /* M */
    int elements;  /* N */
    int knots;     /* of the spring */
    int branches;  /* J of creep, rounded up to a multiple of 4 */
    int bends;     /* knots of the transformer; 0: no actuator has one */
    int cells;     /* in which bends are looked up; 0: they are counted */
} dehyst_bank_sizes;

/* Where the tables of a block of lanes are; private to the core. */
struct dehyst_block;

/* Tables of M actuators. All were checked by dehyst_model_tabulate; they have neither grades nor smooth elements,
 * no inertia, no lag and one tap of 1. */
typedef struct dehyst_bank {
    dehyst_bank_sizes sizes;
    const dehyst_model *const *compensator; /* [M] */
    const dehyst_real *table;                     /* [dehyst_bank_table_size] from dehyst_bank_tabulate */
    const unsigned char *cell;                    /* [dehyst_bank_cells_size] from dehyst_bank_tabulate */
    const struct dehyst_block *block;             /* [dehyst_bank_blocks_size bytes] from dehyst_bank_tabulate */
} dehyst_bank;

/* Memory of M actuators, an actuator a column. */
typedef struct dehyst_bank_state {
    long columns;           /* from one row to the next, >= M */
    int elements, branches; /* rows */
    dehyst_real *y;         /* [M] w [m] */
    dehyst_real *cart;      /* [elements columns] [m] */
    dehyst_real *strain;    /* [branches columns] [m] */
    dehyst_real *sent;      /* [M] the last voltages */
    long long *limited, *slewed, *refused; /* [columns] numbers of samples */
} dehyst_bank_state;

/* Return the sizes that hold M actuators. */
dehyst_bank_sizes dehyst_bank_sizes_of(int m, const dehyst_model *const *compensator);
/* Return how many numbers the tables have. */
long dehyst_bank_table_size(const dehyst_bank_sizes *sizes);
long dehyst_bank_cells_size(const dehyst_bank_sizes *sizes);
long dehyst_bank_blocks_size(const dehyst_bank_sizes *sizes);
/* Compute the tables.
 * @param bank its sizes and compensators are given, the rest is the result
 * @param table [dehyst_bank_table_size]
 * @param cell [dehyst_bank_cells_size]
 * @param block [dehyst_bank_blocks_size bytes], aligned as a pointer */
void dehyst_bank_tabulate(dehyst_bank *bank, dehyst_real *table, unsigned char *cell, void *block);
/* Return how many numbers a call works in. */
long dehyst_bank_work_size(const dehyst_bank_sizes *sizes);

/* A call for actuators `first` to `end` - 1; `first` is a multiple of DEHYST_LANES. */
typedef struct dehyst_bank_call {
    int first, end;
    long samples;           /* n */
    long in_row, out_row;   /* numbers from one sample to the next in `in` and `out` */
    const dehyst_real *in;  /* [n in_row] */
    dehyst_real *out;       /* [n out_row] */
    dehyst_real *work;      /* [dehyst_bank_work_size] */
} dehyst_bank_call;

typedef void dehyst_bank_run(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call);

/* Wanted displacements to voltages, within limits and slew rate, as dehyst_loop_step does. */
dehyst_bank_run dehyst_bank_compensate;
/* Voltages to displacements w, as dehyst_loop_play does. */
dehyst_bank_run dehyst_bank_simulate;

/* The builds of both, for tests and benchmarks; dehyst_bank_compensate chooses once. AVX2's may be called where
 * dehyst_bank_has_avx2 returns 1. */
dehyst_bank_run dehyst_bank_compensate_baseline, dehyst_bank_simulate_baseline;
dehyst_bank_run dehyst_bank_compensate_avx2, dehyst_bank_simulate_avx2;
int dehyst_bank_has_avx2(void);

#ifdef __cplusplus
}
#endif
#endif
