#include "loop.h"

#include <algorithm>
#include <cmath>

#include "tables.h"

namespace {

// The memory of a loop as one row of numbers, so that it can be saved, restored and compared bit for bit.
struct Loop {
    // Samples of a block of `run`, and of the shortest path that is taken in blocks.
    static constexpr long BLOCK = 8192, SHORTEST = 1000;
    static constexpr double FARTHEST = 1 / DEHYST_EPSILON / DEHYST_EPSILON;
    const Core &core;
    std::vector<double> decay, gain, tap, memory, start;
    dehyst_model model{};
    dehyst_loop loop{};
    nb::object on_clamp, slow;
    bool reported[2] = {false, false};
    bool busy = false;
    double per_metre = 1; // of displacements that offer and step are given

    // numbers: low, high, change, lag, keep, from_old, from_new.
    Loop(const Core &core_, Input decay_, Input gain_, Input transition, Input tap_, Input numbers,
         nb::object on_clamp_)
        : core(core_), decay(copy(decay_)), gain(copy(gain_)), tap(copy(tap_)), on_clamp(on_clamp_) {
        const bool inertia = core.tables.inertia;
        if (decay.size() != core.output.size() || gain.size() != decay.size() || numbers.size() != 7 ||
            transition.size() != (inertia ? 8 : 0))
            demand(DEHYST_ERR_SIZE);
        const double *row = transition.data(), *x = numbers.data();
        dehyst_transition step{};
        if (inertia) step = {{row[0], row[1], row[2], row[3]}, {row[4], row[5]}, {row[6], row[7]}};
        model.actuator = core.tables, model.step = step;
        model.output = {int(core.output.size()), core.output.data(), decay.data(), gain.data(), 0, 0};
        model.low = x[0], model.high = x[1], model.change = x[2];
        model.taps = int(tap.size()), model.tap = tap.data();
        model.lag = x[3], model.keep = x[4], model.from_old = x[5], model.from_new = x[6];
        demand(dehyst_model_tabulate(&model));
    }
    Loop(const Loop &) = delete;

    // Numbers of a start: carts, elongations, strains behind the elements.
    void set_start(double w, Input cart, Input strain, Input motion) {
        const size_t n = core.rho.size();
        if (cart.size() != n || strain.size() != core.strains_size() || motion.size() != (model.actuator.inertia ? 2 : 0))
            demand(DEHYST_ERR_SIZE);
        start = copy(cart);
        start.insert(start.end(), strain.data(), strain.data() + strain.size());
        const double *elongation = start.data() + n;
        model.start = {w, w, 0, start.data(), elongation, elongation + core.length.size()};
        if (model.actuator.inertia) model.start.y = motion(0), model.start.rate = motion(1);
    }
    void begin(double w, Input cart, Input strain, Input motion) {
        demand_idle();
        set_start(w, cart, strain, motion);
        std::vector<double> room(dehyst_memory_size(&model));
        dehyst_loop fresh{};
        demand(dehyst_loop_begin(&model, &fresh, room.data()));
        loop = fresh;
        memory = std::move(room);
    }
    // The model as a block, with the start that it has there.
    nb::bytes block(double w, Input cart, Input strain, Input motion, double period, int ahead) {
        set_start(w, cart, strain, motion);
        model.period = period, model.ahead = ahead;
        std::vector<unsigned char> bytes(dehyst_model_save(&model, nullptr, 0));
        dehyst_model_save(&model, bytes.data(), bytes.size());
        return nb::bytes(reinterpret_cast<const char *>(bytes.data()), bytes.size());
    }
    // A snapshot as firmware writes it; the model needs its `id`, from block.
    nb::bytes save() const {
        demand_free();
        std::vector<unsigned char> bytes(DEHYST_SNAPSHOT(core.rho.size(), core.length.size(), core.output.size(), tap.size()));
        dehyst_loop_save(&model, &loop, memory.data(), bytes.data(), bytes.size());
        return nb::bytes(reinterpret_cast<const char *>(bytes.data()), bytes.size());
    }
    void restore(nb::bytes bytes) {
        demand_free();
        demand(dehyst_loop_restore(&model, &loop, memory.data(), reinterpret_cast<const unsigned char *>(bytes.c_str()),
                                   bytes.size()));
    }
    // Checksums of the model, from block: of all numbers, and of what the memory depends on.
    std::tuple<unsigned long, unsigned long> ids() const { return {model.id, model.shape}; }

    double *carts() { return memory.data() + (loop.half ? core.rho.size() : 0); }
    double *strains() { return memory.data() + 2 * core.rho.size(); }
    double *inputs() { return strains() + core.strains_size(); }

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
        on_clamp(slewed, u, loop.voltage, loop.sent);
        reported[slewed] = true;
    }

