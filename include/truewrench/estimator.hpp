// The two estimators over windows of motion (docs/method.md, "Online and map").
//
// `online`: windows in sequence; each is solved jointly with the gain under what the ones before left.
// `map`:    all windows share one gain; given it they are independent, and only their small matrices are added.
#pragma once

#include "truewrench/estimate.hpp"
#include "truewrench/knots.hpp"
#include "truewrench/parallel.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

namespace truewrench {

template <int N>
class Estimator {
 public:
  Estimator(std::vector<LogData> logs, SensorScale<N> sensor, CommonPrior prior, EstimatorSettings settings)
      : logs_(std::move(logs)), sensor_(std::move(sensor)), prior_(std::move(prior)), settings_(settings) {
    for (const LogData& log : logs_) gates_.emplace_back(log);
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      const LogData& log = logs_[l];
      models_.emplace_back(log, sensor_, prior_.layout, &gates_[l]);
      finest_.push_back(settings_.knots.samples_per_coefficient * slowest_period(log));
    }
  }
  Estimator(const Estimator&) = delete;
  Estimator& operator=(const Estimator&) = delete;

  Estimate online() {
    Estimate out;
    std::vector<Item> items;
    std::vector<InformationSum> coarse, fine;
    out.converged = first_pass(out, items, coarse, fine);
    conclude(out, coarse, fine);
    // Windows linearised at different gains disagree about which change of the gain a change of the payload
    // undoes, and together would claim to know the payload: all of them are taken to the final gain.
    if (out.status == Status::ok && (reconsider(items, out.posterior) || prior_.layout.payload)) {
      settle(out, items, coarse, fine, settings_.tolerance);
      leave_out_pushes(out, items, coarse, fine);
    }
    if (out.status == Status::ok) out.window_dependence = doubled(items, out.posterior);
    out.gates = gates_;
    out.spacing = spacings(items, first_spacings());
    return out;
  }

  // Without a start all is found from the logs at once. What fits badly so, by contacts say, may still fit in most
  // places: `online`, whose windows come one by one, can then be the start of another attempt.
  Estimate map(const Start& start = {}) {
    Estimate out;
    std::vector<Item> items;
    if (start.mean.empty()) {
      share_all(out, items, gradually(out, items));
    } else {
      begin(out);
      out.posterior.mean = start.mean;
      out.posterior.covariance = start.covariance;
      share_all(out, items, start.spacing);
    }
    return out;
  }

 private:
  struct Item {
    std::size_t log;
    WindowRange range;
    WindowFit fit;
  };

  // Samples in windows that fit, and in all.
  static std::pair<double, double> fitted_samples(const std::vector<WindowReport>& windows) {
    double fitted = 0.0, all = 0.0;
    for (const WindowReport& w : windows) {
      all += static_cast<double>(w.samples);
      if (w.status == WindowStatus::fitted) fitted += static_cast<double>(w.samples);
    }
    return {fitted, all};
  }

  // What the priors say.
  void begin(Estimate& out) const {
    out.posterior =
        combine(prior_, std::vector<InformationSum>(logs_.size(), InformationSum(prior_.layout.size())));
    out.status = out.posterior.status;
  }

  // Before anything is known of the motion.
  std::vector<double> first_spacings() const {
    return std::vector<double>(logs_.size(), settings_.window / settings_.window_intervals);
  }

