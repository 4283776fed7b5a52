// The test of a push against the dense problem in which it is an unknown.
#include "truewrench/push.hpp"

#include "dense_window.hpp"

#include <gtest/gtest.h>

#include <numeric>

namespace truewrench {
namespace {

// What a constant push of samples [first, last), on all channels or on one, lowers the dense cost by, with a unit prior on
// the common parameters whose optimum they are.
template <int N>
void expect_dense_push(const Scene& scene, std::size_t first, std::size_t last, double rounding = 1.0) {
  const Prepared<N> window(scene);
  const Blocks<N>& blocks = window.blocks;
  WindowFit fit;
  fit.spline = window.spline;
  fit.x = scene.x;
  fit.theta = scene.theta;
  WindowNormal<N> normal;
  normal.assemble(window.model, blocks, fit.spline, fit.x, fit.theta, Terms::all, true);
  ASSERT_EQ(normal.reduce(), Status::ok);
  const Eigen::Index m = scene.x.size(), p = scene.theta.size(), n = scene.channels;
  const Eigen::MatrixXd prior = Eigen::MatrixXd::Identity(p, p);
  const Eigen::MatrixXd covariance = (normal.information() + prior).inverse();

  const Eigen::VectorXd r = scene.residuals(scene.x, scene.theta);
  Eigen::MatrixXd j = Eigen::MatrixXd::Zero(r.size(), m + p + n);
  j.leftCols(m + p) = scene.jacobian();
  Eigen::Index row = scene.residuals(scene.x, scene.theta, false).size();
  for (Eigen::Index k = 0; k < scene.raw.rows(); ++k) {
    for (Eigen::Index i = 0; i < n; ++i) {
      if (std::isnan(scene.raw(k, i))) continue;
      const auto sample = static_cast<std::size_t>(k);
      j(row++, m + p + i) = first <= sample && sample < last ? -1.0 : 0.0;
    }
  }
  Eigen::MatrixXd h = j.transpose() * j;
  h.block(m, m, p, p) += prior;
  Eigen::VectorXd g = -j.transpose() * r;
  g.segment(m, p) -= normal.score();  // what the prior pulls
  const auto decrease = [&](Eigen::Index at, Eigen::Index channels) {
    std::vector<Eigen::Index> unknowns(static_cast<std::size_t>(m + p));
    std::iota(unknowns.begin(), unknowns.end(), 0);
    for (Eigen::Index c = 0; c < channels; ++c) unknowns.push_back(m + p + at + c);
    const Eigen::VectorXd of = g(unknowns);
    return of.dot(h(unknowns, unknowns).ldlt().solve(of));
  };
  const double without = decrease(0, 0);
  const double expected = decrease(0, n) - without;
  double largest = 0.0;
  for (Eigen::Index c = 0; c < n; ++c) largest = std::max(largest, decrease(c, 1) - without);

  const PushScan<N> scan(window.model, fit, blocks, normal, covariance);
  const auto block = [&](std::size_t sample) {  // the first that does not lie before it
    std::size_t b = 0;
    while (b < blocks.wrench.size() && blocks.wrench[b].first < sample) ++b;
    return b;
  };
  const ShiftTest found = scan.test(block(first), block(last));
  EXPECT_EQ(found.components, n);
  EXPECT_NEAR(found.sum_of_squares / expected, 1.0, 1e-8 * rounding);
  EXPECT_NEAR(found.largest / largest, 1.0, 1e-8 * rounding);
}

TEST(PushScan, DecreaseOfTheCostIsThatOfTheDenseProblem) {
  expect_dense_push<6>(Scene(6, true), 5, 20);
  expect_dense_push<6>(Scene(6, true), 20, 27);
  expect_dense_push<6>(Scene(6, true, true), 5, 20, 1e3);
  expect_dense_push<6>(Scene(6, true, false, true), 5, 20, 1e2);
  expect_dense_push<Eigen::Dynamic>(Scene(8, true), 3, 15);
}

}  // namespace
}  // namespace truewrench
