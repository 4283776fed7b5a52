// theta and its covariance from the information as it stands; the rules of (10.1); sizes by (10.6); what a log leaves to the
// next. Included by incremental.hpp.
#pragma once

#include "truewrench/estimation/incremental.hpp"

#include <Eigen/Dense>

namespace truewrench {

// P_ = (S + Pi^-1)^-1 over the active parameters, or over all.
inline bool Incremental::invert(const Eigen::MatrixXd& S, bool all) {
  use_.clear();
  for (std::size_t i = 0; i < active_.size(); ++i)
    if (all || active_[i] != 0) use_.push_back(static_cast<int>(i));
  const auto k = static_cast<Eigen::Index>(use_.size());
  for (Eigen::Index j = 0; j < k; ++j)
    for (Eigen::Index i = j; i < k; ++i)
      M_(i, j) = S(use_[static_cast<std::size_t>(i)], use_[static_cast<std::size_t>(j)]);
  for (Eigen::Index j = 0; j < k; ++j) M_(j, j) += 1.0 / prior_[use_[static_cast<std::size_t>(j)]];
  auto M = M_.topLeftCorner(k, k);
  if (Eigen::internal::llt_inplace<double, Eigen::Lower>::blocked(M) >= 0) return false;
  logdet_s_ = 2.0 * M.diagonal().array().log().sum();
  P_.setZero();
  auto P = covariance_.topLeftCorner(k, k);
  P.setIdentity();
  M.triangularView<Eigen::Lower>().solveInPlace(P);
  M.transpose().triangularView<Eigen::Upper>().solveInPlace(P);
  for (Eigen::Index j = 0; j < k; ++j)
    for (Eigen::Index i = 0; i < k; ++i)
      P_(use_[static_cast<std::size_t>(i)], use_[static_cast<std::size_t>(j)]) = P(i, j);
  return true;
}

// theta by S and its information vector; `judge`: the rules for s, kappa and gamma first.
inline bool Incremental::solve(const Eigen::MatrixXd& S, bool judge) {
  const int nt = lag_.parameters();
  const Eigen::VectorXd& mean = lag_.layout().mean();
  const auto eta = S.row(nt).head(nt).transpose();
  if (judge) {
    // s ~ N(s_0, stated^2 + v), v = max(0, (s_hat - s_0)^2 - V - stated^2)                                        (10.1)
    if (!invert(S, true)) return false;
    column_ = eta + mean.cwiseQuotient(prior_);
    solved_.noalias() = P_ * column_;
    for (std::size_t i = 0; i < lag_.streams(); ++i) {
      const int at = lag_.clock_at(i);
      const double V = 1.0 / std::max(1.0 / P_(at, at) - 1.0 / prior_[at], 1e-12);
      const double apart = (solved_[at] - mean[at]) * V / P_(at, at);
      prior_[at] = stated_[at] + std::max(0.0, apart * apart - V - stated_[at]);
    }
    // kappa and gamma are held unless the data's own variance is below 1/16
    if (!invert(S, true)) return false;
    std::fill(active_.begin(), active_.end(), char{1});
    const auto hold = [&](int at) {
      if (at < 0 || std::max(1.0 / P_(at, at) - 1.0 / prior_[at], 0.0) > constants::filter_information)
        return;
      active_[static_cast<std::size_t>(at)] = 0;
    };
    for (std::size_t i = 0; i < lag_.streams(); ++i) hold(lag_.clock_at(i) + 1);
    hold(lag_.gamma_at());
  }
  use_.clear();
  for (std::size_t i = 0; i < active_.size(); ++i)
    if (active_[i] != 0) use_.push_back(static_cast<int>(i));
  const auto k = static_cast<Eigen::Index>(use_.size());
  for (Eigen::Index j = 0; j < k; ++j) {
    const int at = use_[static_cast<std::size_t>(j)];
    for (Eigen::Index i = j; i < k; ++i) M_(i, j) = S(use_[static_cast<std::size_t>(i)], at);
    M_(j, j) += 1.0 / prior_[at];
    double right = eta[at] + mean[at] / prior_[at];
    for (std::size_t h = 0; h < active_.size(); ++h) {
      if (active_[h] != 0) continue;
      const int held = static_cast<int>(h);
      right -= S(std::max(at, held), std::min(at, held)) * mean[held];
    }
    solved_[j] = right;
  }
  auto M = M_.topLeftCorner(k, k);
  if (Eigen::internal::llt_inplace<double, Eigen::Lower>::blocked(M) >= 0) return false;
  logdet_s_ = 2.0 * M.diagonal().array().log().sum();
  auto x = solved_.head(k);
  M.triangularView<Eigen::Lower>().solveInPlace(x);
  M.transpose().triangularView<Eigen::Upper>().solveInPlace(x);
  if (!x.allFinite()) return false;
  lag_.theta = mean;
  for (Eigen::Index j = 0; j < k; ++j) lag_.theta[use_[static_cast<std::size_t>(j)]] = x[j];
  return true;
}

// P_ of the active parameters, and M_ = S + Pi^-1 over all places (lower triangle; what is held is left out).
inline void Incremental::settle(const Eigen::MatrixXd& S) {
  invert(S, false);
  M_ = S.topLeftCorner(lag_.parameters(), lag_.parameters());
  for (Eigen::Index i = 0; i < M_.rows(); ++i) M_(i, i) += 1.0 / prior_[i];
}

// (10.6) once from sums and P_, theta's share of the raw rows by S; the largest relative move.
inline double Incremental::resize(const SizeSums& sums, const Eigen::MatrixXd& S) {
  const int nt = lag_.parameters(), n = lag_.channels();
  Sizes& z = lag_.sizes;
  double move = 0.0;
  Eigen::Array2d of_group = Eigen::Array2d::Zero();
  double all = 0.0;
  for (int i = 0; i < nt; ++i) {
    double share = 0.0;
    for (int j = 0; j < nt; ++j)
      share += P_(i, j) * (S(std::max(i, j), std::min(i, j)) - base_(std::max(i, j), std::min(i, j)));
    bool clock = false;
    for (std::size_t s = 0; s < lag_.streams(); ++s)
      clock = clock || i == lag_.clock_at(s) || i == lag_.clock_at(s) + 1;
    if (!clock) all += share;
    if (i >= lag_.gain_at() && i < lag_.gain_at() + 6 * n)
      of_group[raw_group((i - lag_.gain_at()) / 6, n)] += share;
    if (i >= lag_.offset_at() && i < lag_.offset_at() + n)
      of_group[raw_group(i - lag_.offset_at(), n)] += share;
  }
  of_group *= std::max(0.0, all) / std::max(of_group.sum(), 1e-300);
  const auto factor = [&move](double& f, double rss, double rows, double used) {
    const double to = std::sqrt(std::max(rss, 1e-300) / std::max(rows - used, 1e-3 * std::max(rows, 1.0)));
    const double ratio = std::clamp(to / f, 0.2, 5.0);
    f *= ratio;
    move = std::max(move, std::abs(std::log(ratio)));
  };
  for (Eigen::Index r = 0; r < z.raw_factor.size(); ++r)
    if (sums.raw_count[r] > 0.0)
      factor(z.raw_factor[r], sums.raw[r], sums.raw_count[r], sums.raw_trace[r] + of_group[r]);
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r)
      if (sums.motion_count[i][r] > 0.0)
        factor(z.motion_factor[i][r], sums.motion[i][r], sums.motion_count[i][r], sums.motion_trace[i][r]);
  for (int j = 0; j < kComponents; ++j) {
    const double size = sums.knots + kDegree5 - smoothness_order(lag_.about().source, j);
    const double to = std::max(sums.energy[j], 1e-16) / std::max(size - sums.energy_trace[j], 1.0);
    const double ratio = std::clamp(to / z.q[j], 1e-3, 1e3);
    z.q[j] *= ratio;
    move = std::max(move, 0.5 * std::abs(std::log(ratio)));
  }
  // upsilon: the same rule with R = E, exponent 1
  double squares = 0.0, freedom = 0.0;
  const int u = lag_.quadratic_at();
  for (int i = u; i < u + n; ++i) {
    squares += lag_.theta[i] * lag_.theta[i];
    freedom += 1.0 - P_(i, i) / prior_[i];
  }
  prior_.segment(u, n).setConstant(
      std::max(squares / std::max(freedom, 0.05), constants::quadratic_floor * constants::quadratic_floor));
  return move;
}

