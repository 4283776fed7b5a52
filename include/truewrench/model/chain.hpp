// The arm as a product of exponentials: motion of the sensor frame and its derivatives by the joints (METHOD 10.6).
//
//   g(q) = exp([xi_1] q_1) ... exp([xi_M] q_M) g(0)
//   J_i  = Ad(exp([xi_i] q_i) ... exp([xi_M] q_M) g(0))^-1 xi_i        in sensor axes: nu = sum J_i qd_i
//
// A joint moves what is nearer to the root past the sensor and nothing beyond itself: for any twist y of the links before joint
// i, in sensor axes, dy/dq_i = [y, J_i]. So the twist, its derivative, and their Jacobians are sums of brackets.
#pragma once

#include "truewrench/model/body.hpp"
#include "truewrench/model/record.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

namespace truewrench {

// From the root to the sensor frame.
struct Chain {
  std::vector<Vector6> xi;          // (M) twist of unit joint speed at q = 0, of the root's origin, root axes
  Matrix3 R = Matrix3::Identity();  // R_root_sensor at q = 0
  Vector3 p = Vector3::Zero();      // p_root_sensor at q = 0 [m]
};

// What carries the root, a row a time.
struct Carrier {
  RowMatrix twist,
      rate;  // (K, 6) of the root's origin, root axes, and its component-wise derivative; or empty: at rest
  RowMatrix R_inertial_root;  // (K, 9) row by row; or empty: they agree
};

namespace chain {

struct Twist {
  Vector3 v, omega;
};

inline Vector3 cross(const Vector3& a, const Vector3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Twist bracket(const Twist& x, const Twist& y) {
  return {cross(x.omega, y.v) + cross(x.v, y.omega), cross(x.omega, y.omega)};
}
inline Twist operator+(const Twist& x, const Twist& y) { return {x.v + y.v, x.omega + y.omega}; }
inline Twist operator-(const Twist& x, const Twist& y) { return {x.v - y.v, x.omega - y.omega}; }
inline Twist operator*(const Twist& x, double s) { return {x.v * s, x.omega * s}; }
inline Vector3 turned_back(const Matrix3& R, const Vector3& x) {  // R^T x
  Vector3 out;
  for (int c = 0; c < 3; ++c) out[c] = R(0, c) * x[0] + R(1, c) * x[1] + R(2, c) * x[2];
  return out;
}
inline Twist row(const RowMatrix& m, Eigen::Index k) {
  const double* x = m.data() + 6 * k;
  return {{x[0], x[1], x[2]}, {x[3], x[4], x[5]}};
}
inline void store(double* out, const Twist& x, std::ptrdiff_t stride) {
  for (int r = 0; r < 3; ++r) {
    out[r * stride] = x.v[r];
    out[(3 + r) * stride] = x.omega[r];
  }
}

// A joint at q = 0: the axis it turns about through a point of it, and how far along for an angle; or a slide.
struct Joint {
  Twist xi;
  double speed = 0.0;  // |Omega|; 0: a slide
  Vector3 axis = Vector3::Zero(), point = Vector3::Zero(), along = Vector3::Zero();

  explicit Joint(const Vector6& twist) : xi{twist.head<3>(), twist.tail<3>()}, speed(xi.omega.norm()) {
    if (speed == 0.0) return;
    axis = xi.omega / speed;
    point = cross(axis, xi.v) / speed;
    along = axis * axis.dot(xi.v);
  }

  // Turns and shifts (R, p) by exp([xi] q).
  void move(double q, Matrix3& R, Vector3& p) const {
    if (speed == 0.0) {
      p += xi.v * q;
      return;
    }
    const double angle = speed * q, s = std::sin(angle), c = std::cos(angle), rest = 1.0 - c;
    Matrix3 turn;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) turn(i, j) = rest * axis[i] * axis[j] + (i == j ? c : 0.0);
    turn(0, 1) -= s * axis[2];
    turn(0, 2) += s * axis[1];
    turn(1, 2) -= s * axis[0];
    turn(1, 0) += s * axis[2];
    turn(2, 0) -= s * axis[1];
    turn(2, 1) += s * axis[0];
    p = product(turn, Vector3(p - point)) + point + along * q;
    R = product(turn, R);
  }
};

}  // namespace chain

// Motion of the sensor's origin, sensor axes, at (K, M) q, qd, qdd; the attitude where `gravity` asks for it, and so the Jacobian.
inline Status chain_motion(const Chain& of, const RowMatrix& q, const RowMatrix& qd, const RowMatrix& qdd,
                           const Carrier& carrier, bool gravity, bool jacobian, MappedMotion& out) {
  using chain::Twist;
  const Eigen::Index K = q.rows();
  const int M = static_cast<int>(of.xi.size());
  for (const RowMatrix* x : {&q, &qd, &qdd})
    if (x->rows() != K || x->cols() != M) return Status::wrong_size;
  const auto told = [K](const RowMatrix& x, Eigen::Index columns) {
    return x.rows() == 0 || (x.rows() == K && x.cols() == columns);
  };
  if (carrier.twist.rows() != carrier.rate.rows() || !told(carrier.twist, 6) || !told(carrier.rate, 6) ||
      !told(carrier.R_inertial_root, 9))
    return Status::wrong_size;
  std::vector<chain::Joint> joints(of.xi.begin(), of.xi.end());
  std::vector<Twist> J(joints.size()), before(joints.size() + 1), faster(before), turn(J);
  for (RowMatrix* m : {&out.nu, &out.a}) m->resize(K, 6);
  out.R_sensor_root.resize(gravity ? K : 0, 9);
  out.jacobian.resize(jacobian ? K : 0, 36 * M);
  const std::ptrdiff_t stride = 3 * M;
  for (Eigen::Index k = 0; k < K; ++k) {
    Matrix3 R = of.R;
    Vector3 p = of.p;
    for (std::size_t i = joints.size(); i-- > 0;) {
      const Twist& xi = joints[i].xi;
      J[i] = {chain::turned_back(R, xi.v + chain::cross(xi.omega, p)), chain::turned_back(R, xi.omega)};
      joints[i].move(q.data()[k * M + static_cast<Eigen::Index>(i)], R, p);
    }
    before[0] = faster[0] = {Vector3::Zero(), Vector3::Zero()};
    if (carrier.twist.rows() > 0)
      for (auto& [to, from] : {std::pair{&before[0], &carrier.twist}, std::pair{&faster[0], &carrier.rate}}) {
        const Twist root = chain::row(*from, k);
        *to = {chain::turned_back(R, root.v + chain::cross(root.omega, p)),
               chain::turned_back(R, root.omega)};
      }
    for (std::size_t i = 0; i < J.size(); ++i) {
      const double speed = qd.data()[k * M + static_cast<Eigen::Index>(i)];
      turn[i] = bracket(before[i], J[i]);  // d nu / d q_i
      before[i + 1] = before[i] + J[i] * speed;
      faster[i + 1] = faster[i] + J[i] * qdd.data()[k * M + static_cast<Eigen::Index>(i)] + turn[i] * speed;
    }
    const Twist &nu = before.back(), &a = faster.back();
    chain::store(out.nu.data() + 6 * k, nu, 1);
    chain::store(out.a.data() + 6 * k, a, 1);
    double *upper = out.jacobian.data() + (jacobian ? 36 * M * k : 0), *lower = upper + 6 * stride;
    for (std::size_t i = 0; jacobian && i < J.size(); ++i) {
      chain::store(upper + i, turn[i], stride);
      chain::store(upper + M + i, J[i], stride);
      chain::store(upper + 2 * M + i, {Vector3::Zero(), Vector3::Zero()}, stride);
      chain::store(lower + i, bracket(faster[i], J[i]) + bracket(turn[i], nu - before[i]), stride);
      chain::store(lower + M + i, turn[i] - bracket(nu - before[i + 1], J[i]), stride);
      chain::store(lower + 2 * M + i, J[i], stride);
    }
    if (!gravity) continue;
    if (carrier.R_inertial_root.rows() > 0) {
      Matrix3 carried;
      for (int i = 0; i < 9; ++i) carried(i / 3, i % 3) = carrier.R_inertial_root.data()[9 * k + i];
      R = product(carried, R);
    }
    std::copy_n(R.data(), 9, out.R_sensor_root.data() + 9 * k);  // by columns: the rows of its inverse
  }
  return Status::ok;
}

}  // namespace truewrench
