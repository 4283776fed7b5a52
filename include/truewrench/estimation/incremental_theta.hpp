// Sizes by (10.6), the covariance of theta and of C, what a log leaves to the next. Included by incremental.hpp.
#pragma once

#include "truewrench/estimation/incremental.hpp"

namespace truewrench {

inline void Incremental::resize_theta() {
  const int nt = lag_.parameters();
  const auto size = static_cast<std::size_t>(nt);
  past_ = present_ = lag_.make_front();
  moving_ = lag_.make_moving();
  S_ = Z_ = Zp_ = Zb_ = Zo_ = own_ = Eigen::MatrixXd::Zero(nt + 1, nt + 1);
  P_ = covariance_ = Eigen::MatrixXd::Zero(nt, nt);
  column_ = theta0_ = theta1_ = Eigen::VectorXd::Zero(nt);
  work_.assign(size * static_cast<std::size_t>(2 * dense::padded(nt + 1)) + 8, 0.0);
  use_.reserve(size);
  active_.assign(size, 1);
}

// Information on theta of this log alone, at theta as it stands: what was known before it is another matrix at another theta.
inline const Eigen::MatrixXd& Incremental::of_log() {
  Zo_ = Z_ - Zb_;
  lag_.pull(Zo_, own_);
  return own_;
}

// (10.6) once from sums and P_, theta's share of the raw rows by what the log told; the largest relative move.
inline double Incremental::resize(const SizeSums& sums) {
  const int nt = lag_.parameters(), n = lag_.channels();
  Sizes& z = lag_.sizes;
  const Eigen::MatrixXd& S = first_log_ ? S_ : of_log();
  double move = 0.0, all = 0.0;
  std::array<double, 2> of_group{};
  for (int i = 0; i < nt; ++i) {
    double share = 0.0;
    for (int j = 0; j < nt; ++j) {
      const int a = std::max(i, j), b = std::min(i, j);
      share += P_(i, j) * S(a, b);
    }
    bool clock = false;
    for (std::size_t s = 0; s < lag_.streams(); ++s)
      clock = clock || i == lag_.columns().clock[s] || i == lag_.columns().clock[s] + 1;
    if (!clock) all += share;
    const int c = i - lag_.columns().C, b = i - lag_.columns().b;
    // of a log after others terms of one channel cancel: what they sum to is no measure of the group
    const double own = std::max(share, 0.0);
    if (c >= 0 && c < 6 * n) of_group[static_cast<std::size_t>(raw_group(c / 6, n))] += own;
    if (b >= 0 && b < n) of_group[static_cast<std::size_t>(raw_group(b, n))] += own;
  }
  const double scale = std::max(0.0, all) / std::max(of_group[0] + of_group[1], 1e-300);
  for (Eigen::Index r = 0; r < z.raw_factor.size(); ++r) {
    const auto g = static_cast<std::size_t>(r);
    if (sums.raw_count[g] > 0.0)
      move = std::max(move, resize_factor(z.raw_factor[r], sums.raw[g], sums.raw_count[g],
                                          sums.raw_trace[g] + scale * of_group[g]));
  }
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r) {
      const auto g = static_cast<std::size_t>(r);
      if (sums.motion_count[i][g] > 0.0)
        move = std::max(move, resize_factor(z.motion_factor[i][r], sums.motion[i][g], sums.motion_count[i][g],
                                            sums.motion_trace[i][g]));
    }
  for (int j = 0; j < kComponents; ++j) {
    const auto ju = static_cast<std::size_t>(j);
    const double size = sums.knots + kDegree5 - smoothness_order(lag_.about().source, j);
    move = std::max(
        move, resize_smoothness(z, lag_.about(), j, lag_.h(), sums.energy[ju], size - sums.energy_trace[ju]));
  }
  // upsilon: the same rule with R = E, exponent 1
  double squares = 0.0, freedom = 0.0;
  const int u = lag_.columns().u;
  for (int i = u; i < u + n; ++i) {
    squares += lag_.theta[i] * lag_.theta[i];
    freedom += 1.0 - P_(i, i) / prior_[i];
  }
  const double floor = constants::departure_floor * constants::departure_floor;
  for (int i = u; i < u + n; ++i) prior_[i] = std::max(squares / std::max(freedom, 0.05), floor);
  return move;
}

