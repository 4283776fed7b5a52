// What the estimator reads: include/truewrench/model/record.hpp.
#include "bindings.hpp"

#include "truewrench/model/record.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <memory>
#include <tuple>

namespace truewrench::python {
namespace {

using Mapped = std::tuple<RowMatrix, RowMatrix, RowMatrix, RowMatrix>;  // nu, a, R_sensor_root, jacobian

// A Python function as the core's map; threads of the core wait for the interpreter.
MotionMap wrapped(nb::callable function) {
  const auto held = std::shared_ptr<nb::callable>(new nb::callable(std::move(function)), [](nb::callable* f) {
    const nb::gil_scoped_acquire locked;
    delete f;
  });
  return [held](const Eigen::VectorXd& time, const RowMatrix& x, const RowMatrix& xd, const RowMatrix& xdd,
                MappedMotion& out) {
    const nb::gil_scoped_acquire locked;
    std::tie(out.nu, out.a, out.R_sensor_root, out.jacobian) = nb::cast<Mapped>((*held)(time, x, xd, xdd));
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
      .def_rw("kappa_mean", &MotionStream::kappa_mean);
  nb::class_<RecordedLog>(m, "RecordedLog",
                          "A log as the estimator reads it; channels in fractions of their scale.")
      .def(nb::init<>())
      .def_rw("source", &RecordedLog::source)
      .def_rw("payload", &RecordedLog::payload)
      .def_rw("point", &RecordedLog::point)
      .def_rw("body", &RecordedLog::body)
      .def_rw("offset_knots", &RecordedLog::offset_knots)
      .def_rw("offset_walk", &RecordedLog::offset_walk)
      .def_rw("time", &RecordedLog::time)
      .def_rw("raw", &RecordedLog::raw)
      .def_rw("R_sensor_root", &RecordedLog::R_sensor_root)
      .def_rw("temperature", &RecordedLog::temperature)
      .def_rw("motion", &RecordedLog::motion)
      .def(
          "set_map", [](RecordedLog& log, nb::callable function) { log.map = wrapped(std::move(function)); },
          nb::sig("def set_map(self, function: collections.abc.Callable[..., object], /) -> None"));
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
