// Quintic splines against Cox and de Boor's recursion on numbers.
#include "truewrench/bspline.hpp"

#include "oracles.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

std::vector<double> uneven_breakpoints() { return {-0.4, -0.1, 0.0, 0.5, 0.55, 1.3, 2.0}; }

using Rows = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

std::vector<double> times(const std::vector<double>& breakpoints) {
  std::vector<double> t;
  for (std::size_t i = 0; i + 1 < breakpoints.size(); ++i) {
    for (const double f : {0.0, 0.07, 0.5, 0.81})
      t.push_back((1.0 - f) * breakpoints[i] + f * breakpoints[i + 1]);
  }
  t.push_back(breakpoints.back());
  return t;
}

Rows random_coefficients(int count) {
  std::mt19937 random(5);
  return oracle::normal_matrix(random, count, 3);
}

Eigen::RowVector3d value(const BSpline& spline, const Rows& x, double t, int derivative) {
  const int i = spline.interval(t);
  return spline.basis(i, powers(spline.local(i, t)), derivative).transpose() * x.middleRows<kActive>(i);
}

TEST(BSpline, BasisAndDerivativesAreThoseOfCoxAndDeBoor) {
  const std::vector<double> uneven = uneven_breakpoints();
  for (const auto& breakpoints : {uneven, std::vector<double>{2.0, 2.5}, BSpline::uniform(-1.0, 1.0, 9)}) {
    const BSpline spline(breakpoints);
    for (const double t : times(breakpoints)) {
      const int i = spline.interval(t);
      for (int derivative = 0; derivative <= 2; ++derivative) {
        const Eigen::VectorXd expected = oracle::basis(breakpoints, t, derivative);
        ASSERT_EQ(expected.size(), spline.coefficients());
        Eigen::VectorXd found = Eigen::VectorXd::Zero(expected.size());
        found.segment<kActive>(i) = spline.basis(i, powers(spline.local(i, t)), derivative);
        EXPECT_LT((found - expected).norm(), 1e-11 * (1.0 + expected.norm()))
            << "t " << t << ", " << derivative;
      }
    }
  }
}

TEST(BSpline, BasisFunctionsSumToOneAndTheirRatesToZero) {
  const std::vector<double> uneven = uneven_breakpoints();
  const BSpline spline(uneven);
  for (const double t : times(uneven)) {
    const int i = spline.interval(t);
    const Powers u = powers(spline.local(i, t));
    EXPECT_NEAR(spline.basis(i, u, 0).sum(), 1.0, 1e-12);
    EXPECT_NEAR(spline.basis(i, u, 1).sum(), 0.0, 1e-9);
    EXPECT_NEAR(spline.basis(i, u, 2).sum(), 0.0, 1e-7);
  }
}

TEST(BSpline, EveryTimeBelongsToTheIntervalThatHoldsItAndTimesOutsideToTheEnds) {
  const std::vector<double> uneven = uneven_breakpoints();
  const BSpline spline(uneven);
  EXPECT_EQ(spline.intervals(), 6);
  EXPECT_EQ(spline.interval(-0.4), 0);
  EXPECT_EQ(spline.interval(-0.1), 1);
  EXPECT_EQ(spline.interval(0.54), 3);
  EXPECT_EQ(spline.interval(2.0), 5);
  EXPECT_EQ(spline.interval(-9.0), 0);
  EXPECT_EQ(spline.interval(9.0), 5);
}

TEST(BSpline, FourDerivativesAreContinuousAcrossBreakpoints) {
  const std::vector<double> uneven = uneven_breakpoints();
  const BSpline spline(uneven);
  const Rows x = random_coefficients(spline.coefficients());
  for (int i = 0; i + 1 < spline.intervals(); ++i) {
    Powers left = powers(1.0);
    Powers right = powers(-1.0);
    const auto p = spline.polynomial<3>(i, x);
    const auto q = spline.polynomial<3>(i + 1, x);
    for (int derivative = 0; derivative <= 4; ++derivative) {
      const Eigen::Vector3d jump = p * left - q * right;
      EXPECT_LT(jump.norm(), 1e-9 * (1.0 + (p * left).norm())) << "breakpoint " << i << ", " << derivative;
      left = spline.rate(i, left);
      right = spline.rate(i + 1, right);
    }
  }
}

TEST(BSpline, PolynomialOfAnIntervalIsTheSplineThere) {
  const std::vector<double> uneven = uneven_breakpoints();
  const BSpline spline(uneven);
  const Rows x = random_coefficients(spline.coefficients());
  for (const double t : times(uneven)) {
    const int i = spline.interval(t);
    const Eigen::Vector3d found = spline.polynomial<3>(i, x) * powers(spline.local(i, t));
    const Eigen::Vector3d expected = x.transpose() * oracle::basis(uneven, t, 0);
    EXPECT_LT((found - expected).norm(), 1e-12 * (1.0 + expected.norm()));
  }
}

