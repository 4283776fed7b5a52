// Contacts and spikes found in residuals, and the false alarms that noise gives.
#include "truewrench/contact.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

namespace truewrench {
namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Rows noise(int samples, unsigned seed) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> normal;
  return Rows::NullaryExpr(samples, 6, [&]() { return normal(generator); });
}

TEST(NormalQuantile, InvertsTheTailOfTheNormalDistribution) {
  for (const double p : {0.05, 1e-3, 1e-7, 1e-12}) {
    EXPECT_NEAR(0.5 * std::erfc(normal_quantile(p) / std::numbers::sqrt2) / p, 1.0, 1e-9) << p;
  }
}

TEST(ChiSquareAt, InvertsTheDeviate) {
  for (const double degrees : {1.0, 6.0, 5000.0}) {
    for (const double z : {-0.5, 0.0, 3.0, 7.0}) {
      EXPECT_NEAR(chi_square_deviate(chi_square_at(z, degrees), degrees), z, 1e-9) << degrees;
    }
  }
}

TEST(DisturbanceScan, NoiseAloneGivesNoMoreAlarmsThanItIsAllowed) {
  int alarms = 0;
  for (unsigned seed = 0; seed < 200; ++seed) {
    const DisturbanceScan scan(noise(1000, seed));
    alarms += static_cast<int>(scan.find(300, 0.05).size());
  }
  EXPECT_LE(alarms, 22);  // 10 expected, and 99.9% of what chance makes of them
}

TEST(DisturbanceScan, FindsAShiftOfThreeSigmaWhereItIs) {
  Rows r = noise(1000, 7);
  r.middleRows(400, 50).array() += 3.0;
  const std::vector<Disturbance> found = DisturbanceScan(r).find(300, 0.01);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_NEAR(static_cast<double>(found[0].first), 400.0, 2.0);
  EXPECT_NEAR(static_cast<double>(found[0].last), 450.0, 2.0);
}

TEST(DisturbanceScan, LeavesTheShadowOfADisturbanceToTheNextLook) {
  Rows r = noise(1000, 8);
  r.middleRows(400, 50).array() += 6.0;
  r.middleRows(370, 30).array() -= 2.0;  // the motion bent towards it
  r.middleRows(450, 30).array() -= 2.0;
  const std::vector<Disturbance> found = DisturbanceScan(r).find(300, 0.01);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_NEAR(static_cast<double>(found[0].first), 400.0, 2.0);
  EXPECT_NEAR(static_cast<double>(found[0].last), 450.0, 2.0);
}

TEST(DisturbanceScan, FindsASpikeOfOneSampleInOneComponent) {
  Rows r = noise(2000, 9);
  r(1234, 4) += 12.0;
  const std::vector<Disturbance> found = DisturbanceScan(r).find(600, 0.01);
  ASSERT_FALSE(found.empty());
  EXPECT_EQ(found[0].first, 1234U);
  EXPECT_EQ(found[0].last, 1235U);
}

TEST(DisturbanceScan, FindsChatterWhoseMeanIsThatOfNoise) {
  Rows r = noise(2000, 10);
  for (int k = 800; k < 900; ++k) r.row(k).array() += (k % 2 == 0 ? 3.0 : -3.0);
  const std::vector<Disturbance> found = DisturbanceScan(r).find(600, 0.01);
  ASSERT_FALSE(found.empty());
  for (const Disturbance& d : found) {
    EXPECT_GE(d.first, 795U);
    EXPECT_LE(d.last, 905U);
  }
}

TEST(DisturbanceScan, MissingSamplesCountForNothing) {
  Rows r = noise(500, 11);
  r.middleRows(100, 50).setConstant(std::nan(""));
  EXPECT_TRUE(DisturbanceScan(r).find(150, 0.001).empty());
  EXPECT_TRUE(DisturbanceScan(Rows(0, 6)).find(1, 0.01).empty());
}

}  // namespace
}  // namespace truewrench
