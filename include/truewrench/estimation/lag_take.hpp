// Samples to the rows of an interval: as they are, or at the Gauss nodes of
// their own sampling (METHOD 9). Included by lag.hpp.
#pragma once

#include "truewrench/estimation/lag.hpp"

namespace truewrench {

template <typename Masked>
void Lag::take(long at, const Ring<RawSample>& samples, long from, long to, const Masked& masked) {
  Interval& v = interval(at);
  v.rows = 0;
  v.spared = 0.0;
  v.remainder.fill(0.0);
  v.begin = origin_ + h_ * static_cast<double>(at);
  v.end = v.begin + h_;
  const auto n = static_cast<std::size_t>(n_);
  const unsigned whole = (1U << n) - 1U;
  const auto cells = [&](const RawSample& s) {
    unsigned out = 0;
    for (std::size_t c = 0; c < n; ++c) out |= std::isfinite(s.value[c]) ? 1U << c : 0U;
    return out;
  };
  const auto finish = [&](RawRow& row) {
    const double u = (row.time - v.begin) / h_;
    Basis b[2];
    spline_.bases(u, 0, 2, b);
    for (std::size_t p = 0; p < 2; ++p) std::copy_n(b[p].data(), kLocal, row.basis.begin() + kLocal * p);
    row.masked = false;
    row.weight = 1.0;
    row.channels = 0;
    for (int c = 0; c < n_; ++c) {
      row.channels += row.has(c) ? 1 : 0;
      if (!row.has(c)) row.value[static_cast<std::size_t>(c)] = 0.0;
    }
  };
  if (to - from <= kMostRows) {
    for (long k = from; k < to; ++k) {
      RawRow& row = v.row[static_cast<std::size_t>(v.rows++)];
      const RawSample& s = samples[k];
      row.time = s.time;
      row.size = 1.0;
      row.temperature = s.temperature;
      row.R = s.R;
      row.value = s.value;
      row.cells = cells(s);
      finish(row);
    }
    return;
  }
  int count = 0;
  for (long k = from; k < to && count < window_.nodes.capacity(); ++k)
    if (cells(samples[k]) == whole) window_.picked[static_cast<std::size_t>(count++)] = k;
  if (count < kMostRows) return;
  count = window_.fit(
      count, n_, kMostRows + 1, masked_chi2(n_), [&](long k) { return samples[k].time - v.begin; },
      [&](long k, int c) { return samples[k].value[static_cast<std::size_t>(c)]; },
      [&](int c) { return noise(c); }, [&](long k) { masked(samples[k].time, samples[k].time); });
  std::copy_n(window_.remainder.begin(), n, v.remainder.begin());
  const auto sample = [&](int k) -> const RawSample& {
    return samples[window_.picked[static_cast<std::size_t>(k)]];
  };
  v.rows = kNodes;
  v.spared = count - kNodes;
  int k = 0;
  for (std::size_t m = 0; m < kNodes; ++m) {
    RawRow& row = v.row[m];
    row.time = v.begin + window_.nodes.time[m];
    row.size = window_.nodes.weight[m];
    while (k + 2 < count && sample(k + 1).time < row.time) ++k;
    const RawSample &before = sample(k), &after = sample(k + 1);
    const double share = std::clamp((row.time - before.time) / (after.time - before.time), 0.0, 1.0);
    for (int x = 0; x < 9; ++x)
      row.R.data()[x] = (1.0 - share) * before.R.data()[x] + share * after.R.data()[x];
    row.temperature = before.temperature;
    row.cells = whole;
    for (std::size_t c = 0; c < n; ++c) row.value[c] = window_.value[c][m];
    finish(row);
  }
}

inline void Lag::take(std::size_t stream, const Ring<MotionSample>& samples, long from, long to) {
  Ring<MotionRow>& out = motion_[stream];
  int count = 0;
  const auto whole = [](const MotionSample& s) {
    for (const double x : s.value)
      if (!std::isfinite(x)) return false;
    return true;
  };
  if (to - from > kMostRows)
    for (long k = from; k < to && count < window_.nodes.capacity(); ++k)
      if (whole(samples[k])) window_.picked[static_cast<std::size_t>(count++)] = k;
  if (to - from <= kMostRows || count <= kMostRows) {
    for (long k = from; k < std::min(to, from + kMostRows) && !out.full(); ++k) {
      MotionRow& row = out.push();
      row = MotionRow();
      row.time = samples[k].time;
      for (std::size_t j = 0; j < 6; ++j) {
        row.have[j] = std::isfinite(samples[k].value[j]) ? 1.0 : 0.0;
        row.value[j] = row.have[j] > 0.0 ? samples[k].value[j] : 0.0;
      }
    }
    return;
  }
  const double begin = samples[from].time;
  const auto sample = [&](int k) -> const MotionSample& {
    return samples[window_.picked[static_cast<std::size_t>(k)]];
  };
  window_.nodes.sample(count, [&](int k) { return sample(k).time - begin; });
  std::array<std::array<double, kNodes>, 6> value{};
  std::array<double, 6> remainder{};
  for (std::size_t j = 0; j < 6; ++j)
    remainder[j] = window_.nodes.project(count, [&](int k) { return sample(k).value[j]; }, value[j]);
  for (std::size_t m = 0; m < kNodes && !out.full(); ++m) {
    MotionRow& row = out.push();
    row = MotionRow();
    row.time = begin + window_.nodes.time[m];
    row.size = window_.nodes.weight[m];
    row.have.fill(1.0);
    for (std::size_t j = 0; j < 6; ++j) row.value[j] = value[j][m];
    if (m > 0) continue;
    row.remainder = remainder;
    row.spared = count - kNodes;
  }
}

}  // namespace truewrench
