// Steps of the filter and the corrector neither allocate nor throw.
#include "no_allocation.hpp"

#include "truewrench/corrector.hpp"
#include "truewrench/ekf.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

template <bool Offset>
void filter_does_not_allocate() {
  const Payload payload;
  Ekf<Offset> filter(payload, {});
  const Vector6 raw = Vector6::Random();
  const Vector6 twist = Vector6::Random();
  const Vector6 missing = Vector6::Constant(std::numeric_limits<double>::quiet_NaN());
  const Vector3 gravity = Vector3::Zero();
  static_assert(noexcept(filter.predict(0.01)) && noexcept(filter.update(raw, twist, gravity)));
  Status worst = Status::ok;
  double sum = 0.0;
  const int count = allocations_in([&] {
    for (int i = 0; i < 1000; ++i) {
      const Status moved = filter.predict(0.01);
      const Status updated = filter.update(i % 3 == 0 ? missing : raw, i % 5 == 0 ? missing : twist, gravity);
      worst = std::max({worst, moved, updated});
      sum += filter.last_update().nis + filter.state()(12) + filter.covariance()(0, 0) + filter.gain()(0, 0);
    }
  });
  EXPECT_EQ(count, 0);
  EXPECT_EQ(worst, Status::ok);
  EXPECT_TRUE(std::isfinite(sum));
}

template <int N>
void corrector_does_not_allocate(int n) {
  Corrector<N> corrector;
  SensorModel<N> sensor;
  sensor.gain = Eigen::MatrixXd::Identity(n, 6);
  sensor.offset = Eigen::VectorXd::Zero(n);
  sensor.noise = Eigen::VectorXd::Ones(n);
  ASSERT_EQ(corrector.configure(sensor, Eigen::MatrixXd::Identity(7 * n, 7 * n)), Status::ok);
  const Eigen::VectorXd raw = Eigen::VectorXd::Random(n);
  Correction out;
  const double* const samples = raw.data();
  static_assert(noexcept(corrector.step(samples, out)) && noexcept(corrector.covariance(out.wrench)));
  double sum = 0.0;
  const int count = allocations_in([&] {
    for (int i = 0; i < 1000; ++i) {
      if (corrector.step(samples, out) == Status::ok) sum += corrector.covariance(out.wrench)(0, 0);
    }
  });
  EXPECT_EQ(count, 0);
  EXPECT_GT(sum, 0.0);
}

TEST(NoAllocation, FilterStep) { filter_does_not_allocate<false>(); }
TEST(NoAllocation, FilterStepWithOffset) { filter_does_not_allocate<true>(); }
TEST(NoAllocation, CorrectorStep) {
  corrector_does_not_allocate<6>(6);
  corrector_does_not_allocate<Eigen::Dynamic>(9);
}

}  // namespace
}  // namespace truewrench
