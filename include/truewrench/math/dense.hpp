// Dense linear algebra on rows of doubles: products in tiles of 6 x 8 registers, Cholesky, triangular solves, eigenvalues.
//
// Plain functions on pointers, row by row with a stride that is a multiple of 8: expressions of dynamic matrices took four
// fifths of the compile time, and a third of the speed of these tiles.
#pragma once

#include <Eigen/Core>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace truewrench::dense {

using Lane = double __attribute__((vector_size(32), aligned(8), may_alias));

using Half = double __attribute__((vector_size(16), aligned(8), may_alias));

// y += x v. Of six values when `fixed` is 6: as vectors, whatever a compiler fears of aliases.
template <int fixed = 0>
inline void add(double* __restrict y, double x, const double* __restrict v, int n = fixed) {
  if constexpr (fixed == 6) {
    *reinterpret_cast<Lane*>(y) += x * *reinterpret_cast<const Lane*>(v);
    *reinterpret_cast<Half*>(y + 4) += x * *reinterpret_cast<const Half*>(v + 4);
  } else {
    for (int i = 0; i < n; ++i) y[i] += x * v[i];
  }
}

// y += x v of n values, mostly six.
inline void add_some(double* __restrict y, double x, const double* __restrict v, int n) {
  if (n == 6)
    add<6>(y, x, v);
  else
    add(y, x, v, n);
}

// y += u v, element by element.
inline void add(double* __restrict y, const double* __restrict u, const double* __restrict v, int n) {
  for (int i = 0; i < n; ++i) y[i] += u[i] * v[i];
}

// What a product is taken from: what stands, 0, or what stands and then a triangular solve.
enum class Mode { add, fresh, forward, backward };

inline constexpr int tile_rows = 6;

inline int padded(int columns) { return (columns + 7) & ~7; }

// Rows of C (R, n) -= A B with A(i, l) = a[i rs + l cs], then R^T X = C or R X = C with the upper triangle r, in registers.
template <int R>
[[gnu::noinline]] void tile(double* C, std::ptrdiff_t ldc, const double* A, std::ptrdiff_t rs,
                            std::ptrdiff_t cs, const double* B, std::ptrdiff_t ldb, int n, int k,
                            const double* r, std::ptrdiff_t ldr, Mode mode) {
  double inverse[R] = {};
  if (mode == Mode::forward || mode == Mode::backward)
    for (int i = 0; i < R; ++i) inverse[i] = 1.0 / r[i * ldr + i];
  for (int c = 0; c < n; c += 8) {
    Lane x[R][2];
    for (int i = 0; i < R; ++i) {
      x[i][0] = mode == Mode::fresh ? Lane{} : *reinterpret_cast<const Lane*>(C + i * ldc + c);
      x[i][1] = mode == Mode::fresh ? Lane{} : *reinterpret_cast<const Lane*>(C + i * ldc + c + 4);
    }
    const double *a = A, *b = B + c;
    for (int l = 0; l < k; ++l, a += cs, b += ldb) {
      const Lane b0 = *reinterpret_cast<const Lane*>(b), b1 = *reinterpret_cast<const Lane*>(b + 4);
      for (int i = 0; i < R; ++i) {
        x[i][0] -= a[i * rs] * b0;
        x[i][1] -= a[i * rs] * b1;
      }
    }
    if (mode == Mode::forward)
      for (int i = 0; i < R; ++i) {
        x[i][0] *= inverse[i];
        x[i][1] *= inverse[i];
        for (int j = i + 1; j < R; ++j) {
          x[j][0] -= r[i * ldr + j] * x[i][0];
          x[j][1] -= r[i * ldr + j] * x[i][1];
        }
      }
    else if (mode == Mode::backward)
      for (int i = R - 1; i >= 0; --i) {
        x[i][0] *= inverse[i];
        x[i][1] *= inverse[i];
        for (int j = 0; j < i; ++j) {
          x[j][0] -= r[j * ldr + i] * x[i][0];
          x[j][1] -= r[j * ldr + i] * x[i][1];
        }
      }
    for (int i = 0; i < R; ++i) {
      *reinterpret_cast<Lane*>(C + i * ldc + c) = x[i][0];
      *reinterpret_cast<Lane*>(C + i * ldc + c + 4) = x[i][1];
    }
  }
}