// One more lag for one of the two parts of (10.11): what it adds to what was known before it.
inline void Incremental::part(const Eigen::MatrixXd& S) {
  Eigen::MatrixXd& to = parts_[static_cast<std::size_t>(part_)];
  for (Eigen::Index i = 0; i < S.size(); ++i) to.data()[i] += S.data()[i] - Zl_.data()[i];
  Zl_ = S;
  part_ = 1 - part_;
}

// The rows of a block that count, to sums of w'.
inline void Incremental::add_delays(DelaySums& sums, long g) const noexcept {
  for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
    const Lag::Interval& v = lag_.interval(i);
    for (int r = 0; r < v.rows; ++r) {
      const RawRow& row = v.row[static_cast<std::size_t>(r)];
      if (row.masked)
        sums.cut();
      else
        sums.add(row.time, row.w.data());
    }
  }
}

// column_: what the gain and the offset do by the delay that they imitate, to this order.
inline void Incremental::imitate(int order) noexcept {
  column_.setZero();
  if (order == 0) column_[lag_.columns().clock[0]] = 1.0;
  for (int r = 0; r < lag_.channels(); ++r) {
    double gain[2][6], offset[2];
    delays_.imitate(lag_.theta.data() + lag_.columns().C + 6 * r, gain, offset);
    for (int j = 0; j < 6; ++j) column_[lag_.columns().C + 6 * r + j] = gain[order][j];
    column_[lag_.columns().b + r] = offset[order];
  }
}

inline const Eigen::MatrixXd& Incremental::theta_covariance() noexcept {
  const int nt = lag_.parameters();
  gather(Z_, 0, S_);
  invert();
  covariance_ = P_;
  for (int h = 0; h < nt; ++h) {
    if (active_[static_cast<std::size_t>(h)] != 0) continue;
    for (int i = 0; i < nt; ++i) {
      double sum = i == h ? 1.0 : 0.0;
      for (int j = 0; j < nt; ++j) sum -= P_(i, j) * S_(std::max(h, j), std::min(h, j));
      column_[i] = sum;
    }
    const bool delay = imitated_ && h == lag_.columns().clock[0];
    const auto add = [&](double variance) {
      const int C = lag_.columns().C;
      const double left = bounded(variance, column_.data() + C, prior_.data() + C, 6 * lag_.channels());
      for (int j = 0; j < nt; ++j)
        for (int i = 0; i < nt; ++i) covariance_(i, j) += left * column_[i] * column_[j];
      covariance_(h, h) += (variance - left) * column_[h] * column_[h];  // its own width stays
    };
    if (delay) imitate(0);
    add(prior_[h]);
    if (!delay) continue;
    imitate(1);  // and what bends: E s^4 / 4
    add(0.75 * prior_[h] * prior_[h]);
  }
  return covariance_;
}

