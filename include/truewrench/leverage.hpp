// trace(W J Hxx^-1 J^T) per channel and component of the motion: the degrees of freedom that the motion of a window
// took from its streams (docs/method.md, "Knots").
#pragma once

#include "truewrench/fit.hpp"
#include "truewrench/window.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace truewrench {

// `normal` holds the factor of the knots of `fit`, `blocks` its samples.
template <int N>
class Leverage {
 public:
  Leverage(const WindowModel<N>& model, const WindowFit& fit, const Blocks<N>& blocks,
           const WindowNormal<N>& normal)
      : fit_(fit),
        blocks_(blocks),
        normal_(normal),
        channels_(model.layout().channels),
        model_(model, fit.theta) {}

  // Per channel, then per component of the motion.
  std::vector<double> of_components() const {
    const double all = static_cast<double>(kCoordinates * fit_.spline.coefficients());
    std::vector<double> found = by_band();
    double total = 0.0;
    for (const double l : found) total += l;
    // The recursion inside the band cancels where the velocities hardly hold the motion; all leverages together
    // are the number of coefficients, which tells.
    const bool sound = std::abs(total - all) < 1e-3 * all &&
                       std::all_of(found.begin(), found.end(), [](double l) { return l >= 0.0; });
    return sound ? found : by_probes();
  }

 private:
  using Active = Eigen::Matrix<double, kActive, kCoordinates, Eigen::RowMajor>;

  auto active(int interval) const { return fit_.x.template middleRows<kActive>(interval); }

  WrenchTerms<N> terms(const WrenchBlock<N>& b) const {
    return WrenchTerms<N>(model_, b, model_.raw_by_twist(b.state(active(b.interval)).nu));
  }

  std::vector<double> blank() const {
    return std::vector<double>(static_cast<std::size_t>(channels_ + kCoordinates), 0.0);
  }

  // By the blocks of Hxx^-1 inside the band.
  std::vector<double> by_band() const {
    std::vector<double> out = blank();
    const MotionNormal z = normal_.covariance_band();
    const auto covariance = [&](int interval, const BasisRow& a, const BasisRow& b) {
      Matrix6 sum = Matrix6::Zero();
      for (int k = 0; k < kActive; ++k) {
        for (int l = 0; l < kActive; ++l) {
          if (k >= l) {
            sum += (a[k] * b[l]) * z(interval + k, interval + l);
          } else {
            sum += (a[k] * b[l]) * z(interval + l, interval + k).transpose();
          }
        }
      }
      return sum;
    };
    for (const MotionBlock& b : blocks_.motion) {
      const Matrix6 ss = covariance(b.interval, b.basis, b.basis);
      Vector6 variance = b.scale.cwiseAbs2().cwiseProduct(ss.diagonal());
      if (b.rows >= 0) {
        const MotionBlock::Rows& j = blocks_.rows[static_cast<std::size_t>(b.rows)];
        const Matrix6 sl = covariance(b.interval, b.basis, j.lower);
        const Matrix6 ll = covariance(b.interval, j.lower, j.lower);
        const Matrix6 all = j.of * ss * j.of.transpose() + 2.0 * j.of * sl * j.of_lower.transpose() +
                            j.of_lower * ll * j.of_lower.transpose();
        variance = all.diagonal();
      }
      for (int c = 0; c < 6; ++c) out[static_cast<std::size_t>(channels_ + c)] += variance[c];
    }
    for (const WrenchBlock<N>& b : blocks_.wrench) {
      const WrenchTerms<N> t = terms(b);
      for (std::size_t i = 0; i < static_cast<std::size_t>(t.count); ++i) {
        for (std::size_t j = 0; j <= i; ++j) {
          const Matrix6 v = (i == j ? 1.0 : 2.0) * covariance(b.interval, *t.basis[i], *t.basis[j]);
          for (int c = 0; c < channels_; ++c) {
            out[static_cast<std::size_t>(c)] +=
                b.weight[c] * t.by[i].row(c).dot(t.by[j].row(c) * v.transpose());
          }
        }
      }
    }
    return out;
  }

  // By Hutchinson's estimator: z^T A z with random signs z has the mean trace(A), and needs only solutions.
  std::vector<double> by_probes() const {
    constexpr int probes = 16;
    using Signs = Eigen::Matrix<double, 1, probes>;
    std::vector<double> out = blank();
    Eigen::MatrixXd y = Eigen::MatrixXd::Zero(kCoordinates * fit_.spline.coefficients(), probes);
    // Twice over the rows J of the whitened problem: y = J^T z, then z^T J H^-1 y per component.
    for (const bool forward : {true, false}) {
      std::minstd_rand random(1);
      for_each_row([&](int component, int interval, const Active& row) {
        const auto bits = static_cast<unsigned>(random());
        Signs z;
        for (int p = 0; p < probes; ++p) z[p] = bits >> (p + 8) & 1U ? 1.0 : -1.0;
        const Eigen::Map<const Eigen::Matrix<double, kActive * kCoordinates, 1>> r(row.data());
        auto entries = y.middleRows<kActive * kCoordinates>(kCoordinates * interval);
        if (forward) {
          entries.noalias() += r * z;
        } else {
          out[static_cast<std::size_t>(component)] += (r.transpose() * entries).dot(z) / probes;
        }
      });
      if (forward) normal_.solve(y);
    }
    for (double& l : out) l = std::max(l, 0.0);
    return out;
  }

  // Calls visit(component, interval, derivatives by the active coefficients) for the rows of the whitened problem.
  template <typename Visit>
  void for_each_row(const Visit& visit) const {
    for (const MotionBlock& b : blocks_.motion) {
      for (int c = 0; c < kCoordinates; ++c) {
        Active row = Active::Zero();
        if (b.rows < 0) {
          row.col(c) = b.scale[c] * b.basis;
        } else {
          const MotionBlock::Rows& j = blocks_.rows[static_cast<std::size_t>(b.rows)];
          row = b.basis * j.of.row(c) + j.lower * j.of_lower.row(c);
        }
        visit(channels_ + c, b.interval, row);
      }
    }
    for (const WrenchBlock<N>& b : blocks_.wrench) {
      const WrenchTerms<N> t = terms(b);
      for (int c = 0; c < channels_; ++c) {
        Active row = Active::Zero();
        for (std::size_t i = 0; i < static_cast<std::size_t>(t.count); ++i) {
          row += std::sqrt(b.weight[c]) * *t.basis[i] * t.by[i].row(c);
        }
        visit(c, b.interval, row);
      }
    }
  }

  const WindowFit& fit_;
  const Blocks<N>& blocks_;
  const WindowNormal<N>& normal_;
  int channels_;
  WindowModelAt<N> model_;
};

}  // namespace truewrench
