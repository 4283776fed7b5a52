// The wrench of a body whose own parameters are uncertain, and its Jacobians (METHOD 3): the twist belongs to a point fixed to
// the sensor, which an error of the centre of mass does not move.
#pragma once

#include "truewrench/payload.hpp"
#include "truewrench/spatial.hpp"

#include <cmath>

namespace truewrench {

inline constexpr int kBodyParameters =
    10;  // log of the mass, centre of mass, xx yy zz xy xz yz: departures from stated

using BodyVector = Eigen::Matrix<double, kBodyParameters, 1>;
using BodyJacobian = Eigen::Matrix<double, 6, kBodyParameters>;

// The inertia tensor with elements xx yy zz xy xz yz.
inline Matrix3 inertia_tensor(const double* e) {
  Matrix3 m;
  m << e[0], e[3], e[4],  //
      e[3], e[1], e[5],   //
      e[4], e[5], e[2];
  return m;
}

// The body that departs from a stated one.
inline Payload departed(const Payload& stated, const BodyVector& by) {
  Payload out = stated;
  out.mass *= std::exp(by[0]);
  for (int i = 0; i < 3; ++i) out.center_of_mass[i] += by[1 + i];
  out.inertia += inertia_tensor(by.data() + 4);
  return out;
}

// Small products, as plain loops: expressions of blocks cost a hundred megabytes to compile.
inline Matrix3 product(const Matrix3& a, const Matrix3& b) {
  Matrix3 out;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) out(r, c) = a(r, 0) * b(0, c) + a(r, 1) * b(1, c) + a(r, 2) * b(2, c);
  return out;
}
inline Vector3 product(const Matrix3& a, const Vector3& x) {
  Vector3 out;
  for (int r = 0; r < 3; ++r) out[r] = a(r, 0) * x[0] + a(r, 1) * x[1] + a(r, 2) * x[2];
  return out;
}
inline Vector3 cross(const Vector3& a, const Vector3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vector3 linear(const Vector6& x) { return {x[0], x[1], x[2]}; }
inline Vector3 angular(const Vector6& x) { return {x[3], x[4], x[5]}; }

// By twist, acceleration and gravity.
struct MotionJacobian {
  Matrix6 nu, a;
  Eigen::Matrix<double, 6, 3> g;
};

// f = m (vdot + Omega x v + Omegadot x e + Omega x (Omega x e) - g), e = c - point; w = -[f; c x f + n] (METHOD 3).
inline Vector6 wrench_about(const Payload& p, const Vector3& point, const Vector6& nu, const Vector6& a,
                            const Vector3& g) {
  const Vector3 omega = angular(nu), alpha = angular(a), &c = p.center_of_mass;
  const Vector3 e(c[0] - point[0], c[1] - point[1], c[2] - point[2]);
  const Vector3 turn = cross(omega, linear(nu)), spin = cross(alpha, e),
                centre = cross(omega, cross(omega, e));
  Vector3 f;
  for (int i = 0; i < 3; ++i) f[i] = p.mass * (a[i] + turn[i] + spin[i] + centre[i] - g[i]);
  const Vector3 rate = product(p.inertia, alpha), gyro = cross(omega, product(p.inertia, omega)),
                moment = cross(c, f);
  Vector6 w;
  for (int i = 0; i < 3; ++i) {
    w[i] = -f[i];
    w[3 + i] = -(moment[i] + rate[i] + gyro[i]);
  }
  return w;
}

// dw/dnu, dw/da, dw/dg (METHOD 3) at nu.
inline MotionJacobian motion_jacobian(const Payload& p, const Vector3& point, const Vector6& nu) {
  const Vector3 omega = angular(nu), &centre = p.center_of_mass;
  const Vector3 e(centre[0] - point[0], centre[1] - point[1], centre[2] - point[2]),
      about = product(p.inertia, omega);
  const Matrix3 O = cross_matrix(omega), E = cross_matrix(e), c = cross_matrix(centre),
                V = cross_matrix(linear(nu)), T = cross_matrix(cross(omega, e)), OE = product(O, E),
                OI = product(O, p.inertia), I = cross_matrix(about);
  // [f by v, f by Omega] and [f by vdot, f by Omegadot]; the moment is c x f and what the inertia adds
  Matrix3 by[4];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      by[0](i, j) = p.mass * O(i, j);
      by[1](i, j) = -p.mass * (V(i, j) + T(i, j) + OE(i, j));
      by[2](i, j) = i == j ? p.mass : 0.0;
      by[3](i, j) = -p.mass * E(i, j);
    }
  MotionJacobian out;
  for (int block = 0; block < 4; ++block) {
    const Matrix3& f = by[block];
    const Matrix3 n = product(c, f);
    Matrix6& to = block < 2 ? out.nu : out.a;
    const int at = 3 * (block % 2);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        to(i, at + j) = -f(i, j);
        to(3 + i, at + j) = -n(i, j) - (block == 1 ? OI(i, j) - I(i, j) : block == 3 ? p.inertia(i, j) : 0.0);
      }
  }
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      out.g(i, j) = by[2](i, j);
      out.g(3 + i, j) = p.mass * c(i, j);
    }
  return out;
}

// dw by the ten departures of the body, w as it stands.
inline BodyJacobian body_jacobian(const Payload& p, const Vector6& nu, const Vector6& a, const Vector6& w) {
  const Vector3 omega = angular(nu), alpha = angular(a), f(-w[0], -w[1], -w[2]),
                moment = cross(p.center_of_mass, f);
  const Matrix3 O = cross_matrix(omega), A = cross_matrix(alpha), OO = product(O, O), F = cross_matrix(f);
  Matrix3 f_c;  // f by the centre of mass
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) f_c(i, j) = p.mass * (A(i, j) + OO(i, j));
  const Matrix3 n_c = product(cross_matrix(p.center_of_mass), f_c);
  BodyJacobian j = BodyJacobian::Zero();
  for (int i = 0; i < 3; ++i) {
    j(i, 0) = w[i];
    j(3 + i, 0) = -moment[i];
    for (int k = 0; k < 3; ++k) {
      j(i, 1 + k) = -f_c(i, k);
      j(3 + i, 1 + k) = -n_c(i, k) + F(i, k);
    }
  }
  // d(I x)/d(xx yy zz xy xz yz) for x = alpha, and Omega x of the same for x = Omega
  static constexpr int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};
  for (int e = 0; e < 6; ++e) {
    Vector3 rate = Vector3::Zero(), turn = rate;
    rate[row[e]] += alpha[column[e]];
    turn[row[e]] += omega[column[e]];
    if (e >= 3) {
      rate[column[e]] += alpha[row[e]];
      turn[column[e]] += omega[row[e]];
    }
    const Vector3 gyro = product(O, turn);
    for (int i = 0; i < 3; ++i) j(3 + i, 4 + e) = -(rate[i] + gyro[i]);
  }
  return j;
}

}  // namespace truewrench
