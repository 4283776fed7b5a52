// Samples averaged over blocks against the samples themselves.
#include "truewrench/window.hpp"

#include "dense_window.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

// 480 samples in one second, of a motion that the spline holds exactly.
struct Averaged {
  Scene scene{6, true};

  explicit Averaged(bool noise) {
    scene.breakpoints = {0.0, 0.25, 0.5, 0.75, 1.0};
    std::mt19937 random(2);
    scene.x = oracle::normal_matrix(random, 9, 6);
    scene.rate_time.clear();
    scene.twist_time.clear();
    scene.sensor_time.clear();
    for (int k = 0; k < 480; ++k) {
      scene.twist_time.push_back((k + 0.5) / 480.0);
      scene.sensor_time.push_back((k + 0.5) / 480.0);
    }
    scene.twist =
        (noise ? 1.0 : 0.0) * oracle::normal_matrix(random, 480, 6) * scene.twist_sigma.asDiagonal();
    scene.raw = (noise ? 1.0 : 0.0) * oracle::normal_matrix(random, 480, 6) *
                scene.channel.cwiseProduct(scene.sensor_sigma).asDiagonal();
    scene.gravity.resize(480, 3);
    for (Eigen::Index k = 0; k < 480; ++k) {
      const double t = scene.sensor_time[static_cast<std::size_t>(k)];
      scene.gravity.row(k) = 9.81 * Eigen::RowVector3d(std::sin(t), std::cos(t), 0.0);
      const Vector6 s = scene.x.transpose() * oracle::basis(scene.breakpoints, t, 0);
      const Vector6 ds = scene.x.transpose() * oracle::basis(scene.breakpoints, t, 1);
      const Vector6 w =
          oracle::wrench(scene.payload.mass, scene.payload.center_of_mass, scene.payload.inertia, scene.point,
                         s, ds, scene.gravity.row(k).transpose())
              .cwiseProduct(scene.wrench_scale);
      scene.twist.row(k) += s;
      for (int i = 0; i < 6; ++i) {
        scene.raw(k, i) += scene.channel[i] * (scene.theta.segment<6>(6 * i).dot(w) + scene.theta[36 + i]);
      }
    }
  }

  struct Sums {
    double cost;
    Eigen::MatrixXd information;
    Eigen::VectorXd score;
  };
  Sums sums(int per_interval) const {
    const Prepared<6> window(scene, per_interval);
    WindowNormal<6> normal;
    normal.assemble(window.model, window.blocks, window.spline, scene.x, scene.theta, Terms::all, true);
    EXPECT_EQ(normal.reduce(), Status::ok);
    return {normal.cost(), normal.information(), normal.score()};
  }
};

TEST(Blocks, MeanWrenchIsRightToTheFourthOrderOfTheBlockLength) {
  const Averaged log(false);
  EXPECT_LT(log.sums(one_sample_a_block).cost, 1e-18);
  const double coarse = log.sums(5).cost;
  const double middle = log.sums(10).cost;
  const double fine = log.sums(20).cost;
  // Residuals of fourth order, squared.
  EXPECT_NEAR(std::log2(coarse / middle), 8.0, 1.0);
  EXPECT_NEAR(std::log2(middle / fine), 8.0, 1.0);
  EXPECT_LT(log.sums(12).cost, 0.05);  // of a chi-square whose expectation is one per degree of freedom
}

TEST(Blocks, InformationLostByAveragingIsOfSecondOrder) {
  const Averaged log(false);
  const Eigen::MatrixXd exact = log.sums(one_sample_a_block).information;
  const double coarse = relative(log.sums(10).information, exact);
  const double fine = relative(log.sums(20).information, exact);
  EXPECT_LT(fine, 0.02);
  EXPECT_NEAR(std::log2(coarse / fine), 2.0, 0.5);
}

TEST(Blocks, StepFromNoisySamplesIsThatOfTheSamplesToAFractionOfSigma) {
  const Averaged log(true);
  const auto step = [](const Averaged::Sums& s) {
    const Eigen::MatrixXd prior = Eigen::MatrixXd::Identity(s.score.size(), s.score.size()) / (0.3 * 0.3);
    return Eigen::VectorXd((s.information + prior).llt().solve(s.score));
  };
  const Averaged::Sums exact = log.sums(one_sample_a_block);
  const Eigen::VectorXd d = step(log.sums(12)) - step(exact);
  const Eigen::VectorXd sigma =
      (exact.information + Eigen::MatrixXd::Identity(42, 42) / 0.09).inverse().diagonal().cwiseSqrt();
  EXPECT_LT((d.cwiseQuotient(sigma)).cwiseAbs().maxCoeff(), 0.5);
}

TEST(Blocks, MissingComponentsAreMissingInTheInformationToo) {
  Averaged log(true);
  for (int k = 100; k < 140; ++k) log.scene.raw(k, 2) = log.scene.twist(k, 4) = missing;
  const Averaged::Sums averaged = log.sums(12);
  const Averaged::Sums exact = log.sums(one_sample_a_block);
  EXPECT_LT(relative(averaged.information, exact.information), 0.02);
  EXPECT_LT(relative(averaged.information, Averaged(true).sums(12).information), 0.2);
  EXPECT_GT(relative(averaged.information, Averaged(true).sums(12).information), 0.02);
}

}  // namespace
}  // namespace truewrench
