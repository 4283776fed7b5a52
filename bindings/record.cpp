// What the estimator reads: include/truewrench/model/record.hpp.
#include "bindings.hpp"

#include "truewrench/model/chain.hpp"
#include "truewrench/model/record.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <memory>
#include <optional>
#include <tuple>
#include <utility>

namespace truewrench::python {
namespace {

using Carried = std::tuple<RowMatrix, RowMatrix, RowMatrix>;  // of a Carrier

// A chain as the core's map; what carries it by a Python function of the times, or None. Threads of the core wait for the
// interpreter.
MotionMap map_of(Chain chain, std::optional<nb::callable> carried, bool gravity) {
  std::shared_ptr<nb::callable> held;
  if (carried)
    held = {new nb::callable(std::move(*carried)), [](nb::callable* f) {
              const nb::gil_scoped_acquire locked;
              delete f;
            }};
  return [chain = std::move(chain), held, gravity](const Eigen::VectorXd& time, const RowMatrix& q,
                                                   const RowMatrix& qd, const RowMatrix& qdd, bool jacobian,
                                                   MappedMotion& out) {
    Carrier carrier;
    if (held) {
      const nb::gil_scoped_acquire locked;
      std::tie(carrier.twist, carrier.rate, carrier.R_inertial_root) = nb::cast<Carried>((*held)(time));
    }
    require(chain_motion(chain, q, qd, qdd, carrier, gravity, jacobian, out), "joints, or what carries them");
  };
}

}  // namespace

void bind_record(nb::module_& m) {
  nb::enum_<Source>(m, "Source", "What the components of the motion spline are.")
      .value("twist", Source::twist)
      .value("imu", Source::imu)
      .value("mapped", Source::mapped);
  nb::class_<MotionStream>(m, "MotionStream",
                           "Measurements of a derivative of the motion spline (NaN: missing).")
      .def(nb::init<>())
      .def_rw("derivative", &MotionStream::derivative)
      .def_rw("time", &MotionStream::time)
      .def_rw("value", &MotionStream::value)
      .def_rw("sigma", &MotionStream::sigma)
      .def_rw("group", &MotionStream::group)
      .def_rw("bias_prior", &MotionStream::bias_prior)
      .def_rw("time_offset_prior", &MotionStream::time_offset_prior)
      .def_rw("clock_mean", &MotionStream::clock_mean)
      .def_rw("kappa_mean", &MotionStream::kappa_mean)
      .def_rw("half_window", &MotionStream::half_window);
  nb::class_<RecordedLog>(m, "RecordedLog",
                          "A log as the estimator reads it; channels in fractions of their scale.")
      .def(nb::init<>())
      .def_rw("source", &RecordedLog::source)
      .def_rw("payload", &RecordedLog::payload)
      .def_rw("point", &RecordedLog::point)
      .def_rw("body", &RecordedLog::body)
      .def_rw("arm", &RecordedLog::arm)
      .def_rw("offset_knots", &RecordedLog::offset_knots)
      .def_rw("offset_walk", &RecordedLog::offset_walk)
      .def_rw("time", &RecordedLog::time)
      .def_rw("raw", &RecordedLog::raw)
      .def_rw("R_sensor_root", &RecordedLog::R_sensor_root)
      .def_rw("own_roots", &RecordedLog::own_roots)
      .def_rw("temperature", &RecordedLog::temperature)
      .def_rw("half_window", &RecordedLog::half_window)
      .def_rw("clock_set", &RecordedLog::clock_set)
      .def_rw("resolved", &RecordedLog::resolved)
      .def_rw("motion", &RecordedLog::motion)
      .def("__copy__", [](const RecordedLog& log) { return log; })
      .def(
          "set_chain",
          [](RecordedLog& log, const Chain& chain, std::optional<nb::callable> carried, bool gravity) {
            log.carried = carried.has_value();
            log.map = map_of(chain, std::move(carried), gravity);
          },
          nb::arg("chain"), nb::arg("carried").none(), nb::arg("gravity"),
          nb::sig("def set_chain(self, chain: Chain, carried: collections.abc.Callable[..., object] | None, "
                  "gravity: bool) -> None"),
          "The arm of a mapped motion; `carried`: of times (K,) what `Chain.motion` takes of its root, or "
          "None.");
  nb::class_<Chain>(m, "Chain", "The joints from the root to the sensor frame, as a product of exponentials.")
      .def(
          "__init__",
          [](Chain* self, const RowMatrix& xi, const Matrix3& R, const Vector3& p) {
            if (xi.cols() != 6) throw nb::value_error("xi: expected six columns");
            new (self) Chain{{}, R, p};
            for (Eigen::Index i = 0; i < xi.rows(); ++i) self->xi.emplace_back(xi.row(i).transpose());
          },
          nb::arg("xi"), nb::arg("R"), nb::arg("p"),
          "xi: (M, 6) twists of unit joint speed at q = 0, of the root's origin, root axes; R (3, 3) and p "
          "(3,): pose of the\n"
          "sensor frame in the root, there.")
      .def_prop_ro("joints", [](const Chain& c) { return c.xi.size(); })
      .def(
          "motion",
          [](const Chain& chain, const RowMatrix& q, const RowMatrix& qd, const RowMatrix& qdd,
             const RowMatrix& twist, const RowMatrix& rate, const RowMatrix& R_inertial_root) {
            MappedMotion out;
            require(chain_motion(chain, q, qd, qdd, {twist, rate, R_inertial_root}, true, true, out),
                    "joints (K, M), or what carries them");
            return std::tuple(out.nu, out.a, out.R_sensor_root, out.jacobian);
          },
          nb::arg("q"), nb::arg("qd"), nb::arg("qdd"), nb::arg("twist"), nb::arg("rate"),
          nb::arg("R_inertial_root"),
          "Motion of the sensor's origin, sensor axes.\n\n"
          "twist, rate (K, 6): of the root's origin, root axes, and its derivative, or none: at rest. "
          "R_inertial_root (K, 9)\n"
          "row by row, or none. Returns nu (K, 6), a (K, 6), R_sensor_inertial (K, 9) row by row, and the "
          "Jacobian\n"
          "(K, 12 * 3M), row by row, of [nu; a] by (q, qd, qdd).");
  nb::class_<Statement>(m, "Statement", "What a rig states, normalised.")
      .def(nb::init<>())
      .def_rw("range", &Statement::range)
      .def_rw("sign", &Statement::sign)
      .def_rw("noise", &Statement::noise)
      .def_rw("nominal", &Statement::nominal)
      .def_rw("gain_prior", &Statement::gain_prior)
      .def_rw("offset_prior", &Statement::offset_prior)
      .def_rw("pool_offsets", &Statement::pool_offsets)
      .def_rw("gravity", &Statement::gravity)
      .def_rw("tilt_prior", &Statement::tilt_prior)
      .def_rw("gamma_mean", &Statement::gamma_mean)
      .def_rw("slope_prior", &Statement::slope_prior)
      .def_rw("body_prior", &Statement::body_prior);
}

}  // namespace truewrench::python
