// Which delays the gain can imitate. Where w' = A w + a over a record (force and moment in quadrature at one frequency an axis:
// the paper's own motion), C w(t + s) = (C + s C A) w + s C a: no residual tells s from C. What then seems to tell them apart is
// the noise of the estimated motion, and one dw/dx an interval: together they gave s to 0.5 us, 0.6 ms beside the truth.
#pragma once

#include "truewrench/estimation/stretch.hpp"
#include "truewrench/math/dense.hpp"

#include <vector>

namespace truewrench {

struct Imitation {
  double left = 1.0;          // share of C w', in noise of the channels, that A and a leave
  RowMatrix gain[2];          // C A, C A A, (n, 6)
  Eigen::VectorXd offset[2];  // C a, C A a, (n)
};

// Over the unmasked samples of one log; `C` (n, 6) row by row, `sigma` (n) of the channels.
inline Imitation imitation(const std::vector<Stretch>& stretches, const double* C,
                           const Eigen::VectorXd& sigma) {
  constexpr int F = 7;  // [w, 1]
  Eigen::MatrixXd ff = Eigen::MatrixXd::Zero(F, F);
  double fd[F][6] = {}, dd[6][6] = {};
  for (const Stretch& s : stretches)
    for (Eigen::Index k = 1; k + 1 < s.raw.size(); ++k) {
      if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
      const double span = s.raw.time[k + 1] - s.raw.time[k - 1];
      double f[F], d[6];
      for (int j = 0; j < 6; ++j) {
        f[j] = s.now.w(k, j);
        d[j] = (s.now.w(k + 1, j) - s.now.w(k - 1, j)) / span;
      }
      f[6] = 1.0;
      for (int i = 0; i < F; ++i) {
        for (int j = 0; j < F; ++j) ff(i, j) += f[i] * f[j];
        for (int j = 0; j < 6; ++j) fd[i][j] += f[i] * d[j];
      }
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 6; ++j) dd[i][j] += d[i] * d[j];
    }
  Imitation out;
  const auto n = static_cast<int>(sigma.size());
  for (int order = 0; order < 2; ++order) {
    out.gain[order] = RowMatrix::Zero(n, 6);
    out.offset[order] = Eigen::VectorXd::Zero(n);
  }
  const double count = ff(6, 6);
  if (count < 2.0 * F) return out;
  for (int j = 0; j < 6; ++j) ff(j, j) += 1e-12 * (ff(j, j) + ff.trace() / F);  // an axis that nothing loads
  Eigen::MatrixXd inverse;
  double logdet = 0.0;
  if (!dense::invert(ff, inverse, logdet)) return out;
  double A[F][6] = {};  // w' = A^T [w, 1]
  for (int i = 0; i < F; ++i)
    for (int k = 0; k < F; ++k)
      for (int j = 0; j < 6; ++j) A[i][j] += inverse(i, k) * fd[k][j];
  double all = 0.0, left = 0.0;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < 6; ++j)
      for (int k = 0; k < 6; ++k) {
        double fitted = 0.0;
        for (int f = 0; f < F; ++f) fitted += A[f][j] * fd[f][k];
        const double both = C[6 * i + j] * C[6 * i + k] / (sigma[i] * sigma[i]);
        all += both * (dd[j][k] - fd[6][j] * fd[6][k] / count);
        left += both * (dd[j][k] - fitted);
        out.gain[0](i, k) += C[6 * i + j] * A[k][j];
      }
    for (int j = 0; j < 6; ++j) out.offset[0][i] += C[6 * i + j] * A[6][j];
    for (int j = 0; j < 6; ++j) {
      for (int k = 0; k < 6; ++k) out.gain[1](i, k) += out.gain[0](i, j) * A[k][j];
      out.offset[1][i] += out.gain[0](i, j) * A[6][j];
    }
  }
  if (all > 0.0) out.left = left / all;
  return out;
}

}  // namespace truewrench
