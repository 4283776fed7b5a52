// Logs of a known motion for the tests of the engine; their wrench is the oracle's.
#pragma once

#include "truewrench/knots.hpp"

#include "oracles.hpp"

#include <functional>

namespace truewrench {

// [A00] Table 1.
inline Payload table_1() { return {50.0, Vector3(0.2, 0.0, 0.0), Vector3(1.5, 1.5, 0.4).asDiagonal()}; }

// The arrays behind a LogData; stays where it is while the engine reads it.
struct Recording {
  Payload payload;
  Vector3 point = Vector3::Zero();
  Vector6 twist_sigma;
  std::vector<double> motion_time;
  std::vector<double> sensor_time;
  RowMatrix twist;
  RowMatrix raw;
  RowMatrix gravity;  // or empty

  LogData data() const {
    LogData d;
    d.payload = payload;
    d.point = point;
    d.motion.push_back({0, motion_time, twist.data(), twist_sigma});
    d.wrench = {sensor_time, raw.data(), nullptr};
    if (gravity.size() > 0) d.gravity = {sensor_time, gravity.data(), Vector3::Zero()};
    return d;
  }
};

// What a log is made with. Gain, offset and noise of the sensor are normalised.
struct Simulation {
  Payload payload = table_1();
  Vector3 point = payload.center_of_mass;  // that the twist belongs to
  std::function<Vector6(double)> twist = [](double t) { return oracle::Sines{}.twist(t); };
  std::function<Vector6(double)> acceleration = [](double t) { return oracle::Sines{}.acceleration(t); };
  std::function<Vector3(double)> gravity;  // in sensor axes
  double begin = 0.0;
  double duration = 10.0;
  double motion_rate = 100.0;
  double sensor_rate = 100.0;
  double twist_sigma = 1e-3;
  double sensor_sigma = 1e-3;
  Vector6 range = Vector6(500, 500, 500, 50, 50, 50);
  double sign = 1.0;
  Eigen::VectorXd channel = range;  // full scale per channel, raw units
  Eigen::MatrixXd gain = Matrix6::Identity();
  Eigen::VectorXd offset = Vector6::Zero();

  template <int N>
  SensorScale<N> sensor() const {
    return {channel, Eigen::VectorXd::Constant(channel.size(), sensor_sigma), sign * range.cwiseInverse()};
  }

  Vector6 wrench(double t) const {
    return sign * oracle::wrench(payload.mass, payload.center_of_mass, payload.inertia, point, twist(t),
                                 acceleration(t), gravity ? gravity(t) : Vector3::Zero());
  }

  Eigen::VectorXd theta() const {
    Eigen::VectorXd out(gain.size() + offset.size());
    for (Eigen::Index i = 0; i < gain.rows(); ++i) out.segment<6>(6 * i) = gain.row(i);
    out.tail(offset.size()) = offset;
    return out;
  }

  Recording record(unsigned seed) const {
    std::mt19937 random(seed);
    Recording r;
    r.payload = payload;
    r.point = point;
    r.twist_sigma.setConstant(twist_sigma);
    for (int k = 0; k < duration * motion_rate; ++k) r.motion_time.push_back(begin + k / motion_rate);
    for (int k = 0; k < duration * sensor_rate; ++k) r.sensor_time.push_back(begin + k / sensor_rate);
    const auto n = channel.size();
    r.twist = twist_sigma * oracle::normal_matrix(random, static_cast<Eigen::Index>(r.motion_time.size()), 6);
    r.raw = sensor_sigma * oracle::normal_matrix(random, static_cast<Eigen::Index>(r.sensor_time.size()), n);
    for (std::size_t k = 0; k < r.motion_time.size(); ++k) {
      r.twist.row(static_cast<Eigen::Index>(k)) += twist(r.motion_time[k]);
    }
    if (gravity) r.gravity.resize(r.raw.rows(), 3);
    for (std::size_t k = 0; k < r.sensor_time.size(); ++k) {
      const auto row = static_cast<Eigen::Index>(k);
      const Vector6 w = wrench(r.sensor_time[k]).cwiseQuotient(range);
      r.raw.row(row) = (r.raw.row(row).transpose() + gain * w + offset).cwiseProduct(channel);
      if (gravity) r.gravity.row(row) = gravity(r.sensor_time[k]);
    }
    return r;
  }
};

// Every sample of a recording as one window.
inline WindowRange whole(const Recording& r) {
  WindowRange w;
  w.begin = std::min(r.motion_time.front(), r.sensor_time.front());
  w.end = std::max(r.motion_time.back(), r.sensor_time.back());
  w.motion = {{0, r.motion_time.size()}};
  w.wrench = {0, r.sensor_time.size()};
  return w;
}

}  // namespace truewrench