inline const Eigen::MatrixXd& Incremental::covariance() noexcept {
  const int n = lag_.channels(), C = lag_.columns().C;
  theta_covariance();
  for (int j = 0; j < 6 * n; ++j)
    for (int i = 0; i < 6 * n; ++i) {
      gain_covariance_(i, j) = covariance_(C + i, C + j);
      added_(i, j) = 0.0;
    }
  // (10.9)
  std::array<MomentTotals, 2> totals;
  for (int i = 0; i < n; ++i) moments_.add_to(totals[static_cast<std::size_t>(raw_group(i, n))], i);
  for (std::size_t r = 0; r < found_.size(); ++r) found_[r] = totals[r].best();
  for (int i = 0; i < n; ++i) {
    Spread s = sum9_[static_cast<std::size_t>(i)];
    if (moments_.rows() > 10.0)
      moments_.spread(i, 1.0 / (lag_.noise(i) * lag_.noise(i)), prior_[lag_.columns().b + i],
                      found_[static_cast<std::size_t>(raw_group(i, n))], s.A, s.B);
    for (int k = 0; k < 7; ++k) s.A[k][k] += 1.0 / prior_[k < 6 ? C + 6 * i + k : lag_.columns().u + i];
    double G[7][7];  // its columns: A^-1
    for (int c = 0; c < 7; ++c) {
      double A[7][7], b[7] = {};
      std::copy_n(&s.A[0][0], 49, &A[0][0]);
      b[c] = 1.0;
      dense::solve(&A[0][0], b, 7);
      std::copy_n(b, 7, G[c]);
    }
    for (int k = 0; k < 6; ++k)
      for (int l = 0; l < 6; ++l) {
        double sum = 0.0;
        for (int a = 0; a < 7; ++a)
          for (int b = 0; b < 7; ++b) sum += G[k][a] * s.B[a][b] * G[l][b];
        added_(6 * i + k, 6 * i + l) = sum;
        gain_covariance_(6 * i + k, 6 * i + l) += sum;
      }
  }
  for (int i = 0; i < n; ++i) {
    const Moment& m = found_[static_cast<std::size_t>(raw_group(i, n))];
    const double f2 = std::isfinite(m.z) ? m.delta2 + m.sd : 0.0;
    discrepancy2_[i] = (log_samples_ * f2 + size10_[static_cast<std::size_t>(i)]) /
                       std::max(log_samples_ + size10_samples_, 1.0);
  }
  if (settings_.discrepancy == 0.0) return gain_covariance_;
  const double stated = std::max(settings_.discrepancy, 0.0);
  add_pose(gain_covariance_, prior_.data() + C, pose(),
           [&](int i) { return std::max(discrepancy2_[i], stated * stated); });
  return gain_covariance_;
}

// (10.11) of two parts by their information; `apart`: how much more their gains may differ.
inline Agreement Incremental::compare_parts(const std::array<Eigen::MatrixXd, 2>& parts,
                                            const Eigen::MatrixXd& apart) const {
  const int nt = lag_.parameters();
  const Eigen::VectorXd& mean = lag_.layout().mean();
  std::vector<int> use;
  for (int i = 0; i < nt; ++i)
    if (active_[static_cast<std::size_t>(i)] != 0) use.push_back(i);
  const auto k = static_cast<Eigen::Index>(use.size());
  Eigen::VectorXd prior(k);
  const auto told = [&](const Eigen::MatrixXd& part) {
    Eigen::MatrixXd S(k, k);
    Eigen::VectorXd right(k);
    for (Eigen::Index i = 0; i < k; ++i) {
      const int a = use[static_cast<std::size_t>(i)];
      prior[i] = prior_[a];
      for (Eigen::Index j = 0; j < k; ++j) {
        const int b = use[static_cast<std::size_t>(j)];
        S(i, j) = part(std::max(a, b), std::min(a, b));
      }
      right[i] = part(nt, a) + mean[a] / prior_[a];
      for (int h = 0; h < nt; ++h)
        if (active_[static_cast<std::size_t>(h)] == 0)
          right[i] -= part(std::max(a, h), std::min(a, h)) * mean[h];
    }
    return TellsOf(std::move(S), right, prior);
  };
  const TellsOf first = told(parts[0]);
  return compare(first, told(parts[1]), apart, prior);
}

inline Agreement Incremental::agreement() {
  std::array<Eigen::MatrixXd, 2> parts{S_, S_};
  for (std::size_t p = 0; p < 2; ++p) gather(parts_[p], 1 + p, parts[p]);
  return compare_parts(parts, 4.0 * added_);  // either has half of the rows
}

