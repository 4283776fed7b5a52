// The contact wrench: kernels, derivative by every parameter, tare, events, rows.
#include "oracles.hpp"
#include "truewrench/contact/events.hpp"
#include "truewrench/contact/rows.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace truewrench {
namespace {

constexpr std::int64_t period = 2'000'000;  // 500 Hz
constexpr double warmth = 6.0;              // [K] above the reference, where a slope is known

contact::Settings settings_of(int n, Feels feels, bool more) {
  std::mt19937 random(3);
  contact::Settings s;
  Eigen::MatrixXd gain = 0.1 * oracle::normal_matrix(random, n, 6);
  gain.topRows<6>() += Matrix6::Identity();
  s.sensor.gain = gain;
  s.sensor.offset = oracle::normal_matrix(random, n, 1);
  s.sensor.noise = Eigen::VectorXd::LinSpaced(n, 0.1, 0.2);
  s.feels = feels;
  s.mass = 2.0;
  s.center_of_mass = {0.02, -0.03, 0.08};
  s.S << 0.003, 0.004, 0.002, 0.0003, -0.0002, 0.0004;
  s.mounting = {0.1, -0.2, 0.3};
  s.tilt = {0.01, -0.02};
  s.gravity = {0.0, 0.0, -9.81};
  const Eigen::MatrixXd root = 0.002 * oracle::normal_matrix(random, 7 * n + 15, 7 * n + 15);
  s.covariance = root * root.transpose();
  s.offset_walk = Eigen::VectorXd::Constant(n, 0.01);
  s.time_offset_std = 1e-3;
  s.twist_noise = 1e-6 * Matrix6::Identity();
  if (more) {
    s.temperature_slope = Eigen::VectorXd::Constant(n, 0.3);
    s.temperature_slope_std = Eigen::VectorXd::Constant(n, 0.02);
    s.quadratic_std = Eigen::VectorXd::Constant(n, 0.01);
    s.full_scale = Eigen::VectorXd::Constant(n, 100.0);
  }
  return s;
}

// Root to sensor, turning about a fixed axis, so that the angular velocity is its rate.
struct Swing {
  Vector3 axis = Vector3(1.0, 2.0, -1.0).normalized();
  double angle(double t) const { return 0.8 * std::sin(3.0 * t); }
  Matrix3 turn(double t) const {
    return Eigen::AngleAxisd(-angle(t), axis).toRotationMatrix() *
           Eigen::AngleAxisd(0.7, Vector3::UnitY()).toRotationMatrix();
  }
  Vector6 twist(double t) const {
    Vector6 nu;
    nu << 0.3 * std::sin(2.0 * t), 0.2 * std::cos(3.0 * t), 0.1 * std::sin(4.0 * t),
        2.4 * std::cos(3.0 * t) * axis;
    return nu;
  }
  Vector6 acceleration(double t) const {
    Vector6 a;
    a << 0.6 * std::cos(2.0 * t), -0.6 * std::sin(3.0 * t), 0.4 * std::cos(4.0 * t),
        -7.2 * std::sin(3.0 * t) * axis;
    return a;
  }
};

Eigen::VectorXd raw_of(const contact::Settings& s, const Swing& motion, double t,
                       const Vector6& contact_wrench) {
  contact::Matrix3x2 by;
  const Vector3 g = motion.turn(t) * contact::tilted_fall(s.gravity, s.tilt, by);
  const Matrix3 S = contact::symmetric(s.S);
  const Matrix3 inertia = s.mass * (S.trace() * Matrix3::Identity() - S);
  const double sign = s.feels == Feels::payload_on_sensor ? 1.0 : -1.0;
  const Vector6 w = contact_wrench + sign * oracle::wrench(s.mass, s.center_of_mass, inertia, Vector3::Zero(),
                                                           motion.twist(t), motion.acceleration(t), g);
  Matrix3 turns[3];
  const Matrix3 R = contact::channel_turn(s.mounting, turns);
  Vector6 turned;
  turned << R * w.head<3>(), R * w.tail<3>();
  Eigen::VectorXd raw = s.sensor.gain * turned + s.sensor.offset;
  if (s.temperature_slope.size() > 0) raw += warmth * s.temperature_slope;
  return raw;
}

// Samples of both streams from 0 on, sensor and motion at the same stamps.
void fill(Contact& c, const contact::Settings& s, int count, const Vector6& contact_wrench) {
  const Swing motion;
  for (int i = 0; i < count; ++i) {
    const double t = 1e-9 * static_cast<double>(i * period);
    const Eigen::VectorXd raw = raw_of(s, motion, t, contact_wrench);
    ASSERT_EQ(c.add_raw(i * period, raw.data(), i), Status::ok);
    ASSERT_EQ(c.add_motion(i * period, motion.twist(t), motion.turn(t) * s.gravity, motion.turn(t), i),
              Status::ok);
  }
}

TEST(ContactKernel, IsTheOneOfTheLine) {
  const int n = 11;
  const double dt = 2e-3;
  Eigen::VectorXd t(n), a(n), w(n);
  for (int i = 0; i < n; ++i) t[i] = dt * (i - 5);
  contact::line_slope(t.data(), n, a.data());
  EXPECT_NEAR(contact::mean_weights(t.data(), a.data(), n, t.data(), n, w.data()), 1.0, 1e-14);
  Eigen::VectorXd expected = Eigen::VectorXd::Zero(n);
  for (int j = 1; j < n; ++j) {  // means of neighbouring samples, 6 j (n - j) / (n (n^2 - 1))
    const double weight = 6.0 * j * (n - j) / (n * (n * n - 1.0));
    expected[j - 1] += 0.5 * weight;
    expected[j] += 0.5 * weight;
  }
  EXPECT_LT((w - expected).norm(), 1e-14);
}

TEST(ContactKernel, NewestHasNoDelay) {
  const int n = 11;
  Eigen::VectorXd t(n), a(n), w(n);
  for (int i = 0; i < n; ++i) t[i] = 2e-3 * (i - 10);
  contact::parabola(t.data(), n, 1, a.data());
  EXPECT_NEAR(contact::mean_weights(t.data(), a.data(), n, t.data(), n, w.data()), 1.0, 1e-12);
  EXPECT_NEAR(w.dot(t), 0.0, 1e-15);              // first moment, from the newest sample
  EXPECT_NEAR(a.dot(t.cwiseAbs2()), 0.0, 1e-14);  // exact for a parabola
  EXPECT_NEAR(w.norm(), 0.655, 1e-3);
  contact::parabola(t.data(), n, 2, a.data());
  EXPECT_NEAR(a.dot(t.cwiseAbs2()), 2.0, 1e-9);
}

TEST(ContactKernel, OtherStampsOfTheSensor) {
  Eigen::VectorXd t(5), a(5), s(7), w(7);
  t << -0.02, -0.011, 0.0, 0.01, 0.021;
  s << -0.023, -0.015, -0.008, -0.001, 0.006, 0.013, 0.022;
  contact::line_slope(t.data(), 5, a.data());
  EXPECT_NEAR(contact::mean_weights(t.data(), a.data(), 5, s.data(), 7, w.data()), 1.0, 1e-12);
  EXPECT_NEAR(w.sum(), 1.0, 1e-12);
  // of what is linear, the mean is that of the slope's integral: sum a t^2 / 2
  EXPECT_NEAR(w.dot(s), 0.5 * a.dot(t.cwiseAbs2()), 1e-14);
}

TEST(Contact, FindsTheContactAndNothingElse) {
  const Vector6 hit = (Vector6() << 5.0, -3.0, 2.0, 0.2, 0.1, -0.3).finished();
  for (const int n : {6, 8}) {
    for (const Feels feels : {Feels::payload_on_sensor, Feels::sensor_on_payload}) {
      for (const bool newest : {false, true}) {
        const contact::Settings s = settings_of(n, feels, false);
        Contact c;
        ASSERT_EQ(c.configure(s, 0.02, newest), Status::ok);
        ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
        fill(c, s, 60, hit);
        ContactWrench out;
        ASSERT_EQ(c.evaluate(50 * period, out), ContactState::ok);
        EXPECT_LT((out.wrench - hit).norm(), newest ? 6e-3 : 2e-3);  // what linear interpolation leaves
        EXPECT_EQ(c.delay(), newest ? 0.0 : 0.01);
        EXPECT_EQ(c.evaluate(58 * period, out), newest ? ContactState::ok : ContactState::waiting);
      }
    }
  }
}

TEST(Contact, DerivativeIsThatOfDifferences) {
  for (const int n : {6, 8}) {
    for (const Feels feels : {Feels::payload_on_sensor, Feels::sensor_on_payload}) {
      const contact::Settings s = settings_of(n, feels, true);
      Contact c;
      ASSERT_EQ(c.configure(s, 0.02), Status::ok);
      ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
      c.set_temperature(s.temperature_reference + warmth);
      fill(c, s, 60, Vector6::Constant(3.0));
      ContactWrench out;
      ASSERT_EQ(c.evaluate(40 * period, out), ContactState::ok);
      const Eigen::MatrixXd found = c.jacobian();
      const Eigen::VectorXd theta = c.theta();
      for (int k = 0; k < theta.size(); ++k) {
        const double step = 1e-6;
        Eigen::VectorXd high = theta, low = theta;
        high[k] += step;
        low[k] -= step;
        const Vector6 difference = (c.contact_at(high) - c.contact_at(low)) / (2.0 * step);
        const double scale = 1.0 + difference.norm();
        // for n > 6 the weighted inverse moves within what it leaves out, which is noise
        EXPECT_LT((found.col(k).head<6>() - difference).norm(), (k < 6 * n && n > 6 ? 1e-3 : 1e-6) * scale)
            << "parameter " << k << " of " << n << " channels";
      }
    }
  }
}

TEST(Contact, CovarianceIsTheDenseOne) {
  const contact::Settings s = settings_of(6, Feels::payload_on_sensor, false);
  Contact c;
  ASSERT_EQ(c.configure(s, 0.02), Status::ok);
  ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
  fill(c, s, 60, Vector6::Zero());
  ContactWrench out;
  ASSERT_EQ(c.evaluate(40 * period, out), ContactState::ok);
  const int p = c.places().size();
  Eigen::MatrixXd P(p, p);
  for (int i = 0; i < p; ++i)
    for (int j = 0; j < p; ++j) P(i, j) = c.covariance(i, j);
  const Eigen::MatrixXd J = c.jacobian().topRows<6>();
  const Eigen::MatrixXd rest = out.covariance - J * P * J.transpose();
  // noise under the kernel and the walk of 80 ms; both small beside it, both positive definite
  EXPECT_GT(Eigen::LLT<Eigen::MatrixXd>(rest).info() == Eigen::Success, 0);
  EXPECT_LT((rest - rest.transpose()).norm(), 1e-12);
}

TEST(Contact, TareIsAnUpdateAndRefusedInContact) {
  contact::Settings s = settings_of(6, Feels::payload_on_sensor, false);
  contact::Settings drifted = s;
  drifted.sensor.offset.array() += 0.5;
  Contact c;
  EXPECT_EQ(c.tare(), Tare::nothing);
  s.offset_walk.setConstant(3.0);
  ASSERT_EQ(c.configure(s, 0.02), Status::ok);
  ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
  fill(c, drifted, 60, Vector6::Zero());
  ContactWrench before, after;
  ASSERT_EQ(c.evaluate(40 * period, before), ContactState::ok);
  EXPECT_LT(before.chi2, contact_limit);
  ASSERT_EQ(c.tare(), Tare::accepted);
  EXPECT_EQ(c.tare(), Tare::nothing);
  ASSERT_EQ(c.evaluate(40 * period, after), ContactState::ok);
  EXPECT_LT(after.wrench.norm(), 0.25 * before.wrench.norm());
  EXPECT_LT(after.covariance.trace(), before.covariance.trace());

  Contact hit;
  ASSERT_EQ(hit.configure(s, 0.02), Status::ok);
  ASSERT_EQ(hit.set_periods(2e-3, 2e-3), Status::ok);
  fill(hit, s, 60, Vector6::Constant(40.0));
  ASSERT_EQ(hit.evaluate(40 * period, before), ContactState::ok);
  EXPECT_EQ(hit.tare(), Tare::in_contact);
}

TEST(Contact, BadInputIsRefused) {
  const contact::Settings good = settings_of(6, Feels::payload_on_sensor, false);
  contact::Settings s = good;
  Contact c;
  ContactWrench out;
  const Vector6 raw = Vector6::Zero();
  EXPECT_EQ(c.add_raw(0, raw.data()), Status::not_configured);
  EXPECT_EQ(c.evaluate(0, out), ContactState::not_configured);
  s.mass = 0.0;
  EXPECT_EQ(c.configure(s, 0.02), Status::not_positive);
  s = good;
  s.covariance.resize(3, 3);
  EXPECT_EQ(c.configure(s, 0.02), Status::wrong_size);
  s = good;
  s.center_of_mass[1] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(c.configure(s, 0.02), Status::not_finite);
  s = good;
  s.sensor.gain.row(2).setZero();
  EXPECT_EQ(c.configure(s, 0.02), Status::singular);
  EXPECT_EQ(c.configure(good, -1.0), Status::not_positive);
  ASSERT_EQ(c.configure(good, 0.02), Status::ok);
  EXPECT_EQ(c.evaluate(0, out), ContactState::not_configured);  // no periods yet
  EXPECT_EQ(c.set_periods(0.0, 1.0), Status::not_positive);
  EXPECT_EQ(c.set_periods(1e-6, 1e-6), Status::wrong_size);  // more samples than are kept
  ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
  EXPECT_EQ(c.add_raw(5, raw.data()), Status::ok);
  EXPECT_EQ(c.add_raw(5, raw.data()), Status::not_increasing);
  const Vector6 bad = Vector6::Constant(std::numeric_limits<double>::infinity());
  EXPECT_EQ(c.add_raw(6, bad.data()), Status::not_finite);
  EXPECT_EQ(c.add_motion(6, bad, Vector3::Zero(), Matrix3::Zero()), Status::not_finite);
}

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
