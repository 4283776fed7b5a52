// One window solved: Gauss-Newton on (motion, common parameters), and the search for the coarsest knots that the
// data accept (docs/method.md, "Knots").
//
// Coarse to fine. At every spacing two questions are asked of each interval: are the residuals of every stream
// as large as their noise says, and would halving the interval lower the cost by more than chance (the score
// test of the nested, finer spline: one linearisation, no second fit)? An interval that fails is halved.
#pragma once

#include "truewrench/contact.hpp"
#include "truewrench/window.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <utility>
#include <vector>

namespace truewrench {

struct KnotSettings {
  int blocks_per_interval = 12;  // samples of an interval are averaged into this many blocks, if it has more
  double samples_per_coefficient = 2;  // the finest spacing, in periods of the slower stream
  double interval_sigma = 4;  // an interval is halved when its score test exceeds its mean by this much,
  double window_sigma = 3;    // all that exceed their mean, when the window's sum exceeds its own by this
  double residual_sigma = 5;  // or when a stream's residuals on it exceed their noise by this
  double reject_sigma = 5;    // a window is rejected when a stream's residuals exceed their noise by this
  int max_iterations = 12;
  double tolerance = 1e-3;  // remaining decrease of the cost (chi-square units) that counts as converged
  int max_levels = 30;
  double false_disturbances = 0.01;  // disturbances found by chance in a window without any
  double disturbance_price = 40;     // decrease of the cost (chi-square units) that one must be worth
  double hopeless_sigma = 2;         // residuals of an interval that do not fit; where more intervals than
  double hopeless_share = 0.9;       // this share do not, disturbances are not looked for
  double most_disturbed = 0.4;       // share of a window's samples that may be left out
};

enum class WindowStatus : std::uint8_t {
  fitted,
  too_short,            // fewer samples than coefficients of the coarsest spline
  motion_undetermined,  // the streams present do not determine the motion
  not_converged,
  misfit,      // residuals above their noise at every admissible spacing
  unresolved,  // finer knots would still fit better, but the samples do not resolve them
};

struct WindowFit {
  WindowStatus status = WindowStatus::too_short;
  BSpline spline;
  Coefficients x;
  Eigen::VectorXd theta;
  Information information;
  Information finer;             // the same with every interval halved
  double nested = 0.0;           // decrease of the cost by halving every interval,
  double nested_expected = 0.0;  // and what chance alone gives
  Groups groups{};
  std::vector<ComponentStatistics> components;  // channels, then those of the first series of the motion
  int disturbances = 0;
  int iterations = 0;
};

template <int N>
class WindowSolver {
 public:
  WindowSolver(const WindowModel<N>& model, const KnotSettings& settings)
      : model_(model), settings_(settings) {}

  // Searches knots from `start` on. With `prior` theta is solved for, else it is held. Where the window does not fit,
  // or only with knots crowded in one place, or leaves a disturbance in its residuals, it is searched again with
  // what does not belong left out; of two explanations that fit, the cheaper one stands.
  WindowFit search(const WindowRange& window, const BSpline& start, const Eigen::VectorXd& theta,
                   const Prior* prior, double finest) {
    open(window);
    WindowFit fit = search(window, start, theta, prior, finest, false);
    if (model_.gate() == nullptr || !suspect(fit, window)) return fit;
    const bool fitted = fit.status == WindowStatus::fitted;
    if (!fitted && hopeless(fit, window)) return fit;
    open(window);
    WindowFit other = search(window, start, theta, prior, finest, true);
    other.iterations += fit.iterations;
    if (other.status == WindowStatus::fitted && (!fitted || price(other) < price(fit))) return other;
    open(window);
    return fit;
  }

  // Whether another search may do better: the window does not fit, or only with knots crowded in one place, or what is
  // not noise stands out of its residuals.
  bool suspect(const WindowFit& fit, const WindowRange& window) {
    return fit.status != WindowStatus::fitted || crowded(fit.spline) || disturbed(fit, window, Terms::all);
  }

  // Leaves out what stands out of the residuals at a given theta, until nothing does.
  void exclude(WindowFit& fit, const WindowRange& window) {
    if (model_.gate() == nullptr) return;
    for (int i = 0; i < settings_.max_iterations && disturbed(fit, window, Terms::all); ++i) {
      leave_out(window);
      if (solve(fit, window, Terms::all, nullptr) != WindowStatus::fitted) return;
    }
  }