inline Agreement Incremental::agreement_with_logs_before() {
  const double now = log_samples_, before = size10_samples_, all = now + before;
  if (!(now > 0.0 && before > 0.0)) return {};
  Eigen::MatrixXd past = S_;
  gather(Zb_, 0, past);
  // (10.9), and twice (10.10): what follows the pose need not be the same in two logs
  const int C = lag_.columns().C;
  const Eigen::Index gains = added_.rows();
  const Eigen::MatrixXd pose = gain_covariance_ - covariance_.block(C, C, gains, gains) - added_;
  return compare_parts({past, of_log()}, (all / now + all / before) * added_ + 2.0 * pose);
}

inline bool Incremental::sound() {
  if (!ready_ || status_ != Status::ok || unresolved()) return false;
  const auto seen = static_cast<double>(samples_), masked = static_cast<double>(masked_samples_);
  if (!(masked <= constants::most_lost * seen)) return false;
  if (!(lag_.sizes.raw_factor.maxCoeff() <= constants::noise_told)) return false;
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    if (!(lag_.sizes.motion_factor[i].maxCoeff() <= constants::motion_noise_most)) return false;
  const int n = lag_.channels(), C = lag_.columns().C;
  for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i)
    if (!reads_[i] && !std::isnan(first_raw_[i])) return false;
  covariance();
  const auto variance = gain_covariance_.diagonal().array();
  const double share = constants::undetermined * constants::undetermined;
  if (!(variance < share * prior_.segment(C, 6 * n).array()).any()) return false;  // nothing was learnt
  const double agree = 0.5 * constants::doubt;  // no number agrees with nothing
  return agreement().p >= agree && agreement_with_logs_before().p >= agree;
}

// ------------------------------------------------------------------------------------------------
// logs

inline void Incremental::begin_log() {
  const Eigen::VectorXd& sigma = lag_.layout().sigma();
  stated_ = sigma;
  for (Eigen::Index i = 0; i < sigma.size(); ++i) {
    const double s = std::clamp(sigma[i], 1e-9, 1e30);
    stated_[i] = s * s;
  }
  if (first_log_) prior_ = stated_;
  active_.assign(static_cast<std::size_t>(lag_.parameters()), 1);
  left_ = SizeSums();
  first_stretch_ = true;
  chosen_ = false;
  hops_ = 0;
  moments_.clear();
  past_delays_.clear();
  told_ = told_ || (!first_log_ && !imitated_);
  imitated_ = false;
  log_samples_ = 0.0;
}

// (M13): information without the chosen parameters, what is held at its mean, the rest eliminated with its prior.
template <typename Chosen>
inline void Incremental::forget(Eigen::MatrixXd& S, const Chosen& chosen) const {
  const int nt = lag_.parameters();
  const Eigen::VectorXd& mean = lag_.layout().mean();
  for (int o = 0; o < nt; ++o) {
    if (!chosen(o)) continue;
    const auto with = [&S, o](int i) -> double& { return S(std::max(i, o), std::min(i, o)); };
    const bool held = active_[static_cast<std::size_t>(o)] == 0;
    if (!held) {
      with(o) += 1.0 / prior_[o];
      with(nt) += mean[o] / prior_[o];
    }
    for (int j = 0; j <= nt; ++j) {
      if (j == o) continue;
      if (held) {
        if (j < nt) S(nt, j) -= mean[o] * with(j);
        continue;
      }
      const double c = with(j) / with(o);
      for (int i = j; i <= nt; ++i)
        if (i != o) S(i, j) -= with(i) * c;
    }
    for (int j = 0; j <= nt; ++j) with(j) = 0.0;
  }
}

