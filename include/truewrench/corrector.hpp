// Raw channels to the true wrench and its uncertainty, sample by sample ([A00] 1-4).
#pragma once

#include "truewrench/math/dense.hpp"
#include "truewrench/sensor.hpp"
#include "truewrench/types.hpp"

#include <cmath>

namespace truewrench {

struct Correction {
  Vector6 wrench;
  Vector6 std;  // 1 sigma
};

// w = G^+ (raw - b). With u = [w; 1] and D = [dG, db] the errors of gain and offset, the wrench is wrong
// by G^+ (e - D u), so each element of its covariance is one of G^+ R G^+^T plus a quadratic form in u.
// The coefficients of the 28 products u_p u_q are fixed by the calibration; configure() forms them once.
template <int N = Eigen::Dynamic>
class Corrector {
 public:
  using Sensor = SensorModel<N>;

  // `covariance`: 7n x 7n, of [gain row by row; offset]. Of each channel, none if empty: `quadratic`, 1 sigma of its
  // departure from linear over the square of its signal, (raw - b)^2; `discrepancy`, 1 sigma of a sample beside the
  // noise, which has no part in the weights. Allocates; step() does not. A failure leaves no calibration, not even an
  // earlier one: what it was replaced for is not to be used in its place.
  Status configure(const Sensor& sensor, const Eigen::Ref<const Eigen::MatrixXd>& covariance,
                   const Eigen::Ref<const Eigen::VectorXd>& quadratic = Eigen::VectorXd(),
                   const Eigen::Ref<const Eigen::VectorXd>& discrepancy = Eigen::VectorXd()) {
    configured_ = false;
    const Eigen::Index n = sensor.gain.rows();
    if (covariance.rows() != 7 * n || covariance.cols() != 7 * n) return Status::wrong_size;
    if (quadratic.size() != 0 && quadratic.size() != n) return Status::wrong_size;
    if (discrepancy.size() != 0 && discrepancy.size() != n) return Status::wrong_size;
    if (!covariance.allFinite() || !quadratic.allFinite() || !discrepancy.allFinite())
      return Status::not_finite;
    if (!dense::is_covariance(covariance)) return Status::not_positive;
    typename Sensor::Inverse inverse;
    if (const Status status = generalised_inverse(sensor, inverse); status != Status::ok) return status;

    sensor_ = sensor;
    quadratic_.setZero(n);
    if (quadratic.size() == n) quadratic_ = quadratic;
    inverse_.setZero(8, n);
    inverse_.template topRows<6>() = inverse;
    // Column 7 k + p of E takes [gain row by row; offset] to element (k, p) of G^+ D.
    Eigen::MatrixXd e = Eigen::MatrixXd::Zero(7 * n, 42);
    for (int k = 0; k < 6; ++k)
      for (Eigen::Index i = 0; i < n; ++i)
        for (int p = 0; p < 7; ++p) e(p < 6 ? 6 * i + p : 6 * n + i, 7 * k + p) = inverse(k, i);
    const Eigen::MatrixXd moments = dense::transposed_times(e, dense::transposed_times(covariance, e));
    Eigen::VectorXd variance = sensor.noise.cwiseAbs2();
    if (discrepancy.size() == n) variance += discrepancy.cwiseAbs2();
    const Matrix6 noise = inverse * variance.asDiagonal() * inverse.transpose();

    deviation_.setZero();
    int pair = 0;
    for (int k = 0; k < 6; ++k) {
      for (int l = k; l < 6; ++l, ++pair) {
        const Eigen::Matrix<double, 7, 7> form = moments.block<7, 7>(7 * k, 7 * l);
        int product = 0;
        for (int p = 0; p < 7; ++p)
          for (int q = p; q < 7; ++q, ++product)
            elements_(pair, product) = p == q ? form(p, p) : form(p, q) + form(q, p);
        elements_(pair, products - 1) += noise(k, l);
        if (k == l) deviation_.row(k) = elements_.row(pair);
      }
    }
    configured_ = true;
    return Status::ok;
  }

  bool configured() const noexcept { return configured_; }
  const typename Sensor::Channels& offset() const { return sensor_.offset; }

  // One sample of the n channels. A value that is not finite, or so large that the wrench has no finite sigma, gives a
  // NaN wrench and not_finite; without a
  // calibration every sample gives a NaN wrench and not_configured, and `raw` is not read.
  Status step(const double* raw, Correction& out) const noexcept {
    if (!configured_) return nothing(out, Status::not_configured);
    Lanes w = Lanes::Zero();
    for (Eigen::Index i = 0; i < sensor_.offset.size(); ++i)
      w += (raw[i] - sensor_.offset(i)) * inverse_.col(i);
    const Products monomials = products_of(w);
    Lanes variance = Lanes::Zero();
    for (int p = 0; p < products; ++p) variance += monomials(p) * deviation_.col(p);
    for (Eigen::Index i = 0; i < sensor_.offset.size(); ++i) {
      const double signal = raw[i] - sensor_.offset(i);
      variance += (quadratic_(i) * signal * signal * inverse_.col(i)).cwiseAbs2();
    }
    out.wrench = w.template head<6>();
    // Rounding can leave a variance that is zero in truth slightly below it.
    out.std = variance.template head<6>().cwiseMax(0.0).cwiseSqrt();
    return out.wrench.allFinite() && out.std.allFinite() ? Status::ok : nothing(out, Status::not_finite);
  }

  // The full covariance of a wrench that step() gave; NaN without a calibration.
  Matrix6 covariance(const Vector6& wrench) const noexcept {
    if (!configured_) return Matrix6::Constant(std::nan(""));
    Lanes w = Lanes::Zero();
    w.template head<6>() = wrench;
    const Eigen::Matrix<double, 21, 1> elements = elements_.lazyProduct(products_of(w));
    Matrix6 c;
    int pair = 0;
    for (int k = 0; k < 6; ++k)
      for (int l = k; l < 6; ++l, ++pair) c(k, l) = c(l, k) = elements(pair);
    for (Eigen::Index i = 0; i < sensor_.offset.size(); ++i) {
      double signal = 0.0;
      for (int j = 0; j < 6; ++j) signal += sensor_.gain(i, j) * wrench(j);
      const Vector6 departure = quadratic_(i) * signal * signal * inverse_.col(i).template head<6>();
      for (int k = 0; k < 6; ++k)
        for (int l = 0; l < 6; ++l) c(k, l) += departure(k) * departure(l);
    }
    return c;
  }

 private:
  static constexpr int products = 28;         // of the elements of u = [w; 1], each pair once
  using Lanes = Eigen::Matrix<double, 8, 1>;  // six values, padded to whole vector registers
  using Products = Eigen::Matrix<double, products, 1>;

  static Status nothing(Correction& out, Status why) noexcept {
    out.wrench.setConstant(std::nan(""));
    out.std.setConstant(std::nan(""));
    return why;
  }

  static Products products_of(const Lanes& w) {
    Lanes u = w;
    u(6) = 1.0;
    Products m;
    int product = 0;
    for (int p = 0; p < 7; ++p)
      for (int q = p; q < 7; ++q, ++product) m(product) = u(p) * u(q);
    return m;
  }

  Sensor sensor_;
  typename Sensor::Channels quadratic_;
  Eigen::Matrix<double, 8, N, Eigen::ColMajor, 8, Sensor::storage> inverse_;
  Eigen::Matrix<double, 8, products> deviation_;
  Eigen::Matrix<double, 21, products> elements_;
  bool configured_ = false;
};

}  // namespace truewrench