  // One Gauss-Newton step of the motion at a given theta and the information there, on fixed knots.
  Status relinearise(WindowFit& fit, const WindowRange& window, const Eigen::VectorXd& theta) {
    fit.theta = theta;
    build(blocks_, window, fit.spline, theta);
    normal_.assemble(model_, blocks_, fit.spline, fit.x, theta, Terms::all, true);
    if (const Status st = normal_.reduce(); st != Status::ok) return st;
    fit.information = {normal_.information(), normal_.score()};
    fit.x += normal_.motion_step({});
    return Status::ok;
  }

  // The motion and the information on given knots, theta held.
  WindowFit hold(const WindowRange& window, const BSpline& spline, const Eigen::VectorXd& theta) {
    WindowFit fit;
    fit.spline = spline;
    fit.theta = theta;
    fit.x = Coefficients::Zero(spline.coefficients(), kCoordinates);
    fit.status = solve(fit, window, Terms::motion, nullptr);
    if (fit.status == WindowStatus::fitted) fit.status = solve(fit, window, Terms::all, nullptr);
    if (fit.status == WindowStatus::fitted && relinearise(fit, window, theta) != Status::ok) {
      fit.status = WindowStatus::motion_undetermined;
    }
    return fit;
  }

  // The payload's wrench at every sensor sample of the window, SI, as the sensor feels it: rows of `out`.
  void predict(const WindowFit& fit, const WindowRange& window, RowMatrix& out) const {
    const Vector6 unit = model_.wrench_scale().cwiseAbs().cwiseInverse();
    const WindowModelAt<N> model(model_, fit.theta);
    for_each_sensor_sample(fit, window, model, [&](std::size_t k, int, const Vector6& w) {
      if (model_.sensed(k)) out.row(static_cast<Eigen::Index>(k)) = w.cwiseProduct(unit);
    });
  }

  // Statistics of a converged fit: the score test of halved knots, residuals at every sample, leverage; and the
  // verdict on the window.
  void finish(WindowFit& fit, const WindowRange& window, const Prior* prior) {
    const Refinement r = test(fit, window, Terms::all, prior, true);
    fit.nested = r.nested;
    fit.nested_expected = r.expected;
    fit.groups = Groups{};
    for (const Groups& g : r.residuals) {
      for (std::size_t k = 0; k < kGroups; ++k) fit.groups[k] += g[k];
    }
    take_components(fit, window);
    add_leverage(fit);
    fit.disturbances = disturbances(window);
    fit.status =
        left_out_share(window) > settings_.most_disturbed ? WindowStatus::misfit : WindowStatus::fitted;
    for (const GroupStatistics& g : fit.groups) {
      if (g.deviate() > settings_.reject_sigma) fit.status = WindowStatus::misfit;
    }
    if (fit.status == WindowStatus::fitted &&
        fit.nested - fit.nested_expected > settings_.reject_sigma * std::sqrt(2.0 * fit.nested_expected)) {
      fit.status = WindowStatus::unresolved;
    }
  }

 private:
  using Samples = std::pair<std::size_t, std::size_t>;
  using Polynomial = Eigen::Matrix<double, kCoordinates, kActive>;

  struct Refinement {
    std::vector<double> gain;  // decrease of the cost per interval by halving all of them
    std::vector<Groups> residuals;
    double nested = 0.0;
    double expected = 0.0;
  };

  WindowFit search(const WindowRange& window, const BSpline& start, const Eigen::VectorXd& theta,
                   const Prior* prior, double finest, bool gated) {
    WindowFit fit;
    fit.spline = start;
    fit.theta = theta;
    fit.x = Coefficients::Zero(start.coefficients(), kCoordinates);
    // The motion alone first: linear, independent of theta, and a safe start for the joint solution.
    if (!refine(fit, window, Terms::motion, nullptr, finest, gated)) return fit;
    if (!refine(fit, window, Terms::all, prior, finest, gated)) return fit;
    finish(fit, window, prior);
    return fit;
  }

