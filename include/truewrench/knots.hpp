// One window solved: Gauss-Newton on (motion, common parameters), and the search for the coarsest knots that the
// data accept (docs/method.md, "Knots").
//
// Coarse to fine. At every spacing two questions are asked of each interval: are the residuals of every stream
// as large as their noise says, and would halving the interval lower the cost by more than chance (the score
// test of the nested, finer spline: one linearisation, no second fit)? An interval that fails is halved, or dealt
// out anew with its neighbours where its halves would be too short.
#pragma once

#include "truewrench/gating.hpp"
#include "truewrench/leverage.hpp"
#include "truewrench/push.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

namespace truewrench {

template <int N>
class WindowSolver {
 public:
  WindowSolver(const WindowModel<N>& model, const KnotSettings& settings)
      : model_(model), settings_(settings), gating_(model, settings.false_disturbances) {}

  // Searches knots from `start` on. With `prior` theta is solved for, else it is held. Where the window does not fit,
  // or only with knots crowded in one place, or leaves a disturbance in its residuals, it is searched again with
  // what does not belong left out; of two explanations that fit, the cheaper one stands. A window that fits at a held
  // theta carries what its verdict took; its noise components and all of its leverage are counted by `finish`.
  WindowFit search(const WindowRange& window, const BSpline& start, const Eigen::VectorXd& theta,
                   const Prior* prior, double finest) {
    gating_.open(window);
    WindowFit fit = search(window, start, theta, prior, finest, false);
    if (!gating_.possible() || !suspect(fit, window)) return fit;
    const bool fitted = fit.status == WindowStatus::fitted;
    if (nowhere(fit) && hopeless(fit, window, prior == nullptr)) return fit;
    gating_.open(window);
    WindowFit other = search(window, start, theta, prior, finest, true);
    other.iterations += fit.iterations;
    if (other.status == WindowStatus::fitted && (!fitted || price(other) < price(fit))) return other;
    gating_.open(window);
    return fit;
  }

  // Whether another search may do better: the window does not fit, or only with knots crowded in one place, or what is
  // not noise stands out of its residuals.
  bool suspect(const WindowFit& fit, const WindowRange& window) {
    return fit.status != WindowStatus::fitted || crowded(fit.spline) ||
           gating_.disturbed(fit, window, Terms::all);
  }

  // Whether a window that does not fit at a held theta would hardly anywhere with it free, at its knots, which resolve
  // what the samples do where it does not fit.
  bool lost(const WindowFit& held, const WindowRange& window, const Prior& prior) {
    if (!nowhere(held)) return false;
    WindowFit free = held;
    return solve(free, window, Terms::all, &prior) == WindowStatus::fitted && hopeless(free, window, false);
  }

  // Leaves out what stands out of the residuals at a given theta, until nothing does.
  void exclude(WindowFit& fit, const WindowRange& window) {
    if (!gating_.possible()) return;
    for (int i = 0; i < settings_.max_iterations && gating_.disturbed(fit, window, Terms::all); ++i) {
      gating_.leave_out(window);
      if (solve(fit, window, Terms::all, nullptr) != WindowStatus::fitted) return;
    }
  }

  // One Gauss-Newton step of the motion at a given theta and the information there, on fixed knots. `freedom`: of the
  // sensor's noise (WindowNormal::assemble).
  Status relinearise(WindowFit& fit, const WindowRange& window, const Eigen::VectorXd& theta,
                     double freedom = 0.0) {
    fit.theta = theta;
    fit.assigned_at = assignment(fit, delay(theta));
    build(blocks_, window, fit.spline, theta, fit.assigned_at);
    normal_.assemble(model_, blocks_, fit.spline, fit.x, theta, Terms::all, true, freedom);
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
    WindowResiduals<N>(model_, fit, window).for_each_wrench([&](std::size_t k, int, const Vector6& w) {
      if (model_.sensed(k)) out.row(static_cast<Eigen::Index>(k)) = w.cwiseProduct(unit);
    });
  }

  // Statistics of a converged fit: the score test of halved knots, residuals at every sample, leverage; and the
  // verdict on the window.
  void finish(WindowFit& fit, const WindowRange& window, const Prior* prior) {
    const Refinement r = test(fit, window, Terms::all, prior, true);
    fit.nested = r.nested;
    fit.nested_expected = r.expected;
    WindowResiduals<N>(model_, fit, window).summarise(fit.groups, fit.components);
    add_leverage(fit);
    conclude(fit, window);
  }

