// Running sums of what left the lag: the moments of (10.9) without a second look at the rows, and those of (10.10).
#pragma once

#include "truewrench/estimation/discrepancy.hpp"
#include "truewrench/estimation/lag.hpp"

#include <array>
#include <cmath>

namespace truewrench {

// (10.9). Z = [w, 1, (C_0 w)_i^2, r_i] of all rows; K the Matern-3/2 correlation. Z^T K Z and Z^T K^2 Z are sums over pairs that
// recursions over the rows take: with A the part of K before the diagonal, K^2 = (A + E)(A + E)^T-like products, each of which
// is a recursion on what another one leaves (see add()). Residuals may be of a theta since left: X = [w, 1, (C_0 w)^2] is
// projected out at the end, and a change of theta moves them within it.
class MomentSums {
 public:
  explicit MomentSums(int channels = 6) : n_(channels), d_(7 + 2 * channels) {
    ZZ_ = Eigen::MatrixXd::Zero(d_, d_);
    for (Kernel& k : kernels_) {
      k.KZ = k.KKZ = ZZ_;
      k.a = k.b = k.c = k.d = Eigen::VectorXd::Zero(d_);
    }
    z_ = f_ = q_ = e_ = Eigen::VectorXd::Zero(d_);
  }

  void clear() {
    ZZ_.setZero();
    rows_ = 0.0;
    trace_ = 0.0;
    started_ = false;
    for (Kernel& k : kernels_) {
      k.KZ.setZero();
      k.KKZ.setZero();
      for (Eigen::VectorXd* v : {&k.a, &k.b, &k.c, &k.d}) v->setZero();
      k.p0 = k.p1 = k.p2 = k.squares = 0.0;
    }
  }

  // A row of `size` samples. With c the root of size, rows are c Z and K is c_j c_k K_jk.
  void add(const RawRow& row) {
    const double c = std::sqrt(row.size), c2 = row.size;
    z_ << row.w, 1.0, row.cw.cwiseAbs2(), row.residual;
    z_ *= c;
    const double dt = started_ ? row.time - time_ : 0.0;
    time_ = row.time;
    started_ = true;
    ZZ_.noalias() += z_ * z_.transpose();
    rows_ += 1.0;
    trace_ += c2;
    for (std::size_t t = 0; t < kernels_.size(); ++t) {
      Kernel& k = kernels_[t];
      const double x = dt / constants::taus[t], e = std::exp(-x), ee = e * e;
      // (A Z)_k = c (a + b), a and b the sums of e^-x and x e^-x over the rows before
      k.b = e * (k.b + x * k.a);
      k.a *= e;
      k.d = e * (k.d + x * k.c);
      k.c *= e;
      k.p2 = ee * (k.p2 + 2.0 * x * k.p1 + x * x * k.p0);
      k.p1 = ee * (k.p1 + x * k.p0);
      k.p0 *= ee;
      f_ = c * (k.a + k.b);
      q_ = c * (k.c + k.d);
      const double alpha = k.p0 + k.p1, beta = k.p1 + k.p2;
      e_ = f_ + 0.5 * c2 * z_;
      k.KZ.noalias() += e_ * z_.transpose();  // half: made symmetric by found()
      // K^2 = (A + D)^T (A + D) + [A (A + D) + ...] + A A^T, D the diagonal
      e_ = f_ + c2 * z_;
      k.KKZ.noalias() += 0.5 * e_ * e_.transpose();
      q_ += 0.5 * c2 * (alpha + beta) * z_;
      k.KKZ.noalias() += q_ * z_.transpose();
      k.squares += c2 * c2 + 2.0 * c2 * (k.p0 + 2.0 * k.p1 + k.p2);
      // what later rows meet
      k.a += c * z_;
      k.c += c * (e_ + alpha * z_);
      k.d += (c * beta) * z_;
      k.p0 += c2;
    }
  }

  double rows() const { return rows_; }

