// The window estimators over whole records: include/truewrench/estimator.hpp.
#include "bindings.hpp"

#include "truewrench/estimator.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace truewrench::python {
namespace {

// One log's arrays, kept alive while the core reads them.
struct RecordedLog {
  Payload payload;
  Matrix6 shift = Matrix6::Identity();
  std::vector<std::pair<Array1, Array2>> motion;
  std::vector<std::pair<int, Vector6>> motion_kind;  // order and sigma
  std::optional<Array1> time;
  std::optional<Array2> raw;
  std::optional<Array2> gravity;
  Vector3 gravity_constant = Vector3::Zero();

  void add_motion(int order, Array1 t, Array2 value, const Vector6& sigma) {
    if (order < 0 || order > 1) throw nb::value_error("order must be 0 (twist) or 1 (its derivative)");
    if (value.shape(0) != t.shape(0) || value.shape(1) != 6)
      throw nb::value_error("motion: values must be N x 6");
    motion.emplace_back(std::move(t), std::move(value));
    motion_kind.emplace_back(order, sigma);
  }

  void set_wrench(Array1 t, Array2 samples, std::optional<Array2> g) {
    if (samples.shape(0) != t.shape(0)) throw nb::value_error("raw: one row per time is expected");
    if (g && (g->shape(0) != t.shape(0) || g->shape(1) != 3))
      throw nb::value_error("gravity: N x 3 is expected");
    time = std::move(t);
    raw = std::move(samples);
    gravity = std::move(g);
  }

  LogData data() const {
    if (!time || !raw) throw nb::value_error("a log needs the sensor's samples: call set_wrench first");
    LogData d;
    d.payload = payload;
    d.map.shift = shift;
    for (std::size_t i = 0; i < motion.size(); ++i) {
      const auto& [t, value] = motion[i];
      d.motion.push_back({motion_kind[i].first, {t.data(), t.shape(0)}, value.data(), motion_kind[i].second});
    }
    d.wrench = {
        {time->data(), time->shape(0)}, raw->data(), gravity ? gravity->data() : nullptr, gravity_constant};
    return d;
  }
};

template <int N>
Estimate run(const std::string& method, std::vector<LogData> logs, const Eigen::VectorXd& channel_scale,
             const Eigen::VectorXd& sigma, const Vector6& wrench_scale, CommonPrior prior,
             const EstimatorSettings& settings) {
  Estimator<N> estimator(std::move(logs), SensorScale<N>{channel_scale, sigma, wrench_scale},
                         std::move(prior), settings);
  return method == "online" ? estimator.online() : estimator.map();
}

Estimate estimate(const std::string& method, const std::vector<const RecordedLog*>& logs,
                  const Eigen::VectorXd& channel_scale, const Eigen::VectorXd& sigma,
                  const Vector6& wrench_scale, const Eigen::VectorXd& mean,
                  const Eigen::VectorXd& information, bool pool_offsets, const EstimatorSettings& settings) {
  const auto n = static_cast<int>(channel_scale.size());
  if (method != "online" && method != "map") throw nb::value_error("method must be 'online' or 'map'");
  if (n < 6 || n > kMaxChannels) throw nb::value_error("6 to 32 channels are supported");
  if (sigma.size() != n) throw nb::value_error("sigma: one per channel is expected");
  if (mean.size() != information.size() || (mean.size() != 6 * n && mean.size() != 7 * n)) {
    throw nb::value_error("prior: 6 n gains, or 7 n with the offset, are expected");
  }
  std::vector<LogData> data;
  for (const RecordedLog* log : logs) {
    data.push_back(log->data());
    if (log->raw->shape(1) != static_cast<std::size_t>(n))
      throw nb::value_error("raw: one column per channel is expected");
  }
  CommonPrior prior{{n, mean.size() == 7 * n}, pool_offsets, mean, information};
  const nb::gil_scoped_release release;
  if (n == 6)
    return run<6>(method, std::move(data), channel_scale, sigma, wrench_scale, std::move(prior), settings);
  return run<Eigen::Dynamic>(method, std::move(data), channel_scale, sigma, wrench_scale, std::move(prior),
                             settings);
}

}  // namespace

