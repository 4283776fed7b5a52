// Coordinates in which information may wait for a later theta: gain and body as
// the products that data tell of.
//
// raw = C w = D phi,  D = C B,  B = L(c) diag(mu, iota),  phi = the wrench of a body of the stated mass, at
// its own centre, of inertia I / iota: a heavier payload and a smaller gain are one D, and what no record can
// tell is a direction in which D stands still, wherever one linearises. In theta itself every lag has another
// such direction, and their difference passes for information. Found on 30 clean records of 8 s (gains
// against `map`; NEES of `map` 1.03): in theta sigma of single gains 0.3 of `map`'s, 0.35 sigma apart (RMS),
// NEES 1.19; with the Jacobians of one theta for all, two records 1 sigma apart, NEES 1.09 (what payloads
// move while data hardly tell, squared); in D 0.95 ... 1.04, 0.08 sigma apart, NEES 0.99.
#pragma once

#include "truewrench/math/dense.hpp"
#include "truewrench/model/parameters.hpp"

#include <array>

namespace truewrench {

class Products {
 public:
  Products() = default;
  // Places in theta of gain (n, 6) and body; range of the wrench axes.
  Products(int channels, int gain_at, int body_at, int parameters, const Payload& stated,
           const Vector6& range)
      : n_(channels), C_(gain_at), body_(body_at), nt_(parameters), stated_(stated) {
    for (int i = 0; i < 6; ++i) range_[i] = range[i];
    trace_ = stated.inertia(0, 0) + stated.inertia(1, 1) + stated.inertia(2, 2);
    D.assign(static_cast<std::size_t>(6 * n_), 0.0);
  }

  // D, B and the body of phi at a theta.
  void set(const double* theta) {
    BodyVector by;
    std::copy_n(theta + body_, kBodyParameters, by.data());
    const Payload now = departed(stated_, by);
    mu_ = std::exp(by[0]);
    iota_ = trace_ > 0.0 ? 1.0 + (by[4] + by[5] + by[6]) / trace_ : 1.0;
    const Matrix3 lever = cross_matrix(now.center_of_mass);
    std::fill_n(B[0], 36, 0.0);
    for (int i = 0; i < 3; ++i) {
      B[i][i] = mu_;
      B[3 + i][3 + i] = iota_;
      for (int j = 0; j < 3; ++j) B[3 + i][j] = mu_ * lever(i, j) * range_[j] / range_[3 + i];
    }
    centre = now.center_of_mass;
    body.mass = stated_.mass;
    body.center_of_mass = Vector3::Zero();
    for (int i = 0; i < 9; ++i) body.inertia.data()[i] = now.inertia.data()[i] / iota_;
    times(theta + C_, D.data());
  }
  // Rows (n, 6) times B.
  void times(const double* rows, double* out) const {
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j < 6; ++j) {
        double sum = 0.0;
        for (int k = 0; k < 6; ++k) sum += rows[6 * i + k] * B[k][j];
        out[6 * i + j] = sum;
      }
  }

  // theta with D in place of C, the body's mass without effect, its inertia that of phi, less the stated.
  void coordinates(const double* theta, double* z) const {
    std::copy_n(theta, nt_, z);
    std::copy_n(D.data(), 6 * n_, z + C_);
    z[body_] = 0.0;
    for (int k = 0; k < 6; ++k) z[body_ + 4 + k] = element(body.inertia, k) - element(stated_.inertia, k);
  }

