// One fit of the model to one or several logs (METHOD 10.1, 10.2): Gauss-Newton on the motion and theta together, the sizes by
// (10.6), and the likelihood (10.7) that compares fits.
#pragma once

#include "truewrench/estimation/delay.hpp"
#include "truewrench/estimation/log_fit.hpp"
#include "truewrench/parallel.hpp"

#include <algorithm>
#include <functional>
#include <limits>
#include <memory>
#include <utility>

namespace truewrench {

class Fit {
 public:
  Fit() = default;
  Fit(std::shared_ptr<const Statement> rig, std::vector<LogFit> logs,
      const std::vector<std::vector<double>>& steps, int threads)
      : rig_(std::move(rig)), logs_(std::move(logs)), steps_(steps), threads_(threads) {
    std::vector<const RecordedLog*> recorded;
    recorded.reserve(logs_.size());
    for (const LogFit& l : logs_) recorded.push_back(l.log);
    layout_ = Layout(*rig_, recorded, steps_);
    theta = layout_.mean();
    slope_ = Eigen::VectorXd::Zero(layout_.size());
    slope_at_ = Eigen::VectorXd::Constant(layout_.size(), std::numeric_limits<double>::infinity());
    stated_ = layout_.sigma().cwiseMax(1e-9).cwiseMin(1e30).cwiseAbs2();
    prior = stated_;
    active.assign(static_cast<std::size_t>(layout_.size()), 1);
    returns_.assign(active.size(), 0);
    n_ = static_cast<int>(rig_->noise.size());
    lagged = rig_->nominal;
    for (LogFit& l : logs_) {
      l.sweeps.resize(l.stretches.size());
      l.sizes = starting_sizes(*l.log, n_);
    }
  }

  Eigen::VectorXd theta, prior;  // prior: variances as the sizes have them
  std::vector<char> active;      // kappa and gamma may be held (10.1)
  RowMatrix lagged;              // C_0 of (10.3)
  bool robust = false;
  int iterations = 0;
  bool converged = false;
  bool failed = false;  // a factorisation: the record says nothing finite

  const Statement& rig() const { return *rig_; }
  std::shared_ptr<const Statement> shared_rig() const { return rig_; }
  const Layout& layout() const { return layout_; }
  std::vector<LogFit>& logs() { return logs_; }
  const std::vector<LogFit>& logs() const { return logs_; }
  const std::vector<std::vector<double>>& steps() const { return steps_; }
  int channels() const { return n_; }
  int threads() const { return threads_; }
  const Eigen::MatrixXd& P() const { return P_; }
  const Eigen::MatrixXd& S() const { return S_; }
  const Eigen::VectorXd& step() const { return step_; }
  const Eigen::VectorXd& stated() const { return stated_; }
  // What all rows say at the last linearisation; those of a log, of its own theta, and of a quarter of each log beside those before
  // it (10.11).
  Information all() const { return {data_, gradient_}; }
  const Information& of_log(std::size_t l) const { return of_log_[l]; }
  const std::array<Information, 4>& quarters() const { return quarters_; }
  double log_determinant() const { return logdet_x_ + logdet_s_; }

  Eigen::VectorXd local(std::size_t l) const { return pick(theta, layout_.log(l).global); }

  // Standard deviation found of a channel's samples, fraction of range.
  double sigma(std::size_t l, int channel) const {
    return rig_->noise[channel] * logs_[l].sizes.raw_factor[raw_group(channel, n_)];
  }
  // RMS of sigma over the channels of a group.
  double group_sigma(std::size_t l, int group) const {
    double sum = 0.0;
    int count = 0;
    for (int i = 0; i < n_; ++i)
      if (raw_group(i, n_) == group) {
        sum += sigma(l, i) * sigma(l, i);
        ++count;
      }
    return std::sqrt(sum / count);
  }

  void predict() {
    each_stretch([this](std::size_t l, Stretch& s, Sweep&) {
      s.predict(layout_.log(l), local(l), lagged, logs_[l].sizes.form != Form::none);
    });
  }

  // w_t of 10.3 at the residuals and sizes as they stand.
  void reweigh() {
    for (std::size_t l = 0; l < logs_.size(); ++l) reweigh_log(l);
  }
  void reweigh_log(std::size_t l) {
    for (Stretch& s : logs_[l].stretches)
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k)
        s.raw.weight[k] = s.raw.size[k] * (s.raw.masked[static_cast<std::size_t>(k)] != 0 ? 0.0
                                           : robust ? robust_weight(s.raw.channels[k], chi2(l, s, k))
                                                    : 1.0);
  }

