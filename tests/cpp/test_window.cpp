// The normal equations of a window against the dense Jacobian of residuals written out here.
#include "truewrench/window.hpp"

#include "dense_window.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

template <int N>
void expect_dense_normal_equations(const Scene& scene, double rounding = 1.0, double freedom = 0.0) {
  const Prepared<N> window(scene);
  WindowNormal<N> normal;

  const Eigen::VectorXd r = scene.residuals(scene.x, scene.theta);
  const Eigen::MatrixXd j = scene.jacobian();
  const Eigen::Index m = scene.x.size();
  const Eigen::Index p = scene.theta.size();
  Eigen::VectorXd weight = Eigen::VectorXd::Ones(r.size());
  if (freedom > 0.0) {
    for (Eigen::Index k = scene.residuals(scene.x, scene.theta, false).size(); k < r.size(); ++k) {
      weight[k] = (freedom + 1.0) / (freedom + r[k] * r[k]);
    }
  }
  const Eigen::MatrixXd h = j.transpose() * weight.asDiagonal() * j;
  const Eigen::VectorXd g = -j.transpose() * weight.asDiagonal() * r;
  const Eigen::MatrixXd hxx = h.topLeftCorner(m, m);
  const Eigen::LLT<Eigen::MatrixXd> factor(hxx);

  normal.assemble(window.model, window.blocks, window.spline, scene.x, scene.theta, Terms::all, true,
                  freedom);
  EXPECT_NEAR(normal.cost(), r.dot(weight.asDiagonal() * r), 1e-10 * r.squaredNorm());
  EXPECT_LT(relative(normal.information(), h.bottomRightCorner(p, p)), 1e-11 * rounding);
  EXPECT_LT(relative(normal.score(), g.tail(p)), 1e-11 * rounding);

  ASSERT_EQ(normal.reduce(), Status::ok);
  const Eigen::MatrixXd schur =
      h.bottomRightCorner(p, p) - h.bottomLeftCorner(p, m) * factor.solve(h.topRightCorner(m, p));
  const Eigen::VectorXd score = g.tail(p) - h.bottomLeftCorner(p, m) * factor.solve(g.head(m));
  EXPECT_LT(relative(normal.information(), schur), 1e-9 * rounding);
  EXPECT_LT(relative(normal.score(), score), 1e-9 * rounding);
  EXPECT_EQ(normal.information(), normal.information().transpose());

  const auto flat = [](const Coefficients& c) {
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(c.data(), c.size()));
  };
  const Eigen::VectorXd held = factor.solve(g.head(m));
  EXPECT_LT(relative(flat(normal.motion_step({})), held), 1e-9 * rounding);
  EXPECT_NEAR(normal.motion_decrement(), g.head(m).dot(held), 1e-9 * std::abs(g.head(m).dot(held)));
  // The step of motion and common parameters together is that of the dense system, here with a unit prior.
  Eigen::MatrixXd with_prior = h;
  with_prior.diagonal().tail(p).array() += 1.0;
  const Eigen::VectorXd dense = with_prior.llt().solve(g);
  const Eigen::VectorXd dtheta =
      (normal.information() + Eigen::MatrixXd::Identity(p, p)).llt().solve(normal.score());
  EXPECT_LT(relative(dtheta, dense.tail(p)), 1e-7 * rounding);
  EXPECT_LT(relative(flat(normal.motion_step(dtheta)), dense.head(m)), 1e-7 * rounding);

  const MotionNormal covariance = normal.covariance_band();
  const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(m, m));
  for (int a = 0; a < window.spline.coefficients(); ++a) {
    for (int b = std::max(0, a - kDegree); b <= a; ++b) {
      EXPECT_LT((covariance(a, b) - inverse.block<6, 6>(6 * a, 6 * b)).norm(), 1e-9 * inverse.norm());
    }
  }

  // Without the common parameters the motion's part is the same.
  normal.assemble(window.model, window.blocks, window.spline, scene.x, scene.theta, Terms::all, false,
                  freedom);
  ASSERT_EQ(normal.reduce(), Status::ok);
  EXPECT_LT(relative(flat(normal.motion_step({})), held), 1e-9 * rounding);
}

TEST(WindowNormal, SixChannelsAndOffsetGiveTheDenseNormalEquations) {
  expect_dense_normal_equations<6>(Scene(6, true));
}

TEST(WindowNormal, StudentsNoiseWeighsTheSensorAlone) {
  expect_dense_normal_equations<6>(Scene(6, true), 1e2, 4.0);
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(8, true), 1e2, 1.0);
}

