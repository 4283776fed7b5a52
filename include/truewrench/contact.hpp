// Samples that do not belong to the model: contacts, knocks, spikes (docs/method.md, "Contacts and outliers").
//
// The residuals of one stream over their sigma are scanned at many lengths for stretches whose mean, or whose
// size, is not that of noise. The limit follows the number of stretches looked at, so that clean records lose
// next to nothing.
#pragma once

#include "truewrench/statistics.hpp"

#include <Eigen/Core>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

namespace truewrench {

// Samples [first, last) of a series, and how far they are from noise (standard normal deviate).
struct Disturbance {
  std::size_t first = 0;
  std::size_t last = 0;
  double deviate = 0.0;
};

// What a constant shift of a stretch's samples would explain: by all components together and by the one that shows it
// most, in squares that are chi-square where there is none.
struct ShiftTest {
  int components = 0;
  double sum_of_squares = 0.0;
  double largest = 0.0;

  void add(double square) {
    ++components;
    sum_of_squares += square;
    largest = std::max(largest, square);
  }
  // `density`: what noise makes of every square.
  double deviate(double density = 1.0) const {
    if (components == 0) return 0.0;
    return std::max(chi_square_deviate(sum_of_squares / density, components), std::sqrt(largest / density));
  }
};

// Both ends moved to where `deviate(first, last)` of a series of so many samples is largest.
template <typename Deviate>
Disturbance trimmed(Disturbance d, std::size_t samples, const Deviate& deviate) {
  for (std::size_t step = std::max<std::size_t>(1, (d.last - d.first) / 2); step > 0; step /= 2) {
    for (bool better = true; better;) {
      better = false;
      const auto attempt = [&](std::size_t first, std::size_t last) {
        if (first >= last || last > samples) return;
        const double z = deviate(first, last);
        if (z <= d.deviate) return;
        d = {first, last, z};
        better = true;
      };
      const Disturbance from = d;
      if (from.first >= step) attempt(from.first - step, from.last);
      attempt(from.first + step, from.last);
      attempt(from.first, from.last + step);
      if (from.last >= step) attempt(from.first, from.last - step);
    }
  }
  return d;
}

// Running sums over the residuals of one series: row k holds those of the samples before k.
class DisturbanceScan {
 public:
  // `residuals`: one row per sample over its sigma, NaN where there is none.
  explicit DisturbanceScan(
      const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>& residuals)
      : components_(residuals.cols()), sums_(residuals.rows() + 1, 2 * residuals.cols() + 1) {
    const Eigen::Index n = components_;
    sums_.row(0).setZero();
    for (Eigen::Index k = 0; k < residuals.rows(); ++k) {
      sums_.row(k + 1) = sums_.row(k);
      for (Eigen::Index c = 0; c < n; ++c) {
        const double r = residuals(k, c);
        if (!std::isfinite(r)) continue;
        sums_(k + 1, c) += r;
        sums_(k + 1, n + c) += 1.0;
        sums_(k + 1, 2 * n) += r * r;
      }
    }
  }

  std::size_t samples() const { return static_cast<std::size_t>(sums_.rows()) - 1; }

  // Deviate of samples [first, last): of the means, the larger of that of all components together and that of each
  // alone; or of the sum of squares.
  double deviate(std::size_t first, std::size_t last, bool of_means) const {
    const Sums s = sums(first, last);
    if (of_means) return s.means.deviate();
    return s.count > 0.0 ? chi_square_deviate(s.squares, s.count) : 0.0;
  }

  // Stretches beyond what chance gives, the strongest first. The motion bends towards a disturbance and throws the
  // shadow of it around, with the other sign: means tell them apart, sums of squares do not and are asked only
  // where the means say nothing; and what is much weaker than the strongest is left to the next look.
  std::vector<Disturbance> find(std::size_t longest, double false_alarms) const {
    std::vector<Disturbance> found = find(longest, false_alarms, true);
    return found.empty() ? find(longest, false_alarms, false) : found;
  }

 private:
  struct Sums {
    ShiftTest means;  // squared, over their variance
    double squares = 0.0;
    double count = 0.0;
  };

  Sums sums(std::size_t first, std::size_t last) const {
    const Eigen::Index n = components_;
    const double* a = sums_.data() + static_cast<Eigen::Index>(first) * sums_.cols();
    const double* b = sums_.data() + static_cast<Eigen::Index>(last) * sums_.cols();
    Sums s;
    for (Eigen::Index c = 0; c < n; ++c) {
      const double k = b[n + c] - a[n + c];
      if (k < 0.5) continue;
      s.means.add((b[c] - a[c]) * (b[c] - a[c]) / k);
      s.count += k;
    }
    s.squares = b[2 * n] - a[2 * n];
    return s;
  }

  std::vector<Disturbance> find(std::size_t longest, double false_alarms, bool of_means) const {
    const std::size_t n = samples();
    if (n == 0) return {};
    // Stretches of one length overlap and lengths grow in powers of two: so many are independent.
    const double looks = 2.0 * static_cast<double>(n) * static_cast<double>(2 * components_ + 2);
    const double limit = normal_quantile(false_alarms / looks);
    std::vector<double> limits{0.0};  // of the squared means of so many components
    for (int c = 1; c <= components_; ++c) limits.push_back(chi_square_at(limit, c));
    const auto beyond = [&](const Sums& s) {
      if (s.means.components == 0) return false;
      if (!of_means) return s.squares > chi_square_at(limit, s.count);
      return s.means.sum_of_squares > limits[static_cast<std::size_t>(s.means.components)] ||
             s.means.largest > limit * limit;
    };
    std::vector<Disturbance> found;
    for (std::size_t length = 1; length <= std::max<std::size_t>(longest, 1); length *= 2) {
      const std::size_t step = std::max<std::size_t>(1, length / 8);
      for (std::size_t k = 0; k + length <= n; k += step) {
        if (beyond(sums(k, k + length))) found.push_back({k, k + length, deviate(k, k + length, of_means)});
      }
    }
    std::sort(found.begin(), found.end(), [](const Disturbance& a, const Disturbance& b) {
      return a.deviate > b.deviate || (a.deviate == b.deviate && a.first < b.first);
    });
    std::vector<Disturbance> kept;
    for (const Disturbance& d : found) {
      if (!kept.empty() && d.deviate < 0.5 * kept.front().deviate) break;
      const bool overlaps = std::any_of(kept.begin(), kept.end(), [&](const Disturbance& k) {
        return d.first < k.last + 1 && k.first < d.last + 1;
      });
      if (overlaps) continue;
      kept.push_back(
          trimmed(d, n, [&](std::size_t first, std::size_t last) { return deviate(first, last, of_means); }));
    }
    return kept;
  }

  Eigen::Index components_;
  // Columns: r of every component, samples of every component, r^2 of all.
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> sums_;
};

}  // namespace truewrench
