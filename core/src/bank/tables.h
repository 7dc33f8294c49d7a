/* The tables of a bank in blocks of lanes; private to the bank. */
#ifndef DEHYST_BANK_TABLES_H
#define DEHYST_BANK_TABLES_H

#include "internal.h"
#include "dehyst_bank.h"

/* Most blocks that are computed together, and the numbers that their nearest cache holds. */
#define GROUP 8
#define NEAREST 1500

/* Numbers of one block. */
typedef struct block_sizes {
    int elements, branches;
    long memory, table, curves, cells; /* `table` without curves, which lie behind the tables of all blocks */
} block_sizes;

/* LANES curves. A lane with fewer knots has further ones beyond every value.
 *
 * Where all lanes have equal segments, these are found by division: (x - origin) scale. Many other knots are found by
 * equal cells of x, each with one bend at most: cell (x - origin) scale, of which is stored how many bends lie before
 * it. Rounding does not disturb, as it keeps the order of numbers. */
typedef struct block_curve {
    int size, equal, cells;     /* cells 0: bends are counted one by one */
    const dehyst_real *bend;    /* [size - 2, LANES] the inner knots */
    const dehyst_real *origin, *scale; /* [LANES] */
    const dehyst_real *first, *last; /* [LANES] the first knots, and the numbers of the last segments */
    const dehyst_real *piece;   /* [LANES, size, 4] knot, value and slope of a segment, and the bend that ends it */
    const unsigned char *before; /* [LANES, cells] */
} block_curve;

/* The tables of one block, an actuator a lane. */
typedef struct dehyst_block {
    int elements, branches;
    const dehyst_real *rho, *kappa;                    /* [elements LANES] */
    const dehyst_real *creep, *decay, *gain;           /* [branches LANES] */
    const dehyst_real *low, *high, *change, *stiffness; /* [LANES] */
    const dehyst_real *bent;                           /* [LANES] whether there is a transformer */
    const dehyst_real *tolerance, *far, *stiffest;      /* [LANES] of a search [V, m, V/m] */
    block_curve spring, transformer, inverse;
} block_tables;

block_sizes dehyst_block_sizes_of(const dehyst_bank_sizes *sizes);
/* Return how many blocks are computed together. */
int dehyst_blocks_together(const dehyst_bank_sizes *sizes);

#endif
