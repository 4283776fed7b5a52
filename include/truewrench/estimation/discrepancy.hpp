// What the residuals of a fit show of a slow discrepancy (METHOD (10.9)).
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/estimation/moments.hpp"

#include <algorithm>
#include <functional>

namespace truewrench {

// Which samples count: of log l, stretch s, row k.
using Keep = std::function<bool(std::size_t, std::size_t, Eigen::Index)>;

inline Keep unmasked(const Fit& fit) {
  return [&fit](std::size_t l, std::size_t s, Eigen::Index k) {
    return fit.logs()[l].stretches[s].raw.masked[static_cast<std::size_t>(k)] == 0;
  };
}

// The sums of one log: of all channels together where each has every sample, else of each by itself.
class LogMoments {
 public:
  // As MomentSums.
  LogMoments(const Fit& fit, std::size_t l, const Keep& keep, const std::vector<double>& taus, bool squares)
      : n_(fit.channels()) {
    const auto& stretches = fit.logs()[l].stretches;
    const auto rows = [&](const auto& visit) {
      for (std::size_t s = 0; s < stretches.size(); ++s)
        for (Eigen::Index k = 0; k < stretches[s].raw.rows(); ++k)
          if (keep(l, s, k)) visit(stretches[s], k);
    };
    bool whole = true;
    rows([&](const Stretch& s, Eigen::Index k) { whole = whole && s.raw.channels[k] == n_; });
    sums_.assign(static_cast<std::size_t>(whole ? 1 : n_), MomentSums(whole ? n_ : 1, taus, squares));
    rows([&](const Stretch& s, Eigen::Index k) {
      for (std::size_t i = 0; i < sums_.size(); ++i) {
        const auto at = n_ * k + static_cast<Eigen::Index>(i);
        if (whole || std::isfinite(s.raw.value.data()[at]))
          sums_[i].add(s.raw.time[k], s.raw.size[k], s.now.w.data() + 6 * k, s.now.cw.data() + at,
                       s.now.residual.data() + at);
      }
    });
  }

  // The sums in which a channel is, and its place there.
  const MomentSums& of(int channel) const {
    return sums_[sums_.size() > 1 ? static_cast<std::size_t>(channel) : 0];
  }
  int place(int channel) const { return sums_.size() > 1 ? 0 : channel; }

 private:
  int n_;
  std::vector<MomentSums> sums_;
};

// All that moments() and spread() ask for, of the samples that are left in.
inline LogMoments unmasked_sums(const Fit& fit, std::size_t l) {
  return {fit, l, unmasked(fit), {std::begin(constants::taus), std::end(constants::taus)}, true};
}

// (10.9) for the groups of one log, from the residuals of a fit without d.
inline std::vector<Moment> moments(const Fit& fit, const LogMoments& log) {
  const int n = fit.channels();
  std::vector<MomentTotals> totals(static_cast<std::size_t>(raw_groups(n)));
  for (int i = 0; i < n; ++i)
    if (log.of(i).rows() >= 10.0)
      log.of(i).add_to(totals[static_cast<std::size_t>(raw_group(i, n))], log.place(i));
  std::vector<Moment> out;
  out.reserve(totals.size());
  for (const MomentTotals& one : totals) out.push_back(one.best());
  return out;
}

// Share of what the raw output of one log does, white noise apart, that the wrench does not explain: delta^2 of (10.9) over it and
// the variance of C w, in the group where it is smallest.
inline double unexplained(const Fit& fit, std::size_t l, const std::vector<Moment>& found) {
  const int n = fit.channels();
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n), squares = sum;
  double rows = 0.0;
  for (const Stretch& s : fit.logs()[l].stretches)
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
      if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
      rows += s.raw.size[k];
      for (int i = 0; i < n; ++i) {
        sum[i] += s.raw.size[k] * s.now.cw(k, i);
        squares[i] += s.raw.size[k] * s.now.cw(k, i) * s.now.cw(k, i);
      }
    }
  double least = 1.0;
  for (std::size_t r = 0; r < found.size(); ++r) {
    double variance = 0.0, channels = 0.0;
    for (int i = 0; i < n; ++i)
      if (raw_group(i, n) == static_cast<int>(r)) {
        variance += std::max(0.0, squares[i] / rows - std::pow(sum[i] / rows, 2));
        ++channels;
      }
    const double all = found[r].delta2 + variance / channels;
    least = std::min(least, all > 0.0 ? found[r].delta2 / all : 0.0);
  }
  return least;
}

