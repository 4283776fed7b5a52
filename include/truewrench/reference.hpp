// A motion close to the true one, about which the displacement of the sensor is estimated: what the joints of an arm
// measure is a pose, and a pose is not linear in a twist (docs/method.md, "Joints").
#pragma once

#include "truewrench/bspline.hpp"
#include "truewrench/spatial.hpp"

#include <utility>
#include <vector>

namespace truewrench {

inline constexpr int kCoordinates = 6;  // motion coordinates: the components of a twist or a displacement

using Coefficients = Eigen::Matrix<double, Eigen::Dynamic, kCoordinates, Eigen::RowMajor>;

// What the payload's wrench depends on.
struct MotionState {
  Vector6 nu;
  Vector6 a;
  Vector3 gravity;
};

// The reference at one time, or its mean over a block of samples.
struct ReferencePoint {
  Vector6 nu = Vector6::Zero();
  Vector6 a = Vector6::Zero();
  Vector6 jerk = Vector6::Zero();

  ReferencePoint& operator+=(const ReferencePoint& o) {
    nu += o.nu;
    a += o.a;
    jerk += o.jerk;
    return *this;
  }
  ReferencePoint operator/(double count) const { return {nu / count, a / count, jerk / count}; }

  // The motion displaced by p from the reference, whose gravity in sensor axes is g; first order in p.
  MotionState displaced(const Vector6& p, const Vector6& dp, const Vector6& ddp, const Vector3& g) const {
    const Matrix6 by_twist = twist_adjoint(nu);
    return {nu + by_twist * p + dp, a + twist_adjoint(a) * p + by_twist * dp + ddp,
            g + g.cross(Vector3(p.tail<3>()))};
  }

  // Derivative of the displaced acceleration.
  Vector6 displaced_jerk(const Vector6& p, const Vector6& dp, const Vector6& ddp, const Vector6& dddp) const {
    return jerk + twist_adjoint(jerk) * p + 2.0 * twist_adjoint(a) * dp + twist_adjoint(nu) * ddp + dddp;
  }
};

class ReferenceMotion {
 public:
  // Twist of the logged point in sensor axes: a quintic spline with clamped ends. `spacing` [s]: how fast it may change,
  // the knots of the fit behind it; the displacement needs knots no wider than half of that to undo what noise did to it.
  ReferenceMotion(std::vector<double> breakpoints, Coefficients twist, double spacing)
      : spline_(std::move(breakpoints)), twist_(std::move(twist)), spacing_(spacing) {}

  double spacing() const { return spacing_; }

  ReferencePoint at(double t) const {
    const int i = spline_.interval(t);
    const Powers u = powers(spline_.local(i, t));
    const Eigen::Matrix<double, kCoordinates, kActive> x = spline_.polynomial<kCoordinates>(i, twist_);
    const Powers du = spline_.rate(i, u);
    return {x * u, x * du, x * spline_.rate(i, du)};
  }

 private:
  BSpline spline_;
  Coefficients twist_;
  double spacing_;
};

}  // namespace truewrench