  bool refine(WindowFit& fit, const WindowRange& window, Terms terms, const Prior* prior, double finest,
              bool gated) {
    for (int level = 0; level < settings_.max_levels; ++level) {
      WindowStatus st = solve(fit, window, terms, prior);
      if (gated) {
        // Knots too coarse look like disturbances as well: each spacing decides anew.
        open(window, terms);
        for (int i = 0; i < settings_.max_iterations && disturbed(fit, window, terms); ++i) {
          leave_out(window);
          const bool too_coarse = left_out_share(window) > settings_.most_disturbed;
          if (too_coarse) open(window, terms);
          st = solve(fit, window, terms, prior);
          if (too_coarse) break;
        }
      }
      if (st != WindowStatus::fitted) {
        // At a spacing that is still too coarse the joint problem may be misled; a finer one is tried.
        if (st != WindowStatus::not_converged) {
          fit.status = st;
          return false;
        }
      }
      const Refinement r = test(fit, window, terms, prior, false);
      const std::vector<char> marked = mark(fit.spline, r, finest);
      if (std::none_of(marked.begin(), marked.end(), [](char m) { return m; })) return true;
      BSpline finer(fit.spline.halved(marked));
      fit.x = fit.spline.refined<kCoordinates>(fit.x, finer);
      fit.spline = std::move(finer);
    }
    return true;
  }

  // Takes all samples of a window again: of the motion, of the sensor, or of both.
  void open(const WindowRange& window, Terms terms) const {
    Gate& gate = *model_.gate();
    const auto clear = [](std::vector<char>& g, const Samples& r) {
      std::fill(g.begin() + static_cast<std::ptrdiff_t>(r.first),
                g.begin() + static_cast<std::ptrdiff_t>(r.second), 0);
    };
    if (terms == Terms::all) return clear(gate.wrench, window.wrench);
    for (std::size_t m = 0; m < window.motion.size(); ++m) clear(gate.motion[m], window.motion[m]);
  }
  void open(const WindowRange& window) const {
    if (model_.gate() == nullptr) return;
    open(window, Terms::motion);
    open(window, Terms::all);
  }

  // Looks for disturbances in the streams that `terms` adds. They are kept for leave_out().
  bool disturbed(const WindowFit& fit, const WindowRange& window, Terms terms) {
    residual_rows(fit, window, terms);
    found_.clear();
    for (std::size_t s = 0; s < residual_rows_.size(); ++s) {
      if (residual_rows_[s].rows() == 0) continue;
      const DisturbanceScan scan(residual_rows_[s]);
      for (const Disturbance& d : scan.find(scan.samples() / 3, settings_.false_disturbances)) {
        found_.emplace_back(terms == Terms::all ? -1 : static_cast<int>(s), d);
      }
    }
    return !found_.empty();
  }

  void leave_out(const WindowRange& window) const {
    Gate& gate = *model_.gate();
    for (const auto& [series, d] : found_) {
      std::vector<char>& g = series < 0 ? gate.wrench : gate.motion[static_cast<std::size_t>(series)];
      const std::size_t first =
          series < 0 ? window.wrench.first : window.motion[static_cast<std::size_t>(series)].first;
      std::fill(g.begin() + static_cast<std::ptrdiff_t>(first + d.first),
                g.begin() + static_cast<std::ptrdiff_t>(first + d.last), 1);
    }
  }

  static double share(const std::vector<char>& gate, const Samples& r) {
    if (r.first == r.second) return 0.0;
    const auto begin = gate.begin() + static_cast<std::ptrdiff_t>(r.first);
    const auto end = gate.begin() + static_cast<std::ptrdiff_t>(r.second);
    return static_cast<double>(std::count(begin, end, 1)) / static_cast<double>(r.second - r.first);
  }

  // Stretches left out.
  int disturbances(const WindowRange& window) const {
    if (model_.gate() == nullptr) return 0;
    int sum = 0;
    const auto count = [&](const std::vector<char>& g, const Samples& r) {
      for (std::size_t k = r.first; k < r.second; ++k) sum += g[k] != 0 && (k == r.first || g[k - 1] == 0);
    };
    count(model_.gate()->wrench, window.wrench);
    for (std::size_t m = 0; m < window.motion.size(); ++m) count(model_.gate()->motion[m], window.motion[m]);
    return sum;
  }

  // Share of the samples left out, of the series that lost most.
  double left_out_share(const WindowRange& window) const {
    if (model_.gate() == nullptr) return 0.0;
    double most = share(model_.gate()->wrench, window.wrench);
    for (std::size_t m = 0; m < window.motion.size(); ++m) {
      most = std::max(most, share(model_.gate()->motion[m], window.motion[m]));
    }
    return most;
  }

