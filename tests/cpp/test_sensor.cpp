// Inverse and conditioning of a gain, with the number of channels fixed and free.
#include "truewrench/sensor.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

template <typename Model>
class AnySensor : public testing::Test {};

template <int N, int Channels>
struct Case {
  static SensorModel<N> sensor() {
    SensorModel<N> s;
    s.gain = Eigen::MatrixXd::Random(Channels, 6);
    s.offset = Eigen::VectorXd::Random(Channels);
    s.noise = Eigen::VectorXd::Random(Channels).cwiseAbs() + Eigen::VectorXd::Constant(Channels, 0.1);
    return s;
  }
  using Inverse = typename SensorModel<N>::Inverse;
};

using Cases = testing::Types<Case<6, 6>, Case<8, 8>, Case<Eigen::Dynamic, 6>, Case<Eigen::Dynamic, 32>>;
TYPED_TEST_SUITE(AnySensor, Cases);

TYPED_TEST(AnySensor, InverseUndoesTheGainAndSatisfiesTheNormalEquations) {
  const auto s = TypeParam::sensor();
  typename TypeParam::Inverse inverse;
  ASSERT_EQ(generalised_inverse(s, inverse), Status::ok);
  const Matrix6 identity = inverse * s.gain;
  EXPECT_LT((identity - Matrix6::Identity()).norm(), 1e-10);
  // (G^T R^-1 G) G^+ = G^T R^-1
  const Eigen::MatrixXd weight = s.noise.cwiseAbs2().cwiseInverse().asDiagonal();
  const Eigen::MatrixXd left = s.gain.transpose() * weight * s.gain * inverse;
  const Eigen::MatrixXd right = s.gain.transpose() * weight;
  EXPECT_LT((left - right).norm(), 1e-9 * right.norm());
}

TEST(Sensor, FaultsAreNamed) {
  SensorModel<6> s{Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()};
  SensorModel<6>::Inverse inverse;
  s.gain.row(5) = s.gain.row(4);
  EXPECT_EQ(generalised_inverse(s, inverse), Status::singular);
  s.gain.setIdentity();
  s.noise(3) = 0.0;
  EXPECT_EQ(generalised_inverse(s, inverse), Status::not_positive);
  s.noise(3) = std::numeric_limits<double>::infinity();
  EXPECT_EQ(generalised_inverse(s, inverse), Status::not_finite);
  SensorModel<> five{Eigen::MatrixXd::Random(5, 6), Eigen::VectorXd::Zero(5), Eigen::VectorXd::Ones(5)};
  SensorModel<>::Inverse none;
  EXPECT_EQ(generalised_inverse(five, none), Status::wrong_size);
}

TEST(Sensor, NormConditionIsReportedAndNeverRefuses) {
  const Vector6 range = (Vector6() << 500, 500, 500, 50, 50, 50).finished();
  SensorModel<6> s{3.0 * Matrix6::Identity(), Vector6::Zero(), Vector6::Ones()};  // Delta = 2 I
  Conditioning figures;
  ASSERT_EQ(conditioning(s, SensorModel<6>::Gain(Matrix6::Identity()), range, figures), Status::ok);
  EXPECT_NEAR(figures.departure_norm, 2.0, 1e-12);
  EXPECT_FALSE(figures.departure_below_one());
  EXPECT_NEAR(figures.condition_number, 1.0, 1e-12);
}

}  // namespace
}  // namespace truewrench
