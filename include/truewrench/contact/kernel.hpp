// The matched pair of kernels of the contact wrench: a slope of the twist, and its integral for all else.
//
// A slope of the twist, sum a_i nu(t_i) with sum a_i = 0 and sum a_i t_i = 1, is the mean of its derivative under the
// step function K, K(t) = sum of a_i over t_i > t, whose integral is 1. Everything else, raw channels and what of the
// tool's wrench needs no derivative, is averaged with the same K: the filter then is exact for any motion.
#pragma once

#include <algorithm>
#include <cmath>

namespace truewrench::contact {

// Slope weights a (n) at increasing stamps t (n) [s]: of the least-squares line, the derivative at their middle.
inline void line_slope(const double* t, int n, double* a) {
  double mean = 0.0, square = 0.0;
  for (int i = 0; i < n; ++i) mean += t[i] / n;
  for (int i = 0; i < n; ++i) square += (t[i] - mean) * (t[i] - mean);
  for (int i = 0; i < n; ++i) a[i] = (t[i] - mean) / square;
}

// Weights a (n) at stamps t (n), n >= 3, that the least-squares parabola has for a derivative at the newest stamp:
// the first (Savitzky and Golay), or the second.
inline void parabola(const double* t, int n, int derivative, double* a) {
  const double scale = t[n - 1] - t[0];
  double s[5] = {0.0, 0.0, 0.0, 0.0, 0.0};  // sums of powers of x = (t - t_newest) / scale
  for (int i = 0; i < n; ++i) {
    const double x = (t[i] - t[n - 1]) / scale;
    double power = 1.0;
    for (double& sum : s) {
      sum += power;
      power *= x;
    }
  }
  // rows of the adjugate of the normal matrix [s0 s1 s2; s1 s2 s3; s2 s3 s4]
  const double c1[3] = {s[2] * s[3] - s[1] * s[4], s[0] * s[4] - s[2] * s[2], s[1] * s[2] - s[0] * s[3]};
  const double c2[3] = {s[1] * s[3] - s[2] * s[2], c1[2], s[0] * s[2] - s[1] * s[1]};
  const double determinant = s[1] * c1[0] + s[2] * c1[1] + s[3] * c1[2];
  const double* c = derivative == 1 ? c1 : c2;
  const double factor = derivative == 1 ? 1.0 / (determinant * scale) : 2.0 / (determinant * scale * scale);
  for (int i = 0; i < n; ++i) {
    const double x = (t[i] - t[n - 1]) / scale;
    a[i] = factor * (c[0] + c[1] * x + c[2] * x * x);
  }
}

// Weights (m) on samples at increasing stamps s (m): the integral of K times what is linear between the samples.
// K is that of slope weights a (n) at `edges` (n). Gives the share of the integral that the samples cover.
inline double mean_weights(const double* edges, const double* a, int n, const double* s, int m,
                           double* weight) {
  std::fill(weight, weight + m, 0.0);
  double covered = 0.0, k = 0.0;
  int i = 0;
  for (int j = 0; j + 1 < n; ++j) {
    k -= a[j];  // the sum of what follows, since all sum to zero
    double from = edges[j];
    while (i + 2 < m && s[i + 1] <= from) ++i;
    for (int at = i; at + 1 < m && s[at] < edges[j + 1]; ++at) {
      const double low = std::max(from, s[at]), high = std::min(edges[j + 1], s[at + 1]);
      if (high <= low) continue;
      const double share = k * (high - low);
      const double along = (0.5 * (low + high) - s[at]) / (s[at + 1] - s[at]);
      weight[at] += share * (1.0 - along);
      weight[at + 1] += share * along;
      covered += share;
      from = high;
    }
  }
  return covered;
}

// Weights (m) on samples at stamps s (m) of the slope a (n) at `edges` (n) of what is linear between the samples; false
// where an edge lies outside.
inline bool slope_weights(const double* edges, const double* a, int n, const double* s, int m,
                          double* weight) {
  std::fill(weight, weight + m, 0.0);
  int i = 0;
  for (int j = 0; j < n; ++j) {
    while (i + 2 < m && s[i + 1] <= edges[j]) ++i;
    if (edges[j] < s[i] || edges[j] > s[i + 1]) return false;
    const double along = (edges[j] - s[i]) / (s[i + 1] - s[i]);
    weight[i] += a[j] * (1.0 - along);
    weight[i + 1] += a[j] * along;
  }
  return true;
}

}  // namespace truewrench::contact
