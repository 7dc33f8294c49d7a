#include "loop.h"

#include <cmath>

#include "tables.h"

namespace {

// The memory of a loop as one row of numbers, so that it can be saved, restored and compared bit for bit.
struct Loop {
    const Wide &wide;
    std::vector<double> decay, gain, tap, inputs, spare;
    std::unique_ptr<Wide::Memory> memory;
    dehyst_compensator compensator{};
    dehyst_loop loop{};
    nb::object on_clamp;
    bool reported[2] = {false, false};
    bool busy = false;

    // numbers: low, high, change, lag, keep, from_old, from_new.
    Loop(const Wide &wide_, Input decay_, Input gain_, Input transition, Input tap_, Input numbers,
         nb::object on_clamp_)
        : wide(wide_), decay(copy(decay_)), gain(copy(gain_)), tap(copy(tap_)), inputs(tap.size()),
          spare(wide.base.rho.size()), on_clamp(on_clamp_) {
        const bool inertia = wide.tables.inertia;
        if (decay.size() != wide.stiffness.size() || gain.size() != decay.size() || numbers.size() != 7 ||
            transition.size() != (inertia ? 8 : 0))
            demand(DEHYST_ERR_SIZE);
        const double *row = transition.data(), *x = numbers.data();
        dehyst_step step{decay.data(), gain.data(), {}};
        if (inertia) step.transition = {{row[0], row[1], row[2], row[3]}, {row[4], row[5]}, {row[6], row[7]}};
        compensator = {wide.tables, step, x[0], x[1], x[2], int(tap.size()), tap.data(), x[3], x[4], x[5], x[6], 0};
        demand(dehyst_compensator_tabulate(&compensator));
    }
    Loop(const Loop &) = delete;

    void begin(double w, Input cart, Input strain, Input motion) {
        demand_idle();
        auto begun = wide.memory(w, cart, strain, motion);
        dehyst_loop fresh{};
        fresh.state = begun->state;
        fresh.inputs = inputs.data();
        fresh.candidate.cart = spare.data();
        demand(dehyst_loop_begin(&compensator, &fresh));
        loop = fresh;
        memory = std::move(begun);
    }

    // A clamp is reported before the voltage counts as sent, once of each kind: the listener may still raise.
    void check_offer(double u) {
        if (loop.offer == DEHYST_REFUSED) {
            loop.offer = DEHYST_NOTHING;
            throw CoreError("the wanted displacement is not a finite number");
        }
        if (loop.offer == DEHYST_LIMITED || loop.offer == DEHYST_SLEWED) report(loop.offer == DEHYST_SLEWED, u);
    }
    void report(bool slewed, double u) {
        if (reported[slewed]) return;
        on_clamp(slewed, u, loop.voltage);
        reported[slewed] = true;
    }

    double offer(double u) {
        demand_free();
        const double v = dehyst_loop_offer(&compensator, &loop, u);
        if (loop.offer != DEHYST_CANDIDATE) check_offer(u);
        return v;
    }
    void commit(double v) {
        demand_free();
        if (!dehyst_loop_accepts(&compensator, v)) throw CoreError("nothing like the limits");
        dehyst_loop_commit(&compensator, &loop, v);
    }
    double step(double u) {
        const double v = offer(u);
        dehyst_loop_commit(&compensator, &loop, v);
        return v;
    }
    // Another thread may request a step while the interpreter lock is released: that raises.
    struct Busy {
        bool &flag;
        explicit Busy(bool &flag_) : flag(flag_) { flag = true; }
        ~Busy() { flag = false; }
    };
    void demand_idle() const {
        if (busy) throw std::runtime_error("this compensator is running in another thread; give each thread its own");
    }
    void demand_free() const {
        demand_idle();
        if (!memory) throw std::runtime_error("this loop has not begun");
    }

