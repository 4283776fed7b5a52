// (10.10) by running sums: over stretches, with rows that stand for several samples, without masked ones.
#include "truewrench/estimation/pose.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

namespace truewrench {
namespace {

struct Moving {
  std::array<double, 6> nu{}, w{};
};

// Six axes at two frequencies each; `shift`: of the wrench, as an offset is.
Moving moving(double t, double shift = 0.0) {
  Moving out;
  for (std::size_t j = 0; j < 6; ++j) {
    const double f = 1.0 + 0.7 * static_cast<double>(j), g = 9.0 - static_cast<double>(j);
    out.nu[j] = 0.1 * std::cos(f * t) + 0.05 * std::sin(g * t);
    out.w[j] = -0.1 * f * std::sin(f * t) + 0.02 * g * std::cos(g * t + 1.0) + shift;
  }
  return out;
}

void run(PoseSums& sums, int count, double shift, double size = 1.0) {
  for (int k = 0; k < count; ++k) {
    const Moving at = moving(0.01 * k, shift);
    sums.add(0.01 * k, size, false, at.nu.data(), at.w.data());
  }
}

TEST(PoseSums, TwoStretchesOfOneMotionHideWhatOneOfThemHides) {
  PoseSums one, two;
  run(one, 800, 0.0);
  run(two, 800, 0.3);
  two.end_stretch(false);
  run(two, 800, -0.2);
  EXPECT_NEAR(two.share().A, one.share().A, 1e-9);
  EXPECT_NEAR(two.share().period, one.share().period, 1e-9);
}

TEST(PoseSums, ARowCountsAsManySamplesAsItStandsFor) {
  PoseSums one, four;
  run(one, 500, 0.0);
  run(four, 500, 0.0, 4.0);
  EXPECT_NEAR(four.share().A, one.share().A, 1e-12);
  EXPECT_NEAR((four.share().ww - one.share().ww).norm(), 0.0, 1e-12);
}

TEST(PoseSums, MaskedRowsMoveTheBodyAndCountForNothing) {
  PoseSums clean, masked;
  for (int k = 0; k < 800; ++k) {
    const Moving at = moving(0.01 * k);
    const bool hit = k > 300 && k < 340;
    std::array<double, 6> w = at.w;
    if (hit) w.fill(5.0);
    masked.add(0.01 * k, 1.0, hit, at.nu.data(), w.data());
    clean.add(0.01 * k, hit ? 0.0 : 1.0, false, at.nu.data(), at.w.data());
  }
  EXPECT_NEAR(masked.share().A, clean.share().A, 1e-12);
  EXPECT_NEAR((masked.share().ww - clean.share().ww).norm(), 0.0, 1e-12);
}

}  // namespace
}  // namespace truewrench
