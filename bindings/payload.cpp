// Whole records through include/truewrench/payload.hpp.
#include "bindings.hpp"

#include "truewrench/payload.hpp"

#include <nanobind/eigen/dense.h>

namespace truewrench::python {

void bind_payload(nb::module_& m) {
  nb::class_<Payload>(m, "Payload", "A rigid payload: mass [kg], centre of mass [m] and inertia about it [kg m^2], sensor axes.")
      .def(nb::init<>())
      .def_rw("mass", &Payload::mass)
      .def_rw("center_of_mass", &Payload::center_of_mass)
      .def_rw("inertia", &Payload::inertia);
}

}  // namespace truewrench::python
