// A window full of everything, with its residuals and their dense Jacobian written out.
#pragma once

#include "truewrench/spatial.hpp"
#include "truewrench/window.hpp"

#include "oracles.hpp"

#include <gtest/gtest.h>

namespace truewrench {

inline constexpr double missing = std::numeric_limits<double>::quiet_NaN();
inline constexpr int one_sample_a_block = 1 << 20;

// One window full of everything: uneven knots and stamps, a twist and its derivative logged apart from the
// sensor, missing components, gravity per sample, a twist of another point than the centre of mass.
struct Scene {
  int channels = 6;
  bool offset = true;
  bool extras = false;  // payload, temperature and clock as well
  bool about = false;   // about a reference motion, with a covariance and a coupling per sample
  Payload payload{3.0, Vector3(0.1, -0.2, 0.15), Vector3(0.3, 0.2, 0.4).asDiagonal()};
  Vector3 point = Vector3(-0.3, 0.2, 0.1);
  std::vector<double> breakpoints{0.0, 0.3, 0.45, 1.0};
  std::vector<double> twist_time, rate_time, sensor_time;
  RowMatrix twist, rate, raw, gravity;
  Vector6 twist_sigma = Vector6(0.01, 0.02, 0.03, 0.04, 0.05, 0.06);
  Vector6 rate_sigma = Vector6(0.5, 0.4, 0.3, 0.2, 0.6, 0.7);
  Vector6 wrench_scale = -Vector6(20, 30, 40, 2, 3, 4).cwiseInverse();
  Eigen::VectorXd channel, sensor_sigma, temperature;
  std::vector<double> reference_breakpoints{-0.2, 0.1, 0.5, 0.8, 1.3};
  Coefficients reference_twist;
  RowMatrix covariance, coupling;  // 6 x 6 in a row, of the twist's samples and those of the rate
  Coefficients x;
  Eigen::VectorXd theta;

  Scene(int n, bool with_offset, bool with_extras = false, bool about_reference = false)
      : channels(n), offset(with_offset), extras(with_extras), about(about_reference) {
    std::mt19937 random(17);
    std::uniform_real_distribution<double> time(0.0, 1.0);
    payload.inertia += 0.05 * (Matrix3::Ones() - Matrix3::Identity());
    const auto stamps = [&](std::vector<double>& t, int count) {
      for (int k = 0; k < count; ++k) t.push_back(time(random));
      std::sort(t.begin(), t.end());
    };
    stamps(twist_time, 23);
    stamps(rate_time, 11);
    stamps(sensor_time, 31);
    twist = oracle::normal_matrix(random, 23, 6);
    rate = oracle::normal_matrix(random, 11, 6);
    raw = 3.0 * oracle::normal_matrix(random, 31, n);
    gravity = 9.81 * oracle::normal_matrix(random, 31, 3).rowwise().normalized();
    channel = Eigen::VectorXd::LinSpaced(n, 2.0, 5.0);
    sensor_sigma = Eigen::VectorXd::LinSpaced(n, 0.01, 0.04);
    x = oracle::normal_matrix(random, static_cast<Eigen::Index>(breakpoints.size()) + 4, 6);
    theta = oracle::normal_matrix(random, layout().size(), 1);
    if (extras) {
      theta.segment<kPayloadParameters>(layout().payload_begin()) *= 0.05;
      theta[layout().time_offset_begin()] = 0.013;
      for (double& t : sensor_time) t = 0.05 + 0.9 * t;  // stays inside the window when shifted
      temperature = oracle::normal_matrix(random, 31, 1);
    }
    for (const auto& [row, column] : {std::pair(2, 1), {2, 5}, {9, 0}, {10, 0}}) twist(row, column) = missing;
    rate.row(4).setConstant(missing);
    for (const auto& [row, column] : {std::pair(0, 3), {7, 0}, {7, 5}, {30, n - 1}})
      raw(row, column) = missing;
    raw.row(12).setConstant(missing);
    if (!about) return;
    reference_twist = oracle::normal_matrix(random, 9, 6);
    covariance.resize(23, 36);
    for (Eigen::Index k = 0; k < 23; ++k) {
      const Matrix6 l = Matrix6::Identity() + 0.3 * oracle::normal_matrix(random, 6, 6);
      const Matrix6 c = 1e-3 * l * l.transpose();
      covariance.row(k) = Eigen::Map<const Eigen::Matrix<double, 1, 36>>(c.data());
      if (twist.row(k).hasNaN()) twist.row(k).setConstant(missing);  // a row is whole or missing
    }
    coupling = oracle::normal_matrix(random, 11, 36);
  }

