// The rows of a lag: where theta's parameters stand, what the model predicts at
// a row, and the sums over the rows of an interval. Included by lag.hpp.
#pragma once

#include "truewrench/estimation/lag.hpp"

namespace truewrench {

inline void Lag::carry(const RecordedLog& about) {
  about_ = about;
  layout_ = Layout(rig_, {&about_}, {});
  nt_ = layout_.size();
  const Columns& c = layout_.log(0);
  const auto place = [&c](int i) { return i < 0 ? -1 : c.global[static_cast<std::size_t>(i)]; };
  C_ = place(c.C), b_ = place(c.b), u_ = place(c.u), body_ = place(c.body), slope_ = place(c.slope);
  tilt_ = place(c.tilt), gamma_ = place(c.gamma);
  streams_ = about_.motion.size();
  for (std::size_t i = 0; i < streams_; ++i) {
    clock_[i] = place(c.clock[i]);
    bias_[i] = place(c.bias[i]);
  }
  double g = 0.0;
  for (int i = 0; i < 3; ++i) g += rig_.gravity[i] * rig_.gravity[i];
  gravity_ = g > 0.0 && about_.source != Source::imu;
  dense_.clear();
  for (int k = 0; k < kBodyParameters; ++k) dense_.push_back(body_ + k);
  if (gravity_ && gamma_ >= 0) dense_.insert(dense_.end(), {clock_[0], clock_[0] + 1, gamma_});
  if (gravity_ && tilt_ >= 0) dense_.insert(dense_.end(), {tilt_, tilt_ + 1});
  nd_ = static_cast<int>(dense_.size());
  nf_ = slope_ >= 0 ? 8 : 7;
  theta = layout_.mean();
  products_ = Products(n_, C_, body_, nt_, about_.payload, rig_.range);
  sizes.raw_factor = Eigen::VectorXd::Ones(raw_groups(n_));
  sizes.q = Eigen::VectorXd::Constant(kComponents, constants::smoothness_start);
  sizes.motion_factor.clear();
  for (const MotionStream& m : about_.motion) {
    int groups = 0;
    for (Eigen::Index j = 0; j < m.group.size(); ++j) groups = std::max(groups, m.group[j] + 1);
    sizes.motion_factor.push_back(Eigen::VectorXd::Ones(groups));
  }
  lagged = rig_.nominal;
}

inline void Lag::resize_work() {
  ldt_ = dense::padded(nt_ + 1);
  ld_ = kTheta + ldt_;
  ldx_ = dense::padded(nd_);
  ldp_ = dense::padded(nf_ + n_ + 6 * nd_);
  const auto assign = [](std::vector<double>& v, int size) {
    v.assign(static_cast<std::size_t>(size + 8), 0.0);
  };
  for (Block& b : blocks_) assign(b.panel, kWidth * ld_);
  assign(last_, kWidth * ld_);
  assign(T_, (nt_ + 1) * ldt_);
  assign(phi_, kMostRows * ldp_);
  assign(X_, kMostRows * 6 * ldx_);
  const int left = 2 * kLocal + nf_ + 2 * n_;
  assign(weights_, kMostRows * dense::padded(left));
  assign(G_, left * ldp_);
  assign(left_, 72);
  assign(of_dense_, std::max(kComponents, n_) * ldx_);
  assign(VJ_, 12 * n_);
  assign(slopes_, 6 * n_);
  assign(lagged_, 6 * n_);
  assign(z_, nt_);
  assign(full_, (nt_ + 1) * nt_);
  assign(SV_, 6 * n_);
  assign(XX_, nd_ * ldx_);
  assign(here_, kWidth * kTheta);
  assign(next_, kWidth * kTheta);
  assign(inverse_, kWidth * kTheta);
  assign(V_, 2 * kWidth * kPadded);
  scale_.resize(6);
  for (int r = 0; r < 6; ++r) scale_[static_cast<std::size_t>(r)] = rig_.sign / rig_.range[r];
}

// What rows and blocks need of theta.
inline void Lag::refresh() {
  products_.set(theta.data());
  products_.coordinates(theta.data(), z_.data());
  products_.times(lagged.data(), lagged_.data());
  for (int i = 0; i < 3; ++i) point_[i] = about_.point[i] - products_.centre[i];
  root_ = gravity_ && tilt_ >= 0
              ? tilted(rig_.gravity, Eigen::Vector2d(theta[tilt_], theta[tilt_ + 1]), by_tilt_)
              : rig_.gravity;
  if (!gravity_ || gamma_ < 0) return;
  s_ = theta[clock_[0]];
  kappa_ = theta[clock_[0] + 1];
  late_ = theta[gamma_];
}

// g+ = g + gamma [ s Omega x g + (1 - kappa) s^2 Omega x (Omega x g) + kappa
// s^2 Omegadot x g ]                    (10.5)
inline Vector3 Lag::gravity_of(const RawRow& row) const {
  if (!gravity_) return Vector3::Zero();
  Vector3 g = product(row.R, root_);
  if (late_ == 0.0) return g;
  const Vector3 omega = angular(row.nu), first = cross(omega, g), turn = cross(omega, first),
                spin = cross(angular(row.a), g);
  for (int i = 0; i < 3; ++i)
    g[i] += late_ * (s_ * first[i] + s_ * s_ * ((1.0 - kappa_) * turn[i] + kappa_ * spin[i]));
  return g;
}

// raw = C w + b + u (C_0 w)^2 + slope dT (10.3)
inline void Lag::predict(long g) {
  refresh();
  double xx[2 * kWidth];
  coefficients(g, xx);
  for (int o = 0; o < kBlock; ++o) {
    Interval& v = interval(kBlock * g + o);
    const double* c = xx + kComponents * o;
    for (int r = 0; r < v.rows; ++r) {
      RawRow& row = v.row[static_cast<std::size_t>(r)];
      double x[2 * kComponents] = {};
      for (std::size_t l = 0; l < kLocal; ++l) {
        dense::add<6>(x, row.basis[l], c + kComponents * static_cast<int>(l));
        dense::add<6>(x + 6, row.basis[kLocal + l], c + kComponents * static_cast<int>(l));
      }
      const bool imu = about_.source == Source::imu;  // a_s takes the place of vdot + Omega x v - g
      for (int j = 0; j < 6; ++j) {
        row.nu[j] = imu && j < 3 ? 0.0 : x[j];
        row.a[j] = imu && j < 3 ? x[j] : x[6 + j];
      }
      row.phi = wrench_about(products_.body, point_, row.nu, row.a, gravity_of(row));
      for (int k = 0; k < 6; ++k) row.phi[k] *= scale_[static_cast<std::size_t>(k)];
      for (int k = 0; k < 6; ++k) {
        double sum = 0.0;
        for (int l = 0; l < 6; ++l) sum += products_.B[k][l] * row.phi[l];
        row.w[k] = sum;
      }
      for (int i = 0; i < n_; ++i) {
        const auto iu = static_cast<std::size_t>(i);
        double cw = 0.0, e = row.value[iu] - theta[b_ + i];
        for (int k = 0; k < 6; ++k) {
          cw += lagged(i, k) * row.w[k];
          e -= products_.D[static_cast<std::size_t>(6 * i + k)] * row.phi[k];
        }
        row.cw[iu] = cw;
        e -= theta[u_ + i] * cw * cw;
        if (slope_ >= 0) e -= row.temperature * theta[slope_ + i];
        row.residual[iu] = row.has(i) ? e : 0.0;
      }
    }
  }
}

// d phi (fractions of range) by [x, x'] (6, 12) and by the dense parameters (6,
// ldx), row by row, at one row.
inline void Lag::jacobians(const RawRow& row, double* J, double* X) const {
  MotionJacobian j = motion_jacobian(products_.body, point_, row.nu);
  const BodyJacobian by_body = body_jacobian(products_.body, row.nu, row.a, row.phi);
  for (int c = 0; c < kBodyParameters; ++c)  // the mass and the lever arm are in D: of the centre the point's
                                             // motion alone
    for (int r = 0; r < 6; ++r)
      X[r * ldx_ + c] =
          c == 0 || (c < 4 && r >= 3) ? 0.0 : scale_[static_cast<std::size_t>(r)] * by_body(r, c);
  if (gravity_) {
    int to = kBodyParameters;
    const auto put = [&](const double* x) {  // a parameter of gravity
      for (int r = 0; r < 6; ++r)
        X[r * ldx_ + to] =
            scale_[static_cast<std::size_t>(r)] * (j.g(r, 0) * x[0] + j.g(r, 1) * x[1] + j.g(r, 2) * x[2]);
      ++to;
    };
    const Vector3 g = product(row.R, root_), omega = angular(row.nu), alpha = angular(row.a);
    const double t = s_, kappa = kappa_, gamma = late_;
    if (gamma_ >= 0) {  // of (10.5)
      const Vector3 first = cross(omega, g), turn = cross(omega, first), spin = cross(alpha, g);
      double by[3][3];
      for (int i = 0; i < 3; ++i) {
        const double second = (1.0 - kappa) * turn[i] + kappa * spin[i];
        by[0][i] = gamma * (first[i] + 2.0 * t * second);
        by[1][i] = gamma * t * t * (spin[i] - turn[i]);
        by[2][i] = t * first[i] + t * t * second;
      }
      for (const auto& x : by) put(x);
    }
    for (int c = 0; tilt_ >= 0 && c < 2; ++c) {
      const Vector3 x = product(row.R, Vector3(by_tilt_(0, c), by_tilt_(1, c), by_tilt_(2, c)));
      const Vector3 first = cross(omega, x), turn = cross(omega, first), spin = cross(alpha, x);
      double by[3];
      for (int i = 0; i < 3; ++i)
        by[i] = x[i] + gamma * (t * first[i] + t * t * ((1.0 - kappa) * turn[i] + kappa * spin[i]));
      put(by);
    }
    const Matrix3 turned = cross_matrix(g);
    for (int r = 0; r < 6; ++r)  // to first order in s
      for (int c = 0; c < 3; ++c)
        j.nu(r, 3 + c) -=
            gamma * t * (j.g(r, 0) * turned(0, c) + j.g(r, 1) * turned(1, c) + j.g(r, 2) * turned(2, c));
  }
  const bool imu = about_.source == Source::imu;
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) {
      const double scale = scale_[static_cast<std::size_t>(r)];
      J[r * 12 + c] = scale * (imu && c < 3 ? j.a(r, c) : j.nu(r, c));
      J[r * 12 + 6 + c] = imu && c < 3 ? 0.0 : scale * j.a(r, c);
    }
}