  // Whether most intervals do not fit: no disturbance, but noise or a motion that the model has not.
  bool hopeless(const WindowFit& fit, const WindowRange& window) const {
    if (fit.status != WindowStatus::misfit && fit.status != WindowStatus::unresolved) return false;
    int bad = 0;
    const std::vector<Groups> groups = residuals(fit, window, Terms::all);
    for (const Groups& interval : groups) {
      bad += std::any_of(interval.begin(), interval.end(),
                         [&](const GroupStatistics& g) { return g.deviate() > settings_.hopeless_sigma; });
    }
    return bad > settings_.hopeless_share * static_cast<double>(groups.size());
  }

  // Knots much closer in one place than in another.
  static bool crowded(const BSpline& spline) {
    double narrow = spline.width(0), wide = narrow;
    for (int i = 1; i < spline.intervals(); ++i) {
      narrow = std::min(narrow, spline.width(i));
      wide = std::max(wide, spline.width(i));
    }
    return narrow < 0.3 * wide;
  }

  // What an explanation costs: residuals, twice the coefficients (Akaike), and what finding a disturbance among all
  // stretches is worth, each beyond what the samples it leaves out would have cost.
  double price(const WindowFit& fit) const {
    double sum =
        2.0 * kCoordinates * fit.spline.coefficients() + settings_.disturbance_price * fit.disturbances;
    double used = 0.0;
    for (const GroupStatistics& g : fit.groups) {
      sum += g.sum_of_squares;
      used += g.count;
    }
    return sum - 2.0 * used;
  }

  // Residuals of the streams that `terms` adds over their sigma, a row per sample of the window, NaN where left out.
  void residual_rows(const WindowFit& fit, const WindowRange& window, Terms terms) {
    residual_rows_.clear();
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    if (terms == Terms::motion) {
      for (std::size_t m = 0; m < window.motion.size(); ++m) {
        const auto [first, last] = window.motion[m];
        residual_rows_.push_back(RowMatrix::Constant(static_cast<Eigen::Index>(last - first), 6, nan));
        for_each_motion_residual(fit, window, m, [&](std::size_t k, int, const Vector6& r) {
          residual_rows_.back().row(static_cast<Eigen::Index>(k - first)) = r;
        });
      }
      return;
    }
    const auto [first, last] = window.wrench;
    residual_rows_.push_back(
        RowMatrix::Constant(static_cast<Eigen::Index>(last - first), model_.layout().channels, nan));
    for_each_sensor_residual(fit, window, [&](std::size_t k, int, const ChannelVector<N>& r) {
      residual_rows_.back().row(static_cast<Eigen::Index>(k - first)) = r;
    });
  }

  void build(Blocks<N>& blocks, const WindowRange& window, const BSpline& spline,
             const Eigen::VectorXd& theta) const {
    blocks.build(model_, window, spline, settings_.blocks_per_interval, delay(theta));
  }

  double delay(const Eigen::VectorXd& theta) const {
    const ParameterLayout& layout = model_.layout();
    return layout.time_offset ? theta[layout.time_offset_begin()] : 0.0;
  }

  WindowStatus solve(WindowFit& fit, const WindowRange& window, Terms terms, const Prior* prior) {
    build(blocks_, window, fit.spline, fit.theta);
    for (int i = 0; i < settings_.max_iterations; ++i) {
      normal_.assemble(model_, blocks_, fit.spline, fit.x, fit.theta, terms, prior != nullptr);
      if (normal_.reduce() != Status::ok) return WindowStatus::motion_undetermined;
      ++fit.iterations;
      double decrement = normal_.motion_decrement();
      Eigen::VectorXd dtheta;
      if (prior != nullptr) {
        const Eigen::VectorXd pull = prior->information * (prior->mean - fit.theta);
        const Eigen::VectorXd g = normal_.score() + pull;
        dtheta = (normal_.information() + prior->information).llt().solve(g);
        decrement += g.dot(dtheta);
      }
      if (!std::isfinite(decrement)) return WindowStatus::not_converged;
      const Coefficients dx = normal_.motion_step(dtheta);
      if (terms == Terms::motion) {  // linear: one step is the solution
        fit.x += dx;
        return WindowStatus::fitted;
      }
      const bool last = decrement < settings_.tolerance;
      const double before = normal_.cost() + prior_cost(fit.theta, prior);
      double step = 1.0;
      for (;; step *= 0.5) {
        if (step < 1e-3) return WindowStatus::not_converged;
        const Coefficients x = fit.x + step * dx;
        const Eigen::VectorXd theta =
            prior != nullptr ? Eigen::VectorXd(fit.theta + step * dtheta) : fit.theta;
        if (prior != nullptr && model_.layout().time_offset) {
          blocks_.build_wrench(model_, window, fit.spline, settings_.blocks_per_interval, delay(theta));
        }
        if (last || cost(x, theta) + prior_cost(theta, prior) < before - 1e-4 * step * decrement) {
          fit.x = x;
          fit.theta = theta;
          break;
        }
      }
      if (last) return WindowStatus::fitted;
    }
    return WindowStatus::not_converged;
  }