  double delay() const { return extras ? theta[layout().time_offset_begin()] : 0.0; }

  ParameterLayout layout() const {
    ParameterLayout l;
    l.channels = channels;
    l.offset = offset;
    l.payload = l.temperature = l.time_offset = extras;
    return l;
  }

  LogData data() const {
    LogData d;
    d.payload = payload;
    d.point = point;
    d.motion.push_back({0, twist_time, twist.data(), twist_sigma});
    d.motion.push_back({1, rate_time, rate.data(), rate_sigma});
    if (about) {
      d.motion[0].covariance = covariance.data();
      d.motion[1].coupling = coupling.data();
      d.reference.emplace(reference_breakpoints, reference_twist, 1.0);
    }
    d.wrench = {sensor_time, raw.data(), extras ? temperature.data() : nullptr};
    if (!extras) d.gravity = {sensor_time, gravity.data(), Vector3::Zero()};
    return d;
  }

  WindowRange window() const {
    return {0.0, 1.0, {{0, twist_time.size()}, {0, rate_time.size()}}, {0, sensor_time.size()}};
  }

  // A body displaced by p from the reference: its twist, the derivative of that, and gravity in its axes.
  void displace(double t, Vector6& p, Vector6& dp, const Vector6& ddp, Vector3& g) const {
    const Vector6 nu = reference_twist.transpose() * oracle::basis(reference_breakpoints, t, 0);
    const Vector6 a = reference_twist.transpose() * oracle::basis(reference_breakpoints, t, 1);
    const auto bracket = [](const Vector6& b, const Vector6& c) {  // of two twists
      const Vector3 v = b.head<3>(), omega = b.tail<3>(), u = c.head<3>(), phi = c.tail<3>();
      Vector6 out;
      out << omega.cross(u) + v.cross(phi), omega.cross(phi);
      return out;
    };
    g += g.cross(Vector3(p.tail<3>()));
    const Vector6 twist_there = nu + bracket(nu, p) + dp;
    dp = a + bracket(a, p) + bracket(nu, dp) + ddp;
    p = twist_there;
  }

