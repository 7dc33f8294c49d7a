// Arrays in, arrays out, the interpreter lock released, a status back. No algorithm.
#include "tables.h"
#include "loop.h"

namespace {

std::tuple<Matrix, Output> strains(Input path, Bounds bounds, Grid decay, Grid gain, double before, Input strain) {
    std::vector<double> d = copy(strain);
    const size_t n = path.size(), j = d.size();
    const std::vector<double> none;
    const Core::Steps steps{bounds, decay, gain, Grid(none.data(), {decay.shape(0), 0})};
    const size_t count = steps.size(n, j, false);
    Matrix out = room<Matrix>(n, j);
    const double *source = path.data();
    {
        nb::gil_scoped_release release;
        for (size_t r = 0; r < count; r++) {
            const long first = steps.first(r);
            dehyst_strains(int(j), steps.decay_of(r), steps.gain_of(r), d.data(), first ? source[first - 1] : before,
                           source + first, out.data() + first * j, steps.length(r));
        }
    }
    return {out, as_array(d)};
}

// Creep behind the elements of displacements m, or with `inverse` m from displacements that creep.
std::tuple<Output, Output> output_creep(Input path, Bounds bounds, Grid decay, Grid rise, Input gain, double before,
                                        Input strain, bool inverse) {
    std::vector<double> e = copy(strain);
    const size_t n = path.size(), k = e.size();
    const std::vector<double> none;
    const Core::Steps steps{bounds, decay, rise, Grid(none.data(), {decay.shape(0), 0})};
    const size_t count = steps.size(n, k, false);
    if (gain.size() != k) demand(DEHYST_ERR_SIZE);
    Output out = room<Output>(n);
    const double *source = path.data(), *gains = gain.data();
    const auto run = inverse ? dehyst_output_compensate : dehyst_output_simulate;
    {
        nb::gil_scoped_release release;
        for (size_t r = 0; r < count; r++) {
            const long first = steps.first(r), length = steps.length(r);
            dehyst_output output{int(k), gains, steps.decay_of(r), steps.gain_of(r), 0, 0};
            demand(dehyst_output_tabulate(&output));
            run(&output, e.data(), before, source + first, out.data() + first, length);
            if (length > 0) before = (inverse ? out.data() : source)[first + length - 1];
        }
    }
    return {out, as_array(e)};
}

std::tuple<Matrix, Output> slip_elongations(Input rho, Input cart, Input y) {
    std::vector<double> own_rho = copy(rho), own_cart = copy(cart);
    const size_t n = y.size(), size = own_rho.size();
    if (own_cart.size() != size) demand(DEHYST_ERR_SIZE);
    dehyst_slip slip{int(size), own_rho.data(), nullptr, nullptr, nullptr, nullptr, 0};
    Matrix out = room<Matrix>(n, size);
    const double *source = y.data();
    {
        nb::gil_scoped_release release;
        dehyst_slip_elongations(&slip, own_cart.data(), source, out.data(), long(n));
    }
    return {out, as_array(own_cart)};
}

Matrix smooth_elongations(Input length, Input closing, Input y, Input start) {
    std::vector<double> back(length.size()), elongation = copy(start);
    const size_t n = y.size(), size = length.size();
    if (closing.size() != size || elongation.size() != size) demand(DEHYST_ERR_SIZE);
    demand(dehyst_smooth_tabulate(int(size), length.data(), closing.data(), back.data()));
    dehyst_smooth smooth{int(size), length.data(), back.data(), nullptr};
    Matrix out = room<Matrix>(n, size);
    const double *source = y.data();
    {
        nb::gil_scoped_release release;
        dehyst_smooth_elongations(&smooth, elongation.data(), n ? source[0] : 0.0, source, out.data(), long(n));
    }
    return out;
}

// Runs of equal steps; the first sample has none before it.
std::tuple<nb::ndarray<nb::numpy, int64_t, nb::ndim<1>>, Output> steps(Input time) {
    std::vector<int64_t> bounds{0};
    std::vector<double> durations;
    const long n = long(time.size());
    for (long first = 0, end; first < n; first = end) {
        end = first == 0 ? 1 : dehyst_equal_steps(time.data(), first, n);
        durations.push_back(first == 0 ? 0.0 : (time.data()[end - 1] - time.data()[first - 1]) / double(end - first));
        bounds.push_back(end);
    }
    return {as_array(bounds), as_array(durations)};
}

} // namespace

NB_MODULE(_core, m) {
    // Actuators that live until the interpreter ends are no leak worth a page of warnings.
    nb::set_leak_warnings(false);
    m.doc() = "The C core of dehyst; use it through dehyst._native.";
    nb::exception<CoreError>(m, "CoreError", PyExc_ValueError);
    nb::class_<Core>(m, "Core")
        .def(nb::init<Input, Input, Input, Input, Input, Input, Input, Input, Input, Input, Input, Input, Input>())
        .def("compensate", &Core::compensate)
        .def("simulate", &Core::simulate)
        .def("voltage", &Core::voltage)
        .def("depth", &Core::depth)
        .def("spring_at", &Core::spring_at)
        .def("spring_inverse", &Core::spring_inverse);
    bind_loop(m);
    m.def("slip_elongations", &slip_elongations);
    m.def("smooth_elongations", &smooth_elongations);
    m.def("steps", &steps);
    m.def("strains", &strains);
    m.def("output_creep", &output_creep);
}
