// Whole records through include/truewrench/ekf.hpp.
#include "bindings.hpp"

#include "truewrench/ekf.hpp"

#include <nanobind/eigen/dense.h>

#include <algorithm>
#include <cstdint>

namespace truewrench::python {
namespace {

using Times = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Indices = Eigen::Matrix<std::int64_t, Eigen::Dynamic, 1>;

// What the filter leaves of one record of N rows.
struct EkfRecord {
  Eigen::VectorXd state;
  RowMatrix covariance;
  RowMatrix innovation;        // N x 12
  Eigen::VectorXd nis;         // N
  Indices degrees_of_freedom;  // N
  Indices history_row;         // M
  RowMatrix history_gain;      // M x 36
  Status status = Status::ok;
  std::int64_t rows_done = 0;
};

template <bool Offset>
EkfRecord run(const Payload& payload, const EkfSettings& settings, const Times& time_ns, const Array2& raw,
              const Array2& twist, const Array2& gravity, std::int64_t history_every) {
  const auto n = static_cast<std::int64_t>(time_ns.shape(0));
  EkfRecord out;
  out.innovation.setConstant(n, 12, std::numeric_limits<double>::quiet_NaN());
  out.nis.setZero(n);
  out.degrees_of_freedom.setZero(n);
  const std::int64_t kept = (n + history_every - 1) / history_every;
  out.history_row.resize(kept);
  out.history_gain.resize(kept, 36);

  const auto filter = std::make_unique<Ekf<Offset>>(payload, settings);
  for (std::int64_t i = 0; i < n; ++i) {
    if (i > 0)
      out.status = filter->predict(1e-9 * static_cast<double>(time_ns.data()[i] - time_ns.data()[i - 1]));
    if (out.status == Status::ok) {
      out.status = filter->update(Eigen::Map<const Vector6>(raw.data() + 6 * i),
                                  Eigen::Map<const Vector6>(twist.data() + 6 * i),
                                  Eigen::Map<const Vector3>(gravity.data() + 3 * i));
    }
    if (out.status != Status::ok) break;
    const EkfUpdate& update = filter->last_update();
    out.innovation.row(i) = update.innovation.transpose();
    out.nis(i) = update.nis;
    out.degrees_of_freedom(i) = update.degrees_of_freedom;
    // The last row of each stretch, and the last of all.
    if ((i + 1) % history_every == 0 || i + 1 == n) {
      const std::int64_t k = i / history_every;
      out.history_row(k) = i;
      Eigen::Map<typename Ekf<Offset>::Gain>(out.history_gain.row(k).data()) = filter->gain();
    }
    out.rows_done = i + 1;
  }
  out.state = filter->state();
  out.covariance = filter->covariance();
  return out;
}

EkfRecord ekf_run(const Payload& payload, const EkfSettings& settings, bool with_offset, const Times& time_ns,
                  const Array2& raw, const Array2& twist, const Array2& gravity, std::int64_t history_every) {
  const std::size_t n = time_ns.shape(0);
  expect_shape(raw, n, 6, "raw");
  expect_shape(twist, n, 6, "twist");
  expect_shape(gravity, n, 3, "gravity");
  if (history_every < 1) throw nb::value_error("history_every: expected at least 1");
  require(check(payload), "payload");
  require(check(settings), "settings");
  const nb::gil_scoped_release unlocked;
  return with_offset ? run<true>(payload, settings, time_ns, raw, twist, gravity, history_every)
                     : run<false>(payload, settings, time_ns, raw, twist, gravity, history_every);
}

}  // namespace

void bind_ekf(nb::module_& m) {
  nb::enum_<Feels>(m, "Feels", "Sign of the wrench in raw = gain w + offset.")
      .value("payload_on_sensor", Feels::payload_on_sensor)
      .value("sensor_on_payload", Feels::sensor_on_payload);
  nb::class_<EkfSettings>(m, "EkfSettings",
                          "Noise and start of the published filter; by default its published start.")
      .def(nb::init<>())
      .def_rw("feels", &EkfSettings::feels)
      .def_rw("raw_covariance", &EkfSettings::raw_covariance, "(6, 6) of one sample of the channels.")
      .def_rw("twist_covariance", &EkfSettings::twist_covariance, "(6, 6) of one sample of the twist.")
      .def_rw("process_density", &EkfSettings::process_density,
              "(6,) spectral density of the derivative of a.")
      .def_rw("twist_variance", &EkfSettings::twist_variance, "(6,) of nu at the start.")
      .def_rw("acceleration_variance", &EkfSettings::acceleration_variance, "(6,) of a at the start.")
      .def_rw("gain", &EkfSettings::gain, "(6, 6) at the start.")
      .def_rw("offset", &EkfSettings::offset, "(6,) at the start.")
      .def_rw("parameter_covariance", &EkfSettings::parameter_covariance,
              "(42, 42) of [gain row by row, offset] at the start.");
  nb::class_<EkfRecord>(m, "EkfRecord", "What the filter leaves of a record of N rows.")
      .def_ro("state", &EkfRecord::state, "(48,) or (54,): nu, a, gain row by row and offset.")
      .def_ro("covariance", &EkfRecord::covariance, "Of the state.")
      .def_ro("innovation", &EkfRecord::innovation, "(N, 12): channels, twist; NaN where there is no sample.")
      .def_ro("nis", &EkfRecord::nis, "(N,) innovation^T S^-1 innovation.")
      .def_ro("degrees_of_freedom", &EkfRecord::degrees_of_freedom, "(N,) samples used in each row.")
      .def_ro("history_row", &EkfRecord::history_row, "(M,) rows of history_gain.")
      .def_ro("history_gain", &EkfRecord::history_gain, "(M, 36) gain row by row after those rows.")
      .def_ro("status", &EkfRecord::status)
      .def_ro("rows_done", &EkfRecord::rows_done, "Rows taken in before `status` stopped the filter.");
  m.def("ekf_run", &ekf_run, nb::arg("payload"), nb::arg("settings"), nb::arg("with_offset"),
        nb::arg("time_ns"), nb::arg("raw"), nb::arg("twist"), nb::arg("gravity"),
        nb::arg("history_every") = 1,
        "Run the published filter over a record: time (N,) int64, raw (N, 6), twist (N, 6) of the centre of "
        "mass and\n"
        "gravity (N, 3) in sensor axes. NaN in raw or twist: no sample there.");
}

}  // namespace truewrench::python
