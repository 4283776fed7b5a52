// Whether two parts of what a record says agree on the gain (METHOD (10.11)).
#pragma once

#include "truewrench/math/chi_square.hpp"
#include "truewrench/math/dense.hpp"

#include <array>
#include <cmath>

namespace truewrench {

// One comparison of two parts of the record (10.11).
struct Agreement {
  double p = 1.0;
  double chi2 = 0.0;
  int freedom = 0;
};

// p of (10.11) from what two parts say of theta: means, covariances, priors' variances; the gains come first. `added`: what (10.9)
// adds to the gains' covariances, of both.
inline Agreement compare(const std::array<Eigen::VectorXd, 2>& mean, const std::array<Eigen::MatrixXd, 2>& P,
                         const Eigen::MatrixXd& added, const Eigen::VectorXd& prior) {
  // V = P_a + P_b - P_a Pi^-1 P_b - P_b Pi^-1 P_a, in units of the prior's sigma                                    (10.11)
  Agreement out;
  const Eigen::Index gains = added.rows();
  Eigen::MatrixXd scaled = P[1];
  for (Eigen::Index i = 0; i < scaled.rows(); ++i) scaled.row(i) /= prior[i];
  const Eigen::MatrixXd both = dense::transposed_times(P[0], scaled);
  Eigen::MatrixXd V(gains, gains);
  Eigen::VectorXd delta(gains);
  for (Eigen::Index i = 0; i < gains; ++i) {
    delta[i] = (mean[0][i] - mean[1][i]) / std::sqrt(prior[i]);
    for (Eigen::Index j = 0; j < gains; ++j)
      V(i, j) =
          (P[0](i, j) + P[1](i, j) - both(i, j) - both(j, i) + added(i, j)) / std::sqrt(prior[i] * prior[j]);
  }
  const dense::Spectrum spectrum = dense::eigen(V);
  for (Eigen::Index i = 0; i < gains; ++i) {
    if (spectrum.values[i] <= 1e-9) continue;
    const double projected = spectrum.vectors.col(i).dot(delta);
    out.chi2 += projected * projected / spectrum.values[i];
    ++out.freedom;
  }
  out.p = out.freedom > 0 ? std::exp(chi_square_log_tail(out.chi2, out.freedom)) : 1.0;
  return out;
}

// What a part of the rows says of some parameters, apart from where it was linearised: by information and gradient in these, their
// prior's variances and its pull.
struct TellsOf {
  Eigen::VectorXd mean;
  Eigen::MatrixXd P;
  bool solved;

  TellsOf(Eigen::MatrixXd S, const Eigen::VectorXd& pull, const Eigen::VectorXd& prior) {
    for (Eigen::Index i = 0; i < S.rows(); ++i) S(i, i) += 1.0 / prior[i];
    double logdet = 0.0;
    solved = dense::invert(S, P, logdet);
    if (solved) mean = dense::times(P, pull);
  }
};

// p of (10.11); no number, which no verdict takes for agreement, where it could not be had.
inline Agreement compare(const TellsOf& a, const TellsOf& b, const Eigen::MatrixXd& added,
                         const Eigen::VectorXd& prior) {
  if (!a.solved || !b.solved) return {std::nan("")};
  return compare({a.mean, b.mean}, {a.P, b.P}, added, prior);
}

}  // namespace truewrench
