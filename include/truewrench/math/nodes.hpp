// Gauss nodes of a discrete measure: what many samples of a smooth function say, as few weighted rows (METHOD 9).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

namespace truewrench {

// Eigenvalues of a symmetric matrix onto its diagonal, eigenvectors as columns:
// cyclic Jacobi, without an allocation.
template <int N>
void diagonalise(double (&a)[N][N], double (&v)[N][N]) {
  double size = 0.0;
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) {
      v[i][j] = i == j ? 1.0 : 0.0;
      size += a[i][j] * a[i][j];
    }
  for (int round = 0; round < 30; ++round) {
    double off = 0.0;
    for (int q = 1; q < N; ++q)
      for (int p = 0; p < q; ++p) {
        off += a[p][q] * a[p][q];
        if (std::abs(a[p][q]) < 1e-300) continue;
        const double ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
        const double t = (ratio >= 0.0 ? 1.0 : -1.0) / (std::abs(ratio) + std::sqrt(1.0 + ratio * ratio));
        const double c = 1.0 / std::sqrt(1.0 + t * t), s = t * c;
        for (int k = 0; k < N; ++k) {
          const double x = a[k][p], y = v[k][p];
          a[k][p] = c * x - s * a[k][q];
          a[k][q] = s * x + c * a[k][q];
          v[k][p] = c * y - s * v[k][q];
          v[k][q] = s * y + c * v[k][q];
        }
        for (int k = 0; k < N; ++k) {
          const double x = a[p][k];
          a[p][k] = c * x - s * a[q][k];
          a[q][k] = s * x + c * a[q][k];
        }
      }
    if (!(off > 1e-30 * size)) break;
  }
}

// The Gauss quadrature of a discrete measure, and the projection of samples on polynomials of a lower degree:
// a sum over the samples of such a polynomial times the values is the weighted sum over the nodes.
template <int kNodes>
class Nodes {
 public:
  void reserve(int most) {
    basis_.resize(static_cast<std::size_t>(most * kNodes));
    sampled_.resize(static_cast<std::size_t>(most));
    count_ = 0;
  }
  int capacity() const { return static_cast<int>(basis_.size()) / kNodes; }

  std::array<double, kNodes> time{}, weight{};

  // Orthonormal polynomials at `count` times (Stieltjes), nodes and weights
  // from their three-term recurrence. Those of the same times, but for when they begin, stand: samples are mostly even.
  template <typename Time>
  void sample(int count, const Time& at) {
    const double origin = at(0);
    double low = origin, high = origin;
    for (int k = 1; k < count; ++k) {
      low = std::min(low, at(k));
      high = std::max(high, at(k));
    }
    const double middle = 0.5 * (low + high), half = std::max(0.5 * (high - low), 1e-12),
                 first = 1.0 / std::sqrt(static_cast<double>(count));
    bool stands = count == count_;
    for (int k = 0; stands && k < count; ++k)
      stands = std::abs(at(k) - origin - sampled_[static_cast<std::size_t>(k)]) < kSame * half;
    if (stands) {
      for (std::size_t i = 0; i < kNodes; ++i) time[i] = origin + apart_[i];
      return;
    }
    count_ = count;
    for (int k = 0; k < count; ++k) sampled_[static_cast<std::size_t>(k)] = at(k) - origin;
    double jacobi[kNodes][kNodes] = {}, vectors[kNodes][kNodes] = {};
    for (int k = 0; k < count; ++k) row(k)[0] = first;
    for (int m = 0; m < kNodes; ++m) {
      double sum = 0.0, next = 0.0;
      for (int k = 0; k < count; ++k) sum += row(k)[m] * row(k)[m] * (at(k) - middle) / half;
      jacobi[m][m] = sum;
      if (m + 1 == kNodes) break;
      for (int k = 0; k < count; ++k) {
        double* p = row(k);
        p[m + 1] = ((at(k) - middle) / half - sum) * p[m] - (m > 0 ? jacobi[m - 1][m] * p[m - 1] : 0.0);
        next += p[m + 1] * p[m + 1];
      }
      next = std::sqrt(next);
      jacobi[m][m + 1] = jacobi[m + 1][m] = next;
      for (int k = 0; k < count; ++k) row(k)[m + 1] /= next;
    }
    diagonalise(jacobi, vectors);
    for (int m = 0; m < kNodes; ++m) {
      const auto i = static_cast<std::size_t>(m);
      time[i] = middle + half * jacobi[m][m];
      weight[i] = static_cast<double>(count) * vectors[0][m] * vectors[0][m];
      for (int p = 0; p < kNodes; ++p) at_node_[m][p] = vectors[p][m] / vectors[0][m] * first;  // pi_p(node)
    }
    for (int m = 1; m < kNodes; ++m)  // in the order of time
      for (int k = m; k > 0 && time[static_cast<std::size_t>(k)] < time[static_cast<std::size_t>(k - 1)];
           --k) {
        std::swap(time[static_cast<std::size_t>(k)], time[static_cast<std::size_t>(k - 1)]);
        std::swap(weight[static_cast<std::size_t>(k)], weight[static_cast<std::size_t>(k - 1)]);
        std::swap(at_node_[k], at_node_[k - 1]);
      }
    for (std::size_t i = 0; i < kNodes; ++i) apart_[i] = time[i] - origin;
  }