  static double prior_cost(const Eigen::VectorXd& theta, const Prior* prior) {
    if (prior == nullptr) return 0.0;
    const Eigen::VectorXd d = theta - prior->mean;
    return d.dot(prior->information * d);
  }

  double cost(const Coefficients& x, const Eigen::VectorXd& theta) const {
    double sum = 0.0;
    for (const MotionBlock& b : blocks_.motion) {
      const Vector6 r = b.value - b.series->of(x.middleRows<kActive>(b.interval).transpose() * b.basis);
      sum += b.weight.dot(r.cwiseAbs2());
    }
    const WindowModelAt<N> model(model_, theta);
    for (const WrenchBlock<N>& b : blocks_.wrench)
      sum += b.weight.dot((b.raw - raw_of(model, b, x)).cwiseAbs2());
    return sum;
  }

  static ChannelVector<N> raw_of(const WindowModelAt<N>& model, const WrenchBlock<N>& b,
                                 const Coefficients& x) {
    const auto xi = x.middleRows<kActive>(b.interval);
    const Vector6 w =
        model.wrench_at(xi.transpose() * b.basis, xi.transpose() * b.basis_rate, b.gravity, b.spread);
    return model.raw_of(w, b.temperature);
  }

  // The score test of the spline with every interval halved. `keep`: leave its information in fit.finer and that
  // of the present knots in fit.information.
  Refinement test(WindowFit& fit, const WindowRange& window, Terms terms, const Prior* prior, bool keep) {
    Refinement out;
    out.residuals = residuals(fit, window, terms);
    out.gain.assign(static_cast<std::size_t>(fit.spline.intervals()), 0.0);
    const bool common = keep || prior != nullptr;
    if (keep) {
      build(blocks_, window, fit.spline, fit.theta);
      normal_.assemble(model_, blocks_, fit.spline, fit.x, fit.theta, terms, true);
      if (normal_.reduce() == Status::ok) fit.information = {normal_.information(), normal_.score()};
      fit.finer = fit.information;
    }
    const std::vector<char> all(out.gain.size(), 1);
    const BSpline finer(fit.spline.halved(all));
    const Coefficients x = fit.spline.refined<kCoordinates>(fit.x, finer);
    build(fine_blocks_, window, finer, fit.theta);
    fine_normal_.assemble(model_, fine_blocks_, finer, x, fit.theta, terms, common);
    if (fine_normal_.reduce() != Status::ok) return out;  // too few samples to ask
    if (keep) fit.finer = {fine_normal_.information(), fine_normal_.score()};
    Eigen::VectorXd dtheta;
    if (prior != nullptr) {
      dtheta = (fine_normal_.information() + prior->information)
                   .llt()
                   .solve(fine_normal_.score() + prior->information * (prior->mean - fit.theta));
    }
    const Coefficients x_new = x + fine_normal_.motion_step(dtheta);
    const Eigen::VectorXd theta_new = prior != nullptr ? Eigen::VectorXd(fit.theta + dtheta) : fit.theta;
    for (const MotionBlock& b : fine_blocks_.motion) {
      const Vector6 d = b.series->of((x_new - x).middleRows<kActive>(b.interval).transpose() * b.basis);
      out.gain[static_cast<std::size_t>(b.interval / 2)] += b.weight.dot(d.cwiseAbs2());
    }
    if (terms == Terms::all) {
      const WindowModelAt<N> model(model_, fit.theta);
      const WindowModelAt<N> model_new(model_, theta_new);
      for (const WrenchBlock<N>& b : fine_blocks_.wrench) {
        const ChannelVector<N> d = raw_of(model_new, b, x_new) - raw_of(model, b, x);
        out.gain[static_cast<std::size_t>(b.interval / 2)] += b.weight.dot(d.cwiseAbs2());
      }
    }
    for (const double g : out.gain) out.nested += g;
    out.expected = kCoordinates * static_cast<double>(out.gain.size());
    return out;
  }

