// The recursive filter, step by step, against dense matrices written out in the test.
#include "truewrench/ekf.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>

namespace truewrench {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

Payload table_1() {
  Payload p;
  p.mass = 50.0;
  p.center_of_mass = Vector3(0.2, 0.0, 0.0);
  p.inertia = Vector3(1.5, 1.5, 0.4).asDiagonal();
  return p;
}

// F on [nu; a]: nu(t + dt) = nu + dt a.
Matrix12 transition(double dt) {
  Matrix12 f = Matrix12::Identity();
  f.topRightCorner<6, 6>().diagonal().setConstant(dt);
  return f;
}

// Q on [nu; a] for the spectral densities of a' ([(m/s^2)^2/s], [(rad/s^2)^2/s]).
Matrix12 process_noise(double dt, const Vector6& density) {
  const ProcessWeights weights = process_weights(dt);
  Matrix12 q = Matrix12::Zero();
  q.topLeftCorner<6, 6>().diagonal() = weights.twist * density;
  q.topRightCorner<6, 6>().diagonal() = weights.cross * density;
  q.bottomLeftCorner<6, 6>().diagonal() = weights.cross * density;
  q.bottomRightCorner<6, 6>().diagonal() = weights.acceleration * density;
  return q;
}

TEST(EkfMotion, ProcessNoiseIsTheIntegralOfWhiteNoiseThroughTheTransition) {
  const Vector6 density = Vector6::Random().cwiseAbs();
  const double dt = 0.37;
  Matrix12 input = Matrix12::Zero();
  input.bottomRightCorner<6, 6>() = density.asDiagonal();
  Matrix12 sum = Matrix12::Zero();
  const int steps = 4000;
  for (int i = 0; i < steps; ++i) {  // midpoint rule
    const Matrix12 f = transition(dt * (1.0 - (i + 0.5) / steps));
    sum += dt / steps * f * input * f.transpose();
  }
  EXPECT_LT((process_noise(dt, density) - sum).norm(), 1e-7 * sum.norm());
}

TEST(EkfMotion, TwoStepsAreOneOfTheirLength) {
  const Vector6 density = Vector6::Random().cwiseAbs();
  const Matrix12 f = transition(0.2);
  EXPECT_LT((transition(0.1) * f - transition(0.3)).norm(), 1e-15);
  const Matrix12 after = transition(0.1) * process_noise(0.2, density) * transition(0.1).transpose();
  EXPECT_LT((after + process_noise(0.1, density) - process_noise(0.3, density)).norm(), 1e-15);
}

Eigen::MatrixXd random_spd(int size) {
  const Eigen::MatrixXd root = Eigen::MatrixXd::Random(size, size);
  return root * root.transpose() / size + 0.1 * Eigen::MatrixXd::Identity(size, size);
}

// [A00] 20: the measurement as a function of the state, for finite differences.
Eigen::VectorXd measure(const Payload& p, double sign, const Eigen::VectorXd& x, const Vector3& g) {
  const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> c(x.data() + 12);
  Eigen::VectorXd y(12);
  y << sign * c * wrench(p, x.head(6), x.segment(6, 6), g), x.head(6);
  if (x.size() == 54) y.head(6) += x.tail(6);
  return y;
}

template <typename Filter>
class AnyEkf : public testing::Test {};
using Filters = testing::Types<Ekf<false>, Ekf<true>>;
TYPED_TEST_SUITE(AnyEkf, Filters);

TYPED_TEST(AnyEkf, OneStepEqualsDenseMatricesWithTheJacobianDifferenced) {
  constexpr int size = TypeParam::size;
  const Vector3 g(0.3, -9.0, 2.0);
  for (const Feels feels : {Feels::payload_on_sensor, Feels::sensor_on_payload}) {
    EkfSettings s;
    s.feels = feels;
    s.parameter_covariance = random_spd(42);
    s.gain += 0.2 * Matrix6::Random();
    s.offset = Vector6::Random();
    s.raw_covariance = Matrix6::Identity() + 0.1 * Matrix6::Ones();
    s.twist_covariance = 1e-4 * (Matrix6::Identity() + 0.1 * Matrix6::Ones());
    TypeParam filter(table_1(), s);
    const double sign = static_cast<double>(feels);
    // A first update, so that nu, a and their correlations with the rest are not zero.
    ASSERT_EQ(filter.update(10.0 * Vector6::Random(), Vector6::Random(), g), Status::ok);

    Eigen::VectorXd x = filter.state();
    Eigen::MatrixXd p = filter.covariance(), f = Eigen::MatrixXd::Identity(size, size);
    f.topLeftCorner(12, 12) = transition(0.013);
    x = f * x;
    p = f * p * f.transpose();
    p.topLeftCorner(12, 12) += process_noise(0.013, s.process_density);
    ASSERT_EQ(filter.predict(0.013), Status::ok);
    EXPECT_LT((Eigen::VectorXd(filter.state()) - x).norm(), 1e-12 * x.norm());
    EXPECT_LT((Eigen::MatrixXd(filter.covariance()) - p).norm(), 1e-12 * p.norm());

    Eigen::MatrixXd h(12, size);
    for (int k = 0; k < size; ++k) {  // quadratic in nu and bilinear: central differences are exact
      const Eigen::VectorXd step = 1e-4 * Eigen::VectorXd::Unit(size, k);
      h.col(k) = (measure(table_1(), sign, x + step, g) - measure(table_1(), sign, x - step, g)) / 2e-4;
    }
    const Vector6 raw = 100.0 * Vector6::Random();
    const Vector6 twist = Vector6::Random();
    Eigen::VectorXd y(12);
    y << raw, twist;
    y -= measure(table_1(), sign, x, g);
    Eigen::MatrixXd innovation_covariance = h * p * h.transpose();
    innovation_covariance.topLeftCorner(6, 6) += s.raw_covariance;
    innovation_covariance.bottomRightCorner(6, 6) += s.twist_covariance;
    const Eigen::LLT<Eigen::MatrixXd> llt(innovation_covariance);
    const Eigen::MatrixXd gain = llt.solve(h * p).transpose();
    ASSERT_EQ(filter.update(raw, twist, g), Status::ok);
    const EkfUpdate& update = filter.last_update();
    EXPECT_LT((Eigen::VectorXd(update.innovation) - y).norm(), 1e-10 * y.norm());
    EXPECT_LT((Eigen::MatrixXd(update.innovation_covariance) - innovation_covariance).norm(),
              1e-7 * innovation_covariance.norm());
    EXPECT_EQ(update.degrees_of_freedom, 12);
    EXPECT_NEAR(update.nis, y.dot(llt.solve(y)), 1e-6 * update.nis);
    x += gain * y;
    p -= gain * innovation_covariance * gain.transpose();
    EXPECT_LT((Eigen::VectorXd(filter.state()) - x).norm(), 1e-6 * x.norm());
    EXPECT_LT((Eigen::MatrixXd(filter.covariance()) - p).norm(), 1e-6 * p.norm());
  }
}

TYPED_TEST(AnyEkf, CovarianceIsSymmetricToTheLastBit) {
  TypeParam filter(table_1(), {});
  for (int i = 0; i < 50; ++i) {
    ASSERT_EQ(filter.predict(0.01), Status::ok);
    ASSERT_EQ(filter.update(Vector6::Random(), Vector6::Random(), Vector3::Zero()), Status::ok);
  }
  const Eigen::MatrixXd p = filter.covariance();
  EXPECT_EQ(p, p.transpose());
}

TEST(Ekf, SamplesThatAreMissingChangeNothing) {
  Ekf<false> none(table_1(), {});
  ASSERT_EQ(none.predict(0.1), Status::ok);
  const Eigen::MatrixXd before = none.covariance();
  ASSERT_EQ(none.update(Vector6::Constant(nan), Vector6::Constant(nan), Vector3::Zero()), Status::ok);
  EXPECT_EQ(none.last_update().degrees_of_freedom, 0);
  EXPECT_EQ(Eigen::MatrixXd(none.covariance()), before);

  // A row without twist is one whose twist is infinitely uncertain.
  EkfSettings vague;
  vague.twist_covariance = 1e14 * Matrix6::Identity();
  Ekf<false> left_out(table_1(), {});
  Ekf<false> uncertain(table_1(), vague);
  const Vector6 raw = Vector6::Random();
  ASSERT_EQ(left_out.update(raw, Vector6::Constant(nan), Vector3::Zero()), Status::ok);
  ASSERT_EQ(uncertain.update(raw, Vector6::Random(), Vector3::Zero()), Status::ok);
  EXPECT_EQ(left_out.last_update().degrees_of_freedom, 6);
  EXPECT_TRUE(std::isnan(left_out.last_update().innovation(6)));
  EXPECT_LT((Eigen::MatrixXd(left_out.covariance()) - Eigen::MatrixXd(uncertain.covariance())).norm(), 1e-10);
}

TEST(Ekf, InputsThatCannotBeUsedLeaveTheEstimateAlone) {
  Ekf<false> filter(table_1(), {});
  ASSERT_EQ(filter.update(Vector6::Random(), Vector6::Random(), Vector3::Zero()), Status::ok);
  const Eigen::VectorXd state = filter.state();
  EXPECT_EQ(filter.predict(0.0), Status::not_increasing);
  EXPECT_EQ(filter.predict(nan), Status::not_finite);
  EXPECT_EQ(filter.update(Vector6::Zero(), Vector6::Zero(), Vector3(nan, 0, 0)), Status::not_finite);
  Vector6 infinite = Vector6::Zero();
  infinite(2) = std::numeric_limits<double>::infinity();
  EXPECT_EQ(filter.update(infinite, Vector6::Zero(), Vector3::Zero()), Status::not_finite);
  EXPECT_EQ(Eigen::VectorXd(filter.state()), state);
}

TEST(Ekf, SettingsThatMakeNoSenseAreNamed) {
  EkfSettings s;
  EXPECT_EQ(check(s), Status::ok);
  s.raw_covariance(2, 2) = 0.0;
  EXPECT_EQ(check(s), Status::not_positive);
  s = {};
  s.process_density(0) = nan;
  EXPECT_EQ(check(s), Status::not_finite);
}

}  // namespace
}  // namespace truewrench
