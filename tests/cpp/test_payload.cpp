// The wrench of a payload, from point masses that obey nothing but f = m a.
#include "truewrench/payload.hpp"

#include <gtest/gtest.h>

#include <array>

namespace truewrench {
namespace {

struct PointMass {
  double mass;
  Vector3 position;  // from the sensor centre
};

const std::array<PointMass, 4> cloud{
    {{1.5, {0.3, 0.1, -0.2}}, {0.7, {-0.2, 0.4, 0.1}}, {2.2, {0.1, -0.3, 0.5}}, {0.4, {0.6, 0.2, 0.3}}}};

Payload rigid(const std::array<PointMass, 4>& points) {
  Payload p;
  p.mass = 0.0;
  p.center_of_mass.setZero();
  for (const auto& [m, r] : points) {
    p.mass += m;
    p.center_of_mass += m * r;
  }
  p.center_of_mass /= p.mass;
  p.inertia.setZero();
  for (const auto& [m, r] : points) {
    const Vector3 d = r - p.center_of_mass;
    p.inertia += m * (d.squaredNorm() * Matrix3::Identity() - d * d.transpose());
  }
  return p;
}

TEST(Payload, ReactionIsTheSumOverPointMasses) {
  const Payload payload = rigid(cloud);
  for (int trial = 0; trial < 200; ++trial) {
    const Vector6 nu = 3.0 * Vector6::Random();
    const Vector6 a = 5.0 * Vector6::Random();
    const Vector3 g = 9.81 * Vector3::Random();
    const Vector3 omega = nu.tail<3>();
    const Vector3 alpha = a.tail<3>();
    const Vector3 at_com = a.head<3>() + omega.cross(nu.head<3>());
    Vector3 force = Vector3::Zero();
    Vector3 moment = Vector3::Zero();
    for (const auto& [m, r] : cloud) {
      const Vector3 d = r - payload.center_of_mass;
      const Vector3 f = m * (at_com + alpha.cross(d) + omega.cross(omega.cross(d)) - g);
      force -= f;
      moment -= r.cross(f);
    }
    const Vector6 w = wrench(payload, nu, a, g);
    EXPECT_LT((w.head<3>() - force).norm(), 1e-12 * (1.0 + force.norm()));
    EXPECT_LT((w.tail<3>() - moment).norm(), 1e-12 * (1.0 + moment.norm() + force.norm()));
  }
}

TEST(Payload, WrenchIsLinearInAccelerationAndGravityApart) {
  const Payload payload = rigid(cloud);
  const Vector6 nu = Vector6::Random();
  const Vector6 a = Vector6::Random();
  const Vector3 none = Vector3::Zero();
  const Vector6 rest = wrench(payload, nu, Vector6::Zero(), none) + wrench_jacobian_acceleration(payload) * a;
  EXPECT_LT((wrench(payload, nu, a, none) - rest).norm(), 1e-12);
}

TEST(Payload, BodiesThatCannotExistAreNamed) {
  Payload p = rigid(cloud);
  EXPECT_EQ(check(p), Status::ok);
  p.mass = 0.0;
  EXPECT_EQ(check(p), Status::not_positive);
  p.mass = 1.0;
  p.inertia = Vector3(1.0, 1.0, 2.1).asDiagonal();  // 2.1 > 1 + 1
  EXPECT_EQ(check(p), Status::unphysical_payload);
  p.inertia = Vector3(1.0, 1.0, 2.0).asDiagonal();  // a flat body
  EXPECT_EQ(check(p), Status::ok);
  p.inertia(0, 1) += 0.01;  // and not (1, 0)
  EXPECT_EQ(check(p), Status::unphysical_payload);
  p.inertia(0, 0) = std::nan("");
  EXPECT_EQ(check(p), Status::not_finite);
}

}  // namespace
}  // namespace truewrench
