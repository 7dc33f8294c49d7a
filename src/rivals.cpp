// The second extension module: steppers of rival models, for comparisons. Each part brings its own bindings.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_fields(nb::module_ &m);

NB_MODULE(_rivals, m) {
    m.doc() = "Steppers of rival models; use them through dehyst.rivals.";
    bind_fields(m);
}