TEST(BSpline, MeanOfASplineOverSamplesIsTheSplineOfTheirMeanPowers) {
  const std::vector<double> uneven = uneven_breakpoints();
  const BSpline spline(uneven);
  const Rows x = random_coefficients(spline.coefficients());
  const std::vector<double> samples{0.01, 0.02, 0.1, 0.25, 0.49};
  const int i = spline.interval(samples.front());
  for (int derivative = 0; derivative <= 2; ++derivative) {
    Powers u = Powers::Zero();
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const double t : samples) {
      u += powers(spline.local(i, t)) / 5.0;
      mean += x.transpose() * oracle::basis(uneven, t, derivative) / 5.0;
    }
    const Eigen::Vector3d found = x.middleRows<kActive>(i).transpose() * spline.basis(i, u, derivative);
    EXPECT_LT((found - mean).norm(), 1e-11 * (1.0 + mean.norm()));
  }
}

TEST(BSpline, RefinementKeepsTheSplineExactly) {
  const std::vector<double> uneven = uneven_breakpoints();
  const BSpline spline(uneven);
  const Rows x = random_coefficients(spline.coefficients());
  std::vector<double> thirds = uneven;  // knots at other places than the middle
  thirds.insert(thirds.begin() + 4, 0.51);
  thirds.insert(thirds.begin() + 1, {-0.38, -0.13});
  const std::vector<std::vector<double>> finer{
      uneven, thirds, spline.halved(std::vector<char>(6, 1)),
      spline.halved(std::vector<char>{0, 1, 0, 0, 1, 1}),
      BSpline(spline.halved(std::vector<char>(6, 1))).halved(std::vector<char>(12, 1))};
  for (const auto& breakpoints : finer) {
    const BSpline fine(breakpoints);
    const Rows y = spline.refined<3>(x, fine);
    ASSERT_EQ(y.rows(), fine.coefficients());
    for (const double t : times(breakpoints)) {
      for (int derivative = 0; derivative <= 1; ++derivative) {
        const Eigen::RowVector3d expected = value(spline, x, t, derivative);
        EXPECT_LT((value(fine, y, t, derivative) - expected).norm(), 1e-10 * (1.0 + expected.norm()));
      }
    }
  }
}

TEST(BSpline, HalvingMarksPutsOneBreakpointInTheMiddleOfEachMarkedInterval) {
  const BSpline spline(std::vector<double>{0.0, 1.0, 3.0, 4.0});
  EXPECT_EQ(spline.halved(std::vector<char>{0, 1, 0}), (std::vector<double>{0.0, 1.0, 2.0, 3.0, 4.0}));
  EXPECT_EQ(spline.halved(std::vector<char>{1, 0, 1}), (std::vector<double>{0.0, 0.5, 1.0, 3.0, 3.5, 4.0}));
}

TEST(BSpline, MarkedNeighboursTooShortToBeHalvedAreDealtOutAnew) {
  const BSpline even(BSpline::uniform(0.0, 4.0, 4));
  const std::vector<char> all(4, 1), first{1, 1, 0, 0}, none(4, 0);
  EXPECT_EQ(even.halved(all, 0.5), even.halved(all));
  EXPECT_EQ(even.halved(all, 0.7), BSpline::uniform(0.0, 4.0, 5));
  EXPECT_EQ(even.halved(all, 0.95), even.breakpoints());
  EXPECT_EQ(even.halved(none, 0.7), even.breakpoints());
  EXPECT_EQ(even.halved(first, 0.7), (std::vector<double>{0.0, 0.75, 1.5, 2.25, 3.0, 4.0}));
  EXPECT_EQ(even.halved(first, 0.8), even.breakpoints());
  const BSpline uneven(std::vector<double>{0.0, 1.0, 2.0, 4.0});
  EXPECT_EQ(uneven.halved(std::vector<char>{0, 0, 1}, 0.8), (std::vector<double>{0.0, 1.0, 2.0, 3.0, 4.0}));
  EXPECT_EQ(uneven.halved(std::vector<char>{0, 1, 1}, 0.6),
            (std::vector<double>{0.0, 2.0 / 3.0, 4.0 / 3.0, 2.0, 3.0, 4.0}));
}

TEST(BSpline, UniformBreakpointsMeetBothEndsExactly) {
  const std::vector<double> t = BSpline::uniform(0.1, 0.7, 7);
  ASSERT_EQ(t.size(), 8U);
  EXPECT_EQ(t.front(), 0.1);
  EXPECT_EQ(t.back(), 0.7);
}

}  // namespace
}  // namespace truewrench
