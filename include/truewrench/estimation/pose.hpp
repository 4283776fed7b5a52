// How far what follows the pose can hide in the gain (METHOD (10.10)), by sums that run along with the rows.
#pragma once

#include "truewrench/estimation/pose_moments.hpp"
#include "truewrench/spatial.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace truewrench {

// The rotation by a vector [rad].
inline Matrix3 rotation(const Vector3& turn) {
  const double angle = turn.norm(), a = angle > 1e-8 ? std::sin(angle) / angle : 1.0,
               b = angle > 1e-8 ? (1.0 - std::cos(angle)) / (angle * angle) : 0.5;
  const Matrix3 x = cross_matrix(turn);
  return Matrix3::Identity() + a * x + b * (x * x);
}

// The rotation M that maximises tr M^T B (Davenport).
inline Matrix3 nearest_rotation(const Matrix3& B) {
  double K[4][4], vectors[4][4];
  const double trace = B.trace();
  K[0][0] = trace;
  for (int i = 0; i < 3; ++i) {
    K[0][1 + i] = K[1 + i][0] = B((i + 2) % 3, (i + 1) % 3) - B((i + 1) % 3, (i + 2) % 3);
    for (int j = 0; j < 3; ++j) K[1 + i][1 + j] = B(i, j) + B(j, i) - (i == j ? trace : 0.0);
  }
  diagonalise(K, vectors);
  int best = 0;
  for (int i = 1; i < 4; ++i)
    if (K[i][i] > K[best][best]) best = i;
  const Vector3 q(vectors[1][best], vectors[2][best], vectors[3][best]);
  const Matrix3 x = cross_matrix(q);
  return Matrix3::Identity() + 2.0 * vectors[0][best] * x + 2.0 * (x * x);
}

// w against the pose, means by stretch: place and vector part of the turn, in the axes of the mean attitude; and the integral of
// the twist, component by component, unless the body turns by more than `kTurns` about an axis, or is an arm's. A cable may
// follow either: by the second a free body's oscillations hide more, by the first an arm's motions in gravity.
class PoseSums {
 public:
  // A sample, or a row that stands for `size` of them: twist nu (6), normalised wrench w (6).
  void add(double time, double size, bool masked, const double* nu, const double* w) {
    const double dt = started_ ? time - time_ : 0.0;
    if (dt > 0.0) move(dt, nu);
    if (!masked && dt > 0.0) {
      for (int i = 0; i < 6; ++i) all_.rate[i] += (w[i] - before_[i]) * (w[i] - before_[i]) / dt;
      rated_ += dt;
    }
    std::copy_n(nu, 6, nu_);
    std::copy_n(w, 6, before_);
    time_ = time;
    started_ = true;
    if (masked) return;
    double z[kValues];
    std::copy_n(w, 6, z);
    std::copy_n(integral_, 6, z + kIntegral);
    std::copy_n(place_.data(), 3, z + kPlace);
    std::copy_n(R_.data(), 9, z + kAttitude);
    samples_ += size;
    for (int i = 0; i < kValues; ++i) {
      const double x = size * z[i];
      sum_[i] += x;
      for (int j = 0; j <= i; ++j) product_[i][j] += x * z[j];
    }
  }

  // What a stretch ends with goes into the whole; arm: it is one's.
  void end_stretch(bool arm) {
    fold(all_, arm);
    PoseSums next;
    next.all_ = all_;
    next.rated_ = rated_;
    *this = std::move(next);
  }

  PoseShare share(bool arm = false) const {
    PoseMoments all = all_;
    fold(all, arm);
    // (dw / dt)^2 by time, as what waits is counted by samples
    for (double& x : all.rate) x *= rated_ > 0.0 ? all.samples / rated_ : 0.0;
    return all.share();
  }

 private:
  static constexpr double kTurns = 1.0;  // [rad] beyond which the components of the twist are no pose
  static constexpr int kIntegral = 6, kPlace = 12, kAttitude = 15, kValues = 24;  // z = [w, ...]

  PoseMoments all_;  // of the stretches before
  bool started_ = false;
  double time_ = 0.0, rated_ = 0.0, samples_ = 0.0;
  double nu_[6] = {}, before_[6] = {}, integral_[6] = {}, least_[3] = {}, most_[3] = {};
  Vector3 place_ = Vector3::Zero();                            // in the axes that the stretch began with
  Matrix3 R_ = Matrix3::Identity();                            // to them
  double sum_[kValues] = {}, product_[kValues][kValues] = {};  // lower triangle

  void move(double dt, const double* nu) {
    Vector3 turn, v0, v1;
    for (int i = 0; i < 6; ++i) integral_[i] += 0.5 * dt * (nu[i] + nu_[i]);
    for (int i = 0; i < 3; ++i) {
      turn[i] = 0.5 * dt * (nu[3 + i] + nu_[3 + i]);
      v0[i] = nu_[i];
      v1[i] = nu[i];
      least_[i] = std::min(least_[i], integral_[3 + i]);
      most_[i] = std::max(most_[i], integral_[3 + i]);
    }
    const Vector3 before = R_ * v0;
    R_ = Matrix3(R_ * rotation(turn));
    place_ += 0.5 * dt * (before + R_ * v1);
  }

  double centred(int i, int j) const {
    return product_[std::max(i, j)][std::min(i, j)] - sum_[i] * sum_[j] / samples_;
  }

  // Component c of the place, or of the turn, as sums of values of z: which, and how much of each.
  int placed(int c, const Matrix3& M, int (&which)[6], double (&times)[6]) const {
    if (c < 3) {  // M^T place
      for (int i = 0; i < 3; ++i) {
        which[i] = kPlace + i;
        times[i] = M(i, c);
      }
      return 3;
    }
    const int x = (c + 1) % 3, y = (c + 2) % 3;  // 1/2 ((M^T R)_yx - (M^T R)_xy)
    for (int i = 0; i < 3; ++i) {
      which[i] = kAttitude + static_cast<int>(&R_(i, x) - R_.data());
      times[i] = 0.5 * M(i, y);
      which[3 + i] = kAttitude + static_cast<int>(&R_(i, y) - R_.data());
      times[3 + i] = -0.5 * M(i, x);
    }
    return 6;
  }

  void fold(PoseMoments& all, bool arm) const {
    if (samples_ == 0.0) return;
    bool turns = arm;
    for (int i = 0; i < 3; ++i) turns = turns || most_[i] - least_[i] >= kTurns;
    Matrix3 sum;
    std::copy_n(sum_ + kAttitude, 9, sum.data());
    const Matrix3 mean = nearest_rotation(sum);
    all.samples += samples_;
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j) {
        all.ww[i][j] += product_[std::max(i, j)][std::min(i, j)];
        all.centred[i][j] += centred(i, j);
      }
    for (int pose = 0; pose < PoseMoments::kPoses; ++pose)
      for (int c = 0; c < 6; ++c) {
        int which[6] = {kIntegral + c};
        double times[6] = {1.0}, square = 0.0;
        const int parts = pose == 0 || turns ? placed(c, mean, which, times) : 1;
        for (int a = 0; a < parts; ++a) {
          for (int b = 0; b < parts; ++b) square += times[a] * times[b] * centred(which[a], which[b]);
          for (int i = 0; i < 6; ++i) all.wp[pose][i][c] += times[a] * centred(i, which[a]);
        }
        all.pp[pose][c] += std::max(square, 0.0);
      }
  }
};

}  // namespace truewrench