inline Status Incremental::next_root() noexcept {
  if (refused_ != Status::ok) return refused_;
  const Status status = close();
  const auto chosen = [this](int i) { return in_root(i); };
  for (Eigen::MatrixXd* of : {&Z_, &parts_[0], &parts_[1]}) forget(*of, chosen);
  for (int i = 0; i < lag_.parameters(); ++i)
    if (in_root(i)) lag_.theta[i] = lag_.layout().mean()[i];
  Zl_ = Z_;
  lag_.set_front(past_, Z_);
  gather(Z_, 0, S_);
  return status;
}

inline Status Incremental::next_log(const RecordedLog& about) {
  if (refused_ != Status::ok) return refused_;
  if (const Status refused = check(lag_.rig(), about, settings_); refused != Status::ok) return refused;
  const Status status = finish();
  const int n = lag_.channels(), before = lag_.parameters();
  const bool common = lag_.layout().tilt >= 0;
  covariance();
  for (int i = 0; i < n && moments_.rows() > 10.0; ++i) {
    const Moment& m = found_[static_cast<std::size_t>(raw_group(i, n))];
    Spread& s = sum9_[static_cast<std::size_t>(i)];
    moments_.spread(i, 1.0 / (lag_.noise(i) * lag_.noise(i)), prior_[lag_.columns().b + i], m, s.A, s.B);
    size10_[static_cast<std::size_t>(i)] += log_samples_ * (m.delta2 + m.sd);
  }
  size10_samples_ += log_samples_;
  const Eigen::VectorXd theta = lag_.theta, prior = prior_;
  const bool other = about.body != lag_.about().body;
  std::array<Eigen::MatrixXd, 3> old{Z_, parts_[0], parts_[1]};
  for (std::size_t k = 0; k < 3; ++k) {
    if (other) gather(Eigen::MatrixXd(old[k]), k, old[k]);
    forget(old[k], [this](int i) { return own(i); });
  }
  std::vector<int> from, shared;  // places of what goes on, before and now
  for (int i = 0; i < before; ++i)
    if (!own(i)) from.push_back(i);
  const RowMatrix lagged = lag_.lagged;
  lag_.carry(about);
  lag_.resize_work();
  resize_theta();
  const int nt = lag_.parameters(), tilt = lag_.layout().tilt;
  for (int i = 0; i < nt; ++i)
    if (!own(i) && (common || tilt < 0 || (i != tilt && i != tilt + 1))) shared.push_back(i);
  const auto moved = [&](const Eigen::MatrixXd& all) {
    Eigen::MatrixXd to = Eigen::MatrixXd::Zero(nt + 1, nt + 1);
    for (std::size_t j = 0; j < from.size(); ++j) {
      for (std::size_t i = j; i < from.size(); ++i) to(shared[i], shared[j]) = all(from[i], from[j]);
      to(nt, shared[j]) = all(before, from[j]);
    }
    return to;
  };
  const Eigen::MatrixXd none = Eigen::MatrixXd::Zero(nt + 1, nt + 1);
  for (std::size_t k = 0; k < 3; ++k) {
    Eigen::MatrixXd& to = k == 0 ? Z_ : parts_[k - 1];
    others_[k] = moved(other ? old[k] : others_[k]);
    to = other ? none : moved(old[k]);
  }
  Zl_ = Z_;
  lag_.set_front(past_, Z_);
  first_log_ = !ready_;
  begin_log();
  if (ready_) lag_.lagged = lagged;
  prior_ = stated_;
  for (std::size_t i = 0; i < from.size() && ready_; ++i) {
    prior_[shared[i]] = prior[from[i]];
    lag_.theta[shared[i]] = theta[from[i]];
  }
  gather(Z_, 0, S_);
  Zb_ = Z_;
  raw_ = {};
  raw_.reserve(masked_.size());
  for (auto& m : motion_) {
    m = {};
    m.reserve(masked_.size());
  }
  keep();  // in place from now on
  return status;
}

}  // namespace truewrench
