// Sensor and tool as one set of parameters, and the wrench of the tool with its derivatives by them.
//
//     raw = C R w + b + slope (T - T_ref) + quadratic,     w = w_tool + w_contact in the sign of `sensor.feels`
//
// R turns sensor axes into those of the channels. theta = (gain row by row, log mass, centre of mass (3), second
// moments per mass (6), offset, mounting (3), tilt (2), clock, [temperature slope, quadratic]), the last two where
// they have a sigma.
#pragma once

#include "truewrench/sensor.hpp"
#include "truewrench/spatial.hpp"
#include "truewrench/types.hpp"

#include <Eigen/Geometry>

#include <cmath>
#include <cstdint>

namespace truewrench::contact {

using Vector2 = Eigen::Vector2d;
using Channels = SensorModel<>::Channels;
using Inverse = SensorModel<>::Inverse;
using Matrix3x2 = Eigen::Matrix<double, 3, 2>;

// What is known of sensor and tool (tool.yaml), SI and raw units. Vectors of zero length stand for zeros.
struct Settings {
  SensorModel<> sensor;  // gain in the rig's sign and channel axes; noise of a sample, 1 sigma
  Feels feels = Feels::payload_on_sensor;    // sign of every wrench that goes in or comes out
  double mass = 1.0;                         // [kg]
  Vector3 center_of_mass = Vector3::Zero();  // seen from the sensor's origin, sensor axes [m]
  Vector6 S = Vector6::Zero();               // xx, yy, zz, xy, xz, yz: second moments per mass about it [m^2]
  Vector3 mounting = Vector3::Zero();     // roll, pitch, yaw of the channels' axes in the sensor frame [rad]
  Vector2 tilt = Vector2::Zero();         // of gravity against the stated direction [rad]
  Vector3 gravity = Vector3::Zero();      // free fall in the root frame, as stated [m/s^2]
  Eigen::MatrixXd covariance;             // (7n + 15)^2 of theta up to the tilt
  std::int64_t offset_time_ns = 0;        // when the offset was the one stated
  Eigen::VectorXd offset_walk;            // (n) raw units per sqrt(s)
  Eigen::VectorXd pose_repeatability;     // (n) 1 sigma of what a pose adds [raw units]
  Eigen::VectorXd slow_error;             // (n) 1 sigma of what else departs at any time [raw units]
  double time_offset = 0.0;               // t_motion = t_sensor + time_offset [s]
  double time_offset_std = 0.0;           // [s]
  Eigen::VectorXd temperature_slope;      // (n) of the offset [raw units per K]
  Eigen::VectorXd temperature_slope_std;  // (n) 1 sigma
  double temperature_reference = 25.0;    // [degC]
  Eigen::VectorXd quadratic_std;          // (n) 1 sigma of a quadratic term at full scale, fraction of range
  Eigen::VectorXd full_scale;             // (n) of each channel [raw units]; needed with the quadratic term
  Matrix6 twist_noise = Matrix6::Zero();  // covariance of one sample of the twist
  Matrix3 gravity_noise = Matrix3::Zero();  // and of its free fall: of an IMU's specific force
};

// Means under the kernel: all that the parameters are combined with.
struct Features {
  Channels raw;                             // raw channels
  double warmth = 0.0;                      // temperature above the reference [K]
  Vector6 acceleration = Vector6::Zero();   // slope of the twist
  Vector3 apparent = Vector3::Zero();       // Omega x v - g, g by the stated gravity [m/s^2]
  Matrix3 turning = Matrix3::Zero();        // Omega Omega^T
  Matrix3 R_sensor_root = Matrix3::Zero();  // zero where gravity's direction plays no part
  Vector6 jerk = Vector6::Zero();           // derivative of `acceleration`, 0 without an uncertain clock
  Vector3 apparent_rate = Vector3::Zero();  // of `apparent`
  Matrix3 turning_rate = Matrix3::Zero();   // of `turning`
};

// Six elements as a symmetric matrix.
inline Matrix3 symmetric(const Vector6& e) {
  Matrix3 m;
  m << e[0], e[3], e[4],  //
      e[3], e[1], e[5],   //
      e[4], e[5], e[2];
  return m;
}

// Free fall turned by two small angles about axes normal to it, the second axis the first turned by a right angle
// about gravity, and the derivative by them.
inline Vector3 tilted_fall(const Vector3& gravity, const Vector2& tilt, Matrix3x2& by_tilt) {
  by_tilt.setZero();
  const double size = gravity.norm();
  if (size == 0.0) return Vector3::Zero();
  int least = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(gravity[i]) < std::abs(gravity[least])) least = i;
  const Vector3 e1 = gravity.cross(Vector3::Unit(least)).normalized();
  Matrix3x2 axes;
  axes.col(0) = e1.cross(gravity);
  axes.col(1) = gravity.cross(e1).cross(gravity) / size;
  const Vector3 x = gravity + axes.col(0) * tilt[0] + axes.col(1) * tilt[1];
  const double ratio = size / x.norm();
  for (int c = 0; c < 2; ++c)
    by_tilt.col(c) = ratio * (axes.col(c) - x * (x.dot(axes.col(c)) / x.squaredNorm()));
  return ratio * x;
}

