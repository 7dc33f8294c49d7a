// Arrays in, arrays out, the interpreter lock released. Sizes are checked here, values by dehyst_rivals.plays.
#include <stdexcept>
#include <tuple>
#include <vector>

#include "arrays.h"
#include "plays.h"

namespace {

using Counts = nb::ndarray<const int, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void demand(bool holds) {
    if (!holds) throw std::invalid_argument("arrays of different lengths");
}

struct Plays {
    std::vector<double> r, knot, value, slope, tau, share;
    std::vector<int> first;
    plays_model model;

    Plays(Input r_, Counts first_, Input knot_, Input value_, Input slope_, Input tau_, Input share_, double offset)
        : r(copy(r_)), knot(copy(knot_)), value(copy(value_)), slope(copy(slope_)), tau(copy(tau_)),
          share(copy(share_)), first(first_.data(), first_.data() + first_.size()) {
        demand(first.size() == r.size() + 1 && first[0] == 0 && size_t(first.back()) == knot.size());
        for (size_t i = 0; i < r.size(); i++) demand(first[i] < first[i + 1]);
        demand(value.size() == knot.size() && slope.size() == knot.size() + r.size() && share.size() == tau.size());
        model = {int(r.size()), r.data(),          first.data(), knot.data(),  value.data(),
                 slope.data(),  int(tau.size()), tau.data(),   share.data(), offset};
    }
    Plays(const Plays &) = delete;

    // What came out, how many samples were met, and the state reached: voltage, plays, low-passes.
    using Result = std::tuple<Output, long, double, Output, Output>;

    template <typename Function> Result run(Function function, Input in, Input dt, double v, Input z, Input q) const {
        std::vector<double> own_z = copy(z), own_q = copy(q), held(r.size()), kept(tau.size()),
            gain(tau.size());
        std::vector<int> at(r.size());
        const size_t n = in.size();
        demand(own_z.size() == r.size() && own_q.size() == tau.size() && (tau.empty() || dt.size() == n));
        plays_state state{v, own_z.data(), own_q.data(), held.data(), at.data(), 0, kept.data(), gain.data()};
        Output out = room<Output>(n);
        const double *source = in.data(), *steps = tau.empty() ? nullptr : dt.data();
        long met;
        {
            nb::gil_scoped_release release;
            plays_begin(&model, &state);
            met = function(&model, &state, source, steps, out.data(), long(n));
        }
        return {out, met, state.v, as_array(own_z), as_array(own_q)};
    }

    Result simulate(Input in, Input dt, double v, Input z, Input q) const {
        auto function = [](const plays_model *m, plays_state *s, const double *a, const double *d, double *b, long n) {
            plays_simulate(m, s, a, d, b, n);
            return n;
        };
        return run(function, in, dt, v, z, q);
    }
    Result compensate(Input in, Input dt, double v, Input z, Input q) const {
        return run(plays_compensate, in, dt, v, z, q);
    }
};

Matrix outputs(Input r, Input z, Input v) {
    std::vector<double> own_r = copy(r), own_z = copy(z);
    const size_t n = v.size(), size = own_r.size();
    demand(own_z.size() == size);
    Matrix out = room<Matrix>(n, size);
    const double *source = v.data();
    {
        nb::gil_scoped_release release;
        plays_outputs(int(size), own_r.data(), own_z.data(), source, out.data(), long(n));
    }
    return out;
}

} // namespace

void bind_plays(nb::module_ &m) {
    nb::class_<Plays>(m, "Plays")
        .def(nb::init<Input, Counts, Input, Input, Input, Input, Input, double>())
        .def("simulate", &Plays::simulate)
        .def("compensate", &Plays::compensate);
    m.def("play_outputs", &outputs);
}
