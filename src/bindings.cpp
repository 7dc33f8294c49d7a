// Arrays in, arrays out, the interpreter lock released, a status back. No algorithm.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "dehyst.h"

namespace nb = nanobind;

using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;
using Matrix = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

namespace {

class CoreError : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

const char *sentence(dehyst_status status) {
    switch (status) {
    case DEHYST_OK: return "done";
    case DEHYST_ERR_SIZE: return "fewer than two knots, or arrays of different lengths";
    case DEHYST_ERR_FINITE: return "a value that is not finite";
    case DEHYST_ERR_ORDER: return "knots, spring voltages and breakaway elongations must strictly increase";
    case DEHYST_ERR_SIGN: return "stiffnesses must be >= 0 and breakaway elongations > 0";
    case DEHYST_ERR_STATE: return "a cart lies farther from the displacement than its breakaway elongation";
    case DEHYST_ERR_CAPACITY: return "the stack of reversals is too short";
    case DEHYST_ERR_UNREACHABLE: return "no history from rest leaves carts like these";
    }
    return "unknown status";
}

void demand(dehyst_status status) {
    if (status != DEHYST_OK) throw CoreError(sentence(status));
}

std::vector<double> copy(Input array) { return {array.data(), array.data() + array.size()}; }

template <typename Array> Array own(std::unique_ptr<double[]> data, std::initializer_list<size_t> shape) {
    double *raw = data.release();
    nb::capsule owner(raw, [](void *p) noexcept { delete[] static_cast<double *>(p); });
    return Array(raw, shape, owner);
}

Output as_array(const std::vector<double> &values) {
    std::unique_ptr<double[]> data(new double[values.size() + 1]);
    std::copy(values.begin(), values.end(), data.get());
    return own<Output>(std::move(data), {values.size()});
}

struct Core {
    std::vector<double> rho, kappa, knot, value, slope, edge, intercept, stiffness;
    dehyst_actuator actuator;

    Core(Input rho_, Input kappa_, Input knot_, Input value_)
        : rho(copy(rho_)), kappa(copy(kappa_)), knot(copy(knot_)), value(copy(value_)) {
        const size_t n = rho.size();
        if (kappa.size() != n || value.size() != knot.size() || knot.size() < 2) demand(DEHYST_ERR_SIZE);
        slope.resize(knot.size() - 1);
        edge.resize(n + 1), intercept.resize(n + 1), stiffness.resize(n + 1);
        double inverse_step = 0;
        demand(dehyst_curve_tabulate(int(knot.size()), knot.data(), value.data(), slope.data()));
        demand(dehyst_slip_tabulate(int(n), rho.data(), kappa.data(), edge.data(), intercept.data(), stiffness.data(),
                                    &inverse_step));
        actuator.slip = {int(n),           rho.data(),       kappa.data(), edge.data(),
                         intercept.data(), stiffness.data(), inverse_step};
        actuator.spring = {int(knot.size()), knot.data(), value.data(), slope.data()};
    }
    Core(const Core &) = delete;

    std::vector<double> carts(double y, Input cart) const {
        std::vector<double> own_cart = copy(cart);
        if (own_cart.size() != rho.size()) demand(DEHYST_ERR_SIZE);
        dehyst_state state{y, own_cart.data()};
        demand(dehyst_state_check(&actuator, &state));
        return own_cart;
    }

    using Run = void(const dehyst_actuator *, dehyst_state *, dehyst_stack *, const double *, double *, long);
    using Step = double(const dehyst_actuator *, dehyst_state *, double);

    std::tuple<Output, double, Output> run(Run *function, Step *step, Input in, double y, Input cart, bool stack) const {
        std::vector<double> own_cart = carts(y, cart);
        dehyst_state state{y, own_cart.data()};
        const size_t n = in.size();
        std::unique_ptr<double[]> out(new double[n + 1]);
        const double *source = in.data();
        {
            nb::gil_scoped_release release;
            if (stack) {
                std::vector<dehyst_reversal> reversals(DEHYST_STACK_CAPACITY(rho.size()));
                dehyst_stack work{int(reversals.size()), 0, 1, 0, 0, reversals.data()};
                function(&actuator, &state, &work, source, out.get(), long(n));
            } else {
                for (size_t t = 0; t < n; t++) out[t] = step(&actuator, &state, source[t]);
            }
        }
        return {own<Output>(std::move(out), {n}), state.y, as_array(own_cart)};
    }

    auto compensate(Input in, double y, Input cart, bool stack) const {
        return run(dehyst_compensate_run, dehyst_compensate_step, in, y, cart, stack);
    }
    auto simulate(Input in, double y, Input cart, bool stack) const {
        return run(dehyst_simulate_run, dehyst_simulate_step, in, y, cart, stack);
    }

    int depth(Input history, double y, Input cart) const {
        std::vector<double> own_cart = carts(y, cart), out(history.size() + 1);
        dehyst_state state{y, own_cart.data()};
        std::vector<dehyst_reversal> reversals(DEHYST_STACK_CAPACITY(rho.size()));
        dehyst_stack work{int(reversals.size()), 0, 1, 0, 0, reversals.data()};
        demand(dehyst_stack_encode(&actuator, &state, &work));
        dehyst_stack_compensate(&actuator, &work, history.data(), out.data(), long(history.size()));
        return work.depth;
    }

    double voltage(double y, Input cart) const {
        std::vector<double> own_cart = carts(y, cart);
        dehyst_state state{y, own_cart.data()};
        return dehyst_voltage(&actuator, &state);
    }
    double spring_at(double y) const { return dehyst_curve_at(&actuator.spring, y); }
    double spring_inverse(double v) const { return dehyst_curve_inverse(&actuator.spring, v); }
};

std::tuple<Matrix, Output> stops(Input rho, Input cart, Input y) {
    std::vector<double> own_rho = copy(rho), own_cart = copy(cart);
    const size_t n = y.size(), size = own_rho.size();
    if (own_cart.size() != size) demand(DEHYST_ERR_SIZE);
    dehyst_slip slip{int(size), own_rho.data(), nullptr, nullptr, nullptr, nullptr, 0};
    std::unique_ptr<double[]> out(new double[n * size + 1]);
    const double *source = y.data();
    {
        nb::gil_scoped_release release;
        dehyst_slip_stops(&slip, own_cart.data(), source, out.get(), long(n));
    }
    return {own<Matrix>(std::move(out), {n, size}), as_array(own_cart)};
}

} // namespace

NB_MODULE(_core, m) {
    // Actuators that live until the interpreter ends are no leak worth a page of warnings.
    nb::set_leak_warnings(false);
    m.doc() = "The C core of dehyst; use it through dehyst._native.";
    nb::exception<CoreError>(m, "CoreError", PyExc_ValueError);
    nb::class_<Core>(m, "Core")
        .def(nb::init<Input, Input, Input, Input>(), nb::arg("rho"), nb::arg("kappa"), nb::arg("knot"), nb::arg("value"))
        .def("compensate", &Core::compensate)
        .def("simulate", &Core::simulate)
        .def("depth", &Core::depth)
        .def("voltage", &Core::voltage)
        .def("spring_at", &Core::spring_at)
        .def("spring_inverse", &Core::spring_inverse);
    m.def("stops", &stops);
}
