// Of a fit: s, kappa and gamma of its logs. What the gain imitates, what is held, and what the motion adds to kappa's score (10.1).
#pragma once

#include "truewrench/estimation/information.hpp"
#include "truewrench/estimation/likelihood.hpp"

#include <utility>
#include <vector>

namespace truewrench {

// Sums over the unmasked samples of each log, at the motion as it stands.
inline void Fit::compare_delays() {
  delays_.assign(logs_.size(), DelaySums());
  for (std::size_t l = 0; l < logs_.size(); ++l)
    for (const Stretch& s : logs_[l].stretches) {
      delays_[l].cut();
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k)
        if (s.raw.masked[static_cast<std::size_t>(k)] == 0)
          delays_[l].add(s.raw.time[k], s.now.w.data() + 6 * k);
        else
          delays_[l].cut();
    }
  imitated_ = !delays_.empty();
  for (std::size_t l = 0; l < logs_.size();
       ++l)  // one that tells its delay tells the gain, and the others' delays
    imitated_ = imitated_ &&
                delays_[l].imitated(theta.data() + layout_.C, n_, [this, l](int i) { return sigma(l, i); });
}

// Less d theta / ds, and d^2 theta / ds^2, of the gain and the offset that imitate the s of a log, where i is one.
inline void Fit::imitate(Eigen::Index i, Eigen::VectorXd& L, Eigen::VectorXd& bend) const {
  if (!imitated_) return;
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    const Columns& c = layout_.in_theta(l);
    if (c.clock.empty() || c.clock[0] != i) continue;
    L.setZero();
    bend = Eigen::VectorXd::Zero(L.size());
    for (int r = 0; r < n_; ++r) {
      double gain[2][6], offset[2];
      delays_[l].imitate(theta.data() + layout_.C + 6 * r, gain, offset);
      for (int j = 0; j < 6; ++j) {
        L[layout_.C + 6 * r + j] = -gain[0][j];
        bend[layout_.C + 6 * r + j] = gain[1][j];
      }
      L[c.b + r] = -offset[0];
      bend[c.b + r] = offset[1];
    }
  }
}

inline bool Fit::clock_prior() {
  Eigen::MatrixXd P;
  double logdet = 0.0;
  if (!dense::invert(with_prior(), P, logdet)) return false;
  const Eigen::VectorXd step = dense::times(P, pull());
  for (std::size_t l = 0; l < logs_.size(); ++l)
    for (const int i : layout_.in_theta(l).clock) {
      prior[i] =
          clock_variance(stated_[i], prior[i], P(i, i), theta[i] + step[i] - layout_.mean()[i], imitated_);
    }
  return true;
}

// kappa and gamma are held at their means unless the data's own variance is below 1/16 (10.1), and the first s of a log where
// the gain imitates it: the others are told by the motion that they share. What is told at its mean and, there twice, not where
// it leads, stays at its mean: 2 of 240 clean records went to and fro without end. `moved`: whether that changed theta.
inline bool Fit::hold(bool& moved) {
  Eigen::MatrixXd P;
  double logdet = 0.0;
  if (!dense::invert(with_prior(), P, logdet)) return false;
  const std::vector<char> before = std::exchange(active, std::vector<char>(active.size(), 1));
  const auto rest = [&](int i) {
    active[static_cast<std::size_t>(i)] = 0;
    moved = moved || theta[i] != layout_.mean()[i];
    theta[i] = layout_.mean()[i];
  };
  constexpr int most = 2;  // returns: tolerance; a first motion is rough
  const auto judge = [&](int i) {
    const double own = std::max(1.0 / P(i, i) - 1.0 / prior[i], 0.0);
    int& returns = returns_[static_cast<std::size_t>(i)];
    if (returns < most && own > told(constants::filter_prior)) return;
    if (iterations > 1 && before[static_cast<std::size_t>(i)] != 0) ++returns;
    rest(i);
  };
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    const Columns& c = layout_.in_theta(l);
    if (imitated_ && !c.clock.empty()) rest(c.clock[0]);
    for (const int at : c.clock) judge(at + 1);
    if (c.gamma >= 0) judge(c.gamma);
  }
  return true;
}

// Whether a kappa goes back: noise gives it up to twice the curvature that Gauss-Newton knows.
inline bool Fit::turned(const Eigen::VectorXd& last) const {
  for (Eigen::Index i = 0; i < last.size(); ++i)
    if (slope_[i] != 0.0 && last[i] * step_[i] < 0.0 && std::abs(step_[i]) > 0.5 * std::sqrt(P_(i, i)))
      return true;
  return false;
}

