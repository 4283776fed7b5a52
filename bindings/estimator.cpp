// The window estimators over whole records: include/truewrench/estimator.hpp.
#include "bindings.hpp"

#include "truewrench/estimator.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/array.h>
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
  Vector3 point = Vector3::Zero();
  Vector3 gravity_constant = Vector3::Zero();
  struct Motion {
    int order;
    Array1 time;
    Array2 value;
    Vector6 sigma;
    std::optional<Matrix6> combination;
    std::optional<Array3> covariance;
    std::optional<Array3> coupling;
  };
  std::vector<Motion> motion;
  std::optional<ReferenceMotion> reference;
  std::optional<std::pair<Array1, Array2>> wrench;
  std::optional<Array1> temperature;
  std::optional<std::pair<Array1, Array2>> gravity;

  void add_motion(int order, Array1 time, Array2 value, const Vector6& sigma,
                  const std::optional<Matrix6>& combination, std::optional<Array3> covariance,
                  std::optional<Array3> coupling) {
    if (order < 0 || order > 2) throw nb::value_error("order must be 0, 1 or 2");
    if (value.shape(0) != time.shape(0) || value.shape(1) != 6)
      throw nb::value_error("motion: N x 6 is expected");
    for (const auto* m : {&covariance, &coupling}) {
      if (*m && ((*m)->shape(0) != time.shape(0) || (*m)->shape(1) != 6 || (*m)->shape(2) != 6))
        throw nb::value_error("motion: covariance and coupling are N x 6 x 6");
    }
    if (coupling && order == 0) throw nb::value_error("motion: order 0 has no order below");
    motion.push_back({order, std::move(time), std::move(value), sigma, combination, std::move(covariance),
                      std::move(coupling)});
  }

  void set_reference(const std::vector<double>& breakpoints, const Array2& twist, double spacing) {
    if (breakpoints.size() < 2 || twist.shape(0) != breakpoints.size() + kDegree - 1 || twist.shape(1) != 6)
      throw nb::value_error(
          "reference: 6 coefficients for each of K + 5 splines are expected on K intervals");
    reference.emplace(
        breakpoints,
        Eigen::Map<const Coefficients>(twist.data(), static_cast<Eigen::Index>(twist.shape(0)), 6), spacing);
  }

  void set_wrench(Array1 time, Array2 raw, std::optional<Array1> departure) {
    if (raw.shape(0) != time.shape(0)) throw nb::value_error("raw: one row per time is expected");
    if (departure && departure->shape(0) != time.shape(0))
      throw nb::value_error("temperature: one per time is expected");
    wrench.emplace(std::move(time), std::move(raw));
    temperature = std::move(departure);
  }

  void set_gravity(Array1 time, Array2 value) {
    if (value.shape(0) != time.shape(0) || value.shape(1) != 3)
      throw nb::value_error("gravity: N x 3 is expected");
    gravity.emplace(std::move(time), std::move(value));
  }

  LogData data() const {
    if (!wrench) throw nb::value_error("a log needs the sensor's samples: call set_wrench first");
    LogData d;
    d.payload = payload;
    d.point = point;
    for (const Motion& m : motion) {
      d.motion.push_back({m.order,
                          {m.time.data(), m.time.shape(0)},
                          m.value.data(),
                          m.sigma,
                          m.combination,
                          m.covariance ? m.covariance->data() : nullptr,
                          m.coupling ? m.coupling->data() : nullptr});
    }
    d.reference = reference;
    d.wrench = {{wrench->first.data(), wrench->first.shape(0)},
                wrench->second.data(),
                temperature ? temperature->data() : nullptr};
    d.gravity.constant = gravity_constant;
    if (gravity) {
      d.gravity.time = {gravity->first.data(), gravity->first.shape(0)};
      d.gravity.value = gravity->second.data();
    }
    return d;
  }
};

template <int N>
Estimate run(const std::string& method, std::vector<LogData> logs, const Eigen::VectorXd& channel_scale,
             const Eigen::VectorXd& sigma, const Vector6& wrench_scale, const CommonPrior& prior,
             const EstimatorSettings& settings, const Start& start) {
  Estimator<N> estimator(std::move(logs), SensorScale<N>{channel_scale, sigma, wrench_scale}, prior,
                         settings);
  return method == "online" ? estimator.online() : estimator.map(start);
}