// One more lag for one of the two parts of (10.11): what it adds to what was known before it.
inline void Incremental::part(const Eigen::MatrixXd& S) {
  parts_[static_cast<std::size_t>(part_)] += S - Sl_;
  Sl_ = S;
  part_ = 1 - part_;
}

inline const Eigen::MatrixXd& Incremental::theta_covariance() noexcept {
  invert(S_, false);
  covariance_ = P_;
  for (Eigen::Index i = 0; i < P_.rows(); ++i) {
    if (active_[static_cast<std::size_t>(i)] != 0) continue;
    for (Eigen::Index j = 0; j < P_.rows(); ++j) solved_[j] = S_(std::max(i, j), std::min(i, j));
    column_.noalias() = -P_ * solved_;
    column_[i] = 1.0;
    for (Eigen::Index j = 0; j < P_.rows(); ++j) covariance_.col(j) += (prior_[i] * column_[j]) * column_;
  }
  return covariance_;
}

inline const Eigen::MatrixXd& Incremental::covariance() noexcept {
  const int n = lag_.channels();
  gain_covariance_ = theta_covariance().block(lag_.gain_at(), lag_.gain_at(), 6 * n, 6 * n);
  // (10.9)
  added_.setZero();
  for (int r = 0; r < raw_groups(n); ++r) found_[static_cast<std::size_t>(r)] = moments_.found(r);
  for (int i = 0; i < n; ++i) {
    const Moment& m = found_[static_cast<std::size_t>(raw_group(i, n))];
    Eigen::Matrix<double, 7, 7> A = sum9_[static_cast<std::size_t>(i)][0],
                                B = sum9_[static_cast<std::size_t>(i)][1], A1, B1;
    if (moments_.rows() > 10.0) {
      moments_.spread(i, 1.0 / (lag_.noise(i) * lag_.noise(i)), prior_[lag_.offset_at() + i], m, A1, B1);
      A += A1;
      B += B1;
    }
    for (int k = 0; k < 6; ++k) A(k, k) += 1.0 / prior_[lag_.gain_at() + 6 * i + k];
    A(6, 6) += 1.0 / prior_[lag_.quadratic_at() + i];
    const Eigen::Matrix<double, 7, 7> G = A.llt().solve(Eigen::Matrix<double, 7, 7>::Identity());
    const Eigen::Matrix<double, 7, 7> GB = G * B;
    added_.block<6, 6>(6 * i, 6 * i) = (GB * G).topLeftCorner<6, 6>();
  }
  gain_covariance_ += added_;
  // (10.10)
  for (int i = 0; i < n; ++i) {
    const Moment& m = found_[static_cast<std::size_t>(raw_group(i, n))];
    const double now = std::max(log_samples_, 1.0), f2 = std::isfinite(m.z) ? m.delta2 + m.sd : 0.0;
    discrepancy2_[i] = (now * f2 + size10_[i]) / (now + size10_samples_);
  }
  if (settings_.discrepancy == 0.0) return gain_covariance_;
  const PoseShare share = pose_.share();
  Matrix6 ww = share.ww;
  ww.diagonal().array() += 1e-12 * std::max(ww.trace(), 1e-12);
  const Matrix6 hidden = std::min(share.A, 1.0 - 1e-9) / std::max(1.0 - share.A, 1e-9) / 6.0 * ww.inverse();
  for (int i = 0; i < n; ++i) {
    const double stated = std::max(settings_.discrepancy, 0.0),
                 f2 = std::max(discrepancy2_[i], stated * stated);
    Vector6 g;
    for (int k = 0; k < 6; ++k) {
      const double room = prior_[lag_.gain_at() + 6 * i + k] - gain_covariance_(6 * i + k, 6 * i + k);
      g[k] = std::sqrt(std::clamp(room / std::max(f2 * hidden(k, k), 1e-300), 0.0, 1.0));
    }
    gain_covariance_.block<6, 6>(6 * i, 6 * i) += f2 * g.asDiagonal() * hidden * g.asDiagonal();
  }
  return gain_covariance_;
}

