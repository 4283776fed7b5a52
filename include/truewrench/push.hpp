// Pushes that motion and gain take up (docs/method.md, "Contacts and outliers").
//
// Where a sensor is better than the velocities, it is the sensor that tells the motion, and motion and gain bend to a
// push until little of it is left in the residuals. The score test of a constant push over a stretch knows how much they
// can take, and asks of the rest whether it is noise.
#pragma once

#include "truewrench/contact.hpp"
#include "truewrench/fit.hpp"
#include "truewrench/window.hpp"

#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace truewrench {

template <int N>
class PushScan {
 public:
  // `normal`: reduced on the knots of `fit` with its common parameters, `blocks` its samples. `covariance`: of the
  // common parameters, after all that is known of them.
  PushScan(const WindowModel<N>& model, const WindowFit& fit, const Blocks<N>& blocks,
           const WindowNormal<N>& normal, const Eigen::MatrixXd& covariance)
      : blocks_(blocks.wrench),
        factor_(normal.factor()),
        covariance_(covariance),
        channels_(model.layout().channels),
        intervals_(fit.spline.intervals()) {
    const auto p = covariance.rows();
    RowMatrix solved = normal.reduced();  // Hxx^-1 [Hxt, gx]
    factor_.solve_backward(solved);
    const WindowModelAt<N> at(model, fit.theta);
    const ChannelVector<N> sigma = model.precision().cwiseInverse();
    sums_.setZero(static_cast<Eigen::Index>(blocks_.size()) + 1, channels_ * (2 + p));
    for (std::size_t k = 0; k < blocks_.size(); ++k) {
      const WrenchBlock<N>& b = blocks_[k];
      const auto xi = fit.x.template middleRows<kActive>(b.interval);
      const MotionState state = b.state(xi);
      const Vector6 w = at.wrench_of(state, b.spread);
      const ChannelMatrix<N> by_twist = at.raw_by_twist(state.nu);
      // Of the block's mean, in a sum over its samples.
      const ChannelVector<N> weight = b.weight.cwiseProduct(sigma);
      const WrenchTerms<N> terms(at, b, by_twist);
      ByMotion by_motion = ByMotion::Zero(kActive * kCoordinates, channels_);
      for (std::size_t t = 0; t < static_cast<std::size_t>(terms.count); ++t) {
        const ChannelMatrix<N> weighted = weight.asDiagonal() * terms.by[t];
        for (int a = 0; a < kActive; ++a) {
          by_motion.template middleRows<kCoordinates>(kCoordinates * a) +=
              (*terms.basis[t])[a] * weighted.transpose();
        }
      }
      const auto taken = solved.template middleRows<kActive * kCoordinates>(kCoordinates * b.interval);
      auto sum = sums_.row(static_cast<Eigen::Index>(k) + 1);
      sum = sums_.row(static_cast<Eigen::Index>(k));
      sum.head(channels_) += b.weight.cwiseProduct(sigma.cwiseAbs2()).transpose();
      sum.segment(channels_, channels_) +=
          (weight.cwiseProduct(b.raw - at.raw_of(w, b.temperature)) - by_motion.transpose() * taken.col(p))
              .transpose();
      Eigen::Map<RowMatrix>(sum.data() + 2 * channels_, channels_, p) +=
          weight.asDiagonal() * at.raw_by_parameters(state, w, b.temperature, by_twist, b.jerk(xi)) -
          by_motion.transpose() * taken.leftCols(p);
      by_motion_.push_back(by_motion);
    }
  }

  // Decrease of the cost by the push that explains blocks [first, last) of samples best, on all channels or on one.
  ShiftTest test(std::size_t first, std::size_t last) const {
    const Eigen::RowVectorXd sum =
        sums_.row(static_cast<Eigen::Index>(last)) - sums_.row(static_cast<Eigen::Index>(first));
    const ChannelVector<N> count = sum.head(channels_).transpose();
    const Eigen::Map<const RowMatrix> by_common(sum.data() + 2 * channels_, channels_, covariance_.rows());
    const Eigen::MatrixXd taken =
        by_motion(first, last, settled * count.sum()) + by_common * covariance_ * by_common.transpose();
    // V over the samples' own noise (M14b).
    const ChannelVector<N> scale =
        count.unaryExpr([](double c) { return c > 0.0 ? 1.0 / std::sqrt(c) : 0.0; });
    const Eigen::MatrixXd left = Eigen::MatrixXd(count.cwiseProduct(scale.cwiseAbs2()).asDiagonal()) -
                                 scale.asDiagonal() * taken * scale.asDiagonal();
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(left);
    const Eigen::VectorXd u = sum.segment(channels_, channels_).transpose().cwiseProduct(scale);
    const Eigen::VectorXd z = eigen.eigenvectors().transpose() * u;
    ShiftTest out;
    for (int i = 0; i < channels_; ++i) {
      if (eigen.eigenvalues()[i] < least_left) continue;
      ++out.components;
      out.sum_of_squares += z[i] * z[i] / eigen.eigenvalues()[i];
    }
    for (int i = 0; i < channels_; ++i) {
      if (left(i, i) >= least_left) out.largest = std::max(out.largest, u[i] * u[i] / left(i, i));
    }
    return out;
  }