inline void tile_of(int rows, double* C, std::ptrdiff_t ldc, const double* A, std::ptrdiff_t rs,
                    std::ptrdiff_t cs, const double* B, std::ptrdiff_t ldb, int n, int k,
                    const double* r = nullptr, std::ptrdiff_t ldr = 0, Mode mode = Mode::add) {
  switch (rows) {
    case 6:
      return tile<6>(C, ldc, A, rs, cs, B, ldb, n, k, r, ldr, mode);
    case 5:
      return tile<5>(C, ldc, A, rs, cs, B, ldb, n, k, r, ldr, mode);
    case 4:
      return tile<4>(C, ldc, A, rs, cs, B, ldb, n, k, r, ldr, mode);
    case 3:
      return tile<3>(C, ldc, A, rs, cs, B, ldb, n, k, r, ldr, mode);
    case 2:
      return tile<2>(C, ldc, A, rs, cs, B, ldb, n, k, r, ldr, mode);
    default:
      return tile<1>(C, ldc, A, rs, cs, B, ldb, n, k, r, ldr, mode);
  }
}

// C (m, n) -= A B, or - A B (fresh), with A(i, l) = a[i rs + l cs] (m, k), B (k, n); n a multiple of 8.
inline void subtract(double* C, std::ptrdiff_t ldc, const double* A, std::ptrdiff_t rs, std::ptrdiff_t cs,
                     const double* B, std::ptrdiff_t ldb, int m, int n, int k, Mode mode = Mode::add) {
  for (int t = 0; t < m; t += tile_rows)
    tile_of(std::min(tile_rows, m - t), C + t * ldc, ldc, A + t * rs, rs, cs, B, ldb, n, k, nullptr, 0, mode);
}

// R^T R of the symmetric matrix whose upper triangle leads the rows of `a`, in place, and R^-T times the columns after it, to
// `ld`. Adds log det; false where it is not positive definite. Below the diagonal nothing is left that means anything.
inline bool factor(double* a, std::ptrdiff_t ld, int rows, double& logdet) {
  for (int t = 0; t < rows; t += tile_rows) {
    const int m = std::min(tile_rows, rows - t), c = t & ~7;
    double d[tile_rows * 8] = {}, pivots = 1.0;
    for (int i = 0; i < m; ++i)
      for (int j = i; j < m; ++j) d[8 * i + j] = a[(t + i) * ld + t + j];
    tile_of(m, d, 8, a + t, 1, ld, a + t, ld, 8, t);
    for (int i = 0; i < m; ++i) {
      if (!(d[9 * i] > 0.0)) return false;
      const double root = std::sqrt(d[9 * i]);
      pivots *= root;
      if (i % 3 == 2 || i + 1 == m) {
        logdet += 2.0 * std::log(pivots);
        pivots = 1.0;
      }
      d[9 * i] = root;
      for (int j = i + 1; j < m; ++j) d[8 * i + j] /= root;
      for (int l = i + 1; l < m; ++l)
        for (int j = l; j < m; ++j) d[8 * l + j] -= d[8 * i + l] * d[8 * i + j];
    }
    tile_of(m, a + t * ld + c, ld, a + t, 1, ld, a + c, ld, static_cast<int>(ld) - c, t, d, 8, Mode::forward);
  }
  return true;
}

// X <- R^-1 X of the upper triangle that leads the rows of r; X (rows, n).
inline void solve_upper(const double* r, std::ptrdiff_t ldr, int rows, double* X, std::ptrdiff_t ldx, int n) {
  for (int t = (rows - 1) / tile_rows * tile_rows; t >= 0; t -= tile_rows) {
    const int m = std::min(tile_rows, rows - t), after = t + m;
    tile_of(m, X + t * ldx, ldx, r + t * ldr + after, ldr, 1, X + after * ldx, ldx, n, rows - after,
            r + t * ldr + t, ldr, Mode::backward);
  }
}

// X <- R^-T X.
inline void solve_transposed(const double* r, std::ptrdiff_t ldr, int rows, double* X, std::ptrdiff_t ldx,
                             int n) {
  for (int t = 0; t < rows; t += tile_rows)
    tile_of(std::min(tile_rows, rows - t), X + t * ldx, ldx, r + t, 1, ldr, X, ldx, n, t, r + t * ldr + t,
            ldr, Mode::forward);
}