// R from sensor axes to those of the channels, R^T = Rz Ry Rx, and its derivatives by roll, pitch, yaw.
inline Matrix3 channel_turn(const Vector3& mounting, Matrix3 (&by_angle)[3]) {
  const Vector3 c = mounting.array().cos(), s = mounting.array().sin();
  Matrix3 x, y, z, dx, dy, dz;
  x << 1, 0, 0, 0, c[0], -s[0], 0, s[0], c[0];
  y << c[1], 0, s[1], 0, 1, 0, -s[1], 0, c[1];
  z << c[2], -s[2], 0, s[2], c[2], 0, 0, 0, 1;
  dx << 0, 0, 0, 0, -s[0], -c[0], 0, c[0], -s[0];
  dy << -s[1], 0, c[1], 0, 0, 0, -c[1], 0, -s[1];
  dz << -s[2], -c[2], 0, c[2], -s[2], 0, 0, 0, 0;
  by_angle[0] = (z * y * dx).transpose();
  by_angle[1] = (z * dy * x).transpose();
  by_angle[2] = (dz * y * x).transpose();
  return (z * y * x).transpose();
}

// Where the parameters stand.
struct Places {
  int n = 0;            // channels
  bool warm = false;    // with temperature slopes
  bool curved = false;  // with quadratic terms

  int mass() const { return 6 * n; }
  int center() const { return 6 * n + 1; }
  int S() const { return 6 * n + 4; }
  int offset() const { return 6 * n + 10; }
  int mounting() const { return 7 * n + 10; }
  int tilt() const { return 7 * n + 13; }
  int clock() const { return 7 * n + 15; }
  int slope() const { return 7 * n + 16; }
  int quadratic() const { return slope() + (warm ? n : 0); }
  int size() const { return quadratic() + (curved ? n : 0); }
};

// Moment about the centre of mass per mass: of I Omegadot + Omega x I Omega, I / m = tr S E - S; linear in S.
inline Vector3 spin_moment(const Matrix3& S, const Vector3& alpha, const Matrix3& turning) {
  // [Omega x S Omega]_i = e_ijk (turning S)_jk, and the part of tr S E is zero
  const Matrix3 q = turning * S;
  const Vector3 about(q(1, 2) - q(2, 1), q(2, 0) - q(0, 2), q(0, 1) - q(1, 0));
  return S.trace() * alpha - S * alpha - about;
}

// Tool and sensor at one theta.
struct Point {
  Places at;
  double mass = 1.0;
  Vector3 c = Vector3::Zero();
  Matrix3 S = Matrix3::Zero();
  Matrix3 R = Matrix3::Identity();
  Matrix3 R_by[3];
  Vector3 fall_off = Vector3::Zero();  // free fall in the root frame less the stated one [m/s^2]
  Matrix3x2 fall_by = Matrix3x2::Zero();
  double clock_off = 0.0;  // time offset less the one by which the features were taken [s]
  Channels offset, slope, quadratic, scale;
  Inverse inverse;  // (C R)^+, 6 x n

  // Wrench of the tool on the sensor, payload_on_sensor, by features of the motion and the part that acts at the centre.
  Vector6 tool(const Vector6& acceleration, const Vector3& apparent, const Matrix3& turning,
               const Vector3& extra) const {
    const Vector3 alpha = acceleration.tail<3>();
    const Vector3 of_mass =
        acceleration.head<3>() + apparent + alpha.cross(c) + turning * c - turning.trace() * c + extra;
    Vector6 w;
    w.head<3>() = -mass * of_mass;
    w.tail<3>() = -mass * (c.cross(of_mass) + spin_moment(S, alpha, turning));
    return w;
  }

  // d tool / d acceleration: less the spatial inertia about the sensor's origin.
  Matrix6 by_acceleration() const {
    const Matrix3 cx = cross_matrix(c);
    Matrix6 m;
    m.topLeftCorner<3, 3>() = -mass * Matrix3::Identity();
    m.topRightCorner<3, 3>() = mass * cx;
    m.bottomLeftCorner<3, 3>() = -mass * cx;
    m.bottomRightCorner<3, 3>() = -mass * (S.trace() * Matrix3::Identity() - S - cx * cx);
    return m;
  }
};

}  // namespace truewrench::contact
