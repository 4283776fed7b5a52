// The rows of a fixed lag: what one interval of knots holds of the sensor's
// samples and of the motion's. Where a rate gives an interval more samples than
// it can tell apart, they are replaced, once, by weighted rows at the Gauss
// nodes of their own sampling (METHOD 9). Nothing here allocates after
// construction.
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/math/spline.hpp"
#include "truewrench/types.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

namespace truewrench {

inline constexpr int kMostChannels = 12;
inline constexpr int kMostStreams = 3;
inline constexpr int kMostRows = 8;  // of an interval and a stream
inline constexpr int kNodes = 5;     // that stand for more

using Channels = std::array<double, kMostChannels>;

// A sample of the sensor, as it comes.
struct RawSample {
  double time = 0.0, temperature = 0.0;
  Channels value{};
  Matrix3 R = Matrix3::Identity();  // R_sensor_root
};

// A sample of a motion stream, as it comes.
struct MotionSample {
  double time = 0.0;
  std::array<double, 6> value{};
};

// A row of (10.3): `size` samples at one time.
struct RawRow {
  double time = 0.0, size = 1.0, weight = 1.0, temperature = 0.0;
  int channels = 0;    // n_t
  unsigned cells = 0;  // which of them: bits
  bool masked = false;
  std::array<double, 2 * kLocal> basis{};  // B, B'
  Channels value{};
  Matrix3 R = Matrix3::Identity();
  // as predicted
  Channels residual{}, cw{};  // 0 where a cell is missing; C_0 w
  Vector6 nu = Vector6::Zero(), a = Vector6::Zero(), w = Vector6::Zero(),
          phi = Vector6::Zero();  // w = B phi

  bool has(int i) const { return (cells >> i & 1U) != 0; }
};

// A row of (10.4).
struct MotionRow {
  double time = 0.0, size = 1.0;
  std::array<double, 6> value{}, have{};  // have: 1, or 0 where a cell is missing
  std::array<double, 6> remainder{};      // sum of squares within what it stands for
  double spared = 0.0;                    // samples that the remainder counts
};

// A ring of fixed capacity, its elements named by how many came before.
template <typename T>
class Ring {
 public:
  void reserve(std::size_t capacity) { items_.resize(std::max<std::size_t>(capacity, 1)); }
  long begin() const { return begin_; }
  long end() const { return end_; }
  bool full() const { return end_ - begin_ >= static_cast<long>(items_.size()); }
  bool empty() const { return begin_ == end_; }
  T& operator[](long i) { return items_[static_cast<std::size_t>(i) % items_.size()]; }
  const T& operator[](long i) const { return items_[static_cast<std::size_t>(i) % items_.size()]; }
  T& push() { return (*this)[end_++]; }
  void drop_before(long i) { begin_ = std::max(begin_, std::min(i, end_)); }
  void clear() { begin_ = end_; }

 private:
  std::vector<T> items_;
  long begin_ = 0, end_ = 0;
};

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

// x of A x = b, A (N, N) symmetric positive definite, its lower triangle read:
// LDL^T in place.
template <int N>
void solve_small(double (&A)[N][N], double (&b)[N]) {
  for (int j = 0; j < N; ++j) {
    const double pivot = std::max(A[j][j], 1e-300);
    for (int i = j + 1; i < N; ++i) {
      const double l = A[i][j] / pivot;
      for (int k = j + 1; k <= i; ++k) A[i][k] -= l * A[k][j];
      b[i] -= l * b[j];
    }
    for (int i = j + 1; i < N; ++i) A[i][j] /= pivot;
    b[j] /= pivot;
  }
  for (int j = N - 1; j >= 0; --j)
    for (int i = j + 1; i < N; ++i) b[j] -= A[i][j] * b[i];
}

// The Gauss quadrature of a discrete measure, and the projection of samples on
// polynomials of a lower degree: a sum over the samples of such a polynomial
// times the values is the weighted sum over the nodes.
class Nodes {
 public:
  void reserve(int most) { basis_.resize(static_cast<std::size_t>(most * kNodes)); }
  int capacity() const { return static_cast<int>(basis_.size()) / kNodes; }

  std::array<double, kNodes> time{}, weight{};

  // Orthonormal polynomials at `count` times (Stieltjes), nodes and weights
  // from their three-term recurrence.
  template <typename Time>
  void sample(int count, const Time& at) {
    double low = at(0), high = at(0);
    for (int k = 1; k < count; ++k) {
      low = std::min(low, at(k));
      high = std::max(high, at(k));
    }
    const double middle = 0.5 * (low + high), half = std::max(0.5 * (high - low), 1e-12),
                 first = 1.0 / std::sqrt(static_cast<double>(count));
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

  // The polynomial of a projection at a sample, by the projection's values at
  // the nodes.
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
  std::vector<double> basis_;  // (samples, kNodes)
  std::array<double, kNodes> at_node_[kNodes];

  double* row(int k) { return basis_.data() + k * kNodes; }
  const double* row(int k) const { return basis_.data() + k * kNodes; }
};

}  // namespace truewrench