  // (10.9) of a group of channels.
  Moment found(int group) const {
    constexpr std::size_t count = std::size(constants::taus);
    std::array<double, count> num{}, t1{}, t2{};
    double nu = 0.0, rss = 0.0;
    for (int i = 0; i < n_; ++i) {
      if (raw_group(i, n_) != group) continue;
      const Matrix8 XX = features(ZZ_, i, false);
      const Vector8 length = XX.diagonal().cwiseSqrt().cwiseMax(1e-300), Xr = against(ZZ_, i, false);
      const Eigen::SelfAdjointEigenSolver<Matrix8> eigen(length.cwiseInverse().asDiagonal() * XX *
                                                         length.cwiseInverse().asDiagonal());
      Matrix8 V = length.cwiseInverse().asDiagonal() * eigen.eigenvectors();  // Q = X V
      int rank = 0;
      for (int c = 0; c < 8; ++c) {
        if (eigen.eigenvalues()[c] > 1e-12) {
          V.col(c) /= std::sqrt(eigen.eigenvalues()[c]);
          ++rank;
        } else {
          V.col(c).setZero();
        }
      }
      const Vector8 Qr = V.transpose() * Xr;
      for (std::size_t t = 0; t < count; ++t) {
        const Kernel& k = kernels_[t];
        const Matrix8 S = V.transpose() * features(k.KZ, i, true) * V,
                      SS = V.transpose() * features(k.KKZ, i, true) * V;
        const Vector8 QKr = V.transpose() * against(k.KZ, i, true);
        num[t] += 2.0 * k.KZ(7 + n_ + i, 7 + n_ + i) - 2.0 * Qr.dot(QKr) + Qr.dot(S * Qr);  // r^T M K M r
        t1[t] += trace_ - S.trace();                                                        // tr M K
        t2[t] += k.squares - 2.0 * SS.trace() + S.squaredNorm();                            // tr M K M K
      }
      nu += rows_ - rank;
      rss += ZZ_(7 + n_ + i, 7 + n_ + i) - Qr.squaredNorm();
    }
    Moment best;
    best.z = -std::numeric_limits<double>::infinity();
    if (!(nu > 0.0) || !(rss > 0.0)) return best;
    for (std::size_t t = 0; t < count; ++t) {
      const double top = num[t] - t1[t] * rss / nu, den = std::max(t2[t] - t1[t] * t1[t] / nu, 1e-300);
      const double sd = rss / nu * std::sqrt(2.0 / den), z = sd > 0.0 ? top / den / sd : 0.0;
      if (z > best.z) best = {constants::taus[t], std::max(0.0, top / den), sd, z};
    }
    return best;
  }

  // X^T X and delta^2 X^T K X of [C_i, u_i] with the offset, of prior variance `offset`, eliminated; v: 1 / sigma_i^2.
  void spread(int i, double v, double offset, const Moment& m, Eigen::Matrix<double, 7, 7>& A,
              Eigen::Matrix<double, 7, 7>& B) const {
    std::size_t t = 0;
    while (t + 1 < kernels_.size() && constants::taus[t] != m.tau) ++t;
    const Matrix8 XX = v * features(ZZ_, i, false),
                  XKX = v * v * m.delta2 * features(kernels_[t].KZ, i, true);
    // order of features(): w, 1, (C_0 w)^2; the offset out
    Eigen::Matrix<double, 7, 8> T = Eigen::Matrix<double, 7, 8>::Zero();
    for (int k = 0; k < 7; ++k) {
      const int at = k < 6 ? k : 7;
      T(k, at) = 1.0;
      T(k, 6) = -XX(at, 6) / (XX(6, 6) + 1.0 / offset);
    }
    Matrix8 with = XX;
    with(6, 6) += 1.0 / offset;
    A = T * with * T.transpose();
    B = T * XKX * T.transpose();
  }

 private:
  using Matrix8 = Eigen::Matrix<double, 8, 8>;
  using Vector8 = Eigen::Matrix<double, 8, 1>;
  struct Kernel {
    Eigen::MatrixXd KZ, KKZ;     // halves: X + X^T
    Eigen::VectorXd a, b, c, d;  // A Z; A applied to (A + D) Z, and A A^T Z
    double p0 = 0.0, p1 = 0.0, p2 = 0.0, squares = 0.0;
  };
  int n_, d_;
  bool started_ = false;
  double time_ = 0.0, rows_ = 0.0, trace_ = 0.0;
  Eigen::MatrixXd ZZ_;
  std::array<Kernel, std::size(constants::taus)> kernels_;
  Eigen::VectorXd z_, f_, q_, e_;

