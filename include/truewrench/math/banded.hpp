// Symmetric positive definite bands of the coefficients of several components, side by side so that vectors span components:
// factor, solve, the band of the inverse.
#pragma once

#include "truewrench/math/dense.hpp"
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
    for (Eigen::Index j = 0; j < size; ++j)
      for (int c = 0; c < lanes; c += 4) {
        double* column = at(j, 0) + c;
        dense::Lane L[kLocal], root = lane(column);
        for (int b = 0; b < 4; ++b) {
          positive = positive && root[b] > 0.0;
          root[b] = 1.0 / std::sqrt(root[b]);
        }
        lane(column) = L[0] = root;
        for (int i = 1; i < kLocal; ++i) lane(column + i * lanes) = L[i] = lane(column + i * lanes) * L[0];
        for (int k = 1; k < kLocal; ++k) {
          double* to = at(j + k, 0) + c;
          for (int i = k; i < kLocal; ++i) lane(to + (i - k) * lanes) -= L[i] * L[k];
        }
      }
    return positive;
  }

  // x (size + 5, lanes), the last five rows 0.
  void solve(std::vector<double>& x) const {
    for (Eigen::Index j = 0; j < size; ++j)
      for (int c = 0; c < lanes; c += 4) {
        const double* column = at(j, 0) + c;
        double* own = x.data() + j * lanes + c;
        const dense::Lane y = lane(own) = lane(own) * lane(column);
        for (int i = 1; i < kLocal; ++i) lane(own + i * lanes) -= lane(column + i * lanes) * y;
      }
    std::fill(x.begin() + size * lanes, x.end(), 0.0);
    for (Eigen::Index j = size - 1; j >= 0; --j)
      for (int c = 0; c < lanes; c += 4) {
        const double* column = at(j, 0) + c;
        double* own = x.data() + j * lanes + c;
        dense::Lane y = lane(own);
        for (int i = 1; i < kLocal; ++i) y -= lane(column + i * lanes) * lane(own + i * lanes);
        lane(own) = y * lane(column);
      }
  }

  // The bands of (L L^T)^-1, in the same form (Takahashi).
  void inverse(Bands& z) const {
    std::fill(z.a.begin(), z.a.end(), 0.0);
    for (Eigen::Index j = size - 1; j >= 0; --j)
      for (int c = 0; c < lanes; c += 4) {
        const double* column = at(j, 0) + c;
        double* out = z.at(j, 0) + c;
        dense::Lane L[kLocal], own[kLocal];
        for (int k = 0; k < kLocal; ++k) L[k] = lane(column + k * lanes);
        for (int i = kDegree5; i >= 0; --i) {
          dense::Lane y = {};
          for (int k = 1; k < kLocal; ++k)
            y -= L[k] * (i == 0 ? own[k] : lane(z.at(j + std::min(i, k), std::abs(i - k)) + c));
          own[i] = (i == 0 ? y + L[0] : y) * L[0];
          lane(out + i * lanes) = own[i];
        }
      }
    std::fill(z.a.begin() + size * kLocal * lanes, z.a.end(), 0.0);
    for (Eigen::Index j = std::max<Eigen::Index>(0, size - kDegree5); j < size; ++j)
      for (int i = static_cast<int>(size - j); i < kLocal; ++i) std::fill_n(z.at(j, i), lanes, 0.0);
  }

  // Adds d^T A d - 2 d^T b, d = x - from; all (size + 5, lanes); component by component.
  void quadratic(const std::vector<double>& x, const std::vector<double>& from, const std::vector<double>& b,
                 double* sum) const {
    for (int c = 0; c < lanes; c += 4) {
      dense::Lane all = {};
      for (Eigen::Index j = 0; j < size; ++j) {
        const double *to = x.data() + j * lanes + c, *begin = from.data() + j * lanes + c;
        const dense::Lane own = lane(to) - lane(begin);
        dense::Lane row = lane(at(j, 0) + c) * own - 2.0 * lane(b.data() + j * lanes + c);
        for (int i = 1; i < kLocal; ++i)
          row += 2.0 * lane(at(j, i) + c) * (lane(to + i * lanes) - lane(begin + i * lanes));
        all += row * own;
      }
      lane(sum + c) += all;
    }
  }

  // Adds <A, B> of symmetric bands, component by component.
  void inner(const Bands& other, double* sum) const {
    for (int c = 0; c < lanes; c += 4) {
      dense::Lane all = {};
      for (Eigen::Index j = 0; j < size; ++j)
        for (int i = 0; i < kLocal; ++i)
          all += (i == 0 ? 1.0 : 2.0) * lane(at(j, i) + c) * lane(other.at(j, i) + c);
      lane(sum + c) += all;
    }
  }

 private:
  static dense::Lane& lane(double* at) { return *reinterpret_cast<dense::Lane*>(at); }
  static const dense::Lane& lane(const double* at) { return *reinterpret_cast<const dense::Lane*>(at); }
};

}  // namespace truewrench
