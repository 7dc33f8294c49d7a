#include "dehyst_bank.h"

int dehyst_bank_has_avx2(void)
{
#if defined(DEHYST_BUILD_AVX2) && (defined(__GNUC__) || defined(__clang__))
    return __builtin_cpu_supports("avx2") != 0;
#else
    return 0;
#endif
}

void dehyst_bank_compensate(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call)
{
    if (dehyst_bank_has_avx2())
        dehyst_bank_compensate_avx2(bank, state, call);
    else
        dehyst_bank_compensate_baseline(bank, state, call);
}

void dehyst_bank_simulate(const dehyst_bank *bank, const dehyst_bank_state *state, const dehyst_bank_call *call)
{
    if (dehyst_bank_has_avx2())
        dehyst_bank_simulate_avx2(bank, state, call);
    else
        dehyst_bank_simulate_baseline(bank, state, call);
}
