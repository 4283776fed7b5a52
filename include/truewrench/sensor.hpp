// The sensor raw = gain w + offset, its noise-weighted inverse and how well that inverse is posed ([A00]
// 1-4).
#pragma once

#include "truewrench/types.hpp"

#include <Eigen/QR>
#include <Eigen/SVD>

namespace truewrench {

inline constexpr int max_channels = 32;

// Six or more channels. N is their number, or Eigen::Dynamic for up to max_channels without heap.
template <int N = Eigen::Dynamic>
struct SensorModel {
  static_assert(N <= max_channels);
  static constexpr int storage = N == Eigen::Dynamic ? max_channels : N;
  using Gain = Eigen::Matrix<double, N, 6, Eigen::ColMajor, storage, 6>;
  using Inverse = Eigen::Matrix<double, 6, N, Eigen::ColMajor, 6, storage>;
  using Channels = Eigen::Matrix<double, N, 1, Eigen::ColMajor, storage, 1>;

  Gain gain;        // raw unit per N and N m
  Channels offset;  // raw unit
  Channels noise;   // 1 sigma per sample, raw unit

  Channels raw(const Vector6& w) const { return gain * w + offset; }
};

// What can go wrong with a sensor model before any arithmetic is done with it.
template <int N>
Status check(const SensorModel<N>& s) {
  if (s.gain.rows() < 6 || s.offset.size() != s.gain.rows() || s.noise.size() != s.gain.rows())
    return Status::wrong_size;
  if (!s.gain.allFinite() || !s.offset.allFinite() || !s.noise.allFinite()) return Status::not_finite;
  if (s.noise.minCoeff() <= 0.0) return Status::not_positive;
  return Status::ok;
}

// A of any number of channels: one factorisation for a compiler to translate, whatever N.
using TallMatrix = SensorModel<>::Gain;
using TallFactors = Eigen::ColPivHouseholderQR<TallMatrix>;

// The Moore-Penrose inverse of a matrix with six columns of length one; singular where its rank is less.
inline Status tall_inverse(const TallMatrix& A, SensorModel<>::Inverse& inverse) {
  TallFactors qr(A);
  qr.setThreshold(1e-12);
  if (qr.rank() < 6) return Status::singular;
  // P R^-1 Q^T of each unit vector, in loops: Eigen's solver takes a compiler 200 MB here
  const Eigen::Index n = A.rows();
  const auto& QR = qr.matrixQR();
  inverse.resize(6, n);
  for (Eigen::Index c = 0; c < n; ++c) {
    SensorModel<>::Channels x = SensorModel<>::Channels::Zero(n);
    x[c] = 1.0;
    for (Eigen::Index k = 0; k < 6; ++k) {  // the reflections I - t v v^T, v = (1, below the diagonal)
      double sum = x[k];
      for (Eigen::Index r = k + 1; r < n; ++r) sum += QR(r, k) * x[r];
      sum *= qr.hCoeffs()[k];
      x[k] -= sum;
      for (Eigen::Index r = k + 1; r < n; ++r) x[r] -= sum * QR(r, k);
    }
    for (Eigen::Index k = 5; k >= 0; --k) {
      for (Eigen::Index j = k + 1; j < 6; ++j) x[k] -= QR(k, j) * x[j];
      x[k] /= QR(k, k);
    }
    for (Eigen::Index k = 0; k < 6; ++k) inverse(qr.colsPermutation().indices()[k], c) = x[k];
  }
  return Status::ok;
}

// Singular values, the largest first: of the triangle R of A = Q R P^T.
inline Vector6 singular_values(const TallMatrix& A) {
  const TallFactors qr(A);
  Matrix6 R = Matrix6::Zero();
  for (Eigen::Index j = 0; j < 6; ++j) R.col(j).head(j + 1) = qr.matrixQR().col(j).head(j + 1);
  return Eigen::JacobiSVD<Matrix6>(R).singularValues();
}

// G^+ = (G^T R^-1 G)^-1 G^T R^-1 with R = diag(noise^2): the inverse of smallest variance, by
// orthogonal factorisation of the whitened gain. Its columns are scaled to length one first, so that
// N beside N m does not pass for a missing rank.
template <int N>
Status generalised_inverse(const SensorModel<N>& s, typename SensorModel<N>::Inverse& inverse) {
  if (const Status status = check(s); status != Status::ok) return status;
  const typename SensorModel<N>::Channels weight = s.noise.cwiseInverse();
  TallMatrix whitened = weight.asDiagonal() * s.gain;
  const Vector6 length = whitened.colwise().norm().transpose();
  if (length.minCoeff() <= 0.0) return Status::singular;
  whitened = whitened * length.cwiseInverse().asDiagonal();
  SensorModel<>::Inverse white;
  if (const Status status = tall_inverse(whitened, white); status != Status::ok) return status;
  inverse = length.cwiseInverse().asDiagonal() * white * weight.asDiagonal();
  return inverse.allFinite() ? Status::ok : Status::singular;
}

// Figures without units: wrench axes counted in their ranges, channels in what the nominal gain gives
// over the ranges.
struct Conditioning {
  double condition_number = 0.0;  // of the normalised gain; infinite when singular
  double departure_norm = 0.0;    // ||Delta||_2, Delta = C - I ([A00] 3-4)

  // The paper's condition guarantees that C is invertible. It is sufficient, not necessary.
  bool departure_below_one() const { return departure_norm < 1.0; }
};

// C = Chat G, with Chat the weighted inverse of the nominal gain, as the paper's C = Chat Cs.
template <int N>
Status conditioning(const SensorModel<N>& s, const typename SensorModel<N>::Gain& nominal,
                    const Vector6& range, Conditioning& out) {
  if (const Status status = check(s); status != Status::ok) return status;
  if (nominal.rows() != s.gain.rows()) return Status::wrong_size;
  if (!range.allFinite() || !nominal.allFinite()) return Status::not_finite;
  if (range.minCoeff() <= 0.0) return Status::not_positive;

  typename SensorModel<N>::Inverse chat;
  SensorModel<N> believed = s;
  believed.gain = nominal;
  if (const Status status = generalised_inverse(believed, chat); status != Status::ok) return status;
  const Matrix6 delta = range.cwiseInverse().asDiagonal() * (chat * s.gain) * range.asDiagonal();
  out.departure_norm = Eigen::JacobiSVD<Matrix6>(delta - Matrix6::Identity()).singularValues()(0);

  const typename SensorModel<N>::Channels scale = nominal.cwiseAbs() * range;
  const TallMatrix normalised = scale.cwiseInverse().asDiagonal() * s.gain * range.asDiagonal();
  if (!normalised.allFinite()) return Status::singular;
  const Vector6 values = singular_values(normalised);
  out.condition_number = values(0) / values(5);
  return values(5) > 0.0 ? Status::ok : Status::singular;
}

}  // namespace truewrench
