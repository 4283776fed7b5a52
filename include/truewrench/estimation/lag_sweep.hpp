// The blocks of a lag: what they predict, their elimination, the way back and the traces. Included by lag.hpp.
#pragma once

#include "truewrench/estimation/lag.hpp"

namespace truewrench {

// raw = C w + b + u (C_0 w)^2 + slope dT                                                                        (10.3)
inline void Lag::predict(long g) {
  model();
  PairVector xx;
  xx << block(g).x, block(g + 1).x;
  for (int o = 0; o < kBlock; ++o) {
    Interval& v = interval(kBlock * g + o);
    const Eigen::Map<const Gram> local(xx.data() + kComponents * o);
    for (int r = 0; r < v.rows; ++r) {
      RawRow& row = v.row[static_cast<std::size_t>(r)];
      const Vector6 x0 = local * row.b0, x1 = local * row.b1;
      if (about_.source == Source::twist) {
        row.nu = x0;
        row.a = x1;
      } else {  // IMU: a_s takes the place of vdot + Omega x v - g
        row.nu << Vector3::Zero(), x0.tail<3>();
        row.a << x0.head<3>(), x1.tail<3>();
      }
      row.g.setZero();
      if (gravity_) {
        row.g = row.R * root_;
        // g+ = g + gamma [ s Omega x g + (1 - kappa) s^2 Omega x (Omega x g) + kappa s^2 Omegadot x g ]           (10.5)
        if (gamma_ >= 0) {
          const double s = theta[clock_[0]], kappa = theta[clock_[0] + 1];
          const Vector3 omega = row.nu.tail<3>(), first = omega.cross(row.g);
          row.g += theta[gamma_] *
                   (s * first +
                    s * s * ((1.0 - kappa) * omega.cross(first) + kappa * row.a.tail<3>().cross(row.g)));
        }
      }
      row.w = scale_.cwiseProduct(wrench_about(payload_, about_.point, row.nu, row.a, row.g));
      row.cw.noalias() = lagged.lazyProduct(row.w);
      for (int i = 0; i < n_; ++i) {
        double e =
            row.value[i] - gain_.row(i).dot(row.w) - theta[b_ + i] - theta[u_ + i] * row.cw[i] * row.cw[i];
        if (slope_ >= 0) e -= row.temperature * theta[slope_ + i];
        row.residual[i] = row.have[i] * e;
      }
    }
  }
}

// d w (fractions of range) by [x, x'] and by the dense parameters, at one row.
inline void Lag::jacobians(const RawRow& row, Wrenches& J, Dense& X) const {
  const Vector6 w = row.w.cwiseQuotient(scale_);
  MotionJacobian j = motion_jacobian(payload_, about_.point, row.nu);
  X.resize(6, nd_);
  X.leftCols<kBodyParameters>() = body_jacobian(payload_, row.nu, row.a, w);
  int at = kBodyParameters;
  if (gravity_) {
    const Vector3 g = row.R * root_, omega = row.nu.tail<3>(), alpha = row.a.tail<3>();
    Matrix3 late = Matrix3::Identity();  // d g+ / d g
    if (gamma_ >= 0) {                   // of (10.5)
      const double t = theta[clock_[0]], kappa = theta[clock_[0] + 1], gamma = theta[gamma_];
      const Vector3 first = omega.cross(g), turn = omega.cross(first), spin = alpha.cross(g);
      const Vector3 second = (1.0 - kappa) * turn + kappa * spin;
      X.col(at) = j.g * (gamma * (first + 2.0 * t * second));
      X.col(at + 1) = j.g * (gamma * t * t * (spin - turn));
      X.col(at + 2) = j.g * (t * first + t * t * second);
      at += 3;
      const Matrix3 O = cross_matrix(omega);
      late += gamma * (t * O + t * t * ((1.0 - kappa) * O * O + kappa * cross_matrix(alpha)));
      j.nu.rightCols<3>() -= gamma * t * j.g * cross_matrix(g);  // to first order in s
    }
    if (tilt_ >= 0) X.middleCols<2>(at) = j.g * (late * (row.R * by_tilt_));
  }
  if (about_.source == Source::twist) {
    J << j.nu, j.a;
  } else {
    J << j.a.leftCols<3>(), j.nu.rightCols<3>(), Matrix6::Zero().leftCols<3>(), j.a.rightCols<3>();
  }
  for (int r = 0; r < 6; ++r) {
    J.row(r) *= scale_[r];
    X.row(r) *= scale_[r];
  }
}

// (10.1): c^T R c / q.
inline void Lag::add_smoothness(long g, const PairVector& xx, SizeSums& sums) {
  static_cast<void>(g);
  for (int j = 0; j < kComponents; ++j) {
    const Gram R = smoothness(j);
    const double v = 1.0 / sizes.q[j];
    for (int o = 0; o < kBlock; ++o) {
      const Eigen::Map<const Gram> local(xx.data() + kComponents * o);
      const Basis x = local.row(j).transpose(), pull = R * x;
      sums.energy[j] += x.dot(pull);
      for (int k = 0; k < kLocal; ++k) {
        F_(kComponents * (o + k) + j, nt_) -= v * pull[k];
        for (int l = 0; l <= k; ++l) H_(kComponents * (o + k) + j, kComponents * (o + l) + j) += v * R(k, l);
      }
    }
  }
  sums.knots += kBlock;
}

// Rows of (10.4).
inline void Lag::add_motion(Front& f, long g, bool last, const PairVector& xx, SizeSums& sums) {
  for (std::size_t i = 0; i < streams_; ++i) {
    const MotionStream& stream = about_.motion[i];
    Vector6 v;
    for (int j = 0; j < 6; ++j) v[j] = 1.0 / (motion_noise(i, j) * motion_noise(i, j));
    for (int o = 0; o < kBlock; ++o) interval(kBlock * g + o).motion[i].setZero();
    const int s_at = clock_[i];
    Placed at;
    for (; f.next[i] < motion_[i].end(); ++f.next[i]) {
      const MotionRow& row = motion_[i][f.next[i]];
      if (!placed(i, row, g, last, xx, at)) break;
      const Eigen::Map<const Gram> local(xx.data() + kComponents * at.o);
      const Vector6 by_s = local * at.by_s, by_kappa = local * at.by_kappa;
      const Gram bb = row.size * at.b * at.b.transpose();
      interval(kBlock * g + at.o).motion[i] += bb * (row.have.sum() / 6.0);
      const int base = kComponents * at.o;
      for (int j = 0; j < kComponents; ++j) {
        if (row.have[j] == 0.0) continue;
        const int group = stream.group[j];
        const double stated = 1.0 / (stream.sigma[j] * stream.sigma[j]);
        sums.motion[i][group] += stated * (row.size * at.residual[j] * at.residual[j] + row.remainder[j]);
        sums.motion_count[i][group] += 1.0 + row.spared;
        const double y = row.size * v[j], r = y * at.residual[j];
        for (int k = 0; k < kLocal; ++k) {
          const int to = base + kComponents * k + j;
          F_(to, nt_) += at.b[k] * r;
          F_(to, s_at) += y * at.b[k] * by_s[j];
          F_(to, s_at + 1) += y * at.b[k] * by_kappa[j];
          if (bias_[i] >= 0) F_(to, bias_[i] + j) += y * at.b[k];
          for (int l = 0; l <= k; ++l) H_(to, base + kComponents * l + j) += v[j] * bb(k, l);
        }
        f.T(s_at, s_at) += y * by_s[j] * by_s[j];
        f.T(s_at + 1, s_at) += y * by_s[j] * by_kappa[j];
        f.T(s_at + 1, s_at + 1) += y * by_kappa[j] * by_kappa[j];
        f.T(nt_, s_at) += r * by_s[j];
        f.T(nt_, s_at + 1) += r * by_kappa[j];
        if (bias_[i] < 0) continue;
        const int b = bias_[i] + j;
        f.T(b, b) += y;
        f.T(nt_, b) += r;
        f.T(std::max(b, s_at), std::min(b, s_at)) += y * by_s[j];
        f.T(std::max(b, s_at + 1), std::min(b, s_at + 1)) += y * by_kappa[j];
      }
    }
  }
}

// Rows of (10.3) of one interval: one Jacobian, the mean of its rows', for H and F alike; the gradient is exact.
inline void Lag::add_raw(Front& f, Interval& v, int o, SizeSums& sums) {
  v.m00.setZero();
  v.m01.setZero();
  v.m11.setZero();
  double total = 0.0, all = 0.0;
  for (int i = 0; i < n_; ++i) v.v[i] = 1.0 / (noise(i) * noise(i));
  Wrenches mean = Wrenches::Zero(), J;
  Channels cw_mean = Channels::Zero(n_), vr(n_), have = Channels::Zero(n_);
  const int base = kComponents * o;
  for (int r = 0; r < v.rows; ++r) {
    RawRow& row = v.row[static_cast<std::size_t>(r)];
    if (row.masked) continue;
    const double weight = row.weight * row.size;
    Dense& X = X_[static_cast<std::size_t>(r)];
    jacobians(row, J, X);
    mean += weight * J;
    cw_mean += weight * row.cw;
    have += weight * row.have;
    total += weight;
    all += row.size;
    for (int i = 0; i < n_; ++i) {
      const double e = row.residual[i] / rig_.noise[i];
      sums.raw[raw_group(i, n_)] += weight * e * e;
      sums.raw_count[raw_group(i, n_)] += row.have[i];
    }
    // J^T V^-1 r
    vr = weight * v.v.cwiseProduct(row.residual);
    Vector6 y = Vector6::Zero();
    for (int i = 0; i < n_; ++i) {
      y += vr[i] * gain_.row(i).transpose();
      const double bend = 2.0 * theta[u_ + i] * row.cw[i] * vr[i];
      y += bend * lagged.row(i).transpose();
      f.T(nt_, u_ + i) += vr[i] * row.cw[i] * row.cw[i];
    }
    const Vector6 z0 = J.leftCols<6>().transpose() * y, z1 = J.rightCols<6>().transpose() * y;
    for (int k = 0; k < kLocal; ++k)
      F_.col(nt_).segment<6>(base + kComponents * k) += row.b0[k] * z0 + row.b1[k] * z1;
    v.m00 += weight * row.b0 * row.b0.transpose();
    v.m01 += weight * row.b0 * row.b1.transpose();
    v.m11 += weight * row.b1 * row.b1.transpose();
    for (int x = 0; x < nd_; ++x) f.T(nt_, dense_[static_cast<std::size_t>(x)]) += X.col(x).dot(y);
  }
  if (total <= 0.0) {
    v.v.setZero();
    return;
  }
  if (v.spared > 0.0)
    for (int i = 0; i < n_; ++i) {
      sums.raw[raw_group(i, n_)] += total / all * v.remainder[i] / (rig_.noise[i] * rig_.noise[i]);
      sums.raw_count[raw_group(i, n_)] += v.spared;
    }
  mean /= total;
  cw_mean /= total;
  v.v = v.v.cwiseProduct(have / total);  // of what cells are there
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::ColMajor, kMostChannels, 6> slope(n_, 6);  // d raw / d w
  for (int i = 0; i < n_; ++i) slope.row(i) = gain_.row(i) + 2.0 * theta[u_ + i] * cw_mean[i] * lagged.row(i);
  v.J = slope.lazyProduct(mean);
  Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::ColMajor, 6, kMostChannels> SV(6, n_);
  for (int i = 0; i < n_; ++i) SV.col(i) = v.v[i] * slope.row(i).transpose();
  const Matrix6 Q = SV.lazyProduct(slope);
  // H_xx, lower triangle
  const Matrix6 T00 = mean.leftCols<6>().transpose() * (Q * mean.leftCols<6>()),
                T01 = mean.leftCols<6>().transpose() * (Q * mean.rightCols<6>()), T10 = T01.transpose(),
                T11 = mean.rightCols<6>().transpose() * (Q * mean.rightCols<6>());
  for (int k = 0; k < kLocal; ++k)
    for (int l = 0; l <= k; ++l)
      H_.block<6, 6>(base + kComponents * k, base + kComponents * l) +=
          v.m00(k, l) * T00 + v.m01(k, l) * T01 + v.m01(l, k) * T10 + v.m11(k, l) * T11;
  add_raw_theta(f, v, o, mean, SV, Q);
}

// H_xt and H_tt of the rows of one interval.
inline void Lag::add_raw_theta(
    Front& f, const Interval& v, int o, const Wrenches& mean,
    const Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::ColMajor, 6, kMostChannels>& SV, const Matrix6& Q) {
  Eigen::Matrix<double, 8, 8> FF = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> x;
  Eigen::Matrix<double, kLocal, 8> BF0 = Eigen::Matrix<double, kLocal, 8>::Zero(), BF1 = BF0;
  Eigen::Matrix<double, 8, Eigen::Dynamic, Eigen::ColMajor, 8, kMostChannels> FU(8, n_);
  Eigen::Matrix<double, kLocal, Eigen::Dynamic, Eigen::ColMajor, kLocal, kMostChannels> BU0(kLocal, n_),
      BU1(kLocal, n_);
  Channels UU = Channels::Zero(n_), cw2(n_);
  FU.setZero();
  BU0.setZero();
  BU1.setZero();
  const int flat = 6 * nd_;
  auto FX = FX_.topRows(flat);
  auto UX = UX_.topRows(flat);
  FX.setZero();
  UX.setZero();
  for (auto& b : BX_) b.topRows(flat).setZero();
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMostDense, kMostDense> XX(nd_, nd_);
  XX.setZero();
  Dense QX(6, nd_);
  for (int r = 0; r < v.rows; ++r) {
    const RawRow& row = v.row[static_cast<std::size_t>(r)];
    if (row.masked) continue;
    const double weight = row.weight * row.size;
    x << row.w, 1.0, row.temperature;
    cw2 = row.cw.cwiseAbs2();
    const Dense& X = X_[static_cast<std::size_t>(r)];
    const Eigen::Map<const DenseFlat> all(X.data(), flat);
    FF += weight * x * x.transpose();
    BF0 += (weight * row.b0) * x.transpose();
    BF1 += (weight * row.b1) * x.transpose();
    for (int i = 0; i < n_; ++i) {
      const double wu = weight * cw2[i];
      FU.col(i) += wu * x;
      BU0.col(i) += wu * row.b0;
      BU1.col(i) += wu * row.b1;
      UU[i] += wu * cw2[i];
      UX.col(i) += wu * all;
      const double y = v.v[i] > 0.0 ? weight * row.residual[i] / (noise(i) * noise(i)) : 0.0;
      for (int k = 0; k < 6; ++k) f.T(nt_, C_ + 6 * i + k) += y * row.w[k];
      f.T(nt_, b_ + i) += y;
      if (slope_ >= 0) f.T(nt_, slope_ + i) += y * row.temperature;
    }
    for (int k = 0; k < nf_; ++k) FX.col(k) += (weight * x[k]) * all;
    for (int l = 0; l < kLocal; ++l) {
      BX_[0].col(l).head(flat) += (weight * row.b0[l]) * all;
      BX_[1].col(l).head(flat) += (weight * row.b1[l]) * all;
    }
    QX.noalias() = (weight * Q).lazyProduct(X);
    XX.noalias() += X.transpose().lazyProduct(QX);
  }
  // H_xt
  const Matrix6 left0 = mean.leftCols<6>().transpose() * Q, left1 = mean.rightCols<6>().transpose() * Q;
  for (int l = 0; l < kLocal; ++l) {
    const int at = kComponents * (o + l);
    for (int i = 0; i < n_; ++i) {
      const Vector6 j0 = v.v[i] * v.J.row(i).head<6>().transpose(),
                    j1 = v.v[i] * v.J.row(i).tail<6>().transpose();
      F_.block<6, 6>(at, C_ + 6 * i) += j0 * BF0.row(l).head<6>() + j1 * BF1.row(l).head<6>();
      F_.col(b_ + i).segment<6>(at) += BF0(l, 6) * j0 + BF1(l, 6) * j1;
      F_.col(u_ + i).segment<6>(at) += BU0(l, i) * j0 + BU1(l, i) * j1;
      if (slope_ >= 0) F_.col(slope_ + i).segment<6>(at) += BF0(l, 7) * j0 + BF1(l, 7) * j1;
    }
    const Eigen::Map<const Dense> X0(BX_[0].col(l).data(), 6, nd_), X1(BX_[1].col(l).data(), 6, nd_);
    for (int y = 0; y < nd_; ++y)
      F_.col(dense_[static_cast<std::size_t>(y)]).segment<6>(at) += left0 * X0.col(y) + left1 * X1.col(y);
  }
  // H_tt, lower triangle
  const auto add = [&f](int a, int b, double y) { f.T(std::max(a, b), std::min(a, b)) += y; };
  for (int i = 0; i < n_; ++i) {
    const double y = v.v[i];
    for (int k = 0; k < 6; ++k)
      for (int l = 0; l <= k; ++l) f.T(C_ + 6 * i + k, C_ + 6 * i + l) += y * FF(k, l);
    for (int k = 0; k < 6; ++k) {
      add(b_ + i, C_ + 6 * i + k, y * FF(6, k));
      add(u_ + i, C_ + 6 * i + k, y * FU(k, i));
      if (slope_ >= 0) add(slope_ + i, C_ + 6 * i + k, y * FF(7, k));
    }
    f.T(b_ + i, b_ + i) += y * FF(6, 6);
    add(b_ + i, u_ + i, y * FU(6, i));
    f.T(u_ + i, u_ + i) += y * UU[i];
    if (slope_ >= 0) {
      add(slope_ + i, b_ + i, y * FF(7, 6));
      add(slope_ + i, u_ + i, y * FU(7, i));
      f.T(slope_ + i, slope_ + i) += y * FF(7, 7);
    }
  }
  auto cross = UT_.topLeftCorner(nd_, n_);
  for (int k = 0; k < nf_; ++k) {
    const Eigen::Map<const Dense> X(FX_.col(k).data(), 6, nd_);
    cross.noalias() = X.transpose().lazyProduct(SV);
    for (int i = 0; i < n_; ++i) {
      const int at = k < 6 ? C_ + 6 * i + k : (k == 6 ? b_ : slope_) + i;
      for (int y = 0; y < nd_; ++y) add(at, dense_[static_cast<std::size_t>(y)], cross(y, i));
    }
  }
  for (int i = 0; i < n_; ++i) {
    const Eigen::Map<const Dense> X(UX_.col(i).data(), 6, nd_);
    for (int y = 0; y < nd_; ++y) add(u_ + i, dense_[static_cast<std::size_t>(y)], X.col(y).dot(SV.col(i)));
  }
  for (int y = 0; y < nd_; ++y)
    for (int z = 0; z <= y; ++z)
      add(dense_[static_cast<std::size_t>(y)], dense_[static_cast<std::size_t>(z)], XX(y, z));
}

inline void Lag::expect(const Front& f, long g, bool last) {
  H_.topLeftCorner<kWidth, kWidth>() = f.H;
  H_.bottomRows<kWidth>().setZero();
  PairVector b = PairVector::Zero();
  b.head<kWidth>() = f.F.col(nt_);
  b.head<kWidth>().noalias() -= f.F.leftCols(nt_) * theta;
  for (int j = 0; j < kComponents; ++j) {
    const Gram R = smoothness(j) / sizes.q[j];
    for (int o = 0; o < kBlock; ++o)
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l <= k; ++l) H_(kComponents * (o + k) + j, kComponents * (o + l) + j) += R(k, l);
  }
  const PairVector none = PairVector::Zero();
  for (std::size_t i = 0; i < streams_; ++i) {
    Placed at;
    for (long r = f.next[i]; r < motion_[i].end(); ++r) {
      const MotionRow& row = motion_[i][r];
      if (!placed(i, row, g, last, none, at)) break;  // the residual of nothing: the value
      for (int j = 0; j < kComponents; ++j) {
        const double v = row.have[j] * row.size / (motion_noise(i, j) * motion_noise(i, j));
        for (int k = 0; k < kLocal; ++k) {
          b[kComponents * (at.o + k) + j] += v * at.b[k] * at.residual[j];
          for (int l = 0; l <= k; ++l)
            H_(kComponents * (at.o + k) + j, kComponents * (at.o + l) + j) += v * at.b[k] * at.b[l];
        }
      }
    }
  }
  if (Eigen::internal::llt_inplace<double, Eigen::Lower>::blocked(H_) >= 0) return;
  H_.triangularView<Eigen::Lower>().solveInPlace(b);
  H_.transpose().triangularView<Eigen::Upper>().solveInPlace(b);
  block(g).x = b.head<kWidth>();
  block(g + 1).x = b.tail<kWidth>();
}

