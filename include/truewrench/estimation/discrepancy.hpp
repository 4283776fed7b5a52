// What residuals show of a slow discrepancy by moments (METHOD (10.9)), and what follows the pose unseen (10.10).
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <functional>

namespace truewrench {

// (10.9) of one group of channels of one log, at the tau of the largest z.
struct Moment {
  double tau = constants::taus[0];
  double delta2 = 0.0;  // delta^2, fraction of range squared
  double sd = 0.0;      // its standard deviation
  double z = 0.0;
};

// Which samples count: of log l, stretch s, row k.
using Keep = std::function<bool(std::size_t, std::size_t, Eigen::Index)>;

inline Keep unmasked(const Fit& fit) {
  return [&fit](std::size_t l, std::size_t s, Eigen::Index k) {
    return fit.logs()[l].stretches[s].raw.masked[static_cast<std::size_t>(k)] == 0;
  };
}

// K X of a Matern-3/2 correlation (1 + t / tau) exp(-t / tau) on increasing times: two recursions a column.
inline Eigen::MatrixXd correlate(const Eigen::VectorXd& time, double tau, const Eigen::MatrixXd& X) {
  Eigen::MatrixXd out = X;
  const Eigen::Index n = time.size();
  for (const int direction : {1, -1}) {
    Eigen::RowVectorXd a = Eigen::RowVectorXd::Zero(X.cols()), b = a;
    for (Eigen::Index i = 1; i < n; ++i) {
      const Eigen::Index to = direction > 0 ? i : n - 1 - i, from = to - direction;
      const double x = std::abs(time[to] - time[from]) / tau, e = std::exp(-x);
      a += X.row(from);
      b = e * (b + x * a);
      a *= e;
      out.row(to) += a + b;
    }
  }
  return out;
}

// sum over all pairs of K_ij^2.
inline double squared_correlations(const Eigen::VectorXd& time, double tau) {
  double a = 0.0, b = 0.0, c = 0.0, sum = 0.0;
  for (Eigen::Index i = 1; i < time.size(); ++i) {
    const double x = (time[i] - time[i - 1]) / tau, e = std::exp(-2.0 * x);
    a += 1.0;
    c = e * (c + 2.0 * x * b + x * x * a);
    b = e * (b + x * a);
    a *= e;
    sum += a + 2.0 * b + c;
  }
  return static_cast<double>(time.size()) + 2.0 * sum;
}

// Times, X_i = [w, 1, (C w)_i^2] and residuals of the samples of one channel.
struct ChannelRows {
  Eigen::VectorXd time, residual;
  Eigen::MatrixXd X;  // (K, 8)
};

inline ChannelRows channel_rows(const Fit& fit, std::size_t l, int channel, const Keep& keep) {
  std::vector<std::pair<std::size_t, Eigen::Index>> at;
  const auto& stretches = fit.logs()[l].stretches;
  for (std::size_t s = 0; s < stretches.size(); ++s)
    for (Eigen::Index k = 0; k < stretches[s].raw.size(); ++k)
      if (keep(l, s, k) && std::isfinite(stretches[s].raw.value(k, channel))) at.emplace_back(s, k);
  ChannelRows out;
  const auto rows = static_cast<Eigen::Index>(at.size());
  out.time.resize(rows);
  out.residual.resize(rows);
  out.X.resize(rows, 8);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const auto [s, k] = at[static_cast<std::size_t>(i)];
    const Stretch& stretch = stretches[s];
    out.time[i] = stretch.raw.time[k];
    out.residual[i] = stretch.now.residual(k, channel);
    out.X.row(i) << stretch.now.w.row(k), 1.0, stretch.now.cw(k, channel) * stretch.now.cw(k, channel);
  }
  return out;
}

