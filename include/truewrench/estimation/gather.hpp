// Samples that come faster than anything moves, as few weighted rows (METHOD 9): of every 20 ms, four at the Gauss nodes of their
// own sampling. A sum over the samples of a cubic times the values, and of a polynomial of degree 7, is that over the rows;
// what no cubic takes is kept as a sum of squares, so that the likelihood is that of the samples.
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/estimation/stretch.hpp"
#include "truewrench/math/nodes.hpp"

#include <algorithm>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

namespace truewrench {

inline constexpr int kGathered = 4;        // rows of a window
inline constexpr int kWorthGathering = 8;  // samples of one
inline constexpr int kPacket = 64;         // samples at most that arrive together

// Of the samples, in the median over so many: those that come in packets lie no closer than on average.
inline double median_period(const Eigen::VectorXd& time) {
  const Eigen::Index span = std::min<Eigen::Index>(kPacket, time.size() - 1);
  if (span < 1) return 0.0;
  std::vector<double> d(static_cast<std::size_t>(time.size() - span));
  for (Eigen::Index k = 0; k + span < time.size(); ++k)
    d[static_cast<std::size_t>(k)] = (time[k + span] - time[k]) / static_cast<double>(span);
  const auto middle = d.begin() + static_cast<std::ptrdiff_t>(d.size() / 2);
  std::nth_element(d.begin(), middle, d.end());
  return *middle;
}

inline bool worth_gathering(const Eigen::VectorXd& time) {
  const double period = median_period(time);
  return period > 0.0 && period * kWorthGathering < 1.01 * constants::gather_window;
}

// Rows as they come; `take` puts them in the order of time.
class GatheredRows {
 public:
  explicit GatheredRows(Eigen::Index columns) : columns_(columns) {}

  // A row: returns where its values, and their remainders, are to be written.
  std::pair<double*, double*> push(double time, double size) {
    time_.push_back(time);
    size_.push_back(size);
    value_.resize(value_.size() + static_cast<std::size_t>(columns_), std::nan(""));
    remainder_.resize(value_.size(), 0.0);
    const std::size_t at = value_.size() - static_cast<std::size_t>(columns_);
    return {value_.data() + at, remainder_.data() + at};
  }

  void take(Eigen::VectorXd& time, RowMatrix& value, Eigen::VectorXd& size, RowMatrix& remainder) const {
    std::vector<std::size_t> order(time_.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [this](std::size_t a, std::size_t b) { return time_[a] < time_[b]; });
    const auto rows = static_cast<Eigen::Index>(order.size());
    time.resize(rows);
    size.resize(rows);
    value.resize(rows, columns_);
    remainder.resize(rows, columns_);
    for (Eigen::Index k = 0; k < rows; ++k) {
      const std::size_t from = order[static_cast<std::size_t>(k)],
                        at = from * static_cast<std::size_t>(columns_);
      time[k] = time_[from];
      size[k] = size_[from];
      std::copy_n(value_.data() + at, columns_, value.data() + k * columns_);
      std::copy_n(remainder_.data() + at, columns_, remainder.data() + k * columns_);
    }
  }

