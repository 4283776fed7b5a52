// A sensor on an arm whose velocities are known, as a control loop meets it: each stream with stamps of its own.
#pragma once

#include "oracles.hpp"
#include "truewrench/estimation/incremental.hpp"

#include <cmath>
#include <random>

namespace truewrench {

// The payload of [A00] Table 1 (free fall), its twist at 500 Hz, six channels at 400 Hz; drawn from what `rig` states.
struct LoopCase {
  static constexpr double motion_rate = 500.0, sensor_rate = 400.0;
  static constexpr double force = 500.0, moment = 50.0, noise = 2e-4, velocity_noise = 1e-4;

  Statement rig;
  RecordedLog about;
  Eigen::MatrixXd gain;
  Vector6 offset;
  oracle::Sines motion;
  std::mt19937 random;

  explicit LoopCase(unsigned seed) : random(seed) {
    rig.range << force, force, force, moment, moment, moment;
    rig.noise = Vector6::Constant(noise);
    rig.nominal = Matrix6::Identity();
    rig.offset_prior = Vector6::Constant(0.1);
    rig.body_prior = {Eigen::Matrix<double, 10, 1>::Zero()};
    about.payload.mass = 50.0;
    about.payload.center_of_mass = {0.2, 0.0, 0.0};
    about.payload.inertia = Vector3(1.5, 1.5, 0.4).asDiagonal();
    about.point = about.payload.center_of_mass;
    about.raw.resize(0, 6);
    MotionStream twist;
    twist.sigma = Vector6::Constant(velocity_noise);
    twist.group.resize(6);
    twist.group << 0, 0, 0, 1, 1, 1;
    about.motion = {twist};
    gain = Matrix6::Identity() + rig.gain_prior * oracle::normal_matrix(random, 6, 6);
    offset = 0.1 * oracle::normal_matrix(random, 6, 1);
  }

  Vector6 twist_at(double t) {
    return motion.twist(t) + velocity_noise * oracle::normal_matrix(random, 6, 1);
  }
  Vector6 raw_at(double t) {
    const Payload& p = about.payload;
    const Vector6 w = oracle::wrench(p.mass, p.center_of_mass, p.inertia, p.center_of_mass, motion.twist(t),
                                     motion.acceleration(t), Vector3::Zero());
    return gain * w.cwiseQuotient(rig.range) + offset + noise * oracle::normal_matrix(random, 6, 1);
  }

  // Both streams in the order of time; `to` is told of each sample and says whether it was taken.
  template <typename To>
  void run(double seconds, To&& to) {
    for (double next[2] = {0.0, 0.0007}; next[0] < seconds || next[1] < seconds;) {
      const bool sensor = next[1] < next[0];
      const double t = next[sensor ? 1 : 0];
      const Vector6 value = sensor ? raw_at(t) : twist_at(t);
      to(sensor, t, value);
      next[sensor ? 1 : 0] += 1.0 / (sensor ? sensor_rate : motion_rate);
    }
  }
  // As record() has it.
  Status feed(Incremental& online, double seconds) {
    Status worst = Status::ok;
    run(seconds, [&](bool sensor, double t, const Vector6& value) {
      const Status s = sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data());
      if (s != Status::ok) worst = s;
    });
    return worst;
  }
};

}  // namespace truewrench
