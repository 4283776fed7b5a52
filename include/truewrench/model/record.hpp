// A log as the estimator reads it: streams with stamps of their own, in seconds on one clock; NaN where a sample is missing.
//
// Channels are fractions of R_i = |nominal_i| @ range, the motion is in SI units (METHOD 10.1).
#pragma once

#include "truewrench/payload.hpp"
#include "truewrench/types.hpp"

#include <Eigen/Core>

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

namespace truewrench {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

inline constexpr int max_components = 32;  // of a motion, or channels

// What the components of the motion spline are.
enum class Source : std::uint8_t {
  twist,   // v, Omega of the logged point
  imu,     // specific force at the sensor origin, Omega
  mapped,  // generalised positions: joints, through a MotionMap
};

// Measurements of a derivative of the motion spline.
struct MotionStream {
  int derivative = 0;
  Eigen::VectorXd time;   // (K) [s]
  RowMatrix value;        // (K, M)
  Eigen::VectorXd sigma;  // (M) stated
  Eigen::VectorXi
      group;  // (M) which components share one factor on their noise, counted from 0 within the stream
  Eigen::VectorXd bias_prior;      // (M) 1 sigma of a constant bias, or empty
  double time_offset_prior = 0.0;  // [s] 1 sigma of s, beside which the data may show more (10.1)
  double clock_mean = 0.0;         // s_0 [s]
  double kappa_mean = 0.5;
  double half_window = 0.0;  // [s] of what a sample is a mean of, so that kappa tells it without a delay
  // of rows that stand for more than a sample, else empty:
  Eigen::VectorXd size;  // (K) samples
  RowMatrix remainder;   // (K, M) their sum of squares about it
};

// Filters in (10.4), twist(t) = [1 + second d^2 + third d^3] nu(t + s), exact to third order for a clock and one pole, of the sensor
// (kappa below 1/2) or of the velocities (above); and its derivatives by s and kappa.
struct Bending {
  double second_by_kappa;  // S^2 + r^2
  double pole;             // [s] time constant
  double second, third, second_by_s, third_by_s, third_by_kappa;

  // [s] late in all; [s^2] r^2, of what samples are means of; kappa - 1/2. A pole is as late as it averages: what is averaged
  // beyond that is to both sides.
  Bending(double late, double square_window, double off)
      : second_by_kappa(late * late + square_window),
        pole(std::min(std::sqrt(2.0 * std::abs(off) * second_by_kappa), std::abs(late))),
        second(off * second_by_kappa),
        third(-std::copysign(pole * pole * pole / 3.0, off)),
        second_by_s(2.0 * off * late),
        third_by_s(pole < std::abs(late) ? -pole * second_by_s : -std::copysign(1.0, off) * late * pole),
        third_by_kappa(pole < std::abs(late) ? -pole * second_by_kappa : 0.0) {}

  // Of what a filter of the sensor averages over: variance [s^2], and how late the products of its pole are [s].
  double averaged() const { return std::max(0.0, -2.0 * second); }
  double skewed() const { return second < 0.0 ? pole : 0.0; }

  // Rows of nu(t + s) and its four derivatives to those of the twist, by the motion, by s and by kappa.
  template <typename Basis>
  void rows(const Basis* b, int knots, double* by_motion, double* by_s, double* by_kappa) const {
    for (int l = 0; l < knots; ++l) {
      const auto at = static_cast<std::size_t>(l);
      by_motion[l] = b[0][at] + second * b[2][at] + third * b[3][at];
      by_s[l] = b[1][at] + second_by_s * b[2][at] + (second + third_by_s) * b[3][at] + third * b[4][at];
      by_kappa[l] = second_by_kappa * b[2][at] + third_by_kappa * b[3][at];
    }
  }
};

// What generalised positions and their derivatives mean for the sensor: a row a time.
struct MappedMotion {
  RowMatrix nu, a;          // (K, 6)
  RowMatrix R_sensor_root;  // (K, 9) row by row; empty without gravity
  RowMatrix jacobian;       // (K, 12 * 3M), row by row: of [nu, a] by (x, x', x'')
};

// From (K) times and (K, M) x, x', x'' to the motion of the sensor; the Jacobian where it is asked for.
using MotionMap = std::function<void(const Eigen::VectorXd&, const RowMatrix&, const RowMatrix&,
                                     const RowMatrix&, bool jacobian, MappedMotion&)>;

struct RecordedLog {
  Source source = Source::twist;
  Payload payload;                  // as stated
  Vector3 point = Vector3::Zero();  // that the twist belongs to, from the sensor origin
  int body = 0;                     // which payload of theta it carries
  bool arm = false;  // twists are those of an arm: (10.10) looks at its place, however little it turns
  // where the offset is stated to walk: [s] between which it goes by straight lines, a walk of this rate about them, fraction of
  // range per sqrt(s); stretches begin and end there
  std::vector<double> offset_knots;
  double offset_walk = 0.0;
  Eigen::VectorXd time;     // (K) [s] of the sensor's samples
  RowMatrix raw;            // (K, n)
  RowMatrix R_sensor_root;  // (K, 9) row by row, or empty: no gravity, or a mapped motion that brings its own
  Eigen::VectorXd temperature;  // (K) above the reference [K], or empty
  // [s] from which on the attitude has headings that nothing tells to others: gravity is tilted about axes of a root frame of
  // this log alone, anew from each of these times on, where stretches begin and end; empty: the root frame that logs share
  std::vector<double> own_roots;
  double half_window = 0.0;  // [s] as of a stream, of the sensor's samples
  double clock_set = 0.0;    // [s] how much later the sensor was, undone at its stamps; (10.4) bends by it on
  bool resolved =
      false;  // a low-pass of motion and sensor alike has left nothing that a knot a sample does not follow
  std::vector<MotionStream> motion;
  MotionMap map;         // of a mapped motion
  bool carried = false;  // whether it depends on the time: what carries an arm has the stamps of the motion
  // of rows that stand for more than a sample, else empty:
  Eigen::VectorXd size;              // (K) samples
  RowMatrix remainder;               // (K, n) their sum of squares about it
  std::vector<Eigen::Index> spikes;  // samples of the log that no row holds

  int components() const { return motion.empty() ? 0 : static_cast<int>(motion.front().value.cols()); }
  // Of a stream, by its s and kappa.
  Bending bending(std::size_t stream, double s, double kappa) const {
    const double of_stream = motion[stream].half_window;
    return {s + clock_set, half_window * half_window + of_stream * of_stream, kappa - 0.5};
  }
};

// What a rig states of the sensor and of what is not known, normalised; 0 holds a parameter at its mean.
struct Statement {
  Vector6 range = Vector6::Ones();  // [N, N m]
  double sign = 1.0;                // of w: Feels
  Eigen::VectorXd noise;            // (n) 1 sigma of a sample
  RowMatrix nominal;                // (n, 6) normalised gain
  double gain_prior = 0.3;
  Eigen::VectorXd offset_prior;  // (n)
  bool pool_offsets = false;
  Vector3 gravity = Vector3::Zero();  // in the root frame
  double tilt_prior = 0.0;            // [rad]
  double gamma_mean = 0.5;
  double slope_prior = 0.0;                              // of the offset with temperature [1 / K]
  std::vector<Eigen::Matrix<double, 10, 1>> body_prior;  // 1 sigma: of log mass, [m], [kg m^2]
};

}  // namespace truewrench
