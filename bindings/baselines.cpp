// The compiled parts of the rival models, each bound by a file of its own. No algorithm.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_plays(nb::module_ &m);
void bind_fields(nb::module_ &m);

NB_MODULE(_rivals, m) {
    nb::set_leak_warnings(false);
    m.doc() = "Steppers of rival models; use them by the models of dehyst.baselines.";
    bind_plays(m);
    bind_fields(m);
}
