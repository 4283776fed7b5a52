// The streams of one log as the estimators read them: each at its own times, missing values as NaN.
#pragma once

#include "truewrench/payload.hpp"
#include "truewrench/reference.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace truewrench {

// Measurements of a derivative of the motion coordinates, NaN where there is none. The coordinates are a logged twist
// (order 0 the twist, order 1 its component-wise derivative), or the displacement from a reference motion (order 0 the
// displacement, order 1 its derivative).
struct MotionSeries {
  int order = 0;
  std::span<const double> time;   // [s]
  const double* value = nullptr;  // rows of six
  Vector6 sigma = Vector6::Ones();
  // What was measured is `combination` times the derivative, with a covariance and with a part of the derivative of the
  // order below, which change from sample to sample; identity, diag(sigma^2) and zero unless given.
  std::optional<Matrix6> combination = std::nullopt;
  const double* covariance = nullptr;  // rows of 6 x 6
  const double* coupling = nullptr;    // rows of 6 x 6, in `combination` of it

  bool direct() const { return !combination && covariance == nullptr && coupling == nullptr; }

  // L^-1 of a covariance L L^T: what makes noise white.
  static Matrix6 whitening(const Matrix6& covariance) {
    const Eigen::LLT<Matrix6> factor(covariance);
    return factor.matrixL().solve(Matrix6::Identity());
  }
  Matrix6 covariance_at(std::size_t k) const { return Eigen::Map<const Matrix6>(covariance + 36 * k); }
  Matrix6 coupling_at(std::size_t k) const {
    return Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(coupling + 36 * k);
  }
};

struct WrenchSeries {
  std::span<const double> time;         // [s]
  const double* raw = nullptr;          // rows of n, NaN where there is no sample
  const double* temperature = nullptr;  // departure from the reference [K], or none
};

// Gravity in sensor axes on the clock of the motion; without samples the constant holds.
struct GravitySeries {
  std::span<const double> time;   // [s]
  const double* value = nullptr;  // rows of three
  Vector3 constant = Vector3::Zero();

  // Cubic interpolation through the four samples around t; exact at a sample.
  Vector3 at(double t) const {
    if (time.empty()) return constant;
    const auto n = time.size();
    const auto row = [&](std::size_t k) { return Eigen::Map<const Vector3>(value + 3 * k); };
    const auto after = static_cast<std::size_t>(std::lower_bound(time.begin(), time.end(), t) - time.begin());
    if (after < n && time[after] == t) return row(after);
    if (n < 4) return row(std::min(after, n - 1));
    const std::size_t first = std::min(after < 2 ? 0 : after - 2, n - 4);
    Vector3 sum = Vector3::Zero();
    for (std::size_t i = first; i < first + 4; ++i) {
      double weight = 1.0;
      for (std::size_t j = first; j < first + 4; ++j) {
        if (j != i) weight *= (t - time[j]) / (time[i] - time[j]);
      }
      sum += weight * row(i);
    }
    return sum;
  }
};

// One recording of one payload.
struct LogData {
  Payload payload;  // as stated
  Vector3 point =
      Vector3::Zero();  // the point whose twist is logged, fixed to the sensor, seen from its centre [m]
  std::vector<MotionSeries> motion;
  WrenchSeries wrench;
  GravitySeries gravity;  // of the reference motion, where there is one
  std::optional<ReferenceMotion> reference;
};

// A stretch of one log: sample ranges [first, last) per series.
struct WindowRange {
  double begin = 0.0;
  double end = 0.0;
  std::vector<std::pair<std::size_t, std::size_t>> motion;
  std::pair<std::size_t, std::size_t> wrench{0, 0};

  // This window and the one that follows it.
  WindowRange joined(const WindowRange& next) const {
    WindowRange both = *this;
    both.end = next.end;
    both.wrench.second = next.wrench.second;
    for (std::size_t m = 0; m < motion.size(); ++m) both.motion[m].second = next.motion[m].second;
    return both;
  }
};

// Samples of one log that are left out: a contact, a spike. Windows that share no sample may write at once.
struct Gate {
  std::vector<char> wrench;
  std::vector<std::vector<char>> motion;

