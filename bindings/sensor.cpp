// include/truewrench/sensor.hpp: the inverse of a gain and how well it is posed.
#include "bindings.hpp"

#include "truewrench/sensor.hpp"

#include <nanobind/eigen/dense.h>

namespace truewrench::python {
namespace {

SensorModel<> sensor_of(const RowMatrix& gain, const Eigen::VectorXd& noise) {
  if (gain.rows() < 6 || gain.rows() > max_channels || gain.cols() != 6 || noise.size() != gain.rows())
    require(Status::wrong_size, "gain and noise of 6 to 32 channels");
  return {gain, Eigen::VectorXd::Zero(gain.rows()), noise};
}

RowMatrix inverse_of(const RowMatrix& gain, const Eigen::VectorXd& noise) {
  SensorModel<>::Inverse inverse;
  require(generalised_inverse(sensor_of(gain, noise), inverse), "gain");
  return inverse;
}

Conditioning conditioning_of(const RowMatrix& gain, const Eigen::VectorXd& noise, const RowMatrix& nominal,
                             const Vector6& range) {
  const SensorModel<> sensor = sensor_of(gain, noise);
  Conditioning out;
  const Status status = conditioning(sensor, sensor_of(nominal, noise).gain, range, out);
  if (status != Status::singular) require(status, "gain");
  return out;
}

}  // namespace

void bind_sensor(nb::module_& m) {
  nb::class_<Conditioning>(m, "Conditioning", "How well a gain is posed, in range-normalised units.")
      .def_ro("condition_number", &Conditioning::condition_number,
              "Of the gain; infinite when it is singular.")
      .def_ro("departure_norm", &Conditioning::departure_norm, "Induced 2-norm of Delta = C - I.")
      .def_prop_ro("departure_below_one", &Conditioning::departure_below_one,
                   "The paper's condition: sufficient for an inverse, not necessary.");
  m.def("generalised_inverse", &inverse_of, nb::arg("gain"), nb::arg("noise"),
        "The (6, n) inverse of a gain (n, 6) that gives the wrench of smallest variance, for 1-sigma noise "
        "(n,).\n\n"
        "Raises ValueError when the gain cannot be inverted.");
  m.def(
      "conditioning", &conditioning_of, nb::arg("gain"), nb::arg("noise"), nb::arg("nominal"),
      nb::arg("range"),
      "Condition number and departure from the nominal gain, with wrench axes counted in their ranges (6,).");
}

}  // namespace truewrench::python