void bind_estimator(nb::module_& m) {
  nb::enum_<WindowStatus>(m, "WindowStatus", "What became of a window of motion.")
      .value("fitted", WindowStatus::fitted)
      .value("too_short", WindowStatus::too_short)
      .value("motion_undetermined", WindowStatus::motion_undetermined)
      .value("not_converged", WindowStatus::not_converged)
      .value("misfit", WindowStatus::misfit)
      .value("unresolved", WindowStatus::unresolved);

  nb::class_<KnotSettings>(m, "KnotSettings", "How the knots of a window are chosen.")
      .def(nb::init<>())
      .def_rw("blocks_per_interval", &KnotSettings::blocks_per_interval)
      .def_rw("samples_per_coefficient", &KnotSettings::samples_per_coefficient)
      .def_rw("interval_sigma", &KnotSettings::interval_sigma)
      .def_rw("window_sigma", &KnotSettings::window_sigma)
      .def_rw("residual_sigma", &KnotSettings::residual_sigma)
      .def_rw("reject_sigma", &KnotSettings::reject_sigma)
      .def_rw("max_iterations", &KnotSettings::max_iterations)
      .def_rw("tolerance", &KnotSettings::tolerance)
      .def_rw("max_levels", &KnotSettings::max_levels);

  nb::class_<EstimatorSettings>(m, "EstimatorSettings",
                                "Settings of the window estimators, with their defaults.")
      .def(nb::init<>())
      .def_rw("knots", &EstimatorSettings::knots)
      .def_rw("window", &EstimatorSettings::window)
      .def_rw("window_intervals", &EstimatorSettings::window_intervals)
      .def_rw("map_window_intervals", &EstimatorSettings::map_window_intervals)
      .def_rw("gap_periods", &EstimatorSettings::gap_periods)
      .def_rw("dependence_sigma", &EstimatorSettings::dependence_sigma)
      .def_rw("few_samples", &EstimatorSettings::few_samples)
      .def_rw("max_rounds", &EstimatorSettings::max_rounds)
      .def_rw("max_iterations", &EstimatorSettings::max_iterations)
      .def_rw("tolerance", &EstimatorSettings::tolerance)
      .def_rw("threads", &EstimatorSettings::threads);

  nb::class_<RecordedLog>(m, "RecordedLog", "The streams of one log, each at its own times [s].")
      .def(nb::init<>())
      .def_rw("payload", &RecordedLog::payload)
      .def_rw("shift", &RecordedLog::shift,
              "6 x 6 map from the logged twist to that of the payload's centre of mass")
      .def_rw("gravity_constant", &RecordedLog::gravity_constant)
      .def("add_motion", &RecordedLog::add_motion, nb::arg("order"), nb::arg("time"), nb::arg("value"),
           nb::arg("sigma"),
           "Measurements (N, 6) of the order-th derivative of the twist, NaN where missing.")
      .def("set_wrench", &RecordedLog::set_wrench, nb::arg("time"), nb::arg("raw"), nb::arg("gravity").none(),
           "Raw sensor samples (N, n), NaN where missing, and gravity (N, 3) in sensor axes or None.");

  nb::class_<GroupStatistics>(m, "GroupStatistics", "Residuals of one stream against their noise.")
      .def_ro("sum_of_squares", &GroupStatistics::sum_of_squares)
      .def_ro("count", &GroupStatistics::count)
      .def_ro("leverage", &GroupStatistics::leverage)
      .def_prop_ro("deviate", &GroupStatistics::deviate);

  nb::class_<WindowReport>(m, "WindowReport", "One window: where it lies, its knots and how well it fits.")
      .def_ro("log", &WindowReport::log)
      .def_ro("begin", &WindowReport::begin)
      .def_ro("end", &WindowReport::end)
      .def_ro("status", &WindowReport::status)
      .def_ro("intervals", &WindowReport::intervals)
      .def_ro("samples_per_coefficient", &WindowReport::samples_per_coefficient)
      .def_ro("samples", &WindowReport::samples)
      .def_prop_ro("groups",
                   [](const WindowReport& r) {
                     return std::vector<GroupStatistics>(r.groups.begin(), r.groups.end());
                   })
      .def_ro("nested", &WindowReport::nested)
      .def_ro("nested_expected", &WindowReport::nested_expected);

  nb::class_<HistoryEntry>(m, "HistoryEntry", "The common parameters after a window of `online`, normalised.")
      .def_ro("log", &HistoryEntry::log)
      .def_ro("time", &HistoryEntry::time)
      .def_ro("mean", &HistoryEntry::mean)
      .def_ro("sigma", &HistoryEntry::sigma);

  nb::class_<Estimate>(m, "Estimate",
                       "Result of `online` or `map`, normalised: [gain row by row, offset] of every log.")
      .def_prop_ro("solved",
                   [](const Estimate& e) { return e.status == Status::ok && !e.posterior.mean.empty(); })
      .def_ro("converged", &Estimate::converged)
      .def_prop_ro("mean", [](const Estimate& e) { return e.posterior.mean; })
      .def_prop_ro("covariance", [](const Estimate& e) { return e.posterior.covariance; })
      .def_ro("windows", &Estimate::windows)
      .def_ro("history", &Estimate::history)
      .def_prop_ro(
          "wrench", [](const Estimate& e) { return e.wrench; },
          "Per log: the payload's wrench (rows of set_wrench, 6), SI, NaN where no window fits.")
      .def_ro("knot_dependence", &Estimate::knot_dependence)
      .def_ro("window_dependence", &Estimate::window_dependence)
      .def_ro("iterations", &Estimate::iterations);

  m.def(
      "twist_shift", &twist_shift, nb::arg("r"),
      "6 x 6 map from the twist of a point to that of another of the same body, r [m] from the first to it.");

  m.def("estimate", &estimate, nb::arg("method"), nb::arg("logs"), nb::arg("channel_scale"), nb::arg("sigma"),
        nb::arg("wrench_scale"), nb::arg("prior_mean"), nb::arg("prior_information"), nb::arg("pool_offsets"),
        nb::arg("settings"),
        "Estimate the normalised gain and offsets from windows of motion ('online' or 'map').");
}

}  // namespace truewrench::python
