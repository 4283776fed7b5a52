// A symmetric positive definite band of a component's coefficients: factor, solve, the band of its inverse.
#pragma once

#include "truewrench/math/spline.hpp"

namespace truewrench {

// Lower form: row i of `a` holds the i-th subdiagonal.
class Banded {
 public:
  Eigen::MatrixXd a;

  explicit Banded(Eigen::Index size = 0) : a(Eigen::MatrixXd::Zero(kLocal, size)) {}

  void add(Eigen::Index at, const Gram& local) {
    for (int k = 0; k < kLocal; ++k)
      for (int l = 0; l <= k; ++l) a(k - l, at + l) += local(k, l);
  }

  // L L^T in place; false where it is not positive definite.
  bool factor() {
    const double twice = banded_logdet(a);
    if (!std::isfinite(twice)) return false;
    logdet_ = twice;
    // banded_logdet leaves the squares of the pivots on the diagonal
    a.row(0) = a.row(0).cwiseSqrt();
    return true;
  }
  double logdet() const { return logdet_; }

  void solve(Eigen::Ref<Eigen::VectorXd> x) const {
    const Eigen::Index n = a.cols();
    for (Eigen::Index j = 0; j < n; ++j) {
      x[j] /= a(0, j);
      for (Eigen::Index i = 1; i < kLocal && j + i < n; ++i) x[j + i] -= a(i, j) * x[j];
    }
    for (Eigen::Index j = n - 1; j >= 0; --j) {
      for (Eigen::Index i = 1; i < kLocal && j + i < n; ++i) x[j] -= a(i, j) * x[j + i];
      x[j] /= a(0, j);
    }
  }

  // The band of (L L^T)^-1, in the same form (Takahashi).
  Eigen::MatrixXd inverse() const {
    const Eigen::Index n = a.cols();
    Eigen::MatrixXd z = Eigen::MatrixXd::Zero(kLocal, n);
    const auto at = [&z](Eigen::Index i, Eigen::Index j) -> double& { return i >= j ? z(i - j, j) : z(j - i, i); };
    for (Eigen::Index j = n - 1; j >= 0; --j) {
      const Eigen::Index last = std::min<Eigen::Index>(n - 1, j + kLocal - 1);
      for (Eigen::Index i = last; i >= j; --i) {
        double sum = i == j ? 1.0 / a(0, j) : 0.0;
        for (Eigen::Index k = j + 1; k <= last; ++k) sum -= a(k - j, j) * at(i, k);
        z(i - j, j) = sum / a(0, j);
      }
    }
    return z;
  }

 private:
  double logdet_ = 0.0;
};

// <A, B> of two symmetric bands in lower form.
inline double banded_inner(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return a.row(0).dot(b.row(0)) + 2.0 * a.bottomRows(a.rows() - 1).cwiseProduct(b.bottomRows(a.rows() - 1)).sum();
}

}  // namespace truewrench