    double offer(double u) {
        demand_free();
        const double v = dehyst_loop_offer(&model, &loop, memory.data(), u);
        if (loop.offer != DEHYST_CANDIDATE) check_offer(u);
        return v;
    }
    void commit(double v) {
        demand_free();
        // From farther outside, the next step, which is within the limits, would exceed the slew rate.
        const bool returns = v - model.high <= model.change && model.low - v <= model.change;
        if (!returns || !dehyst_loop_accepts(&model, v)) throw CoreError("nothing like the limits");
        dehyst_loop_commit(&model, &loop, memory.data(), v);
    }
    double step(double u) {
        const double v = offer(u);
        dehyst_loop_commit(&model, &loop, memory.data(), v);
        return v;
    }
    void withdraw() {
        demand_free();
        loop.offer = DEHYST_NOTHING;
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
        if (memory.empty()) throw std::runtime_error("this loop has not begun");
    }

    // A block on the stack of reversals, which gives the voltages of steps up to rounding. Nothing has changed if it is
    // false: the loop has parts that such a block lacks, or a voltage is refused or clamped.
    bool run_block(const double *u, double *v, long n) {
        const dehyst_output &output = model.output;
        const size_t k = size_t(output.branches);
        if (model.lag > 0 || model.taps > 1 || model.actuator.inertia) return false;
        std::vector<double> cart(carts(), carts() + core.rho.size()), strain(strains(), inputs()), w(u, u + n);
        if (loop.gain != 1 || loop.offset != 0)
            for (double &one : w) one = (one - loop.offset) / loop.gain;
        double *behind = strain.data() + strain.size() - k;
        if (k > 0) dehyst_output_compensate(&output, behind, loop.driven, w.data(), w.data(), n);
        // Sums of what is wrong, which a compiler takes several samples at a time.
        int far = 0, refused = 0;
        for (long t = 0; t < n; t++) far += !(std::fabs(w[t]) <= FARTHEST);
        if (far) return false;
        dehyst_state state{{loop.w, cart.data()}, strain.data(), 0, 0, 0};
        Core::Workspace work(core.rho.size(), core.knot.size(), core.length.size(), true);
        dehyst_compensate_run(&model.actuator, &state, &work.workspace, w.data(), nullptr, v, n);
        for (long t = 0; t < n; t++) refused += !(v[t] >= model.low) | !(v[t] <= model.high);
        for (long t = 1; t < n; t++) refused += !(std::fabs(v[t] - v[t - 1]) <= model.change);
        if (refused || !(std::fabs(v[0] - loop.sent) <= model.change)) return false;
        std::copy(cart.begin(), cart.end(), carts());
        std::copy(strain.begin(), strain.end(), strains());
        loop.w = loop.wanted = loop.target = *inputs() = w[n - 1];
        if (k > 0) loop.driven = w[n - 1];
        loop.candidate = loop.voltage = loop.sent = v[n - 1];
        loop.offer = DEHYST_NOTHING;
        return true;
    }
    Output run(Input u) {
        demand_free();
        const long n = long(u.size());
        Output out = room<Output>(u.size());
        const double *source = u.data();
        {
            const Busy mark(busy);
            nb::gil_scoped_release release;
            for (long first = 0, count; first < n; first += count) {
                count = std::min(BLOCK, n - first);
                double *v = out.data() + first;
                if (n >= SHORTEST && run_block(source + first, v, count)) continue;
                dehyst_loop_run(&model, &loop, memory.data(), source + first, v, count);
            }
        }
        return out;
    }
    // Voltages, where each leads, and what was on offer.
    std::tuple<Output, Output, Output> trace(Input u) {
        demand_free();
        const size_t n = u.size();
        Output v = room<Output>(n), w = room<Output>(n), offers = room<Output>(n);
        for (size_t t = 0; t < n; t++) {
            v(t) = dehyst_loop_offer(&model, &loop, memory.data(), u.data()[t]);
            offers(t) = loop.offer;
            dehyst_loop_commit(&model, &loop, memory.data(), v(t));
            w(t) = displacement();
        }
        return {v, w, offers};
    }

    // Every number that a step reads, as the core made it.
    nb::dict tables() const {
        const dehyst_model &c = model;
        const double *phi = c.step.phi, *before = c.step.before, *after = c.step.after;
        nb::dict found;
        auto put = [&](const char *name, const std::vector<double> &values) { found[name] = as_array(values); };
        put("rho", core.rho), put("kappa", core.kappa);
        put("knot", core.knot), put("value", core.value), put("slope", core.slope);
        put("grade_knot", core.grade_knot), put("grade_value", core.grade_value), put("grade_slope", core.grade_slope);
        put("tau_voltage", core.tau_voltage), put("tau_drive", core.tau_drive);
        put("tau_slope", core.tau_slope), put("tau_inverse", core.tau_inverse);
        put("output_gain", core.output), put("output_decay", decay), put("output_rise", gain);
        put("output", {c.output.at_rest, c.output.at_once});
        put("length", core.length), put("back", core.back), put("smooth", core.smooth);
        put("tap", tap);
        if (core.tables.inertia) {
            put("inertia", {core.tables.series, core.tables.share});
            put("transition", {phi[0], phi[1], phi[2], phi[3], before[0], before[1], after[0], after[1]});
        } else {
            put("inertia", {}), put("transition", {});
        }
        put("loop", {c.low, c.high, c.change, c.lag, c.keep, c.from_old, c.from_new, c.stiffness});
        return found;
    }

