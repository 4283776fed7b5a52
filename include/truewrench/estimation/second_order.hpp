// What the product of gain and body adds to mean and covariance, beyond the derivatives at the estimate (METHOD 3, 10.1).
//
// Data tell K = C M(b), M the payload's spatial inertia: what is not told of the body b moves the gain C along K, and the
// likeliest gain and body together are not the middle of what is left. Allocates.
#pragma once

#include "truewrench/math/dense.hpp"
#include "truewrench/model/body.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace truewrench {

// A payload that logs moved.
struct Carried {
  std::array<int, kBodyParameters> places{};  // of its parameters in theta
  Payload body;                               // as found
  Matrix6 felt = Matrix6::Identity();         // sum of w w^T over the samples
};

using BodyChanges = std::array<Matrix6, kBodyParameters>;

// L_k = (dM / db_k) M^-1: where w is felt of a body, w + L_k w db_k is of one that is another. Moments of inertia below
// `inertia_std` resist no turn.
inline BodyChanges body_changes(const Payload& body, double inertia_std) {
  constexpr double flat = 1e-12;  // of the largest moment: rounding
  const double m = body.mass;
  const Matrix3 c = cross_matrix(body.center_of_mass), one = Matrix3::Identity();
  const double least = std::max({inertia_std, flat * body.inertia.cwiseAbs().maxCoeff(), 1e-150});
  // M = X^-T diag(m, I) X^-1, X = [1 [c]; 0 1]
  Matrix6 X = Matrix6::Identity(), inner = Matrix6::Zero();
  X.topRightCorner<3, 3>() = c;
  inner.topLeftCorner<3, 3>() = one / m;
  const dense::Spectrum axes = dense::eigen(body.inertia);
  for (int k = 0; k < 3; ++k) {
    const Vector3 axis = axes.vectors.col(k);
    const double moment = axes.values[k];
    inner.bottomRightCorner<3, 3>() += moment / (moment * moment + least * least) * axis * axis.transpose();
  }
  const Matrix6 inverse = X * inner * X.transpose();
  BodyChanges out;
  for (Matrix6& by : out) by.setZero();
  out[0] << m * one, -m * c, m * c, -m * c * c;
  for (int k = 0; k < 3; ++k) {
    const Matrix3 e = cross_matrix(Vector3::Unit(k));
    out[static_cast<std::size_t>(1 + k)] << Matrix3::Zero(), -m * e, m * e, -m * (e * c + c * e);
  }
  for (int k = 0; k < 6; ++k) {
    const Vector6 unit = Vector6::Unit(k);
    out[static_cast<std::size_t>(4 + k)].bottomRightCorner<3, 3>() = inertia_tensor(unit.data());
  }
  for (Matrix6& by : out) by = by * inverse;
  return out;
}

// 1/2 d log |H_CC| / db_k = tr[(1 x L_k) H P]: p(b) ~ exp(-Q(b) / 2) |H_CC(b)|^(-1/2) with the gain integrated out.
// `told`: (6n, 6n) H P, the data's information on the gain times its covariance once the body is known; row by row.
inline BodyVector volume_slope(const BodyChanges& change, const Eigen::MatrixXd& told) {
  Matrix6 sum = Matrix6::Zero();
  for (Eigen::Index i = 0; i + 6 <= told.rows(); i += 6) sum += told.block<6, 6>(i, i);
  BodyVector out;
  for (int k = 0; k < kBodyParameters; ++k) out[k] = (change[static_cast<std::size_t>(k)] * sum).trace();
  return out;
}

// A^-1, directions below `relative` of the largest left out.
inline Eigen::MatrixXd symmetric_inverse(const Eigen::MatrixXd& A, double relative) {
  const dense::Spectrum spectrum = dense::eigen(A);
  Eigen::MatrixXd rows = spectrum.vectors.transpose();  // each over the root of its eigenvalue
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    const double value = spectrum.values[i];
    rows.row(i) *= value > relative * spectrum.values.maxCoeff() ? 1.0 / std::sqrt(value) : 0.0;
  }
  return dense::transposed_times(rows, rows);
}

