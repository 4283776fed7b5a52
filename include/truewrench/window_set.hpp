// Windows of motion that share the common parameters (docs/method.md, "Online and map").
#pragma once

#include "truewrench/parallel.hpp"
#include "truewrench/problem.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

namespace truewrench {

struct LogWindow {
  std::size_t log;
  WindowRange range;
  WindowFit fit;
};

template <int N>
class WindowSet {
 public:
  explicit WindowSet(Problem<N>& problem)
      : coarse(problem.nothing_seen()), fine(coarse), problem_(&problem) {}

  std::vector<LogWindow> windows;
  std::vector<InformationSum> coarse;  // what they say of every log's parameters,
  std::vector<InformationSum> fine;    // and what they would say with every knot interval halved

  // Gauss-Newton on the common parameters with the knots held.
  bool iterate(Estimate& out, double tolerance, double freedom = 0.0) {
    double decrement = 0.0;
    for (int i = 0; i < problem_->settings.max_iterations; ++i) {
      parallel_for(windows.size(), problem_->settings.threads, [&](std::size_t k) {
        LogWindow& w = windows[k];
        if (w.fit.status != WindowStatus::fitted) return;
        WindowSolver<N> solver = problem_->solver(w.log);
        if (solver.relinearise(w.fit, w.range, out.posterior.mean[w.log], freedom) != Status::ok) {
          w.fit.status = WindowStatus::motion_undetermined;
        }
      });
      sum();
      Posterior next = combine(problem_->prior, coarse);
      out.status = next.status;
      if (out.status != Status::ok) return false;
      decrement = squared_distance(out.posterior.mean, next);
      out.posterior = std::move(next);
      ++out.iterations;
      if (decrement < tolerance) return true;
    }
    return decrement < problem_->settings.settled;
  }

  // The common parameters on all windows with their knots held, and the verdict on every window there.
  void settle(Estimate& out, double tolerance) {
    out.converged = iterate(out, tolerance);
    if (out.status != Status::ok) return;
    review(out.posterior.mean);
    sum();
    conclude(out);
    out.windows.clear();
    for (const LogWindow& i : windows) out.windows.push_back(problem_->report(i.log, i.range, i.fit));
  }

  // Searches again, at the common gain, the windows that looked suspect on the way to it. True where one changed.
  bool reconsider(const Posterior& posterior) {
    std::vector<char> changed(windows.size(), 0);
    parallel_for(windows.size(), problem_->settings.threads, [&](std::size_t k) {
      LogWindow& w = windows[k];
      if (!problem_->enough_samples(w.range)) return;
      WindowSolver<N> solver = problem_->solver(w.log);
      w.fit.theta = posterior.mean[w.log];
      if (!solver.suspect(w.fit, w.range)) return;
      Gate& gate = problem_->gates[w.log];
      const auto left_out = gate.of(w.range);
      WindowFit fit = solver.search(w.range, problem_->knots_to_begin_with(w.log, w.range, 1),
                                    posterior.mean[w.log], nullptr, problem_->finest[w.log]);
      changed[k] = fit.status == WindowStatus::fitted &&
                   (w.fit.status != WindowStatus::fitted ||
                    fit.spline.breakpoints() != w.fit.spline.breakpoints() || fit.disturbances > 0);
      if (changed[k]) {
        w.fit = std::move(fit);
      } else {
        gate.restore(w.range, left_out);
      }
    });
    return std::any_of(changed.begin(), changed.end(), [](char c) { return c != 0; });
  }

