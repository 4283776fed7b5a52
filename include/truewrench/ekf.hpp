// The recursive filter as published ([A00] 18-26): state [nu; a; rows of C], with an offset when asked.
//
// The covariance is kept as its upper triangle and updated as P - W^T W with W = L^-1 H P and
// S = L L^T, so it is symmetric by construction and stays positive definite at small measurement noise.
// A step neither allocates nor throws.
#pragma once

#include "truewrench/payload.hpp"
#include "truewrench/tile.hpp"
#include "truewrench/types.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace truewrench {

using Vector12 = Eigen::Matrix<double, 12, 1>;
using Matrix12 = Eigen::Matrix<double, 12, 12>;
using Matrix42 = Eigen::Matrix<double, 42, 42>;

// What white noise of unit density on a' leaves on nu and a after a step of dt seconds, the motion a double integrator
// ([A00] 18-21): Q = [twist s, cross s; cross s, acceleration s] for the densities s of the six components.
struct ProcessWeights {
  double twist;         // dt^3 / 3
  double cross;         // dt^2 / 2
  double acceleration;  // dt
};

inline ProcessWeights process_weights(double dt) { return {dt * dt * dt / 3.0, 0.5 * dt * dt, dt}; }

// The defaults are the published start: C = I, P = I, nu = a = 0, in SI units.
struct EkfSettings {
  Feels feels = Feels::payload_on_sensor;
  Matrix6 raw_covariance = Matrix6::Identity();           // of one sample of the six channels
  Matrix6 twist_covariance = 1e-6 * Matrix6::Identity();  // of one sample of nu; J_c E[.] J_c^T for joints
  Vector6 process_density = Vector6::Constant(0.5);       // of a', a tuning parameter of the paper
  Vector6 twist_variance = Vector6::Ones();               // of nu at the start
  Vector6 acceleration_variance = Vector6::Ones();        // of a at the start
  Matrix6 gain = Matrix6::Identity();
  Vector6 offset = Vector6::Zero();
  Matrix42 parameter_covariance = published_parameter_covariance();  // of [C row by row; offset] at the start

  static Matrix42 published_parameter_covariance() {
    Matrix42 p = Matrix42::Zero();
    p.topLeftCorner<36, 36>().setIdentity();
    return p;
  }
};

inline Status check(const EkfSettings& s) {
  if (!s.raw_covariance.allFinite() || !s.twist_covariance.allFinite() || !s.process_density.allFinite() ||
      !s.twist_variance.allFinite() || !s.acceleration_variance.allFinite() || !s.gain.allFinite() ||
      !s.offset.allFinite() || !s.parameter_covariance.allFinite())
    return Status::not_finite;
  const double smallest_prior =
      std::min({s.process_density.minCoeff(), s.twist_variance.minCoeff(), s.acceleration_variance.minCoeff(),
                s.parameter_covariance.diagonal().minCoeff()});
  const double smallest_noise =
      std::min(s.raw_covariance.diagonal().minCoeff(), s.twist_covariance.diagonal().minCoeff());
  if (smallest_prior < 0.0 || smallest_noise <= 0.0) return Status::not_positive;
  return Status::ok;
}

// What one update has to say for itself. Rows 0-5 are the channels, rows 6-11 the twist.
struct EkfUpdate {
  Vector12 innovation = Vector12::Constant(std::numeric_limits<double>::quiet_NaN());  // NaN: no sample
  Matrix12 innovation_covariance = Matrix12::Identity();  // S; identity in the rows without a sample
  double nis = 0.0;  // innovation^T S^-1 innovation: chi-square with degrees_of_freedom when consistent
  int degrees_of_freedom = 0;  // the samples used, the expectation of `nis` when consistent
};

template <bool Offset>
class Ekf {
 public:
  static constexpr int size = Offset ? 54 : 48;
  using State = Eigen::Matrix<double, size, 1>;
  using Covariance = Eigen::Matrix<double, size, size>;
  using Gain = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

