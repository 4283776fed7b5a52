// The two estimators over windows of motion (docs/method.md, "Online and map").
//
// `online`: windows in sequence; each is solved jointly with the gain under what the ones before left.
// `map`:    all windows share one gain; given it they are independent, and only their small matrices are added.
#pragma once

#include "truewrench/window_sequence.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace truewrench {

template <int N>
class Estimator {
 public:
  Estimator(std::vector<LogData> logs, const SensorScale<N>& sensor, CommonPrior prior,
            const EstimatorSettings& settings)
      : problem_(std::move(logs), sensor, std::move(prior), settings) {}

  Estimate online() {
    Estimate out;
    WindowSet<N> set = WindowSequence<N>(problem_).run(out);
    set.conclude(out);
    // Windows linearised at different gains disagree about which change of the gain a change of the payload
    // undoes, and together would claim to know the payload: all of them are taken to the final gain.
    if (out.status == Status::ok && (set.reconsider(out.posterior) || problem_.prior.layout.payload)) {
      set.settle(out, problem_.settings.tolerance);
      set.leave_out_pushes(out);
      problem_.prepare_wrench(out);
      if (out.status == Status::ok) set.predict(out);
    }
    if (out.status == Status::ok) out.window_dependence = set.doubled(out.posterior);
    out.gates = problem_.gates;
    out.spacing = set.spacings(problem_.first_spacings());
    return out;
  }

  // Without a start all is found from the logs at once. What fits badly so, by contacts say, may still fit in most
  // places: `online`, whose windows come one by one, can then be the start of another attempt.
  Estimate map(const Start& start = {}) {
    Estimate out;
    WindowSet<N> set(problem_);
    if (start.mean.empty()) {
      share_all(out, set, gradually(out, set));
    } else {
      problem_.begin(out);
      out.posterior.mean = start.mean;
      out.posterior.covariance = start.covariance;
      share_all(out, set, start.spacing);
    }
    return out;
  }

 private:
  // The common parameters from all windows at once, and the knot spacing that the data ask for. A precise sensor whose
  // gain is not known would bend motion, clock and knots until they agree with it; so it is believed step by step, from
  // the size of its misfit to its noise, and samples far off count little on the way. A window that does not fit keeps
  // its knots: without it, a gain found from few others would be further off.
  std::vector<double> gradually(Estimate& out, WindowSet<N>& set) {
    std::vector<double> spacing = problem_.first_spacings();
    problem_.begin(out);
    if (out.status != Status::ok) return spacing;
    problem_.disbelieve(problem_.settings.disregard);  // knots of the velocities alone
    set.windows = lay_out(spacing, problem_.settings.map_window_intervals, out.posterior, {});
    std::vector<BSpline> plain;
    for (const LogWindow& i : set.windows) plain.push_back(i.fit.spline);
    double variance = std::max(1.0, problem_.settings.disregard * set.misfit_of_sensor());
    for (bool all_fit = false;;) {
      problem_.disbelieve(variance);
      set.iterate(out, problem_.settings.settled,
                  variance == 1.0 && all_fit ? 0.0 : problem_.settings.freedom);
      if (out.status != Status::ok || variance == 1.0) break;
      spacing = set.spacings(spacing);
      const double left = variance * set.misfit_of_sensor();
      variance =
          std::max(1.0, std::min(variance / problem_.settings.believe, problem_.settings.believe * left));
      problem_.disbelieve(variance);
      std::vector<char> fits(set.windows.size(), 1);
      parallel_for(set.windows.size(), problem_.settings.threads, [&](std::size_t k) {
        LogWindow& w = set.windows[k];
        if (!problem_.enough_samples(w.range)) return;
        const bool fitted = w.fit.status == WindowStatus::fitted;
        WindowFit fit =
            problem_.solver(w.log).search(w.range, fitted ? w.fit.spline : plain[k],
                                          out.posterior.mean[w.log], nullptr, problem_.finest[w.log]);
        fits[k] = fit.status == WindowStatus::fitted;
        if (fits[k] || !fitted) w.fit = std::move(fit);
      });
      all_fit = std::all_of(fits.begin(), fits.end(), [](char f) { return f != 0; });
    }
    problem_.disbelieve(1.0);
    return set.spacings(spacing);
  }

  // `map` on windows of so many knot intervals, longer ones while the gain depends on their length.
  void share_all(Estimate& out, WindowSet<N>& set, const std::vector<double>& spacing) {
    for (int intervals = problem_.settings.map_window_intervals; out.status == Status::ok; intervals *= 2) {
      share(out, set, spacing, intervals);
      if (out.status != Status::ok) break;
      out.window_dependence = set.doubled(out.posterior);
      // It falls about as the root of their length.
      const double longer =
          problem_.settings.longest_window * problem_.settings.map_window_intervals / intervals;
      const bool depends = out.window_dependence >= problem_.settings.dependence_sigma;
      if (!depends || out.window_dependence >= problem_.settings.dependence_sigma * std::sqrt(longer)) break;
    }
    problem_.prepare_wrench(out);
    if (out.status == Status::ok) set.predict(out);
    out.gates = problem_.gates;
    out.spacing = set.spacings(spacing);
  }

