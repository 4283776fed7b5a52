// The rows of a fixed lag: what one interval of knots holds of the sensor's samples and of the motion's. Where a rate gives an
// interval more samples than it can tell apart, they are replaced, once, by weighted rows at the Gauss nodes of their own
// sampling (METHOD 9). Nothing here allocates after construction.
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/math/spline.hpp"
#include "truewrench/types.hpp"

#include <Eigen/Eigenvalues>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace truewrench {

inline constexpr int kMostChannels = 12;
inline constexpr int kMostStreams = 3;
inline constexpr int kMostRows = 8;  // of an interval and a stream
inline constexpr int kNodes = 5;     // that stand for more

using Channels = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kMostChannels, 1>;

// A sample of the sensor, as it comes.
struct RawSample {
  double time = 0.0, temperature = 0.0;
  std::array<double, kMostChannels> value{};
  Matrix3 R = Matrix3::Identity();  // R_sensor_root
};

// A sample of a motion stream, as it comes.
struct MotionSample {
  double time = 0.0;
  Vector6 value = Vector6::Zero();
};

// A row of (10.3): `size` samples at one time.
struct RawRow {
  double time = 0.0, size = 1.0, weight = 1.0, temperature = 0.0;
  int channels = 0;  // n_t
  bool masked = false;
  Basis b0 = Basis::Zero(), b1 = Basis::Zero();
  Channels value, have;  // have: 1, or 0 where a cell is missing
  Matrix3 R = Matrix3::Identity();
  // as predicted
  Channels residual, cw;  // cw: C_0 w
  Vector6 nu = Vector6::Zero(), a = Vector6::Zero(), w = Vector6::Zero();
  Vector3 g = Vector3::Zero();
};

// A row of (10.4).
struct MotionRow {
  double time = 0.0, size = 1.0;
  Vector6 value = Vector6::Zero(), have = Vector6::Ones();
  Vector6 remainder = Vector6::Zero();  // sum of squares within what it stands for
  double spared = 0.0;                  // samples that the remainder counts
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

// The Gauss quadrature of a discrete measure, and the projection of samples on polynomials of a lower degree: a sum over the
// samples of such a polynomial times the values is the weighted sum over the nodes.
class Nodes {
 public:
  void reserve(int most) { basis_.resize(most, kNodes); }
  int capacity() const { return static_cast<int>(basis_.rows()); }

  std::array<double, kNodes> time{}, weight{};

  // Orthonormal polynomials at `count` times (Stieltjes), nodes and weights from their three-term recurrence.
  template <typename Time>
  void sample(int count, const Time& at) {
    double low = at(0), high = at(0);
    for (int k = 1; k < count; ++k) {
      low = std::min(low, at(k));
      high = std::max(high, at(k));
    }
    const double middle = 0.5 * (low + high), half = std::max(0.5 * (high - low), 1e-12);
    auto p = basis_.topRows(count);
    p.col(0).setConstant(1.0 / std::sqrt(static_cast<double>(count)));
    Eigen::Matrix<double, kNodes, 1> alpha;
    Eigen::Matrix<double, kNodes - 1, 1> beta;
    for (int m = 0; m < kNodes; ++m) {
      double sum = 0.0, next = 0.0;
      for (int k = 0; k < count; ++k) sum += p(k, m) * p(k, m) * (at(k) - middle) / half;
      alpha[m] = sum;
      if (m + 1 == kNodes) break;
      for (int k = 0; k < count; ++k) {
        const double x = (at(k) - middle) / half;
        p(k, m + 1) = (x - sum) * p(k, m) - (m > 0 ? beta[m - 1] * p(k, m - 1) : 0.0);
        next += p(k, m + 1) * p(k, m + 1);
      }
      beta[m] = std::sqrt(next);
      p.col(m + 1) /= beta[m];
    }
    solver_.computeFromTridiagonal(alpha, beta);
    for (int m = 0; m < kNodes; ++m) {
      const auto i = static_cast<std::size_t>(m);
      time[i] = middle + half * solver_.eigenvalues()[m];
      const double first = solver_.eigenvectors()(0, m);
      weight[i] = static_cast<double>(count) * first * first;
      // pi_p(node) = v_p / v_0 * pi_0
      at_node_.col(m) = solver_.eigenvectors().col(m) / (first * std::sqrt(static_cast<double>(count)));
    }
  }

  // Values at the nodes, and the sum of squares that no polynomial takes.
  template <typename Value>
  double project(int count, const Value& value, std::array<double, kNodes>& out) const {
    Eigen::Matrix<double, kNodes, 1> c = Eigen::Matrix<double, kNodes, 1>::Zero();
    const double shift = value(0);  // so that what is left is no difference of large sums
    double squares = 0.0;
    for (int k = 0; k < count; ++k) {
      const double y = value(k) - shift;
      c += y * basis_.row(k).transpose();
      squares += y * y;
    }
    for (int m = 0; m < kNodes; ++m) out[static_cast<std::size_t>(m)] = shift + c.dot(at_node_.col(m));
    return std::max(squares - c.squaredNorm(), 0.0);
  }

  // The polynomial of a projection at a sample, by the projection's values at the nodes.
  double back(int k, const std::array<double, kNodes>& value) const {
    double sum = 0.0;
    for (int m = 0; m < kNodes; ++m)
      sum += value[static_cast<std::size_t>(m)] * weight[static_cast<std::size_t>(m)] *
             basis_.row(k).dot(at_node_.col(m));
    return sum;
  }

 private:
  Eigen::Matrix<double, Eigen::Dynamic, kNodes, Eigen::RowMajor> basis_;
  Eigen::Matrix<double, kNodes, kNodes> at_node_;
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, kNodes, kNodes>> solver_;
};

}  // namespace truewrench
