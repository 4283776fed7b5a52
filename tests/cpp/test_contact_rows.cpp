// The contact wrench of the rows of a table, and its events.
#include "contact_case.hpp"
#include "truewrench/contact/even_stamps.hpp"
#include "truewrench/contact/events.hpp"
#include "truewrench/contact/rows.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <utility>
#include <vector>

namespace truewrench {
namespace {

TEST(ContactEvents, AreMergedAndPlaced) {
  ContactEvents events;
  ContactWrench w;
  w.wrench << 0.0, 0.0, 10.0, 0.5, -0.2, 0.7;
  w.chi2 = 100.0;
  const Vector3 c(0.0, 0.0, 0.1);
  w.time_ns = 0;
  EXPECT_FALSE(events.step(w, c));
  w.time_ns = 90'000'000;
  EXPECT_FALSE(events.step(w, c));
  w.time_ns = 191'000'000;
  w.chi2 = 6.0;
  const auto event = events.step(w, c);
  ASSERT_TRUE(event);
  EXPECT_EQ(event->end_ns, 90'000'000);
  EXPECT_DOUBLE_EQ(event->peak_force, 10.0);
  EXPECT_LT((event->point - Vector3(0.02, 0.05, 0.1)).norm(), 1e-12);
  EXPECT_FALSE(events.finish());
}

// Numbers of the rows of one table at some stamps [ns] that get their wrench; nothing touches the tool.
std::vector<std::int64_t> rows_given(const std::vector<std::int64_t>& stamps, double window, double& worst) {
  const contact::Settings s = settings_of(6, Feels::payload_on_sensor, false);
  ContactRows rows;
  EXPECT_EQ(rows.configure(s, window, false, false, 8192), Status::ok);
  const Swing motion;
  std::vector<std::int64_t> given;
  const auto take = [&](std::int64_t number, const ContactWrench& w) {
    given.push_back(number);
    worst = std::max(worst, w.wrench.norm());
  };
  for (const std::int64_t stamp : stamps) {
    const double t = 1e-9 * static_cast<double>(stamp);
    const Eigen::VectorXd raw = raw_of(s, motion, t, Vector6::Zero());
    EXPECT_EQ(
        rows.feed({stamp, raw.data(), motion.twist(t), motion.turn(t) * s.gravity, motion.turn(t)}, take),
        Status::ok);
  }
  rows.finish(take);
  return given;
}

TEST(ContactRows, KernelsMayBeLongerThanWhatTellsThePeriods) {
  for (const auto& [rate, window] : {std::pair{2000, 0.02}, {4000, 0.02}, {500, 0.1}, {1000, 0.02}}) {
    std::vector<std::int64_t> stamps;
    for (int i = 0; i < 600; ++i) stamps.push_back(i * (1'000'000'000LL / rate));
    double worst = 0.0;
    const std::vector<std::int64_t> given = rows_given(stamps, window, worst);
    const auto half = static_cast<std::int64_t>(std::lround(0.5 * window * rate));
    ASSERT_EQ(static_cast<std::int64_t>(given.size()), 600 - 2 * half) << rate;
    EXPECT_EQ(given.front(), half);
    EXPECT_TRUE(std::is_sorted(given.begin(), given.end()));
    EXPECT_LT(worst, 0.05 * window / 0.02);  // what means over a kernel leave of products
  }
}

TEST(ContactRows, ARowOfNothingIsNone) {
  ContactRows rows;
  ASSERT_EQ(rows.configure(settings_of(6, Feels::payload_on_sensor, false), 0.02, false, false, 64),
            Status::ok);
  int given = 0;
  for (std::int64_t k = 0; k < 100; ++k) {
    ContactRow row;  // neither channels nor motion
    row.time_ns = 1'000'000 * k;
    EXPECT_EQ(rows.feed(row, [&](std::int64_t, const ContactWrench&) { ++given; }), Status::ok);
  }
  EXPECT_EQ(given, 0);
}

TEST(ContactRows, SamplesMissingWhileThePeriodsAreLearntCostThemselvesAlone) {
  for (const int missing : {1, 5, 12, 19}) {
    std::vector<std::int64_t> stamps;
    for (int i = 0; i < 400; ++i) stamps.push_back((i + (i < missing ? 0 : 15)) * 1'000'000LL);
    double worst = 0.0;
    const std::vector<std::int64_t> given = rows_given(stamps, 0.02, worst);
    EXPECT_EQ(given.size(), 400U - missing - 20U) << missing;
    EXPECT_LT(worst, 0.05);
  }
}

TEST(ContactRows, ABurstAtTheStartIsNoPeriod) {
  std::vector<std::int64_t> stamps;
  for (int i = 0; i < 30; ++i) stamps.push_back(i * 50'000LL);
  for (int i = 0; i < 400; ++i) stamps.push_back((i + 5) * 1'000'000LL);
  double worst = 0.0;
  const std::vector<std::int64_t> given = rows_given(stamps, 0.02, worst);
  EXPECT_GE(given.size(), 400U - 20U);
  EXPECT_EQ(given.back(), 430 - 11);
  EXPECT_LT(worst, 0.05);
}

TEST(EvenStamps, OneByOneStaysAndPacketsLieOnALine) {
  contact::EvenStamps plain;
  for (int i = 0; i < 500; ++i) {  // scattered by up to 0.4 of the period
    const std::int64_t time = i * 2'000'000LL + (i * 7919 % 800) * 1'000LL;
    EXPECT_EQ(plain.stamp(time), time);
  }
  for (const int size : {4, 8, 16, 24}) {
    contact::EvenStamps even;
    std::int64_t before = -1;
    for (int i = 0; i < 3000; ++i) {
      // taken every 2 ms; a packet comes with its last sample, up to 0.5 ms later
      const int last = (i / size + 1) * size - 1;
      const std::int64_t time = last * 2'000'000LL + (last * 7919 % 500) * 1'000LL - (last - i) * 20'000LL;
      const std::int64_t found = even.stamp(time);
      EXPECT_GT(found, before);
      before = found;
      if (i > 1000) {
        EXPECT_LT(std::abs(found - i * 2'000'000LL - 250'000), 300'000) << size << " " << i;
      }
    }
    EXPECT_TRUE(even.packets());
  }
}

TEST(EvenStamps, TheLineBeginsAnewWherePacketsAreLost) {
  contact::EvenStamps even;
  for (int i = 0; i < 2000; ++i) {
    if (i / 8 % 50 == 49) continue;
    const int last = (i / 8 + 1) * 8 - 1;
    const std::int64_t found = even.stamp(last * 2'000'000LL - (last - i) * 20'000LL);
    if (i > 200 && i / 8 % 50 > 1) {
      EXPECT_LT(std::abs(found - i * 2'000'000LL), 300'000) << i;
    }
  }
}

TEST(ContactRows, ASensorWhoseSamplesComeInPackets) {
  const contact::Settings s = settings_of(6, Feels::payload_on_sensor, false);
  const Swing motion;
  const Vector6 nothing = Vector6::Constant(std::nan(""));
  const Eigen::VectorXd unread = Eigen::VectorXd::Constant(6, std::nan(""));
  ContactRows rows;
  ASSERT_EQ(rows.configure(s, 0.02, false, false, 8192), Status::ok);
  std::int64_t given = 0, fed = 0;
  double worst = 0.0;
  const auto take = [&](std::int64_t, const ContactWrench& w) {
    if (++given > 200) worst = std::max(worst, w.wrench.norm());
  };
  for (int i = 0; i < 2000; ++i) {  // both at 500 Hz; 16 of the sensor at once, just after the last of them
    const std::int64_t time = i * 2'000'000LL;
    const double t = 1e-9 * static_cast<double>(time);
    ContactRow row{time, unread.data(), motion.twist(t), motion.turn(t) * s.gravity, motion.turn(t)};
    EXPECT_EQ(rows.feed(row, take), Status::ok);
    ++fed;
    for (int j = 15; i % 16 == 15 && j >= 0; --j, ++fed) {
      const double then = t - 2e-3 * j;
      const Eigen::VectorXd raw = raw_of(s, motion, then, Vector6::Zero());
      ContactRow read{time + (16 - j) * 20'000LL, raw.data(), nothing, nothing.head<3>(),
                      Matrix3::Constant(std::nan(""))};
      EXPECT_EQ(rows.feed(read, take), Status::ok);
    }
  }
  rows.finish(take);
  EXPECT_GT(given, fed - 300);
  EXPECT_LT(worst, 0.1);
}

TEST(ContactRows, PosesAndStreamsOfTwoRates) {
  const contact::Settings s = settings_of(6, Feels::payload_on_sensor, false);
  ContactRows rows;
  ASSERT_EQ(rows.configure(s, 0.02, false, false, 1024), Status::ok);
  const Swing motion;
  const Vector6 nothing = Vector6::Constant(std::nan(""));
  int given = 0;
  double worst = 0.0;
  for (int i = 0; i < 600; ++i) {  // sensor at 1 kHz, motion at 250 Hz
    const double t = 1e-3 * i;
    const Eigen::VectorXd raw = raw_of(s, motion, t, Vector6::Zero());
    ContactRow row{i * 1'000'000LL, raw.data(), nothing, nothing.head<3>(), Matrix3::Constant(std::nan(""))};
    if (i % 4 == 0) {
      row.twist = motion.twist(t);
      row.fall = motion.turn(t) * s.gravity;
      row.R_sensor_root = motion.turn(t);
    }
    ASSERT_EQ(rows.feed(row,
                        [&](std::int64_t, const ContactWrench& w) {
                          ++given;
                          worst = std::max(worst, w.wrench.norm());
                        }),
              Status::ok);
  }
  EXPECT_GT(given, 560);
  EXPECT_LT(worst, 0.02);  // what linear interpolation of the motion over 4 ms leaves of 20 N

  ASSERT_EQ(rows.configure(s, 0.02, false, false, 1024), Status::ok);
  given = 0;
  for (int i = 0; i < 5; ++i) {
    const Matrix3 turn = motion.turn(0.1 * i);
    contact::Matrix3x2 by;
    Vector6 w =
        oracle::wrench(s.mass, s.center_of_mass, Matrix3::Identity(), Vector3::Zero(), Vector6::Zero(),
                       Vector6::Zero(), turn * contact::tilted_fall(s.gravity, s.tilt, by));
    Matrix3 turns[3];
    const Matrix3 R = contact::channel_turn(s.mounting, turns);
    w << (R * w.head<3>()).eval(), (R * w.tail<3>()).eval();
    const Eigen::VectorXd raw = s.sensor.gain * w + s.sensor.offset;
    const auto count = [&](std::int64_t, const ContactWrench& pose) {
      ++given;
      EXPECT_LT(pose.wrench.norm(), 1e-10);
    };
    ASSERT_EQ(rows.feed({i * 3'000'000'000LL, raw.data(), Vector6::Zero(), turn * s.gravity, turn}, count),
              Status::ok);
    if (i == 4) rows.finish(count);
  }
  EXPECT_EQ(given, 5);
}

}  // namespace
}  // namespace truewrench
