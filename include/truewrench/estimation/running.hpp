// Running sums of what left the lag: the moments of (10.9) without a second
// look at the rows, and those of (10.10).
#pragma once

#include "truewrench/estimation/delay.hpp"
#include "truewrench/estimation/discrepancy.hpp"
#include "truewrench/estimation/lag.hpp"
#include "truewrench/estimation/pose.hpp"

#include <array>
#include <cmath>

namespace truewrench {

// (10.9). Z = [w, 1, (C_0 w)_i^2, r_i] of all rows, K the Matern-3/2
// correlation. Z^T K Z and Z^T K^2 Z are sums over pairs of rows that
// recursions take as the rows come: with A the part of K before the diagonal
// and D the diagonal, K^2 is (A + D)^T (A + D) + [A (A + D) + its transpose] +
// A A^T; of each, what a row meets is a state that the rows before left and
// that decays. Residuals may be of a theta since left: X = [w, 1, (C_0 w)^2] is
// projected out at the end, and a change of theta moves them within it.
class MomentSums {
 public:
  explicit MomentSums(int channels = 6) : n_(channels), d_(7 + 2 * channels) {
    const auto d = static_cast<std::size_t>(d_);
    ZZ_.assign(d * d, 0.0);
    for (Kernel& k : kernels_) {
      k.KZ = k.KKZ = ZZ_;
      for (auto* v : {&k.a, &k.b, &k.c, &k.d}) v->assign(d, 0.0);
    }
    z_.assign(d, 0.0);
    f_ = q_ = e_ = z_;
  }

  void clear() {
    std::fill(ZZ_.begin(), ZZ_.end(), 0.0);
    rows_ = trace_ = 0.0;
    started_ = false;
    for (Kernel& k : kernels_) {
      for (auto* v : {&k.KZ, &k.KKZ, &k.a, &k.b, &k.c, &k.d}) std::fill(v->begin(), v->end(), 0.0);
      k.p0 = k.p1 = k.p2 = k.squares = 0.0;
    }
  }