inline double dot(const double* a, const double* b, int n) {
  Lane x = {}, y = {};
  int i = 0;
  for (; i + 8 <= n; i += 8) {
    x += *reinterpret_cast<const Lane*>(a + i) * *reinterpret_cast<const Lane*>(b + i);
    y += *reinterpret_cast<const Lane*>(a + i + 4) * *reinterpret_cast<const Lane*>(b + i + 4);
  }
  x += y;
  double sum = (x[0] + x[1]) + (x[2] + x[3]);
  for (; i < n; ++i) sum += a[i] * b[i];
  return sum;
}

// Whether P can be a covariance: symmetric, and below zero in no direction, but for rounding, 1e-6 of the correlations.
inline bool is_covariance(const Eigen::MatrixXd& P) {
  const int n = static_cast<int>(P.rows()), ld = padded(n);
  std::vector<double> work(static_cast<std::size_t>(n * ld + 8), 0.0);
  constexpr double rounding = 1e-6;
  for (int i = 0; i < n; ++i) {
    if (!(P(i, i) >= 0.0)) return false;
    for (int j = i; j < n; ++j) {
      const double scale = std::sqrt(P(i, i)) * std::sqrt(P(j, j)), of = 0.5 * (P(i, j) + P(j, i));
      if (!(std::abs(P(i, j) - P(j, i)) <= rounding * scale) || (scale == 0.0 && of != 0.0)) return false;
      work[static_cast<std::size_t>(i * ld + j)] = i == j ? 1.0 + rounding : scale > 0.0 ? of / scale : 0.0;
    }
  }
  double logdet = 0.0;
  return factor(work.data(), ld, n, logdet);
}

// The inverse of a symmetric positive definite matrix, and its log det; false where it is not.
inline bool invert(const Eigen::MatrixXd& S, Eigen::MatrixXd& inverse, double& logdet) {
  const int n = static_cast<int>(S.rows()), half = padded(n), ld = 2 * half;
  std::vector<double> work(static_cast<std::size_t>(n * ld + 8), 0.0),
      out(static_cast<std::size_t>(n * half + 8), 0.0);
  for (int i = 0; i < n; ++i) {
    std::copy_n(S.col(i).data(), n, work.data() + i * ld);
    work[static_cast<std::size_t>(i * ld + half + i)] = -1.0;
  }
  logdet = 0.0;
  if (!factor(work.data(), ld, n, logdet)) return false;
  // R^-1 R^-T from the rows of -R^-T: of row k the columns to k
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j)
      work[static_cast<std::size_t>(i * ld + j)] = -work[static_cast<std::size_t>(i * ld + half + j)];
  for (int t = 0; t < n; t += tile_rows) {
    const int m = std::min(tile_rows, n - t), c = t & ~7;
    tile_of(m, out.data() + t * half + c, half, work.data() + t * ld + t, 1, ld,
            work.data() + t * ld + half + c, ld, half - c, n - t);
  }
  inverse.resize(n, n);
  for (int i = 0; i < n; ++i)
    for (int j = i; j < n; ++j) inverse(i, j) = inverse(j, i) = out[static_cast<std::size_t>(i * half + j)];
  return true;
}

// x of A x = b in place of b, A (n, n) symmetric, its lower triangle read, by L D L^T in its place; false where it is not
// positive definite.
inline bool solve(double* A, double* b, int n) {
  for (int j = 0; j < n; ++j) {
    const double pivot = A[j * n + j];
    if (!(pivot > 0.0)) return false;
    for (int i = j + 1; i < n; ++i) {
      const double l = A[i * n + j] / pivot;
      for (int k = j + 1; k <= i; ++k) A[i * n + k] -= l * A[k * n + j];
      b[i] -= l * b[j];
    }
    for (int i = j + 1; i < n; ++i) A[i * n + j] /= pivot;
    b[j] /= pivot;
  }
  for (int j = n - 1; j >= 0; --j)
    for (int i = j + 1; i < n; ++i) b[j] -= A[i * n + j] * b[i];
  return true;
}

