// The contact wrench: kernels, derivative by every parameter, tare.
#include "contact_case.hpp"
#include "truewrench/contact.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace truewrench {
namespace {

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

// Where the motion's stamps are later, its samples of the moment are, too.
TEST(Contact, DelayIsWhenItsWrenchIsKnown) {
  for (const double later : {-3e-3, 0.0, 3e-3}) {
    contact::Settings s = settings_of(6, Feels::payload_on_sensor, false);
    s.time_offset = later;
    Contact c;
    ASSERT_EQ(c.configure(s, 0.02), Status::ok);
    ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
    fill(c, s, 60, Vector6::Zero());
    ContactWrench out;
    const auto late = std::llround(1e9 * c.delay());
    EXPECT_EQ(c.evaluate(58 * period - late, out), ContactState::ok) << later;
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

// Of a ring that is full, the place of the next sample is that of the oldest.
TEST(Contact, ARefusedSampleTakesNoOthersPlace) {
  constexpr int capacity = 64;
  Contact c;
  ASSERT_EQ(c.configure(settings_of(6, Feels::payload_on_sensor, false), 0.02, false, capacity), Status::ok);
  ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
  Vector6 raw = Vector6::Constant(0.5);
  for (std::int64_t k = 0; k < capacity; ++k) {
    ASSERT_EQ(c.add_raw(2'000'000 * k, raw.data(), k), Status::ok);
    ASSERT_EQ(
        c.add_motion(2'000'000 * k, Vector6::Zero(), Vector3(0, 0, -9.81), Matrix3::Identity(), k, true),
        Status::ok);
  }
  ContactWrench before, after;
  ASSERT_EQ(c.evaluate_pose(0, before), ContactState::ok);
  raw[3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(c.add_raw(2'000'000 * capacity, raw.data(), capacity), Status::not_finite);
  ASSERT_EQ(c.evaluate_pose(0, after), ContactState::ok);
  EXPECT_EQ(after.wrench, before.wrench);
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
  s.covariance(0, 1) = s.covariance(1, 0) = -1.1 * std::sqrt(s.covariance(0, 0) * s.covariance(1, 1));
  EXPECT_EQ(c.configure(s, 0.02), Status::not_positive);
  s = good;
  s.twist_noise(2, 2) = -1e-9;
  EXPECT_EQ(c.configure(s, 0.02), Status::not_positive);
  s = good;
  s.time_offset_std = -1e-3;
  EXPECT_EQ(c.configure(s, 0.02), Status::not_positive);
  s = good;
  s.slow_error = Vector6::Constant(-1e-3);
  EXPECT_EQ(c.configure(s, 0.02), Status::not_positive);
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
  EXPECT_EQ(c.set_periods(1e-3, std::numeric_limits<double>::infinity()), Status::not_finite);
  s = good;
  s.offset_time_ns = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(Contact().configure(s, 0.02), Status::not_finite);
  EXPECT_EQ(c.set_periods(1e-6, 1e-6), Status::wrong_size);  // more samples than are kept
  ASSERT_EQ(c.set_periods(2e-3, 2e-3), Status::ok);
  EXPECT_EQ(c.add_raw(5, raw.data()), Status::ok);
  EXPECT_EQ(c.add_raw(5, raw.data()), Status::not_increasing);
  using Stamp = std::numeric_limits<std::int64_t>;  // whose differences are no numbers
  EXPECT_EQ(c.add_raw(Stamp::max(), raw.data()), Status::not_increasing);
  EXPECT_EQ(c.evaluate(Stamp::min(), out), ContactState::gap);
  const Vector6 bad = Vector6::Constant(std::numeric_limits<double>::infinity());
  EXPECT_EQ(c.add_raw(6, bad.data()), Status::not_finite);
  EXPECT_EQ(c.add_motion(6, bad, Vector3::Zero(), Matrix3::Zero()), Status::not_finite);
}

}  // namespace
}  // namespace truewrench