// Rows of (10.3) of one interval, those with the same cells together.
inline void Lag::add_raw(Front& f, Interval& v, const Places& at, SizeSums& sums) {
  v.v.fill(0.0);
  unsigned done[kMostRows];
  int masks = 0, rows_of = 0, largest = -1;
  for (int r = 0; r < v.rows; ++r) {
    const RawRow& row = v.row[static_cast<std::size_t>(r)];
    if (row.masked || std::find(done, done + masks, row.cells) != done + masks) continue;
    int count = 0;
    for (int l = r; l < v.rows; ++l) {
      const RawRow& other = v.row[static_cast<std::size_t>(l)];
      if (!other.masked && other.cells == row.cells) ++count;
    }
    if (count > rows_of) {
      rows_of = count;
      largest = r;
    }
    done[masks++] = row.cells;
  }
  for (int m = 0; m < masks; ++m)  // the traces know the largest of them
    sum_rows(f, v, static_cast<int>(done[m]), done[m] == v.row[static_cast<std::size_t>(largest)].cells, at,
             sums);
}

// Sums over the rows with the cells `same`: one Jacobian, the mean of the
// rows', for H and F alike.
inline void Lag::sum_rows(Front& f, Interval& v, int same, bool keep, const Places& at, SizeSums& sums) {
  const int left_rows = 2 * kLocal + nf_ + 2 * n_, ldw = dense::padded(left_rows);
  double mean[72] = {}, J[72], gradient[2 * kComponents * kLocal] = {}, by_dense[kMostDense] = {};
  std::array<Gram, 3> m;
  for (Gram& x : m) std::fill_n(x.data(), kLocal * kLocal, 0.0);
  Channels information{}, cw_mean{};
  double total = 0.0, all = 0.0;
  int count = 0;
  for (int i = 0; i < n_; ++i)
    if ((same >> i & 1) != 0) information[static_cast<std::size_t>(i)] = 1.0 / (noise(i) * noise(i));
  for (int r = 0; r < v.rows; ++r) {
    RawRow& row = v.row[static_cast<std::size_t>(r)];
    if (row.masked || static_cast<int>(row.cells) != same) continue;
    const double weight = row.weight * row.size;
    double *phi = phi_.data() + count * ldp_, *X = X_.data() + 6 * count * ldx_,
           *left = weights_.data() + count * ldw,
           *vr = left + 2 * kLocal + nf_ + n_;  // less what they weigh
    ++count;
    total += weight;
    all += row.size;
    jacobians(row, J, X);
    for (int c = 0; c < 6; ++c) {
      phi[c] = row.phi[c];
      std::copy_n(X + c * ldx_, nd_, phi + nf_ + n_ + c * nd_);
    }
    phi[6] = 1.0;
    if (slope_ >= 0) phi[7] = row.temperature;
    dense::add(mean, weight, J, 72);
    // J^T V^-1 r
    double y[6] = {}, z[12] = {};
    for (int i = 0; i < n_; ++i) {
      const auto iu = static_cast<std::size_t>(i);
      const double cw = row.cw[iu], x = weight * information[iu] * row.residual[iu];
      phi[nf_ + i] = cw * cw;
      cw_mean[iu] += weight * cw;
      vr[i] = -x;
      dense::add<6>(y, x, products_.D.data() + 6 * i);
      dense::add<6>(y, 2.0 * theta[u_ + i] * cw * x, lagged_.data() + 6 * i);
      const double e = row.residual[iu] / rig_.noise[i];
      const auto group = static_cast<std::size_t>(raw_group(i, n_));
      sums.raw[group] += weight * e * e;
      sums.raw_count[group] += row.has(i) ? 1.0 : 0.0;
    }
    for (int c = 0; c < 6; ++c) {
      dense::add(by_dense, y[c], X + c * ldx_, nd_);
      dense::add(z, y[c], J + 12 * c, 12);
    }
    const double* b = row.basis.data();
    for (int l = 0; l < kLocal; ++l) {
      left[l] = -weight * b[l];
      left[kLocal + l] = -weight * b[kLocal + l];
      dense::add<6>(gradient + kComponents * l, b[l], z);
      dense::add<6>(gradient + kComponents * l, b[kLocal + l], z + 6);
      for (std::size_t pq = 0; pq < 3; ++pq) {  // a column a knot of the second basis
        const double* second = b + (pq == 0 ? 0 : kLocal);
        dense::add<6>(m[pq].data() + kLocal * l, weight * second[l], b + (pq == 2 ? kLocal : 0));
      }
    }
    for (int x = 0; x < nf_ + n_; ++x) left[2 * kLocal + x] = -weight * phi[x];
  }
  if (!(total > 0.0)) return;
  if (v.spared > 0.0)
    for (std::size_t i = 0; i < static_cast<std::size_t>(n_); ++i) {
      const auto group = static_cast<std::size_t>(raw_group(static_cast<int>(i), n_));
      sums.raw[group] +=
          total / all * v.remainder[i] / (rig_.noise[static_cast<int>(i)] * rig_.noise[static_cast<int>(i)]);
      sums.raw_count[group] += v.spared;
    }
  for (double& x : mean) x /= total;
  for (int i = 0; i < n_; ++i)  // d raw / d w
    for (int c = 0; c < 6; ++c) {
      const auto iu = static_cast<std::size_t>(i);
      slopes_[6 * iu + static_cast<std::size_t>(c)] =
          products_.D[6 * iu + static_cast<std::size_t>(c)] +
          2.0 * theta[u_ + i] * (cw_mean[iu] / total) * lagged_[6 * iu + static_cast<std::size_t>(c)];
    }
  dense::subtract(G_.data(), ldp_, weights_.data(), 1, ldw, phi_.data(), ldp_, left_rows, ldp_, count,
                  dense::Mode::fresh);
  // gradient of theta
  for (int i = 0; i < n_; ++i) {
    const double* g = G_.data() + (2 * kLocal + nf_ + n_ + i) * ldp_;
    for (int k = 0; k < 6; ++k) f.T[this->at(C_ + 6 * i + k, nt_)] += g[k];
    f.T[this->at(b_ + i, nt_)] += g[6];
    if (slope_ >= 0) f.T[this->at(slope_ + i, nt_)] += g[7];
    f.T[this->at(u_ + i, nt_)] += g[nf_ + i];
  }
  for (int x = 0; x < nd_; ++x) f.T[this->at(dense_[static_cast<std::size_t>(x)], nt_)] += by_dense[x];
  // (d raw / d w)^T V^-1, its product with d raw / d w, and with the mean
  // Jacobian
  double Q[36] = {}, JC[12 * kMostChannels] = {};
  for (int i = 0; i < n_; ++i)
    for (int c = 0; c < 6; ++c) {
      const double x = slopes_[static_cast<std::size_t>(6 * i + c)],
                   y = x * information[static_cast<std::size_t>(i)];
      SV_[static_cast<std::size_t>(c * n_ + i)] = y;
      dense::add<6>(Q + 6 * c, -y, slopes_.data() + 6 * i);
      dense::add(JC + 12 * i, x, mean + 12 * c, 12);
    }
  std::fill_n(left_.begin(), 72, 0.0);
  for (int h = 0; h < 6; ++h)
    for (int c = 0; c < 6; ++c) dense::add(left_.data() + 12 * h, -Q[6 * h + c], mean + 12 * c, 12);
  std::fill(XX_.begin(), XX_.end(), 0.0);
  double QX[kMostDense];
  for (int r = 0; r < count; ++r) {
    const double *X = X_.data() + 6 * r * ldx_,
                 weight = -weights_[static_cast<std::size_t>(r * ldw + 2 * kLocal + 6)];
    for (int c = 0; c < 6; ++c) {
      std::fill_n(QX, nd_, 0.0);
      for (int h = 0; h < 6; ++h) dense::add(QX, -weight * Q[6 * c + h], X + h * ldx_, nd_);
      for (int y = 0; y < nd_; ++y) dense::add(XX_.data() + y * ldx_, X[c * ldx_ + y], QX, nd_);
    }
  }
  add_band(m, JC, information, at);
  // H_xt
  for (int i = 0; i < n_; ++i)
    for (int j = 0; j < 12; ++j)
      VJ_[static_cast<std::size_t>(j * n_ + i)] = information[static_cast<std::size_t>(i)] * JC[12 * i + j];
  for (int l = 0; l < kLocal; ++l) {
    double* to = at.row[static_cast<std::size_t>(l)] + kTheta;
    for (int p = 0; p < 2; ++p) {
      const double* G = G_.data() + (kLocal * p + l) * ldp_;
      dense::subtract(of_dense_.data(), ldx_, left_.data() + 6 * p, 1, 12, G + nf_ + n_, nd_, kComponents,
                      ldx_, 6, p == 0 ? dense::Mode::fresh : dense::Mode::add);
      for (int j = 0; j < kComponents; ++j) {
        double* row = to + j * ld_;
        const double* a = VJ_.data() + (6 * p + j) * n_;
        for (int i = 0; i < n_; ++i) {
          dense::add<6>(row + C_ + 6 * i, a[i], G);
          row[u_ + i] += a[i] * G[nf_ + i];
        }
        dense::add(row + b_, G[6], a, n_);
        if (slope_ >= 0) dense::add(row + slope_, G[7], a, n_);
      }
    }
    for (int j = 0; j < kComponents; ++j) {
      double* row = to + j * ld_;
      for (int y = 0; y < nd_; ++y)
        row[dense_[static_cast<std::size_t>(y)]] -= of_dense_[static_cast<std::size_t>(j * ldx_ + y)];
      row[nt_] += gradient[kComponents * l + j];
    }
  }
  add_theta(f, information);
  if (!keep) return;
  v.m = std::move(m);
  std::copy_n(JC, 12 * n_, v.J.begin());
  v.v = information;
}

