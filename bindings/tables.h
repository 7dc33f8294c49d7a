// An actuator's tables and memory, owned by C++ for the length of a call or of a loop.
#ifndef DEHYST_TABLES_H
#define DEHYST_TABLES_H

#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "arrays.h"
#include "dehyst_records.h"

using Grid = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Bounds = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

class CoreError : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

inline void demand(dehyst_status status) {
    if (status != DEHYST_OK) throw CoreError(dehyst_status_text(status));
}

// Sizes that the core's int holds, also where tables have rows and columns.
constexpr size_t LARGEST_TABLE = size_t(1) << 28;
inline void demand_size(size_t rows, size_t columns = 1) {
    if (columns > 0 && rows > LARGEST_TABLE / columns) throw CoreError("tables larger than the core can index");
}

// An actuator of any parts; the C functions choose the fast path of those that it has.
struct Core {
    std::vector<double> rho, kappa, knot, value, slope, edge, intercept, slip_stiffness;
    std::vector<double> grade_knot, grade_value, grade_slope, tau_voltage, tau_drive, tau_slope, tau_inverse;
    std::vector<double> length, back, smooth, output;
    dehyst_actuator tables{};

    Core(Input rho_, Input kappa_, Input knot_, Input value_, Input grade_knot_, Input grades, Input tau_voltage_,
         Input tau_drive_, Input inertia, Input length_, Input closing, Input smooth_,
         Input output_)
        : rho(copy(rho_)), kappa(copy(kappa_)), knot(copy(knot_)), value(copy(value_)), grade_knot(copy(grade_knot_)),
          grade_slope(copy(grades)), tau_voltage(copy(tau_voltage_)), tau_drive(copy(tau_drive_)),
          length(copy(length_)), back(length.size()), smooth(copy(smooth_)),
          output(copy(output_)) {
        const size_t n = rho.size(), m = grade_knot.empty() ? 0 : grade_knot.size() - 1;
        demand_size(n + 1, m + 1), demand_size(knot.size()), demand_size(tau_voltage.size());
        demand_size(length.size()), demand_size(output.size());
        if (kappa.size() != n || value.size() != knot.size() || knot.size() < 2 || grade_slope.size() != n * m ||
            tau_voltage.size() != tau_drive.size() || closing.size() != length.size() ||
            smooth.size() != length.size() || (inertia.size() != 0 && inertia.size() != 2))
            demand(DEHYST_ERR_SIZE);
        tabulate_elements(int(n), int(m));
        tabulate_transformer(int(tau_voltage.size()));
        tables.inertia = inertia.size() > 0;
        if (tables.inertia) tables.series = inertia(0), tables.share = inertia(1);
        demand(dehyst_smooth_tabulate(int(length.size()), length.data(), closing.data(), back.data()));
        tables.smooth = {int(length.size()), length.data(), back.data(), smooth.data()};
    }
    Core(const Core &) = delete;

    void tabulate_elements(int n, int m) {
        slope.resize(knot.size() - 1);
        edge.resize(n + 1), intercept.resize(n + 1), slip_stiffness.resize(n + 1);
        double inverse_step = 0;
        demand(dehyst_curve_tabulate(int(knot.size()), knot.data(), value.data(), slope.data()));
        demand(dehyst_slip_tabulate(n, rho.data(), kappa.data(), edge.data(), intercept.data(), slip_stiffness.data(),
                                    &inverse_step));
        tables.plain.slip = {n, rho.data(), kappa.data(), edge.data(), intercept.data(), slip_stiffness.data(),
                             inverse_step};
        tables.plain.spring = {int(knot.size()), knot.data(), value.data(), slope.data()};
        if (m == 0) return;
        grade_slope.resize(size_t(n + 1) * m), grade_value.resize(size_t(n + 1) * (m + 1));
        demand(dehyst_grades_tabulate(n, m, grade_knot.data(), grade_slope.data(), grade_value.data()));
        tables.grades = {m, grade_knot.data(), grade_value.data(), grade_slope.data()};
    }
    void tabulate_transformer(int k) {
        if (k == 0) return;
        tau_slope.resize(k), tau_inverse.resize(k);
        demand(dehyst_curve_tabulate(k, tau_voltage.data(), tau_drive.data(), tau_slope.data()));
        demand(dehyst_curve_tabulate(k, tau_drive.data(), tau_voltage.data(), tau_inverse.data()));
        tables.transformer = {k, tau_voltage.data(), tau_drive.data(), tau_slope.data()};
        tables.inverse_transformer = {k, tau_drive.data(), tau_voltage.data(), tau_inverse.data()};
    }

    // In one array: the elongations of smooth elements, and strains behind the elements.
    size_t strains_size() const { return length.size() + output.size(); }
    struct Memory {
        std::vector<double> cart, strain;
        dehyst_state state;
    };

    std::unique_ptr<Memory> memory(double w, Input cart, Input strain, Input motion) const {
        auto own_memory = std::make_unique<Memory>();
        own_memory->cart = copy(cart), own_memory->strain = copy(strain);
        if (own_memory->cart.size() != rho.size() ||
            own_memory->strain.size() != strains_size() || motion.size() != (tables.inertia ? 2 : 0))
            demand(DEHYST_ERR_SIZE);
        own_memory->state = {{w, own_memory->cart.data()}, own_memory->strain.data(), 0, 0, 0};
        if (tables.inertia) own_memory->state.y = motion(0), own_memory->state.rate = motion(1);
        demand(dehyst_check(&tables, &own_memory->state));
        return own_memory;
    }

    struct Workspace {
        std::vector<dehyst_reversal> reversals;
        std::vector<double> value, slope, at_cart, along;
        std::vector<int> segment;
        dehyst_workspace workspace;

