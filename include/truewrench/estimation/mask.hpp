// MASK of METHOD 10.3. Stamps that scatter move all channels of a sample together, along C dw/dt: that is no contact.
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <algorithm>
#include <limits>
#include <vector>

namespace truewrench {

// chi^2(t) of the samples of one log where their times scatter by tau: r^T (diag sigma^2 + tau^2 g g^T)^-1 r, g = C_0 dw/dt.
class Scattered {
 public:
  Scattered(const Fit& fit, std::size_t l) : n_(fit.channels()) {
    for (int i = 0; i < n_; ++i) sigma_.push_back(fit.sigma(l, i));
    // p = g^T D^-1 r / G, G = g^T D^-1 g, has variance tau^2 + 1 / G: by the median of p^2, of the half with the larger G
    struct Row {
      double G, p2;
    };
    std::vector<Row> rows;
    for (const Stretch& s : fit.logs()[l].stretches) {
      rates_.push_back(rates(fit, s));
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
        const auto [G, a] = along(s, rates_.back(), k);
        if (G > 0.0) rows.push_back({s.raw.size[k] * G, a * a / (G * G)});
      }
    }
    if (rows.size() < 20) return;
    std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.G > b.G; });
    std::vector<double> found;
    found.reserve(rows.size() / 2);
    for (std::size_t k = 0; k < rows.size() / 2; ++k) found.push_back(rows[k].p2 / kMedian - 1.0 / rows[k].G);
    const auto middle = found.begin() + static_cast<std::ptrdiff_t>(found.size() / 2);
    std::nth_element(found.begin(), middle, found.end());
    tau2_ = std::max(0.0, *middle);
  }

  double chi2(const Stretch& s, std::size_t stretch, Eigen::Index k) const {
    const RowMatrix& rate = rates_[stretch];
    double sum = 0.0;
    for (int i = 0; i < n_; ++i) {
      const double r = s.now.residual(k, i), v = sigma_[static_cast<std::size_t>(i)], g = rate(k, i);
      sum += r * r / (v * v) + s.raw.spread(k, i) / (v * v + tau2_ * g * g);
    }
    const auto [G, a] = along(s, rate, k);
    return sum - tau2_ * a * a / (1.0 + tau2_ * G);
  }

 private:
  static constexpr double kMedian = 0.4549364;  // of chi^2 with one degree of freedom
  int n_;
  double tau2_ = 0.0;
  std::vector<double> sigma_;
  std::vector<RowMatrix> rates_;  // of each stretch: C_0 dw/dt (K, n)

  // 0 at the ends.
  static RowMatrix rates(const Fit& fit, const Stretch& s) {
    const Eigen::Index rows = s.raw.rows();
    RowMatrix out = RowMatrix::Zero(rows, fit.channels());
    for (Eigen::Index k = 1; k + 1 < rows; ++k) {
      const double before = s.raw.time[k] - s.raw.time[k - 1], after = s.raw.time[k + 1] - s.raw.time[k];
      for (int i = 0; i < fit.channels(); ++i) {
        const double to = s.now.cw(k + 1, i) - s.now.cw(k, i), from = s.now.cw(k, i) - s.now.cw(k - 1, i);
        out(k, i) = middle_rate(before, after, from, to);
      }
    }
    return out;
  }

  // G and g^T D^-1 r of the channels that are there.
  std::pair<double, double> along(const Stretch& s, const RowMatrix& rate, Eigen::Index k) const {
    double G = 0.0, a = 0.0;
    for (int i = 0; i < n_; ++i) {
      if (!std::isfinite(s.raw.value(k, i))) continue;
      const double v = sigma_[static_cast<std::size_t>(i)], g = rate(k, i);
      G += g * g / (v * v);
      a += g * s.now.residual(k, i) / (v * v);
    }
    return {G, a};
  }
};

inline void clear_mask(LogFit& log) {
  for (Stretch& s : log.stretches) std::fill(s.raw.masked.begin(), s.raw.masked.end(), char{0});
}