    Output run(Input u) {
        demand_free();
        const size_t n = u.size();
        std::unique_ptr<double[]> out(new double[n + 1]);
        const double *source = u.data();
        {
            const Busy mark(busy);
            nb::gil_scoped_release release;
            dehyst_loop_run(&compensator, &loop, source, out.get(), long(n));
        }
        return own<Output>(std::move(out), {n});
    }
    // One column of a path of many, (n, M): wanted displacements to voltages, or voltages to displacements.
    using Columns = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
    void run_column(nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu> in, Columns out,
                    size_t column, bool plays) {
        demand_free();
        const size_t n = in.shape(0), row = in.shape(1);
        if (out.shape(0) != n || out.shape(1) != row || column >= row) demand(DEHYST_ERR_SIZE);
        const double *from = in.data() + column;
        double *to = out.data() + column;
        const Busy mark(busy);
        nb::gil_scoped_release release;
        for (size_t t = 0; t < n; t++, from += row, to += row) {
            if (plays) {
                dehyst_loop_play(&compensator, &loop, *from);
                *to = wide.tables.inertia ? loop.state.y : loop.state.memory.y;
            } else {
                *to = dehyst_loop_step(&compensator, &loop, *from);
            }
        }
    }
    // Voltages, where each leads, and what was on offer.
    std::tuple<Output, Output, Output> trace(Input u) {
        demand_free();
        const size_t n = u.size();
        std::unique_ptr<double[]> v(new double[n + 1]), w(new double[n + 1]), offers(new double[n + 1]);
        for (size_t t = 0; t < n; t++) {
            v[t] = dehyst_loop_offer(&compensator, &loop, u.data()[t]);
            offers[t] = loop.offer;
            dehyst_loop_commit(&compensator, &loop, v[t]);
            w[t] = loop.state.memory.y;
        }
        return {own<Output>(std::move(v), {n}), own<Output>(std::move(w), {n}), own<Output>(std::move(offers), {n})};
    }

    // Every number that a step reads, as the core made it.
    nb::dict tables() const {
        const dehyst_compensator &c = compensator;
        const double *phi = c.step.transition.phi, *before = c.step.transition.before, *after = c.step.transition.after;
        const Core &base = wide.base;
        nb::dict found;
        auto put = [&](const char *name, const std::vector<double> &values) { found[name] = as_array(values); };
        put("rho", base.rho), put("kappa", base.kappa);
        put("knot", base.knot), put("value", base.value), put("slope", base.slope);
        put("grade_knot", wide.grade_knot), put("grade_value", wide.grade_value), put("grade_slope", wide.grade_slope);
        put("tau_voltage", wide.tau_voltage), put("tau_drive", wide.tau_drive);
        put("tau_slope", wide.tau_slope), put("tau_inverse", wide.tau_inverse);
        put("creep", wide.stiffness), put("decay", decay), put("gain", gain);
        put("length", wide.length), put("back", wide.back), put("smooth", wide.smooth);
        put("tap", tap);
        if (wide.tables.inertia) {
            put("inertia", {wide.tables.series, wide.tables.share});
            put("transition", {phi[0], phi[1], phi[2], phi[3], before[0], before[1], after[0], after[1]});
        } else {
            put("inertia", {}), put("transition", {});
        }
        put("loop", {c.low, c.high, c.change, c.lag, c.keep, c.from_old, c.from_new, c.stiffness});
        return found;
    }

    double sent() const { return loop.sent; }
    std::tuple<unsigned long, unsigned long, unsigned long> counts() const {
        return {loop.limited, loop.slewed, loop.refused};
    }
    std::tuple<double, Output, Output, Output> state() const {
        demand_free();
        const std::vector<double> motion{loop.state.y, loop.state.rate};
        const double *cart = loop.state.memory.cart;
        return {loop.state.memory.y, as_array({cart, cart + spare.size()}), as_array(memory->strain),
                as_array(wide.tables.inertia ? motion : std::vector<double>())};
    }

    // What a state lacks to go on bit for bit: amplifier, mass and what was inputs.
    Output rest() const {
        demand_free();
        std::vector<double> row{loop.sent,        loop.acting,      loop.intended[0],
                                loop.intended[1], loop.state.input, loop.state.rate};
        row.insert(row.end(), inputs.begin(), inputs.end());
        return as_array(row);
    }
    void go_on(Input row, unsigned long limited, unsigned long slewed, unsigned long refused) {
        demand_free();
        if (row.size() != 6 + inputs.size()) demand(DEHYST_ERR_SIZE);
        for (size_t i = 0; i < row.size(); i++)
            if (!std::isfinite(row(i))) demand(DEHYST_ERR_FINITE);
        // The push and the velocity of a mass, as `dehyst_check` bounds its place.
        const double farthest = 1 / DEHYST_EPSILON / DEHYST_EPSILON;
        if (std::fabs(row(4)) > farthest || std::fabs(row(5)) > farthest) demand(DEHYST_ERR_FINITE);
        loop.sent = row(0), loop.acting = row(1), loop.intended[0] = row(2), loop.intended[1] = row(3);
        loop.state.input = row(4), loop.state.rate = row(5);
        std::copy(row.data() + 6, row.data() + row.size(), inputs.begin());
        loop.limited = limited, loop.slewed = slewed, loop.refused = refused;
        loop.offer = DEHYST_NOTHING;
    }

