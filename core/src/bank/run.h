/* Whole calls of a bank, compiled once for every instruction set. `BUILD(name)` is the name of a build's function. */
#ifndef BUILD
#error "define BUILD before including run.h"
#endif

#include "compensate.h"
#if defined(__AVX2__)
#include "simulate.h"
#else
/* Without registers for lanes a search in lanes takes longer than one after the other: each goes by itself. */
INLINE void simulate_block(const dehyst_bank *bank, const dehyst_bank_state *state, const block_tables *t,
                           block_memory *memory, int actuator, int width, const dehyst_real *restrict v,
                           dehyst_real *restrict y, dehyst_real *scratch)
{
    int l;
    (void)t;
    for (l = 0; l < width; l++) y[l] = by_itself(bank, state, memory, actuator + l, l, v[l], 1, scratch);
    exchange(memory);
}
#endif

/* Samples from the fetch of a row to its use. */
#define AHEAD 4
/* Samples that all groups take before the next ones. */
#define PART 128

/* Copy the columns of a block [rows columns] to `packed` [rows LANES], zeros in lanes that have no actuator. */
static void pack(const dehyst_real *from, long columns, int rows, int width, dehyst_real *packed)
{
    int i, l;
    for (i = 0; i < rows; i++, from += columns, packed += LANES) {
        if (width == LANES) {
            store(packed, load(from));
            continue;
        }
        for (l = 0; l < width; l++) packed[l] = from[l];
        for (; l < LANES; l++) packed[l] = 0;
    }
}

/* Fill the rows that a state does not have. */
static void pad(dehyst_real *packed, int rows, int all)
{
    int i;
    for (i = rows * LANES; i < all * LANES; i++) packed[i] = 0;
}

static void unpack(const dehyst_real *packed, int rows, int width, dehyst_real *to, long columns)
{
    int i, l;
    for (i = 0; i < rows; i++, to += columns, packed += LANES) {
        if (width == LANES)
            store(to, load(packed));
        else
            for (l = 0; l < width; l++) to[l] = packed[l];
    }
}

/* Return the packed memory of block b of a group, and exchange it with the state. */
static block_memory memory_of(const block_sizes *sizes, dehyst_real *work, int b)
{
    block_memory memory;
    memory.cart = work + b * sizes->memory;
    memory.after = memory.cart + (long)sizes->elements * LANES;
    memory.strain = memory.after + (long)sizes->elements * LANES;
    memory.y = memory.strain + (long)sizes->branches * LANES;
    memory.sent = memory.y + LANES;
    memory.held = memory.sent + LANES;
    memory.slope = memory.held + LANES;
    memory.direction = memory.slope + LANES;
    memory.holds = 0;
    store(memory.direction, all_of(0));
    return memory;
}

/* Fetch the rows of a sample into the cache: they lie too far apart for a processor to see that they follow. */
INLINE void fetch_rows(const dehyst_bank_call *call, long t, int first, int blocks)
{
    int b;
    if (t >= call->samples) return;
    for (b = 0; b < blocks; b++) {
        fetch(call->in + t * call->in_row + first + b * LANES);
        fetch_to_write(call->out + t * call->out_row + first + b * LANES);
    }
}

INLINE void run_group(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call,
                             int first, int blocks, block_step *step)
{
    const block_sizes sizes = dehyst_block_sizes_of(&bank->sizes);
    dehyst_real *scratch = call->work + GROUP * sizes.memory;
    const block_tables *tables = bank->block + first / LANES;
    block_memory memory[GROUP];
    int width[GROUP], b;
    long t;
    for (b = 0; b < blocks; b++) {
        const int m = first + b * LANES;
        width[b] = call->end - m < LANES ? call->end - m : LANES;
        memory[b] = memory_of(&sizes, call->work, b);
        pack(state->cart + m, state->columns, state->elements, width[b], memory[b].cart);
        pack(state->strain + m, state->columns, state->branches, width[b], memory[b].strain);
        pad(memory[b].strain, state->branches, sizes.branches);
        pack(state->y + m, 0, 1, width[b], memory[b].y);
        pack(state->sent + m, 0, 1, width[b], memory[b].sent);
    }
    for (t = 0; t < call->samples; t++) {
        const dehyst_real *in = call->in + t * call->in_row + first;
        fetch_rows(call, t + AHEAD, first, blocks);
        dehyst_real *out = call->out + t * call->out_row + first;
        for (b = 0; b < blocks; b++, in += LANES, out += LANES) {
            if (width[b] == LANES) {
                step(bank, state, &tables[b], &memory[b], first + b * LANES, LANES, in, out, scratch);
            } else {
                dehyst_real padded[LANES], result[LANES];
                pack(in, 0, 1, width[b], padded);
                step(bank, state, &tables[b], &memory[b], first + b * LANES, width[b], padded, result, scratch);
                unpack(result, 1, width[b], out, 0);
            }
        }
    }
    for (b = 0; b < blocks; b++) {
        const int m = first + b * LANES;
        unpack(memory[b].cart, state->elements, width[b], state->cart + m, state->columns);
        unpack(memory[b].strain, state->branches, width[b], state->strain + m, state->columns);
        unpack(memory[b].y, 1, width[b], state->y + m, 0);
        unpack(memory[b].sent, 1, width[b], state->sent + m, 0);
    }
}

/* Blocks are computed in groups whose memory stays in the nearest cache; all groups take some samples before the next
 * ones, as every row lies in another page. */
INLINE void run(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call,
                       block_step *step)
{
    const int together = dehyst_blocks_together(&bank->sizes);
    dehyst_bank_call part = *call;
    long done;
    int first;
    for (done = 0; done < call->samples; done += PART) {
        part.samples = call->samples - done < PART ? call->samples - done : PART;
        part.in = call->in + done * call->in_row;
        part.out = call->out + done * call->out_row;
        for (first = call->first; first < call->end; first += together * LANES) {
            const int left = (call->end - first + LANES - 1) / LANES;
            run_group(bank, state, &part, first, left < together ? left : together, step);
        }
    }
}

void BUILD(dehyst_bank_compensate)(const dehyst_bank *bank, const dehyst_bank_state *state,
                                   const dehyst_bank_call *call)
{
    run(bank, state, call, compensate_block);
}

void BUILD(dehyst_bank_simulate)(const dehyst_bank *bank, const dehyst_bank_state *state,
                                 const dehyst_bank_call *call)
{
    run(bank, state, call, simulate_block);
}