// (10.9) for the groups of one log, from the residuals of a fit without d.
inline std::vector<Moment> moments(const Fit& fit, std::size_t l) {
  const int groups = raw_groups(fit.channels());
  std::vector<Moment> out(static_cast<std::size_t>(groups));
  for (int group = 0; group < groups; ++group) {
    constexpr std::size_t count = std::size(constants::taus);
    std::array<double, count> num{}, t1{}, t2{};
    double nu = 0.0, rss = 0.0;
    for (int i = 0; i < fit.channels(); ++i) {
      if (raw_group(i, fit.channels()) != group) continue;
      const ChannelRows rows = channel_rows(fit, l, i, unmasked(fit));
      const auto n = static_cast<double>(rows.time.size());
      if (n < 10.0) continue;
      // Q: an orthonormal basis of X
      const Eigen::VectorXd length = rows.X.colwise().norm().transpose().cwiseMax(1e-300);
      const Eigen::MatrixXd X = rows.X * length.cwiseInverse().asDiagonal();
      const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(X.transpose() * X);
      int rank = 0;
      Eigen::MatrixXd Q(X.rows(), X.cols());
      for (Eigen::Index c = 0; c < X.cols(); ++c)
        if (eigen.eigenvalues()[c] > 1e-12) Q.col(rank++) = X * eigen.eigenvectors().col(c) / std::sqrt(eigen.eigenvalues()[c]);
      Q.conservativeResize(Eigen::NoChange, rank);
      const Eigen::VectorXd r = rows.residual - Q * (Q.transpose() * rows.residual);
      for (std::size_t t = 0; t < count; ++t) {
        Eigen::MatrixXd both(Q.rows(), rank + 1);
        both << Q, r;
        const Eigen::MatrixXd K = correlate(rows.time, constants::taus[t], both);
        const Eigen::MatrixXd S = Q.transpose() * K.leftCols(rank);
        num[t] += r.dot(K.col(rank));                                                          // r^T M K M r
        t1[t] += n - S.trace();                                                                // tr M K
        t2[t] += squared_correlations(rows.time, constants::taus[t]) - 2.0 * K.leftCols(rank).squaredNorm() + S.squaredNorm();  // tr M K M K
      }
      nu += n - rank;
      rss += r.squaredNorm();
    }
    Moment& best = out[static_cast<std::size_t>(group)];
    best.z = -std::numeric_limits<double>::infinity();
    if (nu <= 0.0) continue;
    for (std::size_t t = 0; t < count; ++t) {
      const double top = num[t] - t1[t] * rss / nu, den = std::max(t2[t] - t1[t] * t1[t] / nu, 1e-300);
      const double sd = rss / nu * std::sqrt(2.0 / den), z = sd > 0.0 ? top / den / sd : 0.0;
      if (z > best.z) best = {constants::taus[t], std::max(0.0, top / den), sd, z};
    }
  }
  return out;
}

// What (10.9) adds to the covariance of C (6n, 6n) where the samples that `keep` names determine it:
// delta^2 (X^T X)^-1 X^T K X (X^T X)^-1, the prior's information beside X^T X.
inline Eigen::MatrixXd spread(const Fit& fit, const std::vector<std::vector<Moment>>& found, const Keep& keep) {
  const int n = fit.channels();
  const Layout& layout = fit.layout();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  std::vector<int> offset_of, offsets;
  for (std::size_t l = 0; l < fit.logs().size(); ++l)
    offset_of.push_back(layout.log(l).global[static_cast<std::size_t>(layout.log(l).b)]);
  offsets = offset_of;
  offsets.erase(std::unique(offsets.begin(), offsets.end()), offsets.end());
  const auto m = static_cast<Eigen::Index>(offsets.size());
  for (int i = 0; i < n; ++i) {
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(7 + m, 7 + m), B = A;  // of [C_i, u_i, offsets]
    for (int k = 0; k < 6; ++k) A(k, k) = 1.0 / fit.prior[layout.C + 6 * i + k];
    A(6, 6) = 1.0 / fit.prior[layout.u + i];
    for (Eigen::Index o = 0; o < m; ++o) A(7 + o, 7 + o) = 1.0 / fit.prior[offsets[static_cast<std::size_t>(o)] + i];
    for (std::size_t l = 0; l < fit.logs().size(); ++l) {
      const ChannelRows rows = channel_rows(fit, l, i, keep);
      if (rows.time.size() == 0) continue;
      const Moment& moment = found[l][static_cast<std::size_t>(raw_group(i, n))];
      const Eigen::Index o = 7 + std::distance(offsets.begin(), std::find(offsets.begin(), offsets.end(), offset_of[l]));
      Eigen::MatrixXd X = Eigen::MatrixXd::Zero(rows.X.rows(), 7 + m);
      X.leftCols<6>() = rows.X.leftCols<6>();
      X.col(6) = rows.X.col(7);
      X.col(o) = rows.X.col(6);
      const double v = std::pow(fit.sigma(l, i), -2.0);
      A += v * X.transpose() * X;
      if (moment.delta2 > 0.0) B += v * v * moment.delta2 * X.transpose() * correlate(rows.time, moment.tau, X);
    }
    const Eigen::MatrixXd G = A.llt().solve(Eigen::MatrixXd::Identity(A.rows(), A.cols()));
    out.block(6 * i, 6 * i, 6, 6) = (G * B * G).topLeftCorner<6, 6>();
  }
  return out;
}

