// What residuals show of a slow discrepancy by moments (METHOD (10.9)), from sums that run along with the rows.
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/math/dense.hpp"
#include "truewrench/math/nodes.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>
#include <vector>

namespace truewrench {

// (10.9) of one group of channels of one log, at the tau of the largest z.
struct Moment {
  double tau = constants::taus[0];
  double delta2 = 0.0;  // delta^2, fraction of range squared
  double sd = 0.0;      // its standard deviation
  double z = 0.0;
};

// What channels of one group say together, tau by tau.
struct MomentTotals {
  static constexpr std::size_t count = std::size(constants::taus);
  std::array<double, count> num{}, t1{}, t2{};  // r^T M K M r, tr M K, tr M K M K
  double nu = 0.0, rss = 0.0;                   // tr M, r^T M r

  Moment best() const {
    Moment out;
    out.z = -std::numeric_limits<double>::infinity();
    if (!(nu > 0.0) || !(rss > 0.0)) return out;
    for (std::size_t t = 0; t < count; ++t) {
      const double top = num[t] - t1[t] * rss / nu, den = t2[t] - t1[t] * t1[t] / nu;
      if (!(den > 1e-9 * t2[t])) continue;  // a record so short that this tau is a constant in it
      const double sd = rss / nu * std::sqrt(2.0 / den), z = sd > 0.0 ? top / den / sd : 0.0;
      if (z > out.z) out = {constants::taus[t], std::max(0.0, top / den), sd, z};
    }
    return out;
  }
};

// (10.9). Z = [w, 1, (C_0 w)_i^2, r_i] of all rows, K the Matern-3/2 correlation. Z^T K Z and Z^T K^2 Z are
// sums over pairs of rows that recursions take as the rows come: with A the part of K before the diagonal and
// D the diagonal, K^2 is (A + D)^T (A + D) + [A (A + D) + its transpose] + A A^T; of each, what a row meets
// is a state that the rows before left and that decays. Residuals may be of a theta since left: X = [w, 1,
// (C_0 w)^2] is projected out at the end, and a change of theta moves them within it.
class MomentSums {
 public:
  // Of channels with samples at the same times.
  explicit MomentSums(int channels = 6)
      : MomentSums(channels, {std::begin(constants::taus), std::end(constants::taus)}, true) {}
  // With K of these taus; `squares`: and K^2, which add_to() asks for, of all.
  MomentSums(int channels, const std::vector<double>& taus, bool squares)
      : n_(channels),
        d_((shared + 2 * channels + 3) & ~3),
        squares_(squares),
        taus_(taus),
        kernels_(taus.size()) {
    const auto d = static_cast<std::size_t>(d_), n = static_cast<std::size_t>(n_);
    ZZ_ = {std::vector<double>(shared * d, 0.0), std::vector<double>(3 * n, 0.0)};
    for (Kernel& k : kernels_) {
      k.KZ = k.KKZ = ZZ_;
      for (auto* v : {&k.a, &k.b, &k.c, &k.d}) v->assign(d, 0.0);
    }
    z_.assign(d, 0.0);
    f_ = q_ = e_ = z_;
  }

  void clear() {
    rows_ = trace_ = 0.0;
    started_ = false;
    ZZ_.clear();
    for (Kernel& k : kernels_) {
      for (auto* m : {&k.KZ, &k.KKZ}) m->clear();
      for (auto* v : {&k.a, &k.b, &k.c, &k.d}) std::fill(v->begin(), v->end(), 0.0);
      k.p0 = k.p1 = k.p2 = k.squares = 0.0;
    }
  }