// H_xx: sum over p, q of B^(p)_k B^(q)_l J_p^T V^-1 J_q.
inline void Lag::add_band(const std::array<Gram, 3>& m, const double* J, const Channels& v,
                          const Places& at) {
  double T[4 * 36] = {};
  for (int i = 0; i < n_; ++i)
    for (int p = 0; p < 2; ++p)
      for (int q = 0; q < 2; ++q)
        for (int j = 0; j < 6; ++j)
          dense::add<6>(T + ((2 * p + q) * 6 + j) * 6, v[static_cast<std::size_t>(i)] * J[12 * i + 6 * p + j],
                        J + 12 * i + 6 * q);
  for (int k = 0; k < kLocal; ++k)
    for (int l = k; l < kLocal; ++l) {
      const double x[4] = {m[0](k, l), m[1](k, l), m[1](l, k), m[2](k, l)};
      double* to = at.row[static_cast<std::size_t>(k)] +
                   at.column[static_cast<std::size_t>(k)][static_cast<std::size_t>(l)];
      for (int j = 0; j < 6; ++j)
        for (int pq = 0; pq < 4; ++pq) dense::add<6>(to + j * ld_, x[pq], T + (pq * 6 + j) * 6);
    }
}

// H_tt of the rows of one interval.
inline void Lag::add_theta(Front& f, const Channels& v) {
  const double* F = G_.data() + 2 * kLocal * ldp_;
  const auto tt = [&](int i, int j) -> double& { return f.T[at(i, j)]; };
  for (int x = 0; x < nf_; ++x) {
    dense::subtract(of_dense_.data(), ldx_, SV_.data(), 1, n_, F + x * ldp_ + nf_ + n_, nd_, n_, ldx_, 6,
                    dense::Mode::fresh);
    for (int i = 0; i < n_; ++i) {
      const int column = x < 6 ? C_ + 6 * i + x : (x == 6 ? b_ : slope_) + i;
      for (int y = 0; y < nd_; ++y)
        tt(column, dense_[static_cast<std::size_t>(y)]) -= of_dense_[static_cast<std::size_t>(i * ldx_ + y)];
    }
  }
  for (int i = 0; i < n_; ++i) {
    const double y = v[static_cast<std::size_t>(i)];
    if (y == 0.0) continue;
    const int u = u_ + i;
    int column[8];
    for (int x = 0; x < nf_; ++x) column[x] = x < 6 ? C_ + 6 * i + x : (x == 6 ? b_ : slope_) + i;
    for (int x = 0; x < nf_; ++x) {
      for (int z = x; z < nf_; ++z) tt(column[x], column[z]) += y * F[x * ldp_ + z];
      tt(column[x], u) += y * F[x * ldp_ + nf_ + i];
    }
    const double* U = F + (nf_ + i) * ldp_;
    tt(u, u) += y * U[nf_ + i];
    for (int c = 0; c < 6; ++c)
      for (int z = 0; z < nd_; ++z)
        tt(u, dense_[static_cast<std::size_t>(z)]) +=
            SV_[static_cast<std::size_t>(c * n_ + i)] * U[nf_ + n_ + c * nd_ + z];
  }
  for (int x = 0; x < nd_; ++x)
    for (int y = x; y < nd_; ++y)
      tt(dense_[static_cast<std::size_t>(x)], dense_[static_cast<std::size_t>(y)]) +=
          XX_[static_cast<std::size_t>(x * ldx_ + y)];
}

}  // namespace truewrench
