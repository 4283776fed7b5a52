// Which parameters logs share.
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

}  // namespace
}  // namespace truewrench