  std::vector<char> mark(const BSpline& spline, const Refinement& r, double finest) const {
    std::vector<char> marked(r.gain.size(), 0);
    const double local_limit = kCoordinates + settings_.interval_sigma * std::sqrt(2.0 * kCoordinates);
    const bool pooled =
        r.nested - r.expected > settings_.window_sigma * std::sqrt(2.0 * std::max(r.expected, 1.0));
    const double lost = kCoordinates * (1.0 + kDegree / static_cast<double>(spline.intervals()));
    for (std::size_t i = 0; i < marked.size(); ++i) {
      bool bad = r.gain[i] > local_limit || (pooled && r.gain[i] > kCoordinates);
      double total = 0.0;
      for (const GroupStatistics& g : r.residuals[i]) total += g.count;
      for (GroupStatistics g : r.residuals[i]) {
        g.leverage = total > 0.0 ? lost * g.count / total : 0.0;
        bad = bad || g.deviate() > settings_.residual_sigma;
      }
      marked[i] = bad && 0.5 * spline.width(static_cast<int>(i)) >= finest;
    }
    return marked;
  }

  // Residuals at every sample, per interval and group.
  std::vector<Groups> residuals(const WindowFit& fit, const WindowRange& window, Terms terms) const {
    std::vector<Groups> out(static_cast<std::size_t>(fit.spline.intervals()));
    const auto add = [](GroupStatistics& g, double r) {
      if (!std::isfinite(r)) return;
      g.sum_of_squares += r * r;
      g.count += 1.0;
    };
    for (std::size_t m = 0; m < window.motion.size(); ++m) {
      for_each_motion_residual(fit, window, m, [&](std::size_t, int i, const Vector6& r) {
        for (int c = 0; c < 6; ++c) add(out[static_cast<std::size_t>(i)][motion_group(c)], r[c]);
      });
    }
    if (terms == Terms::motion) return out;
    const int n = model_.layout().channels;
    for_each_sensor_residual(fit, window, [&](std::size_t, int i, const ChannelVector<N>& r) {
      for (int c = 0; c < n; ++c) add(out[static_cast<std::size_t>(i)][wrench_group(c, n)], r[c]);
    });
    return out;
  }

  // Calls visit(sample, interval, residual over sigma) for the samples of a window that are not left out.
  template <typename Visit>
  void for_each_motion_residual(const WindowFit& fit, const WindowRange& window, std::size_t m,
                                const Visit& visit) const {
    const MotionSeries& series = model_.log().motion[m];
    const Vector6 precision = series.sigma.cwiseInverse();
    for_each_sample(
        fit, series.time, 0.0, window.motion[m],
        [&](std::size_t k, int i, const Polynomial& x, const Powers& u) {
          if (!model_.moved(m, k)) return;
          const Vector6 s = series.order == 0 ? x * u : x * fit.spline.rate(i, u);
          visit(k, i,
                (Eigen::Map<const Vector6>(series.value + 6 * k) - series.of(s)).cwiseProduct(precision));
        });
  }

  template <typename Visit>
  void for_each_sensor_residual(const WindowFit& fit, const WindowRange& window, const Visit& visit) const {
    const WindowModelAt<N> model(model_, fit.theta);
    for_each_sensor_sample(fit, window, model, [&](std::size_t k, int i, const Vector6& w) {
      if (!model_.sensed(k)) return;
      visit(k, i, (model_.raw(k) - model.raw_of(w, model_.temperature(k))).cwiseProduct(model_.precision()));
    });
  }

  // Calls visit(sample, interval, normalised wrench) for the sensor's samples of a window.
  template <typename Visit>
  void for_each_sensor_sample(const WindowFit& fit, const WindowRange& window, const WindowModelAt<N>& model,
                              const Visit& visit) const {
    const WrenchSeries& series = model_.log().wrench;
    for_each_sample(fit, series.time, model.delay(), window.wrench,
                    [&](std::size_t k, int i, const Polynomial& x, const Powers& u) {
                      const Vector3 g = model_.log().gravity.at(series.time[k] + model.delay());
                      visit(k, i, model.wrench_at(x * u, x * fit.spline.rate(i, u), g));
                    });
  }

