// Rows of the contact wrench, and a tare, neither allocate nor throw.
#include "no_allocation.hpp"

#include "truewrench/contact/rows.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

void contact_does_not_allocate(int n) {
  contact::Settings s;
  s.sensor.gain = Eigen::MatrixXd::Identity(n, 6) + 0.1 * Eigen::MatrixXd::Ones(n, 6);
  s.sensor.offset = Eigen::VectorXd::Zero(n);
  s.sensor.noise = Eigen::VectorXd::Ones(n);
  s.covariance = 1e-4 * Eigen::MatrixXd::Identity(7 * n + 15, 7 * n + 15);
  s.time_offset_std = 1e-3;
  s.temperature_slope_std = s.quadratic_std = Eigen::VectorXd::Constant(n, 1e-3);
  s.full_scale = Eigen::VectorXd::Ones(n);
  for (const bool newest : {false, true}) {
    ContactRows rows;
    ASSERT_EQ(rows.configure(s, 0.02, newest, false, 1024), Status::ok);
    const Eigen::VectorXd raw = 0.01 * Eigen::VectorXd::Ones(n);
    int given = 0;
    Tare tare = Tare::nothing;
    const int count = allocations_in([&] {
      for (std::int64_t i = 0; i < 1000; ++i) {
        const ContactRow row{2'000'000 * i, raw.data(),
                             Vector6::Constant(0.01 * std::sin(0.05 * static_cast<double>(i))),
                             Vector3::Zero(), Matrix3::Identity()};
        static_cast<void>(rows.feed(row, [&](std::int64_t, const ContactWrench&) { ++given; }));
      }
      tare = rows.contact.tare();
    });
    EXPECT_EQ(count, 0);
    EXPECT_GT(given, 950);
    EXPECT_EQ(tare, Tare::accepted);
  }
}

TEST(NoAllocation, ContactRowsAndTare) {
  contact_does_not_allocate(6);
  contact_does_not_allocate(8);
}

}  // namespace
}  // namespace truewrench
