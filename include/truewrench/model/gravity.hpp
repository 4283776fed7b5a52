// Gravity that the sensor feels (10.5), and what a row of (10.3) makes of a motion: d w by the motion and by what is unknown of
// body and gravity.
#pragma once

#include "truewrench/model/parameters.hpp"

#include <array>

namespace truewrench {

// Gravity in the root frame turned by two small angles about axes normal to it, and its derivative by them.
inline Vector3 tilted(const Vector3& gravity, const Eigen::Vector2d& tilt,
                      Eigen::Matrix<double, 3, 2>& by_tilt) {
  const double size = std::sqrt(gravity[0] * gravity[0] + gravity[1] * gravity[1] + gravity[2] * gravity[2]);
  int least = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(gravity[i]) < std::abs(gravity[least])) least = i;
  Vector3 unit = Vector3::Zero();
  unit[least] = 1.0;
  Vector3 e1 = cross(gravity, unit);
  const double across = std::sqrt(e1[0] * e1[0] + e1[1] * e1[1] + e1[2] * e1[2]);
  for (int i = 0; i < 3; ++i) e1[i] /= across;
  const Vector3 axes[2] = {cross(e1, gravity), cross(cross(gravity, e1), gravity)};
  Vector3 x;
  for (int i = 0; i < 3; ++i) x[i] = gravity[i] + axes[0][i] * tilt[0] + axes[1][i] / size * tilt[1];
  const double square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2], ratio = size / std::sqrt(square);
  for (int c = 0; c < 2; ++c) {
    Vector3 axis = axes[c];
    if (c == 1)
      for (int i = 0; i < 3; ++i) axis[i] /= size;
    const double along = (x[0] * axis[0] + x[1] * axis[1] + x[2] * axis[2]) / square;
    for (int i = 0; i < 3; ++i) by_tilt(i, c) = ratio * (axis[i] - x[i] * along);
  }
  return {ratio * x[0], ratio * x[1], ratio * x[2]};
}

// Gravity at one theta.
class Gravity {
 public:
  Gravity() = default;
  // `acts`: it is felt, and tilt and delay have columns. Places in theta by `columns`.
  // `half_window` and `clock_set` [s] are those of the log.
  Gravity(const Statement& rig, const Columns& columns, const double* theta, bool acts, double half_window,
          double clock_set)
      : acts_(acts), late_(acts && columns.gamma >= 0), root_(rig.gravity) {
    if (!acts) return;
    root_ = tilted(rig.gravity, Eigen::Vector2d(theta[columns.tilt], theta[columns.tilt + 1]), by_tilt_);
    if (!late_) return;
    const double s = theta[columns.clock[0]];
    off_ = theta[columns.clock[0] + 1] - 0.5;
    gamma_ = theta[columns.gamma];
    square_window_ = half_window * half_window;
    set_series(s, s + clock_set, Bending(s + clock_set, square_window_, off_));
  }

  bool acts() const { return acts_; }

  // g+ = g + gamma [ s Omega x g + s^2/2 (Omega x (Omega x g) + Omegadot x g) ]
  //        + (kappa - 1/2) (gamma s^2 + r^2) (Omegadot x g - Omega x (Omega x g)), r that of the sensor             (10.5)
  // and the third order of both, set_series().
  Vector3 felt(const Matrix3& R_sensor_root, const Vector6& nu, const Vector6& a, const Vector3& jerk) const {
    if (!acts_) return Vector3::Zero();
    const Vector3 g = in_sensor(R_sensor_root);
    return late_ && (gamma_ != 0.0 || square_window_ != 0.0) ? retarded(g, angular(nu), angular(a), jerk) : g;
  }

  // Calls put(d g+) for s, kappa and gamma of (10.5), where they have columns, and for both tilts. jerk: Omegaddot.
  template <typename Put>
  void by_parameters(const Matrix3& R_sensor_root, const Vector3& omega, const Vector3& alpha,
                     const Vector3& jerk, const Put& put) const {
    if (late_) {
      const auto x = products(in_sensor(R_sensor_root), omega, alpha, jerk);
      double by[3][3];
      for (int i = 0; i < 3; ++i) {
        by[0][i] = gamma_ * sum(by_s_, x, i);
        by[1][i] = gamma_ * sum(by_kappa_, x, i) + square_window_ * (x[1][i] - x[2][i]);
        by[2][i] = sum(series_, x, i);
      }
      for (const auto& d : by) put(d);
    }
    for (int c = 0; c < 2; ++c) {
      const Vector3 x = product(R_sensor_root, Vector3(by_tilt_(0, c), by_tilt_(1, c), by_tilt_(2, c)));
      put(retarded(x, omega, alpha, jerk).data());
    }
  }

  // d g+ = - gamma s [g x] dOmega, to first order in s.
  double lag() const { return gamma_ * series_[0]; }
  // Without (10.5).
  Vector3 in_sensor(const Matrix3& R_sensor_root) const { return product(R_sensor_root, root_); }

 private:
  bool acts_ = false, late_ = false;
  Vector3 root_ = Vector3::Zero();
  Eigen::Matrix<double, 3, 2> by_tilt_ = Eigen::Matrix<double, 3, 2>::Zero();
  double off_ = 0.0, gamma_ = 0.0, square_window_ = 0.0;