  // A row of `size` samples. With c the root of size, rows are c Z and K is c_j
  // c_k K_jk.
  void add(const RawRow& row) {
    const double c = std::sqrt(row.size), c2 = row.size;
    for (int k = 0; k < 6; ++k) z_[static_cast<std::size_t>(k)] = c * row.w[k];
    z_[6] = c;
    for (std::size_t i = 0; i < static_cast<std::size_t>(n_); ++i) {
      z_[7 + i] = c * row.cw[i] * row.cw[i];
      z_[7 + static_cast<std::size_t>(n_) + i] = c * row.residual[i];
    }
    const double dt = started_ ? row.time - time_ : 0.0;
    time_ = row.time;
    started_ = true;
    outer(ZZ_, z_, z_);
    rows_ += 1.0;
    trace_ += c2;
    for (std::size_t t = 0; t < kernels_.size(); ++t) {
      Kernel& k = kernels_[t];
      const double x = dt / constants::taus[t], e = std::exp(-x), ee = e * e;
      k.p2 = ee * (k.p2 + 2.0 * x * k.p1 + x * x * k.p0);
      k.p1 = ee * (k.p1 + x * k.p0);
      k.p0 *= ee;
      const double alpha = k.p0 + k.p1, beta = k.p1 + k.p2;
      for (std::size_t i = 0; i < z_.size(); ++i) {
        // (A Z)_k = c (a + b), a and b the sums of e^-x and x e^-x over the
        // rows before
        k.b[i] = e * (k.b[i] + x * k.a[i]);
        k.a[i] *= e;
        k.d[i] = e * (k.d[i] + x * k.c[i]);
        k.c[i] *= e;
        f_[i] = c * (k.a[i] + k.b[i]);
        q_[i] = c * (k.c[i] + k.d[i]) + 0.5 * c2 * (alpha + beta) * z_[i];
        e_[i] = f_[i] + c2 * z_[i];
        f_[i] += 0.5 * c2 * z_[i];
      }
      outer(k.KZ, f_, z_);  // halves: made symmetric by found()
      outer(k.KKZ, e_, e_, 0.5);
      outer(k.KKZ, q_, z_);
      k.squares += c2 * c2 + 2.0 * c2 * (k.p0 + 2.0 * k.p1 + k.p2);
      for (std::size_t i = 0; i < z_.size(); ++i) {  // what later rows meet
        k.a[i] += c * z_[i];
        k.c[i] += c * (e_[i] + alpha * z_[i]);
        k.d[i] += c * beta * z_[i];
      }
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
      double XX[8][8], V[8][8], length[8], Q[8][8] = {};  // an orthonormal basis of X: X Q
      for (int k = 0; k < 8; ++k) length[k] = std::sqrt(std::max(entry(ZZ_, k, k, i, false), 1e-300));
      for (int k = 0; k < 8; ++k)
        for (int l = 0; l < 8; ++l) XX[k][l] = entry(ZZ_, k, l, i, false) / (length[k] * length[l]);
      diagonalise(XX, V);
      int rank = 0;
      for (int c = 0; c < 8; ++c) {
        if (!(XX[c][c] > 1e-12)) continue;
        for (int k = 0; k < 8; ++k) Q[k][rank] = V[k][c] / (length[k] * std::sqrt(XX[c][c]));
        ++rank;
      }
      double Qr[8] = {}, r2 = entry(ZZ_, 8, 8, i, false);
      for (int c = 0; c < rank; ++c) {
        for (int k = 0; k < 8; ++k) Qr[c] += Q[k][c] * entry(ZZ_, k, 8, i, false);
        rss -= Qr[c] * Qr[c];
      }
      rss += r2;
      nu += rows_ - rank;
      for (std::size_t t = 0; t < count; ++t) {
        const Kernel& k = kernels_[t];
        num[t] += entry(k.KZ, 8, 8, i, true);  // r^T M K M r
        t1[t] += trace_;                       // tr M K
        t2[t] += k.squares;                    // tr M K M K
        for (int c = 0; c < rank; ++c) {
          double QKr = 0.0;
          for (int a = 0; a < 8; ++a) QKr += Q[a][c] * entry(k.KZ, a, 8, i, true);
          num[t] -= 2.0 * Qr[c] * QKr;
          for (int d = 0; d < rank; ++d) {
            double S = 0.0, SS = 0.0;
            for (int a = 0; a < 8; ++a)
              for (int b = 0; b < 8; ++b) {
                S += Q[a][c] * entry(k.KZ, a, b, i, true) * Q[b][d];
                if (c == d) SS += Q[a][c] * entry(k.KKZ, a, b, i, true) * Q[b][d];
              }
            num[t] += Qr[c] * S * Qr[d];
            t2[t] += S * S;
            if (c != d) continue;
            t1[t] -= S;
            t2[t] -= 2.0 * SS;
          }
        }
      }
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

  // X^T X and delta^2 X^T K X of [C_i, u_i], added to A and B; the offset, of
  // prior variance `offset`, eliminated; v: 1 / sigma_i^2.
  void spread(int i, double v, double offset, const Moment& m, double (&A)[7][7], double (&B)[7][7]) const {
    std::size_t t = 0;
    while (t + 1 < kernels_.size() && constants::taus[t] != m.tau) ++t;
    double T[7][8] = {};
    const double pivot = v * entry(ZZ_, 6, 6, i, false) + 1.0 / offset;
    for (int k = 0; k < 7; ++k) {
      const int from = k < 6 ? k : 7;
      T[k][from] = 1.0;
      T[k][6] = -v * entry(ZZ_, from, 6, i, false) / pivot;
    }
    for (int k = 0; k < 7; ++k)
      for (int l = 0; l < 7; ++l)
        for (int a = 0; a < 8; ++a)
          for (int b = 0; b < 8; ++b) {
            const double x = T[k][a] * T[l][b];
            if (x == 0.0) continue;
            A[k][l] += x * (v * entry(ZZ_, a, b, i, false) + (a == 6 && b == 6 ? 1.0 / offset : 0.0));
            B[k][l] += x * v * v * m.delta2 * entry(kernels_[t].KZ, a, b, i, true);
          }
  }

 private:
  struct Kernel {
    std::vector<double> KZ, KKZ;     // halves: X + X^T
    std::vector<double> a, b, c, d;  // A Z; A applied to (A + D) Z, and A A^T Z
    double p0 = 0.0, p1 = 0.0, p2 = 0.0, squares = 0.0;
  };
  int n_, d_;
  bool started_ = false;
  double time_ = 0.0, rows_ = 0.0, trace_ = 0.0;
  std::vector<double> ZZ_;  // (d, d)
  std::array<Kernel, std::size(constants::taus)> kernels_;
  std::vector<double> z_, f_, q_, e_;

  void outer(std::vector<double>& to, const std::vector<double>& a, const std::vector<double>& b,
             double scale = 1.0) const {
    for (std::size_t k = 0; k < a.size(); ++k)
      dense::add(to.data() + k * a.size(), scale * a[k], b.data(), d_);
  }
  // Of channel i: 0 ... 5 w, 6 the constant, 7 (C_0 w)_i^2, 8 the residual.
  double entry(const std::vector<double>& m, int k, int l, int i, bool half) const {
    const auto place = [&](int x) {
      return static_cast<std::size_t>(x < 7 ? x : x == 7 ? 7 + i : 7 + n_ + i);
    };
    const auto d = static_cast<std::size_t>(d_);
    const double x = m[place(k) * d + place(l)];
    return half ? x + m[place(l) * d + place(k)] : x;
  }
};

// (10.10): w against the pose, the integral of the twist component by
// component, means by stretch.
class PoseSums {
 public:
  void add(const RawRow& row) {
    const double c = row.size, dt = row.time - time_;
    for (int i = 0; i < 6; ++i) {
      if (started_) pose_[i] += 0.5 * dt * (row.nu[i] + nu_[i]);
      if (started_ && !row.masked && dt > 0.0)
        rate_[i] += (row.w[i] - before_[i]) * (row.w[i] - before_[i]) / dt;
      nu_[i] = row.nu[i];
      before_[i] = row.w[i];
    }
    if (started_ && !row.masked && dt > 0.0) rated_ += dt;
    time_ = row.time;
    started_ = true;
    if (row.masked) return;
    now_.rows += c;
    for (int i = 0; i < 6; ++i) {
      w_[i] += c * row.w[i];
      p_[i] += c * pose_[i];
      now_.pp[i] += c * pose_[i] * pose_[i];
      for (int j = 0; j < 6; ++j) {
        now_.ww[i][j] += c * row.w[i] * row.w[j];
        now_.wp[i][j] += c * row.w[i] * pose_[j];
      }
    }
  }

  // What a stretch ends with goes into the whole.
  void end_stretch() {
    fold(all_);
    started_ = false;
    now_ = Whole();
    for (double* v : {pose_, w_, p_}) std::fill_n(v, 6, 0.0);
  }

  PoseShare share() const {
    Whole all = all_;
    fold(all);
    PoseShare out;
    if (all.rows == 0.0) return out;
    double correlation[6][6], V[6][6], size[6], total = 0.0, frequency = 0.0;
    int moving = 0, axes = 0;
    for (int i = 0; i < 6; ++i) size[i] = std::sqrt(std::max(all.centred[i][i], 1e-300));
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j) {
        out.ww(i, j) = all.ww[i][j] / all.rows;
        correlation[i][j] = all.centred[i][j] / (size[i] * size[j]);
      }
    diagonalise(correlation, V);
    for (int j = 0; j < 6; ++j) {
      if (!(std::sqrt(all.pp[j] / all.rows) > 1e-6)) continue;  // components that do not move
      double explained = 0.0;
      for (int i = 0; i < 6; ++i) {
        double b = 0.0;
        for (int k = 0; k < 6; ++k) b += V[k][i] * all.wp[k][j] / size[k];
        if (correlation[i][i] > 1e-12) explained += b * b / correlation[i][i];
      }
      total += std::min(1.0, explained / all.pp[j]);
      ++moving;
    }
    out.moved = moving > 0;
    out.A = moving > 0 ? total / moving : 0.0;
    for (int j = 0; j < 6; ++j) {
      if (!(all.centred[j][j] > 1e-12 * all.rows) || !(rated_ > 0.0)) continue;
      frequency +=
          std::sqrt(rate_[j] / rated_ / (all.centred[j][j] / all.rows)) / (2.0 * 3.14159265358979323846);
      ++axes;
    }
    out.period = axes > 0 && frequency > 0.0 ? axes / frequency : 1.0;
    return out;
  }

 private:
  struct Whole {
    double rows = 0.0, ww[6][6] = {}, centred[6][6] = {}, wp[6][6] = {}, pp[6] = {};
  };
  Whole all_, now_;  // now_: not yet about its means
  bool started_ = false;
  double time_ = 0.0, rated_ = 0.0;
  double nu_[6] = {}, before_[6] = {}, pose_[6] = {}, w_[6] = {}, p_[6] = {}, rate_[6] = {};

  void fold(Whole& all) const {
    if (now_.rows == 0.0) return;
    all.rows += now_.rows;
    for (int i = 0; i < 6; ++i) {
      all.pp[i] += std::max(0.0, now_.pp[i] - p_[i] * p_[i] / now_.rows);
      for (int j = 0; j < 6; ++j) {
        all.ww[i][j] += now_.ww[i][j];
        all.centred[i][j] += now_.ww[i][j] - w_[i] * w_[j] / now_.rows;
        all.wp[i][j] += now_.wp[i][j] - w_[i] * p_[j] / now_.rows;
      }
    }
  }
};

}  // namespace truewrench