inline bool Lag::eliminate(Front& f, long g, bool last) {
  model();
  Block& B = block(g);
  PairVector xx;
  xx << B.x, block(g + 1).x;
  H_.topLeftCorner<kWidth, kWidth>() = f.H;
  H_.bottomRows<kWidth>().setZero();
  F_.topRows<kWidth>() = f.F;
  F_.bottomRows<kWidth>().setZero();
  // from the information vector to the gradient at the coefficients and theta as they stand
  auto g_x = F_.col(nt_).head<kWidth>();
  g_x.noalias() -= f.H.selfadjointView<Eigen::Lower>() * B.x;
  g_x.noalias() -= f.F.leftCols(nt_) * theta;
  Z_.row(0).head(nt_).noalias() = B.x.transpose() * f.F.leftCols(nt_);
  f.T.row(nt_).head(nt_) -= Z_.row(0).head(nt_);
  yt_.noalias() = f.T.topLeftCorner(nt_, nt_).selfadjointView<Eigen::Lower>() * theta;
  f.T.row(nt_).head(nt_) -= yt_.transpose();

  B.sums = SizeSums();
  add_smoothness(g, xx, B.sums);
  add_motion(f, g, last, xx, B.sums);
  for (int o = 0; o < kBlock; ++o) add_raw(f, interval(kBlock * g + o), o, B.sums);

  B.L = H_.topLeftCorner<kWidth, kWidth>();
  if (Eigen::internal::llt_inplace<double, Eigen::Lower>::unblocked(B.L) >= 0) return false;
  f.logdet += 2.0 * B.L.diagonal().array().log().sum();
  B.Y = F_.topRows<kWidth>();
  B.L.triangularView<Eigen::Lower>().solveInPlace(B.Y);
  B.B = H_.bottomLeftCorner<kWidth, kWidth>();
  B.L.transpose().triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(B.B);
  f.H = H_.bottomRightCorner<kWidth, kWidth>();
  f.H.selfadjointView<Eigen::Lower>().rankUpdate(B.B, -1.0);
  f.F = F_.bottomRows<kWidth>();
  f.F.noalias() -= B.B * B.Y;
  f.T.selfadjointView<Eigen::Lower>().rankUpdate(B.Y.transpose(), -1.0);

  // back to absolute coordinates
  const auto after = xx.tail<kWidth>();
  B.Y.col(nt_).noalias() += B.L.triangularView<Eigen::Lower>().transpose() * B.x;
  B.Y.col(nt_).noalias() += B.Y.leftCols(nt_) * theta;
  B.Y.col(nt_).noalias() += B.B.transpose() * after;
  f.F.col(nt_).noalias() += f.H.selfadjointView<Eigen::Lower>() * after;
  f.F.col(nt_).noalias() += f.F.leftCols(nt_) * theta;
  Z_.row(0).head(nt_).noalias() = after.transpose() * f.F.leftCols(nt_);
  f.T.row(nt_).head(nt_) += Z_.row(0).head(nt_);
  yt_.noalias() = f.T.topLeftCorner(nt_, nt_).selfadjointView<Eigen::Lower>() * theta;
  f.T.row(nt_).head(nt_) += yt_.transpose();
  return true;
}