// How far a force that follows the pose can hide in the gain (10.10).
struct PoseShare {
  double A = 0.0;                // mean R^2 of the components of the pose on (w, 1)
  Matrix6 ww = Matrix6::Zero();  // E w w^T over the unmasked samples
  double period = 1.0;           // [s] 1 / mean frequency of w, weighted by its power
  bool moved = false;            // any component of the pose
};

// The pose (K, 6) of one stretch: the integral of the twist, component by component; where the body turns by more than 1 rad,
// and for joints, its position in the axes of the mean attitude and the rotation vector from it.
inline RowMatrix pose_of(const Stretch& s) {
  const Eigen::Index n = s.raw.size();
  RowMatrix pose = RowMatrix::Zero(n, 6);
  for (Eigen::Index k = 1; k < n; ++k)
    pose.row(k) = pose.row(k - 1) + 0.5 * (s.raw.time[k] - s.raw.time[k - 1]) * (s.now.nu.row(k) + s.now.nu.row(k - 1));
  const auto turned = pose.rightCols<3>().colwise().maxCoeff() - pose.rightCols<3>().colwise().minCoeff();
  if (n == 0 || (s.log().source != Source::mapped && turned.maxCoeff() < 1.0)) return pose;
  std::vector<Matrix3> R(static_cast<std::size_t>(n), Matrix3::Identity());
  Matrix3 sum = Matrix3::Zero();
  for (Eigen::Index k = 0; k < n; ++k) {
    const auto i = static_cast<std::size_t>(k);
    if (k > 0) {
      const double dt = s.raw.time[k] - s.raw.time[k - 1];
      const Vector3 turn = 0.5 * dt * (s.now.nu.row(k) + s.now.nu.row(k - 1)).tail<3>().transpose();
      const double angle = turn.norm();
      R[i] = R[i - 1] * (angle > 1e-12 ? Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix() : Matrix3::Identity());
      const Vector3 v = 0.5 * (R[i - 1] * s.now.nu.row(k - 1).head<3>().transpose() + R[i] * s.now.nu.row(k).head<3>().transpose());
      pose.row(k).head<3>() = pose.row(k - 1).head<3>() + dt * v.transpose();
    }
    sum += R[i];
  }
  const Eigen::JacobiSVD<Matrix3> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3 mean = svd.matrixU() * svd.matrixV().transpose();
  if (mean.determinant() < 0.0) mean = svd.matrixU() * Vector3(1.0, 1.0, -1.0).asDiagonal() * svd.matrixV().transpose();
  for (Eigen::Index k = 0; k < n; ++k) {
    const Eigen::AngleAxisd turn(Matrix3(mean.transpose() * R[static_cast<std::size_t>(k)]));
    pose.row(k).head<3>() = pose.row(k).head<3>() * mean;
    pose.row(k).tail<3>() = turn.angle() * turn.axis().transpose();
  }
  return pose;
}