  // Information on theta, to first order at it, from that on the coordinates: both (nt + 1, nt + 1), lower
  // triangles, the information vector in the last row; full (nt, padded(nt + 1)): work space.
  void pull(const Eigen::MatrixXd& from, const double* theta, const double* z, Eigen::MatrixXd& to,
            std::vector<double>& full) const {
    const int ld = dense::padded(nt_ + 1);
    full.resize(static_cast<std::size_t>(ld * nt_));
    const auto column = [&](int j) { return full.data() + j * ld; };
    for (int j = 0; j < nt_; ++j) {
      for (int i = 0; i < j; ++i) column(j)[i] = column(i)[j];
      std::copy_n(from.data() + j * (nt_ + 1) + j, nt_ + 1 - j, column(j) + j);
      std::fill(column(j) + nt_ + 1, column(j) + ld, 0.0);
    }
    for (int j = 0; j < nt_; ++j) column(j)[nt_] -= dense::dot(column(j), z, nt_);  // the gradient at z
    columns(theta, full.data(), ld);  // S G, and of the gradient
    for (int j = 0; j < nt_; ++j) {
      to(nt_, j) = column(j)[nt_];
      for (int i = 0; i < j; ++i) std::swap(column(j)[i], column(i)[j]);
    }
    columns(theta, full.data(), ld);  // G^T S G
    for (int j = 0; j < nt_; ++j) {
      to(nt_, j) += dense::dot(column(j), theta, nt_);
      std::copy(column(j) + j, column(j) + nt_, to.data() + j * (nt_ + 1) + j);
    }
  }

  Payload body;                      // of phi
  Vector3 centre = Vector3::Zero();  // c
  double B[6][6] = {};
  std::vector<double> D;  // (n, 6)

 private:
  int n_ = 6, C_ = 0, body_ = 0, nt_ = 0;
  Payload stated_;
  double range_[6] = {}, trace_ = 0.0, mu_ = 1.0, iota_ = 1.0;

  static double element(const Matrix3& m, int k) {
    constexpr int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};
    return m(row[k], column[k]);
  }

  // X <- X G, G the derivative of the coordinates by theta; X (ld, nt), column by column, four rows at a time.
  void columns(const double* theta, double* x, int ld) const {
    using dense::Lane;
    const double* C = theta + C_;
    for (int r = 0; r < ld; r += 4) {
      const auto at = [&](int c) -> Lane& { return *reinterpret_cast<Lane*>(x + c * ld + r); };
      Lane by[kBodyParameters] = {};  // of the body, through D and through its own coordinates
      for (int i = 0; i < n_; ++i) {
        const double* D_row = D.data() + 6 * i;
        Lane d[6], f[3];  // f: what the lever arm sees: of C's moments, by forces
        for (int k = 0; k < 6; ++k) d[k] = at(C_ + 6 * i + k);
        for (int j = 0; j < 3; ++j) f[j] = mu_ * range_[j] * d[j];
        double m[3];
        for (int k = 0; k < 3; ++k) m[k] = C[6 * i + 3 + k] / range_[3 + k];
        for (int k = 0; k < 3; ++k) {
          by[0] += D_row[k] * d[k];
          if (trace_ > 0.0) by[4] += C[6 * i + 3 + k] / trace_ * d[3 + k];
        }
        // sum of m_a [e_k]_ab f_b = e_k . (f x m)
        by[1] += m[2] * f[1] - m[1] * f[2];
        by[2] += m[0] * f[2] - m[2] * f[0];
        by[3] += m[1] * f[0] - m[0] * f[1];
        for (int k = 0; k < 6; ++k) {
          Lane c = {};
          for (int j = 0; j < 6; ++j) c += B[k][j] * d[j];
          at(C_ + 6 * i + k) = c;
        }
      }
      by[5] = by[6] = by[4];
      Lane along = {};  // of iota in I / iota
      for (int k = 0; k < 6; ++k) along += element(body.inertia, k) * at(body_ + 4 + k);
      at(body_) = by[0];
      for (int k = 0; k < 3; ++k) at(body_ + 1 + k) += by[1 + k];
      for (int k = 0; k < 6; ++k) {
        at(body_ + 4 + k) = at(body_ + 4 + k) / iota_ + by[4 + k];
        if (k < 3 && trace_ > 0.0) at(body_ + 4 + k) -= along / (iota_ * trace_);
      }
    }
  }
};

}  // namespace truewrench