TEST(WindowNormal, WithoutOffsetTheGainsAlone) { expect_dense_normal_equations<6>(Scene(6, false)); }

TEST(WindowNormal, PayloadClockAndTemperatureGiveTheDenseNormalEquations) {
  // Finite differences of the time offset are exact to about 1e-8.
  expect_dense_normal_equations<6>(Scene(6, true, true), 1e4);
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(7, false, true), 1e4);
}

TEST(WindowNormal, DisplacementFromAReferenceGivesTheDenseNormalEquations) {
  expect_dense_normal_equations<6>(Scene(6, true, false, true), 1e2);
  expect_dense_normal_equations<6>(Scene(6, true, true, true), 1e4);
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(7, true, false, true), 1e2);
}

TEST(ReferenceMotion, DisplacedBodyMovesAsTheProductOfThePosesDoes) {
  // Poses by the exponential of SE(3), differentiated numerically.
  const auto pose = [](const Vector6& x) {
    Eigen::Matrix4d m = Eigen::Matrix4d::Zero();
    m.topLeftCorner<3, 3>() = cross_matrix(x.tail<3>());
    m.topRightCorner<3, 1>() = x.head<3>();
    Eigen::Matrix4d sum = Eigen::Matrix4d::Identity(), term = sum;
    for (int k = 1; k < 20; ++k) sum += term = (term * m / k).eval();
    return sum;
  };
  const Vector6 nu(0.3, -0.2, 0.5, 0.4, 0.7, -0.6);
  const Vector6 p0 = 1e-5 * Vector6(1, 2, -1, 3, -2, 1), p1 = 1e-5 * Vector6(-4, 1, 2, 2, 5, -3);
  const auto at = [&](double t) { return Eigen::Matrix4d(pose(nu * t) * pose(p0 + p1 * t)); };
  const double h = 1e-3;
  const Eigen::Matrix4d rate = at(0.0).inverse() * (at(h) - at(-h)) / (2.0 * h);
  ReferencePoint reference;
  reference.nu = nu;
  const MotionState s = reference.displaced(p0, p1, Vector6::Zero(), Vector3(0, 0, -9.81));
  // Second order in the displacement, and in the step.
  EXPECT_LT((Vector3(rate.topRightCorner<3, 1>()) - Vector3(s.nu.head<3>())).norm(), 1e-6);
  EXPECT_LT((Vector3(rate(2, 1), rate(0, 2), rate(1, 0)) - Vector3(s.nu.tail<3>())).norm(), 1e-6);
  const Eigen::Matrix3d turned = pose(p0).topLeftCorner<3, 3>();
  EXPECT_LT((turned.transpose() * Vector3(0, 0, -9.81) - s.gravity).norm(), 1e-8);
  EXPECT_GT((s.nu - nu - p1).norm(), 5e-6);  // which the bracket gives
}

TEST(WindowNormal, EightGaugesGiveTheDenseNormalEquations) {
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(8, true));
}

TEST(WindowNormal, MotionTermsAloneLeaveTheSensorOut) {
  const Scene scene(6, true);
  const Prepared<6> window(scene);
  WindowNormal<6> normal;
  normal.assemble(window.model, window.blocks, window.spline, scene.x, scene.theta, Terms::motion, false);
  const Eigen::VectorXd r = scene.residuals(scene.x, scene.theta, false);
  EXPECT_NEAR(normal.cost(), r.squaredNorm(), 1e-10 * r.squaredNorm());
  ASSERT_EQ(normal.reduce(), Status::ok);
  // Linear: one step is the least-squares spline, where the gradient is zero.
  Scene solved = scene;
  solved.x += normal.motion_step({});
  const Eigen::VectorXd gradient = scene.jacobian(false).leftCols(scene.x.size()).transpose() *
                                   solved.residuals(solved.x, scene.theta, false);
  const Eigen::VectorXd before = scene.jacobian(false).leftCols(scene.x.size()).transpose() * r;
  EXPECT_LT(gradient.norm(), 1e-9 * before.norm());
}

TEST(WindowNormal, MotionThatNoStreamDeterminesIsReported) {
  Scene scene(6, true);
  scene.twist.col(4).setConstant(missing);
  scene.rate.col(4).setConstant(missing);
  const Prepared<6> window(scene);
  WindowNormal<6> normal;
  normal.assemble(window.model, window.blocks, window.spline, scene.x, scene.theta, Terms::motion, false);
  EXPECT_EQ(normal.reduce(), Status::not_factorizable);
}

}  // namespace
}  // namespace truewrench