  // The samples of the strongest push that motion and common parameters, of this covariance, have taken up; none: of no
  // samples.
  Disturbance push(const WindowFit& fit, const WindowRange& window, const Eigen::MatrixXd& covariance) {
    if (!gating_.possible()) return {};
    build(blocks_, window, fit.spline, fit.theta, fit.assigned_at);
    normal_.assemble(model_, blocks_, fit.spline, fit.x, fit.theta, Terms::all, true);
    if (normal_.reduce() != Status::ok) return {};
    return PushScan<N>(model_, fit, blocks_, normal_, covariance).strongest(settings_.false_pushes);
  }

 private:
  // That a window is judged by as a whole, and the share of a misfit that their better half has if it is in no one place.
  static constexpr int kStretches = 20;
  static constexpr double kEverywhere = 0.1;

  struct Refinement {
    std::vector<double> gain;  // decrease of the cost per interval by halving all of them
    std::vector<Groups> residuals;
    double nested = 0.0;
    double expected = 0.0;
  };

  // The verdict on a fit that has just passed the test of its knots. The motion's degrees of freedom are counted only
  // where it matters which groups they came from.
  void judge(WindowFit& fit, const WindowRange& window, const Refinement& r) {
    fit.nested = r.nested;
    fit.nested_expected = r.expected;
    fit.groups = Groups{};
    for (const Groups& g : r.residuals) {
      for (std::size_t k = 0; k < kGroups; ++k) fit.groups[k] += g[k];
    }
    const double most = kCoordinates * fit.spline.coefficients();
    if (std::any_of(fit.groups.begin(), fit.groups.end(), [&](GroupStatistics g) {
          g.leverage = most;
          return g.count > 0.0 && (g.degrees_of_freedom() < 1.0 || g.deviate() > settings_.reject_sigma);
        })) {
      add_leverage(fit);
    }
    conclude(fit, window);
  }

  void conclude(WindowFit& fit, const WindowRange& window) const {
    fit.disturbances = gating_.disturbances(window);
    fit.status = gating_.left_out_share(window) > settings_.most_disturbed ? WindowStatus::misfit
                                                                           : WindowStatus::fitted;
    for (const GroupStatistics& g : fit.groups) {
      if (g.deviate() > settings_.reject_sigma) fit.status = WindowStatus::misfit;
    }
    if (fit.status == WindowStatus::fitted &&
        fit.nested - fit.nested_expected > settings_.reject_sigma * std::sqrt(2.0 * fit.nested_expected)) {
      fit.status = WindowStatus::unresolved;
    }
  }

  WindowFit search(const WindowRange& window, const BSpline& start, const Eigen::VectorXd& theta,
                   const Prior* prior, double finest, bool gated) {
    WindowFit fit;
    fit.spline = start;
    fit.theta = theta;
    fit.x = Coefficients::Zero(start.coefficients(), kCoordinates);
    // The motion alone first: linear, independent of theta, and a safe start for the joint solution.
    if (!refine(fit, window, Terms::motion, nullptr, finest, gated)) return fit;
    if (!refine(fit, window, Terms::all, prior, finest, gated)) return fit;
    // At a held theta the test that ended the search says all that a window that fits is asked for.
    if (prior == nullptr && accepted_) judge(fit, window, *accepted_);
    if (fit.status != WindowStatus::fitted) finish(fit, window, prior);
    return fit;
  }

