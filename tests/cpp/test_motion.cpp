// The double integrator, against the integral that defines its process noise.
#include "truewrench/motion.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

TEST(Motion, ProcessNoiseIsTheIntegralOfWhiteNoiseThroughTheTransition) {
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

TEST(Motion, TwoStepsAreOneOfTheirLength) {
  const Vector6 density = Vector6::Random().cwiseAbs();
  const Matrix12 f = transition(0.2);
  EXPECT_LT((transition(0.1) * f - transition(0.3)).norm(), 1e-15);
  const Matrix12 after = transition(0.1) * process_noise(0.2, density) * transition(0.1).transpose();
  EXPECT_LT((after + process_noise(0.1, density) - process_noise(0.3, density)).norm(), 1e-15);
}

}  // namespace
}  // namespace truewrench
