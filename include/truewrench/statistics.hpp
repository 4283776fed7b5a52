// What the window estimator tests with: chi-squares per stream, and whether two estimates agree.
#pragma once

#include "truewrench/parameters.hpp"

#include <Eigen/Dense>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>

namespace truewrench {

// Standard normal deviate of a chi-square (Wilson and Hilferty's cube root).
inline double chi_square_deviate(double sum_of_squares, double degrees_of_freedom) {
  const double v = 2.0 / (9.0 * degrees_of_freedom);
  return (std::cbrt(sum_of_squares / degrees_of_freedom) - (1.0 - v)) / std::sqrt(v);
}

// The sum of squares that has a given deviate.
inline double chi_square_at(double deviate, double degrees_of_freedom) {
  const double v = 2.0 / (9.0 * degrees_of_freedom);
  const double root = 1.0 - v + deviate * std::sqrt(v);
  return degrees_of_freedom * root * root * root;
}

// Deviate that noise exceeds with probability p, by Newton's method on the logarithm; p below 0.1.
inline double normal_quantile(double p) {
  double z = std::sqrt(-2.0 * std::log(p));
  for (int i = 0; i < 8; ++i) {
    const double tail = 0.5 * std::erfc(z / std::numbers::sqrt2);
    const double density = std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::numbers::pi);
    z += (std::log(tail) - std::log(p)) * tail / density;
  }
  return z;
}

// Groups of residuals that are judged apart: the sensor's forces and moments (or all channels, when there are not
// six), and the motion's linear and angular parts.
enum Group : std::uint8_t { kForce, kMoment, kLinear, kAngular, kGroups };

struct GroupStatistics {
  double sum_of_squares = 0.0;  // of residuals over their sigma
  double count = 0.0;
  double leverage = 0.0;  // degrees of freedom that the motion took from this group

  void add(double residual) {
    if (!std::isfinite(residual)) return;
    sum_of_squares += residual * residual;
    count += 1.0;
  }

  double degrees_of_freedom() const { return count - leverage; }

  // Standard normal deviate of the sum of squares.
  double deviate() const {
    const double k = degrees_of_freedom();
    return k < 1.0 ? 0.0 : chi_square_deviate(sum_of_squares, k);
  }

  GroupStatistics& operator+=(const GroupStatistics& o) {
    sum_of_squares += o.sum_of_squares;
    count += o.count;
    leverage += o.leverage;
    return *this;
  }
};
using Groups = std::array<GroupStatistics, kGroups>;

// Residuals of one channel, or of one component of the motion: their size, and that of their means over runs of
// 2, 4, 8 ... samples. White noise has the same spectral density at every length; coloured noise has more at
// the lengths that matter to the gain.
struct ComponentStatistics {
  static constexpr int kRuns = 6;

  GroupStatistics all;
  std::array<double, kRuns> run_squares{};  // squared sums of runs over the number of samples in them
  std::array<double, kRuns> runs{};         // how many

  // A whole series, NaN where there is no sample: runs do not reach across.
  template <typename Series>
  void add(const Series& r) {
    for (Eigen::Index k = 0; k < r.size(); ++k) all.add(r[k]);
    for (int level = 0; level < kRuns; ++level) {
      const Eigen::Index length = Eigen::Index{2} << level;
      for (Eigen::Index k = 0; k + length <= r.size(); k += length) {
        const double sum = r.segment(k, length).sum();
        if (!std::isfinite(sum)) continue;
        run_squares[static_cast<std::size_t>(level)] += sum * sum / static_cast<double>(length);
        runs[static_cast<std::size_t>(level)] += 1.0;
      }
    }
  }
};

inline Group wrench_group(int channel, int channels) {
  return channels == 6 && channel >= 3 ? kMoment : kForce;
}
inline Group motion_group(int coordinate) { return coordinate < 3 ? kLinear : kAngular; }

// Squared distance of two estimates of the common parameters of every log in units of the later one's covariance, of the
// log where it is largest.
inline double squared_distance(const std::vector<Eigen::VectorXd>& from, const Posterior& to) {
  double most = 0.0;
  for (std::size_t l = 0; l < from.size(); ++l) {
    const Eigen::VectorXd d = to.mean[l] - from[l];
    most = std::max(most, d.dot(to.covariance[l].llt().solve(d)));
  }
  return most;
}

// Two estimates of the same gain, `coarse` the efficient one and `fine` with fewer assumptions on the motion: the
// standard normal deviate of d^T (P_fine - P_coarse)^+ d over the directions in which the finer one gives up more
// than 1% of the variance (Hausman's test, docs/method.md).
inline double disagreement(const Posterior& coarse, const Posterior& fine, int gains) {
  const Eigen::MatrixXd pc = coarse.covariance.back().topLeftCorner(gains, gains);
  const Eigen::MatrixXd pf = fine.covariance.back().topLeftCorner(gains, gains);
  const Eigen::VectorXd d = fine.mean.back().head(gains) - coarse.mean.back().head(gains);
  const Eigen::LLT<Eigen::MatrixXd> l(pc);
  const Eigen::MatrixXd half = l.matrixL().solve(pf - pc);
  const Eigen::MatrixXd m = l.matrixL().solve(half.transpose());
  const Eigen::VectorXd z = l.matrixL().solve(d);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(0.5 * (m + m.transpose()));
  GroupStatistics test;
  for (int i = 0; i < gains; ++i) {
    if (eigen.eigenvalues()[i] < 0.01) continue;
    const double e = eigen.eigenvectors().col(i).dot(z);
    test.sum_of_squares += e * e / eigen.eigenvalues()[i];
    test.count += 1.0;
  }
  return test.deviate();
}

}  // namespace truewrench