inline PoseShare pose_share(const Fit& fit) {
  Matrix6 ww = Matrix6::Zero(), centred = Matrix6::Zero(), wp = Matrix6::Zero();
  Vector6 pp = Vector6::Zero(), rate = Vector6::Zero();
  double count = 0.0;
  for (const LogFit& log : fit.logs())
    for (const Stretch& s : log.stretches) {
      const RowMatrix pose = pose_of(s);
      Vector6 w_mean = Vector6::Zero(), p_mean = Vector6::Zero();
      double rows = 0.0;
      for (Eigen::Index k = 0; k < s.raw.size(); ++k)
        if (s.raw.masked[static_cast<std::size_t>(k)] == 0) {
          w_mean += s.now.w.row(k).transpose();
          p_mean += pose.row(k).transpose();
          rows += 1.0;
        }
      if (rows == 0.0) continue;
      w_mean /= rows;
      p_mean /= rows;
      count += rows;
      for (Eigen::Index k = 0; k < s.raw.size(); ++k) {
        if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
        const Vector6 w = s.now.w.row(k), d = w - w_mean, p = pose.row(k).transpose() - p_mean;
        ww += w * w.transpose();
        centred += d * d.transpose();
        wp += d * p.transpose();
        pp += p.cwiseAbs2();
        if (k > 0) {
          const double dt = std::max(s.raw.time[k] - s.raw.time[k - 1], 1e-12);
          rate += ((s.now.w.row(k) - s.now.w.row(k - 1)) / dt).transpose().cwiseAbs2();
        }
      }
    }
  PoseShare out;
  if (count == 0.0) return out;
  out.ww = ww / count;
  const Vector6 size = centred.diagonal().cwiseSqrt().cwiseMax(1e-300);
  const Matrix6 correlation = size.cwiseInverse().asDiagonal() * centred * size.cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6> eigen(correlation);
  double total = 0.0;
  int moving = 0;
  for (int j = 0; j < 6; ++j) {
    if (!(std::sqrt(pp[j] / count) > 1e-6)) continue;  // components that do not move
    const Vector6 b = eigen.eigenvectors().transpose() * wp.col(j).cwiseQuotient(size);
    double explained = 0.0;
    for (int i = 0; i < 6; ++i)
      if (eigen.eigenvalues()[i] > 1e-12) explained += b[i] * b[i] / eigen.eigenvalues()[i];
    total += std::min(1.0, explained / pp[j]);
    ++moving;
  }
  out.moved = moving > 0;
  out.A = moving > 0 ? total / moving : 0.0;
  double frequency = 0.0;
  int axes = 0;
  for (int j = 0; j < 6; ++j)
    if (centred(j, j) > 1e-12 * count) {
      frequency += std::sqrt(rate[j] / centred(j, j)) / (2.0 * 3.14159265358979323846);
      ++axes;
    }
  out.period = axes > 0 && frequency > 0.0 ? axes / frequency : 1.0;
  return out;
}

// (10.10): Cov(C_i) += f_i^2 A / (1 - A) (E w w^T)^-1 / 6, what is added to element ij multiplied by g_i g_j so that no gain's
// variance rises above its prior's. P, prior: (6n, 6n) and (6n); f2: (n).
inline Eigen::MatrixXd add_pose(const Eigen::MatrixXd& P, const Eigen::VectorXd& prior, const Eigen::VectorXd& f2,
                                const PoseShare& share) {
  Matrix6 ww = share.ww;
  ww.diagonal().array() += 1e-12 * std::max(ww.trace(), 1e-12);
  const Matrix6 hidden = std::min(share.A, 1.0 - 1e-9) / std::max(1.0 - share.A, 1e-9) / 6.0 * ww.inverse();
  Eigen::MatrixXd added = Eigen::MatrixXd::Zero(P.rows(), P.cols());
  for (Eigen::Index i = 0; i < f2.size(); ++i) added.block<6, 6>(6 * i, 6 * i) = f2[i] * hidden;
  Eigen::VectorXd g(P.rows());
  for (Eigen::Index i = 0; i < P.rows(); ++i)
    g[i] = std::sqrt(std::clamp((prior[i] - P(i, i)) / std::max(added(i, i), 1e-300), 0.0, 1.0));
  return P + g.asDiagonal() * added * g.asDiagonal();
}

}  // namespace truewrench