        Workspace(size_t elements, size_t knots, size_t smooth, bool stack)
            : reversals(stack ? DEHYST_STACK_CAPACITY(elements) : 0), value(knots), slope(knots), at_cart(elements),
              along(2 * smooth + 1), segment(elements) {
            workspace = {{int(reversals.size()), 0, 1, 0, 0, stack ? reversals.data() : nullptr},
                    value.data(), slope.data(), at_cart.data(), segment.data(), along.data()};
        }
        Workspace(const Workspace &) = delete;
    };

    // Runs of equal steps: samples bounds[r] to bounds[r + 1] take steps of row r; decay and gain are of creep behind the
    // elements.
    struct Steps {
        Bounds bounds;
        Grid decay, gain, transition;

        size_t size(size_t samples, size_t branches, bool inertia) const {
            const size_t r = bounds.size() ? bounds.size() - 1 : 0;
            bool fit = bounds.size() > 0 && bounds(0) == 0 && bounds(r) == int64_t(samples) && decay.shape(0) == r &&
                       gain.shape(0) == r && transition.shape(0) == r && decay.shape(1) == branches &&
                       gain.shape(1) == branches && transition.shape(1) == (inertia ? 8 : 0);
            for (size_t i = 0; fit && i < r; i++) fit = bounds(i) <= bounds(i + 1);
            if (!fit) demand(DEHYST_ERR_SIZE);
            return r;
        }
        const double *decay_of(size_t r) const { return decay.data() + r * decay.shape(1); }
        const double *gain_of(size_t r) const { return gain.data() + r * gain.shape(1); }
        dehyst_transition at(size_t r) const {
            if (transition.shape(1) != 8) return {};
            const double *row = transition.data() + 8 * r;
            return {{row[0], row[1], row[2], row[3]}, {row[4], row[5]}, {row[6], row[7]}};
        }
        long first(size_t r) const { return long(bounds(r)); }
        long length(size_t r) const { return long(bounds(r + 1) - bounds(r)); }
    };

    using Reached = std::tuple<Output, double, Output, Output, Output>;

    Reached reached(Output out, const Memory &after) const {
        const std::vector<double> motion{after.state.y, after.state.rate};
        return {out, after.state.memory.y, as_array(after.cart), as_array(after.strain),
                as_array(tables.inertia ? motion : std::vector<double>())};
    }

    Reached compensate(Input in, Input extra, Bounds bounds, Grid decay, Grid gain, Grid transition, double w,
                       Input cart, Input strain, Input motion, bool stack) const {
        auto own_memory = memory(w, cart, strain, motion);
        const Steps steps{bounds, decay, gain, transition};
        const size_t n = in.size(), count = steps.size(n, output.size(), tables.inertia);
        if (extra.size() != 0 && extra.size() != n) demand(DEHYST_ERR_SIZE);
        Output out = room<Output>(n);
        const double *source = in.data(), *added = extra.size() ? extra.data() : nullptr;
        {
            nb::gil_scoped_release release;
            Workspace work(rho.size(), knot.size(), length.size(), stack);
            for (size_t r = 0; r < count; r++) {
                const long first = steps.first(r);
                dehyst_compensate_run(&tables, &own_memory->state, &work.workspace, source + first,
                                       added ? added + first : nullptr, out.data() + first, steps.length(r));
            }
        }
        return reached(out, *own_memory);
    }

    Reached simulate(Input in, Input load, Bounds bounds, Grid decay, Grid gain, Grid transition, double w, Input cart,
                     Input strain, Input motion, bool stack) const {
        auto own_memory = memory(w, cart, strain, motion);
        const Steps steps{bounds, decay, gain, transition};
        const size_t n = in.size(), count = steps.size(n, output.size(), tables.inertia);
        if (load.size() != 0 && load.size() != n) demand(DEHYST_ERR_SIZE);
        Output out = room<Output>(n);
        const double *source = in.data(), *force = load.size() ? load.data() : nullptr;
        {
            nb::gil_scoped_release release;
            Workspace work(rho.size(), knot.size(), length.size(), stack);
            for (size_t r = 0; r < count; r++) {
                const dehyst_transition step = steps.at(r);
                const long first = steps.first(r);
                dehyst_simulate_run(&tables, &step, &own_memory->state, &work.workspace, source + first,
                                     force ? force + first : nullptr, out.data() + first, steps.length(r));
            }
        }
        return reached(out, *own_memory);
    }

    double voltage(double w, Input cart, Input strain, Input motion) const {
        auto own_memory = memory(w, cart, strain, motion);
        return dehyst_voltage(&tables, &own_memory->state);
    }
    // Entries on the stack of reversals after a history.
    int depth(Input history, double w, Input cart) const {
        std::vector<double> own_cart = copy(cart), out(history.size() + 1);
        if (own_cart.size() != rho.size()) demand(DEHYST_ERR_SIZE);
        dehyst_plain_state state{w, own_cart.data()};
        demand(dehyst_plain_check(&tables.plain, &state));
        std::vector<dehyst_reversal> reversals(DEHYST_STACK_CAPACITY(rho.size()));
        dehyst_stack work{int(reversals.size()), 0, 1, 0, 0, reversals.data()};
        demand(dehyst_stack_encode(&tables.plain, &state, &work));
        dehyst_stack_compensate(&tables.plain, &work, history.data(), out.data(), long(history.size()));
        return work.depth;
    }
    double spring_at(double y) const { return dehyst_curve_at(&tables.plain.spring, y); }
    double spring_inverse(double v) const { return dehyst_curve_inverse(&tables.plain.spring, v); }
};

#endif
