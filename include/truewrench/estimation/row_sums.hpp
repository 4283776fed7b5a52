// Sums over rows of (10.3) in one interval of knots, and what they add to a pair of blocks and to theta (METHOD 9). Of a row only
// its residual, its gradient and its features are formed; all have one Jacobian, the mean of theirs, for H and F alike: the
// gradient stays exact, so the fixed point does not move.
#pragma once

#include "truewrench/estimation/blocks.hpp"
#include "truewrench/estimation/sizes.hpp"
#include "truewrench/model/parameters.hpp"

#include <algorithm>
#include <array>
#include <vector>

namespace truewrench {

// Places of p <= q among the products of up to three derivatives.
inline constexpr std::size_t order_pair[3][3] = {{0, 1, 3}, {1, 2, 4}, {3, 4, 5}};

// Rows of one interval with the same channels.
struct RawSums {
  Gram m[6];               // [order_pair] sum of weighted products B^(p)_k B^(q)_l, row k, p <= q
  std::vector<double> J;   // (n, orders M) their mean d raw / d (x, x', x'')
  std::vector<double> v;   // (n) 1 / sigma^2, 0 where a channel is missing
  std::vector<double> SV;  // (6, n) (d raw / d w)^T V^-1
  // of a constant wrench in every channel, for scores (10.8)
  std::vector<double> basis;  // (orders, 6) sums of weighted bases
  std::vector<double> phi;    // sum of weighted features
  std::vector<double> z;      // (n) V^-1 r
  double weight = 0.0;
  int samples = 0;
};

class RowSums {
 public:
  int M = 6, n = 6, orders = 2;
  // features of a row, phi: f = [w, 1, temperature, ramps, steps] (nf), which every channel has for itself; (C_0 w)_i^2 (n);
  // d w / d (dense parameters) (6, nd)
  int nf = 7, nd = 10, features = 0, ld = 0, ldx = 16;
  std::vector<int> feature;        // (n, nf): columns of f
  std::vector<int> dense_columns;  // (nd)

  // of the last sum
  std::vector<double> G;   // (6 orders + nf + 2 n, ld) weighted [B, B', (B'') ; f ; (C_0 w)^2 ; V^-1 r]^T phi
  std::vector<double> XX;  // (nd, ldx) sum of X^T Q X
  std::vector<double> left;  // (6, orders M) Q J_w
  std::vector<double> gx;    // (6, M) gradient of the motion
  std::vector<double> gd;    // (6, n) and of the discrepancy

