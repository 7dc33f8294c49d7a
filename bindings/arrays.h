// Arrays between Python and C, shared by the bindings: read-only in, owned by Python out.
#ifndef DEHYST_ARRAYS_H
#define DEHYST_ARRAYS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <memory>
#include <vector>

namespace nb = nanobind;

using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;
using Matrix = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

inline std::vector<double> copy(Input array) { return {array.data(), array.data() + array.size()}; }

template <typename Array> Array own(std::unique_ptr<double[]> data, std::initializer_list<size_t> shape) {
    double *raw = data.release();
    nb::capsule owner(raw, [](void *p) noexcept { delete[] static_cast<double *>(p); });
    return Array(raw, shape, owner);
}

inline Output as_array(const std::vector<double> &values) {
    std::unique_ptr<double[]> data(new double[values.size() + 1]);
    std::copy(values.begin(), values.end(), data.get());
    return own<Output>(std::move(data), {values.size()});
}

#endif