  // A row of `size` samples: w (6), C_0 w (n), residuals (n). With c the root of size, rows are c Z and K is c_j c_k K_jk.
  void add(double time, double size, const double* w, const double* cw, const double* residual) {
    const double c = std::sqrt(size), c2 = size;
    for (std::size_t k = 0; k < 6; ++k) z_[k] = c * w[k];
    z_[6] = c;
    for (std::size_t i = 0; i < static_cast<std::size_t>(n_); ++i) {
      z_[shared + i] = c * cw[i] * cw[i];
      z_[shared + static_cast<std::size_t>(n_) + i] = c * residual[i];
    }
    const double dt = started_ ? time - time_ : 0.0;
    const int known = shared + n_;  // columns of X: all that is asked of K^2, and of K by spread()
    time_ = time;
    started_ = true;
    add(ZZ_, z_, z_, 0.5, d_);
    rows_ += 1.0;
    trace_ += c2;
    for (std::size_t t = 0; t < kernels_.size(); ++t) {
      Kernel& k = kernels_[t];
      const double x = dt / taus_[t], e = std::exp(-x), ee = e * e;
      k.p2 = ee * (k.p2 + 2.0 * x * k.p1 + x * x * k.p0);
      k.p1 = ee * (k.p1 + x * k.p0);
      k.p0 *= ee;
      const double alpha = k.p0 + k.p1, beta = k.p1 + k.p2;
      k.move(x, e, c, c2, 0.5 * c2 * (alpha + beta), z_.data(), f_.data(), q_.data(), e_.data());
      add(k.KZ, f_, z_, 1.0, squares_ ? d_ : known);
      if (squares_) {
        add(k.KKZ, e_, e_, 0.5, known);
        add(k.KKZ, q_, z_, 1.0, known);
      }
      k.squares += c2 * c2 + 2.0 * c2 * (k.p0 + 2.0 * k.p1 + k.p2);
      k.meet(c, alpha, beta, z_.data(), e_.data());
      k.p0 += c2;
    }
  }

  double rows() const { return rows_; }

  // What a channel adds to its group.
  void add_to(MomentTotals& totals, int i) const {
    double XX[8][8], V[8][8], length[8], Q[8][8] = {};  // an orthonormal basis of X: X Q
    for (int k = 0; k < 8; ++k) length[k] = std::sqrt(std::max(entry(ZZ_, k, k, i), 1e-300));
    for (int k = 0; k < 8; ++k)
      for (int l = 0; l < 8; ++l) XX[k][l] = entry(ZZ_, k, l, i) / (length[k] * length[l]);
    diagonalise(XX, V);
    int rank = 0;
    for (int c = 0; c < 8; ++c) {
      if (!(XX[c][c] > 1e-12)) continue;
      for (int k = 0; k < 8; ++k) Q[k][rank] = V[k][c] / (length[k] * std::sqrt(XX[c][c]));
      ++rank;
    }
    double Qr[8] = {};
    for (int c = 0; c < rank; ++c) {
      for (int k = 0; k < 8; ++k) Qr[c] += Q[k][c] * entry(ZZ_, k, 8, i);
      totals.rss -= Qr[c] * Qr[c];
    }
    totals.rss += entry(ZZ_, 8, 8, i);
    totals.nu += rows_ - rank;
    for (std::size_t t = 0; t < kernels_.size(); ++t) {
      const Kernel& k = kernels_[t];
      double& num = totals.num[t];
      num += entry(k.KZ, 8, 8, i);
      totals.t1[t] += trace_;
      totals.t2[t] += k.squares;
      for (int c = 0; c < rank; ++c) {
        double QKr = 0.0;
        for (int a = 0; a < 8; ++a) QKr += Q[a][c] * entry(k.KZ, a, 8, i);
        num -= 2.0 * Qr[c] * QKr;
        for (int d = 0; d < rank; ++d) {
          double S = 0.0, SS = 0.0;
          for (int a = 0; a < 8; ++a)
            for (int b = 0; b < 8; ++b) {
              S += Q[a][c] * entry(k.KZ, a, b, i) * Q[b][d];
              if (c == d) SS += Q[a][c] * entry(k.KKZ, a, b, i) * Q[b][d];
            }
          num += Qr[c] * S * Qr[d];
          totals.t2[t] += S * S;
          if (c != d) continue;
          totals.t1[t] -= S;
          totals.t2[t] -= 2.0 * SS;
        }
      }
    }
  }

  // Elements of X^T X and X^T K X of a channel, X = [w, 1, (C_0 w)_i^2].
  double product(int i, int k, int l) const { return entry(ZZ_, k, l, i); }
  double correlated(int i, double tau, int k, int l) const {
    const auto at = std::find(taus_.begin(), taus_.end(), tau) - taus_.begin();
    return entry(kernels_[static_cast<std::size_t>(at)].KZ, k, l, i);
  }

  // X^T X and delta^2 X^T K X of [C_i, u_i], added to A and B; the offset, of
  // prior variance `offset`, eliminated; v: 1 / sigma_i^2.
  void spread(int i, double v, double offset, const Moment& m, double (&A)[7][7], double (&B)[7][7]) const {
    double T[7][8] = {};
    const double pivot = v * product(i, 6, 6) + 1.0 / offset;
    for (int k = 0; k < 7; ++k) {
      const int from = k < 6 ? k : 7;
      T[k][from] = 1.0;
      T[k][6] = -v * product(i, from, 6) / pivot;
    }
    for (int k = 0; k < 7; ++k)
      for (int l = 0; l < 7; ++l)
        for (int a = 0; a < 8; ++a)
          for (int b = 0; b < 8; ++b) {
            const double x = T[k][a] * T[l][b];
            if (x == 0.0) continue;
            A[k][l] += x * (v * product(i, a, b) + (a == 6 && b == 6 ? 1.0 / offset : 0.0));
            B[k][l] += x * v * v * m.delta2 * correlated(i, m.tau, a, b);
          }
  }

