// Splines, bands and bodies against textbook forms written here.
#include "truewrench/math/banded.hpp"
#include "truewrench/math/chi_square.hpp"
#include "truewrench/model/body.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <cmath>
#include <functional>

namespace truewrench {
namespace {

// Cox and de Boor's recursion for the function that starts at knot i of a uniform sequence with spacing 1.
double cox_de_boor(int i, int degree, double x) {
  if (degree == 0) return x >= i && x < i + 1 ? 1.0 : 0.0;
  return (x - i) / degree * cox_de_boor(i, degree - 1, x) +
         (i + degree + 1 - x) / degree * cox_de_boor(i + 1, degree - 1, x);
}

// The whole penalty (N, N) of a spline.
Eigen::MatrixXd dense(const Spline& s, const Penalty& p) {
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(s.size(), s.size());
  for (Eigen::Index i = 0; i < s.intervals(); ++i) R.block(i, i, kLocal, kLocal) += p.inside;
  R.topLeftCorner(kLocal, kLocal) += p.start;
  R.bottomRightCorner(kLocal, kLocal) += p.end;
  return R;
}

TEST(Spline, PiecesAreThoseOfCoxAndDeBoor) {
  const Spline s(2.0, 3.0, 0.1);
  for (const double u : {0.0, 0.2, 0.5, 0.93}) {
    const Basis b = s.basis(u, 0);
    for (int k = 0; k < kLocal; ++k) EXPECT_NEAR(b[k], cox_de_boor(k - 5, 5, u), 1e-14);
    EXPECT_NEAR(b.sum(), 1.0, 1e-14);
  }
}

TEST(Spline, DerivativesAreThoseOfDifferences) {
  const Spline s(0.0, 1.0, 0.1);
  const double d = 1e-5;
  for (int p = 0; p < 4; ++p) {
    const Basis difference = (s.basis(0.4 + d, p) - s.basis(0.4 - d, p)) / (2.0 * d * s.h());
    EXPECT_LT((difference - s.basis(0.4, p + 1)).norm(), 1e-6 * s.basis(0.4, p + 1).norm());
  }
}

TEST(Spline, WholeBlocksFitBetweenItsEnds) {
  const Spline s(1.0, 0.77, 0.05);
  EXPECT_EQ(s.intervals() % kBlock, 0);
  EXPECT_LE(s.h(), 0.05 + 1e-12);
  EXPECT_NEAR(s.end(), 1.77, 1e-12);
  double u = 0.0;
  EXPECT_EQ(s.locate(0.5, u), 0);  // times outside go on with the last polynomial
  EXPECT_LT(u, 0.0);
}

TEST(Spline, DiscrepancyHasTheLogDeterminantOfItsMatrix) {
  const Spline s(0.0, 2.0, 0.1);
  for (const Form form : {Form::matern, Form::walk, Form::bridge}) {
    const Penalty p = s.discrepancy(1.0 / 0.3, form);
    const Eigen::MatrixXd R = dense(s, p);
    EXPECT_NEAR(s.logdet(p), std::log(R.determinant()), 1e-8 * std::abs(std::log(R.determinant())));
  }
}

// Cov(d(s), d(t)) = min(s, t) - s t / T of a walk of one per root of a second that is zero at both ends.
TEST(Spline, BridgeHasTheCovarianceOfAWalkBetweenItsEnds) {
  const double T = 2.0;
  const Spline s(1.0, T, 0.02);
  const Eigen::MatrixXd K = dense(s, s.discrepancy(0.0, Form::bridge)).inverse();
  const auto at = [&](double t) {
    double u = 0.0;
    Eigen::VectorXd b = Eigen::VectorXd::Zero(s.size());
    const Eigen::Index interval = s.locate(1.0 + t, u);
    b.segment(interval, kLocal) = s.basis(u, 0);
    return b;
  };
  for (const double a : {0.0, 0.3, 1.0, 1.7, 2.0})
    for (const double b : {0.0, 0.3, 1.2, 2.0})
      EXPECT_NEAR(at(a).dot(K * at(b)), std::min(a, b) - a * b / T, 0.02 * 0.25 * T);
}

TEST(Spline, SmoothnessAnnihilatesPolynomialsBelowItsOrder) {
  const Spline s(0.0, 2.0, 0.1);
  const Eigen::MatrixXd R = dense(s, s.smoothness(3));
  Eigen::VectorXd x(s.size());
  for (Eigen::Index i = 0; i < x.size(); ++i) x[i] = 3.0 + 0.5 * static_cast<double>(i);
  EXPECT_LT((R * x).norm(), 1e-9 * R.norm() * x.norm());
}

// (10.2): log |R_3 + A^T A| with A the value and the derivatives at the beginning, up to a constant that no spacing changes.
TEST(Spline, LogDeterminantOfSmoothnessComparesSpacings) {
  const auto departure = [](double h) {
    const Spline s(0.0, 2.0, h);
    Eigen::MatrixXd R = dense(s, s.smoothness(3));
    for (int p = 0; p < 3; ++p) {
      const Basis b = s.basis(0.0, p);
      R.topLeftCorner(kLocal, kLocal) += b * b.transpose();
    }
    const Eigen::LLT<Eigen::MatrixXd> llt(R);
    return 2.0 * Eigen::MatrixXd(llt.matrixL()).diagonal().array().log().sum() - s.smoothness_logdet(3);
  };
  EXPECT_NEAR(departure(0.2), departure(0.1), 1e-4);
}

TEST(ChiSquare, TailIsThatOfTables) {
  EXPECT_NEAR(std::exp(chi_square_log_tail(12.592, 6.0)), 0.05, 1e-5);
  EXPECT_NEAR(std::exp(chi_square_log_tail(0.676, 6.0)), 0.995, 1e-4);
  EXPECT_NEAR(chi_square_log_tail(48.4, 6.0), std::log(9.9e-9), 0.02);
}

TEST(Body, JacobiansAreThoseOfDifferences) {
  const Payload stated{5.0, {0.02, 0.03, 0.1}, Vector3(0.04, 0.03, 0.02).asDiagonal()};
  const Vector3 point(0.01, -0.02, 0.08);
  const Vector6 nu = Vector6::LinSpaced(-0.5, 0.7), a = Vector6::LinSpaced(1.0, -2.0);
  const Vector3 g(1.0, -3.0, -9.0);
  BodyVector by;
  by << 0.01, 0.002, -0.001, 0.003, 1e-3, 2e-3, -1e-3, 5e-4, -4e-4, 3e-4;
  const auto w = [&](const BodyVector& b, const Vector6& n, const Vector6& x, const Vector3& free_fall) {
    return wrench_about(departed(stated, b), point, n, x, free_fall);
  };
  const MotionJacobian j = motion_jacobian(departed(stated, by), point, nu);
  const BodyJacobian b = body_jacobian(departed(stated, by), nu, a, w(by, nu, a, g));
  const double d = 1e-6;
  for (int i = 0; i < 6; ++i) {
    const Vector6 e = d * Vector6::Unit(i);
    EXPECT_LT(((w(by, nu + e, a, g) - w(by, nu - e, a, g)) / (2.0 * d) - j.nu.col(i)).norm(), 1e-7);
    EXPECT_LT(((w(by, nu, a + e, g) - w(by, nu, a - e, g)) / (2.0 * d) - j.a.col(i)).norm(), 1e-7);
  }
  for (int i = 0; i < 3; ++i) {
    const Vector3 e = d * Vector3::Unit(i);
    EXPECT_LT(((w(by, nu, a, g + e) - w(by, nu, a, g - e)) / (2.0 * d) - j.g.col(i)).norm(), 1e-7);
  }
  for (int i = 0; i < kBodyParameters; ++i) {
    const BodyVector e = d * BodyVector::Unit(i);
    EXPECT_LT(((w(by + e, nu, a, g) - w(by - e, nu, a, g)) / (2.0 * d) - b.col(i)).norm(), 1e-6);
  }
}

}  // namespace
}  // namespace truewrench