// Delta^T V^-1 Delta, V = P_a + P_b - P_a Pi^-1 P_b - P_b Pi^-1 P_a                                                 (10.11)
inline Agreement Incremental::agreement() const {
  Agreement out;
  const int n = lag_.channels(), nt = lag_.parameters();
  std::vector<int> use;
  for (std::size_t i = 0; i < active_.size(); ++i)
    if (active_[i] != 0) use.push_back(static_cast<int>(i));
  const auto k = static_cast<Eigen::Index>(use.size());
  std::array<Eigen::MatrixXd, 2> P;
  std::array<Eigen::VectorXd, 2> theta;
  const Eigen::VectorXd& mean = lag_.layout().mean();
  Eigen::VectorXd prior(k);
  for (Eigen::Index i = 0; i < k; ++i) prior[i] = prior_[use[static_cast<std::size_t>(i)]];
  for (std::size_t p = 0; p < 2; ++p) {
    Eigen::MatrixXd S(k, k);
    Eigen::VectorXd right(k);
    for (Eigen::Index i = 0; i < k; ++i) {
      const int a = use[static_cast<std::size_t>(i)];
      for (Eigen::Index j = 0; j < k; ++j) {
        const int b = use[static_cast<std::size_t>(j)];
        S(i, j) = parts_[p](std::max(a, b), std::min(a, b));
      }
      right[i] = parts_[p](nt, a) + mean[a] / prior[i];
      for (int h = 0; h < nt; ++h)
        if (active_[static_cast<std::size_t>(h)] == 0)
          right[i] -= parts_[p](std::max(a, h), std::min(a, h)) * mean[h];
    }
    S.diagonal() += prior.cwiseInverse();
    const Eigen::LDLT<Eigen::MatrixXd> solver(S);
    P[p] = solver.solve(Eigen::MatrixXd::Identity(k, k));
    theta[p] = solver.solve(right);
  }
  const Eigen::MatrixXd both = P[0] * prior.cwiseInverse().asDiagonal() * P[1];
  // either part has half of the rows that (10.9) had
  const Eigen::MatrixXd V =
      (P[0] + P[1] - both - both.transpose()).topLeftCorner(6 * n, 6 * n) + 4.0 * added_;
  const Eigen::VectorXd scale = prior.head(6 * n).cwiseSqrt();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scale.cwiseInverse().asDiagonal() * V *
                                                             scale.cwiseInverse().asDiagonal());
  const Eigen::VectorXd projected =
      eigen.eigenvectors().transpose() * (theta[0] - theta[1]).head(6 * n).cwiseQuotient(scale);
  for (int i = 0; i < 6 * n; ++i) {
    if (eigen.eigenvalues()[i] <= 1e-9) continue;
    out.chi2 += projected[i] * projected[i] / eigen.eigenvalues()[i];
    ++out.freedom;
  }
  out.p = out.freedom > 0 ? std::exp(chi_square_log_tail(out.chi2, out.freedom)) : 1.0;
  return out;
}

