// The wrench a moving payload exerts on the sensor, and its Jacobians ([A00] 5-9, 22-24).
#pragma once

#include "truewrench/spatial.hpp"
#include "truewrench/types.hpp"

#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>

namespace truewrench {

// Everything beyond the sensing element, as one rigid body.
struct Payload {
  double mass = 1.0;                         // [kg]
  Vector3 center_of_mass = Vector3::Zero();  // c: from the sensor centre, sensor axes [m]
  Matrix3 inertia = Matrix3::Identity();     // I_c: about the centre of mass, sensor axes [kg m^2]
};

// A body of positive mass whose principal moments are positive and satisfy the triangle inequality.
// `slack` forgives rounding in a table, relative to the largest principal moment.
inline Status check(const Payload& p, double slack = 1e-9) {
  if (!std::isfinite(p.mass) || !p.center_of_mass.allFinite() || !p.inertia.allFinite())
    return Status::not_finite;
  if (p.mass <= 0.0) return Status::not_positive;
  const Vector3 principal =
      Eigen::SelfAdjointEigenSolver<Matrix3>().computeDirect(p.inertia, Eigen::EigenvaluesOnly).eigenvalues();
  const double largest = principal.maxCoeff();
  if ((p.inertia - p.inertia.transpose()).cwiseAbs().maxCoeff() > slack * largest)
    return Status::unphysical_payload;
  if (principal.minCoeff() <= 0.0) return Status::unphysical_payload;
  if (principal.sum() < 2.0 * largest * (1.0 - slack)) return Status::unphysical_payload;
  return Status::ok;
}

// w = -[f_c; c x f_c + n_c] ([A00] 5-8 with gravity g in sensor axes; zero on orbit).
inline Vector6 wrench(const Payload& p, const Vector6& nu, const Vector6& a, const Vector3& g) {
  const Vector3 v = nu.head<3>();
  const Vector3 omega = nu.tail<3>();
  const Vector3 f = p.mass * (a.head<3>() + omega.cross(v) - g);               // [A00] 5
  const Vector3 n = p.inertia * a.tail<3>() + omega.cross(p.inertia * omega);  // [A00] 6
  Vector6 w;
  w.head<3>() = -f;                                // [A00] 7
  w.tail<3>() = -(p.center_of_mass.cross(f) + n);  // [A00] 8
  return w;
}

// dw/da, constant for a given payload ([A00] 24, any c and I_c).
inline Matrix6 wrench_jacobian_acceleration(const Payload& p) {
  Matrix6 j;
  j.topLeftCorner<3, 3>() = -p.mass * Matrix3::Identity();
  j.topRightCorner<3, 3>().setZero();
  j.bottomLeftCorner<3, 3>() = -p.mass * cross_matrix(p.center_of_mass);
  j.bottomRightCorner<3, 3>() = -p.inertia;
  return j;
}

// dw/dnu at nu ([A00] 24, any c and I_c).
inline Matrix6 wrench_jacobian_twist(const Payload& p, const Vector6& nu) {
  const Vector3 v = nu.head<3>();
  const Vector3 omega = nu.tail<3>();
  const Matrix3 cx = cross_matrix(p.center_of_mass);
  const Matrix3 df_dv = p.mass * cross_matrix(omega);
  const Matrix3 df_domega = -p.mass * cross_matrix(v);
  Matrix6 j;
  j.topLeftCorner<3, 3>() = -df_dv;
  j.topRightCorner<3, 3>() = -df_domega;
  j.bottomLeftCorner<3, 3>() = -cx * df_dv;
  j.bottomRightCorner<3, 3>() =
      -(cx * df_domega + cross_matrix(omega) * p.inertia - cross_matrix(p.inertia * omega));
  return j;
}

}  // namespace truewrench