  // The strongest push beyond what chance gives, from a sixth of a knot interval to a third of the window, in samples of
  // the log; none: of no samples. Through the gain it throws shadows on all the log, which are not told from other pushes.
  Disturbance strongest(double false_alarms) const {
    const std::size_t n = blocks_.size();
    const std::size_t longest = n / 3;
    const double density = noise_density();
    const auto deviate = [&](std::size_t first, std::size_t last) {
      return test(first, last).deviate(density);
    };
    Disturbance most;
    std::size_t looks = 0;
    const auto shortest = std::max<std::size_t>(1, n / static_cast<std::size_t>(6 * intervals_));
    for (std::size_t length = shortest; length <= longest; length *= 2) {
      for (std::size_t k = 0; k + length <= n; k += std::max<std::size_t>(1, length / 4)) {
        const double z = deviate(k, k + length);
        if (z > most.deviate) most = {k, k + length, z};
        looks += 1 + 2 * static_cast<std::size_t>(channels_);  // one channel's push has a sign
      }
    }
    if (looks == 0 || most.deviate < normal_quantile(false_alarms / static_cast<double>(looks))) return {};
    most = trimmed(most, n, [&](std::size_t first, std::size_t last) {
      return last - first > longest ? 0.0 : deviate(first, last);
    });
    return {blocks_[most.first].first, blocks_[most.last - 1].last, most.deviate};
  }

 private:
  using ByMotion = Eigen::Matrix<double, kActive * kCoordinates, N, Eigen::RowMajor>;

  static constexpr double margin = 1.5;       // on what colour adds
  static constexpr double settled = 1e-5;     // of a stretch's information, what far coefficients may add
  static constexpr double least_left = 0.01;  // of it, below which a push is not told from the motion

  // Spectral density of the residuals over that of white noise of the stated size, or 1: what is coloured looks like
  // pushes everywhere. The median of squared sums over runs shorter than a knot interval, which pushes here and there
  // do not raise; what the motion has absorbed of it is covered by a margin.
  double noise_density() const {
    const std::size_t n = blocks_.size();
    double largest = 1.0;
    for (std::size_t run = 1; run * static_cast<std::size_t>(intervals_) <= n; run *= 2) {
      std::vector<double> ratios;
      for (std::size_t k = 0; k + run <= n; k += run) {
        const Eigen::RowVectorXd sum = sums_.row(static_cast<Eigen::Index>(k + run)).head(2 * channels_) -
                                       sums_.row(static_cast<Eigen::Index>(k)).head(2 * channels_);
        ShiftTest t;
        for (int i = 0; i < channels_; ++i) {
          if (sum[i] > 0.0) t.add(sum[channels_ + i] * sum[channels_ + i] / sum[i]);
        }
        if (t.components > 0) ratios.push_back(t.sum_of_squares / chi_square_at(0.0, t.components));
      }
      if (ratios.empty()) continue;
      const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
      std::nth_element(ratios.begin(), middle, ratios.end());
      largest = std::max(largest, *middle);
    }
    return 1.0 + margin * (largest - 1.0);
  }

  // A Hxx^-1 A^T of the derivatives A of the samples' sum, what the motion takes of its variance.
  Eigen::MatrixXd by_motion(std::size_t first, std::size_t last, double negligible) const {
    const int from = blocks_[first].interval;
    const int behind = blocks_[last - 1].interval + kActive;  // coefficients that do not act on the stretch
    RowMatrix y = RowMatrix::Zero(kCoordinates * (factor_.blocks() - from), channels_);
    for (std::size_t k = first; k < last; ++k) {
      y.template middleRows<kActive * kCoordinates>(kCoordinates * (blocks_[k].interval - from)) +=
          by_motion_[k];
    }
    Eigen::MatrixXd taken = Eigen::MatrixXd::Zero(channels_, channels_);
    int quiet = 0;
    for (int j = from; j < factor_.blocks() && quiet < kActive; ++j) {
      factor_.forward_row(y, j, from);
      const auto row = y.template middleRows<kCoordinates>(kCoordinates * (j - from));
      taken.noalias() += row.transpose() * row;
      if (j >= behind) quiet = row.squaredNorm() < negligible ? quiet + 1 : 0;
    }
    return taken;
  }

  const std::vector<WrenchBlock<N>>& blocks_;
  const MotionNormal& factor_;
  const Eigen::MatrixXd& covariance_;
  int channels_;
  int intervals_;
  // Sums over the samples of the blocks before k, residuals and derivatives over their sigma: samples per channel; the
  // residuals and their derivatives by the common parameters, both with the motion following.
  RowMatrix sums_;
  // Sums over a block's samples of the derivatives by its active coefficients.
  std::vector<ByMotion> by_motion_;
};

}  // namespace truewrench
