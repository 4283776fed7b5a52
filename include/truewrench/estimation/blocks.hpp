// Blocks of five knots (METHOD 9): where rows stand in the panels of two of them, the elimination of one, and the way back to
// its covariances.
#pragma once

#include "truewrench/math/dense.hpp"
#include "truewrench/math/spline.hpp"

#include <algorithm>

namespace truewrench {

inline constexpr int kPairs = kLocal * (kLocal + 1) / 2;  // k <= l of an interval's knots
constexpr int knot_pair(int k, int l) { return k * kLocal - k * (k - 1) / 2 + l - k; }

// Where the rows of a knot under an interval begin in the panels of two blocks, and their columns.
struct Places {
  double* row[kLocal];
  int column[kLocal][kLocal];  // of knot l in the rows of knot k <= l
  int ld, theta;               // stride of the rows; where theta's columns begin
};

// A panel: of every knot m rows, of a block W: [R, its knots ; R^-T H, the next block's knots ; R^-T [H_xt, gradient]], R^T R
// the pivot: the first upper triangular, the second zero where a knot of the next block lies more than five after.
struct Shape {
  int m = 6, nt = 0;                        // rows of a knot; columns of theta
  int W = 30, Wp = 32, ldt = 64, ld = 128;  // W and nt + 1 to multiples of 8

  Shape() = default;
  Shape(int rows_of_knot, int parameters)
      : m(rows_of_knot),
        nt(parameters),
        W(kBlock * m),
        Wp(dense::padded(W)),
        ldt(dense::padded(nt + 1)),
        ld(2 * Wp + ldt) {}

  int theta() const { return 2 * Wp; }
  // Place of an element of theta's upper triangle (nt + 1, ldt), the gradient its last column.
  std::size_t tt(int i, int j) const { return static_cast<std::size_t>(i <= j ? i * ldt + j : j * ldt + i); }

  // Under interval o of the block whose panel is P, the next one's N.
  Places places(int o, double* P, double* N) const {
    Places out;
    out.ld = ld;
    out.theta = theta();
    for (int k = 0; k < kLocal; ++k) {
      const bool here = o + k < kBlock;
      out.row[k] = here ? P + (o + k) * m * ld : N + (o + k - kBlock) * m * ld;
      for (int l = k; l < kLocal; ++l)
        out.column[k][l] =
            !here || o + l < kBlock ? (here ? o + l : o + l - kBlock) * m : Wp + (o + l - kBlock) * m;
    }
    return out;
  }

  // Factor a block's pivot; take what it tells of theta from T and, where there is a next block, from its rows N. False where
  // the pivot is not positive definite.
  bool eliminate(double* P, double* N, double* T, double& logdet) const {
    if (!dense::factor(P, ld, W, logdet)) return false;
    for (int t = 0; t <= nt && T; t += dense::tile_rows) {
      const int c = t & ~7;
      dense::tile_of(std::min(dense::tile_rows, nt + 1 - t), T + t * ldt + c, ldt, P + theta() + t, 1, ld,
                     P + theta() + c, ld, ldt - c, W);
    }
    for (int t = 0; t < W && N; t += dense::tile_rows) {
      const int rows = std::min(dense::tile_rows, W - t), c = t & ~7, from = t / m * m;
      const double *A = P + from * ld + Wp + t, *B = P + from * ld;
      dense::tile_of(rows, N + t * ld + c, ld, A, 1, ld, B + Wp + c, ld, Wp - c, W - from);
      if (T) dense::tile_of(rows, N + t * ld + theta(), ld, A, 1, ld, B + theta(), ld, ldt, W - from);
    }
    return true;
  }

  // Covariances of a block, theta known, by selected inversion: S_gh = - G S_hh, S_gg = R^-1 R^-T - S_gh G^T, h the next block,
  // G = R^-1 R^-T H_gh. `here` and `next` (W, 2 Wp): [its knots ; the next block's]; X (W, ldx) <- R^-1 X, its first 2 Wp columns
  // [1 ; R^-T H_gh]; V (2 W, Wp): work space. `last`: there is no next block.
  void invert(const double* P, bool last, double* X, int ldx, double* V, double* here,
              const double* next) const {
    for (int i = 0; i < W; ++i) {
      std::fill_n(X + i * ldx, 2 * Wp, 0.0);
      X[i * ldx + i] = 1.0;
      if (!last) std::copy_n(P + i * ld + Wp, W, X + i * ldx + Wp);
    }
    dense::solve_upper(P, ld, W, X, ldx, ldx);
    for (int i = 0; i < W; ++i)
      for (int j = 0; j < W; ++j) {
        V[j * Wp + i] = -X[i * ldx + j];
        V[(W + j) * Wp + i] = X[i * ldx + Wp + j];
      }
    if (!last) dense::subtract(here + Wp, 2 * Wp, X + Wp, ldx, 1, next, 2 * Wp, W, Wp, W, dense::Mode::fresh);
    for (int t = 0; t < W; t += dense::tile_rows)
      dense::tile_of(std::min(dense::tile_rows, W - t), here + t * 2 * Wp, 2 * Wp, X + t * ldx + t, ldx, 1,
                     V + t * Wp, Wp, Wp, W - t, nullptr, 0, dense::Mode::fresh);
    if (!last) dense::subtract(here, 2 * Wp, here + Wp, 2 * Wp, 1, V + W * Wp, Wp, W, Wp, W);
  }

  // Covariance of knots a <= b (0 ... 9 of two blocks), (m, m) at a stride of 2 Wp.
  const double* covariance(const double* here, const double* next, int a, int b) const {
    if (a >= kBlock) return next + (a - kBlock) * m * 2 * Wp + (b - kBlock) * m;
    return here + a * m * 2 * Wp + (b < kBlock ? b * m : Wp + (b - kBlock) * m);
  }
};

}  // namespace truewrench