  // Every residual over its sigma, as a function of motion and common parameters.
  Eigen::VectorXd residuals(const Coefficients& at_x, const Eigen::VectorXd& at_theta,
                            bool sensor = true) const {
    std::vector<double> r;
    const auto motion = [&](const std::vector<double>& t, const RowMatrix& value, const Vector6& sigma,
                            int order) {
      for (std::size_t k = 0; k < t.size(); ++k) {
        const auto row = static_cast<Eigen::Index>(k);
        Vector6 s = at_x.transpose() * oracle::basis(breakpoints, t[k], order);
        if (about && order == 1) {
          for (int c = 0; c < 6; ++c) {
            s[c] += coupling.row(row).segment<6>(6 * c).dot(at_x.transpose() *
                                                            oracle::basis(breakpoints, t[k], 0));
          }
        }
        Vector6 whitened = (value.row(row).transpose() - s).cwiseQuotient(sigma);
        if (about && order == 0) {
          const Matrix6 c = Eigen::Map<const Matrix6>(covariance.data() + 36 * k);
          whitened = c.llt().matrixL().solve(Vector6(value.row(row).transpose() - s));
        }
        for (int c = 0; c < 6; ++c) {
          if (!std::isnan(whitened[c])) r.push_back(whitened[c]);
        }
      }
    };
    motion(twist_time, twist, twist_sigma, 0);
    motion(rate_time, rate, rate_sigma, 1);
    const ParameterLayout at = layout();
    double delay = 0.0;
    double mass = payload.mass;
    Vector3 center = payload.center_of_mass;
    Matrix3 inertia = payload.inertia;
    if (extras) {
      const Eigen::VectorXd p = at_theta.segment<kPayloadParameters>(at.payload_begin());
      delay = at_theta[at.time_offset_begin()];
      mass *= 1.0 + p[0];
      center += p.segment<3>(1);
      Matrix3 relative;
      relative << p[4], p[7], p[8], p[7], p[5], p[9], p[8], p[9], p[6];
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          inertia(i, j) += relative(i, j) * std::sqrt(payload.inertia(i, i) * payload.inertia(j, j));
        }
      }
    }
    for (std::size_t k = 0; sensor && k < sensor_time.size(); ++k) {
      const auto row = static_cast<Eigen::Index>(k);
      const double t = sensor_time[k] + delay;
      Vector6 s = at_x.transpose() * oracle::basis(breakpoints, t, 0);
      Vector6 ds = at_x.transpose() * oracle::basis(breakpoints, t, 1);
      Vector3 g = extras ? Vector3::Zero() : Vector3(gravity.row(row).transpose());
      if (about) displace(t, s, ds, at_x.transpose() * oracle::basis(breakpoints, t, 2), g);
      const Vector6 w = oracle::wrench(mass, center, inertia, point, s, ds, g).cwiseProduct(wrench_scale);
      for (int i = 0; i < channels; ++i) {
        double expected = at_theta.segment<6>(6 * i).dot(w);
        if (offset) expected += at_theta[at.offset_begin() + i];
        if (extras) expected += at_theta[at.temperature_begin() + i] * temperature[row];
        if (!std::isnan(raw(row, i))) r.push_back((raw(row, i) / channel[i] - expected) / sensor_sigma[i]);
      }
    }
    return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
  }

  // d(residuals)/d[x row by row, theta]. At most quadratic in each unknown but the time offset: central differences
  // are exact for the others.
  Eigen::MatrixXd jacobian(bool sensor = true) const {
    const Eigen::Index motion = x.size();
    Eigen::MatrixXd j(residuals(x, theta, sensor).size(), motion + theta.size());
    for (Eigen::Index k = 0; k < j.cols(); ++k) {
      const auto moved = [&](double step) {
        Coefficients at_x = x;
        Eigen::VectorXd at_theta = theta;
        (k < motion ? at_x.data()[k] : at_theta[k - motion]) += step;
        return residuals(at_x, at_theta, sensor);
      };
      const double step = extras ? 1e-5 : 1.0;
      j.col(k) = 0.5 / step * (moved(step) - moved(-step));
    }
    return j;
  }
};

// What the engine makes of a scene, which has to outlive it: everything but the normal equations.
template <int N>
struct Prepared {
  LogData data;
  SensorScale<N> sensor;
  WindowModel<N> model;
  BSpline spline;
  Blocks<N> blocks;

  explicit Prepared(const Scene& scene, int per_interval = one_sample_a_block)
      : data(scene.data()),
        sensor{scene.channel, scene.sensor_sigma, scene.wrench_scale},
        model(data, sensor, scene.layout()),
        spline(scene.breakpoints) {
    blocks.build(model, scene.window(), spline, per_interval, scene.delay(), scene.delay());
  }
  Prepared(const Prepared&) = delete;  // the model refers to the data
  Prepared& operator=(const Prepared&) = delete;
};

inline double relative(const Eigen::MatrixXd& found, const Eigen::MatrixXd& expected) {
  return (found - expected).norm() / expected.norm();
}

}  // namespace truewrench