  template <typename Visit>
  static void for_each_sample(const WindowFit& fit, std::span<const double> time, double delay,
                              std::pair<std::size_t, std::size_t> range, const Visit& visit) {
    std::size_t k = range.first;
    for (int i = 0; i < fit.spline.intervals() && k < range.second; ++i) {
      const Polynomial x = fit.spline.polynomial<kCoordinates>(i, fit.x);
      const bool last = i + 1 == fit.spline.intervals();
      const double edge = fit.spline.breakpoints()[static_cast<std::size_t>(i) + 1];
      for (; k < range.second && (last || time[k] + delay < edge); ++k) {
        visit(k, i, x, powers(fit.spline.local(i, time[k] + delay)));
      }
    }
  }

  // Statistics of every channel and of every component of the motion's first series.
  void take_components(WindowFit& fit, const WindowRange& window) {
    const int n = model_.layout().channels;
    fit.components.assign(static_cast<std::size_t>(n + kCoordinates), ComponentStatistics{});
    const auto take = [&](RowMatrix& rows, const std::vector<char>* gate, std::size_t first, int at) {
      for (Eigen::Index k = 0; gate != nullptr && k < rows.rows(); ++k) {
        if ((*gate)[first + static_cast<std::size_t>(k)] != 0)
          rows.row(k).setConstant(std::numeric_limits<double>::quiet_NaN());
      }
      for (Eigen::Index c = 0; c < rows.cols(); ++c) {
        fit.components[static_cast<std::size_t>(at + c)].add(rows.col(c).eval());
      }
    };
    const Gate* gate = model_.gate();
    residual_rows(fit, window, Terms::all);
    take(residual_rows_.front(), gate != nullptr ? &gate->wrench : nullptr, window.wrench.first, 0);
    residual_rows(fit, window, Terms::motion);
    if (residual_rows_.empty()) return;
    take(residual_rows_.front(), gate != nullptr ? &gate->motion.front() : nullptr,
         window.motion.front().first, n);
  }

  // trace(W J Hxx^-1 J^T) per group and component: the degrees of freedom that the motion took.
  void add_leverage(WindowFit& fit) {
    const double all = static_cast<double>(kCoordinates * fit.spline.coefficients());
    const auto total = [&] {
      double sum = 0.0;
      for (const double l : leverage_) sum += l;
      return sum;
    };
    leverage_by_band(fit);
    // The recursion inside the band cancels where the velocities hardly hold the motion; all leverages together
    // are the number of coefficients, which tells.
    const bool sound = std::abs(total() - all) < 1e-3 * all &&
                       std::all_of(leverage_.begin(), leverage_.end(), [](double l) { return l >= 0.0; });
    if (!sound) leverage_by_probes(fit);
    const int n = model_.layout().channels;
    for (int c = 0; c < n + kCoordinates; ++c) {
      const double l = leverage_[static_cast<std::size_t>(c)];
      fit.groups[c < n ? wrench_group(c, n) : motion_group(c - n)].leverage += l;
      fit.components[static_cast<std::size_t>(c)].all.leverage += l;
    }
  }

