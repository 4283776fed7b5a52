// Pushes that motion and gain take up (docs/method.md, "Contacts and outliers").
//
// Where a sensor is better than the velocities, it is the sensor that tells the motion, and motion and gain bend to a
// push until little of it is left in the residuals. The score test of a constant push over a stretch knows how much they
// can take, and asks of the rest whether it is noise.
#pragma once

#include "truewrench/contact.hpp"
#include "truewrench/fit.hpp"
#include "truewrench/window.hpp"

#include <Eigen/Cholesky>
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
        channels_(model.layout().channels),
        taken_(static_cast<std::size_t>(fit.spline.intervals())) {
    const auto p = covariance.rows();
    const auto n = static_cast<Eigen::Index>(blocks_.size());
    RowMatrix solved = normal.reduced();  // Hxx^-1 [Hxt, gx]
    normal.factor().solve_backward(solved);
    const WindowModelAt<N> at(model, fit.theta);
    const ChannelVector<N> sigma = model.precision().cwiseInverse();
    counts_.setZero(n + 1, channels_);
    residuals_.setZero(n + 1, channels_);
    by_common_.setZero((n + 1) * channels_, p);
    std::vector<ByMotion> by_motion;  // of the samples of one interval before the end of each of its blocks
    for (Eigen::Index k = 0; k < n; ++k) {
      const WrenchBlock<N>& b = blocks_[static_cast<std::size_t>(k)];
      const auto xi = fit.x.template middleRows<kActive>(b.interval);
      const MotionState state = b.state(xi);
      const Vector6 w = at.wrench_of(state, b.spread);
      const ChannelMatrix<N> by_twist = at.raw_by_twist(state.nu);
      // Of the block's mean, in a sum over its samples.
      const ChannelVector<N> weight = b.weight.cwiseProduct(sigma);
      const ByMotion a = derivative(WrenchTerms<N>(at, b, by_twist), weight);
      const auto taken = solved.template middleRows<kActive * kCoordinates>(kCoordinates * b.interval);
      counts_.row(k + 1) = counts_.row(k) + b.weight.cwiseProduct(sigma.cwiseAbs2()).transpose();
      residuals_.row(k + 1) = residuals_.row(k) - taken.col(p).transpose() * a;
      residuals_.row(k + 1) += weight.cwiseProduct(b.raw - at.raw_of(w, b.temperature)).transpose();
      auto common = by_common_.middleRows((k + 1) * channels_, channels_);
      common = by_common_.middleRows(k * channels_, channels_);
      common.noalias() -= a.transpose() * taken.leftCols(p);
      common += weight.asDiagonal() * at.raw_by_parameters(state, w, b.temperature, by_twist, b.jerk(xi));
      by_motion.push_back(by_motion.empty() ? a : ByMotion(by_motion.back() + a));
      if (k + 1 == n || blocks_[static_cast<std::size_t>(k) + 1].interval != b.interval) {
        const auto first = static_cast<std::size_t>(k + 1) - by_motion.size();
        const double count = (counts_.row(k + 1) - counts_.row(static_cast<Eigen::Index>(first))).sum();
        taken_[static_cast<std::size_t>(b.interval)] = {
            first, by_motion.size(), followed(normal.factor(), b.interval, by_motion, settled * count)};
        by_motion.clear();
      }
    }
    by_covariance_.noalias() = by_common_ * covariance;
  }

  // Decrease of the cost by the push that explains blocks [first, last) of samples best, on all channels or on one.
  ShiftTest test(std::size_t first, std::size_t last) const {
    const auto f = static_cast<Eigen::Index>(first), l = static_cast<Eigen::Index>(last);
    const ChannelVector<N> count = (counts_.row(l) - counts_.row(f)).transpose();
    const auto of = [&](const RowMatrix& sums) -> Common {
      return sums.middleRows(l * channels_, channels_) - sums.middleRows(f * channels_, channels_);
    };
    Square left = of(by_covariance_) * of(by_common_).transpose();
    add_by_motion(first, last, left);
    // V over the samples' own noise (M14b).
    const ChannelVector<N> scale =
        count.unaryExpr([](double c) { return c > 0.0 ? 1.0 / std::sqrt(c) : 0.0; });
    left = -(scale.asDiagonal() * left * scale.asDiagonal()).eval();
    left.diagonal() += count.cwiseProduct(scale.cwiseAbs2());
    const ChannelVector<N> u = (residuals_.row(l) - residuals_.row(f)).transpose().cwiseProduct(scale);
    ShiftTest out;
    for (int i = 0; i < channels_; ++i) {
      if (left(i, i) >= least_left) out.largest = std::max(out.largest, u[i] * u[i] / left(i, i));
    }
    // No eigenvalue exceeds 1, so none is less than their product.
    const Eigen::LLT<Square> llt(left);
    if (llt.info() == Eigen::Success && llt.matrixLLT().diagonal().prod() > std::sqrt(least_left)) {
      out.components = channels_;
      out.sum_of_squares = llt.matrixL().solve(u).squaredNorm();
      return out;
    }
    const Eigen::SelfAdjointEigenSolver<Square> eigen(left);
    const ChannelVector<N> z = eigen.eigenvectors().transpose() * u;
    for (int i = 0; i < channels_; ++i) {
      if (eigen.eigenvalues()[i] < least_left) continue;
      ++out.components;
      out.sum_of_squares += z[i] * z[i] / eigen.eigenvalues()[i];
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
    const auto shortest = std::max<std::size_t>(1, n / (6 * taken_.size()));
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
  using Common = Eigen::Matrix<double, N, Eigen::Dynamic, Eigen::RowMajor>;
  using RowsOfChannels = Eigen::Matrix<double, Eigen::Dynamic, N, Eigen::RowMajor>;
  using Square = Eigen::Matrix<double, N, N>;

  // L^-1 A^T of an interval, A the derivatives by the motion summed over its samples before the end of each block: rows
  // of the coefficients from its first active one to where they no longer matter, the blocks side by side.
  struct Taken {
    std::size_t first = 0;  // block
    std::size_t blocks = 0;
    RowMatrix by_motion;
  };

  static constexpr double margin = 1.5;       // on what colour adds
  static constexpr double settled = 1e-5;     // of a stretch's information, what far coefficients may add
  static constexpr double least_left = 0.01;  // of it, below which a push is not told from the motion

  // Spectral density of the residuals over that of white noise of the stated size, or 1: what is coloured looks like
  // pushes everywhere. The median of squared sums over runs shorter than a knot interval, which pushes here and there
  // do not raise; what the motion has absorbed of it is covered by a margin.
  double noise_density() const {
    const std::size_t n = blocks_.size();
    double largest = 1.0;
    for (std::size_t run = 1; run * taken_.size() <= n; run *= 2) {
      std::vector<double> ratios;
      for (std::size_t k = 0; k + run <= n; k += run) {
        const auto f = static_cast<Eigen::Index>(k), l = static_cast<Eigen::Index>(k + run);
        ShiftTest t;
        for (int i = 0; i < channels_; ++i) {
          const double sum = residuals_(l, i) - residuals_(f, i);
          const double count = counts_(l, i) - counts_(f, i);
          if (count > 0.0) t.add(sum * sum / count);
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

  // Derivative of a block's weighted sum by the coefficients that act on it.
  ByMotion derivative(const WrenchTerms<N>& terms, const ChannelVector<N>& weight) const {
    ByMotion out = ByMotion::Zero(kActive * kCoordinates, channels_);
    for (std::size_t t = 0; t < static_cast<std::size_t>(terms.count); ++t) {
      const ChannelMatrix<N> weighted = weight.asDiagonal() * terms.by[t];
      for (int a = 0; a < kActive; ++a) {
        out.template middleRows<kCoordinates>(kCoordinates * a) +=
            (*terms.basis[t])[a] * weighted.transpose();
      }
    }
    return out;
  }

  // See Taken. Far coefficients are left out once those of a whole degree together add less than `negligible`.
  RowMatrix followed(const MotionNormal& factor, int interval, const std::vector<ByMotion>& by_motion,
                     double negligible) const {
    const auto columns = static_cast<Eigen::Index>(by_motion.size()) * channels_;
    RowMatrix y(kActive * kCoordinates, columns);
    for (std::size_t k = 0; k < by_motion.size(); ++k) {
      y.middleCols(static_cast<Eigen::Index>(k) * channels_, channels_) = by_motion[k];
    }
    int row = 0;
    for (int quiet = 0; interval + row < factor.blocks() && quiet < kActive; ++row) {
      if (kCoordinates * row == y.rows()) {
        y.conservativeResize(2 * y.rows(), Eigen::NoChange);
        y.bottomRows(y.rows() / 2).setZero();
      }
      factor.forward_row(y, interval + row, interval);
      const auto all = y.block(kCoordinates * row, columns - channels_, kCoordinates, channels_);
      if (row >= kActive) quiet = all.squaredNorm() < negligible ? quiet + 1 : 0;
    }
    y.conservativeResize(kCoordinates * row, Eigen::NoChange);
    return y;
  }

  // A Hxx^-1 A^T of blocks [first, last), what the motion takes of their variance.
  void add_by_motion(std::size_t first, std::size_t last, Square& sum) const {
    const int from = blocks_[first].interval, to = blocks_[last - 1].interval;
    Eigen::Index rows = 0;
    for (int i = from; i <= to; ++i) {
      rows = std::max(rows, kCoordinates * (i - from) + taken_[static_cast<std::size_t>(i)].by_motion.rows());
    }
    RowsOfChannels y = RowsOfChannels::Zero(rows, channels_);
    for (int i = from; i <= to; ++i) {
      const Taken& t = taken_[static_cast<std::size_t>(i)];
      if (t.blocks == 0) continue;
      const auto before = [&](std::size_t block) {  // of a block of the interval or behind it
        return t.by_motion.middleCols(
            static_cast<Eigen::Index>(std::min(block - t.first, t.blocks) - 1) * channels_, channels_);
      };
      auto of = y.middleRows(kCoordinates * (i - from), t.by_motion.rows());
      of += before(last);
      if (first > t.first) of -= before(first);
    }
    for (Eigen::Index r = 0; r < rows; r += kCoordinates) {
      const auto row = y.template middleRows<kCoordinates>(r);
      sum.noalias() += row.transpose().lazyProduct(row);
    }
  }

  const std::vector<WrenchBlock<N>>& blocks_;
  int channels_;
  std::vector<Taken> taken_;  // per interval
  // Sums over the samples of the blocks before k, over their sigma: samples per channel; the residuals and their
  // derivatives by the common parameters, both with the motion following; the latter times the parameters' covariance.
  RowMatrix counts_;
  RowMatrix residuals_;
  RowMatrix by_common_;
  RowMatrix by_covariance_;
};

}  // namespace truewrench