// MASK: w_t < 0.3, less what scattered stamps explain; gaps of up to 30 ms closed; what then lasts 30 ms or more widened by
// 20 ms each side.
inline void set_mask(Fit& fit) {
  for (std::size_t l = 0; l < fit.logs().size(); ++l) {
    LogFit& log = fit.logs()[l];
    const Scattered scattered(fit, l);
    for (std::size_t at = 0; at < log.stretches.size(); ++at) {
      Stretch& s = log.stretches[at];
      const Eigen::Index n = s.raw.rows();
      std::vector<char> low(static_cast<std::size_t>(n), 0);
      for (Eigen::Index k = 0; k < n; ++k)
        low[static_cast<std::size_t>(k)] =
            robust_weight(s.raw.channels[k], scattered.chi2(s, at, k)) < constants::mask_weight;
      Eigen::Index last = -1;
      for (Eigen::Index k = 0; k < n; ++k) {
        if (low[static_cast<std::size_t>(k)] == 0) continue;
        if (last >= 0 && s.raw.time[k] - s.raw.time[last] - log.period <= constants::mask_shortest + 1e-9)
          std::fill(low.begin() + last, low.begin() + k, char{1});
        last = k;
      }
      std::vector<char> out = low;
      for (Eigen::Index a = 0; a < n;) {
        if (low[static_cast<std::size_t>(a)] == 0) {
          ++a;
          continue;
        }
        Eigen::Index b = a;
        while (b < n && low[static_cast<std::size_t>(b)] != 0) ++b;
        if (s.raw.time[b - 1] - s.raw.time[a] + log.period >= constants::mask_shortest - 1e-9)
          for (Eigen::Index k = 0; k < n; ++k)
            if (s.raw.time[k] >= s.raw.time[a] - constants::gather_window - 1e-9 &&
                s.raw.time[k] <= s.raw.time[b - 1] + constants::gather_window + 1e-9)
              out[static_cast<std::size_t>(k)] = 1;
        a = b;
      }
      s.raw.masked = std::move(out);
    }
  }
}

inline Fit with_mask(Fit fit) {
  set_mask(fit);
  return fit;
}

// Whether two fits of the same logs at the same h leave out the same samples.
inline bool same_mask(const Fit& a, const Fit& b) {
  for (std::size_t l = 0; l < a.logs().size(); ++l)
    for (std::size_t i = 0; i < a.logs()[l].stretches.size(); ++i)
      if (a.logs()[l].stretches[i].raw.masked != b.logs()[l].stretches[i].raw.masked) return false;
  return true;
}

// How much the masked samples of a log, left in, would add to the variance of the noise.
inline double masked_variance(const Fit& fit, std::size_t l) {
  double added = 0.0, all = 0.0;
  for (const Stretch& s : fit.logs()[l].stretches)
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
      all += s.raw.size[k];
      if (s.raw.masked[static_cast<std::size_t>(k)] != 0 && s.raw.channels[k] > 0)
        added += s.raw.size[k] * fit.chi2(l, s, k) / s.raw.channels[k];
    }
  return added / std::max(all, 1.0);
}

// Masks taken away again where with_masked would end there: they add a tenth at most of what it takes. Of clean samples the mask
// hides 0.0003, for which records were fitted twice. Whether any log keeps one.
inline bool leave_in(Fit& fit) {
  bool kept = false;
  for (std::size_t l = 0; l < fit.logs().size(); ++l)
    if (masked_variance(fit, l) <= 0.1 * (constants::mask_worth - 1.0))
      clear_mask(fit.logs()[l]);
    else
      kept = true;
  return kept;
}

// Share of a log's samples, or of those from a time on, that are masked.
inline double masked_share(const Fit& fit, std::size_t l,
                           double from = -std::numeric_limits<double>::infinity()) {
  double masked = 0.0, all = 0.0;
  for (const Stretch& s : fit.logs()[l].stretches)
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
      if (s.raw.time[k] < from) continue;
      all += s.raw.size[k];
      masked += s.raw.masked[static_cast<std::size_t>(k)] != 0 ? s.raw.size[k] : 0.0;
    }
  return masked / std::max(all, 1.0);
}

// Whether a log ends masked, for as long as a contact lasts at least.
inline bool end_masked(const Fit& fit, std::size_t l) {
  const LogFit& log = fit.logs()[l];
  const Stretch& s = log.stretches.back();
  const Eigen::Index last = s.raw.rows() - 1;
  Eigen::Index k = last;
  while (k >= 0 && s.raw.masked[static_cast<std::size_t>(k)] != 0) --k;
  return k < last && s.raw.time[last] - s.raw.time[k + 1] + log.period >= constants::mask_shortest - 1e-9;
}

}  // namespace truewrench
