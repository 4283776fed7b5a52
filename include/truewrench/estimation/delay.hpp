// Which delays the gain can imitate. Where w' = A w + a over a record (force and moment in quadrature at one frequency an axis:
// the paper's own motion), C w(t + s) = C exp(s A) w + ..., and no residual tells s from C. What then seems to tell them apart is
// the noise of the estimated motion, and one dw/dx an interval: together they gave s to 0.5 us, 0.6 ms beside the truth.
#pragma once

#include "truewrench/estimation/constants.hpp"

#include <algorithm>
#include <cmath>

namespace truewrench {

// Prior variance of s ~ N(s_0, stated + v), v = max(0, (s_hat - s_0)^2 - V - stated), from its posterior at the prior that stands:
// so far apart from s_0, with this variance. The data's own are s_hat and V. Where the gain imitates it v is 0.       (10.1)
inline double clock_variance(double stated, double prior, double variance, double apart, bool imitated) {
  const double V = 1.0 / std::max(1.0 / variance - 1.0 / prior, 1e-12), own = apart * V / variance;
  return stated + (imitated ? 0.0 : std::max(0.0, own * own - V - stated));
}

// A variance of what is held, so that none of the gains that follow it by `by` (count) is less certain than beforehand: in a record
// too short to turn the wrench they would imitate it without bound (0.1 of prior, 2.1 of sigma).                       (10.1)
inline double bounded(double variance, const double* by, const double* prior, int count) {
  double out = variance;
  for (int j = 0; j < count; ++j)
    if (out * by[j] * by[j] > prior[j]) out = prior[j] / (by[j] * by[j]);
  return out;
}

// The derivative at the middle of three samples, of the parabola through them: times between them, and changes.
inline double middle_rate(double before, double after, double from, double to) {
  return (to * before / after + from * after / before) / (before + after);
}

// Sums of w' on [w, 1] over samples as they come, w' by differences of the neighbours; fixed size, no heap.
class DelaySums {
 public:
  static constexpr int features = 7;  // [w, 1]

  void clear() { *this = DelaySums(); }
  void cut() { known_ = 0; }  // the next sample does not follow the last

  void add(double time, const double* w) {
    if (known_ == 2) {
      const double before = time_[1] - time_[0], after = time - time_[1];
      double f[features], d[6];
      for (int j = 0; j < 6; ++j) {
        f[j] = w_[1][j];
        d[j] = middle_rate(before, after, f[j] - w_[0][j], w[j] - f[j]);
      }
      f[6] = 1.0;
      for (int i = 0; i < features; ++i) {
        for (int j = 0; j < features; ++j) ff_[i][j] += f[i] * f[j];
        for (int j = 0; j < 6; ++j) fd_[i][j] += f[i] * d[j];
      }
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 6; ++j) dd_[i][j] += d[i] * d[j];
    }
    if (known_ == 2) {
      time_[0] = time_[1];
      std::copy_n(w_[1], 6, w_[0]);
    }
    const int last = std::min(known_, 1);
    time_[last] = time;
    std::copy_n(w, 6, w_[last]);
    known_ = std::min(known_ + 1, 2);
  }

  // [A^T; a^T] of w' = A w + a; false where the samples are too few.
  bool rates(double (&A)[features][6]) const {
    double M[features][features + 6], mean = 0.0;
    if (ff_[6][6] < 2.0 * features) return false;
    for (int i = 0; i < 6; ++i) mean += ff_[i][i] / 6.0;
    for (int i = 0; i < features; ++i) {
      std::copy_n(ff_[i], features, M[i]);
      std::copy_n(fd_[i], 6, M[i] + features);
      if (i < 6) M[i][i] += 1e-12 * (ff_[i][i] + mean);  // an axis that nothing loads
    }
    for (int p = 0; p < features; ++p) {  // positive definite: no pivots
      if (!(M[p][p] > 0.0)) return false;
      for (int i = 0; i < features; ++i) {
        if (i == p) continue;
        const double x = M[i][p] / M[p][p];
        for (int j = p; j < features + 6; ++j) M[i][j] -= x * M[p][j];
      }
    }
    for (int i = 0; i < features; ++i)
      for (int j = 0; j < 6; ++j) A[i][j] = M[i][features + j] / M[i][i];
    return true;
  }

  // Whether the gain C (n, 6), row by row, imitates a delay: the share of C w' that A and a leave, in noise of the channels.
  template <typename Sigma>
  bool imitated(const double* C, int n, const Sigma& sigma) const {
    double A[features][6], unexplained[6][6], centred[6][6];
    if (!rates(A)) return false;
    for (int j = 0; j < 6; ++j)
      for (int k = 0; k < 6; ++k) {
        unexplained[j][k] = dd_[j][k];
        for (int f = 0; f < features; ++f) unexplained[j][k] -= A[f][j] * fd_[f][k];
        centred[j][k] = dd_[j][k] - fd_[6][j] * fd_[6][k] / ff_[6][6];
      }
    double left = 0.0, all = 0.0;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < 6; ++j)
        for (int k = 0; k < 6; ++k) {
          const double both = C[6 * i + j] * C[6 * i + k] / (sigma(i) * sigma(i));
          left += both * unexplained[j][k];
          all += both * centred[j][k];
        }
    return left < constants::delay_left * all;
  }

  // What a delay of 1 s adds to the gain row (6) and offset of a channel that imitate it: C A and C a; and C A A, C A a.
  void imitate(const double* C_row, double (&gain)[2][6], double (&offset)[2]) const {
    double A[features][6];
    std::fill_n(&gain[0][0], 12, 0.0);
    offset[0] = offset[1] = 0.0;
    if (!rates(A)) return;
    for (int order = 0; order < 2; ++order) {
      const double* from = order == 0 ? C_row : gain[0];
      for (int j = 0; j < 6; ++j) {
        for (int k = 0; k < 6; ++k) gain[order][k] += from[j] * A[k][j];
        offset[order] += from[j] * A[6][j];
      }
    }
  }

 private:
  double ff_[features][features] = {}, fd_[features][6] = {}, dd_[6][6] = {};
  double time_[2] = {}, w_[2][6] = {};
  int known_ = 0;
};

}  // namespace truewrench