 private:
  Eigen::Index columns_;
  std::vector<double> time_, size_, value_, remainder_;
};

// The end of the window that begins with sample k.
inline Eigen::Index window_end(const Eigen::VectorXd& time, Eigen::Index k) {
  Eigen::Index end = k + 1;
  while (end < time.size() && time[end] < time[k] + constants::gather_window - 1e-9) ++end;
  return end;
}

// The sensor's samples; spikes that stand out of their window are left out and named. `noise`: stated.
inline void gather_raw(const RecordedLog& log, const Eigen::VectorXd& noise, RecordedLog& out) {
  const int n = static_cast<int>(log.raw.cols());
  const Eigen::Index turned = log.R_sensor_root.rows() > 0 ? 9 : 0, warm = log.temperature.size() > 0 ? 1 : 0;
  GatheredRows rows(n + turned + warm);  // [raw, R_sensor_root, temperature]
  Window<kGathered, max_components> window;
  window.reserve(static_cast<int>(log.time.size()));
  const auto single = [&](Eigen::Index k) {
    double* value = rows.push(log.time[k], 1.0).first;
    std::copy_n(log.raw.data() + k * n, n, value);
    for (Eigen::Index x = 0; x < turned; ++x) value[n + x] = log.R_sensor_root(k, x);
    if (warm > 0) value[n + turned] = log.temperature[k];
  };
  int cell[max_components];
  for (Eigen::Index begin = 0, end = 0; begin < log.time.size(); begin = end) {
    end = window_end(log.time, begin);
    const double* like = log.raw.data() + (begin + (end - begin) / 2) * n;  // which channels are there
    int channels = 0, count = 0;
    for (int c = 0; c < n; ++c)
      if (std::isfinite(like[c])) cell[channels++] = c;
    const auto picked = [&](Eigen::Index k) {
      for (int c = 0; c < n; ++c)
        if (std::isfinite(log.raw(k, c)) != std::isfinite(like[c])) return false;
      return channels > 0;
    };
    for (Eigen::Index k = begin; k < end; ++k) count += picked(k) ? 1 : 0;
    const bool few = count < kWorthGathering;
    count = 0;
    for (Eigen::Index k = begin; k < end; ++k) {
      if (!few && picked(k))
        window.picked[static_cast<std::size_t>(count++)] = k;
      else if (finite_in(log.raw, k) > 0)
        single(k);
    }
    if (few) continue;
    count = window.fit(
        count, channels, kWorthGathering, masked_chi2(channels),
        [&](long k) { return log.time[k] - log.time[begin]; },
        [&](long k, int c) { return log.raw(k, cell[c]); }, [&](int c) { return noise[cell[c]]; },
        [&](long k) { out.spikes.push_back(k); });
    std::array<double, kGathered> at{};
    std::array<std::array<double, kGathered>, 10> beside{};
    const auto sample = [&](int k) { return window.picked[static_cast<std::size_t>(k)]; };
    for (Eigen::Index x = 0; x < turned; ++x) {
      window.nodes.project(count, [&](int k) { return log.R_sensor_root(sample(k), x); }, at);
      beside[static_cast<std::size_t>(x)] = at;
    }
    if (warm > 0) {
      window.nodes.project(count, [&](int k) { return log.temperature[sample(k)]; }, at);
      beside[static_cast<std::size_t>(turned)] = at;
    }
    for (std::size_t m = 0; m < kGathered; ++m) {
      const double size = window.nodes.weight[m];
      auto [value, remainder] = rows.push(log.time[begin] + window.nodes.time[m], size);
      for (int c = 0; c < channels; ++c) {
        const auto i = static_cast<std::size_t>(c);
        value[cell[c]] = window.value[i][m];
        remainder[cell[c]] = window.remainder[i] * size / count;
      }
      for (Eigen::Index x = 0; x < turned + warm; ++x) value[n + x] = beside[static_cast<std::size_t>(x)][m];
    }
  }
  std::sort(out.spikes.begin(), out.spikes.end());  // within a window the worst came first
  RowMatrix value, remainder;
  rows.take(out.time, value, out.size, remainder);
  out.raw = value.leftCols(n);
  out.remainder = remainder.leftCols(n);
  if (turned > 0) out.R_sensor_root = value.middleCols(n, 9);
  if (warm > 0) out.temperature = value.col(n + turned);
}

inline void gather_motion(const MotionStream& stream, MotionStream& out) {
  const auto M = static_cast<int>(stream.value.cols());
  GatheredRows rows(M);
  Nodes<kGathered> nodes;
  nodes.reserve(static_cast<int>(stream.time.size()));
  std::vector<Eigen::Index> whole;
  for (Eigen::Index begin = 0, end = 0; begin < stream.time.size(); begin = end) {
    end = window_end(stream.time, begin);
    whole.clear();
    for (Eigen::Index k = begin; k < end; ++k)
      if (finite_in(stream.value, k) == M) whole.push_back(k);
    const bool few = static_cast<int>(whole.size()) < kWorthGathering;
    for (Eigen::Index k = begin; k < end; ++k)
      if (few ? finite_in(stream.value, k) > 0
              : finite_in(stream.value, k) > 0 && finite_in(stream.value, k) < M)
        std::copy_n(stream.value.data() + k * M, M, rows.push(stream.time[k], 1.0).first);
    if (few) continue;
    const auto count = static_cast<int>(whole.size());
    const auto sample = [&](int k) { return whole[static_cast<std::size_t>(k)]; };
    nodes.sample(count, [&](int k) { return stream.time[sample(k)] - stream.time[begin]; });
    std::array<std::array<double, kGathered>, max_components> value{};
    double left[max_components];
    for (int j = 0; j < M; ++j)
      left[j] = nodes.project(
          count, [&](int k) { return stream.value(sample(k), j); }, value[static_cast<std::size_t>(j)]);
    for (std::size_t m = 0; m < kGathered; ++m) {
      auto [to, remainder] = rows.push(stream.time[begin] + nodes.time[m], nodes.weight[m]);
      for (int j = 0; j < M; ++j) {
        to[j] = value[static_cast<std::size_t>(j)][m];
        remainder[j] = left[j] * nodes.weight[m] / count;
      }
    }
  }
  rows.take(out.time, out.value, out.size, out.remainder);
}

// The log for the estimator: itself, or with what comes faster than 400 Hz gathered.
inline std::shared_ptr<const RecordedLog> gathered(const RecordedLog& log, const Eigen::VectorXd& noise) {
  bool any = worth_gathering(log.time);
  for (const MotionStream& m : log.motion) any = any || worth_gathering(m.time);
  if (!any) return nullptr;
  auto out = std::make_shared<RecordedLog>(log);
  gather_raw(log, noise, *out);  // slower ones come out as they are
  for (std::size_t i = 0; i < log.motion.size(); ++i) gather_motion(log.motion[i], out->motion[i]);
  return out;
}

}  // namespace truewrench