inline double Lag::terminal(const Front& f, Eigen::MatrixXd& S, Eigen::VectorXd& eta) {
  Lf_ = f.H;
  if (Eigen::internal::llt_inplace<double, Eigen::Lower>::unblocked(Lf_) >= 0) return std::nan("");
  Yf_ = f.F;
  Lf_.triangularView<Eigen::Lower>().solveInPlace(Yf_);
  S = f.T;
  S.selfadjointView<Eigen::Lower>().rankUpdate(Yf_.transpose(), -1.0);
  eta = S.row(nt_).head(nt_).transpose();
  return f.logdet + 2.0 * Lf_.diagonal().array().log().sum();
}

inline void Lag::back(long from) {
  BlockVector x, y;
  for (long g = end_; g >= from; --g) {
    const bool free = g == end_;
    const Eigen::MatrixXd& Y = free ? Yf_ : block(g).Y;
    y = Y.col(nt_);
    y.noalias() -= Y.leftCols(nt_) * theta;
    if (!free) y.noalias() -= block(g).B.transpose() * x;
    (free ? Lf_ : block(g).L).transpose().triangularView<Eigen::Upper>().solveInPlace(y);
    x = block(g).x = y;
  }
}

inline void Lag::traces(long from) {
  // covariance of two blocks, theta known
  Linv_.setIdentity();
  Lf_.triangularView<Eigen::Lower>().solveInPlace(Linv_);
  pair_.topLeftCorner<kWidth, kWidth>().noalias() = Linv_.transpose() * Linv_;
  for (long g = end_ - 1; g >= from; --g) {
    Block& B = block(g);
    next_ = pair_.topLeftCorner<kWidth, kWidth>();
    Linv_.setIdentity();
    B.L.triangularView<Eigen::Lower>().solveInPlace(Linv_);
    Gt_.noalias() = B.B * Linv_;
    pair_.bottomRightCorner<kWidth, kWidth>() = next_;
    pair_.bottomLeftCorner<kWidth, kWidth>().noalias() = -next_ * Gt_;
    pair_.topRightCorner<kWidth, kWidth>() = pair_.bottomLeftCorner<kWidth, kWidth>().transpose();
    pair_.topLeftCorner<kWidth, kWidth>().noalias() = Linv_.transpose() * Linv_;
    pair_.topLeftCorner<kWidth, kWidth>().noalias() -=
        Gt_.transpose() * pair_.bottomLeftCorner<kWidth, kWidth>();
    SizeSums& s = B.sums;
    s.raw_trace.setZero();
    s.energy_trace.setZero();
    for (auto& m : s.motion_trace) m.setZero();
    for (int o = 0; o < kBlock; ++o) {
      const Interval& v = interval(kBlock * g + o);
      const int base = kComponents * o;
      for (int j = 0; j < kComponents; ++j) {
        Gram local;
        for (int k = 0; k < kLocal; ++k)
          for (int l = 0; l < kLocal; ++l)
            local(k, l) = pair_(base + kComponents * k + j, base + kComponents * l + j);
        s.energy_trace[j] += smoothness(j).cwiseProduct(local).sum() / sizes.q[j];
        for (std::size_t i = 0; i < streams_; ++i)
          s.motion_trace[i][about_.motion[i].group[j]] +=
              v.motion[i].cwiseProduct(local).sum() / (motion_noise(i, j) * motion_noise(i, j));
      }
      if (v.rows == 0 || v.v.isZero()) continue;
      Matrix6 D00 = Matrix6::Zero(), D01 = D00, D11 = D00;  // sum of m(k, l) Cov(x_k, x_l)
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l) {
          const auto cov = pair_.block<6, 6>(base + kComponents * k, base + kComponents * l);
          D00 += v.m00(k, l) * cov;
          D01 += v.m01(k, l) * cov;
          D11 += v.m11(k, l) * cov;
        }
      for (int i = 0; i < n_; ++i) {
        const Vector6 j0 = v.J.row(i).head<6>().transpose(), j1 = v.J.row(i).tail<6>().transpose();
        s.raw_trace[raw_group(i, n_)] +=
            v.v[i] * (j0.dot(D00 * j0) + 2.0 * j0.dot(D01 * j1) + j1.dot(D11 * j1));
      }
    }
  }
}