// ------------------------------------------------------------------------------------------------ logs

inline void Incremental::begin_log() {
  const int n = lag_.channels();
  stated_ = lag_.layout().sigma().cwiseMax(1e-9).cwiseMin(1e30).cwiseAbs2();
  if (first_log_) {
    prior_ = stated_;
    size10_ = discrepancy2_ = Eigen::VectorXd::Zero(n);
  }
  active_.assign(static_cast<std::size_t>(lag_.parameters()), 1);
  left_ = SizeSums();
  first_stretch_ = true;
  chosen_ = false;
  moments_.clear();
  log_samples_ = 0.0;
}

// The information without a log's own parameters: what is held at its mean, the rest eliminated with its prior.
inline Eigen::MatrixXd Incremental::without_own(const Eigen::MatrixXd& S) const {
  const int nt = lag_.parameters(), n = lag_.channels();
  const int from = lag_.offset_at() + (lag_.rig().pool_offsets ? n : 0);
  const Eigen::VectorXd& mean = lag_.layout().mean();
  Eigen::MatrixXd full = S;
  full.triangularView<Eigen::StrictlyUpper>() = S.transpose();
  for (int i = from; i < nt; ++i) {
    if (active_[static_cast<std::size_t>(i)] != 0) {
      full(i, i) += 1.0 / prior_[i];
      full(nt, i) += mean[i] / prior_[i];
      full(i, nt) = full(nt, i);
      const Eigen::VectorXd c = full.col(i) / full(i, i);
      full -= c * full.row(i).eval();
    } else {
      full.row(nt) -= mean[i] * full.row(i).eval();
      full.col(nt) -= mean[i] * full.col(i).eval();
    }
    full.row(i).setZero();
    full.col(i).setZero();
  }
  return full;
}