void check(const CommonPrior& prior, const std::vector<const RecordedLog*>& logs) {
  const int p = prior.layout.size();
  if (prior.mean.size() != p || prior.information.size() != p) {
    throw nb::value_error("prior: mean and information of every common parameter of a log are expected");
  }
  for (std::size_t l = 0; l < prior.links.size(); ++l) {
    const auto size = prior.links[l].size();
    if (size != 0 && (size != p || l == 0 || l >= logs.size()))
      throw nb::value_error("prior: a link holds every parameter, and none leads to the first log");
  }
  if (!prior.layout.payload) return;
  if (prior.payload_of.size() != logs.size()) throw nb::value_error("prior: one payload per log is expected");
  for (const int k : prior.payload_of) {
    if (k < 0 || k >= static_cast<int>(prior.payload_information.size())) {
      throw nb::value_error("prior: a log carries a payload without a prior");
    }
  }
  for (const Eigen::VectorXd& i : prior.payload_information) {
    if (i.size() != kPayloadParameters)
      throw nb::value_error("prior: ten parameters per payload are expected");
  }
}

void check(const Start& start, const ParameterLayout& layout, std::size_t logs) {
  if (start.mean.size() != logs || start.covariance.size() != logs || start.spacing.size() != logs)
    throw nb::value_error("start: one mean, covariance and knot spacing per log are expected");
  const int p = layout.size();
  for (std::size_t l = 0; l < logs; ++l) {
    if (start.mean[l].size() != p || start.covariance[l].rows() != p || start.covariance[l].cols() != p)
      throw nb::value_error("start: every common parameter of a log is expected");
  }
}

