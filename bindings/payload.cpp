// Whole records through include/truewrench/payload.hpp.
#include "bindings.hpp"

#include "truewrench/estimation/second_order.hpp"
#include "truewrench/payload.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <utility>

namespace truewrench::python {
namespace {

using Row3 = Eigen::Map<const Vector3>;
using Row6 = Eigen::Map<const Vector6>;

ArrayOut payload_wrench(const Payload& payload, const Array2& nu, const Array2& a, const Array2& gravity) {
  const std::size_t n = nu.shape(0);
  expect_shape(nu, n, 6, "nu");
  expect_shape(a, n, 6, "a");
  expect_shape(gravity, n, 3, "gravity");
  ArrayOut out = new_array({n, 6});
  const nb::gil_scoped_release unlocked;
  for (std::size_t i = 0; i < n; ++i) {
    Eigen::Map<Vector6>(out.data() + 6 * i) =
        wrench(payload, Row6(nu.data() + 6 * i), Row6(a.data() + 6 * i), Row3(gravity.data() + 3 * i));
  }
  return out;
}

std::pair<ArrayOut, ArrayOut> payload_jacobians(const Payload& payload, const Array2& nu) {
  using RowMatrix6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
  const std::size_t n = nu.shape(0);
  expect_shape(nu, n, 6, "nu");
  ArrayOut acceleration = new_array({n, 6, 6});
  ArrayOut twist = new_array({n, 6, 6});
  const nb::gil_scoped_release unlocked;
  const RowMatrix6 constant = wrench_jacobian_acceleration(payload);
  for (std::size_t i = 0; i < n; ++i) {
    Eigen::Map<RowMatrix6>(acceleration.data() + 36 * i) = constant;
    Eigen::Map<RowMatrix6>(twist.data() + 36 * i) = wrench_jacobian_twist(payload, Row6(nu.data() + 6 * i));
  }
  return {acceleration, twist};
}

void bind_second_order(nb::module_& m) {
  nb::class_<Carried>(
      m, "Carried",
      "A payload that logs moved: places (10) of log mass, centre of mass, xx yy zz xy xz yz among "
      "the parameters,\nthe body as found, and the sum of w w^T (6, 6) over its samples.")
      .def(
          "__init__",
          [](Carried* self, const std::array<int, kBodyParameters>& places, const Payload& body,
             const Matrix6& felt) { new (self) Carried{places, body, felt}; },
          nb::arg("places"), nb::arg("body"), nb::arg("felt"));
  m.def(
      "body_changes",
      [](const Payload& body, double inertia_std) {
        ArrayOut out = new_array({kBodyParameters, 6, 6});
        const BodyChanges change = body_changes(body, inertia_std);
        for (std::size_t k = 0; k < change.size(); ++k)
          Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(out.data() + 36 * k) = change[k];
        return out;
      },
      nb::arg("body"), nb::arg("inertia_std") = 0.0,
      "(dM / db_k) M^-1 (10, 6, 6), M the spatial inertia about the sensor: w + L_k w db_k is felt of a body "
      "that is another.");
  m.def(
      "to_the_middle", &to_the_middle, nb::arg("covariance"), nb::arg("prior"), nb::arg("range"),
      nb::arg("carried"),
      "How far from the likeliest parameters (p) those lie with which the bodies are likeliest, the gain "
      "integrated out:\nof their covariance (p, p), the gain normalised and first, and the gain's variances "
      "(6n) beforehand.");
  m.def("bend", &bend, nb::arg("gain"), nb::arg("center"), nb::arg("prior"),
        "What the product of gain of moment and centre of mass adds to the covariance of the gain (6n, 6n) "
        "[SI].");
}

}  // namespace

void bind_payload(nb::module_& m) {
  nb::class_<Payload>(
      m, "Payload",
      "A rigid payload: mass [kg], centre of mass [m] and inertia about it [kg m^2], sensor axes.")
      .def(nb::init<>())
      .def(
          "__init__",
          [](Payload* self, double mass, const Vector3& center_of_mass, const Matrix3& inertia) {
            new (self) Payload{mass, center_of_mass, inertia};
          },
          nb::arg("mass"), nb::arg("center_of_mass"), nb::arg("inertia"))
      .def_rw("mass", &Payload::mass)
      .def_rw("center_of_mass", &Payload::center_of_mass)
      .def_rw("inertia", &Payload::inertia);
  m.def("payload_wrench", &payload_wrench, nb::arg("payload"), nb::arg("nu"), nb::arg("a"),
        nb::arg("gravity"),
        "The reaction of the payload on the sensor, (N, 6) [N, N m], from the twist of the centre of mass "
        "(N, 6), its\n"
        "component-wise derivative (N, 6) and gravity (N, 3), all in sensor axes.");
  m.def("payload_jacobians", &payload_jacobians, nb::arg("payload"), nb::arg("nu"),
        "Jacobians of payload_wrench, two (N, 6, 6): by the acceleration and by the twist.");
  m.def(
      "twist_shift", &twist_shift, nb::arg("r"),
      "6 x 6 map from the twist of a point to that of another of the same body, r [m] from the first to it.");
  bind_second_order(m);
}

}  // namespace truewrench::python