inline Status Incremental::next_log(const RecordedLog& about) {
  const Status status = close();
  const int n = lag_.channels();
  covariance();
  const int shared = lag_.offset_at() + (lag_.rig().pool_offsets ? n : 0);
  for (int i = 0; i < n; ++i) {
    const Moment& m = found_[static_cast<std::size_t>(raw_group(i, n))];
    if (moments_.rows() <= 10.0) continue;
    Eigen::Matrix<double, 7, 7> A, B;
    moments_.spread(i, 1.0 / (lag_.noise(i) * lag_.noise(i)), prior_[lag_.offset_at() + i], m, A, B);
    sum9_[static_cast<std::size_t>(i)][0] += A;
    sum9_[static_cast<std::size_t>(i)][1] += B;
    size10_[i] += log_samples_ * (m.delta2 + m.sd);
  }
  size10_samples_ += log_samples_;
  const Eigen::VectorXd theta = lag_.theta, prior = prior_;
  std::array<Eigen::MatrixXd, 2> parts{without_own(parts_[0]), without_own(parts_[1])};
  const Eigen::MatrixXd S = without_own(S_);
  const int before = lag_.parameters();
  lag_.carry(about);
  const int nt = lag_.parameters();
  const auto moved = [&](const Eigen::MatrixXd& from) {
    Eigen::MatrixXd to = Eigen::MatrixXd::Zero(nt + 1, nt + 1);
    to.topLeftCorner(shared, shared) = from.topLeftCorner(shared, shared);
    to.row(nt).head(shared) = from.row(before).head(shared);
    return to;
  };
  S_ = Sl_ = Sp_ = base_ = moved(S);
  parts_ = {moved(parts[0]), moved(parts[1])};
  lag_.resize_work();
  past_ = present_ = lag_.make_front();
  past_.T = S_;
  eta_ = solved_ = column_ = theta0_ = theta1_ = Eigen::VectorXd::Zero(nt);
  P_ = M_ = covariance_ = Eigen::MatrixXd::Zero(nt, nt);
  use_.reserve(static_cast<std::size_t>(nt));
  prior_ = lag_.layout().sigma().cwiseMax(1e-9).cwiseMin(1e30).cwiseAbs2();
  prior_.head(shared) = prior.head(shared);
  lag_.theta.head(shared) = theta.head(shared);
  first_log_ = false;
  begin_log();
  raw_ = {};
  raw_.reserve(masked_.size());
  for (auto& m : motion_) {
    m = {};
    m.reserve(masked_.size());
  }
  return status;
}

}  // namespace truewrench