  // Leaves out the strongest pushes that the gain has taken up, and settles anew, until there are none. Windows without
  // any are asked again last.
  void leave_out_pushes(Estimate& out) {
    std::vector<std::size_t> all(windows.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    std::vector<std::size_t> asked = all;
    int rounds = 0;
    while (rounds < problem_->settings.max_pushes && out.status == Status::ok) {
      const std::vector<Push> found = pushes(asked, out.posterior);
      if (found.empty()) {
        if (asked.size() == all.size()) break;
        asked = all;
        continue;
      }
      double most = 0.0;
      for (const Push& p : found) most = std::max(most, p.samples.deviate);
      asked.clear();
      for (const Push& p : found) {
        asked.push_back(p.window);
        if (p.samples.deviate < problem_->settings.shadow * most) continue;
        Gate::leave_out(problem_->gates[windows[p.window].log].wrench, p.samples.first, p.samples.last);
      }
      settle(out, problem_->settings.settled);
      ++rounds;
    }
    if (rounds > 0 && out.status == Status::ok) settle(out, problem_->settings.tolerance);
  }

  // Typical knot spacing of every log: half of its time has closer knots. What crowds them in one place has no say.
  // Of the windows that fit; where none does, as before.
  std::vector<double> spacings(const std::vector<double>& before) const {
    std::vector<double> out;
    for (std::size_t l = 0; l < problem_->logs.size(); ++l) {
      std::vector<double> widths;
      double left = 0.0;
      for (const LogWindow& w : windows) {
        if (w.log != l || w.fit.status != WindowStatus::fitted) continue;
        for (int i = 0; i < w.fit.spline.intervals(); ++i) widths.push_back(w.fit.spline.width(i));
        left += 0.5 * (w.range.end - w.range.begin);
      }
      std::sort(widths.begin(), widths.end());
      double typical = before[l];
      for (std::size_t k = 0; k < widths.size() && left > 0.0; ++k) left -= typical = widths[k];
      out.push_back(typical);
    }
    return out;
  }

  // Mean square of the sensor's residuals over the sigma that they are taken to have.
  double misfit_of_sensor() const {
    std::vector<GroupStatistics> of(windows.size());
    parallel_for(windows.size(), problem_->settings.threads, [&](std::size_t k) {
      const LogWindow& w = windows[k];
      if (w.fit.status != WindowStatus::fitted) return;
      of[k] = WindowResiduals<N>(problem_->models[w.log], w.fit, w.range).sensor();
    });
    GroupStatistics all;
    for (const GroupStatistics& g : of) all += g;
    return all.count > 0.0 ? all.sum_of_squares / all.count : 0.0;
  }

  // Deviate of what halved knots would explain.
  double nested_deviate() const {
    GroupStatistics g;
    for (const LogWindow& i : windows) {
      if (i.fit.status != WindowStatus::fitted) continue;
      g.sum_of_squares += i.fit.nested;
      g.count += i.fit.nested_expected;
    }
    return g.deviate();
  }

  // Halves every interval that the samples still resolve; false where there is none.
  bool halve() {
    bool any = false;
    for (LogWindow& w : windows) {
      if (w.fit.status != WindowStatus::fitted) continue;
      const std::vector<char> all(static_cast<std::size_t>(w.fit.spline.intervals()), 1);
      BSpline finer(w.fit.spline.halved(all, problem_->finest[w.log]));
      any = any || finer.intervals() > w.fit.spline.intervals();
      w.fit.x = w.fit.spline.template refined<kCoordinates>(w.fit.x, finer);
      w.fit.spline = std::move(finer);
    }
    return any;
  }

  // Deviate of the gain against that of neighbouring windows joined in pairs on the same knots, which have fewer
  // coefficients and less noise in the motion. Asked where windows have few samples per coefficient, for there the
  // residuals cannot show that the noise of the inferred motion passes for excitation.
  double doubled(const Posterior& posterior) const {
    struct Pair {
      const LogWindow* first;
      const LogWindow* second;  // or none
      Information apart[2];
      Information joined;
      bool ok = true;
    };
    std::vector<Pair> pairs;
    bool few = false;
    for (std::size_t k = 0; k < windows.size(); ++k) {
      const LogWindow& a = windows[k];
      if (a.fit.status != WindowStatus::fitted) continue;
      few = few || problem_->samples_per_coefficient(a.log, a.fit.spline) < problem_->settings.few_samples;
      const LogWindow* next = k + 1 < windows.size() ? &windows[k + 1] : nullptr;
      const bool joins = next != nullptr && next->log == a.log && next->fit.status == WindowStatus::fitted &&
                         next->range.begin == a.range.end;
      pairs.push_back({&a, joins ? next : nullptr, {}, {}});
      if (joins) ++k;
    }
    if (!few) return 0.0;
    parallel_for(pairs.size(), problem_->settings.threads, [&](std::size_t k) {
      Pair& pair = pairs[k];
      const LogWindow& a = *pair.first;
      WindowSolver<N> solver = problem_->solver(a.log);
      const auto held = [&](const WindowRange& range, const BSpline& spline) {
        WindowFit fit = solver.hold(range, spline, posterior.mean[a.log]);
        pair.ok = pair.ok && fit.status == WindowStatus::fitted;
        return fit.information;
      };
      pair.apart[0] = held(a.range, a.fit.spline);
      if (pair.second == nullptr) return;
      const LogWindow& b = *pair.second;
      pair.apart[1] = held(b.range, b.fit.spline);
      std::vector<double> breakpoints = a.fit.spline.breakpoints();
      const std::vector<double>& tail = b.fit.spline.breakpoints();
      breakpoints.insert(breakpoints.end(), tail.begin() + 1, tail.end());
      pair.joined = held(a.range.joined(b.range), BSpline(std::move(breakpoints)));
    });
    std::vector<InformationSum> apart = problem_->nothing_seen(), joined = apart;
    for (const Pair& pair : pairs) {
      if (!pair.ok) continue;
      const std::size_t l = pair.first->log;
      apart[l].add(pair.apart[0], posterior.mean[l]);
      joined[l].add(pair.second != nullptr ? pair.joined : pair.apart[0], posterior.mean[l]);
      if (pair.second != nullptr) apart[l].add(pair.apart[1], posterior.mean[l]);
    }
    const Posterior fewer = combine(problem_->prior, joined);
    const Posterior more = combine(problem_->prior, apart);
    if (fewer.status != Status::ok || more.status != Status::ok) return 0.0;
    return disagreement(fewer, more, problem_->prior.layout.gains());
  }

  // What the windows say together, and how much of it depends on their knots.
  void conclude(Estimate& out) const {
    out.posterior = combine(problem_->prior, coarse);
    out.status = out.posterior.status;
    const Posterior finer = combine(problem_->prior, fine);
    if (out.status != Status::ok || finer.status != Status::ok) return;
    out.knot_dependence = std::max(disagreement(out.posterior, finer, problem_->prior.layout.gains()),
                                   clock_lost(out.posterior, finer));
  }

  // The payload's wrench in all windows that fit.
  void predict(Estimate& out) const {
    parallel_for(windows.size(), problem_->settings.threads, [&](std::size_t k) {
      const LogWindow& w = windows[k];
      if (w.fit.status != WindowStatus::fitted) return;
      problem_->solver(w.log).predict(w.fit, w.range, out.wrench[w.log]);
    });
  }

 private:
  struct Push {
    std::size_t window;
    Disturbance samples;  // of the sensor
  };

  // The strongest push in each of these windows, of those that have one.
  std::vector<Push> pushes(const std::vector<std::size_t>& of, const Posterior& posterior) const {
    std::vector<Disturbance> strongest(of.size());
    parallel_for(of.size(), problem_->settings.threads, [&](std::size_t k) {
      const LogWindow& w = windows[of[k]];
      if (w.fit.status != WindowStatus::fitted) return;
      strongest[k] = problem_->solver(w.log).push(w.fit, w.range, posterior.covariance[w.log]);
    });
    std::vector<Push> found;
    for (std::size_t k = 0; k < of.size(); ++k) {
      if (strongest[k].deviate > 0.0) found.push_back({of[k], strongest[k]});
    }
    return found;
  }

  // Judges every window at the common gain.
  void review(const std::vector<Eigen::VectorXd>& theta) {
    parallel_for(windows.size(), problem_->settings.threads, [&](std::size_t k) {
      LogWindow& w = windows[k];
      if (w.fit.status != WindowStatus::fitted) return;
      WindowSolver<N> solver = problem_->solver(w.log);
      w.fit.theta = theta[w.log];
      solver.exclude(w.fit, w.range);
      solver.finish(w.fit, w.range, nullptr);
    });
  }

  void sum() {
    coarse = fine = problem_->nothing_seen();
    for (const LogWindow& i : windows) {
      if (i.fit.status != WindowStatus::fitted) continue;
      coarse[i.log].add(i.fit.information, i.fit.theta);
      if (i.fit.finer.matrix.size() > 0) fine[i.log].add(i.fit.finer, i.fit.theta);
    }
  }

  // A spline moved in time is no spline on the same knots, and what it lacks is taken for knowledge of the clock. As a
  // deviate, which reaches its limit where halved knots make the clock's sigma larger by more than they may.
  double clock_lost(const Posterior& posterior, const Posterior& finer) const {
    if (!problem_->prior.layout.time_offset) return 0.0;
    double ratio = 1.0;
    for (std::size_t l = 0; l < problem_->logs.size(); ++l) {
      const double sigma = problem_->clock(posterior.mean[l], posterior.covariance[l]).second;
      ratio = std::max(ratio, problem_->clock(finer.mean[l], finer.covariance[l]).second / sigma);
    }
    return problem_->settings.dependence_sigma * (ratio - 1.0) / problem_->settings.clock_lost;
  }

  Problem<N>* problem_;
};

}  // namespace truewrench
