// The rows of a fixed lag: what one interval of knots holds of the sensor's samples and of the motion's.
// Where a rate gives an interval more samples than it can tell apart, they are replaced, once, by weighted
// rows at the Gauss nodes of their own sampling (METHOD 9). Nothing here allocates after construction.
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/math/nodes.hpp"
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

// Whether the k-th of so many is one of `most` that lie evenly among them, or of all where they are no more.
inline bool evenly(long k, long all, long most) {
  return most >= all || ((k + 1) * most + all / 2) / all > (k * most + all / 2) / all;
}

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
  bool gathered = false;                   // one of those that stand for more together
  std::array<double, 3 * kLocal> basis{};  // B, B', B''
  Channels value{};
  Matrix3 R = Matrix3::Identity();
  // as predicted
  Channels residual{}, cw{};  // 0 where a cell is missing; C_0 w
  Vector6 nu = Vector6::Zero(), a = Vector6::Zero(), w = Vector6::Zero(),
          phi = Vector6::Zero();   // w = B phi
  Vector6 jerk = Vector6::Zero();  // nuddot of a twist

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

}  // namespace truewrench
