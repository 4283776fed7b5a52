// The exact traces of (10.6), by selected inversion of a sweep's factor, block by block from the last.
#pragma once

#include "truewrench/estimation/sweep.hpp"

namespace truewrench {

inline Traces Sweep::traces(const Stretch& s, const Columns& columns, const Sizes& sizes,
                            const Eigen::MatrixXd& P) const {
  Traces out;
  out.raw = Eigen::VectorXd::Zero(sizes.raw_factor.size());
  for (const auto& f : sizes.motion_factor) out.motion.push_back(Eigen::VectorXd::Zero(f.size()));
  out.q = Eigen::VectorXd::Zero(M_);
  if (d_) {
    out.inside.assign(static_cast<std::size_t>(n_), Gram::Zero());
    out.start.assign(static_cast<std::size_t>(n_), Gram::Zero());
  }
  const std::vector<double> root = dense::root(P);
  const int ntz = dense::padded(shape_.nt), ldp = 2 * shape_.Wp, ldx = 2 * shape_.Wp + ntz;
  const auto rows = static_cast<std::size_t>(shape_.W);
  Pair pair;
  for (auto* x : {&pair.here, &pair.next}) x->assign(rows * static_cast<std::size_t>(ldp) + 8, 0.0);
  for (auto* x : {&pair.A, &pair.A_next}) x->assign(rows * static_cast<std::size_t>(ntz) + 8, 0.0);
  for (auto* x : {&pair.known, &pair.theta})
    x->assign(static_cast<std::size_t>(2 * kBlock * kLocal * M_), 0.0);
  for (auto* x : {&pair.ZP, &pair.ZP_next}) x->assign(rows * static_cast<std::size_t>(nc_), 0.0);
  std::vector<double> X(rows * static_cast<std::size_t>(ldx) + 8),
      Z(rows * static_cast<std::size_t>(ntz) + 8, 0.0),
      V(2 * rows * static_cast<std::size_t>(shape_.Wp) + 8, 0.0),
      total(static_cast<std::size_t>(kPairs * M_), 0.0);
  for (int g = blocks_ - 1; g >= 0; --g) {
    const double* R = panel(g);
    const bool last = g + 1 == blocks_;
    std::swap(pair.here, pair.next);
    std::swap(pair.A, pair.A_next);
    std::swap(pair.ZP, pair.ZP_next);
    for (auto* x : {&pair.known, &pair.theta})
      std::copy_n(x->data(), kBlock * kLocal * M_, x->data() + kBlock * kLocal * M_);
    // R^-1 of what theta's sensitivity leaves, beside that of the inverse
    for (int i = 0; i < shape_.W; ++i)
      std::copy_n(R + i * shape_.ld + 2 * shape_.Wp, shape_.nt, X.data() + i * ldx + 2 * shape_.Wp);
    if (!last)
      for (int t = 0; t < shape_.W; t += dense::tile_rows) {
        const int m = std::min(dense::tile_rows, shape_.W - t);
        dense::tile_of(m, X.data() + t * ldx + 2 * shape_.Wp, ldx, R + t * shape_.ld + shape_.Wp, shape_.ld,
                       1, Z.data(), ntz, ntz, std::min(shape_.W, ((t + m - 1) / shape_.m + 1) * shape_.m));
      }
    double* here = pair.here.data();
    shape_.invert(R, last, X.data(), ldx, V.data(), here, pair.next.data());
    for (int i = 0; i < shape_.W; ++i)
      std::copy_n(X.data() + i * ldx + 2 * shape_.Wp, ntz, Z.data() + i * ntz);
    for (int c = 0; c < shape_.nt; c += 8)
      dense::subtract(pair.A.data() + c, ntz, Z.data() + c, ntz, 1, root.data() + c * ntz + c, ntz, shape_.W,
                      8, shape_.nt - c, dense::Mode::fresh);
    for (int i = 0; i < shape_.W; ++i)
      for (int x = 0; x < nc_; ++x)
        pair.ZP[static_cast<std::size_t>(i * nc_ + x)] = dense::dot(
            pair.A.data() + i * ntz, root.data() + clock_columns_[static_cast<std::size_t>(x)] * ntz, ntz);
    for (int k = 0; k < kBlock; ++k)
      for (int l = k; l < k + kLocal && (l < kBlock || !last); ++l)
        for (int j = 0; j < M_; ++j) {
          const int i = k * shape_.m + j, h = (l < kBlock ? l : l - kBlock) * shape_.m + j,
                    to = (k * kLocal + l - k) * M_ + j;
          const double* A = (l < kBlock ? pair.A : pair.A_next).data() + h * ntz;
          pair.known[static_cast<std::size_t>(to)] = here[i * ldp + (l < kBlock ? 0 : shape_.Wp) + h];
          pair.theta[static_cast<std::size_t>(to)] = dense::dot(pair.A.data() + i * ntz, A, ntz);
        }
    if (last) continue;
    for (int o = 0; o < kBlock; ++o) {
      const Eigen::Index interval = kBlock * g + o;
      trace_interval(s, interval, o, pair, total, out);
      const auto [first, end] = of_interval(interval);
      for (std::size_t at = first; at < end; ++at) {
        if (M_ == 6)
          sums().trace<6>(pool_[at], shape_, here, pair.next.data(), o, out.raw.data());
        else
          sums().trace<0>(pool_[at], shape_, here, pair.next.data(), o, out.raw.data());
      }
      if (d_) trace_discrepancy(interval, o, pair, out);
    }
    // - 2 <H_xt, Z P> of the motion rows, by group
    const double* CF = clock_F_.data() + g * 2 * kBlock * M_ * nc_;
    int first = 0;
    for (std::size_t i = 0; i < s.motion.size(); ++i) {
      const int count = 2 + (columns.bias[i] >= 0 ? M_ : 0);
      for (int k = 0; k < 2 * kBlock; ++k)
        for (int j = 0; j < M_; ++j) {
          const double* ZP = (k < kBlock ? pair.ZP.data() + (k * shape_.m + j) * nc_
                                         : pair.ZP_next.data() + ((k - kBlock) * shape_.m + j) * nc_);
          double share = 0.0;  // A is - Z by the root
          for (int x = first; x < first + count; ++x) share += 2.0 * CF[(k * M_ + j) * nc_ + x] * ZP[x];
          out.motion[i][s.log().motion[i].group[j]] += share;
          out.motion_share += share;
        }
      first += count;
    }
  }
  for (int k = 0; k < kLocal; ++k)
    for (int l = k; l < kLocal; ++l)
      for (int j = 0; j < M_; ++j)
        out.q[j] += (k == l ? 1.0 : 2.0) * sizes.q[j] *
                    smoothness_[static_cast<std::size_t>((kLocal * l + k) * M_ + j)] *
                    total[static_cast<std::size_t>(knot_pair(k, l) * M_ + j)];
  for (std::size_t i = 0; i < s.motion.size(); ++i)
    for (Eigen::Index r = 0; r < out.motion[i].size(); ++r) {
      const Eigen::MatrixXd& own = clock_tt_[i][static_cast<std::size_t>(r)];
      double share = 0.0;
      for (int x = 0; x < nc_; ++x)
        for (int y = 0; y < nc_; ++y)
          share += own(x, y) * P(clock_columns_[static_cast<std::size_t>(x)],
                                 clock_columns_[static_cast<std::size_t>(y)]);
      out.motion[i][r] += share;
      out.motion_share += share;
    }
  return out;
}

// <J^T V^-1 J, Sigma> of the motion rows of an interval, theta's share beside; `total`: covariances summed, for R_p.
inline void Sweep::trace_interval(const Stretch& s, Eigen::Index interval, int o, const Pair& pair,
                                  std::vector<double>& total, Traces& out) const {
  double sum[max_components], share[max_components];
  for (std::size_t i = 0; i <= s.motion.size(); ++i) {
    std::fill_n(sum, M_, 0.0);
    std::fill_n(share, M_, 0.0);
    const double* m = i < s.motion.size() ? motion_sums_[i].data() + interval * kPairs * M_ : nullptr;
    for (int k = 0; k < kLocal; ++k)
      for (int l = k; l < kLocal; ++l) {
        const double* known = pair.known.data() + ((o + k) * kLocal + l - k) * M_;
        const double* theta = pair.theta.data() + ((o + k) * kLocal + l - k) * M_;
        const int at = knot_pair(k, l) * M_;
        const double twice = k == l ? 1.0 : 2.0;
        if (m)
          for (int j = 0; j < M_; ++j) {
            sum[j] += twice * m[at + j] * known[j];
            share[j] += twice * m[at + j] * theta[j];
          }
        else
          for (int j = 0; j < M_; ++j) total[static_cast<std::size_t>(at + j)] += known[j];
      }
    if (!m) break;
    for (int j = 0; j < M_; ++j) {
      const double v = motion_information_[i][static_cast<std::size_t>(j)];
      out.motion[i][s.log().motion[i].group[j]] += v * (sum[j] + share[j]);
      out.motion_share += v * share[j];
    }
  }
}

// What the discrepancy adds in the sensor's rows, and its own covariance under an interval.
inline void Sweep::trace_discrepancy(Eigen::Index interval, int o, const Pair& pair, Traces& out) const {
  const int ldp = 2 * shape_.Wp, ntz = dense::padded(shape_.nt), OM = sums().orders * M_;
  const auto cov = [&](int a, int b) { return shape_.covariance(pair.here.data(), pair.next.data(), a, b); };
  const auto A = [&](int k, int at) {
    return k < kBlock ? pair.A.data() + (k * shape_.m + at) * ntz
                      : pair.A_next.data() + ((k - kBlock) * shape_.m + at) * ntz;
  };
  const auto [first, end] = of_interval(interval);
  for (int i = 0; i < n_; ++i) {
    const int d = M_ + i;
    for (std::size_t at = first; at < end; ++at) {
      const RawSums& sums = pool_[at];
      double value = 0.0;
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l) {
          const int a = o + k, b = o + l;
          const double* own = cov(std::min(a, b), std::max(a, b));
          for (int p = 0; p < this->sums().orders; ++p) {
            const double m = 2.0 * sums.m[order_pair[0][p]](k, l);
            const double* J = sums.J.data() + i * OM + p * M_;
            double sum = 0.0;  // of d at knot k and the motion at knot l
            for (int j = 0; j < M_; ++j) sum += J[j] * (a <= b ? own[d * ldp + j] : own[j * ldp + d]);
            value += m * sum;
          }
          value += sums.m[0](k, l) * own[d * ldp + d];
        }
      out.raw[raw_group(i, n_)] += sums.v[static_cast<std::size_t>(i)] * value;
    }
    Gram local;
    for (int k = 0; k < kLocal; ++k)
      for (int l = k; l < kLocal; ++l)
        local(k, l) = local(l, k) =
            cov(o + k, o + l)[d * ldp + d] + dense::dot(A(o + k, d), A(o + l, d), ntz);
    out.inside[static_cast<std::size_t>(i)] += local;
    if (interval == 0) out.start[static_cast<std::size_t>(i)] = local;
  }
}

}  // namespace truewrench
