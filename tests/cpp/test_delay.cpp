// Which delays the gain can imitate, on wrenches whose derivative is known.
#include "truewrench/estimation/delay.hpp"

#include <gtest/gtest.h>

#include <array>
#include <numbers>

namespace truewrench {
namespace {

constexpr double dt = 0.002;  // [s]
constexpr double omega = 2.0 * std::numbers::pi;
const std::array<double, 36> gain = [] {  // rows of C
  std::array<double, 36> C{};
  for (std::size_t i = 0; i < 36; ++i)
    C[i] = (i % 7 == 0 ? 1.0 : 0.0) + 0.1 * std::sin(static_cast<double>(i));
  return C;
}();
constexpr auto sigma = [](int) { return 1e-3; };

// Forces as sines, moments as cosines of one frequency an axis; `second` adds another frequency.
std::array<double, 6> wrench(double t, double second) {
  std::array<double, 6> w{};
  for (std::size_t j = 0; j < 3; ++j) {
    const double f = omega * (0.3 + 0.2 * static_cast<double>(j));
    w[j] = std::sin(f * t) + second * std::sin(2.3 * f * t);
    w[j + 3] = 0.5 * std::cos(f * t) + second * std::cos(1.7 * f * t);
  }
  return w;
}

DelaySums sums_of(double second) {
  DelaySums sums;
  for (int k = 0; k < 5000; ++k) sums.add(dt * k, wrench(dt * k, second).data());
  return sums;
}

TEST(Delay, IsImitatedWhereForceAndMomentAreInQuadrature) {
  EXPECT_TRUE(sums_of(0.0).imitated(gain.data(), 6, sigma));
  EXPECT_FALSE(sums_of(0.7).imitated(gain.data(), 6, sigma));
}

TEST(Delay, OfTheGainIsItsDerivative) {  // C w(t + s) = (C + s C A + s^2 / 2 C A A) w(t) + ...
  const DelaySums sums = sums_of(0.0);
  const double s = 5e-3;
  for (int row = 0; row < 6; ++row) {
    double of_gain[2][6], of_offset[2];
    sums.imitate(gain.data() + 6 * row, of_gain, of_offset);
    for (double t : {0.4, 3.1, 7.7}) {
      const auto now = wrench(t, 0.0), late = wrench(t + s, 0.0);
      double expected = 0.0, found = s * of_offset[0] + 0.5 * s * s * of_offset[1];
      for (std::size_t j = 0; j < 6; ++j) {
        const double C = gain[static_cast<std::size_t>(6 * row) + j];
        expected += C * late[j];
        found += (C + s * of_gain[0][j] + 0.5 * s * s * of_gain[1][j]) * now[j];
      }
      EXPECT_NEAR(found, expected, 2e-6);  // s^3 omega^3 / 6, and differences over 4 ms
    }
  }
}

TEST(Delay, IsNotToldByTooFewSamplesNorAcrossACut) {
  DelaySums few;
  for (int k = 0; k < 10; ++k) few.add(dt * k, wrench(dt * k, 0.0).data());
  double A[DelaySums::features][6];
  EXPECT_FALSE(few.rates(A));
  DelaySums cut;
  for (int k = 0; k < 5000; ++k) {  // a jump in time and wrench that no difference may span
    if (k == 2500) cut.cut();
    const double t = dt * k + (k < 2500 ? 0.0 : 100.0);
    cut.add(t, wrench(t, 0.0).data());
  }
  EXPECT_TRUE(cut.imitated(gain.data(), 6, sigma));
}

}  // namespace
}  // namespace truewrench