inline double Lag::objective(long g, Cursor& next, bool last) const {
  double sum = 0.0;
  PairVector xx;
  xx << block(g).x, block(g + 1).x;
  for (int o = 0; o < kBlock; ++o) {
    const Interval& v = intervals_[static_cast<std::size_t>(kBlock * g + o) % intervals_.size()];
    const double mean = v.spared > 0.0 ? mean_chi2(v) : 0.0;
    for (int r = 0; r < v.rows; ++r) {
      const RawRow& row = v.row[static_cast<std::size_t>(r)];
      const double x = v.spared > 0.0 ? mean : chi2(row);
      sum += row.size * (constants::freedom + row.channels) * std::log1p(x / constants::freedom);
    }
    const Eigen::Map<const Gram> local(xx.data() + kComponents * o);
    for (int j = 0; j < kComponents; ++j) {
      const Basis x = local.row(j).transpose();
      sum += x.dot(smoothness(j) * x) / sizes.q[j];
    }
  }
  for (std::size_t i = 0; i < streams_; ++i) {
    Placed at;
    for (; next[i] < motion_[i].end(); ++next[i]) {
      const MotionRow& row = motion_[i][next[i]];
      if (!placed(i, row, g, last, xx, at)) break;
      for (int j = 0; j < kComponents; ++j) {
        const double z = at.residual[j] / motion_noise(i, j);
        sum += row.size * z * z + row.remainder[j] / (motion_noise(i, j) * motion_noise(i, j));
      }
    }
  }
  return sum;
}

}  // namespace truewrench