  // `map` on windows of about so many knot intervals: knots at the gain of the pass before, then the gain on all of
  // them; once more where the gain has moved; and finer knots while the data ask for them.
  void share(Estimate& out, WindowSet<N>& set, const std::vector<double>& spacing, int intervals) {
    bool search_again = true, far = true;
    for (int round = 0; round < problem_.settings.max_rounds; ++round) {
      const std::vector<Eigen::VectorXd> before = out.posterior.mean;
      if (search_again) {  // windows that fit stay as they are, unless the gain is another
        set.windows = lay_out(spacing, intervals, out.posterior,
                              far ? std::vector<LogWindow>{} : std::move(set.windows));
      }
      set.settle(out, problem_.settings.tolerance);
      if (out.status != Status::ok) return;
      // A window searched at a poor gain bends its knots to it, or is rejected.
      const auto [fitted, all] = fitted_samples(out.windows);
      const bool rejected = all - fitted > problem_.settings.few_rejected * all;
      const double by = squared_distance(before, out.posterior);
      far = by > problem_.prior.layout.size();
      search_again = far || ((round == 0 || rejected) && by > 0.1);
      if (search_again) continue;
      if (std::max(out.knot_dependence, set.nested_deviate()) < problem_.settings.dependence_sigma) break;
      if (!set.halve()) break;
    }
    set.leave_out_pushes(out);
  }

  // Windows of `map` with their knots, searched at a given gain; those that fitted before are taken over. A window that
  // does not fit is cut in two, down to the length of a window of `online`, so that a disturbance costs only its
  // surroundings.
  std::vector<LogWindow> lay_out(const std::vector<double>& spacing, int intervals,
                                 const Posterior& posterior, std::vector<LogWindow> before) const {
    std::vector<LogWindow> items;
    for (std::size_t l = 0; l < problem_.logs.size(); ++l) {
      const double target = std::max(problem_.settings.window, intervals * spacing[l]);
      const auto [delay, delay_sigma] = problem_.clock(posterior.mean[l], posterior.covariance[l]);
      for (const auto& [begin, end] : unbroken_stretches(problem_.logs[l], problem_.settings.gap_periods)) {
        const int count = std::max(1, static_cast<int>(std::ceil((end - begin) / target)));
        const std::vector<double> edges = BSpline::uniform(begin, end, count);
        for (int i = 0; i < count; ++i) {
          const auto k = static_cast<std::size_t>(i);
          items.push_back(
              {l, problem_.range(l, edges[k], edges[k + 1], i + 1 == count, delay, delay_sigma), {}});
        }
      }
    }
    std::vector<std::vector<LogWindow>> parts(items.size());
    parallel_for(items.size(), problem_.settings.threads, [&](std::size_t i) {
      const auto same = std::find_if(before.begin(), before.end(), [&, &item = items[i]](const LogWindow& b) {
        return b.fit.status == WindowStatus::fitted && b.log == item.log &&
               b.range.begin == item.range.begin && b.range.end == item.range.end;
      });
      if (same != before.end()) {
        parts[i].push_back(std::move(*same));
      } else {
        search(items[i], spacing[items[i].log], posterior, parts[i]);
      }
    });
    std::vector<LogWindow> out;
    for (auto& part : parts) std::move(part.begin(), part.end(), std::back_inserter(out));
    return out;
  }

  void search(LogWindow item, double spacing, const Posterior& posterior, std::vector<LogWindow>& out) const {
    const WindowRange& w = item.range;
    const double length = w.end - w.begin;
    if (problem_.enough_samples(w)) {
      const int start = static_cast<int>(length / (4.0 * spacing));
      WindowSolver<N> solver = problem_.solver(item.log);
      const BSpline knots = problem_.knots_to_begin_with(item.log, w, start);
      const Eigen::VectorXd& theta = posterior.mean[item.log];
      item.fit = solver.search(w, knots, theta, nullptr, problem_.finest[item.log]);
      if (item.fit.status != WindowStatus::fitted) {
        // What little is wrong with a gain of few windows may be much to a good sensor.
        const Prior prior{problem_.inverse(posterior.covariance[item.log]), theta};
        if (solver.lost(item.fit, w, prior)) return out.push_back(std::move(item));
        WindowFit freed = solver.search(w, knots, theta, &prior, problem_.finest[item.log]);
        if (freed.status == WindowStatus::fitted) item.fit = std::move(freed);
      }
      if (item.fit.status != WindowStatus::fitted && length >= 2.0 * problem_.settings.window) {
        const auto [first, second] = halves(item, posterior);
        search({item.log, first, {}}, spacing, posterior, out);
        search({item.log, second, {}}, spacing, posterior, out);
        return;
      }
    }
    out.push_back(std::move(item));
  }

  // The window cut in the middle; the second half ends with the same samples.
  std::pair<WindowRange, WindowRange> halves(const LogWindow& item, const Posterior& posterior) const {
    const WindowRange& w = item.range;
    const auto [delay, sigma] = problem_.clock(posterior.mean[item.log], posterior.covariance[item.log]);
    const double middle = 0.5 * (w.begin + w.end);
    std::pair out(problem_.range(item.log, w.begin, middle, false, delay, sigma),
                  problem_.range(item.log, middle, w.end, false, delay, sigma));
    out.second.wrench.second = w.wrench.second;
    for (std::size_t m = 0; m < w.motion.size(); ++m) out.second.motion[m].second = w.motion[m].second;
    return out;
  }

  Problem<N> problem_;
};

}  // namespace truewrench