  // chi^2(t) of the channels of one sample; the mean over those that a row stands for.
  double chi2(std::size_t l, const Stretch& s, Eigen::Index k) const {
    double sum = 0.0;
    for (int i = 0; i < n_; ++i) {
      const double r = s.now.residual(k, i), v = sigma(l, i);
      sum += (r * r + s.raw.spread(k, i)) / (v * v);
    }
    return sum;
  }

  // Information and gradient of all rows, the motion eliminated; false where a factorisation fails.
  bool linearise();

  // Share of the squares of a log's unmasked rows that their weights leave, by groups of channels.
  Eigen::ArrayXd left_by_weights(std::size_t l) const {
    Eigen::ArrayXd weighted = Eigen::ArrayXd::Zero(raw_groups(n_)), all = weighted;
    for (const Stretch& s : logs_[l].stretches)
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k)
        for (int i = 0; i < n_ && s.raw.masked[static_cast<std::size_t>(k)] == 0; ++i) {
          const double r = s.now.residual(k, i), x = r * r + s.raw.spread(k, i);
          weighted[raw_group(i, n_)] += s.raw.weight[k] * x;
          all[raw_group(i, n_)] += s.raw.size[k] * x;
        }
    return (weighted > 0.0).select(weighted / all, 1.0);
  }

  // The step of theta from the last linearisation; `frozen`: with priors and held parameters as they stand.
  bool solve(bool frozen = false) {
    if (!frozen) {
      bool moved = false;
      if (!clock_prior() || !hold(moved)) return !(failed = true);
      if (moved) {  // the residuals that step and sizes see are those of after it
        predict();
        if (!linearise()) return false;
      }
    }
    S_ = with_prior();
    const std::vector<int> use = active_places();
    Eigen::MatrixXd inverse;
    if (!dense::invert(gather(S_, use), inverse, logdet_s_)) return !(failed = true);
    P_ = Eigen::MatrixXd::Zero(layout_.size(), layout_.size());
    for (std::size_t i = 0; i < use.size(); ++i)
      for (std::size_t j = 0; j < use.size(); ++j)
        P_(use[i], use[j]) = inverse(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
    step_ = dense::times(P_, pull());
    if (!step_.allFinite()) failed = true;  // a slope (10.4) where the motion is not definite
    return !failed;
  }

  // - half the gradient in theta, the motion eliminated, of rows with this gradient, such a share of all, and of the prior.
  Eigen::VectorXd pull(const Eigen::VectorXd& gradient, double share) const {
    Eigen::VectorXd out(layout_.size());
    for (Eigen::Index i = 0; i < out.size(); ++i) out[i] = gradient[i] + beside_rows(i, share);
    return out;
  }
  // What prior and slope pull at a place of theta.
  double beside_rows(Eigen::Index i, double share = 1.0) const {
    return -(theta[i] - layout_.mean()[i]) / prior[i] - 0.5 * share * slope_[i];
  }

  // Covariance of theta; what is held adds the width of its prior (10.1).
  Eigen::MatrixXd covariance() const {
    Eigen::MatrixXd out = P_;
    const Eigen::Index size = layout_.size();
    for (Eigen::Index i = 0; i < size; ++i) {
      if (active[static_cast<std::size_t>(i)] != 0) continue;
      Eigen::VectorXd L = dense::times(P_, S_.col(i)), bend;
      imitate(i, L, bend);
      L[i] = -1.0;
      const auto left = [&](double variance, const Eigen::VectorXd& by) {
        return bounded(variance, by.data() + layout_.C, prior.data() + layout_.C, 6 * n_);
      };
      const double first = left(prior[i], L);
      const double second = bend.size() > 0 ? left(0.75 * prior[i] * prior[i], bend) : 0.0;  // E s^4 / 4
      out(i, i) += prior[i] - first;  // its own width stays
      for (Eigen::Index j = 0; j < size; ++j)
        for (Eigen::Index k = 0; k < size; ++k) {
          out(k, j) += first * L[j] * L[k];
          if (bend.size() > 0) out(k, j) += second * bend[j] * bend[k];
        }
    }
    return out;
  }

  // What a step must lower at fixed sizes: the terms of (10.7) in x and theta.
  double objective() const;

  // Take the step of the last solve, halved until the objective falls.
  void advance(double share = 1.0) {
    const auto sum = [this] { return objective() + slope_.dot(theta); };
    const double before = sum();
    const Eigen::VectorXd from = theta;
    std::vector<std::vector<std::array<RowMatrix, 4>>> x(logs_.size());  // c, e and their steps
    for (std::size_t l = 0; l < logs_.size(); ++l) x[l].resize(logs_[l].stretches.size());
    each_stretch([this, &x](std::size_t l, Stretch& s, Sweep& sweep) {
      auto& [c, e, dc, de] = x[l][static_cast<std::size_t>(&s - logs_[l].stretches.data())];
      c = s.c;
      e = s.e;
      dc = RowMatrix::Zero(c.rows(), c.cols());
      de = RowMatrix::Zero(e.rows(), e.cols());
      sweep.back(pick(step_, layout_.log(l).global), dc, de);
    });
    for (; share > 0.5 * constants::move; share *= 0.5) {  // less is no move
      theta = from + share * step_;
      for (std::size_t l = 0; l < logs_.size(); ++l)
        for (std::size_t i = 0; i < x[l].size(); ++i) {
          const auto& [c, e, dc, de] = x[l][i];
          logs_[l].stretches[i].c = c + share * dc;
          if (logs_[l].sizes.form != Form::none) logs_[l].stretches[i].e = e + share * de;
        }
      predict();
      if (sum() <= before + 1e-3 * share) return;
    }
  }

  // Gauss-Newton and (10.6) until theta moves by less than 0.05 sigma (RMS) and the sizes before moved by less than 5 %: the last
  // linearisation is of the sizes as found. `enough`, asked once: whether the first step is all that is wanted of a robust fit.
  Fit& run(const std::function<bool(Fit&)>& enough = {}) {
    lagged = Eigen::Map<const RowMatrix>(theta.data() + layout_.C, n_, 6);
    predict();
    reweigh();
    converged = stands_ = false;
    returns_.assign(active.size(), 0);
    deviance_ = std::numeric_limits<double>::quiet_NaN();
    double resized = std::numeric_limits<double>::infinity();
    for (iterations = std::exchange(begun_, false) ? 2 : 1; iterations <= constants::most_iterations;
         ++iterations) {
      compare_delays();  // a first motion, rough where knots are fine, has rates that nothing imitates
      if (iterations > 1 && !robust) find_slopes();
      const Eigen::VectorXd last = step_;
      if (!find_step()) return *this;
      advance(turned(last) ? 0.5 : 1.0);
      const auto count = static_cast<double>(active_places().size());
      const double move = std::sqrt(step_.dot(dense::times(S_, step_)) / count);
      if (robust) resized = resize();
      converged = iterations > 1 && resized < constants::move &&
                  move < (robust ? constants::robust_move : constants::move) && (robust || slopes_hold());
      if (converged) return robust ? *this : end();
      if (!robust) resized = resize();
      begun_ = iterations == 1 && enough && enough(*this);
      if (begun_) return *this;
    }
    if (robust) return *this;  // whose deviance is rarely asked for
    if (!find_step()) return *this;
    advance();
    return end();
  }

  // Whether one step was enough: nothing to mask, and no more noise than stated.
  bool sound() const { return begun_; }

  // -2 log L (10.7) where the fit has ended; nan where it failed.
  double deviance() {
    if (begun_) run();
    if (robust && !failed && std::isnan(deviance_) && linearise() && solve(true)) deviance_ = likelihood();
    return deviance_;
  }

  // Whether there is a factorisation of the fit at its end, its last step apart.
  bool stands() {
    if (!stands_) stands_ = linearise() && solve();
    return stands_;
  }

  // With the first parameters held: the motion and the other parameters where they are best; then a step of all from there.
  bool settle(const Eigen::VectorXd& first) {
    theta.head(first.size()) = first;
    predict();
    reweigh();
    const std::vector<char> all = active;
    std::fill_n(active.begin(), first.size(), char{0});
    bool solved = true;
    // twice: the wrench is quadratic in the motion, which is near where it was
    for (int round = 0; round < 2 && solved; ++round) {
      solved = linearise() && solve(true);
      if (solved) advance();
    }
    active = all;
    return solved && linearise() && solve(true);
  }

  // Gives back the memory of the factorisation; the next linearisation takes it again.
  void release() {
    stands_ = false;
    // not assign(): its elements would keep their room
    for (LogFit& l : logs_) l.sweeps = std::vector<Sweep>(l.stretches.size());
  }

  // -2 log L (10.7), with the Student-t sum in place of the rows' r^2 / sigma^2 where robust.
  double likelihood() const;

  // d log |H_xx| / d theta: what the score of (10.7) has beyond that of theta at the best x; gives the factorisation back.
  Eigen::VectorXd slope_of_determinant(const std::vector<int>& places);

  // (10.6) once, at the state after the step, traces from the factor before it; the largest relative move.
  double resize();

  // State and sizes of another fit of the same logs at the same h.
  Fit& start_from(const Fit& other) {
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      Sizes& z = logs_[l].sizes;
      const Sizes& from = other.logs_[l].sizes;
      z.q = from.q;
      z.raw_factor = from.raw_factor;
      if (other.robust && !robust) z.raw_factor.array() *= other.left_by_weights(l).rsqrt();
      z.motion_factor = from.motion_factor;
      if (z.form != Form::none && z.form == from.form) {
        z.delta = from.delta;
        z.k = from.k;
      }
      for (std::size_t i = 0; i < logs_[l].stretches.size(); ++i) {
        logs_[l].stretches[i].c = other.logs_[l].stretches[i].c;
        if (z.form != Form::none && z.form == from.form)
          logs_[l].stretches[i].e = other.logs_[l].stretches[i].e;
      }
      const Columns &to = layout_.log(l), &has = other.layout_.log(l);
      for (std::size_t i = 0; i < std::min(to.global.size(), has.global.size()); ++i) {  // steps come last
        const int here = to.global[i], there = has.global[i];
        theta[here] = other.theta[there];
        prior[here] = other.prior[there];
        slope_[here] = other.slope_[there];
        slope_at_[here] = other.slope_at_[there];
      }
    }
    return *this;
  }

  std::vector<int> active_places() const {
    std::vector<int> out;
    for (std::size_t i = 0; i < active.size(); ++i)
      if (active[i] != 0) out.push_back(static_cast<int>(i));
    return out;
  }

  static Eigen::MatrixXd gather(const Eigen::MatrixXd& m, const std::vector<int>& at) {
    Eigen::MatrixXd out(at.size(), at.size());
    for (std::size_t i = 0; i < at.size(); ++i)
      for (std::size_t j = 0; j < at.size(); ++j)
        out(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = m(at[i], at[j]);
    return out;
  }

  static Eigen::VectorXd pick(const Eigen::VectorXd& v, const std::vector<int>& at) {
    Eigen::VectorXd out(at.size());
    for (std::size_t i = 0; i < at.size(); ++i) out[static_cast<Eigen::Index>(i)] = v[at[i]];
    return out;
  }

 private:
  std::shared_ptr<const Statement> rig_;
  std::vector<LogFit> logs_;
  std::vector<std::vector<double>> steps_;
  int threads_ = 1, n_ = 6;
  Layout layout_;
  Eigen::VectorXd stated_, gradient_, step_;
  Eigen::VectorXd slope_, slope_at_;  // what x adds to kappa's gradient, and where that was found
  Eigen::MatrixXd data_, S_, P_;
  std::vector<Information> of_log_;
  std::array<Information, 4> quarters_;
  double logdet_x_ = 0.0, logdet_s_ = 0.0;
  std::vector<DelaySums> delays_;  // of each log, at the begin of an iteration
  bool imitated_ = false;
  double deviance_ = std::numeric_limits<double>::quiet_NaN();
  bool stands_ = false, begun_ = false;  // begun_: one step was enough
  std::vector<int> returns_;             // of what has been let go, in this run

  // The step of a new linearisation, at the sizes of u and of steps that belong to it.
  bool find_step() {
    if (!linearise() || !solve()) return false;
    resize_blocks();
    return solve(true);
  }

  // Where the factorisation that stands is that of the end.
  Fit& end() {
    stands_ = true;
    deviance_ = likelihood();
    return *this;
  }

  template <typename Work>
  void each_stretch(const Work& work) {
    std::vector<std::pair<std::size_t, std::size_t>> all;
    for (std::size_t l = 0; l < logs_.size(); ++l)
      for (std::size_t i = 0; i < logs_[l].stretches.size(); ++i) all.emplace_back(l, i);
    parallel_for(all.size(), threads_, [&](std::size_t k) {
      const auto [l, i] = all[k];
      work(l, logs_[l].stretches[i], logs_[l].sweeps[i]);
    });
  }

  Eigen::VectorXd pull() const { return pull(gradient_, 1.0); }

  Eigen::MatrixXd with_prior() const {
    Eigen::MatrixXd S = data_;
    for (Eigen::Index i = 0; i < S.rows(); ++i) S(i, i) += 1.0 / prior[i];
    return S;
  }

  double resize_tau(LogFit& l, const std::vector<Traces>& traces);
  void resize_blocks();
  double resize_raw(std::size_t l, const Eigen::VectorXd& trace);

  void compare_delays();
  void imitate(Eigen::Index i, Eigen::VectorXd& L, Eigen::VectorXd& bend) const;
  bool clock_prior();
  bool hold(bool& moved);
  double bend_of_determinant(std::size_t l, Eigen::VectorXd* pull);
  void find_slopes();
  bool slope_holds(int k) const;
  bool slopes_hold() const;
  bool turned(const Eigen::VectorXd& last) const;
};

}  // namespace truewrench
