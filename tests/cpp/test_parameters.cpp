// Which parameters logs share.
#include "truewrench/model/gravity.hpp"
#include "truewrench/model/parameters.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

Statement in_gravity() {
  Statement rig;
  rig.noise = Eigen::VectorXd::Constant(6, 1e-3);
  rig.nominal = RowMatrix::Identity(6, 6);
  rig.offset_prior = Eigen::VectorXd::Constant(6, 0.1);
  rig.gravity << 0.0, 0.0, -9.81;
  rig.tilt_prior = 3.5e-3;
  rig.body_prior.emplace_back(Eigen::Matrix<double, 10, 1>::Constant(0.01));
  return rig;
}

TEST(Layout, GravityIsTiltedInTheRootFrameOfALogOrInTheOneThatLogsShare) {
  const Statement rig = in_gravity();
  RecordedLog shared, alone;
  shared.motion.resize(1);
  alone = shared;
  alone.own_roots = {0.0};
  const Layout layout(rig, {&alone, &shared, &alone, &shared}, {});
  const auto tilt = [&](std::size_t l) { return layout.in_theta(l).tilt; };
  EXPECT_EQ(tilt(1), tilt(3));
  EXPECT_EQ((std::vector<int>{tilt(0) + 2, tilt(0) + 4}), (std::vector<int>{tilt(1), tilt(2)}));
  for (const int at : {tilt(0), tilt(1), tilt(2)})
    for (int axis = 0; axis < 2; ++axis) EXPECT_EQ(layout.sigma()[at + axis], rig.tilt_prior);
  EXPECT_EQ(layout.in_theta(0).b, tilt(2) + 2);
}

TEST(Layout, OfOneLogIsTheSameWhosesoeverItsRootFrameIs) {
  const Statement rig = in_gravity();
  RecordedLog log;
  log.motion.resize(1);
  const Layout shared(rig, {&log}, {});
  log.own_roots = {0.0};
  const Layout alone(rig, {&log}, {});
  EXPECT_EQ(alone.log(0).global, shared.log(0).global);
  EXPECT_EQ(alone.in_theta(0).tilt, shared.in_theta(0).tilt);
  EXPECT_EQ(alone.sigma(), shared.sigma());
}

TEST(Layout, EveryRootFrameOfALogHasATiltOfItsOwn) {
  const Statement rig = in_gravity();
  RecordedLog log, shared;
  log.motion.resize(1);
  shared = log;
  log.own_roots = {0.0, 9.0, 11.0};
  const Layout layout(rig, {&log, &shared}, {});
  const int first = layout.in_theta(0).tilt;
  for (const auto& [time, root] : {std::pair{-0.1, 0}, {8.9, 0}, {9.0, 1}, {12.0, 2}}) {
    EXPECT_EQ(layout.in_theta(0).in_root(time).tilt, first + 2 * root) << time;
    EXPECT_EQ(layout.in_theta(1).in_root(time).tilt, layout.tilt) << time;
  }
  EXPECT_EQ(layout.tilt, first + 6);
}

// By s, kappa and gamma, against differences, where samples are late and means of a time.
TEST(Gravity, IsLateByItsParameters) {
  const Statement rig = in_gravity();
  RecordedLog log;
  log.motion.resize(1);
  log.motion[0].time_offset_prior = 0.01;
  const Layout layout(rig, {&log}, {});
  const Columns columns = layout.in_theta(0);
  Eigen::VectorXd theta = layout.mean();
  const int at[3] = {columns.clock[0], columns.clock[0] + 1, columns.gamma};
  const double values[3] = {0.02, 0.3, 0.8}, half_window = 0.04, step = 1e-4;
  for (int i = 0; i < 3; ++i) theta[at[i]] = values[i];
  const Matrix3 R = Eigen::AngleAxisd(0.7, Vector3(1, 2, 3).normalized()).toRotationMatrix();
  Vector6 nu, a;
  nu << 0.1, 0.2, 0.3, 0.9, -0.7, 0.4;
  a << 0.3, 0.1, 0.2, -2.0, 1.5, 3.0;
  const auto felt = [&] { return Gravity(rig, columns, theta.data(), true, half_window).felt(R, nu, a); };
  std::vector<Vector3> by;
  Gravity(rig, columns, theta.data(), true, half_window)
      .by_parameters(R, nu.tail<3>(), a.tail<3>(),
                     [&](const double* x) { by.emplace_back(x[0], x[1], x[2]); });
  for (int i = 0; i < 3; ++i) {
    theta[at[i]] = values[i] + step;
    const Vector3 plus = felt();
    theta[at[i]] = values[i] - step;
    EXPECT_LT((by[static_cast<std::size_t>(i)] - (plus - felt()) / (2.0 * step)).norm(), 1e-6) << i;
    theta[at[i]] = values[i];
  }
  // a mean without a delay adds the second derivative of g
  theta[at[0]] = 0.0;
  const Vector3 g = R * rig.gravity, omega = nu.tail<3>(), alpha = a.tail<3>();
  const Vector3 second = omega.cross(omega.cross(g)) - alpha.cross(g);
  EXPECT_LT((felt() - g - 0.2 * half_window * half_window * second).norm(), 1e-12);
}

}  // namespace
}  // namespace truewrench
