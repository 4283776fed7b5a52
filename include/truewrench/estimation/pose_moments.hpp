// What follows the pose of the sensor hides in the gain, unseen in the residuals (METHOD (10.10)).
#pragma once

#include "truewrench/math/dense.hpp"
#include "truewrench/math/nodes.hpp"
#include "truewrench/types.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace truewrench {

// How far a force that follows the pose can hide in the gain (10.10).
struct PoseShare {
  // mean R^2 of the components of the pose that move on (w, 1), the larger of what two poses have; 1 where none moves: at rest
  // the pose is the wrench
  double A = 0.0;
  Matrix6 ww = Matrix6::Zero();  // E w w^T over the unmasked samples
  double period = 1.0;           // [s] 1 / mean frequency of w, weighted by its power
};

// Sums over unmasked samples: of w, and of w and each of two poses about their means in each stretch.
struct PoseMoments {
  static constexpr int kPoses = 2;
  double samples = 0.0, ww[6][6] = {}, centred[6][6] = {}, wp[kPoses][6][6] = {}, pp[kPoses][6] = {};
  double rate[6] = {};  // of (dw / dt)^2

  PoseShare share() const {
    PoseShare out;
    if (samples == 0.0) return out;
    double correlation[6][6], V[6][6], size[6], frequency = 0.0;
    int axes = 0;
    for (int i = 0; i < 6; ++i) size[i] = std::max(std::sqrt(std::max(centred[i][i], 0.0)), 1e-300);
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j) {
        out.ww(i, j) = ww[i][j] / samples;
        correlation[i][j] = centred[i][j] / (size[i] * size[j]);
      }
    diagonalise(correlation, V);
    for (int j = 0; j < 6; ++j)
      if (centred[j][j] > 1e-12 * samples) {
        frequency += std::sqrt(rate[j] / centred[j][j]) / (2.0 * std::numbers::pi);
        ++axes;
      }
    for (int pose = 0; pose < kPoses; ++pose) {
      double total = 0.0;
      int moving = 0;
      for (int j = 0; j < 6; ++j) {
        if (!(std::sqrt(pp[pose][j] / samples) > 1e-6)) continue;  // components that do not move
        double explained = 0.0;
        for (int i = 0; i < 6; ++i) {
          if (!(correlation[i][i] > 1e-12)) continue;
          double b = 0.0;
          for (int c = 0; c < 6; ++c) b += V[c][i] * wp[pose][c][j] / size[c];
          explained += b * b / correlation[i][i];
        }
        total += std::min(1.0, explained / pp[pose][j]);
        ++moving;
      }
      out.A = std::max(out.A, moving > 0 ? total / moving : 1.0);
    }
    out.period = axes > 0 && frequency > 0.0 ? axes / frequency : 1.0;
    return out;
  }
};

// (E w w^T)^-1 A / (1 - A) / 6, as ill-conditioned as it may be; whether it is there.
inline bool unit_covariance(const PoseShare& share, double (&unit)[6][6]) {
  const double least = 1e-12 * std::max(share.ww.trace(), 1e-12);
  const double times = std::min(share.A, 1.0 - 1e-9) / std::max(1.0 - share.A, 1e-9) / 6.0;
  for (int c = 0; c < 6; ++c) {
    double ww[6][6], b[6] = {};
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j) ww[i][j] = share.ww(i, j) + (i == j ? least : 0.0);
    b[c] = 1.0;
    if (!dense::solve(&ww[0][0], b, 6)) return false;
    for (int d = 0; d < 6; ++d) unit[c][d] = times * b[d];
    for (int d = 0; d < c; ++d) unit[c][d] = unit[d][c];
  }
  return true;
}

// By what a gain's row is multiplied so that its variance does not rise above its prior's.
inline double within_prior(double prior, double P, double added) {
  return std::sqrt(std::clamp((prior - P) / std::max(added, 1e-300), 0.0, 1.0));
}

// (10.10): Cov(C_i) += f_i^2 A / (1 - A) (E w w^T)^-1 / 6, what is added to element ij multiplied by g_i g_j so that no gain's
// variance rises above its prior's. P (6n, 6n), prior (6n): of the gains; f2(i): of a channel.
template <typename OfChannel>
void add_pose(Eigen::MatrixXd& P, const double* prior, const PoseShare& share, const OfChannel& f2) {
  double unit[6][6];
  if (!unit_covariance(share, unit)) return;
  for (Eigen::Index i = 0; 6 * i < P.rows(); ++i) {
    const double size = f2(static_cast<int>(i));
    double g[6];
    for (int c = 0; c < 6; ++c)
      g[c] = within_prior(prior[6 * i + c], P(6 * i + c, 6 * i + c), size * unit[c][c]);
    for (int c = 0; c < 6; ++c)
      for (int d = 0; d < 6; ++d) P(6 * i + c, 6 * i + d) += g[c] * g[d] * size * unit[c][d];
  }
}

}  // namespace truewrench