// The lower triangle L of P = L L^T, row by row at a stride of padded(n); directions without variance stay 0.
inline std::vector<double> root(const Eigen::MatrixXd& P) {
  const int n = static_cast<int>(P.rows()), ld = padded(n);
  std::vector<double> out(static_cast<std::size_t>(n * ld + 8), 0.0);
  for (int j = 0; j < n; ++j) {
    double* row = out.data() + j * ld;
    for (int k = 0; k <= j; ++k) {
      const double* other = out.data() + k * ld;
      double sum = P(j, k);
      for (int l = 0; l < k; ++l) sum -= row[l] * other[l];
      row[k] = k < j ? (other[k] > 0.0 ? sum / other[k] : 0.0) : std::sqrt(std::max(sum, 0.0));
    }
  }
  return out;
}

// z^T I^-1 z by L D L^T, in place of the rows of I; directions in which it is not positive count nothing.
inline double quadratic_inverse(double* I, std::ptrdiff_t ld, Eigen::VectorXd z) {
  double sum = 0.0;
  for (Eigen::Index k = 0; k < z.size(); ++k) {
    const double *pivot = I + k * ld, d = pivot[k];
    if (!(d > 0.0)) continue;
    sum += z[k] * z[k] / d;
    for (Eigen::Index i = k + 1; i < z.size(); ++i) {
      double* row = I + i * ld;
      const double l = row[k] / d;
      z[i] -= l * z[k];
      for (Eigen::Index j = k + 1; j < z.size(); ++j) row[j] -= l * pivot[j];
    }
  }
  return sum;
}

// y = A x.
inline Eigen::VectorXd times(const Eigen::MatrixXd& A, const Eigen::VectorXd& x) {
  Eigen::VectorXd y = Eigen::VectorXd::Zero(A.rows());
  for (Eigen::Index j = 0; j < A.cols(); ++j) {
    const double* column = A.data() + j * A.rows();
    for (Eigen::Index i = 0; i < A.rows(); ++i) y[i] += column[i] * x[j];
  }
  return y;
}

// A^T B.
inline Eigen::MatrixXd transposed_times(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  Eigen::MatrixXd out(A.cols(), B.cols());
  for (Eigen::Index j = 0; j < B.cols(); ++j)
    for (Eigen::Index i = 0; i < A.cols(); ++i) {
      const double *a = A.data() + i * A.rows(), *b = B.data() + j * B.rows();
      double sum = 0.0;
      for (Eigen::Index k = 0; k < A.rows(); ++k) sum += a[k] * b[k];
      out(i, j) = sum;
    }
  return out;
}

// Eigenvalues of a symmetric matrix, in no order, and eigenvectors as columns: cyclic Jacobi.
struct Spectrum {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};

inline Spectrum eigen(Eigen::MatrixXd A) {
  const Eigen::Index n = A.rows();
  Spectrum out{Eigen::VectorXd(n), Eigen::MatrixXd::Identity(n, n)};
  double size = 0.0;
  for (Eigen::Index i = 0; i < n * n; ++i) size += A.data()[i] * A.data()[i];
  for (int round = 0; round < 30; ++round) {
    double off = 0.0;
    for (Eigen::Index q = 1; q < n; ++q)
      for (Eigen::Index p = 0; p < q; ++p) {
        const double x = A(p, q);
        off += x * x;
        if (!(std::abs(x) > 1e-300)) continue;
        const double ratio = (A(q, q) - A(p, p)) / (2.0 * x);
        const double t = (ratio >= 0.0 ? 1.0 : -1.0) / (std::abs(ratio) + std::sqrt(1.0 + ratio * ratio));
        const double c = 1.0 / std::sqrt(1.0 + t * t), s = t * c;
        double *a = A.data() + p * n, *b = A.data() + q * n, *u = out.vectors.data() + p * n,
               *v = out.vectors.data() + q * n;
        for (Eigen::Index k = 0; k < n; ++k) {
          const double x0 = a[k], y0 = u[k];
          a[k] = c * x0 - s * b[k];
          b[k] = s * x0 + c * b[k];
          u[k] = c * y0 - s * v[k];
          v[k] = s * y0 + c * v[k];
        }
        for (Eigen::Index k = 0; k < n; ++k) {
          const double x0 = A(p, k);
          A(p, k) = c * x0 - s * A(q, k);
          A(q, k) = s * x0 + c * A(q, k);
        }
      }
    if (!(off > 1e-30 * size)) break;
  }
  for (Eigen::Index i = 0; i < n; ++i) out.values[i] = A(i, i);
  return out;
}

}  // namespace truewrench::dense