  // Values at the nodes, and the sum of squares that no polynomial takes.
  template <typename Value>
  double project(int count, const Value& value, std::array<double, kNodes>& out) const {
    double c[kNodes] = {}, squares = 0.0;
    const double shift = value(0);  // so that what is left is no difference of large sums
    for (int k = 0; k < count; ++k) {
      const double y = value(k) - shift;
      for (int p = 0; p < kNodes; ++p) c[p] += y * row(k)[p];
      squares += y * y;
    }
    for (int m = 0; m < kNodes; ++m) {
      double sum = shift;
      for (int p = 0; p < kNodes; ++p) sum += c[p] * at_node_[m][p];
      out[static_cast<std::size_t>(m)] = sum;
    }
    for (const double x : c) squares -= x * x;
    return std::max(squares, 0.0);
  }

  // The polynomial of a projection at a sample, by the projection's values at the nodes.
  double back(int k, const std::array<double, kNodes>& value) const {
    double sum = 0.0;
    for (int m = 0; m < kNodes; ++m) {
      double x = 0.0;
      for (int p = 0; p < kNodes; ++p) x += row(k)[p] * at_node_[m][p];
      sum += value[static_cast<std::size_t>(m)] * weight[static_cast<std::size_t>(m)] * x;
    }
    return sum;
  }

 private:
  static constexpr double kSame = 1e-8;  // of half the window, that times may differ by: rounding of stamps
  std::vector<double> basis_;            // (samples, kNodes)
  std::vector<double> sampled_;          // the times that they are of, after the first
  int count_ = 0;
  std::array<double, kNodes> at_node_[kNodes], apart_{};  // nodes after the first time

  double* row(int k) { return basis_.data() + k * kNodes; }
  const double* row(int k) const { return basis_.data() + k * kNodes; }
};

// Samples of several channels that few rows replace: those that their own polynomial does not take are left out first, else they
// would be in every row (METHOD 10.3).
template <int kNodes, int kChannels>
class Window {
 public:
  Nodes<kNodes> nodes;
  std::vector<long> picked;                                   // samples, in the order of time
  std::array<std::array<double, kNodes>, kChannels> value{};  // at the nodes
  std::array<double, kChannels> remainder{};                  // sum of squares that no polynomial takes

  void reserve(int most) {
    nodes.reserve(most);
    picked.resize(static_cast<std::size_t>(most));
    spikes_.resize(picked.size());
    sorted_.resize(picked.size());
  }

  // Rows for the first `count` of `picked`; how many are left. time(sample), sample(sample, channel), sigma(channel) as stated;
  // spikes: chi^2 beyond `level`, by the median where the noise is more than stated; at least `fewest` are kept.
  template <typename Time, typename Sample, typename Sigma, typename Dropped>
  int fit(int count, int channels, int fewest, double level, const Time& time, const Sample& sample,
          const Sigma& sigma, const Dropped& dropped) {
    const auto at = [this](int k) { return picked[static_cast<std::size_t>(k)]; };
    for (int round = 0;; ++round) {
      nodes.sample(count, [&](int k) { return time(at(k)); });
      double expected = 0.0;
      for (int c = 0; c < channels; ++c) {
        const auto i = static_cast<std::size_t>(c);
        remainder[i] = nodes.project(count, [&](int k) { return sample(at(k), c); }, value[i]);
        expected += remainder[i] / (sigma(c) * sigma(c));
      }
      if (round == kMostSpikes || count <= fewest || expected < 2.0 * channels * (count - kNodes))
        return count;
      for (int k = 0; k < count; ++k) {
        double sum = 0.0;
        for (int c = 0; c < channels; ++c) {
          const double z = (sample(at(k), c) - nodes.back(k, value[static_cast<std::size_t>(c)])) / sigma(c);
          sum += z * z;
        }
        spikes_[static_cast<std::size_t>(k)] = sorted_[static_cast<std::size_t>(k)] = sum;
      }
      const auto middle = sorted_.begin() + count / 2;
      std::nth_element(sorted_.begin(), middle, sorted_.begin() + count);
      const auto worst = std::max_element(spikes_.begin(), spikes_.begin() + count) - spikes_.begin();
      if (spikes_[static_cast<std::size_t>(worst)] < level * std::max(1.0, *middle / channels)) return count;
      dropped(picked[static_cast<std::size_t>(worst)]);
      std::copy(picked.begin() + worst + 1, picked.begin() + count, picked.begin() + worst);
      --count;
    }
  }

 private:
  static constexpr int kMostSpikes = 8;
  std::vector<double> spikes_, sorted_;
};

}  // namespace truewrench
