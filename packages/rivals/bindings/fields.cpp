// Arrays in, arrays out, the interpreter lock released. No algorithm: see core/fields.h.
#include <cstdint>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "arrays.h"
#include "fields.h"

namespace {

using Indices = nb::ndarray<const int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void need(const Input &array, size_t size) {
    if (array.size() != size) throw std::invalid_argument("an array of another length");
}

template <typename Model, typename State> using Run = void(const Model *, State *, const double *, double *, long);

template <typename Model, typename State>
Output played(Run<Model, State> *run, const Model &model, State &state, const Input &in) {
    const size_t n = in.size();
    Output out = room<Output>(n);
    const double *source = in.data();
    {
        nb::gil_scoped_release release;
        run(&model, &state, source, out.data(), long(n));
    }
    return out;
}

// numbers: low, step, bottom, below, above.
preisach_plane plane_of(const Input &numbers, const Input &everett, int cells) {
    need(numbers, 5);
    if (cells < 1) throw std::invalid_argument("no cell");
    need(everett, size_t(cells + 1) * size_t(cells + 1));
    const double *p = numbers.data();
    return {cells, p[0], p[1], everett.data(), p[2], p[3], p[4]};
}

// Reversals in pairs v, y, with room for those that `samples` may add.
std::vector<preisach_turn> turns_of(const Input &pairs, size_t samples) {
    const size_t depth = pairs.size() / 2;
    if (depth < 1 || pairs.size() % 2) throw std::invalid_argument("no reversal");
    std::vector<preisach_turn> turns(depth + samples + 1);
    for (size_t i = 0; i < depth; i++) turns[i] = {pairs.data()[2 * i], pairs.data()[2 * i + 1]};
    return turns;
}

std::tuple<Output, Output, double, double> preisach(Input numbers, Input everett, int cells, Input pairs, double v,
                                                    double y, Input in, bool inverse) {
    const preisach_plane plane = plane_of(numbers, everett, cells);
    std::vector<preisach_turn> turns = turns_of(pairs, in.size());
    preisach_stairs stairs{int(pairs.size() / 2), v, y, turns.data()};
    Output out = played(inverse ? preisach_compensate : preisach_simulate, plane, stairs, in);
    Output left = room<Output>(2 * size_t(stairs.depth));
    for (int i = 0; i < stairs.depth; i++) left(2 * i) = turns[i].v, left(2 * i + 1) = turns[i].y;
    return {out, left, stairs.v, stairs.y};
}

// `samples` increase.
Matrix preisach_weights(double low, double step, int cells, Input in, Indices samples) {
    if (cells < 1) throw std::invalid_argument("no cell");
    const size_t n = samples.size(), wide = size_t(cells + 1) * size_t(cells + 1);
    const std::vector<long> chosen(samples.data(), samples.data() + n);
    for (size_t i = 0; i < n; i++)
        if (chosen[i] < 0 || size_t(chosen[i]) >= in.size() || (i && chosen[i] <= chosen[i - 1]))
            throw std::invalid_argument("samples that do not increase within the path");
    std::vector<double> zeros(wide);
    const preisach_plane plane{cells, low, step, zeros.data(), 0, 0, 0};
    std::vector<preisach_turn> turns(in.size() + 2);
    turns[0] = {low, 0};
    preisach_stairs stairs{1, low, 0, turns.data()};
    Matrix out = room<Matrix>(n, wide);
    std::fill(out.data(), out.data() + n * wide, 0.0);
    const double *source = in.data();
    {
        nb::gil_scoped_release release;
        preisach_counts(&plane, &stairs, source, chosen.data(), out.data(), long(n));
    }
    return out;
}

// numbers: alpha, beta, gamma, low, span, c_0, c_1, c_2, c_3.
std::tuple<Output, double, double> bouc_wen(Input numbers, double v, double h, Input in, int what) {
    need(numbers, 9);
    const double *p = numbers.data();
    const boucwen model{p[0], p[1], p[2], {p[3], p[4], {p[5], p[6], p[7], p[8]}}};
    boucwen_state state{v, h};
    Run<boucwen, boucwen_state> *run = what == 0 ? boucwen_simulate : what == 1 ? boucwen_compensate : boucwen_lag;
    Output out = played(run, model, state, in);
    return {out, state.v, state.h};
}

// numbers: low, span, rate, below, above.
std::tuple<Output, double, double> coleman_hodgdon(Input numbers, Input rise, Input fall, double v, double y, Input in,
                                                   bool inverse) {
    need(numbers, 5);
    need(fall, rise.size());
    const double *p = numbers.data();
    const duhem model{p[0], p[1], p[2], int(rise.size()), rise.data(), fall.data(), p[3], p[4]};
    duhem_state state{v, y};
    Output out = played(inverse ? duhem_compensate : duhem_simulate, model, state, in);
    return {out, state.v, state.y};
}

double mapped(Input numbers, double x, bool inverse) {
    need(numbers, 6);
    const double *p = numbers.data();
    const cubic_map map{p[0], p[1], {p[2], p[3], p[4], p[5]}};
    return inverse ? cubic_inverse(&map, x) : cubic_at(&map, x);
}

} // namespace

void bind_fields(nb::module_ &m) {
    m.def("preisach", &preisach);
    m.def("preisach_weights", &preisach_weights);
    m.def("bouc_wen", &bouc_wen);
    m.def("coleman_hodgdon", &coleman_hodgdon);
    m.def("cubic", &mapped);
}
