// Textbook versions that the engine is tested against, written out anew: nothing here calls the engine.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

namespace oracle {

// Clamped knot vector of a quintic spline.
inline std::vector<double> clamped(const std::vector<double>& breakpoints) {
  std::vector<double> t(5, breakpoints.front());
  t.insert(t.end(), breakpoints.begin(), breakpoints.end());
  t.insert(t.end(), 5, breakpoints.back());
  return t;
}

// Cox and de Boor's recursion, and its derivatives: N_{j,d}(t).
inline double b_spline(const std::vector<double>& knots, std::size_t j, int degree, double t,
                       int derivative) {
  const auto over = [](double a, double b) { return b > 0.0 ? a / b : 0.0; };
  const auto d = static_cast<std::size_t>(degree);
  if (derivative > 0) {
    return degree *
           (over(b_spline(knots, j, degree - 1, t, derivative - 1), knots[j + d] - knots[j]) -
            over(b_spline(knots, j + 1, degree - 1, t, derivative - 1), knots[j + d + 1] - knots[j + 1]));
  }
  if (degree == 0) {
    const bool at_end = t == knots.back() && knots[j + 1] == knots.back() && knots[j] < knots[j + 1];
    return (t >= knots[j] && t < knots[j + 1]) || at_end ? 1.0 : 0.0;
  }
  return over(t - knots[j], knots[j + d] - knots[j]) * b_spline(knots, j, degree - 1, t, 0) +
         over(knots[j + d + 1] - t, knots[j + d + 1] - knots[j + 1]) *
             b_spline(knots, j + 1, degree - 1, t, 0);
}

// All basis functions at t: (coefficients).
inline Eigen::VectorXd basis(const std::vector<double>& breakpoints, double t, int derivative) {
  const std::vector<double> knots = clamped(breakpoints);
  Eigen::VectorXd n(static_cast<Eigen::Index>(breakpoints.size()) + 4);
  for (Eigen::Index j = 0; j < n.size(); ++j)
    n[j] = b_spline(knots, static_cast<std::size_t>(j), 5, t, derivative);
  return n;
}

using Vector6 = Eigen::Matrix<double, 6, 1>;

// Reaction of a rigid payload, at the sensor; the twist is that of a point at `point` from the sensor.
inline Vector6 wrench(double mass, const Eigen::Vector3d& c, const Eigen::Matrix3d& inertia,
                      const Eigen::Vector3d& point, const Vector6& nu, const Vector6& a,
                      const Eigen::Vector3d& g) {
  const Eigen::Vector3d omega = nu.tail<3>();
  const Eigen::Vector3d alpha = a.tail<3>();
  const Eigen::Vector3d r = c - point;
  const Eigen::Vector3d of_point = a.head<3>() + omega.cross(nu.head<3>());
  const Eigen::Vector3d of_mass = of_point + alpha.cross(r) + omega.cross(omega.cross(r));
  const Eigen::Vector3d force = mass * (of_mass - g);
  Vector6 w;
  w << -force, -(c.cross(force) + inertia * alpha + omega.cross(inertia * omega));
  return w;
}

inline Eigen::MatrixXd normal_matrix(std::mt19937& random, Eigen::Index rows, Eigen::Index cols) {
  std::normal_distribution<double> normal;
  return Eigen::MatrixXd::NullaryExpr(rows, cols, [&] { return normal(random); });
}

// A smooth motion: one sine per axis, of a twist (N, 6) and its derivative.
struct Sines {
  Vector6 amplitude = Vector6::Constant(0.25);
  Vector6 frequency = Vector6(0.30, 0.51, 0.69, 0.39, 0.60, 0.87);
  Vector6 phase = Vector6(0.0, 1.0, 2.0, 0.5, 1.5, 2.5);

  Vector6 twist(double t) const {
    return amplitude.cwiseProduct((2.0 * M_PI * frequency.array() * t + phase.array()).sin().matrix());
  }
  Vector6 acceleration(double t) const {
    const Vector6 rate = 2.0 * M_PI * frequency;
    return amplitude.cwiseProduct(rate).cwiseProduct((rate.array() * t + phase.array()).cos().matrix());
  }
};

}  // namespace oracle
