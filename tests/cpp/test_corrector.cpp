// Raw channels to wrench and covariance, against the linearised error written out with dense matrices.
#include "truewrench/corrector.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include <limits>
#include <utility>

namespace truewrench {
namespace {

template <int N>
void matches_dense_propagation(int n) {
  SensorModel<N> s;
  s.gain = Eigen::MatrixXd::Random(n, 6);
  s.gain.template topRows<6>() += 3.0 * Matrix6::Identity();
  s.offset = Eigen::VectorXd::Random(n);
  s.noise = Eigen::VectorXd::Constant(n, 0.05);
  const Eigen::MatrixXd root = 1e-2 * Eigen::MatrixXd::Random(7 * n, 7 * n);
  const Eigen::MatrixXd covariance = root * root.transpose();
  Corrector<N> corrector;
  ASSERT_EQ(corrector.configure(s, covariance), Status::ok);

  const Eigen::MatrixXd g = s.gain;
  const Eigen::MatrixXd inverse = (g.transpose() * g).inverse() * g.transpose();  // equal noise
  const Vector6 w = 5.0 * Vector6::Random();
  const Eigen::VectorXd raw = s.raw(w);
  Correction found;
  ASSERT_EQ(corrector.step(raw.data(), found), Status::ok);
  EXPECT_LT((found.wrench - w).norm(), 1e-12 * w.norm());

  Eigen::MatrixXd jacobian =
      Eigen::MatrixXd::Zero(n, 7 * n);  // of the raw error by [gain row by row; offset]
  for (int i = 0; i < n; ++i) {
    jacobian.block(i, 6 * i, 1, 6) = w.transpose();
    jacobian(i, 6 * n + i) = 1.0;
  }
  const Eigen::MatrixXd of_raw =
      0.05 * 0.05 * Eigen::MatrixXd::Identity(n, n) + jacobian * covariance * jacobian.transpose();
  const Matrix6 expected = inverse * of_raw * inverse.transpose();
  EXPECT_LT((corrector.covariance(found.wrench) - expected).norm(), 1e-10 * expected.norm());
  EXPECT_LT((found.std.cwiseAbs2() - expected.diagonal()).norm(), 1e-10 * expected.norm());
}

TEST(Corrector, CovarianceHoldsNoiseGainAndOffset) {
  matches_dense_propagation<6>(6);
  matches_dense_propagation<8>(8);
  matches_dense_propagation<Eigen::Dynamic>(6);
  matches_dense_propagation<Eigen::Dynamic>(32);
}

TEST(Corrector, SampleWithoutAChannelHasNoWrench) {
  Corrector<6> corrector;
  ASSERT_EQ(corrector.configure({Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()},
                                Eigen::MatrixXd::Zero(42, 42)),
            Status::ok);
  Vector6 raw = Vector6::Ones();
  raw(4) = std::numeric_limits<double>::quiet_NaN();
  Correction found;
  EXPECT_EQ(corrector.step(raw.data(), found), Status::not_finite);
  EXPECT_TRUE(found.wrench.array().isNaN().all());
  EXPECT_TRUE(found.std.array().isNaN().all());
}

TEST(Corrector, CovarianceOfTheWrongSizeIsRefused) {
  Corrector<6> corrector;
  EXPECT_EQ(corrector.configure({Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()},
                                Eigen::MatrixXd::Zero(36, 36)),
            Status::wrong_size);
}

TEST(Corrector, VarianceBelowZeroIsRefused) {
  Corrector<6> corrector;
  EXPECT_EQ(corrector.configure({Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()},
                                -Eigen::MatrixXd::Identity(42, 42)),
            Status::not_positive);
  Eigen::MatrixXd indefinite = Eigen::MatrixXd::Identity(42, 42);
  indefinite(0, 1) = indefinite(1, 0) = -1.1;
  EXPECT_EQ(corrector.configure({Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()}, indefinite),
            Status::not_positive);
  EXPECT_FALSE(corrector.configured());
}

template <int N>
void has_nothing_to_say(const Corrector<N>& corrector) {
  const Eigen::VectorXd raw = Eigen::VectorXd::Ones(32);
  Correction found{Vector6::Zero(), Vector6::Zero()};
  EXPECT_FALSE(corrector.configured());
  EXPECT_EQ(corrector.step(raw.data(), found), Status::not_configured);
  EXPECT_TRUE(found.wrench.array().isNaN().all());
  EXPECT_TRUE(found.std.array().isNaN().all());
  EXPECT_TRUE(corrector.covariance(Vector6::Zero()).array().isNaN().all());
}

TEST(Corrector, WithoutACalibrationNoSampleIsOk) {
  has_nothing_to_say(Corrector<6>());
  has_nothing_to_say(Corrector<>());
}

TEST(Corrector, CalibrationThatFailsLeavesNone) {
  const Eigen::MatrixXd exact = Eigen::MatrixXd::Zero(42, 42);
  const SensorModel<6> good{Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()};
  SensorModel<6> singular = good;
  singular.gain.row(5).setZero();
  SensorModel<6> silent = good;
  silent.noise.setZero();
  Corrector<6> corrector;
  for (const auto& [bad, why] : {std::pair{singular, Status::singular}, {silent, Status::not_positive}}) {
    ASSERT_EQ(corrector.configure(good, exact), Status::ok);
    EXPECT_TRUE(corrector.configured());
    EXPECT_EQ(corrector.configure(bad, exact), why);
    has_nothing_to_say(corrector);
  }
}

TEST(Corrector, SensorWithoutChannelsIsNoCalibration) {
  Corrector<> corrector;
  EXPECT_EQ(corrector.configure(SensorModel<>(), Eigen::MatrixXd(0, 0)), Status::wrong_size);
  has_nothing_to_say(corrector);
}

}  // namespace
}  // namespace truewrench
