// The wrench of a body whose own parameters are uncertain, and its Jacobians (METHOD 3): the twist belongs to a point fixed to
// the sensor, which an error of the centre of mass does not move.
#pragma once

#include "truewrench/payload.hpp"
#include "truewrench/spatial.hpp"

#include <cmath>

namespace truewrench {

inline constexpr int kBodyParameters = 10;  // log of the mass, centre of mass, xx yy zz xy xz yz: departures from stated

using BodyVector = Eigen::Matrix<double, kBodyParameters, 1>;
using BodyJacobian = Eigen::Matrix<double, 6, kBodyParameters>;

// The inertia tensor with elements xx yy zz xy xz yz.
template <typename Six>
Matrix3 inertia_tensor(const Six& e) {
  Matrix3 m;
  m << e[0], e[3], e[4],  //
      e[3], e[1], e[5],   //
      e[4], e[5], e[2];
  return m;
}

// The body that departs from a stated one.
inline Payload departed(const Payload& stated, const BodyVector& by) {
  return {stated.mass * std::exp(by[0]), stated.center_of_mass + by.segment<3>(1),
          stated.inertia + inertia_tensor(by.tail<6>())};
}

// By twist, acceleration and gravity.
struct MotionJacobian {
  Matrix6 nu, a;
  Eigen::Matrix<double, 6, 3> g;
};

// f = m (vdot + Omega x v + Omegadot x e + Omega x (Omega x e) - g), e = c - point; w = -[f; c x f + n] (METHOD 3).
inline Vector6 wrench_about(const Payload& p, const Vector3& point, const Vector6& nu, const Vector6& a,
                            const Vector3& g) {
  const Vector3 omega = nu.tail<3>(), alpha = a.tail<3>(), e = p.center_of_mass - point;
  const Vector3 f = p.mass * (a.head<3>() + omega.cross(nu.head<3>()) + alpha.cross(e) +
                              omega.cross(omega.cross(e)) - g);
  const Vector3 n = p.inertia * alpha + omega.cross(p.inertia * omega);
  Vector6 w;
  w << -f, -(p.center_of_mass.cross(f) + n);
  return w;
}

// dw/dnu, dw/da, dw/dg (METHOD 3) at nu.
inline MotionJacobian motion_jacobian(const Payload& p, const Vector3& point, const Vector6& nu) {
  const Vector3 omega = nu.tail<3>(), e = p.center_of_mass - point;
  const Matrix3 O = cross_matrix(omega), E = cross_matrix(e), c = cross_matrix(p.center_of_mass);
  MotionJacobian j;
  Eigen::Matrix<double, 3, 6> f_nu, f_a;
  f_nu << p.mass * O, p.mass * (-cross_matrix(nu.head<3>()) - cross_matrix(omega.cross(e)) - O * E);
  f_a << p.mass * Matrix3::Identity(), -p.mass * E;
  j.nu.topRows<3>() = -f_nu;
  j.nu.bottomRows<3>() = -c * f_nu;
  j.nu.bottomRightCorner<3, 3>() -= O * p.inertia - cross_matrix(p.inertia * omega);
  j.a.topRows<3>() = -f_a;
  j.a.bottomRows<3>() = -c * f_a;
  j.a.bottomRightCorner<3, 3>() -= p.inertia;
  j.g.topRows<3>() = p.mass * Matrix3::Identity();
  j.g.bottomRows<3>() = p.mass * c;
  return j;
}

// dw by the ten departures of the body, w as it stands.
inline BodyJacobian body_jacobian(const Payload& p, const Vector6& nu, const Vector6& a, const Vector6& w) {
  const Vector3 omega = nu.tail<3>(), alpha = a.tail<3>(), f = -w.head<3>();
  const Matrix3 O = cross_matrix(omega), f_c = p.mass * (cross_matrix(alpha) + O * O);
  BodyJacobian j;
  j.col(0) << w.head<3>(), -p.center_of_mass.cross(f);
  j.block<3, 3>(0, 1) = -f_c;
  j.block<3, 3>(3, 1) = -(cross_matrix(p.center_of_mass) * f_c - cross_matrix(f));
  j.block<3, 6>(0, 4).setZero();
  // d(I x)/d(xx yy zz xy xz yz) for x = alpha, and Omega x of the same for x = Omega
  const auto of = [](const Vector3& x) {
    Eigen::Matrix<double, 3, 6> m;
    m << x[0], 0, 0, x[1], x[2], 0,  //
        0, x[1], 0, x[0], 0, x[2],   //
        0, 0, x[2], 0, x[0], x[1];
    return m;
  };
  j.block<3, 6>(3, 4) = -(of(alpha) + O * of(omega));
  return j;
}

}  // namespace truewrench
