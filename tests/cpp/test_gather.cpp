// Rows that stand for many samples: their sums are those of the samples, what no cubic takes is kept.
#include "truewrench/estimation/gather.hpp"

#include <gtest/gtest.h>

#include <random>

namespace truewrench {
namespace {

constexpr int samples = 400;
constexpr double rate = 1000.0;  // [Hz]

RecordedLog record() {
  std::mt19937 draw(1);
  std::normal_distribution<double> normal;
  RecordedLog log;
  log.time.resize(samples);
  log.raw.resize(samples, 6);
  for (int k = 0; k < samples; ++k) {
    log.time[k] = k / rate + 1e-5 * std::sin(static_cast<double>(k));  // no even sampling
    for (int c = 0; c < 6; ++c) log.raw(k, c) = std::sin(3.0 * log.time[k] + c) + 1e-3 * normal(draw);
  }
  MotionStream motion;
  motion.time = log.time;
  motion.value = log.raw;
  motion.sigma = Eigen::VectorXd::Constant(6, 1e-3);
  motion.group = Eigen::VectorXi::Zero(6);
  log.motion.push_back(motion);
  return log;
}

const Eigen::VectorXd noise = Eigen::VectorXd::Constant(6, 1e-3);

double cubic(double t) { return 0.3 + 2.0 * t - 5.0 * t * t + 40.0 * t * t * t; }

TEST(Gather, SumsOfSquaresAreThoseOfTheSamples) {
  const RecordedLog log = record();
  const auto rows = gathered(log, noise);
  ASSERT_NE(rows, nullptr);
  EXPECT_LT(rows->time.size(), samples / 4);
  for (int c = 0; c < 6; ++c) {
    double of_samples = 0.0, of_rows = 0.0, of_motion = 0.0;
    for (int k = 0; k < samples; ++k) of_samples += std::pow(log.raw(k, c) - cubic(log.time[k]), 2);
    for (Eigen::Index k = 0; k < rows->time.size(); ++k)
      of_rows += rows->size[k] * std::pow(rows->raw(k, c) - cubic(rows->time[k]), 2) + rows->remainder(k, c);
    const MotionStream& m = rows->motion[0];
    for (Eigen::Index k = 0; k < m.time.size(); ++k)
      of_motion += m.size[k] * std::pow(m.value(k, c) - cubic(m.time[k]), 2) + m.remainder(k, c);
    EXPECT_NEAR(of_rows, of_samples, 1e-9 * of_samples);
    EXPECT_NEAR(of_motion, of_samples, 1e-9 * of_samples);
  }
  EXPECT_NEAR(rows->size.sum(), samples, 1e-9 * samples);
  for (Eigen::Index k = 1; k < rows->time.size(); ++k) EXPECT_GT(rows->time[k], rows->time[k - 1]);
}

TEST(Gather, WhatStandsOutOfItsWindowIsLeftOutAndNamed) {
  RecordedLog log = record();
  log.raw(57, 2) += 0.05;
  log.raw(233, 0) -= 0.2;
  log.raw(222, 1) += 0.1;
  const auto rows = gathered(log, noise);
  EXPECT_EQ(rows->spikes, (std::vector<Eigen::Index>{57, 222, 233}));
  EXPECT_NEAR(rows->size.sum(), samples - 3, 1e-9 * samples);
  for (Eigen::Index k = 0; k < rows->time.size(); ++k)
    EXPECT_NEAR(rows->raw(k, 2), std::sin(3.0 * rows->time[k] + 2.0), 5e-3);
}

TEST(Gather, ASampleWithAMissingChannelStaysARowOfItsOwn) {
  RecordedLog log = record();
  log.raw(105, 3) = std::nan("");
  const auto rows = gathered(log, noise);
  Eigen::Index alone = -1;
  for (Eigen::Index k = 0; k < rows->time.size(); ++k)
    if (std::isnan(rows->raw(k, 3))) alone = k;
  ASSERT_GE(alone, 0);
  EXPECT_EQ(rows->time[alone], log.time[105]);
  EXPECT_EQ(rows->raw(alone, 1), log.raw(105, 1));
  EXPECT_EQ(rows->size[alone], 1.0);
  EXPECT_NEAR(rows->size.sum(), samples, 1e-9 * samples);
}

TEST(Gather, ADeadChannelStaysAbsent) {
  RecordedLog log = record();
  for (int k = 0; k < samples; ++k) log.raw(k, 4) = std::nan("");
  const auto rows = gathered(log, noise);
  EXPECT_LT(rows->time.size(), samples / 4);
  for (Eigen::Index k = 0; k < rows->time.size(); ++k) {
    EXPECT_TRUE(std::isnan(rows->raw(k, 4)));
    EXPECT_TRUE(std::isfinite(rows->raw(k, 5)));
  }
}

TEST(Gather, SlowLogsAreLeftAsTheyAre) {
  RecordedLog log = record();
  log.time *= 10.0;
  log.motion[0].time *= 10.0;
  EXPECT_EQ(gathered(log, noise), nullptr);
}

}  // namespace
}  // namespace truewrench
