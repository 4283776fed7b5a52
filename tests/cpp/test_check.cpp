// Statements and logs that make no sense: told by a status, by both estimators alike, before anything is read.
#include "oracles.hpp"
#include "truewrench/model/check.hpp"
#include "whole_record.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <limits>

namespace truewrench {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN(),
                 inf = std::numeric_limits<double>::infinity();

struct Case {
  Statement rig;
  RecordedLog log;
};

// Six channels of a light payload, and its twist: 4 s at 100 Hz.
Case sound() {
  Case c;
  c.rig.range << 100.0, 100.0, 100.0, 10.0, 10.0, 10.0;
  c.rig.noise = Vector6::Constant(1e-3);
  c.rig.nominal = Matrix6::Identity();
  c.rig.offset_prior = Vector6::Constant(0.1);
  c.rig.body_prior = {Eigen::Matrix<double, 10, 1>::Zero()};
  c.log.payload = {5.0, {0.02, 0.0, 0.1}, Vector3(0.1, 0.12, 0.06).asDiagonal()};
  MotionStream twist;
  twist.sigma = Vector6::Constant(1e-4);
  twist.group.resize(6);
  twist.group << 0, 0, 0, 1, 1, 1;
  constexpr int rows = 400;
  twist.time = Eigen::VectorXd::LinSpaced(rows, 0.0, 3.99);
  c.log.time = twist.time.array() + 0.002;
  twist.value.resize(rows, 6);
  c.log.raw.resize(rows, 6);
  const oracle::Sines motion;
  std::mt19937 random(1);
  for (int k = 0; k < rows; ++k) {
    twist.value.row(k) =
        (motion.twist(twist.time[k]) + 1e-4 * oracle::normal_matrix(random, 6, 1)).transpose();
    const double t = c.log.time[k];
    const Vector6 w = wrench(c.log.payload, motion.twist(t), motion.acceleration(t), Vector3::Zero());
    c.log.raw.row(k) =
        (w.cwiseQuotient(c.rig.range) + 1e-3 * oracle::normal_matrix(random, 6, 1)).transpose();
  }
  c.log.motion = {twist};
  return c;
}

using Change = std::function<void(Case&)>;
struct Told {
  Status status;
  Change change;
};

// `of_samples`: the rest of a log is sound.
void expect(const std::vector<Told>& all, bool of_samples) {
  for (std::size_t i = 0; i < all.size(); ++i) {
    Case c = sound();
    all[i].change(c);
    EXPECT_EQ(check(c.rig, c.log), of_samples ? Status::ok : all[i].status) << i;
    EXPECT_EQ(check_samples(c.rig, c.log), all[i].status) << i;
    if (all[i].status == Status::ok) continue;
    EXPECT_EQ(of_whole_record(c.rig, c.log).status, all[i].status) << i;
  }
}

TEST(Check, WhatIsSound) {
  const Case c = sound();
  EXPECT_EQ(check_samples(c.rig, c.log), Status::ok);
  EXPECT_EQ(of_whole_record(c.rig, c.log).status, Status::ok);
}

TEST(Check, Statements) {
  expect(
      {
          {Status::wrong_size, [](Case& c) { c.rig.noise = Eigen::VectorXd(); }},
          {Status::wrong_size, [](Case& c) { c.rig.noise = Eigen::VectorXd::Ones(max_components + 1); }},
          {Status::wrong_size, [](Case& c) { c.rig.nominal = RowMatrix::Identity(7, 6); }},
          {Status::wrong_size, [](Case& c) { c.rig.nominal = RowMatrix::Identity(6, 5); }},
          {Status::wrong_size, [](Case& c) { c.rig.offset_prior = Eigen::VectorXd::Ones(5); }},
          {Status::wrong_size, [](Case& c) { c.rig.body_prior.clear(); }},
          {Status::not_positive, [](Case& c) { c.rig.noise[2] = 0.0; }},
          {Status::not_positive, [](Case& c) { c.rig.range[2] = -1.0; }},
          {Status::not_positive, [](Case& c) { c.rig.gain_prior = -0.3; }},
          {Status::not_positive, [](Case& c) { c.rig.sign = 2.0; }},
          {Status::not_positive, [](Case& c) { c.rig.offset_prior[5] = -0.1; }},
          {Status::not_positive, [](Case& c) { c.rig.tilt_prior = -1e-3; }},
          {Status::not_positive, [](Case& c) { c.rig.slope_prior = -1e-3; }},
          {Status::not_positive, [](Case& c) { c.rig.body_prior[0][9] = -1e-3; }},
          {Status::not_finite, [](Case& c) { c.rig.noise[0] = nan; }},
          {Status::not_finite, [](Case& c) { c.rig.range[0] = inf; }},
          {Status::not_finite, [](Case& c) { c.rig.nominal(5, 5) = nan; }},
          {Status::not_finite, [](Case& c) { c.rig.gravity[1] = nan; }},
          {Status::not_finite, [](Case& c) { c.rig.gain_prior = nan; }},
          {Status::not_finite, [](Case& c) { c.rig.offset_prior[0] = inf; }},
          {Status::not_finite, [](Case& c) { c.rig.body_prior[0][0] = nan; }},
          {Status::not_finite, [](Case& c) { c.rig.sign = nan; }},
          {Status::not_finite, [](Case& c) { c.rig.gamma_mean = nan; }},
          {Status::ok, [](Case& c) { c.rig.gain_prior = c.rig.offset_prior[0] = 1e200; }},
          {Status::ok, [](Case& c) { c.rig.gain_prior = c.rig.offset_prior[0] = 0.0; }},
      },
      false);
}

TEST(Check, Logs) {
  expect(
      {
          {Status::wrong_size, [](Case& c) { c.log.motion.clear(); }},
          {Status::wrong_size, [](Case& c) { c.log.body = 1; }},
          {Status::wrong_size, [](Case& c) { c.log.body = -1; }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].sigma = Eigen::VectorXd::Ones(5); }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].group = Eigen::VectorXi::Zero(5); }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].group[1] = 6; }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].group[1] = -1; }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].bias_prior = Eigen::VectorXd::Ones(3); }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].derivative = -1; }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].value = RowMatrix::Zero(400, 7); }},
          {Status::not_positive, [](Case& c) { c.log.motion[0].sigma[3] = 0.0; }},
          {Status::not_positive, [](Case& c) { c.log.motion[0].time_offset_prior = -1.0; }},
          {Status::not_positive, [](Case& c) { c.log.motion[0].half_window = -0.1; }},
          {Status::not_positive, [](Case& c) { c.log.half_window = -0.1; }},
          {Status::not_positive, [](Case& c) { c.log.payload.mass = 0.0; }},
          {Status::unphysical_payload, [](Case& c) { c.log.payload.inertia(0, 0) = 1.0; }},
          {Status::unphysical_payload, [](Case& c) { c.log.payload.inertia(0, 1) += 0.02; }},
          {Status::not_finite, [](Case& c) { c.log.motion[0].sigma[3] = nan; }},
          {Status::not_finite, [](Case& c) { c.log.motion[0].clock_mean = nan; }},
          {Status::not_finite, [](Case& c) { c.log.half_window = nan; }},
          {Status::not_finite, [](Case& c) { c.log.motion[0].bias_prior = Vector6::Constant(nan); }},
          {Status::not_finite, [](Case& c) { c.log.point[0] = nan; }},
          {Status::not_finite, [](Case& c) { c.log.payload.mass = nan; }},
          {Status::not_finite, [](Case& c) { c.log.offset_walk = nan; }},
          {Status::wrong_size, [](Case& c) { c.log.offset_walk = 1e-4; }},
          {Status::not_increasing, [](Case& c) { c.log.offset_knots = {1.0, 1.0}; }},
      },
      false);
}

