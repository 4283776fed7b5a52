// Symmetric positive definite bands of the coefficients of several components, side by side so that vectors span components:
// factor, solve, the band of the inverse.
#pragma once

#include "truewrench/math/spline.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace truewrench {

class Bands {
 public:
  // Lower form: of coefficient j the diagonal and five subdiagonals, each of all components.
  std::vector<double> a;
  Eigen::Index size = 0;
  int lanes = 0;  // components, to a multiple of 4

  Bands() = default;
  Bands(Eigen::Index size_, int components) { resize(size_, components); }

  // To zero.
  void resize(Eigen::Index size_, int components) {
    size = size_;
    lanes = (components + 3) & ~3;
    a.assign(static_cast<std::size_t>((size + kDegree5) * kLocal * lanes),
             0.0);  // five more, so that no column is short
  }

  double* at(Eigen::Index j, int i) { return a.data() + (j * kLocal + i) * lanes; }
  const double* at(Eigen::Index j, int i) const { return a.data() + (j * kLocal + i) * lanes; }

  // L L^T in place; false where one is not positive definite. The diagonal holds 1 / L_jj.
  bool factor() {
    bool positive = true;
    for (Eigen::Index j = 0; j < size; ++j) {
      double* column = at(j, 0);
      for (int c = 0; c < lanes; ++c) {
        positive = positive && column[c] > 0.0;
        column[c] = 1.0 / std::sqrt(column[c]);
      }
      for (int i = 1; i < kLocal; ++i)
        for (int c = 0; c < lanes; ++c) column[i * lanes + c] *= column[c];
      for (int k = 1; k < kLocal; ++k) {
        double* to = at(j + k, 0);
        for (int i = k; i < kLocal; ++i)
          for (int c = 0; c < lanes; ++c)
            to[(i - k) * lanes + c] -= column[i * lanes + c] * column[k * lanes + c];
      }
    }
    return positive;
  }

  // x (size + 5, lanes), the last five rows 0.
  void solve(std::vector<double>& x) const {
    for (Eigen::Index j = 0; j < size; ++j) {
      const double* column = at(j, 0);
      double* own = x.data() + j * lanes;
      for (int c = 0; c < lanes; ++c) own[c] *= column[c];
      for (int i = 1; i < kLocal; ++i)
        for (int c = 0; c < lanes; ++c) own[i * lanes + c] -= column[i * lanes + c] * own[c];
    }
    std::fill(x.begin() + size * lanes, x.end(), 0.0);
    for (Eigen::Index j = size - 1; j >= 0; --j) {
      const double* column = at(j, 0);
      double* own = x.data() + j * lanes;
      for (int i = 1; i < kLocal; ++i)
        for (int c = 0; c < lanes; ++c) own[c] -= column[i * lanes + c] * own[i * lanes + c];
      for (int c = 0; c < lanes; ++c) own[c] *= column[c];
    }
  }

  // The bands of (L L^T)^-1, in the same form (Takahashi).
  void inverse(Bands& z) const {
    std::fill(z.a.begin(), z.a.end(), 0.0);
    for (Eigen::Index j = size - 1; j >= 0; --j) {
      const double* column = at(j, 0);
      double* out = z.at(j, 0);
      for (int i = kDegree5; i >= 0; --i) {
        double* to = out + i * lanes;
        for (int k = 1; k < kLocal; ++k) {
          const double* other = i == 0 ? out + k * lanes : z.at(j + std::min(i, k), std::abs(i - k));
          for (int c = 0; c < lanes; ++c) to[c] -= column[k * lanes + c] * other[c];
        }
        for (int c = 0; c < lanes; ++c) to[c] = (to[c] + (i == 0 ? column[c] : 0.0)) * column[c];
      }
    }
    std::fill(z.a.begin() + size * kLocal * lanes, z.a.end(), 0.0);
    for (Eigen::Index j = std::max<Eigen::Index>(0, size - kDegree5); j < size; ++j)
      for (int i = static_cast<int>(size - j); i < kLocal; ++i) std::fill_n(z.at(j, i), lanes, 0.0);
  }

  // Adds d^T A d - 2 d^T b, d = x - from; all (size + 5, lanes); component by component.
  void quadratic(const std::vector<double>& x, const std::vector<double>& from, const std::vector<double>& b,
                 double* sum) const {
    const auto d = [&](Eigen::Index k, int c) {
      const auto i = static_cast<std::size_t>(k * lanes + c);
      return x[i] - from[i];
    };
    for (Eigen::Index j = 0; j < size; ++j)
      for (int c = 0; c < lanes; ++c) {
        double row = at(j, 0)[c] * d(j, c) - 2.0 * b[static_cast<std::size_t>(j * lanes + c)];
        for (int i = 1; i < kLocal; ++i) row += 2.0 * at(j, i)[c] * d(j + i, c);
        sum[c] += row * d(j, c);
      }
  }

  // Adds <A, B> of symmetric bands, component by component.
  void inner(const Bands& other, double* sum) const {
    for (Eigen::Index j = 0; j < size; ++j)
      for (int i = 0; i < kLocal; ++i) {
        const double *x = at(j, i), *y = other.at(j, i), twice = i == 0 ? 1.0 : 2.0;
        for (int c = 0; c < lanes; ++c) sum[c] += twice * x[c] * y[c];
      }
  }
};

}  // namespace truewrench
