// Status codes of the core, and how they become Python exceptions.
#include "bindings.hpp"

namespace truewrench::python {
namespace {

const char* words(Status status) {
  switch (status) {
    case Status::ok:
      return "ok";
    case Status::not_finite:
      return "a value is not finite";
    case Status::not_positive:
      return "a variance, mass or time step is not positive";
    case Status::not_factorizable:
      return "a matrix is not positive definite to working precision";
    case Status::wrong_size:
      return "array lengths disagree";
    case Status::not_increasing:
      return "time does not increase";
    case Status::unphysical_payload:
      return "the inertia is not that of a rigid body";
    case Status::singular:
      return "the gain cannot be inverted";
    case Status::not_converged:
      return "the iteration did not converge";
    case Status::not_configured:
      return "there is no calibration";
  }
  return "unknown";
}

}  // namespace

void require(Status status, const char* what) {
  if (status == Status::ok) return;
  const std::string message = std::string(what) + ": " + words(status);
  throw nb::value_error(message.c_str());
}

void bind_status(nb::module_& m) {
  nb::enum_<Status>(m, "Status", "Outcome of a call into the core.")
      .value("ok", Status::ok)
      .value("not_finite", Status::not_finite)
      .value("not_positive", Status::not_positive)
      .value("not_factorizable", Status::not_factorizable)
      .value("wrong_size", Status::wrong_size)
      .value("not_increasing", Status::not_increasing)
      .value("unphysical_payload", Status::unphysical_payload)
      .value("singular", Status::singular)
      .value("not_converged", Status::not_converged)
      .value("not_configured", Status::not_configured)
      .def_prop_ro("words", &words, "The outcome as a person would say it.");
}

}  // namespace truewrench::python
