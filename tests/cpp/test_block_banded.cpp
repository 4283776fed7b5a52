// The banded factorisation against dense matrices.
#include "truewrench/block_banded.hpp"

#include "oracles.hpp"

#include <gtest/gtest.h>
#include <Eigen/Dense>

namespace truewrench {
namespace {

// A random symmetric positive definite matrix with the band of BlockBanded<B, W>.
template <int B, int W>
Eigen::MatrixXd random_band(int blocks, unsigned seed) {
  std::mt19937 random(seed);
  Eigen::MatrixXd root = oracle::normal_matrix(random, B * blocks, B * blocks);
  for (int i = 0; i < blocks; ++i) {
    for (int j = 0; j < blocks; ++j) {
      if (j > i || i - j > W) root.block<B, B>(B * i, B * j).setZero();
    }
  }
  return root * root.transpose() + 0.1 * Eigen::MatrixXd::Identity(root.rows(), root.cols());
}

template <int B, int W>
BlockBanded<B, W> banded(const Eigen::MatrixXd& dense) {
  BlockBanded<B, W> h;
  h.reset(static_cast<int>(dense.rows()) / B);
  for (int j = 0; j < h.blocks(); ++j) {
    for (int i = j; i <= std::min(j + W, h.blocks() - 1); ++i) h(i, j) = dense.block<B, B>(B * i, B * j);
  }
  return h;
}

template <typename Shape>
class AnyBand : public testing::Test {};
template <int B, int W>
struct Shape {
  static constexpr int block = B;
  static constexpr int width = W;
};
using Shapes = testing::Types<Shape<6, 5>, Shape<3, 2>, Shape<1, 1>>;
TYPED_TEST_SUITE(AnyBand, Shapes);

TYPED_TEST(AnyBand, SolvesAsTheDenseMatrixDoes) {
  constexpr int B = TypeParam::block;
  constexpr int W = TypeParam::width;
  for (const int blocks : {1, 2, W + 1, 3 * W + 4}) {
    const Eigen::MatrixXd h = random_band<B, W>(blocks, 3);
    std::mt19937 random(4);
    const Eigen::MatrixXd r = oracle::normal_matrix(random, h.rows(), 4);
    BlockBanded<B, W> factor = banded<B, W>(h);
    ASSERT_EQ(factor.factorize(), Status::ok);
    typename BlockBanded<B, W>::Rows z = r;
    factor.solve_forward(z);
    const Eigen::MatrixXd l = h.llt().matrixL();
    EXPECT_LT((l * z - r).norm(), 1e-10 * r.norm());
    factor.solve_backward(z);
    EXPECT_LT((h * z - r).norm(), 1e-9 * r.norm());
  }
}

TYPED_TEST(AnyBand, InverseInsideTheBandIsThatOfTheDenseInverse) {
  constexpr int B = TypeParam::block;
  constexpr int W = TypeParam::width;
  for (const int blocks : {1, 2, W + 1, 3 * W + 4}) {
    const Eigen::MatrixXd h = random_band<B, W>(blocks, 7);
    BlockBanded<B, W> factor = banded<B, W>(h);
    ASSERT_EQ(factor.factorize(), Status::ok);
    const auto z = factor.inverse_band();
    const Eigen::MatrixXd inverse = h.inverse();
    for (int j = 0; j < blocks; ++j) {
      for (int i = j; i <= std::min(j + W, blocks - 1); ++i) {
        EXPECT_LT((z(i, j) - inverse.block<B, B>(B * i, B * j)).norm(), 1e-9 * inverse.norm())
            << i << " " << j;
      }
    }
  }
}

TEST(BlockBanded, MatrixWithoutInformationOnOneDirectionIsSingular) {
  Eigen::MatrixXd h = random_band<3, 2>(6, 11);
  h.row(10).setZero();
  h.col(10).setZero();
  EXPECT_EQ((banded<3, 2>(h).factorize()), Status::not_factorizable);
}

TEST(BlockBanded, MatrixOfDeficientRankIsSingularToWorkingPrecision) {
  // Two directions that are always seen together: their difference is not determined.
  Eigen::MatrixXd h = random_band<3, 2>(6, 12);
  h.row(8) = h.row(7);
  h.col(8) = h.col(7);
  EXPECT_EQ((banded<3, 2>(h).factorize()), Status::not_factorizable);
}

TEST(BlockBanded, IndefiniteOrInvalidMatrixIsNotFactored) {
  Eigen::MatrixXd h = random_band<3, 2>(6, 13);
  Eigen::MatrixXd negative = h;
  negative(17, 17) = -1.0;
  EXPECT_EQ((banded<3, 2>(negative).factorize()), Status::not_factorizable);
  h(4, 4) = std::nan("");
  EXPECT_EQ((banded<3, 2>(h).factorize()), Status::not_factorizable);
}

TEST(BlockBanded, UnitsOfTheUnknownsDoNotDecideWhatIsSingular) {
  Eigen::MatrixXd h = random_band<3, 2>(6, 14);
  Eigen::VectorXd unit(18);
  for (int i = 0; i < 18; ++i) unit[i] = std::pow(10.0, i % 3 * 6 - 6);
  const Eigen::MatrixXd scaled = unit.asDiagonal() * h * unit.asDiagonal();
  EXPECT_EQ((banded<3, 2>(scaled).factorize()), Status::ok);
}

}  // namespace
}  // namespace truewrench
