// A wrist sensor calibrated while the arm moves, and corrected from then on, in one loop without Python. What comes from a
// driver is simulated here: twist of the payload's centre of mass, 500 Hz, and six raw channels [V] with stamps of their own.
//
//     c++ -std=c++20 -O3 -march=native -I include -I /path/to/eigen3 examples/control_loop.cpp -o control_loop && ./control_loop
#include <truewrench/estimation/corrector_of.hpp>

#include <cmath>
#include <cstdio>
#include <random>

using truewrench::Status;
using truewrench::Vector3;
using truewrench::Vector6;

namespace {

// The robot, in your place: its twist and acceleration at t [s], and the wrench of a payload of 50 kg on the sensor.
struct Robot {
  double mass = 50.0;
  Vector3 center_of_mass{0.2, 0.0, 0.0}, moments{1.5, 1.5, 0.4};

  static Vector6 wave(double t, int derivative) {
    Vector6 out = Vector6::Zero();
    for (int i = 0; i < 6; ++i)
      for (int k = 1; k <= 3;
           ++k) {  // several frequencies on every axis: one alone hides what follows the pose
        const double rate = 2.0 * M_PI * (0.21 * k + 0.03 * i);
        out[i] += 0.12 * std::pow(rate, derivative) * std::sin(rate * t + i * k + 0.5 * M_PI * derivative);
      }
    return out;
  }
  Vector6 wrench(double t) const {
    const Vector6 nu = wave(t, 0), a = wave(t, 1);
    const Vector3 v = nu.head<3>(), omega = nu.tail<3>();
    Vector6 w;
    w.head<3>() = -mass * (a.head<3>() + omega.cross(v));
    w.tail<3>() = center_of_mass.cross(Vector3(w.head<3>())) - moments.cwiseProduct(Vector3(a.tail<3>())) -
                  omega.cross(moments.cwiseProduct(omega));
    return w;
  }
};

}  // namespace

int main() {
  const Robot robot;
  std::mt19937 random(1);
  const auto noise = [&](double sigma) {
    std::normal_distribution<double> normal(0.0, sigma);
    return Vector6(Vector6::NullaryExpr([&] { return normal(random); }));
  };

  // What the data sheet says: 500 N and 50 N m are 10 V; noise of 2 mV; gains believed to 30 %, an offset to 1 V.
  truewrench::Statement rig;
  rig.range << 500, 500, 500, 50, 50, 50;
  const Vector6 channel_scale = Vector6::Constant(10.0);  // [V], of full range
  rig.nominal = truewrench::Matrix6::Identity();
  rig.noise = Vector6::Constant(2e-3 / 10.0);
  rig.gain_prior = 0.3;
  rig.offset_prior = Vector6::Constant(0.1);
  rig.body_prior = {Eigen::Matrix<double, 10, 1>::Zero()};  // the payload is known exactly

  // What a log of it will be: one stream of twists of the centre of mass, 1e-4 m/s and rad/s.
  truewrench::RecordedLog about;
  about.payload.mass = robot.mass;
  about.payload.center_of_mass = about.point = robot.center_of_mass;
  about.payload.inertia = robot.moments.asDiagonal();
  about.raw.resize(0, 6);
  truewrench::MotionStream twist;
  twist.value.resize(0, 6);
  twist.sigma = Vector6::Constant(1e-4);
  twist.group.resize(6);
  twist.group << 0, 0, 0, 1, 1, 1;  // velocities share one factor on their noise, angular velocities another
  about.motion = {twist};

  truewrench::Incremental online(rig, about, {.rate = 500.0, .discrepancy = 0.0});  // allocates; no push does
  truewrench::Corrector<6> corrector;

  // The true sensor is off by 10 to 20 %.
  std::normal_distribution<double> off(0.0, 0.15);
  const truewrench::Matrix6 gain =
      truewrench::Matrix6::Identity() + truewrench::Matrix6::NullaryExpr([&] { return off(random); });
  const Vector6 offset = noise(0.3);
  const auto volts = [&](double t) {
    const Vector6 w = robot.wrench(t).cwiseQuotient(rig.range);
    return Vector6(10.0 * (gain * w) + offset + noise(2e-3));
  };

  for (int k = 0; k < 10000; ++k) {  // 20 s at 500 Hz
    const double t = 2e-3 * k;
    const Vector6 nu = robot.wave(t, 0) + noise(1e-4);
    const Vector6 raw = volts(t + 7e-4).cwiseQuotient(channel_scale);
    if (online.push_motion(0, t, nu.data()) != Status::ok) return 1;
    if (online.push_raw(t + 7e-4, raw.data()) != Status::ok) return 1;
    if (k % 2500 == 2499 && online.ready())
      std::printf("%4.0f s: sigma of the gains %.2g of range (RMS)\n", t,
                  std::sqrt(online.covariance().diagonal().mean()));
  }
  if (online.finish() != Status::ok || !online.sound()) return 1;
  if (truewrench::configure(corrector, online, channel_scale) != Status::ok) return 1;

  double squares = 0.0, nominal = 0.0;
  for (int k = 0; k < 1000; ++k) {
    const double t = 20.0 + 2e-3 * k;
    const Vector6 raw = volts(t), true_wrench = robot.wrench(t);
    truewrench::Correction corrected;  // wrench [N, N m] and its 1 sigma
    if (corrector.step(raw.data(), corrected) != Status::ok) return 1;
    squares += (corrected.wrench - true_wrench).cwiseQuotient(corrected.std).squaredNorm() / 6000.0;
    nominal += (raw.cwiseProduct(rig.range) / 10.0 - true_wrench).cwiseQuotient(corrected.std).squaredNorm() /
               6000.0;
  }
  std::printf("error over its sigma: %.2f corrected, %.0f as the data sheet has it\n", std::sqrt(squares),
              std::sqrt(nominal));
  return squares < 2.0 ? 0 : 1;
}