    double sent() const { return loop.sent; }
    double displacement() const { return dehyst_loop_displacement(&model, &loop, memory.data()); }
    void scale(double gain, double offset) {
        demand_free();
        demand(dehyst_loop_scale(&loop, gain, offset));
    }
    std::tuple<unsigned long, unsigned long, unsigned long> counts() const {
        return {loop.limited, loop.slewed, loop.refused};
    }
    std::tuple<double, Output, Output, Output> state() {
        demand_free();
        const std::vector<double> motion{loop.y, loop.rate};
        return {loop.w, as_array({carts(), carts() + core.rho.size()}), as_array({strains(), inputs()}),
                as_array(core.tables.inertia ? motion : std::vector<double>())};
    }

    // What a state lacks to go on bit for bit: amplifier, mass and what was wanted.
    Output rest() {
        demand_free();
        std::vector<double> row{loop.sent, loop.acting, loop.intended[0], loop.intended[1],
                                loop.rate, loop.gain,   loop.offset,      loop.driven};
        row.insert(row.end(), inputs(), inputs() + tap.size());
        return as_array(row);
    }
    void go_on(Input row, unsigned long limited, unsigned long slewed, unsigned long refused) {
        demand_free();
        if (row.size() != 8 + tap.size()) demand(DEHYST_ERR_SIZE);
        for (size_t i = 0; i < row.size(); i++)
            if (!std::isfinite(row(i))) demand(DEHYST_ERR_FINITE);
        // As `dehyst_check` bounds the place of a mass.
        if (std::fabs(row(4)) > FARTHEST || std::fabs(row(7)) > FARTHEST) demand(DEHYST_ERR_FINITE);
        demand(dehyst_loop_scale(&loop, row(5), row(6)));
        loop.sent = row(0), loop.acting = row(1), loop.intended[0] = row(2), loop.intended[1] = row(3);
        loop.rate = row(4), loop.driven = row(7);
        std::copy(row.data() + 8, row.data() + row.size(), inputs());
        loop.limited = limited, loop.slewed = slewed, loop.refused = refused;
        loop.offer = DEHYST_NOTHING;
    }
};

// A float, or NumPy's; what has to be converted first may have a unit, even if it is derived from them.
double plain(nb::handle number) {
    static PyObject *numpys = nb::object(nb::module_::import_("numpy").attr("float64")).release().ptr();
    PyObject *type = reinterpret_cast<PyObject *>(Py_TYPE(number.ptr()));
    if (!PyFloat_CheckExact(number.ptr()) && type != numpys) throw nb::type_error("need a float");
    return PyFloat_AsDouble(number.ptr());
}

// An integral of the error ahead of a loop.
struct Feedback {
    Loop &loop;
    dehyst_feedback memory{};

    Feedback(Loop &loop_, double gain, double bound, int late) : loop(loop_) {
        loop.demand_free();
        demand(dehyst_feedback_begin(&loop.model, &loop.loop, loop.memory.data(), gain, bound, late, &memory));
    }
    // A reading that is not a number says nothing. A step that is refused changes nothing.
    double step(double wanted, double measured) {
        loop.demand_free();
        const dehyst_feedback before = memory;
        const dehyst_model *model = &loop.model;
        const double by = dehyst_feedback_correct(model, &loop.loop, loop.memory.data(), &memory, measured / loop.per_metre);
        try {
            return loop.step(wanted / loop.per_metre + by);
        } catch (...) {
            memory = before;
            throw;
        }
    }
};

// Why the sensor of a cycle is not believed, from what it should show [m] and shows; 0: it is.
int judge(Input expected, Input measured, double bound) {
    if (expected.size() != measured.size()) demand(DEHYST_ERR_SIZE);
    return dehyst_sensor_judge(expected.data(), measured.data(), long(expected.size()), bound);
}

// Loops with the same period. They belong to this bank alone.
struct Bank {
    std::vector<Loop *> loops;
    bool busy = false;

    explicit Bank(nb::list given) {
        for (nb::handle one : given) loops.push_back(&nb::cast<Loop &>(one));
    }

