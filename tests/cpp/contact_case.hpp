// One tool on one motion for the tests of the contact wrench: settings, motion, raw output.
#pragma once

#include "oracles.hpp"
#include "truewrench/contact.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>

namespace truewrench {

constexpr std::int64_t period = 2'000'000;  // 500 Hz
constexpr double warmth = 6.0;              // [K] above the reference, where a slope is known

inline contact::Settings settings_of(int n, Feels feels, bool more) {
  std::mt19937 random(3);
  contact::Settings s;
  Eigen::MatrixXd gain = 0.1 * oracle::normal_matrix(random, n, 6);
  gain.topRows<6>() += Matrix6::Identity();
  s.sensor.gain = gain;
  s.sensor.offset = oracle::normal_matrix(random, n, 1);
  s.sensor.noise = Eigen::VectorXd::LinSpaced(n, 0.1, 0.2);
  s.feels = feels;
  s.mass = 2.0;
  s.center_of_mass = {0.02, -0.03, 0.08};
  s.S << 0.003, 0.004, 0.002, 0.0003, -0.0002, 0.0004;
  s.mounting = {0.1, -0.2, 0.3};
  s.tilt = {0.01, -0.02};
  s.gravity = {0.0, 0.0, -9.81};
  const Eigen::MatrixXd root = 0.002 * oracle::normal_matrix(random, 7 * n + 15, 7 * n + 15);
  s.covariance = root * root.transpose();
  s.offset_walk = Eigen::VectorXd::Constant(n, 0.01);
  s.time_offset_std = 1e-3;
  s.twist_noise = 1e-6 * Matrix6::Identity();
  if (more) {
    s.temperature_slope = Eigen::VectorXd::Constant(n, 0.3);
    s.temperature_slope_std = Eigen::VectorXd::Constant(n, 0.02);
    s.quadratic_std = Eigen::VectorXd::Constant(n, 0.01);
    s.full_scale = Eigen::VectorXd::Constant(n, 100.0);
  }
  return s;
}

// Root to sensor, turning about a fixed axis, so that the angular velocity is its rate.
struct Swing {
  Vector3 axis = Vector3(1.0, 2.0, -1.0).normalized();
  double angle(double t) const { return 0.8 * std::sin(3.0 * t); }
  Matrix3 turn(double t) const {
    return Eigen::AngleAxisd(-angle(t), axis).toRotationMatrix() *
           Eigen::AngleAxisd(0.7, Vector3::UnitY()).toRotationMatrix();
  }
  Vector6 twist(double t) const {
    Vector6 nu;
    nu << 0.3 * std::sin(2.0 * t), 0.2 * std::cos(3.0 * t), 0.1 * std::sin(4.0 * t),
        2.4 * std::cos(3.0 * t) * axis;
    return nu;
  }
  Vector6 acceleration(double t) const {
    Vector6 a;
    a << 0.6 * std::cos(2.0 * t), -0.6 * std::sin(3.0 * t), 0.4 * std::cos(4.0 * t),
        -7.2 * std::sin(3.0 * t) * axis;
    return a;
  }
};

inline Eigen::VectorXd raw_of(const contact::Settings& s, const Swing& motion, double t,
                              const Vector6& contact_wrench) {
  contact::Matrix3x2 by;
  const Vector3 g = motion.turn(t) * contact::tilted_fall(s.gravity, s.tilt, by);
  const Matrix3 S = contact::symmetric(s.S);
  const Matrix3 inertia = s.mass * (S.trace() * Matrix3::Identity() - S);
  const double sign = s.feels == Feels::payload_on_sensor ? 1.0 : -1.0;
  const Vector6 w = contact_wrench + sign * oracle::wrench(s.mass, s.center_of_mass, inertia, Vector3::Zero(),
                                                           motion.twist(t), motion.acceleration(t), g);
  Matrix3 turns[3];
  const Matrix3 R = contact::channel_turn(s.mounting, turns);
  Vector6 turned;
  turned << R * w.head<3>(), R * w.tail<3>();
  Eigen::VectorXd raw = s.sensor.gain * turned + s.sensor.offset;
  if (s.temperature_slope.size() > 0) raw += warmth * s.temperature_slope;
  return raw;
}

// Samples of both streams from 0 on, sensor and motion at the same stamps.
inline void fill(Contact& c, const contact::Settings& s, int count, const Vector6& contact_wrench) {
  const Swing motion;
  for (int i = 0; i < count; ++i) {
    const double t = 1e-9 * static_cast<double>(i * period);
    const Eigen::VectorXd raw = raw_of(s, motion, t, contact_wrench);
    ASSERT_EQ(c.add_raw(i * period, raw.data(), i), Status::ok);
    ASSERT_EQ(c.add_motion(i * period, motion.twist(t), motion.turn(t) * s.gravity, motion.turn(t), i),
              Status::ok);
  }
}

}  // namespace truewrench
