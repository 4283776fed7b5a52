// theta from the information as it stands, by the rules of (10.1). Included by incremental.hpp.
#pragma once

#include "truewrench/estimation/incremental.hpp"

namespace truewrench {

// S + Pi^-1 of the active parameters, or of all, into work_, at a stride that leaves room for so many columns after it, all 0.
inline int Incremental::lay_out(bool all, int columns) {
  const int nt = lag_.parameters();
  use_.clear();
  for (int i = 0; i < nt; ++i)
    if (all || active_[static_cast<std::size_t>(i)] != 0) use_.push_back(i);
  const int k = static_cast<int>(use_.size()), ld = dense::padded(k) + dense::padded(columns);
  std::fill_n(work_.begin(), k * ld, 0.0);
  for (int i = 0; i < k; ++i) {
    const int a = use_[static_cast<std::size_t>(i)];
    double* row = work_.data() + i * ld;
    for (int j = i; j < k; ++j) row[j] = S_(use_[static_cast<std::size_t>(j)], a);
    row[i] += 1.0 / prior_[a];
  }
  logdet_s_ = 0.0;
  return ld;
}

// P_ = (S + Pi^-1)^-1 over the active parameters.
inline bool Incremental::invert() {
  const int nt = lag_.parameters(), ld = lay_out(false, nt), k = static_cast<int>(use_.size()),
            half = dense::padded(k);
  for (int i = 0; i < k; ++i) work_[static_cast<std::size_t>(i * ld + half + i)] = 1.0;
  if (!dense::factor(work_.data(), ld, k, logdet_s_)) return false;
  dense::solve_upper(work_.data(), ld, k, work_.data() + half, ld, ld - half);
  std::fill_n(P_.data(), nt * nt, 0.0);
  for (int i = 0; i < k; ++i)
    for (int j = i; j < k; ++j) {
      const int a = use_[static_cast<std::size_t>(i)], b = use_[static_cast<std::size_t>(j)];
      P_(a, b) = P_(b, a) = work_[static_cast<std::size_t>(i * ld + half + j)];
    }
  return true;
}

// Of clocks, kappa and gamma, with all parameters free: variance and departure from the mean.
inline bool Incremental::look(std::span<const int> places, std::array<Loose, kMostLoose>& out) {
  const int nt = lag_.parameters(), columns = 1 + static_cast<int>(places.size()),
            ld = lay_out(true, columns), half = dense::padded(nt);
  const Eigen::VectorXd& mean = lag_.layout().mean();
  for (int i = 0; i < nt; ++i)
    work_[static_cast<std::size_t>(i * ld + half)] = S_(nt, i) + mean[i] / prior_[i];
  for (std::size_t c = 0; c < places.size(); ++c)
    work_[static_cast<std::size_t>(places[c] * ld + half + 1) + c] = 1.0;
  if (!dense::factor(work_.data(), ld, nt, logdet_s_)) return false;
  for (std::size_t c = 0; c < places.size(); ++c) {
    out[c] = {0.0, -mean[places[c]]};
    for (int i = 0; i < nt; ++i) {  // R^-T of the vector, and of a unit
      const double *row = work_.data() + i * ld + half, of = row[1 + c];
      out[c].variance += of * of;
      out[c].departure += of * row[0];
    }
  }
  return true;
}

// Information on theta of the coordinates' and of the logs with another body: all, or one part.
inline void Incremental::gather(const Eigen::MatrixXd& Z, std::size_t of, Eigen::MatrixXd& S) {
  lag_.pull(Z, S);
  for (Eigen::Index i = 0; i < S.size(); ++i) S.data()[i] += others_[of].data()[i];
}

// The rules for s, kappa and gamma (10.1), by the information S_.
inline bool Incremental::hold_rules() {
  const int streams = static_cast<int>(lag_.streams()), gamma = lag_.columns().gamma;
  std::array<int, kMostLoose> places{};  // clocks, kappas, gamma
  std::array<Loose, kMostLoose> at;
  for (int i = 0; i < streams; ++i) {
    places[static_cast<std::size_t>(i)] = lag_.columns().clock[static_cast<std::size_t>(i)];
    places[static_cast<std::size_t>(streams + i)] = lag_.columns().clock[static_cast<std::size_t>(i)] + 1;
  }
  if (gamma >= 0) places[static_cast<std::size_t>(2 * streams)] = gamma;
  const std::span<const int> all(places.data(), static_cast<std::size_t>(2 * streams + (gamma >= 0 ? 1 : 0)));
  if (!look(all, at)) return false;
  bool changed = false;
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    double& prior = prior_[places[i]];
    const double before = prior;
    prior = clock_variance(stated_[places[i]], before, at[i].variance, at[i].departure, imitated_);
    changed = changed || prior != before;
  }
  // kappa and gamma are held unless the data's own variance is below 1/16
  if (changed && !look(all, at)) return false;
  std::fill(active_.begin(), active_.end(), char{1});
  for (std::size_t i = lag_.streams(); i < all.size(); ++i) {
    const double prior = prior_[all[i]], own = std::max(1.0 / at[i].variance - 1.0 / prior, 0.0);
    // what noise of the motion adds to the score of kappa (Fit::find_slopes) is not known here: a kappa that no delay (1/2)
    // and no pole (1) has, 3 sigma of its prior away, is told by that, and the gain would follow
    const bool far = i < 2 * lag_.streams() && at[i].departure * at[i].departure > 9.0 * prior;
    if (own <= told(constants::filter_prior) || far) active_[static_cast<std::size_t>(all[i])] = 0;
  }
  if (imitated_) active_[static_cast<std::size_t>(places[0])] = 0;  // of the log's first stream
  return true;
}

// theta by the information Z_ and the prior: the rules for s, kappa and gamma,
// and Gauss-Newton on the coordinates.
inline bool Incremental::solve() {
  const int nt = lag_.parameters();
  const Eigen::VectorXd& mean = lag_.layout().mean();
  // a log that told the gain tells the delays of those after it
  delays_ = past_delays_;
  for (long g = lag_.first(); g < lag_.end(); ++g) add_delays(delays_, g);
  imitated_ = !told_ && lag_.streams() > 0 &&
              delays_.imitated(lag_.theta.data() + lag_.columns().C, lag_.channels(),
                               [this](int i) { return lag_.noise(i); });
  for (int round = 0; round < 2; ++round) {
    gather(Z_, 0, S_);
    if (!hold_rules()) return false;
    const int ld = lay_out(false, 1), k = static_cast<int>(use_.size()), half = dense::padded(k);
    for (int i = 0; i < k; ++i) {  // the information vector with the prior's, what is held at its mean
      const int a = use_[static_cast<std::size_t>(i)];
      double& to = work_[static_cast<std::size_t>(i * ld + half)];
      to = S_(nt, a) + mean[a] / prior_[a];
      for (int h = 0; h < nt; ++h)
        if (active_[static_cast<std::size_t>(h)] == 0) to -= S_(std::max(a, h), std::min(a, h)) * mean[h];
    }
    if (!dense::factor(work_.data(), ld, k, logdet_s_)) return false;
    dense::solve_upper(work_.data(), ld, k, work_.data() + half, ld, 8);
    for (int i = 0; i < k; ++i)
      if (!std::isfinite(work_[static_cast<std::size_t>(i * ld + half)])) return false;
    lag_.theta = mean;
    for (int i = 0; i < k; ++i)
      lag_.theta[use_[static_cast<std::size_t>(i)]] = work_[static_cast<std::size_t>(i * ld + half)];
  }
  return true;
}

}  // namespace truewrench
