// The estimator of a control loop neither allocates nor throws once it stands.
#include "no_allocation.hpp"

#include "incremental_case.hpp"

#include <gtest/gtest.h>

#include <limits>

namespace truewrench {
namespace {

// `gravity`: it acts along an attitude that never turns, whatever sense that makes, and cells are missing.
void incremental_does_not_allocate(bool gravity) {
  LoopCase loop(1);
  const Matrix3 R = Matrix3::Identity();
  if (gravity) {
    loop.rig.gravity = {0.0, 0.0, -9.81};
    loop.rig.tilt_prior = 5e-3;
    loop.rig.body_prior[0].setConstant(1e-3);
    loop.about.motion[0].time_offset_prior = 1e-3;
    loop.about.own_roots = {0.0};
  }
  Incremental online(loop.rig, loop.about, {.rate = LoopCase::motion_rate, .discrepancy = 0.0});
  std::vector<std::pair<bool, double>> order;
  std::vector<Vector6> values;
  loop.run(12.0, [&](bool sensor, double t, const Vector6& value) {
    if (t > 7.0 && t < 7.6) return;  // a gap, after which a second stretch begins
    order.emplace_back(sensor, t);
    values.push_back(value);
    if (gravity && values.size() % 5 == 0) values.back()[2] = std::numeric_limits<double>::quiet_NaN();
  });
  static_assert(noexcept(online.push_raw(0.0, nullptr)) && noexcept(online.push_motion(0, 0.0, nullptr)) &&
                noexcept(online.finish()) && noexcept(online.next_root()) && noexcept(online.covariance()));
  Status worst = Status::ok;
  loop.run(5.0, [&](bool sensor, double t, const Vector6& value) {  // a log before
    worst = std::max(
        worst, sensor ? online.push_raw(t, value.data(), R.data()) : online.push_motion(0, t, value.data()));
  });
  ASSERT_EQ(online.next_log(loop.about), Status::ok);
  double sum = 0.0;
  const int count = allocations_in([&] {
    for (std::size_t k = 0; k < values.size(); ++k) {
      const auto [sensor, t] = order[k];
      if (gravity && t > 7.6 && order[k - 1].second < 7.6) worst = std::max(worst, online.next_root());
      worst = std::max(worst, sensor ? online.push_raw(t, values[k].data(), R.data())
                                     : online.push_motion(0, t, values[k].data()));
      if (k % 500 == 0 && online.ready()) sum += online.covariance()(0, 0) + online.gain()(0, 0);
    }
    worst = std::max(worst, online.finish());
  });
  EXPECT_EQ(count, 0);
  EXPECT_EQ(worst, Status::ok);
  EXPECT_TRUE(std::isfinite(sum));
  EXPECT_GT(online.samples(), 3000);
}

TEST(NoAllocation, Incremental) {
  incremental_does_not_allocate(false);
  incremental_does_not_allocate(true);
}

}  // namespace
}  // namespace truewrench