  // Of products(). With D = e^{s d} [1 + second d^2 + third d^3] of (10.4), g+ = D^-1 g; dg = - Omega x g, and the Omega of g is D Omega;
  // e = s^2 / 2 - second of d^2, c = s (second - s^2 / 6) - third of d^3.
  using Series = std::array<double, 7>;
  Series series_{}, by_s_{}, by_kappa_{};
  static Series of(double first, double spin, double e, double se, double jerk, double c) {
    return {first, spin, e, jerk - c, se + 2.0 * c, se + c, -c};
  }
  void set_series(double s, double late, const Bending& by) {
    const double square = late * late, second = off_ * square;  // r^2 apart, gamma does not count it
    const double e = 0.5 * s * s - second, e_by = s - by.second_by_s;
    series_ = of(s, s * s - e, e, s * e, 2.0 * s * second, s * (second - s * s / 6.0) - by.third);
    by_s_ = of(1.0, 2.0 * s - e_by, e_by, e + s * e_by, 2.0 * (second + s * by.second_by_s),
               second + s * (by.second_by_s - 0.5 * s) - by.third_by_s);
    by_kappa_ = of(0.0, square, -square, -s * square, 2.0 * s * square, s * square - by.third_by_kappa);
  }

  static std::array<Vector3, 7> products(const Vector3& g, const Vector3& omega, const Vector3& alpha,
                                         const Vector3& jerk) {
    const Vector3 first = cross(omega, g), spin = cross(alpha, g), turn = cross(omega, first);
    return {first, spin, turn, cross(jerk, g), cross(alpha, first), cross(omega, spin), cross(omega, turn)};
  }
  static double sum(const Series& series, const std::array<Vector3, 7>& x, int i) {
    double out = 0.0;
    for (std::size_t k = 0; k < x.size(); ++k) out += series[k] * x[k][i];
    return out;
  }

  Vector3 retarded(const Vector3& g, const Vector3& omega, const Vector3& alpha, const Vector3& jerk) const {
    const auto x = products(g, omega, alpha, jerk);
    Vector3 out;
    for (int i = 0; i < 3; ++i)
      out[i] = g[i] + gamma_ * sum(series_, x, i) + off_ * square_window_ * (x[1][i] - x[2][i]);
    return out;
  }
};

// w of (10.3), of a motion as the sensor read it: what the mean of a product of motions is beside the product of means is the product
// of their rates, as late as the pole's products are, by the variance of what the sensor averages over (10.4).
inline Vector6 wrench_read(const Payload& p, const Vector3& point, const Vector6& nu, const Vector6& a,
                           const Vector6& jerk, const Vector3& g, const Bending& bending, bool imu) {
  Vector6 w = wrench_about(p, point, nu, a, g);
  const double averaged = bending.averaged(), late = bending.skewed();
  if (averaged == 0.0) return w;
  Vector6 rate;
  for (int j = 0; j < 6; ++j) rate[j] = imu && j < 3 ? 0.0 : a[j] - late * jerk[j];
  const Vector6 products = wrench_about(p, point, rate, Vector6::Zero(), Vector3::Zero());
  for (int j = 0; j < 6; ++j) w[j] += averaged * products[j];
  return w;
}

// What d w is at one row: w (SI) and its motion; `scale` (6): fractions of range, with the sign of the rig. To X (6, ldx) by the
// ten parameters of the body, unless it is `known`, and those of gravity; returned by twist, acceleration and gravity.
inline MotionJacobian row_jacobian(const Payload& body, const Vector3& point, const double* scale,
                                   const Gravity& gravity, const Matrix3& R_sensor_root, const Vector6& nu,
                                   const Vector6& a, const Vector3& jerk, const Vector6& w, bool known,
                                   double* X, int ldx) {
  MotionJacobian j = motion_jacobian(body, point, nu);
  int at = 0;
  if (!known) {
    const BodyJacobian by_body = body_jacobian(body, nu, a, w);
    for (; at < kBodyParameters; ++at)
      for (int r = 0; r < 6; ++r) X[r * ldx + at] = scale[r] * by_body(r, at);
  }
  if (!gravity.acts()) return j;
  gravity.by_parameters(R_sensor_root, angular(nu), angular(a), jerk, [&](const double* by) {
    for (int r = 0; r < 6; ++r)
      X[r * ldx + at] = scale[r] * (j.g(r, 0) * by[0] + j.g(r, 1) * by[1] + j.g(r, 2) * by[2]);
    ++at;
  });
  if (gravity.lag() == 0.0) return j;
  const Matrix3 turned = cross_matrix(gravity.in_sensor(R_sensor_root));
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 3; ++c)
      j.nu(r, 3 + c) -=
          gravity.lag() * (j.g(r, 0) * turned(0, c) + j.g(r, 1) * turned(1, c) + j.g(r, 2) * turned(2, c));
  return j;
}

// d w (fractions of range) by [x, x'] (6, 12) of the splines of a twist, or of an IMU: the specific force in place of v, and no
// derivative of it.
inline void by_splines(const MotionJacobian& j, const double* scale, bool imu, double* J) {
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) {
      J[r * 12 + c] = scale[r] * (imu && c < 3 ? j.a(r, c) : j.nu(r, c));
      J[r * 12 + 6 + c] = imu && c < 3 ? 0.0 : scale[r] * j.a(r, c);
    }
}

}  // namespace truewrench