  bool refine(WindowFit& fit, const WindowRange& window, Terms terms, const Prior* prior, double finest,
              bool gated) {
    accepted_.reset();
    for (int level = 0; level < settings_.max_levels; ++level) {
      WindowStatus st = solve(fit, window, terms, prior);
      if (gated) {
        // Knots too coarse look like disturbances as well: each spacing decides anew.
        gating_.open(window, terms);
        for (int i = 0; i < settings_.max_iterations && gating_.disturbed(fit, window, terms); ++i) {
          gating_.leave_out(window);
          const bool too_coarse = gating_.left_out_share(window) > settings_.most_disturbed;
          if (too_coarse) gating_.open(window, terms);
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
      Refinement r = test(fit, window, terms, prior, false);
      BSpline finer(fit.spline.halved(mark(fit.spline, r), finest));
      if (finer.intervals() == fit.spline.intervals()) {
        accepted_ = std::move(r);
        return true;
      }
      fit.x = fit.spline.refined<kCoordinates>(fit.x, finer);
      fit.spline = std::move(finer);
    }
    return true;
  }

  // Whether all knots were tried, and none do.
  static bool nowhere(const WindowFit& fit) {
    return fit.status == WindowStatus::misfit || fit.status == WindowStatus::unresolved;
  }

  // Whether hardly a stretch of the window fits, and what does not is not in few of them: no disturbance, but noise or a
  // motion that the model has not. At a held theta single intervals are asked: what is a little wrong with it is
  // everywhere in longer stretches, and must not end the search for disturbances.
  bool hopeless(const WindowFit& fit, const WindowRange& window, bool held) const {
    const int most = held ? fit.spline.intervals() : kStretches;
    const std::vector<Groups> stretches = WindowResiduals<N>(model_, fit, window).stretches(most);
    double bad = 0.0;
    std::vector<double> excess;
    for (const Groups& stretch : stretches) {
      bad += std::any_of(stretch.begin(), stretch.end(),
                         [&](const GroupStatistics& g) { return g.deviate() > settings_.hopeless_sigma; });
      double sum = 0.0;
      for (const GroupStatistics& g : stretch) sum += g.sum_of_squares - g.degrees_of_freedom();
      excess.push_back(std::max(0.0, sum));
    }
    std::sort(excess.begin(), excess.end());
    const auto half = excess.begin() + static_cast<std::ptrdiff_t>(excess.size() / 2);
    return bad > settings_.hopeless_share * static_cast<double>(stretches.size()) &&
           std::accumulate(excess.begin(), half, 0.0) >
               kEverywhere * std::accumulate(excess.begin(), excess.end(), 0.0);
  }

  // Knots much closer in one place than in another.
  static bool crowded(const BSpline& spline) {
    double wide = 0.0;
    for (int i = 0; i < spline.intervals(); ++i) wide = std::max(wide, spline.width(i));
    return narrowest(spline) < 0.3 * wide;
  }

  static double narrowest(const BSpline& spline) {
    double narrow = spline.width(0);
    for (int i = 1; i < spline.intervals(); ++i) narrow = std::min(narrow, spline.width(i));
    return narrow;
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

  void build(Blocks<N>& blocks, const WindowRange& window, const BSpline& spline,
             const Eigen::VectorXd& theta, double assigned_at) const {
    blocks.build(model_, window, spline, settings_.blocks_per_interval, delay(theta), assigned_at);
  }

  // Samples are dealt out anew at a delay of half an interval from where they were.
  static double assignment(const WindowFit& fit, double delay) {
    return std::abs(delay - fit.assigned_at) < 0.5 * narrowest(fit.spline) ? fit.assigned_at : delay;
  }

  double delay(const Eigen::VectorXd& theta) const {
    const ParameterLayout& layout = model_.layout();
    return layout.time_offset ? theta[layout.time_offset_begin()] : 0.0;
  }

  WindowStatus solve(WindowFit& fit, const WindowRange& window, Terms terms, const Prior* prior) {
    fit.assigned_at = delay(fit.theta);
    build(blocks_, window, fit.spline, fit.theta, fit.assigned_at);
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
      bool last = decrement < settings_.tolerance;
      const double before = normal_.cost() + prior_cost(fit.theta, prior);
      double step = 1.0;
      for (;; step *= 0.5) {
        if (step < 1e-3) return WindowStatus::not_converged;
        const Coefficients x = fit.x + step * dx;
        const Eigen::VectorXd theta =
            prior != nullptr ? Eigen::VectorXd(fit.theta + step * dtheta) : fit.theta;
        const double assigned_at = assignment(fit, delay(theta));
        if (prior != nullptr && model_.layout().time_offset) {
          blocks_.build_wrench(model_, window, fit.spline, settings_.blocks_per_interval, delay(theta),
                               assigned_at);
        }
        const double after = last ? before : cost(x, theta) + prior_cost(theta, prior);
        if (last || after < before - 1e-4 * step * decrement) {
          fit.x = x;
          fit.theta = theta;
          fit.assigned_at = assigned_at;
          // A cost that falls as a quadratic would is at its minimum.
          last = last || (step == 1.0 && std::abs(before - decrement - after) < settings_.tolerance);
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
      sum += (b.value - b.of(x.middleRows<kActive>(b.interval), blocks_.rows)).squaredNorm();
    }
    const WindowModelAt<N> model(model_, theta);
    for (const WrenchBlock<N>& b : blocks_.wrench)
      sum += b.weight.dot((b.raw - raw_of(model, b, x)).cwiseAbs2());
    return sum;
  }

  static ChannelVector<N> raw_of(const WindowModelAt<N>& model, const WrenchBlock<N>& b,
                                 const Coefficients& x) {
    const MotionState state = b.state(x.middleRows<kActive>(b.interval));
    return model.raw_of(model.wrench_of(state, b.spread), b.temperature);
  }

  // The score test of the spline with every interval halved. `keep`: leave its information in fit.finer and that
  // of the present knots in fit.information.
  Refinement test(WindowFit& fit, const WindowRange& window, Terms terms, const Prior* prior, bool keep) {
    Refinement out;
    if (!keep) out.residuals = WindowResiduals<N>(model_, fit, window).groups(terms);
    out.gain.assign(static_cast<std::size_t>(fit.spline.intervals()), 0.0);
    const bool common = keep || prior != nullptr;
    if (keep) {
      build(blocks_, window, fit.spline, fit.theta, fit.assigned_at);
      normal_.assemble(model_, blocks_, fit.spline, fit.x, fit.theta, terms, true);
      if (normal_.reduce() == Status::ok) fit.information = {normal_.information(), normal_.score()};
      fit.finer = fit.information;
    }
    const std::vector<char> all(out.gain.size(), 1);
    const BSpline finer(fit.spline.halved(all));
    const Coefficients x = fit.spline.refined<kCoordinates>(fit.x, finer);
    build(fine_blocks_, window, finer, fit.theta, delay(fit.theta));
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
      const Coefficients d = x_new.middleRows<kActive>(b.interval) - x.middleRows<kActive>(b.interval);
      out.gain[static_cast<std::size_t>(b.interval / 2)] += b.of(d, fine_blocks_.rows).squaredNorm();
    }
    if (terms == Terms::all) {
      const WindowModelAt<N> model(model_, fit.theta);
      const WindowModelAt<N> model_new(model_, theta_new);
      const double later = delay(theta_new) - delay(fit.theta);
      for (const WrenchBlock<N>& b : fine_blocks_.wrench) {
        ChannelVector<N> d = raw_of(model_new, b, x_new) - raw_of(model, b, x);
        if (later != 0.0) {  // the blocks stay where they are
          const auto xi = x.middleRows<kActive>(b.interval);
          const MotionState state = b.state(xi);
          d += later * model.raw_by_time(model.raw_by_twist(state.nu), state, b.jerk(xi));
        }
        out.gain[static_cast<std::size_t>(b.interval / 2)] += b.weight.dot(d.cwiseAbs2());
      }
    }
    for (const double g : out.gain) out.nested += g;
    out.expected = kCoordinates * static_cast<double>(out.gain.size());
    return out;
  }

  // The intervals that fail a test.
  std::vector<char> mark(const BSpline& spline, const Refinement& r) const {
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
      marked[i] = bad;
    }
    return marked;
  }

  void add_leverage(WindowFit& fit) const {
    const int n = model_.layout().channels;
    const std::vector<double> leverage = Leverage<N>(model_, fit, blocks_, normal_).of_components();
    for (int c = 0; c < n + kCoordinates; ++c) {
      const double l = leverage[static_cast<std::size_t>(c)];
      fit.groups[c < n ? wrench_group(c, n) : motion_group(c - n)].leverage += l;
      if (!fit.components.empty()) fit.components[static_cast<std::size_t>(c)].all.leverage += l;
    }
  }

  const WindowModel<N>& model_;
  KnotSettings settings_;
  WindowGating<N> gating_;
  Blocks<N> blocks_;
  Blocks<N> fine_blocks_;
  WindowNormal<N> normal_;
  WindowNormal<N> fine_normal_;
  std::optional<Refinement> accepted_;  // the test that the knots passed last
};

}  // namespace truewrench