// What once ended the process, or left rows out and said nothing.
TEST(Check, Samples) {
  const auto gravity = [](Case& c) {
    c.rig.gravity = {0.0, 0.0, -9.81};
    c.log.R_sensor_root.resize(c.log.time.size(), 9);
    for (Eigen::Index k = 0; k < c.log.time.size(); ++k)
      c.log.R_sensor_root.row(k) << 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0;
  };
  expect(
      {
          {Status::not_finite, [](Case& c) { c.log.time[100] = nan; }},
          {Status::not_finite, [](Case& c) { c.log.time[399] = inf; }},
          {Status::not_finite, [](Case& c) { c.log.motion[0].time[100] = nan; }},
          {Status::not_increasing, [](Case& c) { std::swap(c.log.time[100], c.log.time[150]); }},
          {Status::not_increasing, [](Case& c) { c.log.time[100] = c.log.time[99]; }},
          {Status::not_increasing, [](Case& c) { c.log.motion[0].time[100] = c.log.motion[0].time[99]; }},
          {Status::wrong_size, [](Case& c) { c.log.time.conservativeResize(300); }},
          {Status::wrong_size, [](Case& c) { c.log.raw = RowMatrix::Zero(400, 5); }},
          {Status::wrong_size, [](Case& c) { c.log.raw = RowMatrix::Zero(400, 0); }},
          {Status::wrong_size, [](Case& c) { c.log.temperature = Eigen::VectorXd::Zero(3); }},
          {Status::wrong_size, [](Case& c) { c.log.R_sensor_root = RowMatrix::Zero(399, 9); }},
          {Status::wrong_size, [](Case& c) { c.log.R_sensor_root = RowMatrix::Zero(400, 0); }},
          {Status::wrong_size, [](Case& c) { c.log.motion[0].time.conservativeResize(300); }},
          {Status::not_configured, [](Case& c) { c.log.source = Source::mapped; }},
          {Status::wrong_size, [](Case& c) { c.rig.gravity = {0.0, 0.0, -9.81}; }},
          {Status::not_finite,
           [&](Case& c) {
             gravity(c);
             c.log.R_sensor_root(7, 4) = nan;
           }},
          {Status::ok, gravity},
          {Status::ok,  // what is not known of a sample that is not there
           [&](Case& c) {
             gravity(c);
             c.log.R_sensor_root(7, 4) = nan;
             c.log.raw.row(7).setConstant(nan);
           }},
          {Status::ok,  // an accelerometer feels it by itself
           [](Case& c) {
             c.rig.gravity = {0.0, 0.0, -9.81};
             c.log.source = Source::imu;
           }},
      },
      true);
}

}  // namespace
}  // namespace truewrench