 private:
  static constexpr int shared = 8;  // places of w, 1 and nothing; then (C_0 w)_i^2 and r_i
  // Symmetric: the rows of what the channels share; of each channel [(C_0 w)^2]^2, (C_0 w)^2 r, r^2.
  struct Products {
    std::vector<double> rows, own;
    void clear() {
      std::fill(rows.begin(), rows.end(), 0.0);
      std::fill(own.begin(), own.end(), 0.0);
    }
  };
  struct Kernel {
    Products KZ, KKZ;
    std::vector<double> a, b, c, d;  // A Z; A applied to (A + D) Z, and A A^T Z
    double p0 = 0.0, p1 = 0.0, p2 = 0.0, squares = 0.0;

    // To the next row, x = dt / tau later: (A Z)_k = c (a + b), a and b the sums of e^-x and x e^-x over the rows before.
    void move(double x, double decay, double root, double size, double own, const double* __restrict z,
              double* __restrict f, double* __restrict q, double* __restrict e) {
      double* __restrict a_ = a.data();
      double* __restrict b_ = b.data();
      double* __restrict c_ = c.data();
      double* __restrict d_ = d.data();
      for (std::size_t i = 0, n = a.size(); i < n; ++i) {
        b_[i] = decay * (b_[i] + x * a_[i]);
        a_[i] *= decay;
        d_[i] = decay * (d_[i] + x * c_[i]);
        c_[i] *= decay;
        const double before = root * (a_[i] + b_[i]);
        q[i] = root * (c_[i] + d_[i]) + own * z[i];
        e[i] = before + size * z[i];
        f[i] = before + 0.5 * size * z[i];
      }
    }
    // What later rows meet.
    void meet(double root, double alpha, double beta, const double* __restrict z,
              const double* __restrict e) {
      double* __restrict a_ = a.data();
      double* __restrict c_ = c.data();
      double* __restrict d_ = d.data();
      for (std::size_t i = 0, n = a.size(); i < n; ++i) {
        a_[i] += root * z[i];
        c_[i] += root * (e[i] + alpha * z[i]);
        d_[i] += root * beta * z[i];
      }
    }
  };
  int n_, d_;
  bool squares_, started_ = false;
  double time_ = 0.0, rows_ = 0.0, trace_ = 0.0;
  Products ZZ_;
  std::vector<double> taus_;
  std::vector<Kernel> kernels_;
  std::vector<double> z_, f_, q_, e_;

  // scale (a b^T + b a^T)
  void add(Products& to, const std::vector<double>& a, const std::vector<double>& b, double scale,
           int columns) const {
    for (std::size_t k = 0; k < 7; ++k) {
      const double x = scale * a[k], y = scale * b[k];
      double* row = to.rows.data() + k * a.size();
      const double *u = a.data(), *v = b.data();
      for (int l = 0; l < columns; l += 4)
        *reinterpret_cast<dense::Lane*>(row + l) += x * *reinterpret_cast<const dense::Lane*>(v + l) +
                                                    y * *reinterpret_cast<const dense::Lane*>(u + l);
    }
    for (std::size_t i = 0, n = static_cast<std::size_t>(n_); i < n; ++i) {
      const std::size_t c = shared + i, r = c + n;
      to.own[i] += 2.0 * scale * a[c] * b[c];
      to.own[n + i] += scale * (a[c] * b[r] + a[r] * b[c]);
      to.own[2 * n + i] += 2.0 * scale * a[r] * b[r];
    }
  }
  // Of channel i: 0 ... 5 w, 6 the constant, 7 (C_0 w)_i^2, 8 the residual.
  double entry(const Products& m, int k, int l, int i) const {
    if (k > l) std::swap(k, l);
    if (k >= 7) return m.own[static_cast<std::size_t>((k + l - 14) * n_ + i)];
    const auto at = static_cast<std::size_t>(l < 7 ? l : shared + (l - 7) * n_ + i);
    return m.rows[static_cast<std::size_t>(k) * static_cast<std::size_t>(d_) + at];
  }
};

}  // namespace truewrench