  // `payload` and `settings` are valid: see check().
  Ekf(const Payload& payload, const EkfSettings& settings)
      : jacobian_acceleration_(static_cast<double>(settings.feels) * wrench_jacobian_acceleration(payload)),
        settings_(settings),
        sign_(static_cast<double>(settings.feels)),
        payload_(payload) {
    std::memset(p_, 0, sizeof p_);
    std::memset(x_, 0, sizeof x_);
    constexpr int parameters = size - first_gain;
    for (int i = 0; i < 6; ++i) {
      p_[i][i] = settings.twist_variance(i);
      p_[6 + i][6 + i] = settings.acceleration_variance(i);
      for (int j = 0; j < 6; ++j) x_[first_gain + 6 * i + j] = settings.gain(i, j);
      if constexpr (Offset) x_[first_offset + i] = settings.offset(i);
    }
    for (int i = 0; i < parameters; ++i)
      for (int j = i; j < parameters; ++j)
        p_[first_gain + i][first_gain + j] = settings.parameter_covariance(i, j);
  }

  // Carries the motion over dt seconds: x <- F x, P <- F P F^T + Q.
  Status predict(double dt) noexcept {
    if (!std::isfinite(dt)) return Status::not_finite;
    if (dt <= 0.0) return Status::not_increasing;
    const ProcessWeights q = process_weights(dt);
    for (int i = 0; i < 6; ++i) x_[i] += dt * x_[6 + i];
    for (int i = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) {
        const double aa = p_[6 + i][6 + j];
        p_[i][j] += dt * (p_[i][6 + j] + p_[j][6 + i] + dt * aa);
      }
    }
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) p_[i][6 + j] += dt * (j < i ? p_[6 + j][6 + i] : p_[6 + i][6 + j]);
      for (int j = first_gain; j < stride; ++j) p_[i][j] += dt * p_[6 + i][j];
    }
    for (int i = 0; i < 6; ++i) {
      const double density = settings_.process_density(i);
      p_[i][i] += q.twist * density;
      p_[i][6 + i] += q.cross * density;
      p_[6 + i][6 + i] += q.acceleration * density;
    }
    return Status::ok;
  }

  // Takes in one row of the log. A NaN in `raw` or `twist` means that it has no sample in this row.
  // On failure the estimate is left as it was; last_update() then holds the innovation that failed.
  Status update(const Vector6& raw, const Vector6& twist, const Vector3& gravity) noexcept {
    const Vector6 nu = twist_estimate();
    const Vector6 w = sign_ * wrench(payload_, nu, acceleration_estimate(), gravity);
    const Gain c = gain();
    MotionColumns h = MotionColumns::Zero();
    h.leftCols<6>().topRows<6>() = c.lazyProduct(sign_ * wrench_jacobian_twist(payload_, nu));
    h.rightCols<6>().topRows<6>() = c.lazyProduct(jacobian_acceleration_);
    Vector6 predicted = c.lazyProduct(w);
    if constexpr (Offset) predicted += Eigen::Map<const Vector6>(x_ + first_offset);
    last_.innovation.head<6>() = raw - predicted;
    last_.innovation.tail<6>() = twist - nu;

    bool missing[12];
    last_.degrees_of_freedom = 0;
    for (int i = 0; i < 12; ++i) {
      missing[i] = std::isnan(i < 6 ? raw(i) : twist(i - 6));
      last_.degrees_of_freedom += missing[i] ? 0 : 1;
      if (!missing[i] && !std::isfinite(last_.innovation(i))) return Status::not_finite;
    }
    last_.nis = 0.0;
    if (last_.degrees_of_freedom == 0) return Status::ok;

    mirror();
    project(h, w, missing);
    assemble_innovation_covariance(h, w, missing);
    Matrix12 l;
    Vector12 inverse_pivot;
    if (!factorize(l, inverse_pivot)) return Status::not_factorizable;
    whiten(l, inverse_pivot, missing);
    correct();
    return Status::ok;
  }

  const EkfUpdate& last_update() const noexcept { return last_; }
  State state() const { return Eigen::Map<const State>(x_); }
  Covariance covariance() const {
    Covariance p;
    for (int i = 0; i < size; ++i)
      for (int j = i; j < size; ++j) p(i, j) = p(j, i) = p_[i][j];
    return p;
  }
  Vector6 twist_estimate() const { return Eigen::Map<const Vector6>(x_); }
  Vector6 acceleration_estimate() const { return Eigen::Map<const Vector6>(x_ + 6); }
  Gain gain() const { return Eigen::Map<const Gain>(x_ + first_gain); }

 private:
  // Rows are padded to whole tiles; the padding stays zero throughout.
  static constexpr int stride = (size + 7) / 8 * 8;
  static constexpr int first_gain = 12;
  static constexpr int first_offset = 48;

  // The part of H that the motion sees, transposed: [C dw/dnu, C dw/da]^T in rows of eight.
  using MotionColumns = Eigen::Matrix<double, 8, 12>;

  // The lower triangle from the upper one.
  void mirror() noexcept {
    for (int i = 0; i < stride; i += 4) {
      for (int r = 0; r < 4; ++r)
        for (int c = r + 1; c < 4; ++c) p_[i + c][i + r] = p_[i + r][i + c];
      for (int j = i + 4; j < stride; j += 4)
        Tile<4, 4>::load(&p_[i][j], stride).store_transposed(&p_[j][i], stride);
    }
  }

  // w_ <- H P with H = [C dw/dnu, C dw/da, I6 kron w^T, I; I 0 0 0]; rows without a sample are zero.
  void project(const MotionColumns& h, const Vector6& w, const bool (&missing)[12]) noexcept {
    for (int j = 0; j < stride; j += tile_columns) {
      project_rows<0>(h, w, j);
      project_rows<3>(h, w, j);
      Tile<6>::load(&p_[0][j], stride).store(&w_[6][j], stride);
    }
    for (int i = 0; i < 12; ++i)
      if (missing[i]) std::fill_n(w_[i], stride, 0.0);
  }

  // Three channels in the columns of one tile; six would not fit the registers.
  template <int first>
  void project_rows(const MotionColumns& h, const Vector6& w, int j) noexcept {
    auto rows = Tile<3>::zero();
    rows.template accumulate<1, 12, 8, 1>(h.data() + first, &p_[0][j], stride);
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 6
      for (int k = 0; k < 6; ++k) rows.add_scaled(i, w(k), &p_[first_gain + 6 * (first + i) + k][j]);
      if constexpr (Offset) rows.add_scaled(i, 1.0, &p_[first_offset + first + i][j]);
    }
    rows.store(&w_[first][j], stride);
  }

  // S = (H P) H^T + R. A row without a sample becomes one of the identity: it changes nothing else.
  void assemble_innovation_covariance(const MotionColumns& h, const Vector6& w,
                                      const bool (&missing)[12]) noexcept {
    alignas(64) double motion[6][8];
    for (int j = 0; j < 8; j += tile_columns) {
      auto block = Tile<6>::zero();
      block.template accumulate<1, 12, 1, stride>(w_[0], h.data() + j, 8);
      block.store(&motion[0][j], 8);
    }
    Matrix12& s = last_.innovation_covariance;
    for (int j = 0; j < 6; ++j) {
      for (int i = j; i < 6; ++i) {
        double sum = motion[i][j] + settings_.raw_covariance(i, j);
        for (int k = 0; k < 6; ++k) sum += w_[i][first_gain + 6 * j + k] * w(k);
        if constexpr (Offset) sum += w_[i][first_offset + j];
        s(i, j) = s(j, i) = sum;
      }
      for (int i = 0; i < 6; ++i) s(6 + i, j) = s(j, 6 + i) = w_[j][i];
      for (int i = j; i < 6; ++i)
        s(6 + i, 6 + j) = s(6 + j, 6 + i) = w_[6 + i][j] + settings_.twist_covariance(i, j);
    }
    for (int i = 0; i < 12; ++i) {
      if (!missing[i]) continue;
      s.row(i).setZero();
      s.col(i).setZero();
      s(i, i) = 1.0;
    }
  }

  // S = L L^T; false when S is not positive definite. `l` holds L in its lower triangle and nothing of
  // meaning above. Square roots are taken at the end, off the chain of dependent pivots.
  bool factorize(Matrix12& l, Vector12& inverse_pivot) const noexcept {
    l = last_.innovation_covariance;
    for (int j = 0; j < 12; ++j) {
      if (!(l(j, j) > 0.0)) return false;
      const double inverse = 1.0 / l(j, j);
      for (int k = j + 1; k < 12; ++k) l.col(k) -= (l(k, j) * inverse) * l.col(j);
    }
    inverse_pivot = l.diagonal().cwiseSqrt().cwiseInverse();
    for (int j = 0; j < 12; ++j) l.col(j) *= inverse_pivot(j);
    return true;
  }

  // w_ <- L^-1 H P and z_ <- L^-1 innovation.
  void whiten(const Matrix12& l, const Vector12& inverse_pivot, const bool (&missing)[12]) noexcept {
    for (int i = 0; i < 12; ++i) {
      double sum = missing[i] ? 0.0 : last_.innovation(i);
      for (int k = 0; k < i; ++k) sum -= l(i, k) * z_[k];
      z_[i] = inverse_pivot(i) * sum;
      last_.nis += z_[i] * z_[i];
    }
    for (int j = 0; j < stride; j += tile_columns) {
      whiten_rows<0>(l, inverse_pivot, j);
      whiten_rows<4>(l, inverse_pivot, j);
      whiten_rows<8>(l, inverse_pivot, j);
    }
  }

  // Four rows of the forward substitution, in the columns of one tile.
  template <int first>
  void whiten_rows(const Matrix12& l, const Vector12& inverse_pivot, int j) noexcept {
    auto rows = Tile<4>::load(&w_[first][j], stride);
    rows.template accumulate<-1, first, 12, 1>(l.data() + first, &w_[0][j], stride);
    rows.template solve_lower<12>(l.data() + 13 * first, inverse_pivot.data() + first);
    rows.store(&w_[first][j], stride);
  }

  // x <- x + P H^T S^-1 innovation = x + W^T z and P <- P - W^T W, the upper triangle in whole tiles.
  void correct() noexcept {
    for (int j = 0; j < stride; j += tile_columns) {
      auto x = Tile<1>::load(&x_[j], stride);
      x.template accumulate<1, 12, 1, 12>(z_, &w_[0][j], stride);
      x.store(&x_[j], stride);
    }
    for (int i = 0; i < stride; i += 4) {
      int j = i;
      if (j % tile_columns != 0) {
        downdate<Tile<4, 4>>(i, j);
        j += 4;
      }
      for (; j < stride; j += tile_columns) downdate<Tile<4>>(i, j);
    }
  }

  template <typename Block>
  void downdate(int i, int j) noexcept {
    auto block = Block::load(&p_[i][j], stride);
    block.template accumulate<-1, 12, stride, 1>(&w_[0][i], &w_[0][j], stride);
    block.store(&p_[i][j], stride);
  }

  alignas(64) double x_[stride];
  alignas(64) double w_[12][stride];
  alignas(64) double p_[stride][stride];
  Matrix6 jacobian_acceleration_;
  EkfUpdate last_;
  EkfSettings settings_;
  double sign_;
  double z_[12];
  Payload payload_;
};

}  // namespace truewrench