// Of a log at theta as it stands: the second difference by c, at 1, of log |H_xx| with c R_p / q in it; and where asked
// J_theta^T V^-1 J_x H_xx^-1 R_p x / q, how the smoothness of x pulls at theta.
inline double Fit::bend_of_determinant(std::size_t l, Eigen::VectorXd* pull) {
  LogFit& log = logs_[l];
  const Columns& columns = layout_.log(l);
  const Eigen::VectorXd at = local(l);
  const double e = constants::move;
  std::vector<double> bend(log.stretches.size());
  std::vector<Eigen::VectorXd> pulls(log.stretches.size());
  parallel_for(bend.size(), threads_, [&](std::size_t i) {
    Stretch& s = log.stretches[i];
    Sweep& sweep = log.sweeps[i];
    s.predict(columns, at, lagged, log.sizes.form != Form::none);
    Sizes sizes = log.sizes;
    // raw rows know of the clocks by gravity alone (10.5): without it those of the last call, which asked for `pull`
    auto extent = pull || columns.gamma >= 0 ? Sweep::Extent::determinant : Sweep::Extent::determinant_again;
    for (const double c : {1.0 - e, 1.0 + e, 1.0}) {
      sizes.q = log.sizes.q / c;
      const bool whole = pull && c == 1.0;
      const Information found =
          sweep.forward(s, columns, at, lagged, sizes, whole ? Sweep::Extent::whole : extent);
      extent = Sweep::Extent::determinant_again;
      bend[i] += (c == 1.0 ? -2.0 : 1.0) * found.logdet / (e * e);
      pulls[i] = found.g;
    }
    if (!pull) return;
    const RowMatrix kept = s.c;
    s.c.setZero();  // a motion that pays nothing, at the same prediction
    pulls[i] -= sweep.forward(s, columns, at, lagged, log.sizes).g;
    s.c = kept;
  });
  double sum = 0.0;
  if (pull) pull->setZero(at.size());
  for (std::size_t i = 0; i < bend.size(); ++i) {
    sum += bend[i];
    if (pull) *pull += pulls[i];
  }
  return sum;
}

// What x adds to the score of kappa beyond what theta at the true x would have: x and theta together bend the motion to where
// noise is followed best and smoothness costs least. With lambda a mode's information over its prior's and y^2 = 1 + signal its
// square, the terms of (10.7) in x and theta fall by y^2 lambda' / (1 + lambda)^2. Of that the pull of smoothness (`pull`) takes
// y^2 lambda' lambda / (1 + lambda)^3, and noise the rest, lambda' / (1 + lambda)^3 = d^3 log |H_xx| / dc^2 dkappa / 2; found
// where kappa no longer travels, and held as a slope until it has moved.                                                (10.4)
inline void Fit::find_slopes() {
  bool any = false;
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    const Columns& columns = layout_.log(l);
    Eigen::VectorXd pull;
    double here = 0.0;
    for (const int clock : columns.clock) {
      const int k = columns.global[static_cast<std::size_t>(clock + 1)];
      if (active[static_cast<std::size_t>(k)] == 0) {
        slope_[k] = 0.0;
        slope_at_[k] = std::numeric_limits<double>::infinity();
      }
      if (slope_holds(k) || std::abs(step_[k]) > std::sqrt(P_(k, k))) continue;
      if (pull.size() == 0) here = bend_of_determinant(l, &pull);
      const double at = theta[k];
      theta[k] = at + constants::move;
      const double noise = 0.5 * (bend_of_determinant(l, nullptr) - here) / constants::move;
      theta[k] = slope_at_[k] = at;
      slope_[k] = 2.0 * pull[clock + 1] + noise;
      any = true;
    }
  }
  if (any) predict();
}

// Whether the slope of a kappa is that of near where it stands (over 7 sigma it changed by 0.8 sigma), or too small to count.
inline bool Fit::slope_holds(int k) const {
  if (active[static_cast<std::size_t>(k)] == 0) return true;
  const double sigma_k = std::sqrt(P_(k, k)), moved = std::abs(theta[k] - slope_at_[k]);
  return std::isfinite(moved) && (moved < sigma_k || 0.5 * std::abs(slope_[k]) * sigma_k < constants::move);
}

inline bool Fit::slopes_hold() const {
  for (std::size_t l = 0; l < logs_.size(); ++l)
    for (const int clock : layout_.in_theta(l).clock)
      if (!slope_holds(clock + 1)) return false;
  return true;
}

}  // namespace truewrench