  // By the blocks of Hxx^-1 inside the band. normal_ holds the factor of the present knots.
  void leverage_by_band(const WindowFit& fit) {
    const MotionNormal z = normal_.covariance_band();
    const auto covariance = [&](int interval, const BasisRow& a, const BasisRow& b) {
      Matrix6 sum = Matrix6::Zero();
      for (int k = 0; k < kActive; ++k) {
        for (int l = 0; l < kActive; ++l) {
          if (k >= l) {
            sum += (a[k] * b[l]) * z(interval + k, interval + l);
          } else {
            sum += (a[k] * b[l]) * z(interval + l, interval + k).transpose();
          }
        }
      }
      return sum;
    };
    const int n = model_.layout().channels;
    leverage_.assign(static_cast<std::size_t>(n + kCoordinates), 0.0);
    for (const MotionBlock& b : blocks_.motion) {
      Matrix6 variance_of = covariance(b.interval, b.basis, b.basis);
      if (!b.series->direct) {
        variance_of = b.series->combination * variance_of * b.series->combination.transpose();
      }
      const Vector6 variance = variance_of.diagonal();
      for (int c = 0; c < 6; ++c) leverage_[static_cast<std::size_t>(n + c)] += b.weight[c] * variance[c];
    }
    const WindowModelAt<N> model(model_, fit.theta);
    const ChannelMatrix<N>& by_rate = model.raw_by_rate();
    for (const WrenchBlock<N>& b : blocks_.wrench) {
      const Vector6 s = fit.x.middleRows<kActive>(b.interval).transpose() * b.basis;
      const ChannelMatrix<N> by_coordinate = model.raw_by_coordinate(s);
      const Matrix6 cc = covariance(b.interval, b.basis, b.basis);
      const Matrix6 cr = covariance(b.interval, b.basis, b.basis_rate);
      const Matrix6 rr = covariance(b.interval, b.basis_rate, b.basis_rate);
      for (int c = 0; c < n; ++c) {
        const auto jc = by_coordinate.row(c);
        const auto jr = by_rate.row(c);
        const double variance =
            (jc * cc * jc.transpose() + 2.0 * jc * cr * jr.transpose() + jr * rr * jr.transpose())(0);
        leverage_[static_cast<std::size_t>(c)] += b.weight[c] * variance;
      }
    }
  }

  // By Hutchinson's estimator: z^T A z with random signs z has the mean trace(A), and needs only solutions.
  void leverage_by_probes(const WindowFit& fit) {
    constexpr int probes = 16;
    const int n = model_.layout().channels;
    const WindowModelAt<N> model(model_, fit.theta);
    const ChannelMatrix<N>& by_rate = model.raw_by_rate();
    leverage_.assign(static_cast<std::size_t>(n + kCoordinates), 0.0);
    const auto rows = static_cast<std::size_t>(kCoordinates) * blocks_.motion.size() +
                      static_cast<std::size_t>(n) * blocks_.wrench.size();
    std::minstd_rand random(1);
    std::vector<double> signs(rows);
    for (int p = 0; p < probes; ++p) {
      for (double& s : signs) s = random() % 2 == 0 ? 1.0 : -1.0;
      Eigen::MatrixXd y = Eigen::MatrixXd::Zero(kCoordinates * fit.spline.coefficients(), 1);
      // Twice over the rows J of the whitened problem: y = J^T z, then z^T J H^-1 y per component.
      for (const bool forward : {true, false}) {
        std::size_t at = 0;
        for (const MotionBlock& b : blocks_.motion) {
          for (int c = 0; c < kCoordinates; ++c) {
            const double z = signs[at++] * std::sqrt(b.weight[c]);
            for (int k = 0; k < kActive; ++k) {
              const Vector6 row = (z * b.basis[k]) * b.series->combination.row(c).transpose();
              auto entry = y.col(0).template segment<kCoordinates>(kCoordinates * (b.interval + k));
              if (forward) entry += row;
              if (!forward) leverage_[static_cast<std::size_t>(n + c)] += row.dot(entry) / probes;
            }
          }
        }
        for (const WrenchBlock<N>& b : blocks_.wrench) {
          const Vector6 s = fit.x.middleRows<kActive>(b.interval).transpose() * b.basis;
          const ChannelMatrix<N> by_coordinate = model.raw_by_coordinate(s);
          for (int c = 0; c < n; ++c) {
            const double z = signs[at++] * std::sqrt(b.weight[c]);
            for (int k = 0; k < kActive; ++k) {
              const Vector6 row =
                  z * (b.basis[k] * by_coordinate.row(c) + b.basis_rate[k] * by_rate.row(c)).transpose();
              auto entry = y.col(0).template segment<kCoordinates>(kCoordinates * (b.interval + k));
              if (forward) entry += row;
              if (!forward) leverage_[static_cast<std::size_t>(c)] += row.dot(entry) / probes;
            }
          }
        }
        if (forward) normal_.solve(y);
      }
    }
    for (double& l : leverage_) l = std::max(l, 0.0);
  }

  const WindowModel<N>& model_;
  KnotSettings settings_;
  Blocks<N> blocks_;
  Blocks<N> fine_blocks_;
  WindowNormal<N> normal_;
  WindowNormal<N> fine_normal_;
  std::vector<RowMatrix> residual_rows_;
  std::vector<double> leverage_;                    // per channel, then per component of the motion
  std::vector<std::pair<int, Disturbance>> found_;  // the series of the motion, or -1 for the sensor
};

}  // namespace truewrench