// What (10.9) adds to the covariance of C (6n, 6n) where the samples that are in the logs' sums determine it:
// delta^2 (X^T X)^-1 X^T K X (X^T X)^-1, the prior's information beside X^T X.
inline Eigen::MatrixXd spread(const Fit& fit, const std::vector<std::vector<Moment>>& found,
                              const std::vector<LogMoments>& sums) {
  const int n = fit.channels();
  const Layout& layout = fit.layout();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  std::vector<int> offset_of, offsets;
  for (std::size_t l = 0; l < fit.logs().size(); ++l) offset_of.push_back(layout.in_theta(l).b);
  offsets = offset_of;
  offsets.erase(std::unique(offsets.begin(), offsets.end()), offsets.end());
  const auto m = static_cast<Eigen::Index>(offsets.size());
  for (int i = 0; i < n; ++i) {
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(7 + m, 7 + m), B = A;  // of [C_i, u_i, offsets]
    for (int k = 0; k < 6; ++k) A(k, k) = 1.0 / fit.prior[layout.C + 6 * i + k];
    A(6, 6) = 1.0 / fit.prior[layout.u + i];
    for (Eigen::Index o = 0; o < m; ++o)
      A(7 + o, 7 + o) = 1.0 / fit.prior[offsets[static_cast<std::size_t>(o)] + i];
    for (std::size_t l = 0; l < fit.logs().size(); ++l) {
      const MomentSums& of = sums[l].of(i);
      if (of.rows() == 0.0) continue;
      const Moment& moment = found[l][static_cast<std::size_t>(raw_group(i, n))];
      const auto o = static_cast<Eigen::Index>(
          7 + std::distance(offsets.begin(), std::find(offsets.begin(), offsets.end(), offset_of[l])));
      const auto to = [o](int c) { return c < 6 ? Eigen::Index{c} : (c == 6 ? o : Eigen::Index{6}); };
      const double v = std::pow(fit.sigma(l, i), -2.0);
      const int place = sums[l].place(i);
      for (int c = 0; c < 8; ++c)
        for (int e = 0; e < 8; ++e) {
          A(to(c), to(e)) += v * of.product(place, c, e);
          if (moment.delta2 > 0.0)
            B(to(c), to(e)) += v * v * moment.delta2 * of.correlated(place, moment.tau, c, e);
        }
    }
    Eigen::MatrixXd G;
    double logdet = 0.0;
    if (!dense::invert(A, G, logdet)) continue;
    const Eigen::MatrixXd GBG = dense::transposed_times(G, dense::transposed_times(B, G));
    for (int c = 0; c < 6; ++c)
      for (int d = 0; d < 6; ++d) out(6 * i + c, 6 * i + d) = GBG(c, d);
  }
  return out;
}

// The sums for it, of the samples that `keep` names.
inline std::vector<LogMoments> sums_for_spread(const Fit& fit, const std::vector<std::vector<Moment>>& found,
                                               const Keep& keep) {
  std::vector<LogMoments> sums;
  sums.reserve(found.size());
  for (std::size_t l = 0; l < found.size(); ++l) {
    std::vector<double> taus;
    for (const Moment& of : found[l])
      if (of.delta2 > 0.0 && std::find(taus.begin(), taus.end(), of.tau) == taus.end())
        taus.push_back(of.tau);
    sums.emplace_back(fit, l, keep, taus, false);
  }
  return sums;
}

}  // namespace truewrench