  int place(int k, int i) const { return k < 7 ? k : 7 + i; }
  Matrix8 features(const Eigen::MatrixXd& m, int i, bool half) const {
    Matrix8 out;
    for (int k = 0; k < 8; ++k)
      for (int l = 0; l < 8; ++l)
        out(k, l) =
            half ? m(place(k, i), place(l, i)) + m(place(l, i), place(k, i)) : m(place(k, i), place(l, i));
    return out;
  }
  Vector8 against(const Eigen::MatrixXd& m, int i, bool half) const {
    Vector8 out;
    const int r = 7 + n_ + i;
    for (int k = 0; k < 8; ++k) out[k] = half ? m(place(k, i), r) + m(r, place(k, i)) : m(place(k, i), r);
    return out;
  }
};

// (10.10): w against the pose, the integral of the twist component by component, means by stretch.
class PoseSums {
 public:
  void clear() { *this = PoseSums(); }

  void add(const RawRow& row) {
    const double c = row.size;
    if (started_) pose_ += 0.5 * (row.time - time_) * (row.nu + nu_);
    const double dt = row.time - time_;
    if (started_ && !row.masked && dt > 0.0) {
      rate_ += dt * ((row.w - w_before_) / dt).cwiseAbs2();
      rated_ += dt;
    }
    time_ = row.time;
    nu_ = row.nu;
    w_before_ = row.w;
    started_ = true;
    if (row.masked) return;
    rows_ += c;
    w_ += c * row.w;
    p_ += c * pose_;
    ww_ += c * row.w * row.w.transpose();
    wp_ += c * row.w * pose_.transpose();
    pp_ += c * pose_.cwiseAbs2();
  }

  // What a stretch ends with goes into the whole.
  void end_stretch() {
    fold(*this, all_);
    started_ = false;
    rows_ = 0.0;
    pose_.setZero();
    w_.setZero();
    p_.setZero();
    pp_.setZero();
    ww_.setZero();
    wp_.setZero();
  }

  PoseShare share() const {
    Whole all = all_;
    fold(*this, all);
    PoseShare out;
    if (all.rows == 0.0) return out;
    out.ww = all.ww / all.rows;
    const Vector6 size = all.centred.diagonal().cwiseSqrt().cwiseMax(1e-300);
    const Eigen::SelfAdjointEigenSolver<Matrix6> eigen(size.cwiseInverse().asDiagonal() * all.centred *
                                                       size.cwiseInverse().asDiagonal());
    double total = 0.0, frequency = 0.0;
    int moving = 0, axes = 0;
    for (int j = 0; j < 6; ++j) {
      if (!(std::sqrt(all.pp[j] / all.rows) > 1e-6)) continue;  // components that do not move
      const Vector6 b = eigen.eigenvectors().transpose() * all.wp.col(j).cwiseQuotient(size);
      double explained = 0.0;
      for (int i = 0; i < 6; ++i)
        if (eigen.eigenvalues()[i] > 1e-12) explained += b[i] * b[i] / eigen.eigenvalues()[i];
      total += std::min(1.0, explained / all.pp[j]);
      ++moving;
    }
    out.moved = moving > 0;
    out.A = moving > 0 ? total / moving : 0.0;
    for (int j = 0; j < 6; ++j) {
      if (!(all.centred(j, j) > 1e-12 * all.rows) || !(rated_ > 0.0)) continue;
      frequency +=
          std::sqrt(rate_[j] / rated_ / (all.centred(j, j) / all.rows)) / (2.0 * 3.14159265358979323846);
      ++axes;
    }
    out.period = axes > 0 && frequency > 0.0 ? axes / frequency : 1.0;
    return out;
  }

 private:
  struct Whole {
    double rows = 0.0;
    Matrix6 ww = Matrix6::Zero(), centred = Matrix6::Zero(), wp = Matrix6::Zero();
    Vector6 pp = Vector6::Zero();
  };
  Whole all_;
  bool started_ = false;
  double time_ = 0.0, rows_ = 0.0, rated_ = 0.0;
  Vector6 nu_ = Vector6::Zero(), w_before_ = nu_, pose_ = nu_, w_ = nu_, p_ = nu_, pp_ = nu_, rate_ = nu_;
  Matrix6 ww_ = Matrix6::Zero(), wp_ = Matrix6::Zero();

  static void fold(const PoseSums& s, Whole& all) {
    if (s.rows_ == 0.0) return;
    all.rows += s.rows_;
    all.ww += s.ww_;
    all.centred += s.ww_ - s.w_ * s.w_.transpose() / s.rows_;
    all.wp += s.wp_ - s.w_ * s.p_.transpose() / s.rows_;
    all.pp += (s.pp_ - s.p_.cwiseAbs2() / s.rows_).cwiseMax(0.0);
  }
};

}  // namespace truewrench
