// What is to be estimated from what: the logs with their models and gates, and what is known beforehand.
#pragma once

#include "truewrench/estimate.hpp"
#include "truewrench/knots.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace truewrench {

template <int N>
struct Problem {
  Problem(std::vector<LogData> recorded, const SensorScale<N>& sensor, CommonPrior known,
          const EstimatorSettings& chosen)
      : logs(std::move(recorded)), prior(std::move(known)), settings(chosen) {
    for (const LogData& log : logs) gates.emplace_back(log);
    for (std::size_t l = 0; l < logs.size(); ++l) {
      models.emplace_back(logs[l], sensor, prior.layout, &gates[l]);
      finest.push_back(settings.knots.samples_per_coefficient * slowest_period(logs[l]));
    }
  }
  Problem(const Problem&) = delete;  // the models point into it
  Problem& operator=(const Problem&) = delete;

  // Of every log, before any of its windows.
  std::vector<InformationSum> nothing_seen() const {
    return std::vector<InformationSum>(logs.size(), InformationSum(prior.layout.size()));
  }

  std::vector<double> first_spacings() const {
    return std::vector<double>(logs.size(), settings.window / settings.window_intervals);
  }

  // What the priors say.
  void begin(Estimate& out) const {
    out.posterior = combine(prior, nothing_seen());
    out.status = out.posterior.status;
  }

  // What is known of a log's parameters before its first window, from the logs before it.
  Prior before(std::size_t log, std::vector<InformationSum> sums) const {
    sums.erase(sums.begin() + static_cast<std::ptrdiff_t>(log) + 1, sums.end());
    const Posterior posterior = combine(prior, sums);
    return {inverse(posterior.covariance[log]), posterior.mean[log]};
  }

  static Eigen::MatrixXd inverse(const Eigen::MatrixXd& m) {
    // Scaled to a unit diagonal: the parameters' units, and with them the matrix' elements, are far apart.
    const Eigen::VectorXd d =
        m.diagonal().cwiseMax(std::numeric_limits<double>::min()).cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd scaled = d.asDiagonal() * m * d.asDiagonal();
    return d.asDiagonal() * scaled.llt().solve(Eigen::MatrixXd::Identity(m.rows(), m.cols())) *
           d.asDiagonal();
  }

  // Time offset of a log and its sigma, from a posterior or prior of its common parameters.
  std::pair<double, double> clock(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance) const {
    if (!prior.layout.time_offset) return {0.0, 0.0};
    const int k = prior.layout.time_offset_begin();
    return {mean[k], std::sqrt(std::max(0.0, covariance(k, k)))};
  }

  // Samples of [begin, end) of a log, given what is known of its clocks.
  WindowRange range(std::size_t log, double begin, double end, bool closed, double delay,
                    double sigma) const {
    return range_of(logs[log], begin, end, closed, delay, 2.0 * sigma);
  }

  // Uniform knots, no wider than what it takes to undo the noise of a reference motion.
  BSpline knots_to_begin_with(std::size_t log, const WindowRange& w, int intervals) const {
    if (const auto& reference = logs[log].reference) {
      intervals =
          std::max(intervals, static_cast<int>(std::ceil(2.0 * (w.end - w.begin) / reference->spacing())));
    }
    return BSpline(BSpline::uniform(w.begin, w.end, std::max(1, intervals)));
  }

  static bool enough_samples(const WindowRange& w) {
    std::size_t motion = 0;
    for (const auto& m : w.motion) motion = std::max(motion, m.second - m.first);
    return motion > kActive && w.wrench.second - w.wrench.first > kActive;
  }

  double samples_per_coefficient(std::size_t log, const BSpline& spline) const {
    double narrowest = spline.end() - spline.begin();
    for (int i = 0; i < spline.intervals(); ++i) narrowest = std::min(narrowest, spline.width(i));
    return settings.knots.samples_per_coefficient * narrowest / finest[log];
  }

  WindowReport report(std::size_t log, const WindowRange& w, const WindowFit& fit) const {
    WindowReport r;
    r.log = static_cast<int>(log);
    r.begin = w.begin;
    r.end = w.end;
    r.status = fit.status;
    r.samples = w.wrench.second - w.wrench.first;
    if (fit.status == WindowStatus::too_short) return r;
    r.intervals = fit.spline.intervals();
    r.samples_per_coefficient = samples_per_coefficient(log, fit.spline);
    r.groups = fit.groups;
    r.components = fit.components;
    r.nested = fit.nested;
    r.nested_expected = fit.nested_expected;
    return r;
  }

  // No wrench is known yet.
  void prepare_wrench(Estimate& out) const {
    out.wrench.clear();
    for (const LogData& log : logs) {
      out.wrench.push_back(RowMatrix::Constant(static_cast<Eigen::Index>(log.wrench.time.size()), 6,
                                               std::numeric_limits<double>::quiet_NaN()));
    }
  }

  WindowSolver<N> solver(std::size_t log) const { return WindowSolver<N>(models[log], settings.knots); }

  // Takes the variance of every sensor's noise for so many times what is stated.
  void disbelieve(double times) {
    for (WindowModel<N>& m : models) m.disbelieve(times);
  }

  std::vector<LogData> logs;
  CommonPrior prior;
  EstimatorSettings settings;
  std::vector<Gate> gates;             // per log: the samples left out
  std::vector<WindowModel<N>> models;  // per log
  std::vector<double> finest;          // per log: the closest knots that its samples allow [s]
};

}  // namespace truewrench