Estimate estimate(const std::string& method, const std::vector<const RecordedLog*>& logs,
                  const Eigen::VectorXd& channel_scale, const Eigen::VectorXd& sigma,
                  const Vector6& wrench_scale, const CommonPrior& prior, const EstimatorSettings& settings,
                  const std::optional<Start>& start) {
  const int n = prior.layout.channels;
  if (method != "online" && method != "map") throw nb::value_error("method must be 'online' or 'map'");
  if (n < 6 || n > max_channels) throw nb::value_error("6 to 32 channels are supported");
  if (channel_scale.size() != n || sigma.size() != n)
    throw nb::value_error("one scale and sigma per channel is expected");
  check(prior, logs);
  std::vector<LogData> data;
  for (const RecordedLog* log : logs) {
    data.push_back(log->data());
    if (log->wrench->second.shape(1) != static_cast<std::size_t>(n)) {
      throw nb::value_error("raw: one column per channel is expected");
    }
  }
  if (start) check(*start, prior.layout, logs.size());
  const nb::gil_scoped_release release;
  auto* const compute = n == 6 ? run<6> : run<Eigen::Dynamic>;
  return compute(method, std::move(data), channel_scale, sigma, wrench_scale, prior, settings,
                 start.value_or(Start{}));
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
      .def_rw("max_levels", &KnotSettings::max_levels)
      .def_rw("false_disturbances", &KnotSettings::false_disturbances)
      .def_rw("false_pushes", &KnotSettings::false_pushes)
      .def_rw("disturbance_price", &KnotSettings::disturbance_price)
      .def_rw("hopeless_sigma", &KnotSettings::hopeless_sigma)
      .def_rw("hopeless_share", &KnotSettings::hopeless_share)
      .def_rw("most_disturbed", &KnotSettings::most_disturbed);

  nb::class_<EstimatorSettings>(m, "EstimatorSettings",
                                "Settings of the window estimators, with their defaults.")
      .def(nb::init<>())
      .def_rw("knots", &EstimatorSettings::knots)
      .def_rw("window", &EstimatorSettings::window)
      .def_rw("window_intervals", &EstimatorSettings::window_intervals)
      .def_rw("map_window_intervals", &EstimatorSettings::map_window_intervals)
      .def_rw("gap_periods", &EstimatorSettings::gap_periods)
      .def_rw("dependence_sigma", &EstimatorSettings::dependence_sigma)
      .def_rw("enough_fitted", &EstimatorSettings::enough_fitted)
      .def_rw("few_samples", &EstimatorSettings::few_samples)
      .def_rw("max_rounds", &EstimatorSettings::max_rounds)
      .def_rw("max_iterations", &EstimatorSettings::max_iterations)
      .def_rw("tolerance", &EstimatorSettings::tolerance)
      .def_rw("settled", &EstimatorSettings::settled)
      .def_rw("threads", &EstimatorSettings::threads);

  nb::class_<ParameterLayout>(m, "ParameterLayout",
                              "Which common parameters a log has: [gains row by row | payload | slope with "
                              "temperature | offset | time offset].")
      .def(nb::init<>())
      .def_rw("channels", &ParameterLayout::channels)
      .def_rw("payload", &ParameterLayout::payload)
      .def_rw("temperature", &ParameterLayout::temperature)
      .def_rw("offset", &ParameterLayout::offset)
      .def_rw("pool_offsets", &ParameterLayout::pool_offsets)
      .def_rw("time_offset", &ParameterLayout::time_offset)
      .def_prop_ro("payload_begin", &ParameterLayout::payload_begin)
      .def_prop_ro("temperature_begin", &ParameterLayout::temperature_begin)
      .def_prop_ro("offset_begin", &ParameterLayout::offset_begin)
      .def_prop_ro("time_offset_begin", &ParameterLayout::time_offset_begin)
      .def_prop_ro("size", &ParameterLayout::size);

  nb::class_<CommonPrior>(m, "CommonPrior", "Independent priors of the common parameters, normalised.")
      .def(nb::init<>())
      .def_rw("layout", &CommonPrior::layout)
      .def_rw("mean", &CommonPrior::mean, "Of one log's vector.")
      .def_rw("information", &CommonPrior::information, "1 / variance; the payload's entries are not used.")
      .def_rw("gains_walk", &CommonPrior::gains_walk, "Every log has gains of its own.")
      .def_rw("links", &CommonPrior::links,
              "Per log, 1 / variance of the step of its own parameters from those of the log before, 0 where "
              "there "
              "is none; or an empty vector.")
      .def_rw("payload_of", &CommonPrior::payload_of, "Per log: which payload it carries.")
      .def_rw("payload_information", &CommonPrior::payload_information,
              "Per payload, 1 / variance of [mass, relative; centre of mass [m]; xx yy zz xy xz yz of the "
              "inertia, "
              "relative to sqrt(I_ii I_jj)].");

  nb::class_<RecordedLog>(m, "RecordedLog", "The streams of one log, each at its own times [s].")
      .def(nb::init<>())
      .def_rw("payload", &RecordedLog::payload, "As stated.")
      .def_rw("point", &RecordedLog::point, "The point whose twist is logged, fixed to the sensor [m].")
      .def_rw("gravity_constant", &RecordedLog::gravity_constant)
      .def("add_motion", &RecordedLog::add_motion, nb::arg("order"), nb::arg("time"), nb::arg("value"),
           nb::arg("sigma"), nb::arg("combination").none() = nb::none(),
           nb::arg("covariance").none() = nb::none(), nb::arg("coupling").none() = nb::none(),
           "Measurements (N, 6) of the order-th derivative of the twist, or about a reference of the "
           "displacement, "
           "or of a combination (6, 6) of its components; NaN where missing. `covariance` (N, 6, 6) instead "
           "of "
           "sigma; `coupling` (N, 6, 6): plus so much of the derivative of the order below.")
      .def("set_reference", &RecordedLog::set_reference, nb::arg("breakpoints"), nb::arg("twist"),
           nb::arg("spacing"),
           "The motion is then a displacement from this one: coefficients (K + 5, 6) of the quintic spline "
           "of the "
           "logged point's twist, and the spacing of the knots of the fit behind it [s].")
      .def("set_wrench", &RecordedLog::set_wrench, nb::arg("time"), nb::arg("raw"),
           nb::arg("temperature").none() = nb::none(),
           "Raw sensor samples (N, n), NaN where missing, and the departure from the reference temperature "
           "(N,) [K].")
      .def("set_gravity", &RecordedLog::set_gravity, nb::arg("time"), nb::arg("value"),
           "Gravity (N, 3) in sensor axes on the clock of the motion.");

  nb::class_<GroupStatistics>(m, "GroupStatistics", "Residuals of one stream against their noise.")
      .def_ro("sum_of_squares", &GroupStatistics::sum_of_squares)
      .def_ro("count", &GroupStatistics::count)
      .def_ro("leverage", &GroupStatistics::leverage)
      .def_prop_ro("deviate", &GroupStatistics::deviate);

  nb::class_<ComponentStatistics>(m, "ComponentStatistics",
                                  "Residuals of one channel or component of the motion over their noise, and "
                                  "of their means over runs of 2, 4, 8 ... samples.")
      .def_ro("all", &ComponentStatistics::all)
      .def_ro("run_squares", &ComponentStatistics::run_squares)
      .def_ro("runs", &ComponentStatistics::runs);

  nb::class_<WindowReport>(m, "WindowReport", "One window: where it lies, its knots and how well it fits.")
      .def_rw("log", &WindowReport::log)
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
      .def_ro(
          "components", &WindowReport::components,
          "ComponentStatistics of the channels, then of the six components of the motion; empty for a window "
          "without a fit.")
      .def_ro("nested", &WindowReport::nested)
      .def_ro("nested_expected", &WindowReport::nested_expected);

  nb::class_<HistoryEntry>(m, "HistoryEntry", "The common parameters after a window of `online`, normalised.")
      .def_rw("log", &HistoryEntry::log)
      .def_ro("time", &HistoryEntry::time)
      .def_ro("mean", &HistoryEntry::mean)
      .def_ro("sigma", &HistoryEntry::sigma);

  nb::class_<Estimate>(m, "Estimate",
                       "Result of `online` or `map`, normalised: the common parameters of every log.")
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
      .def_prop_ro(
          "left_out",
          [](const Estimate& e) {
            std::vector<Eigen::Matrix<bool, Eigen::Dynamic, 1>> out;
            for (const Gate& g : e.gates) {
              out.push_back(Eigen::Map<const Eigen::Matrix<char, Eigen::Dynamic, 1>>(
                                g.wrench.data(), static_cast<Eigen::Index>(g.wrench.size()))
                                .cast<bool>());
            }
            return out;
          },
          "Per log: whether a row of set_wrench was left out as a disturbance.")
      .def_prop_ro(
          "motion_left_out",
          [](const Estimate& e) {
            std::vector<std::vector<std::size_t>> out;
            for (const Gate& g : e.gates) {
              out.emplace_back();
              for (const std::vector<char>& series : g.motion)
                out.back().push_back(static_cast<std::size_t>(std::count(series.begin(), series.end(), 1)));
            }
            return out;
          },
          "Per log and series of the motion: how many rows were left out as disturbances.")
      .def_ro("knot_dependence", &Estimate::knot_dependence)
      .def_ro("window_dependence", &Estimate::window_dependence)
      .def_ro("spacing", &Estimate::spacing, "Per log: typical knot spacing [s].")
      .def_ro("iterations", &Estimate::iterations);

  nb::class_<Start>(m, "Start", "Where `map` may begin: per log.")
      .def(nb::init<>())
      .def_rw("mean", &Start::mean, "Common parameters, normalised.")
      .def_rw("covariance", &Start::covariance, "Of them.")
      .def_rw("spacing", &Start::spacing, "Of the knots [s].");

  m.def("estimate", &estimate, nb::arg("method"), nb::arg("logs"), nb::arg("channel_scale"), nb::arg("sigma"),
        nb::arg("wrench_scale"), nb::arg("prior"), nb::arg("settings"), nb::arg("start") = nb::none(),
        "Estimate the normalised gain and what else is common from windows of motion ('online' or 'map').");
}

}  // namespace truewrench::python
