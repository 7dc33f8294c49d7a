// Many actuators in one call. No algorithm: tables and memory to the core, a share of the actuators to each thread.
#include "bank.h"

#include <algorithm>
#include <cstdint>
#include <thread>

#include <nanobind/stl/string.h>

#include "dehyst_bank.h"
#include "tables.h"

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Live = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Row = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Counts = nb::ndarray<int64_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Numbers that begin where a line of a cache does: lanes then never lie in two.
class Lines {
  public:
    explicit Lines(size_t size = 0) : numbers(size + LINE), begin(0) {
        const auto place = reinterpret_cast<uintptr_t>(numbers.data()) / sizeof(double);
        begin = (LINE - place % LINE) % LINE;
    }
    double *data() { return numbers.data() + begin; }

  private:
    static constexpr size_t LINE = 64 / sizeof(double);
    std::vector<double> numbers;
    size_t begin;
};

// Whether the core computes an actuator in lanes.
bool in_lanes(const Core &core) {
    return core.tables.grades.size == 0 && core.tables.smooth.size == 0 && !core.tables.inertia && core.output.empty();
}

struct Bank {
    std::vector<double> decay, gain;
    Lines table;
    std::vector<unsigned char> cell;
    std::vector<void *> block;
    std::vector<dehyst_model> compensators;
    std::vector<const dehyst_model *> pointers;
    dehyst_bank bank{};
    double tap = 1;
    bool busy = false;

    // decay, gain: of all branches, one actuator after the other. limits: low, high and change in rows.
    Bank(nb::list cores, Input decay_, Input gain_, Rows limits) : decay(copy(decay_)), gain(copy(gain_)) {
        const size_t m = nb::len(cores);
        demand_size(m);
        if (m == 0 || limits.shape(0) != 3 || limits.shape(1) != m || gain.size() != decay.size())
            demand(DEHYST_ERR_SIZE);
        size_t branch = 0;
        for (size_t i = 0; i < m; i++) {
            const Core &core = nb::cast<const Core &>(cores[i]);
            if (!in_lanes(core) || branch + core.stiffness.size() > decay.size()) demand(DEHYST_ERR_SIZE);
            dehyst_step step{decay.data() + branch, gain.data() + branch, {}};
            branch += core.stiffness.size();
            dehyst_model model{};
            model.actuator = core.tables, model.step = step;
            model.low = limits(0, i), model.high = limits(1, i), model.change = limits(2, i);
            model.taps = 1, model.tap = &tap;
            compensators.push_back(model);
        }
        if (branch != decay.size()) demand(DEHYST_ERR_SIZE);
        for (dehyst_model &one : compensators) {
            demand(dehyst_model_tabulate(&one));
            pointers.push_back(&one);
        }
        bank.sizes = dehyst_bank_sizes_of(int(m), pointers.data());
        demand_size(m, size_t(bank.sizes.elements + bank.sizes.knots + bank.sizes.branches + bank.sizes.bends) * 8);
        bank.compensator = pointers.data();
        table = Lines(size_t(dehyst_bank_table_size(&bank.sizes)));
        cell.resize(size_t(dehyst_bank_cells_size(&bank.sizes)) + 1);
        block.resize(size_t(dehyst_bank_blocks_size(&bank.sizes)) / sizeof(void *) + 1);
        dehyst_bank_tabulate(&bank, table.data(), cell.data(), block.data());
    }
    Bank(const Bank &) = delete;

    static dehyst_bank_run *build(const std::string &name, bool plays) {
        if (name == "baseline") return plays ? dehyst_bank_simulate_baseline : dehyst_bank_compensate_baseline;
        if (name == "avx2" && dehyst_bank_has_avx2())
            return plays ? dehyst_bank_simulate_avx2 : dehyst_bank_compensate_avx2;
        return plays ? dehyst_bank_simulate : dehyst_bank_compensate;
    }

    // The memory is the caller's: y and sent (M,), carts (N, M), strains (J, M), counts (3, M) change in place.
    void run(Rows in, Live out, Row y, Live cart, Live strain, Row sent, Counts counts, int threads, bool plays,
             std::string name) {
        const size_t m = pointers.size(), n = in.shape(0);
        if (busy) throw std::runtime_error("this bank is running in another thread; give each thread its own");
        if (in.shape(1) != m || out.shape(0) != n || out.shape(1) != m || y.size() != m || sent.size() != m ||
            cart.shape(1) != m || strain.shape(1) != m || cart.shape(0) != size_t(bank.sizes.elements) ||
            strain.shape(0) > size_t(bank.sizes.branches) || counts.shape(0) != 3 || counts.shape(1) != m || threads < 1)
            demand(DEHYST_ERR_SIZE);
        long long *count = reinterpret_cast<long long *>(counts.data());
        const dehyst_bank_state state{long(m), int(cart.shape(0)), int(strain.shape(0)), y.data(), cart.data(),
                                      strain.data(), sent.data(), count, count + m, count + 2 * m};
        const size_t blocks = (m + DEHYST_LANES - 1) / DEHYST_LANES;
        const size_t work = (size_t(dehyst_bank_work_size(&bank.sizes)) + 7) / 8 * 8;
        const size_t shares = std::min(size_t(threads), blocks);
        Lines room(work * shares);
        dehyst_bank_run *function = build(name, plays);
        const auto share = [&](size_t k) {
            const size_t first = blocks * k / shares * DEHYST_LANES, end = blocks * (k + 1) / shares * DEHYST_LANES;
            const dehyst_bank_call call{int(first),   int(std::min(end, m)), long(n), long(m), long(m), in.data(),
                                        out.data(), room.data() + work * k};
            function(&bank, &state, &call);
        };
        busy = true;
        {
            nb::gil_scoped_release release;
            std::vector<std::thread> others;
            for (size_t k = 1; k < shares; k++) others.emplace_back(share, k);
            share(0);
            for (std::thread &other : others) other.join();
        }
        busy = false;
    }

    // Rows of carts and of strains that the memory has.
    std::tuple<int, int> rows() const {
        size_t branches = 0;
        for (const dehyst_model &one : compensators) branches = std::max(branches, size_t(one.actuator.branches));
        return {bank.sizes.elements, int(branches)};
    }
};

} // namespace

void bind_bank(nb::module_ &m) {
    nb::class_<Bank>(m, "Bank")
        .def(nb::init<nb::list, Input, Input, Rows>(), nb::keep_alive<1, 2>())
        .def("run", &Bank::run)
        .def("rows", &Bank::rows);
    m.def("in_lanes", &in_lanes);
    m.def("has_avx2", [] { return dehyst_bank_has_avx2() != 0; });
}