    // All that decides what comes next, and nothing that does not, one number after the other.
    template <typename Visit> void visit(Visit each) {
        each(loop.state.memory.y);
        for (size_t i = 0; i < spare.size(); i++) each(loop.state.memory.cart[i]);
        for (double &one : memory->strain) each(one);
        if (wide.tables.inertia) each(loop.state.y), each(loop.state.rate), each(loop.state.input);
        each(loop.sent);
        if (compensator.lag > 0) each(loop.acting), each(loop.intended[0]), each(loop.intended[1]);
        for (size_t m = 0; m + 1 < inputs.size(); m++) each(inputs[m]);
    }
    Output row() {
        demand_free();
        std::vector<double> out;
        visit([&](double one) { out.push_back(one); });
        return as_array(out);
    }
    void place(Input row) {
        demand_free();
        size_t size = 0, finite = 0;
        visit([&](double) { size++; });
        if (row.size() != size) demand(DEHYST_ERR_SIZE);
        for (size_t i = 0; i < size; i++) finite += std::isfinite(row(i));
        if (finite < size) demand(DEHYST_ERR_FINITE);
        const double *next = row.data();
        visit([&](double &one) { one = *next++; });
        loop.offer = DEHYST_NOTHING;
        demand(dehyst_check(&wide.tables, &loop.state));
    }

    // Functions of a row: what was in the loop before does not count, what is in it after is of no use.
    double offered(Input row, double u) {
        place(row);
        const double v = dehyst_loop_offer(&compensator, &loop, u);
        if (loop.offer == DEHYST_REFUSED) check_offer(u);
        return v;
    }
    Output stepped(Input row_, double u) {
        place(row_);
        step(u);
        return row();
    }
    // A voltage that leads farther than can be computed is counted only.
    void follow(double v) {
        const unsigned long refused = loop.refused;
        commit(v);
        if (loop.refused != refused) throw CoreError("a voltage that leads farther than can be computed");
    }
    double reached(Input row, double v) {
        place(row);
        follow(v);
        return wide.tables.inertia ? loop.state.y : loop.state.memory.y;
    }
    Output moved(Input row_, double v) {
        place(row_);
        follow(v);
        return row();
    }
};

// A float, or NumPy's; what has to be converted first may have a unit, even if it is derived from them.
double plain(nb::handle number) {
    static PyObject *numpys = nb::object(nb::module_::import_("numpy").attr("float64")).release().ptr();
    PyObject *type = reinterpret_cast<PyObject *>(Py_TYPE(number.ptr()));
    if (!PyFloat_CheckExact(number.ptr()) && type != numpys) throw nb::type_error("need a float");
    return PyFloat_AsDouble(number.ptr());
}

} // namespace

void bind_loop(nb::module_ &m) {
    nb::class_<Loop>(m, "Loop")
        .def(nb::init<const Wide &, Input, Input, Input, Input, Input, nb::object>(), nb::keep_alive<1, 2>())
        .def("begin", &Loop::begin)
        .def("offer", [](Loop &loop, nb::handle u) { return loop.offer(plain(u)); })
        .def("commit", &Loop::commit)
        .def("step", [](Loop &loop, nb::handle u) { return loop.step(plain(u)); })
        .def("run", &Loop::run)
        .def("run_column", &Loop::run_column)
        .def("trace", &Loop::trace)
        .def("tables", &Loop::tables)
        .def("sent", &Loop::sent)
        .def("counts", &Loop::counts)
        .def("state", &Loop::state)
        .def("rest", &Loop::rest)
        .def("go_on", &Loop::go_on)
        .def("row", &Loop::row)
        .def("place", &Loop::place)
        .def("offered", &Loop::offered)
        .def("stepped", &Loop::stepped)
        .def("reached", &Loop::reached)
        .def("moved", &Loop::moved);
}