  // Places of theta by `columns`; M components whose splines count with so many derivatives; `gravity`: it is felt.
  void setup(const Columns& columns, int components, int orders_, bool gravity) {
    M = components;
    n = columns.n;
    orders = orders_;
    C_at_ = columns.C;
    u_at_ = columns.u;
    feature.clear();
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < 6; ++k) feature.push_back(columns.C + 6 * i + k);
      feature.push_back(columns.b + i);
      if (columns.slope >= 0) feature.push_back(columns.slope + i);
      for (const int at : columns.ramps) feature.push_back(at + i);
      for (const int at : columns.steps) feature.push_back(at + i);
    }
    nf = static_cast<int>(feature.size()) / n;
    dense_columns.clear();
    for (int k = 0; k < kBodyParameters && columns.body >= 0; ++k) dense_columns.push_back(columns.body + k);
    if (gravity && columns.gamma >= 0)
      dense_columns.insert(dense_columns.end(), {columns.clock[0], columns.clock[0] + 1, columns.gamma});
    if (gravity) dense_columns.insert(dense_columns.end(), {columns.tilt, columns.tilt + 1});
    nd = static_cast<int>(dense_columns.size());
    features = nf + n + 6 * nd;
    ld = dense::padded(features);
    ldx = dense::padded(nd);
    const int left_rows = kLocal * orders + nf + 2 * n;
    ldw_ = dense::padded(left_rows);
    const auto resize = [](std::vector<double>& v, int size) {
      v.resize(static_cast<std::size_t>(size + 8));
    };
    resize(G, left_rows * ld);
    resize(XX, nd * ldx);
    resize(left, 6 * orders * M);
    resize(gx, kLocal * M);
    resize(gd, kLocal * n);
    resize(mean_, 6 * orders * M);
    resize(spread_, 6 * orders * M);
    resize(slope_, 6 * n);
    resize(by_dense_, nd);
    resize(T_, orders * orders * M * M);
    resize(cross_, std::max(M, n) * ldx);
    resize(VJ_, orders * M * n);
  }
  // Memory of so many rows, and of the sums of one interval.
  void reserve(int rows) {
    const auto resize = [](std::vector<double>& v, int size) {
      v.resize(static_cast<std::size_t>(size + 8));
    };
    resize(jacobian_, rows * 6 * orders * M);
    resize(X_, rows * 6 * ldx);
    resize(q_, rows * 6 * ldx);
    resize(phi_, rows * ld);
    resize(weights_, rows * ldw_);
  }
  void reserve(RawSums& out) const {
    const auto size = [](int x) { return static_cast<std::size_t>(x); };
    out.J.resize(size(n * orders * M));
    out.v.resize(size(n));
    out.SV.resize(size(6 * n));
    out.basis.resize(size(kLocal * orders));
    out.phi.resize(size(features));
    out.z.resize(size(n));
  }

  // To be written before a sum, of each of its rows: d w (fractions of range) by [x, x', x''] (6, orders M) and by the dense
  // parameters (6, ldx), row by row.
  double* J(int row) { return jacobian_.data() + row * 6 * orders * M; }
  double* X(int row) { return X_.data() + row * 6 * ldx; }

  // Mean and spread of the Jacobians of rows [first ... first + count), by Welford's recursion; weight(row).
  template <typename Weight>
  void average(int first, int count, const Weight& weight) {
    const int size = 6 * orders * M;
    std::fill_n(mean_.begin(), size, 0.0);
    std::fill_n(spread_.begin(), size, 0.0);
    double *mean = mean_.data(), *spread = spread_.data(), total = 0.0;
    for (int r = first; r < first + count; ++r) {
      const double *of = J(r), w = weight(r), share = w / (total + w), left_share = w * (1.0 - share);
      for (int x = 0; x < size; ++x) {
        const double d = of[x] - mean[x];
        mean[x] += share * d;
        spread[x] += left_share * d * d;
      }
      total += w;
    }
  }
  // (6, orders M) sums of squares about the mean.
  const double* spread() const { return spread_.data(); }

  // Where raw = C w + ... + u (C_0 w)^2 is linearised: (n, 6), (n), (n, 6).
  void at(const double* C, const double* u, const double* lagged) {
    C_ = C;
    u_ = u;
    lagged_ = lagged;
  }

  // A sum over rows from `first` on, once averaged, with information v (n) of their channels.
  void begin(RawSums& out, int first, const double* v) {
    reserve(out);
    std::copy_n(v, n, out.v.begin());
    out.weight = 0.0;
    out.samples = 0;
    for (Gram& m : out.m) std::fill_n(m.data(), kLocal * kLocal, 0.0);
    first_ = first;
    std::fill(gx.begin(), gx.end(), 0.0);
    std::fill(gd.begin(), gd.end(), 0.0);
    std::fill(by_dense_.begin(), by_dense_.end(), 0.0);
    std::fill_n(cw_, n, 0.0);
  }

  // A row: basis (orders, 6); w (6), C_0 w (n) and residuals (n, 0 where a channel is missing) as predicted; further features
  // (nf - 7).
  void add(RawSums& out, double weight, const double* basis, const double* w, const double* cw,
           const double* residual, const double* further) {
    const int r = out.samples;
    const double *own = J(first_ + r), *X_row = X(first_ + r), *v = out.v.data();
    double *phi = phi_.data() + r * ld, *left_row = weights_.data() + r * ldw_,
           *vr = left_row + kLocal * orders + nf + n;  // less what they weigh
    add_bases(out, weight, basis, cw);
    std::copy_n(w, 6, phi);
    phi[6] = 1.0;
    std::copy_n(further, nf - 7, phi + 7);
    for (int c = 0; c < 6; ++c) std::copy_n(X_row + c * ldx, nd, phi + nf + n + c * nd);
    for (int i = 0; i < n; ++i) {
      phi[nf + i] = cw[i] * cw[i];
      vr[i] = -weight * v[i] * residual[i];
    }
    double y[6] = {};
    pull(own, vr, basis, cw, y);
    for (int c = 0; c < 6; ++c) dense::add(by_dense_.data(), y[c], X_row + c * ldx, nd);
    for (int p = 0; p < orders; ++p)
      for (int l = 0; l < kLocal; ++l) {
        const double b = basis[kLocal * p + l];
        left_row[kLocal * p + l] = -weight * b;
        if (p == 0) dense::add(gd.data() + l * n, -b, vr, n);
      }
    for (int x = 0; x < nf + n; ++x) left_row[kLocal * orders + x] = -weight * phi[x];
  }

  void finish(RawSums& out) {
    const int OM = orders * M, count = out.samples, left_rows = kLocal * orders + nf + 2 * n;
    finish_alone(out);
    dense::subtract(G.data(), ld, weights_.data(), 1, ldw_, phi_.data(), ld, left_rows, ld, count,
                    dense::Mode::fresh);
    double Q[36] = {};  // less (d raw / d w)^T V^-1 (d raw / d w)
    for (int i = 0; i < n; ++i) {
      const auto iu = static_cast<std::size_t>(i);
      out.z[iu] = G[static_cast<std::size_t>((kLocal * orders + nf + n + i) * ld + 6)];
      for (int c = 0; c < 6; ++c) {
        const double y = slope_[6 * iu + static_cast<std::size_t>(c)] * out.v[iu];
        out.SV[static_cast<std::size_t>(c * n + i)] = y;
        dense::add<6>(Q + 6 * c, -y, slope_.data() + 6 * i);
      }
    }
    std::fill(left.begin(), left.end(), 0.0);
    for (int h = 0; h < 6; ++h)
      for (int c = 0; c < 6; ++c) dense::add(left.data() + h * OM, -Q[6 * h + c], mean_.data() + c * OM, OM);
    for (int r = 0; r < count; ++r) {
      double weighted[36];
      const double weight = weights_[static_cast<std::size_t>(r * ldw_ + kLocal * orders + 6)];  // less it
      for (int c = 0; c < 36; ++c) weighted[c] = weight * Q[c];
      dense::tile<6>(q_.data() + 6 * r * ldx, ldx, weighted, 6, 1, X(first_ + r), ldx, ldx, 6, nullptr, 0,
                     dense::Mode::fresh);
    }
    dense::subtract(XX.data(), ldx, X(first_), 1, ldx, q_.data(), ldx, nd, ldx, 6 * count,
                    dense::Mode::fresh);
    for (int x = 0; x < kLocal * orders; ++x)
      out.basis[static_cast<std::size_t>(x)] = G[static_cast<std::size_t>(x * ld + 6)];
    std::copy_n(G.data() + (kLocal * orders + 6) * ld, features, out.phi.begin());  // of the feature 1
  }

  // Of the motion alone: in place of add(), with finish_alone().
  void add_motion(RawSums& out, double weight, const double* basis, const double* cw,
                  const double* residual) {
    double vr[max_components], y[6] = {};
    for (int i = 0; i < n; ++i) vr[i] = -weight * out.v[static_cast<std::size_t>(i)] * residual[i];
    pull(J(first_ + out.samples), vr, basis, cw, y);
    add_bases(out, weight, basis, cw);
  }
  void add_gradient(const Places& at, int gradient) const {
    for (int l = 0; l < kLocal; ++l)
      for (int j = 0; j < M; ++j)
        at.row[l][j * at.ld + at.theta + gradient] += gx[static_cast<std::size_t>(l * M + j)];
  }

  // What H_xx is made of, and nothing else: in place of add() and finish().
  void add_bases(RawSums& out, double weight, const double* basis, const double* cw) {
    out.weight += weight;
    ++out.samples;
    for (int i = 0; i < n; ++i) cw_[i] += weight * cw[i];
    for (int p = 0; p < orders; ++p)
      for (int q = p; q < orders; ++q)
        for (int l = 0; l < kLocal; ++l)  // a column a knot of the second basis
          dense::add<6>(out.m[order_pair[p][q]].data() + kLocal * l, weight * basis[kLocal * q + l],
                        basis + kLocal * p);
  }
  void finish_alone(RawSums& out) {
    const int OM = orders * M;
    std::fill(out.J.begin(), out.J.end(), 0.0);
    for (int i = 0; i < n; ++i)
      for (int c = 0; c < 6; ++c) {
        const double x =  // d raw / d w
            slope_[static_cast<std::size_t>(6 * i + c)] =
                C_[6 * i + c] + 2.0 * u_[i] * (cw_[i] / out.weight) * lagged_[6 * i + c];
        dense::add(out.J.data() + i * OM, x, mean_.data() + c * OM, OM);
      }
  }

  // H_xx: sum over p, q of B^(p)_k B^(q)_l J_p^T V^-1 J_q. `fixed`: M where the compiler knows it, else 0.
  template <int fixed>
  void add_band(const RawSums& sums, const Places& at) {
    const int m = fixed > 0 ? fixed : M, OM = orders * m;
    std::fill(T_.begin(), T_.end(), 0.0);  // (orders M, orders M) J^T V^-1 J
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < OM; ++j) {
        const double x = sums.v[static_cast<std::size_t>(i)] * sums.J[static_cast<std::size_t>(i * OM + j)];
        for (int q = 0; q < orders; ++q)
          dense::add<fixed>(T_.data() + j * OM + q * m, x, sums.J.data() + i * OM + q * m, m);
      }
    for (int k = 0; k < kLocal; ++k)
      for (int l = k; l < kLocal; ++l) {
        double x[9];
        for (int p = 0; p < orders; ++p)
          for (int q = 0; q < orders; ++q) {
            const Gram& products = sums.m[order_pair[p][q]];
            x[p * orders + q] = p <= q ? products(k, l) : products(l, k);
          }
        for (int j = 0; j < m; ++j) {
          double* row = at.row[k] + j * at.ld + at.column[k][l];
          const double* T = T_.data() + j * OM;
          if (fixed == 6 && orders == 2) {
            dense::Lane a = *reinterpret_cast<const dense::Lane*>(row);
            dense::Half b = *reinterpret_cast<const dense::Half*>(row + 4);
            for (int pq = 0; pq < 4; ++pq) {
              const double* of = T + (pq >> 1) * m * OM + (pq & 1) * m;
              a += x[pq] * *reinterpret_cast<const dense::Lane*>(of);
              b += x[pq] * *reinterpret_cast<const dense::Half*>(of + 4);
            }
            *reinterpret_cast<dense::Lane*>(row) = a;
            *reinterpret_cast<dense::Half*>(row + 4) = b;
          } else {
            for (int p = 0; p < orders; ++p)
              for (int q = 0; q < orders; ++q)
                dense::add<fixed>(row, x[p * orders + q], T + p * m * OM + q * m, m);
          }
        }
      }
  }

  // H_xt of the last sum, and the motion's gradient.
  template <int fixed>
  void add_cross(const RawSums& sums, const Places& at, int gradient) {
    const int m = fixed > 0 ? fixed : M, OM = orders * m;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < OM; ++j)
        VJ_[static_cast<std::size_t>(j * n + i)] =
            sums.v[static_cast<std::size_t>(i)] * sums.J[static_cast<std::size_t>(i * OM + j)];
    for (int l = 0; l < kLocal; ++l) {
      double* to = at.row[l] + at.theta;
      const double* g[3] = {};
      for (int p = 0; p < orders; ++p) {
        g[p] = G.data() + (kLocal * p + l) * ld;
        dense::subtract(cross_.data(), ldx, left.data() + p * m, 1, OM, g[p] + nf + n, nd, m, ldx, 6,
                        p == 0 ? dense::Mode::fresh : dense::Mode::add);
      }
      for (int j = 0; j < m; ++j) {
        double* row = to + j * at.ld;
        for (int i = 0; i < n; ++i) {
          dense::Lane* first = reinterpret_cast<dense::Lane*>(row + C_at_ + 6 * i);
          dense::Half* last = reinterpret_cast<dense::Half*>(row + C_at_ + 6 * i + 4);
          dense::Lane x = *first;
          dense::Half y = *last;
          for (int p = 0; p < orders; ++p) {
            const double a = VJ_[static_cast<std::size_t>((p * m + j) * n + i)];
            x += a * *reinterpret_cast<const dense::Lane*>(g[p]);
            y += a * *reinterpret_cast<const dense::Half*>(g[p] + 4);
          }
          *first = x;
          *last = y;
        }
        for (int p = 0; p < orders; ++p) {
          const double* a = VJ_.data() + (p * m + j) * n;
          for (int x = 6; x < nf; ++x)
            dense::add_some(row + feature[static_cast<std::size_t>(x)], g[p][x], a, n);
          dense::add(row + u_at_, a, g[p] + nf, n);
        }
      }
      for (int j = 0; j < m; ++j)
        for (int y = 0; y < nd; ++y)
          to[j * at.ld + dense_columns[static_cast<std::size_t>(y)]] -=
              cross_[static_cast<std::size_t>(j * ldx + y)];
    }
    add_gradient(at, gradient);
  }

  // H_tt of the last sum and theta's gradient: to T, laid out by `shape`.
  void add_theta(const RawSums& sums, const Shape& shape, double* T) {
    const double* F = G.data() + kLocal * orders * ld;
    const int* dense_at = dense_columns.data();
    const auto tt = [&](int i, int j) -> double& { return T[shape.tt(i, j)]; };
    for (int x = 0; x < nf; ++x) {
      dense::subtract(cross_.data(), ldx, sums.SV.data(), 1, n, F + x * ld + nf + n, nd, n, ldx, 6,
                      dense::Mode::fresh);
      for (int i = 0; i < n; ++i) {
        const int column = feature[static_cast<std::size_t>(i * nf + x)];
        for (int y = 0; y < nd; ++y) tt(column, dense_at[y]) -= cross_[static_cast<std::size_t>(i * ldx + y)];
      }
    }
    for (int i = 0; i < n; ++i) {
      const double v = sums.v[static_cast<std::size_t>(i)];
      if (v == 0.0) continue;
      const int *f = feature.data() + i * nf, u = u_at_ + i;
      const double *U = F + (nf + i) * ld, *r = F + (nf + n + i) * ld;
      for (int x = 0; x < nf; ++x) {
        for (int y = x; y < nf; ++y) tt(f[x], f[y]) += v * F[x * ld + y];
        tt(f[x], u) += v * F[x * ld + nf + i];
        tt(f[x], shape.nt) += r[x];
      }
      tt(u, u) += v * U[nf + i];
      tt(u, shape.nt) += r[nf + i];
      for (int c = 0; c < 6; ++c) {
        const double x = sums.SV[static_cast<std::size_t>(c * n + i)];
        for (int y = 0; y < nd; ++y) tt(u, dense_at[y]) += x * U[nf + n + c * nd + y];
      }
    }
    for (int x = 0; x < nd; ++x) {
      for (int y = x; y < nd; ++y) tt(dense_at[x], dense_at[y]) += XX[static_cast<std::size_t>(x * ldx + y)];
      tt(dense_at[x], shape.nt) += by_dense_[static_cast<std::size_t>(x)];
    }
  }

  // tr J Sigma J^T / sigma^2 (10.6), to raw[group]: sum over p, q and knots of m_pq(k, l) J_p Cov(x_k, x_l) J_q^T, under interval
  // o of a block with these covariances.
  template <int fixed>
  void trace(const RawSums& sums, const Shape& shape, const double* here, const double* next, int o,
             double* raw) const {
    const int m = fixed > 0 ? fixed : M, OM = orders * m, ldp = 2 * shape.Wp;
    constexpr int most = fixed > 0 ? fixed : max_components;
    for (int p = 0; p < orders; ++p)
      for (int q = p; q < orders; ++q) {
        const Gram& products = sums.m[order_pair[p][q]];
        double U[most * most] = {}, V[most * most] = {};  // of k <= l, and what k > l adds transposed
        for (int k = 0; k < kLocal; ++k)
          for (int l = k; l < kLocal; ++l) {
            const double* cov = shape.covariance(here, next, o + k, o + l);
            const double x = (p == q && k != l ? 2.0 : 1.0) * products(k, l),
                         y = p != q && k != l ? products(l, k) : 0.0;
            for (int j = 0; j < m; ++j)
              for (int h = 0; h < m; ++h) {
                U[j * m + h] += x * cov[j * ldp + h];
                V[j * m + h] += y * cov[j * ldp + h];
              }
          }
        for (int i = 0; i < n; ++i) {
          const double *a = sums.J.data() + i * OM + p * m, *b = sums.J.data() + i * OM + q * m;
          double value = 0.0;
          for (int j = 0; j < m; ++j) {
            double u = 0.0, v = 0.0;
            for (int h = 0; h < m; ++h) {
              u += U[j * m + h] * b[h];
              v += V[j * m + h] * a[h];
            }
            value += a[j] * u + b[j] * v;
          }
          raw[raw_group(i, n)] += (p == q ? 1.0 : 2.0) * sums.v[static_cast<std::size_t>(i)] * value;
        }
      }
  }

 private:
  int C_at_ = 0, u_at_ = 0, ldw_ = 0, first_ = 0;
  const double *C_ = nullptr, *u_ = nullptr, *lagged_ = nullptr;
  double cw_[max_components] = {};  // sum of weighted C_0 w

  // The exact gradient J^T V^-1 r of a row, less V^-1 r given: by the motion to gx, by w to y (6).
  void pull(const double* own, const double* vr, const double* basis, const double* cw, double* y) {
    const int OM = orders * M;
    double z[3 * max_components];
    for (int i = 0; i < n; ++i) {
      dense::add<6>(y, -vr[i], C_ + 6 * i);
      dense::add<6>(y, -2.0 * u_[i] * cw[i] * vr[i], lagged_ + 6 * i);
    }
    std::fill_n(z, OM, 0.0);
    for (int c = 0; c < 6; ++c) dense::add(z, y[c], own + c * OM, OM);
    for (int p = 0; p < orders; ++p)
      for (int l = 0; l < kLocal; ++l)
        dense::add_some(gx.data() + l * M, basis[kLocal * p + l], z + p * M, M);
  }

  // of all rows: J, X, Q X, phi, and the weighted left sides of G
  std::vector<double> jacobian_, X_, q_, phi_, weights_;
  // (6, orders M); d raw / d w (n, 6); theta's gradient by the dense parameters
  std::vector<double> mean_, spread_, slope_, by_dense_;
  std::vector<double> T_, cross_, VJ_;  // work space
};

}  // namespace truewrench