  // The common parameters from all windows at once, and the knot spacing that the data ask for. A precise sensor whose
  // gain is not known would bend motion, clock and knots until they agree with it; so it is believed step by step, from
  // the size of its misfit to its noise, and samples far off count little on the way. A window that does not fit keeps
  // its knots: without it, a gain found from few others would be further off.
  std::vector<double> gradually(Estimate& out, std::vector<Item>& items) {
    std::vector<double> spacing = first_spacings();
    begin(out);
    if (out.status != Status::ok) return spacing;
    disbelieve(settings_.disregard);  // knots of the velocities alone
    items = lay_out(spacing, settings_.map_window_intervals, out.posterior, {});
    std::vector<BSpline> plain;
    for (const Item& i : items) plain.push_back(i.fit.spline);
    double variance = std::max(1.0, settings_.disregard * misfit_of_sensor(items));
    std::vector<InformationSum> sums;
    for (bool all_fit = false;;) {
      disbelieve(variance);
      iterate(items, out, sums, settings_.settled, variance == 1.0 && all_fit ? 0.0 : settings_.freedom);
      if (out.status != Status::ok || variance == 1.0) break;
      spacing = spacings(items, spacing);
      const double left = variance * misfit_of_sensor(items);
      variance = std::max(1.0, std::min(variance / settings_.believe, settings_.believe * left));
      disbelieve(variance);
      std::vector<char> fits(items.size(), 1);
      parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
        Item& item = items[k];
        if (!enough_samples(item.range)) return;
        const bool fitted = item.fit.status == WindowStatus::fitted;
        WindowFit fit = WindowSolver<N>(models_[item.log], settings_.knots)
                            .search(item.range, fitted ? item.fit.spline : plain[k],
                                    out.posterior.mean[item.log], nullptr, finest_[item.log]);
        fits[k] = fit.status == WindowStatus::fitted;
        if (fits[k] || !fitted) item.fit = std::move(fit);
      });
      all_fit = std::all_of(fits.begin(), fits.end(), [](char f) { return f != 0; });
    }
    disbelieve(1.0);
    return spacings(items, spacing);
  }

  void disbelieve(double times) {
    for (WindowModel<N>& m : models_) m.disbelieve(times);
  }

  // Mean square of the sensor's residuals over the sigma that they are taken to have.
  double misfit_of_sensor(const std::vector<Item>& items) const {
    std::vector<GroupStatistics> of(items.size());
    parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
      const Item& item = items[k];
      if (item.fit.status != WindowStatus::fitted) return;
      of[k] = WindowResiduals<N>(models_[item.log], item.fit, item.range).sensor();
    });
    GroupStatistics all;
    for (const GroupStatistics& g : of) all += g;
    return all.count > 0.0 ? all.sum_of_squares / all.count : 0.0;
  }

  // `map` on windows of so many knot intervals, longer ones while the gain depends on their length.
  void share_all(Estimate& out, std::vector<Item>& items, const std::vector<double>& spacing) {
    for (int intervals = settings_.map_window_intervals; out.status == Status::ok; intervals *= 2) {
      share(out, items, spacing, intervals);
      if (out.status != Status::ok) break;
      out.window_dependence = doubled(items, out.posterior);
      // It falls about as the root of their length.
      const double longer = settings_.longest_window * settings_.map_window_intervals / intervals;
      const bool depends = out.window_dependence >= settings_.dependence_sigma;
      if (!depends || out.window_dependence >= settings_.dependence_sigma * std::sqrt(longer)) break;
    }
    prepare_wrench(out);
    if (out.status == Status::ok) predict(items, out);
    out.gates = gates_;
    out.spacing = spacings(items, spacing);
  }

  // Samples of [begin, end) of a log, given what is known of its clocks.
  WindowRange range(std::size_t log, double begin, double end, bool closed, double delay,
                    double sigma) const {
    return range_of(logs_[log], begin, end, closed, delay, 2.0 * sigma);
  }

  // Time offset of a log and its sigma, from a posterior or prior of its common parameters.
  std::pair<double, double> clock(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance) const {
    if (!prior_.layout.time_offset) return {0.0, 0.0};
    const int k = prior_.layout.time_offset_begin();
    return {mean[k], std::sqrt(std::max(0.0, covariance(k, k)))};
  }

  // Uniform knots, no wider than what it takes to undo the noise of a reference motion.
  BSpline knots_to_begin_with(std::size_t log, const WindowRange& w, int intervals) const {
    if (const auto& reference = logs_[log].reference) {
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

  // The common parameters on all windows with their knots held, and the verdict on every window there.
  void settle(Estimate& out, std::vector<Item>& items, std::vector<InformationSum>& coarse,
              std::vector<InformationSum>& fine, double tolerance) {
    out.converged = iterate(items, out, coarse, tolerance);
    if (out.status != Status::ok) return;
    review(items, out.posterior.mean);
    sum(items, coarse, fine);
    conclude(out, coarse, fine);
    out.windows.clear();
    for (const Item& i : items) out.windows.push_back(report(i.log, i.range, i.fit));
  }

  // Searches again, at the common gain, the windows that looked suspect on the way to it. True where one changed.
  bool reconsider(std::vector<Item>& items, const Posterior& posterior) const {
    std::vector<char> changed(items.size(), 0);
    parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
      Item& item = items[k];
      if (!enough_samples(item.range)) return;
      WindowSolver<N> solver(models_[item.log], settings_.knots);
      item.fit.theta = posterior.mean[item.log];
      if (!solver.suspect(item.fit, item.range)) return;
      WindowFit fit = solver.search(item.range, knots_to_begin_with(item.log, item.range, 1),
                                    posterior.mean[item.log], nullptr, finest_[item.log]);
      changed[k] = fit.status == WindowStatus::fitted &&
                   (item.fit.status != WindowStatus::fitted ||
                    fit.spline.breakpoints() != item.fit.spline.breakpoints() || fit.disturbances > 0);
      if (changed[k]) item.fit = std::move(fit);
    });
    return std::any_of(changed.begin(), changed.end(), [](char c) { return c != 0; });
  }

  // Leaves out the strongest pushes that the gain has taken up, and settles anew, until there are none. Windows without
  // any are asked again last.
  void leave_out_pushes(Estimate& out, std::vector<Item>& items, std::vector<InformationSum>& coarse,
                        std::vector<InformationSum>& fine) {
    bool any = false, all = true;
    std::vector<Disturbance> pushes(items.size());
    for (int rounds = 0; rounds < settings_.max_pushes && out.status == Status::ok;) {
      parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
        const Item& item = items[k];
        if (!all && pushes[k].deviate == 0.0) return;
        pushes[k] = {};
        if (item.fit.status != WindowStatus::fitted) return;
        pushes[k] = WindowSolver<N>(models_[item.log], settings_.knots)
                        .push(item.fit, item.range, out.posterior.covariance[item.log]);
      });
      double most = 0.0;
      for (const Disturbance& p : pushes) most = std::max(most, p.deviate);
      if (most == 0.0 && all) break;
      all = most == 0.0;
      if (all) continue;
      for (std::size_t k = 0; k < items.size(); ++k) {
        if (pushes[k].deviate < settings_.shadow * most) continue;
        WindowSolver<N>(models_[items[k].log], settings_.knots).leave_out(pushes[k]);
      }
      settle(out, items, coarse, fine, settings_.settled);
      any = true;
      ++rounds;
    }
    if (any && out.status == Status::ok) settle(out, items, coarse, fine, settings_.tolerance);
  }

  // `map` on windows of about so many knot intervals: knots at the gain of the pass before, then the gain on all of
  // them; once more where the gain has moved; and finer knots while the data ask for them.
  void share(Estimate& out, std::vector<Item>& items, const std::vector<double>& spacing, int intervals) {
    std::vector<InformationSum> coarse, fine;
    bool search_again = true, far = true;
    for (int round = 0; round < settings_.max_rounds; ++round) {
      const std::vector<Eigen::VectorXd> before = out.posterior.mean;
      if (search_again) {  // windows that fit stay as they are, unless the gain is another
        items = lay_out(spacing, intervals, out.posterior, far ? std::vector<Item>{} : std::move(items));
      }
      settle(out, items, coarse, fine, settings_.tolerance);
      if (out.status != Status::ok) return;
      // A window searched at a poor gain bends its knots to it, or is rejected.
      const auto [fitted, all] = fitted_samples(out.windows);
      const bool rejected = all - fitted > settings_.few_rejected * all;
      const double by = moved(before, out.posterior);
      far = by > prior_.layout.size();
      search_again = far || ((round == 0 || rejected) && by > 0.1);
      if (search_again) continue;
      if (std::max(out.knot_dependence, nested_deviate(items)) < settings_.dependence_sigma) break;
      if (!halve(items)) break;
    }
    leave_out_pushes(out, items, coarse, fine);
  }

  // A pass over all logs. The first window can take a contact for a gain, and then no other window fits: where few
  // fit, passes that begin elsewhere are tried, and the one that explains most samples stands.
  bool first_pass(Estimate& out, std::vector<Item>& items, std::vector<InformationSum>& coarse,
                  std::vector<InformationSum>& fine) {
    bool converged = false;
    double best = -1.0;
    // A clock far from its prior's mean can also keep every window from fitting; tried first at the mean.
    struct Beginning {
      double share;
      double clock;
    };
    std::vector<Beginning> starts;
    for (const double clock :
         prior_.layout.time_offset ? std::vector{0.0, 1.0, -1.0, 2.0, -2.0} : std::vector{0.0}) {
      for (const double share : {0.0, 0.5, 0.25, 0.75}) starts.push_back({share, clock});
    }
    for (const auto& [start, clock] : starts) {
      // Where no window at all fits, none has spoilt the others.
      if (clock == 0.0 ? start != 0.0 && best == 0.0 : start != 0.0 || best > 0.0) continue;
      Estimate pass;
      std::vector<Item> pass_items;
      std::vector<InformationSum> pass_coarse, pass_fine;
      const bool ok = sequence(start, clock, pass, pass_items, pass_coarse, pass_fine);
      const auto [used, all] = fitted_samples(pass.windows);
      if (used > best) {
        best = used;
        converged = ok;
        out = std::move(pass);
        items = std::move(pass_items);
        coarse = std::move(pass_coarse);
        fine = std::move(pass_fine);
      }
      if (used >= settings_.enough_fitted * all) break;
    }
    const auto earlier = [](const auto& a, const auto& b) {
      return std::tie(a.log, a.begin) < std::tie(b.log, b.begin);
    };
    std::sort(out.windows.begin(), out.windows.end(), earlier);
    std::sort(items.begin(), items.end(), [](const Item& a, const Item& b) {
      return std::tie(a.log, a.range.begin) < std::tie(b.log, b.range.begin);
    });
    return converged;
  }

  // Stretches of a log in the order of a pass that begins at this share of it.
  std::vector<std::pair<double, double>> stretches(std::size_t log, double start) const {
    std::vector<std::pair<double, double>> all = unbroken_stretches(logs_[log], settings_.gap_periods);
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

  // One pass over all logs, windows in sequence. False where some window did not converge.
  bool sequence(double start_share, double clock_sigmas, Estimate& out, std::vector<Item>& items,
                std::vector<InformationSum>& coarse, std::vector<InformationSum>& fine) {
    bool converged = true;
    prepare_wrench(out);
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      coarse.emplace_back(prior_.layout.size());
      fine.emplace_back(prior_.layout.size());
      Prior prior = before(l, coarse);
      auto [delay, delay_sigma] = clock(prior.mean, inverse(prior.information));
      // Only where the search begins: the prior stays what it is.
      double shift = clock_sigmas * delay_sigma;
      double length = settings_.window;
      double spacing = 0.0;
      WindowSolver<N> solver(models_[l], settings_.knots);
      for (const auto& [begin, end] : stretches(l, start_share)) {
        bool may_extend = true;
        for (double t = begin; t < end;) {
          const double stop = end - (t + length) < 0.5 * length ? end : t + length;
          const WindowRange window = range(l, t, stop, stop == end, delay, delay_sigma);
          WindowFit fit;
          if (enough_samples(window)) {
            const int start = spacing > 0.0 ? static_cast<int>((stop - t) / (2.0 * spacing)) : 1;
            Eigen::VectorXd from = prior.mean;
            if (prior_.layout.time_offset) from[prior_.layout.time_offset_begin()] += shift;
            fit = solver.search(window, knots_to_begin_with(l, window, start), from, &prior, finest_[l]);
          }
          const bool fitted = fit.status == WindowStatus::fitted;
          // Motion that is slow for the window: a longer one determines it better.
          if (fitted && may_extend && stop < end && fit.spline.intervals() < settings_.window_intervals) {
            length *= 2.0;
            continue;
          }
          if (!fitted && length > settings_.window) {
            length = std::max(settings_.window, 0.5 * length);
            may_extend = false;
            continue;
          }
          out.windows.push_back(report(l, window, fit));
          if (fitted) {
            coarse[l].add(fit.information, fit.theta);
            fine[l].add(fit.finer, fit.theta);
            prior.information += fit.information.matrix;
            prior.mean = fit.theta;
            const Eigen::MatrixXd covariance = inverse(prior.information);
            std::tie(delay, delay_sigma) = clock(prior.mean, covariance);
            shift = 0.0;
            spacing = (stop - t) / fit.spline.intervals();
            out.history.push_back(
                {static_cast<int>(l), stop, prior.mean, covariance.diagonal().cwiseMax(0.0).cwiseSqrt()});
            solver.predict(fit, window, out.wrench[l]);
            if (fit.spline.intervals() > 4 * settings_.window_intervals) {
              length = std::max(settings_.window, 0.5 * length);
            }
          } else if (fit.status == WindowStatus::not_converged) {
            converged = false;
          }
          out.iterations += fit.iterations;
          items.push_back({l, window, {}});
          items.back().fit.status = fit.status;
          items.back().fit.theta = prior.mean;
          items.back().fit.spline = std::move(fit.spline);
          items.back().fit.x = std::move(fit.x);
          may_extend = true;
          t = stop;
        }
      }
    }
    return converged;
  }

  // What is known of a log's parameters before its first window, from the logs before it.
  Prior before(std::size_t log, const std::vector<InformationSum>& sums) const {
    const Posterior posterior = combine(prior_, sums);
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

  // Typical knot spacing of every log: half of its time has closer knots. What crowds them in one place has no say.
  // Of the windows that fit; where none does, as before.
  std::vector<double> spacings(const std::vector<Item>& items, const std::vector<double>& before) const {
    std::vector<double> out;
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      std::vector<double> widths;
      double left = 0.0;
      for (const Item& item : items) {
        if (item.log != l || item.fit.status != WindowStatus::fitted) continue;
        for (int i = 0; i < item.fit.spline.intervals(); ++i) widths.push_back(item.fit.spline.width(i));
        left += 0.5 * (item.range.end - item.range.begin);
      }
      std::sort(widths.begin(), widths.end());
      double typical = before[l];
      for (std::size_t k = 0; k < widths.size() && left > 0.0; ++k) left -= typical = widths[k];
      out.push_back(typical);
    }
    return out;
  }

  // Windows of `map` with their knots, searched at a given gain; those that fitted before are taken over. A window that
  // does not fit is cut in two, down to the length of a window of `online`, so that a disturbance costs only its
  // surroundings.
  std::vector<Item> lay_out(const std::vector<double>& spacing, int intervals, const Posterior& posterior,
                            std::vector<Item> before) const {
    std::vector<Item> items;
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      const double target = std::max(settings_.window, intervals * spacing[l]);
      const auto [delay, delay_sigma] = clock(posterior.mean[l], posterior.covariance[l]);
      for (const auto& [begin, end] : unbroken_stretches(logs_[l], settings_.gap_periods)) {
        const int count = std::max(1, static_cast<int>(std::ceil((end - begin) / target)));
        const std::vector<double> edges = BSpline::uniform(begin, end, count);
        for (int i = 0; i < count; ++i) {
          const auto k = static_cast<std::size_t>(i);
          items.push_back({l, range(l, edges[k], edges[k + 1], i + 1 == count, delay, delay_sigma), {}});
        }
      }
    }
    std::vector<std::vector<Item>> parts(items.size());
    parallel_for(items.size(), settings_.threads, [&](std::size_t i) {
      const auto same = std::find_if(before.begin(), before.end(), [&, &item = items[i]](const Item& b) {
        return b.fit.status == WindowStatus::fitted && b.log == item.log &&
               b.range.begin == item.range.begin && b.range.end == item.range.end;
      });
      if (same != before.end()) {
        parts[i].push_back(std::move(*same));
      } else {
        search(items[i], spacing[items[i].log], posterior, parts[i]);
      }
    });
    std::vector<Item> out;
    for (auto& part : parts) std::move(part.begin(), part.end(), std::back_inserter(out));
    return out;
  }

  void search(Item item, double spacing, const Posterior& posterior, std::vector<Item>& out) const {
    const WindowRange& w = item.range;
    const double length = w.end - w.begin;
    if (enough_samples(w)) {
      const int start = static_cast<int>(length / (4.0 * spacing));
      WindowSolver<N> solver(models_[item.log], settings_.knots);
      const BSpline knots = knots_to_begin_with(item.log, w, start);
      const Eigen::VectorXd& theta = posterior.mean[item.log];
      item.fit = solver.search(w, knots, theta, nullptr, finest_[item.log]);
      if (item.fit.status != WindowStatus::fitted) {
        // What little is wrong with a gain of few windows may be much to a good sensor.
        const Prior prior{inverse(posterior.covariance[item.log]), theta};
        WindowFit freed = solver.search(w, knots, theta, &prior, finest_[item.log]);
        if (freed.status == WindowStatus::fitted) item.fit = std::move(freed);
      }
      if (item.fit.status != WindowStatus::fitted && length >= 2.0 * settings_.window) {
        const auto [first, second] = halves(item, posterior);
        search({item.log, first, {}}, spacing, posterior, out);
        search({item.log, second, {}}, spacing, posterior, out);
        return;
      }
    }
    out.push_back(std::move(item));
  }

  // The window cut in the middle; the second half ends with the same samples.
  std::pair<WindowRange, WindowRange> halves(const Item& item, const Posterior& posterior) const {
    const WindowRange& w = item.range;
    const auto [delay, sigma] = clock(posterior.mean[item.log], posterior.covariance[item.log]);
    const double middle = 0.5 * (w.begin + w.end);
    std::pair out(range(item.log, w.begin, middle, false, delay, sigma),
                  range(item.log, middle, w.end, false, delay, sigma));
    out.second.wrench.second = w.wrench.second;
    for (std::size_t m = 0; m < w.motion.size(); ++m) out.second.motion[m].second = w.motion[m].second;
    return out;
  }

  // Gauss-Newton on the common parameters with the knots held.
  bool iterate(std::vector<Item>& items, Estimate& out, std::vector<InformationSum>& sums, double tolerance,
               double freedom = 0.0) {
    double decrement = 0.0;
    for (int i = 0; i < settings_.max_iterations; ++i) {
      parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
        Item& item = items[k];
        if (item.fit.status != WindowStatus::fitted) return;
        WindowSolver<N> solver(models_[item.log], settings_.knots);
        if (solver.relinearise(item.fit, item.range, out.posterior.mean[item.log], freedom) != Status::ok) {
          item.fit.status = WindowStatus::motion_undetermined;
        }
      });
      std::vector<InformationSum> unused;
      sum(items, sums, unused);
      Posterior next = combine(prior_, sums);
      out.status = next.status;
      if (out.status != Status::ok) return false;
      decrement = moved(out.posterior.mean, next);
      out.posterior = std::move(next);
      ++out.iterations;
      if (decrement < tolerance) return true;
    }
    return decrement < settings_.settled;
  }

  // Squared distance of two estimates in units of the covariance.
  static double moved(const std::vector<Eigen::VectorXd>& from, const Posterior& to) {
    double most = 0.0;
    for (std::size_t l = 0; l < from.size(); ++l) {
      const Eigen::VectorXd d = to.mean[l] - from[l];
      most = std::max(most, d.dot(to.covariance[l].llt().solve(d)));
    }
    return most;
  }

  // Judges every window at the common gain.
  void review(std::vector<Item>& items, const std::vector<Eigen::VectorXd>& theta) const {
    parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
      Item& item = items[k];
      if (item.fit.status != WindowStatus::fitted) return;
      WindowSolver<N> solver(models_[item.log], settings_.knots);
      item.fit.theta = theta[item.log];
      solver.exclude(item.fit, item.range);
      solver.finish(item.fit, item.range, nullptr);
    });
  }

  void sum(const std::vector<Item>& items, std::vector<InformationSum>& coarse,
           std::vector<InformationSum>& fine) const {
    coarse.assign(logs_.size(), InformationSum(prior_.layout.size()));
    fine = coarse;
    for (const Item& i : items) {
      if (i.fit.status != WindowStatus::fitted) continue;
      coarse[i.log].add(i.fit.information, i.fit.theta);
      if (i.fit.finer.matrix.size() > 0) fine[i.log].add(i.fit.finer, i.fit.theta);
    }
  }

  void conclude(Estimate& out, const std::vector<InformationSum>& coarse,
                const std::vector<InformationSum>& fine) const {
    out.posterior = combine(prior_, coarse);
    out.status = out.posterior.status;
    const Posterior finer = combine(prior_, fine);
    if (out.status != Status::ok || finer.status != Status::ok) return;
    out.knot_dependence =
        std::max(disagreement(out.posterior, finer, prior_.layout.gains()), clock_lost(out.posterior, finer));
  }

  // A spline moved in time is no spline on the same knots, and what it lacks is taken for knowledge of the clock. As a
  // deviate, which reaches its limit where halved knots make the clock's sigma larger by more than they may.
  double clock_lost(const Posterior& posterior, const Posterior& finer) const {
    if (!prior_.layout.time_offset) return 0.0;
    double ratio = 1.0;
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      const double sigma = clock(posterior.mean[l], posterior.covariance[l]).second;
      ratio = std::max(ratio, clock(finer.mean[l], finer.covariance[l]).second / sigma);
    }
    return settings_.dependence_sigma * (ratio - 1.0) / settings_.clock_lost;
  }

  void prepare_wrench(Estimate& out) const {
    out.wrench.clear();
    for (const LogData& log : logs_) {
      out.wrench.push_back(RowMatrix::Constant(static_cast<Eigen::Index>(log.wrench.time.size()), 6,
                                               std::numeric_limits<double>::quiet_NaN()));
    }
  }

  void predict(const std::vector<Item>& items, Estimate& out) const {
    parallel_for(items.size(), settings_.threads, [&](std::size_t k) {
      const Item& item = items[k];
      if (item.fit.status != WindowStatus::fitted) return;
      WindowSolver<N>(models_[item.log], settings_.knots).predict(item.fit, item.range, out.wrench[item.log]);
    });
  }

  double samples_per_coefficient(std::size_t log, const BSpline& spline) const {
    double narrowest = spline.end() - spline.begin();
    for (int i = 0; i < spline.intervals(); ++i) narrowest = std::min(narrowest, spline.width(i));
    return settings_.knots.samples_per_coefficient * narrowest / finest_[log];
  }

  // Deviate of the gain against that of neighbouring windows joined in pairs on the same knots, which have fewer
  // coefficients and less noise in the motion. Asked where windows have few samples per coefficient, for there the
  // residuals cannot show that the noise of the inferred motion passes for excitation.
  double doubled(const std::vector<Item>& items, const Posterior& posterior) const {
    struct Pair {
      const Item* first;
      const Item* second;  // or none
      Information apart[2];
      Information joined;
      bool ok = true;
    };
    std::vector<Pair> pairs;
    bool few = false;
    for (std::size_t k = 0; k < items.size(); ++k) {
      const Item& a = items[k];
      if (a.fit.status != WindowStatus::fitted) continue;
      few = few || samples_per_coefficient(a.log, a.fit.spline) < settings_.few_samples;
      const Item* next = k + 1 < items.size() ? &items[k + 1] : nullptr;
      const bool joins = next != nullptr && next->log == a.log && next->fit.status == WindowStatus::fitted &&
                         next->range.begin == a.range.end;
      pairs.push_back({&a, joins ? next : nullptr, {}, {}});
      if (joins) ++k;
    }
    if (!few) return 0.0;
    parallel_for(pairs.size(), settings_.threads, [&](std::size_t k) {
      Pair& pair = pairs[k];
      const Item& a = *pair.first;
      WindowSolver<N> solver(models_[a.log], settings_.knots);
      const auto held = [&](const WindowRange& range, const BSpline& spline) {
        WindowFit fit = solver.hold(range, spline, posterior.mean[a.log]);
        pair.ok = pair.ok && fit.status == WindowStatus::fitted;
        return fit.information;
      };
      pair.apart[0] = held(a.range, a.fit.spline);
      if (pair.second == nullptr) return;
      const Item& b = *pair.second;
      pair.apart[1] = held(b.range, b.fit.spline);
      std::vector<double> breakpoints = a.fit.spline.breakpoints();
      const std::vector<double>& tail = b.fit.spline.breakpoints();
      breakpoints.insert(breakpoints.end(), tail.begin() + 1, tail.end());
      pair.joined = held(a.range.joined(b.range), BSpline(std::move(breakpoints)));
    });
    std::vector<InformationSum> apart(logs_.size(), InformationSum(prior_.layout.size()));
    std::vector<InformationSum> joined = apart;
    for (const Pair& pair : pairs) {
      if (!pair.ok) continue;
      const std::size_t l = pair.first->log;
      apart[l].add(pair.apart[0], posterior.mean[l]);
      joined[l].add(pair.second != nullptr ? pair.joined : pair.apart[0], posterior.mean[l]);
      if (pair.second != nullptr) apart[l].add(pair.apart[1], posterior.mean[l]);
    }
    const Posterior fewer = combine(prior_, joined);
    const Posterior more = combine(prior_, apart);
    if (fewer.status != Status::ok || more.status != Status::ok) return 0.0;
    return disagreement(fewer, more, prior_.layout.gains());
  }

  static double nested_deviate(const std::vector<Item>& items) {
    GroupStatistics g;
    for (const Item& i : items) {
      if (i.fit.status != WindowStatus::fitted) continue;
      g.sum_of_squares += i.fit.nested;
      g.count += i.fit.nested_expected;
    }
    return g.deviate();
  }

  // Halves every interval that the samples still resolve; false where there is none.
  bool halve(std::vector<Item>& items) const {
    bool any = false;
    for (Item& item : items) {
      if (item.fit.status != WindowStatus::fitted) continue;
      std::vector<char> marked(static_cast<std::size_t>(item.fit.spline.intervals()), 0);
      for (std::size_t i = 0; i < marked.size(); ++i) {
        marked[i] = 0.5 * item.fit.spline.width(static_cast<int>(i)) >= finest_[item.log];
        any = any || marked[i];
      }
      BSpline finer(item.fit.spline.halved(marked));
      item.fit.x = item.fit.spline.template refined<kCoordinates>(item.fit.x, finer);
      item.fit.spline = std::move(finer);
    }
    return any;
  }

  std::vector<LogData> logs_;
  SensorScale<N> sensor_;
  CommonPrior prior_;
  EstimatorSettings settings_;
  std::vector<Gate> gates_;
  std::vector<WindowModel<N>> models_;
  std::vector<double> finest_;
};

}  // namespace truewrench