  explicit Gate(const LogData& log) : wrench(log.wrench.time.size(), 0) {
    for (const MotionSeries& s : log.motion) motion.emplace_back(s.time.size(), 0);
  }

  // Samples [first, last) of one of the series.
  static void leave_out(std::vector<char>& series, std::size_t first, std::size_t last) {
    std::fill(series.data() + first, series.data() + last, 1);
  }
  static void take(std::vector<char>& series, std::size_t first, std::size_t last) {
    std::fill(series.data() + first, series.data() + last, 0);
  }

  // What is left out of a window, to be put back by `restore`.
  std::vector<std::vector<char>> of(const WindowRange& window) const {
    std::vector<std::vector<char>> out{part(wrench, window.wrench)};
    for (std::size_t m = 0; m < motion.size(); ++m) out.push_back(part(motion[m], window.motion[m]));
    return out;
  }
  void restore(const WindowRange& window, const std::vector<std::vector<char>>& saved) {
    std::copy(saved[0].begin(), saved[0].end(), wrench.data() + window.wrench.first);
    for (std::size_t m = 0; m < motion.size(); ++m) {
      std::copy(saved[m + 1].begin(), saved[m + 1].end(), motion[m].data() + window.motion[m].first);
    }
  }

 private:
  static std::vector<char> part(const std::vector<char>& series,
                                const std::pair<std::size_t, std::size_t>& samples) {
    return {series.data() + samples.first, series.data() + samples.second};
  }
};

inline double median_period(std::span<const double> time) {
  if (time.size() < 2) return 0.0;
  std::vector<double> d(time.size() - 1);
  for (std::size_t i = 0; i + 1 < time.size(); ++i) d[i] = time[i + 1] - time[i];
  const auto middle = d.begin() + static_cast<std::ptrdiff_t>(d.size() / 2);
  std::nth_element(d.begin(), middle, d.end());
  return *middle;
}

// The longer of the streams' median periods.
inline double slowest_period(const LogData& log) {
  double longest = median_period(log.wrench.time);
  for (const MotionSeries& s : log.motion) longest = std::max(longest, median_period(s.time));
  return longest;
}

// Stretches that every stream covers without a gap of more than `gap_periods` of its own periods.
inline std::vector<std::pair<double, double>> unbroken_stretches(const LogData& log, double gap_periods) {
  using Stretches = std::vector<std::pair<double, double>>;
  const auto covered = [&](std::span<const double> t) {
    Stretches out;
    if (t.empty()) return out;
    const double limit = gap_periods * median_period(t);
    double begin = t.front();
    for (std::size_t i = 0; i + 1 < t.size(); ++i) {
      if (t[i + 1] - t[i] <= limit) continue;
      out.emplace_back(begin, t[i]);
      begin = t[i + 1];
    }
    out.emplace_back(begin, t.back());
    return out;
  };
  Stretches common = covered(log.wrench.time);
  for (const MotionSeries& s : log.motion) {
    Stretches next;
    for (const auto& a : common) {
      for (const auto& b : covered(s.time)) {
        const double begin = std::max(a.first, b.first);
        const double end = std::min(a.second, b.second);
        if (end > begin) next.emplace_back(begin, end);
      }
    }
    common = std::move(next);
  }
  return common;
}

// Samples of [begin, end) on the clock of the motion, or up to and including the end of a stretch. The sensor's
// stamps are `delay` behind it, known to `margin`: samples that may lie outside are left out.
inline WindowRange range_of(const LogData& log, double begin, double end, bool closed, double delay = 0.0,
                            double margin = 0.0) {
  const auto within = [&](std::span<const double> t, double from, double to) {
    const auto first = std::lower_bound(t.begin(), t.end(), from);
    const auto last = closed ? std::upper_bound(first, t.end(), to) : std::lower_bound(first, t.end(), to);
    return std::pair(static_cast<std::size_t>(first - t.begin()), static_cast<std::size_t>(last - t.begin()));
  };
  WindowRange w;
  w.begin = begin;
  w.end = end;
  w.wrench = within(log.wrench.time, begin - delay + margin, end - delay - margin);
  for (const MotionSeries& s : log.motion) w.motion.push_back(within(s.time, begin, end));
  return w;
}

}  // namespace truewrench
