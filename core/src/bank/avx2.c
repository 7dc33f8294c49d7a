/* The bank for x86-64 processors with AVX2. Without fused multiply-add: the bits are those of the other build. */
#if defined(__AVX2__)
#define BUILD(name) name##_avx2
#include "run.h"
#else
#include "dehyst_bank.h"

void dehyst_bank_compensate_avx2(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call)
{
    dehyst_bank_compensate_baseline(bank, state, call);
}

void dehyst_bank_simulate_avx2(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call)
{
    dehyst_bank_simulate_baseline(bank, state, call);
}
#endif
