// Arrays between Python and C, shared by the bindings: read-only in, owned by Python out.
#ifndef DEHYST_ARRAYS_H
#define DEHYST_ARRAYS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <type_traits>
#include <vector>

namespace nb = nanobind;

using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;
using Matrix = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

inline std::vector<double> copy(Input array) { return {array.data(), array.data() + array.size()}; }

// A new array of NumPy, which asks the kernel for large pages where they save time.
template <typename Array, typename... Sizes> Array room(Sizes... sizes) {
    const char *type = std::is_integral_v<typename Array::Scalar> ? "i8" : "f8";
    static const nb::handle empty = nb::object(nb::module_::import_("numpy").attr("empty")).release();
    return nb::cast<Array>(empty(nb::make_tuple(sizes...), type));
}

template <typename T = double> nb::ndarray<nb::numpy, T, nb::ndim<1>> as_array(const std::vector<T> &values) {
    auto out = room<nb::ndarray<nb::numpy, T, nb::ndim<1>>>(values.size());
    std::copy(values.begin(), values.end(), out.data());
    return out;
}

#endif