    using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
    using Live = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
    // One sample (M,) of voltages for wanted displacements; if one of them were clamped or refused, nothing is sent.
    bool step(Input in, nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu> out) {
        const size_t m = loops.size();
        if (busy) throw std::runtime_error("this bank is running in another thread; give each thread its own");
        if (in.size() != m || out.size() != m) demand(DEHYST_ERR_SIZE);
        bool free = true;
        for (size_t i = 0; i < m; i++) {
            Loop &loop = *loops[i];
            out.data()[i] = dehyst_loop_offer(&loop.model, &loop.loop, loop.memory.data(), in.data()[i]);
            free = free && loop.loop.offer == DEHYST_CANDIDATE;
        }
        for (size_t i = 0; i < m; i++) {
            Loop &loop = *loops[i];
            if (free) dehyst_loop_commit(&loop.model, &loop.loop, loop.memory.data(), out.data()[i]);
            else loop.loop.offer = DEHYST_NOTHING;
        }
        return free;
    }
    // A column a loop, (n, M): wanted displacements to voltages, or voltages to displacements. Counts of all loops since
    // their beginning: limited, slewed, refused.
    std::tuple<unsigned long, unsigned long, unsigned long> run(Rows in, Live out, bool plays) {
        const size_t n = in.shape(0), m = loops.size();
        if (busy) throw std::runtime_error("this bank is running in another thread; give each thread its own");
        if (in.shape(1) != m || out.shape(0) != n || out.shape(1) != m) demand(DEHYST_ERR_SIZE);
        unsigned long limited = 0, slewed = 0, refused = 0;
        const Loop::Busy mark(busy);
        nb::gil_scoped_release release;
        for (size_t i = 0; i < m; i++) {
            Loop &one = *loops[i];
            for (size_t t = i; t < n * m; t += m) {
                if (plays) {
                    dehyst_loop_play(&one.model, &one.loop, one.memory.data(), in.data()[t]);
                    out.data()[t] = one.displacement();
                } else {
                    out.data()[t] = dehyst_loop_step(&one.model, &one.loop, one.memory.data(), in.data()[t]);
                }
            }
            limited += one.loop.limited, slewed += one.loop.slewed, refused += one.loop.refused;
        }
        return {limited, slewed, refused};
    }
};

} // namespace

void bind_loop(nb::module_ &m) {
    nb::class_<Loop>(m, "Loop")
        .def(nb::init<const Core &, Input, Input, Input, Input, Input, nb::object>(), nb::keep_alive<1, 2>())
        .def("begin", &Loop::begin)
        .def("offer", [](Loop &loop, nb::handle u) { return loop.offer(plain(u) / loop.per_metre); })
        .def("withdraw", &Loop::withdraw)
        .def("commit", &Loop::commit)
        .def("step", [](Loop &loop, nb::handle u) { return loop.step(plain(u) / loop.per_metre); })
        .def_rw("per_metre", &Loop::per_metre)
        .def_rw("slow", &Loop::slow)
        // A step of a float without a temperature; all else, and what is refused, by the slow one of Python.
        .def("quick", [](Loop &loop, nb::handle u, nb::handle temperature) -> nb::object {
            if (temperature.is_none() && PyFloat_CheckExact(u.ptr())) {
                const double wanted = PyFloat_AsDouble(u.ptr()) / loop.per_metre;
                if (std::isfinite(wanted)) {
                    try {
                        return nb::float_(loop.step(wanted));
                    } catch (const CoreError &) {
                    }
                }
            }
            return loop.slow(u, temperature);
        }, nb::arg("displacement").none(), nb::arg("temperature").none() = nb::none())
        .def("run", &Loop::run)
        .def("trace", &Loop::trace)
        .def("tables", &Loop::tables)
        .def("sent", &Loop::sent)
        .def("displacement", &Loop::displacement)
        .def("scale", &Loop::scale)
        .def("counts", &Loop::counts)
        .def("state", &Loop::state)
        .def("rest", &Loop::rest)
        .def("go_on", &Loop::go_on)
        .def("block", &Loop::block)
        .def("ids", &Loop::ids)
        .def("save", &Loop::save)
        .def("restore", &Loop::restore);
    nb::class_<Feedback>(m, "Feedback")
        .def(nb::init<Loop &, double, double, int>(), nb::keep_alive<1, 2>())
        .def("step", [](Feedback &f, nb::handle u, nb::handle measured) {
            return f.step(plain(u), measured.is_none() ? NAN : plain(measured));
        }, nb::arg("wanted"), nb::arg("measured").none())
        .def_prop_ro("correction", [](const Feedback &f) { return f.memory.correction; })
        .def_prop_ro("fault", [](const Feedback &f) { return int(f.memory.fault); });
    m.def("judge", &judge);
    nb::class_<Bank>(m, "Bank").def(nb::init<nb::list>(), nb::keep_alive<1, 2>()).def("step", &Bank::step).def("run", &Bank::run);
}
