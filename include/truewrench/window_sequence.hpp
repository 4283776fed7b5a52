// A pass over the logs, windows in sequence: each is solved jointly with the common parameters under what the ones before
// left (docs/method.md, "Online and map").
#pragma once

#include "truewrench/window_set.hpp"

#include <algorithm>
#include <tuple>
#include <utility>
#include <vector>

namespace truewrench {

template <int N>
class WindowSequence {
 public:
  explicit WindowSequence(Problem<N>& problem) : problem_(problem) {}

  // The first window can take a contact for a gain, and then no other window fits: where few fit, passes that begin
  // elsewhere are tried, and the one that explains most samples stands. Windows and reports are in the order of time.
  WindowSet<N> run(Estimate& out) const {
    WindowSet<N> set(problem_);
    double best = -1.0;
    for (const Beginning& beginning : beginnings()) {
      // Where no window at all fits, none has spoilt the others.
      const bool first = beginning.share == 0.0;
      if (beginning.clock == 0.0 ? !first && best == 0.0 : !first || best > 0.0) continue;
      Estimate tried;
      WindowSet<N> of_pass = pass(beginning, tried);
      const auto [used, all] = fitted_samples(tried.windows);
      if (used > best) {
        best = used;
        out = std::move(tried);
        set = std::move(of_pass);
      }
      if (used >= problem_.settings.enough_fitted * all) break;
    }
    problem_.gates = out.gates;  // every pass writes its own
    std::sort(out.windows.begin(), out.windows.end(), [](const WindowReport& a, const WindowReport& b) {
      return std::tie(a.log, a.begin) < std::tie(b.log, b.begin);
    });
    std::sort(set.windows.begin(), set.windows.end(), [](const LogWindow& a, const LogWindow& b) {
      return std::tie(a.log, a.range.begin) < std::tie(b.log, b.range.begin);
    });
    return set;
  }

 private:
  // Of a log's stretches, and of its clock's prior: a clock far from its mean can also keep every window from fitting.
  struct Beginning {
    double share;
    double clock;  // sigmas from the mean
  };

  std::vector<Beginning> beginnings() const {
    const bool clock = problem_.prior.layout.time_offset;
    std::vector<Beginning> out;
    for (const double sigmas : clock ? std::vector{0.0, 1.0, -1.0, 2.0, -2.0} : std::vector{0.0}) {
      for (const double share : {0.0, 0.5, 0.25, 0.75}) out.push_back({share, sigmas});
    }
    return out;
  }

  // Stretches of a log in the order of a pass that begins at this share of it.
  std::vector<std::pair<double, double>> stretches(std::size_t log, double start) const {
    std::vector<std::pair<double, double>> all =
        unbroken_stretches(problem_.logs[log], problem_.settings.gap_periods);
    if (all.empty() || start == 0.0) return all;
    const double first = all.front().first + start * (all.back().second - all.front().first);
    std::vector<std::pair<double, double>> before, out;
    for (const auto& [begin, end] : all) {
      if (end <= first) {
        before.emplace_back(begin, end);
      } else if (begin >= first) {
        out.emplace_back(begin, end);
      } else {
        before.emplace_back(begin, first);
        out.emplace_back(first, end);
      }
    }
    out.insert(out.end(), before.begin(), before.end());
    return out;
  }

  WindowSet<N> pass(const Beginning& beginning, Estimate& out) const {
    WindowSet<N> set(problem_);
    out.converged = true;
    problem_.prepare_wrench(out);
    for (std::size_t l = 0; l < problem_.logs.size(); ++l) {
      Prior prior = problem_.before(l, set.coarse);
      auto [delay, delay_sigma] = problem_.clock(prior.mean, problem_.inverse(prior.information));
      // Only where the search begins: the prior stays what it is.
      double shift = beginning.clock * delay_sigma;
      double length = problem_.settings.window;
      double spacing = 0.0;
      WindowSolver<N> solver = problem_.solver(l);
      for (const auto& [begin, end] : stretches(l, beginning.share)) {
        bool may_extend = true;
        for (double t = begin; t < end;) {
          const double stop = end - (t + length) < 0.5 * length ? end : t + length;
          const WindowRange window = problem_.range(l, t, stop, stop == end, delay, delay_sigma);
          WindowFit fit;
          if (problem_.enough_samples(window)) {
            const int start = spacing > 0.0 ? static_cast<int>((stop - t) / (2.0 * spacing)) : 1;
            Eigen::VectorXd from = prior.mean;
            if (problem_.prior.layout.time_offset) from[problem_.prior.layout.time_offset_begin()] += shift;
            fit = solver.search(window, problem_.knots_to_begin_with(l, window, start), from, &prior,
                                problem_.finest[l]);
          }
          const bool fitted = fit.status == WindowStatus::fitted;
          // Motion that is slow for the window: a longer one determines it better.
          if (fitted && may_extend && stop < end &&
              fit.spline.intervals() < problem_.settings.window_intervals) {
            length *= 2.0;
            continue;
          }
          if (!fitted && length > problem_.settings.window) {
            length = std::max(problem_.settings.window, 0.5 * length);
            may_extend = false;
            continue;
          }
          out.windows.push_back(problem_.report(l, window, fit));
          if (fitted) {
            set.coarse[l].add(fit.information, fit.theta);
            set.fine[l].add(fit.finer, fit.theta);
            prior.information += fit.information.matrix;
            prior.mean = fit.theta;
            const Eigen::MatrixXd covariance = problem_.inverse(prior.information);
            std::tie(delay, delay_sigma) = problem_.clock(prior.mean, covariance);
            shift = 0.0;
            spacing = (stop - t) / fit.spline.intervals();
            out.history.push_back(
                {static_cast<int>(l), stop, prior.mean, covariance.diagonal().cwiseMax(0.0).cwiseSqrt()});
            solver.predict(fit, window, out.wrench[l]);
            if (fit.spline.intervals() > 4 * problem_.settings.window_intervals) {
              length = std::max(problem_.settings.window, 0.5 * length);
            }
          } else if (fit.status == WindowStatus::not_converged) {
            out.converged = false;
          }
          out.iterations += fit.iterations;
          set.windows.push_back({l, window, {}});
          set.windows.back().fit.status = fit.status;
          set.windows.back().fit.theta = prior.mean;
          set.windows.back().fit.spline = std::move(fit.spline);
          set.windows.back().fit.x = std::move(fit.x);
          may_extend = true;
          t = stop;
        }
      }
    }
    out.gates = problem_.gates;
    return set;
  }

  Problem<N>& problem_;
};

}  // namespace truewrench
