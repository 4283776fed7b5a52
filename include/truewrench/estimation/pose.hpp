// How far what follows the pose can hide in the gain of a fit (METHOD (10.10)).
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/estimation/pose_moments.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace truewrench {

inline Matrix3 rotation(const Vector3& turn) {
  const double angle = turn.norm(), a = angle > 1e-8 ? std::sin(angle) / angle : 1.0,
               b = angle > 1e-8 ? (1.0 - std::cos(angle)) / (angle * angle) : 0.5;
  const Matrix3 x = cross_matrix(turn);
  return Matrix3::Identity() + a * x + b * (x * x);
}

// The rotation vector of a turn by at most pi.
inline Vector3 rotation_vector(const Matrix3& R) {
  const Vector3 v(0.5 * (R(2, 1) - R(1, 2)), 0.5 * (R(0, 2) - R(2, 0)), 0.5 * (R(1, 0) - R(0, 1)));
  const double sine = v.norm(), cosine = 0.5 * (R.trace() - 1.0), angle = std::atan2(sine, cosine);
  if (cosine > -0.99) return sine > 1e-12 ? Vector3(angle / sine * v) : v;
  int most = 0;  // near pi the axis is in the symmetric part
  for (int c = 1; c < 3; ++c)
    if (R(c, c) > R(most, most)) most = c;
  Vector3 axis;
  axis[most] = std::sqrt((R(most, most) - cosine) / (1.0 - cosine));
  for (int c = 0; c < 3; ++c)
    if (c != most) axis[c] = 0.5 * (R(c, most) + R(most, c)) / ((1.0 - cosine) * axis[most]);
  return (axis.dot(v) < 0.0 ? -angle : angle) * axis;
}

// The rotation M that maximises tr M^T B (Davenport).
inline Matrix3 nearest_rotation(const Matrix3& B) {
  Eigen::MatrixXd K(4, 4);
  const double trace = B.trace();
  K(0, 0) = trace;
  for (int i = 0; i < 3; ++i) {
    K(0, 1 + i) = K(1 + i, 0) = B((i + 2) % 3, (i + 1) % 3) - B((i + 1) % 3, (i + 2) % 3);
    for (int j = 0; j < 3; ++j) K(1 + i, 1 + j) = B(i, j) + B(j, i) - (i == j ? trace : 0.0);
  }
  const dense::Spectrum spectrum = dense::eigen(K);
  Eigen::Index best = 0;
  for (Eigen::Index i = 1; i < 4; ++i)
    if (spectrum.values[i] > spectrum.values[best]) best = i;
  const Vector3 q(spectrum.vectors(1, best), spectrum.vectors(2, best), spectrum.vectors(3, best));
  const Matrix3 x = cross_matrix(q);
  return Matrix3::Identity() + 2.0 * spectrum.vectors(0, best) * x + 2.0 * (x * x);
}

// The pose (K, 6) of one stretch: the integral of the twist, component by component; where the body turns by more than 1 rad,
// and for joints, its position in the axes of the mean attitude and the rotation vector from it.
inline RowMatrix pose_of(const Stretch& s) {
  const Eigen::Index n = s.raw.rows();
  RowMatrix pose = RowMatrix::Zero(n, 6);
  double turned = 0.0;
  for (int c = 0; c < 6; ++c) {
    double least = 0.0, most = 0.0;
    for (Eigen::Index k = 1; k < n; ++k) {
      pose(k, c) =
          pose(k - 1, c) + 0.5 * (s.raw.time[k] - s.raw.time[k - 1]) * (s.now.nu(k, c) + s.now.nu(k - 1, c));
      least = std::min(least, pose(k, c));
      most = std::max(most, pose(k, c));
    }
    if (c >= 3) turned = std::max(turned, most - least);
  }
  if (n == 0 || (s.log().source != Source::mapped && turned < 1.0)) return pose;
  std::vector<Matrix3> R(static_cast<std::size_t>(n), Matrix3::Identity());
  Matrix3 sum = Matrix3::Zero();
  for (Eigen::Index k = 0; k < n; ++k) {
    const auto i = static_cast<std::size_t>(k);
    if (k > 0) {
      const double dt = s.raw.time[k] - s.raw.time[k - 1];
      Vector3 turn, v0, v1;
      for (int c = 0; c < 3; ++c) {
        turn[c] = 0.5 * dt * (s.now.nu(k, 3 + c) + s.now.nu(k - 1, 3 + c));
        v0[c] = s.now.nu(k - 1, c);
        v1[c] = s.now.nu(k, c);
      }
      R[i] = R[i - 1] * rotation(turn);
      const Vector3 v = R[i - 1] * v0 + R[i] * v1;
      for (int c = 0; c < 3; ++c) pose(k, c) = pose(k - 1, c) + 0.5 * dt * v[c];
    }
    sum += R[i];
  }
  const Matrix3 mean = nearest_rotation(sum);
  for (Eigen::Index k = 0; k < n; ++k) {
    const Vector3 turn = rotation_vector(mean.transpose() * R[static_cast<std::size_t>(k)]);
    const Vector3 at = mean.transpose() * Vector3(pose(k, 0), pose(k, 1), pose(k, 2));
    for (int c = 0; c < 3; ++c) {
      pose(k, c) = at[c];
      pose(k, 3 + c) = turn[c];
    }
  }
  return pose;
}

inline PoseShare pose_share(const Fit& fit) {
  PoseMoments sums;
  for (const LogFit& log : fit.logs())
    for (const Stretch& s : log.stretches) {
      const RowMatrix pose = pose_of(s);
      double w_mean[6] = {}, p_mean[6] = {}, rows = 0.0;
      for (const bool sum : {true, false}) {  // means, then products
        if (!sum && rows == 0.0) break;
        for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
          if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
          const double samples = s.raw.size[k];
          if (sum) {
            for (int i = 0; i < 6; ++i) {
              w_mean[i] += samples * s.now.w(k, i);
              p_mean[i] += samples * pose(k, i);
            }
            rows += samples;
            continue;
          }
          const double dt = k > 0 ? std::max(s.raw.time[k] - s.raw.time[k - 1], 1e-12) : 1.0;
          for (int i = 0; i < 6; ++i) {
            const double w = s.now.w(k, i), d = w - w_mean[i] / rows;
            for (int j = 0; j < 6; ++j) {
              sums.ww[i][j] += samples * w * s.now.w(k, j);
              sums.centred[i][j] += samples * d * (s.now.w(k, j) - w_mean[j] / rows);
              sums.wp[i][j] += samples * d * (pose(k, j) - p_mean[j] / rows);
            }
            const double p = pose(k, i) - p_mean[i] / rows,
                         change = k > 0 ? (w - s.now.w(k - 1, i)) / dt : 0.0;
            sums.pp[i] += samples * p * p;
            sums.rate[i] += samples * change * change;
          }
        }
      }
      sums.samples += rows;
    }
  return sums.share();
}

}  // namespace truewrench
