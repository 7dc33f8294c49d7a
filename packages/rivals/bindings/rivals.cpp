// The compiled parts of the models, each bound by a file of its own. No algorithm.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_plays(nb::module_ &m);
void bind_fields(nb::module_ &m);

NB_MODULE(_rivals, m) {
    nb::set_leak_warnings(false);
    m.doc() = "Steppers of the models; use them by the classes of dehyst_rivals.";
    bind_plays(m);
    bind_fields(m);
}