// How far from the likeliest parameters those lie with which the body is likeliest: -P slope.
// P: covariance, the gain normalised and row by row first. prior: (6n) variances of the gain. range: normalises the wrench.
// Each payload tells the share W_p W^-1 of the gain, W its `felt`.
inline Eigen::VectorXd to_the_middle(const Eigen::MatrixXd& P, const Eigen::VectorXd& prior,
                                     const Vector6& range, const std::vector<Carried>& carried) {
  constexpr double nothing = 1e-17,
                   singular = 1e-12;  // variance of what is exact; of a correlation: rounding
  const Eigen::Index gains = prior.size();
  Eigen::VectorXd out = Eigen::VectorXd::Zero(P.rows());
  std::vector<int> at;
  std::vector<const Carried*> tied;  // to the gain
  Matrix6 whole = Matrix6::Zero();
  const Matrix6 unit = range.cwiseInverse().asDiagonal();
  for (const Carried& one : carried) {
    whole += unit * one.felt * unit;
    const std::size_t before = at.size();
    for (const int k : one.places)
      if (P(k, k) > nothing && P.col(k).head(gains).any()) at.push_back(k);
    if (at.size() > before) tied.push_back(&one);
  }
  if (at.empty()) return out;
  const auto count = static_cast<Eigen::Index>(at.size());
  Eigen::MatrixXd inner(count, count), cross(count, gains);  // in units of sigma
  for (Eigen::Index a = 0; a < count; ++a) {
    const int p = at[static_cast<std::size_t>(a)];
    cross.row(a) = P.row(p).head(gains) / std::sqrt(P(p, p));
    for (Eigen::Index b = 0; b < count; ++b) {
      const int q = at[static_cast<std::size_t>(b)];
      inner(a, b) = P(p, q) / std::sqrt(P(p, p) * P(q, q));
    }
  }
  // 1 - P0^-1 P_gg|b = H P_gg|b
  const Eigen::MatrixXd taken =
      dense::transposed_times(cross, dense::transposed_times(symmetric_inverse(inner, singular), cross));
  Eigen::MatrixXd told = prior.cwiseInverse().asDiagonal() * (taken - P.topLeftCorner(gains, gains));
  told.diagonal().array() += 1.0;
  const Matrix6 shares = symmetric_inverse(whole, singular);
  for (const Carried* one : tied) {
    double variance = 0.0;
    for (std::size_t k = 4; k < 7; ++k) variance += P(one->places[k], one->places[k]) / 3.0;
    BodyChanges change = body_changes(one->body, std::sqrt(variance));
    const Matrix6 share = unit * one->felt * unit * shares;
    for (Matrix6& L : change) L = unit * L * range.asDiagonal() * share;
    const BodyVector slope = volume_slope(change, told);
    for (int k = 0; k < kBodyParameters; ++k)
      out -= P.col(one->places[static_cast<std::size_t>(k)]) * slope[k];
  }
  return out;
}

// What the product of gain of moment and centre of mass adds to the covariance of the gain (6n, 6n).
// Of the force f the channels feel (C_f + C_m [c]) f. Where C_m is not told, an error of c turns it into one of C_f that no
// derivative at the estimate shows: E (dC_m [dc])^T (dC_m [dc]). No gain's variance rises above its prior's.
// gain: covariance, SI; center: of the centre of mass [m^2]; prior: (6n) variances beforehand.
inline Eigen::MatrixXd bend(const Eigen::MatrixXd& gain, const Matrix3& center,
                            const Eigen::VectorXd& prior) {
  const Eigen::Index gains = gain.rows();
  std::array<Matrix3, 3> e;
  for (int k = 0; k < 3; ++k) e[static_cast<std::size_t>(k)] = cross_matrix(Vector3::Unit(k));
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(gains, gains);
  for (Eigen::Index i = 0; i < gains; i += 6)
    for (Eigen::Index j = 0; j < gains; j += 6) {
      const Matrix3 moments = gain.block<3, 3>(i + 3, j + 3);
      for (int p = 0; p < 3; ++p)
        for (int q = 0; q < 3; ++q)
          out.block<3, 3>(i, j) += center(p, q) * e[static_cast<std::size_t>(p)].transpose() * moments *
                                   e[static_cast<std::size_t>(q)];
    }
  Eigen::VectorXd part(gains);
  for (Eigen::Index i = 0; i < gains; ++i) {
    const double room = std::max(prior[i] - gain(i, i), 0.0), most = out(i, i);
    part[i] = most > 0.0 ? std::sqrt(std::min(room, most) / most) : 0.0;
  }
  return part.asDiagonal() * out * part.asDiagonal();
}

}  // namespace truewrench
