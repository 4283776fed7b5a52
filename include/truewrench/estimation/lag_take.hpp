// Samples to the rows of an interval: as they are, or at the Gauss nodes of
// their own sampling (METHOD 9). Included by lag.hpp.
#pragma once

#include "truewrench/estimation/lag.hpp"

namespace truewrench {

// Which cells most of the samples [from, to) have, and how many of them.
template <typename Samples, typename Cells>
std::pair<unsigned, long> Lag::most_cells(const Samples& samples, long from, long to, const Cells& cells) {
  const unsigned middle = cells(samples[from + (to - from) / 2]);
  long count = 0;
  for (long k = from; k < to; ++k) count += cells(samples[k]) == middle ? 1 : 0;
  if (2 * count >= to - from) return {middle, count};
  unsigned most = middle;
  for (long k = from; k < to; ++k) {
    const unsigned here = cells(samples[k]);
    if (++times_[here] > times_[most]) most = here;
  }
  count = times_[most];
  for (long k = from; k < to; ++k) times_[cells(samples[k])] = 0;
  return {most, count};
}

// Samples to be gathered, those with the cells that most have, into window_.picked, of the others as many as there are
// rows left to `single`; where too few are alike, samples spread evenly to `single`. The cells, and how many are picked.
template <typename Samples, typename Cells, typename Single>
std::pair<unsigned, int> Lag::pick(const Samples& samples, long from, long to, const Cells& cells,
                                   const Single& single) {
  const long all = to - from;
  const auto [same, agree] =
      all > kMostRows ? most_cells(samples, from, to, cells) : std::pair<unsigned, long>{0, 0};
  int count = 0;
  long of_same = 0, of_others = 0;
  for (long k = from; k < to; ++k)
    if (agree <= kMostRows) {
      if (evenly(k - from, all, kMostRows)) single(samples[k]);
    } else if (cells(samples[k]) == same) {
      if (evenly(of_same++, agree, window_.nodes.capacity()))
        window_.picked[static_cast<std::size_t>(count++)] = k;
    } else if (evenly(of_others++, all - agree, kMostRows - kNodes)) {
      single(samples[k]);
    }
  return {same, count};
}

template <typename Masked>
void Lag::take(long at, const Ring<RawSample>& samples, long from, long to, const Masked& masked) {
  Interval& v = interval(at);
  v.rows = 0;
  v.spared = 0.0;
  v.remainder.fill(0.0);
  v.begin = origin_ + h_ * static_cast<double>(at);
  v.end = v.begin + h_;
  const auto n = static_cast<std::size_t>(n_);
  const auto cells = [&](const RawSample& s) {
    unsigned out = 0;
    for (std::size_t c = 0; c < n; ++c) out |= std::isfinite(s.value[c]) ? 1U << c : 0U;
    return out;
  };
  const auto finish = [&](RawRow& row, bool gathered) {
    const double u = (row.time - v.begin) / h_;
    Basis b[3];
    spline_.bases(u, 0, 3, b);
    for (std::size_t p = 0; p < 3; ++p) std::copy_n(b[p].data(), kLocal, row.basis.begin() + kLocal * p);
    row.masked = false;
    row.gathered = gathered;
    row.weight = 1.0;
    row.channels = 0;
    for (int c = 0; c < n_; ++c) {
      row.channels += row.has(c) ? 1 : 0;
      if (!row.has(c)) row.value[static_cast<std::size_t>(c)] = 0.0;
    }
  };
  const auto single = [&](const RawSample& s) {
    RawRow& row = v.row[static_cast<std::size_t>(v.rows++)];
    row.time = s.time;
    row.size = 1.0;
    row.temperature = s.temperature;
    row.R = s.R;
    row.value = s.value;
    row.cells = cells(s);
    finish(row, false);
  };
  auto [same, count] = pick(samples, from, to, cells, single);
  if (count == 0) return;
  std::array<std::size_t, kMostChannels> cell{};
  int channels = 0;
  for (std::size_t c = 0; c < n; ++c)
    if ((same >> c & 1U) != 0) cell[static_cast<std::size_t>(channels++)] = c;
  const auto of = [&](int c) { return cell[static_cast<std::size_t>(c)]; };
  count = window_.fit(
      count, channels, kMostRows + 1, masked_chi2(channels),
      [&](long k) { return samples[k].time - v.begin; },
      [&](long k, int c) { return samples[k].value[of(c)]; },
      [&](int c) { return noise(static_cast<int>(of(c))); },
      [&](long k) { masked(samples[k].time, samples[k].time); });
  const auto sample = [&](int k) -> const RawSample& {
    return samples[window_.picked[static_cast<std::size_t>(k)]];
  };
  for (int c = 0; c < channels; ++c) v.remainder[of(c)] = window_.remainder[static_cast<std::size_t>(c)];
  v.spared = count - kNodes;
  int k = 0;
  for (std::size_t m = 0; m < kNodes; ++m) {
    RawRow& row = v.row[static_cast<std::size_t>(v.rows++)];
    row.time = v.begin + window_.nodes.time[m];
    row.size = window_.nodes.weight[m];
    while (k + 2 < count && sample(k + 1).time < row.time) ++k;
    const RawSample &before = sample(k), &after = sample(k + 1);
    const double share = std::clamp((row.time - before.time) / (after.time - before.time), 0.0, 1.0);
    for (int x = 0; x < 9; ++x)
      row.R.data()[x] = (1.0 - share) * before.R.data()[x] + share * after.R.data()[x];
    row.temperature = before.temperature;
    row.cells = same;
    for (int c = 0; c < channels; ++c) row.value[of(c)] = window_.value[static_cast<std::size_t>(c)][m];
    finish(row, true);
  }
  // in the order of time, for the sums that run along with it
  for (int r = v.rows - kNodes; r > 0 && r < v.rows; ++r)
    for (auto i = static_cast<std::size_t>(r); i > 0 && v.row[i].time < v.row[i - 1].time; --i)
      std::swap(v.row[i], v.row[i - 1]);
}

inline void Lag::take(std::size_t stream, const Ring<MotionSample>& samples, long from, long to) {
  Ring<MotionRow>& out = motion_[stream];
  const auto cells = [](const MotionSample& s) {
    unsigned found = 0;
    for (std::size_t j = 0; j < 6; ++j) found |= std::isfinite(s.value[j]) ? 1U << j : 0U;
    return found;
  };
  const auto single = [&](const MotionSample& s) {
    if (out.full()) return;
    MotionRow& row = out.push();
    row = MotionRow();
    row.time = s.time;
    for (std::size_t j = 0; j < 6; ++j) {
      row.have[j] = std::isfinite(s.value[j]) ? 1.0 : 0.0;
      row.value[j] = row.have[j] > 0.0 ? s.value[j] : 0.0;
    }
  };
  const long first = out.end();
  const auto [same, count] = pick(samples, from, to, cells, single);
  if (count == 0) return;
  const double begin = samples[from].time;
  const auto sample = [&](int k) -> const MotionSample& {
    return samples[window_.picked[static_cast<std::size_t>(k)]];
  };
  window_.nodes.sample(count, [&](int k) { return sample(k).time - begin; });
  std::array<std::array<double, kNodes>, 6> value{};
  std::array<double, 6> remainder{}, have{};
  for (std::size_t j = 0; j < 6; ++j) {
    if ((same >> j & 1U) == 0) continue;
    have[j] = 1.0;
    remainder[j] = window_.nodes.project(count, [&](int k) { return sample(k).value[j]; }, value[j]);
  }
  for (std::size_t m = 0; m < kNodes && !out.full(); ++m) {
    MotionRow& row = out.push();
    row = MotionRow();
    row.time = begin + window_.nodes.time[m];
    row.size = window_.nodes.weight[m];
    row.have = have;
    for (std::size_t j = 0; j < 6; ++j) row.value[j] = value[j][m];
    if (m > 0) continue;
    row.remainder = remainder;
    row.spared = count - kNodes;
  }
  for (long r = first; r < out.end(); ++r)
    for (long i = r; i > first && out[i].time < out[i - 1].time; --i) std::swap(out[i], out[i - 1]);
}

}  // namespace truewrench
