// START (METHOD 10.3) on the blocks of a lag, on memory of its own: the motion from its own measurements alone, then gain and
// offset by a robust regression. The same as start.hpp does for whole records.
#pragma once

#include "truewrench/estimation/lag.hpp"

#include <algorithm>
#include <cmath>

namespace truewrench {

class LagStart {
 public:
  LagStart() = default;
  LagStart(int blocks, int channels) {
    const Eigen::Index N = kBlock * (blocks + 1);
    for (auto& band : data_) band.assign(kComponents, Eigen::MatrixXd::Zero(kLocal, N));
    for (auto& b : right_) b = RowMatrix::Zero(N, kComponents);
    H_ = inverse_ = R_ = Eigen::MatrixXd::Zero(kLocal, N);
    x_ = Eigen::VectorXd::Zero(N);
    const auto rows = static_cast<std::size_t>(kMostRows * kBlock * (blocks + 1));
    size_.resize(rows);
    weight_.resize(rows);
    residual_.resize(static_cast<Eigen::Index>(rows), channels);
    found_.resize(channels, 7);
    scale_.resize(channels);
    // log |R_p + A^T A| at unit spacing, by blocks (10.2)
    for (int p = 2; p <= 3; ++p) {
      logdet_[static_cast<std::size_t>(p - 2)].assign(static_cast<std::size_t>(blocks + 1), 0.0);
      for (int g = 2; g <= blocks; ++g)
        logdet_[static_cast<std::size_t>(p - 2)][static_cast<std::size_t>(g)] =
            Spline(0.0, kBlock * g, 1.0).smoothness_logdet(p);
    }
  }

  double smoothness_logdet(const Lag& lag, int j) const {
    const int p = smoothness_order(lag.about().source, j);
    const double N = static_cast<double>(kBlock * (lag.end() + 1));
    return logdet_[static_cast<std::size_t>(p - 2)][static_cast<std::size_t>(lag.end())] -
           ((2 * p - 1) * (N - p) + p * (p - 1)) * std::log(lag.h());
  }

  // Coefficients, q and the factors of the motion's noise of all blocks, clocks at their means. -2 log L (10.7) of the motion.
  double motion_alone(Lag& lag, int most = 80) {
    const Eigen::Index N = kBlock * (lag.end() + 1);
    const std::size_t streams = lag.streams();
    std::array<Vector6, kMostStreams> count, spread;
    for (std::size_t i = 0; i < streams; ++i) {
      const MotionStream& stream = lag.about().motion[i];
      count[i].setZero();
      spread[i].setZero();
      for (auto& band : data_[i]) band.leftCols(N).setZero();
      right_[i].topRows(N).setZero();
      Ring<MotionRow>& rows = lag.motion(i);
      for (long k = rows.begin(); k < rows.end(); ++k) {
        const MotionRow& row = rows[k];
        long at = 0;
        const Basis b = basis_of(lag, i, row, at);
        for (int j = 0; j < kComponents; ++j) {
          if (row.have[j] == 0.0) continue;
          const double v = row.size / (stream.sigma[j] * stream.sigma[j]);
          Eigen::MatrixXd& A = data_[i][static_cast<std::size_t>(j)];
          for (int a = 0; a < kLocal; ++a) {
            for (int c = 0; c <= a; ++c) A(a - c, at + c) += v * b[a] * b[c];
            right_[i](at + a, j) += v * row.value[j] * b[a];
          }
          count[i][stream.group[j]] += 1.0 + row.spared;
          spread[i][stream.group[j]] += row.remainder[j] / (stream.sigma[j] * stream.sigma[j]);
        }
      }
    }
    Sizes& z = lag.sizes;
    z.q.setConstant(constants::smoothness_start);
    for (auto& f : z.motion_factor) f.setOnes();
    double deviance = 0.0;
    for (int iteration = 0; iteration < most; ++iteration) {
      std::array<Vector6, kMostStreams> rss = spread, used;
      for (auto& u : used) u.setZero();
      Vector6 energy, trace;
      deviance = 0.0;
      for (int j = 0; j < kComponents; ++j) {
        const auto ju = static_cast<std::size_t>(j);
        const Gram local = lag.smoothness(j);
        R_.leftCols(N).setZero();
        for (Eigen::Index i = 0; i + kLocal <= N; ++i)
          for (int k = 0; k < kLocal; ++k)
            for (int l = 0; l <= k; ++l) R_(k - l, i + l) += local(k, l);
        H_.leftCols(N) = R_.leftCols(N) / z.q[j];
        x_.head(N).setZero();
        for (std::size_t i = 0; i < streams; ++i) {
          const double f = z.motion_factor[i][lag.about().motion[i].group[j]];
          H_.leftCols(N) += data_[i][ju].leftCols(N) / (f * f);
          x_.head(N) += right_[i].col(j).head(N) / (f * f);
        }
        H_.row(0).head(N).array() += 1e-14 * H_.row(0).head(N).maxCoeff();
        const double logdet = factor(N);
        if (!std::isfinite(logdet)) return std::nan("");
        solve(N);
        invert(N);
        for (Eigen::Index k = 0; k < N; ++k) lag.block(k / kBlock).x[kComponents * (k % kBlock) + j] = x_[k];
        double bend = 0.0;
        for (Eigen::Index i = 0; i + kLocal <= N; ++i) {
          const Basis x = x_.segment<kLocal>(i);
          bend += x.dot(local * x);
        }
        energy[j] = bend;
        trace[j] = inner(R_, N);
        const double p = smoothness_order(lag.about().source, j);
        deviance += logdet + bend / z.q[j] + (static_cast<double>(N) - p) * std::log(z.q[j]) -
                    smoothness_logdet(lag, j);
        for (std::size_t i = 0; i < streams; ++i) {
          const MotionStream& stream = lag.about().motion[i];
          const double f = z.motion_factor[i][stream.group[j]];
          double sum = 0.0, n = 0.0;
          Ring<MotionRow>& rows = lag.motion(i);
          for (long k = rows.begin(); k < rows.end(); ++k) {
            const MotionRow& row = rows[k];
            if (row.have[j] == 0.0) continue;
            long at = 0;
            const Basis b = basis_of(lag, i, row, at);
            const double e = row.value[j] - b.dot(x_.segment<kLocal>(at));
            sum += row.size * e * e;
            n += 1.0 + row.spared;
          }
          sum /= stream.sigma[j] * stream.sigma[j];
          rss[i][stream.group[j]] += sum;
          used[i][stream.group[j]] += inner(data_[i][ju], N) / (f * f);
          deviance += sum / (f * f) + 2.0 * n * std::log(f * stream.sigma[j]);
        }
      }
      double move = 0.0;
      if (iteration >= 8)
        for (std::size_t i = 0; i < streams; ++i)
          for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r) {
            if (count[i][r] <= 0.0) continue;
            const double to = std::sqrt(std::max(rss[i][r], 1e-12) /
                                        std::max(count[i][r] - used[i][r], 1e-3 * count[i][r]));
            move = std::max(move, 2.0 * std::abs(std::log(to / z.motion_factor[i][r])));
            z.motion_factor[i][r] = to;
          }
      for (int j = 0; j < kComponents; ++j) {
        const double size = static_cast<double>(N - smoothness_order(lag.about().source, j));
        const double to = std::max(energy[j], 1e-16) / std::max(size - trace[j] / z.q[j], 1.0);
        move = std::max(move, std::abs(std::log(to / z.q[j])));
        z.q[j] *= std::clamp(to / z.q[j], 1e-3, 1e3);
      }
      if (iteration > 8 && move < 1e-3) break;
    }
    return deviance;
  }

  // Gain and offset (theta, raw_factor) by Cauchy weights (1 + n) / (1 + chi^2_n), scale 1.48 median and at least the stated
  // sigma; `gain` false: the offset alone. Rows as predicted; prior: variances of theta.
  void regress(Lag& lag, const Eigen::VectorXd& prior, bool gain) {
    const int n = lag.channels();
    const Statement& rig = lag.rig();
    scale_ = rig.noise;
    Eigen::Index count = 0;
    for (long i = 0; i < kBlock * lag.end(); ++i) count += lag.interval(i).rows;
    std::fill_n(weight_.begin(), count, 1.0);
    for (int round = 0; round < 15; ++round) {
      for (int i = 0; i < n; ++i) {
        Eigen::Matrix<double, 7, 7> A = Eigen::Matrix<double, 7, 7>::Zero();
        Eigen::Matrix<double, 7, 1> b = Eigen::Matrix<double, 7, 1>::Zero(), x;
        const Vector6 start = gain ? Vector6(rig.nominal.row(i).transpose())
                                   : Vector6(lag.theta.segment<6>(lag.gain_at() + 6 * i));
        for (int k = 0; k < 6; ++k) A(k, k) = gain ? 1.0 / prior[lag.gain_at() + 6 * i + k] : 1e30;
        A(6, 6) = 1.0 / prior[lag.offset_at() + i];
        Eigen::Index at = 0;
        for (long v = 0; v < kBlock * lag.end(); ++v)
          for (int r = 0; r < lag.interval(v).rows; ++r, ++at) {
            const RawRow& row = lag.interval(v).row[static_cast<std::size_t>(r)];
            if (row.have[i] == 0.0) continue;
            const double y = row.size * weight_[static_cast<std::size_t>(at)] / (scale_[i] * scale_[i]);
            x << row.w, 1.0;
            A += y * x * x.transpose();
            b += y * (row.value[i] - start.dot(row.w)) * x;
          }
        found_.row(i) = A.llt().solve(b).transpose();
        found_.row(i).head<6>() += start.transpose();
      }
      Eigen::Index at = 0;
      for (long v = 0; v < kBlock * lag.end(); ++v)
        for (int r = 0; r < lag.interval(v).rows; ++r, ++at) {
          const RawRow& row = lag.interval(v).row[static_cast<std::size_t>(r)];
          for (int i = 0; i < n; ++i)
            residual_(at, i) =
                row.have[i] * (row.value[i] - found_.row(i).head<6>().dot(row.w) - found_(i, 6));
        }
      for (int i = 0; i < n; ++i) {
        for (Eigen::Index k = 0; k < count; ++k)
          size_[static_cast<std::size_t>(k)] = std::abs(residual_(k, i));
        const auto middle = size_.begin() + count / 2;
        std::nth_element(size_.begin(), middle, size_.begin() + count);
        scale_[i] = std::max(1.48 * *middle, rig.noise[i]);
      }
      for (Eigen::Index k = 0; k < count; ++k) {
        double chi2 = 0.0;
        for (int i = 0; i < n; ++i) chi2 += residual_(k, i) * residual_(k, i) / (scale_[i] * scale_[i]);
        weight_[static_cast<std::size_t>(k)] = (1.0 + n) / (1.0 + chi2);
      }
    }
    lag.sizes.raw_factor.setZero();
    for (int i = 0; i < n; ++i) {
      lag.theta.segment<6>(lag.gain_at() + 6 * i) = found_.row(i).head<6>().transpose();
      lag.theta[lag.offset_at() + i] = found_(i, 6);
      double& f = lag.sizes.raw_factor[raw_group(i, n)];
      f = std::max(f, scale_[i] / rig.noise[i]);
    }
  }

 private:
  std::array<std::vector<Eigen::MatrixXd>, kMostStreams> data_;
  std::array<RowMatrix, kMostStreams> right_;
  Eigen::MatrixXd H_, inverse_, R_;
  Eigen::VectorXd x_, scale_;
  std::vector<double> size_, weight_;
  Eigen::MatrixXd residual_, found_;
  std::array<std::vector<double>, 2> logdet_;

  static Basis basis_of(const Lag& lag, std::size_t i, const MotionRow& row, long& at) {
    const double x = (row.time + lag.clock(i) - lag.origin()) / lag.h();
    at = std::clamp<long>(static_cast<long>(std::floor(x + 1e-9)), 0, kBlock * lag.end() - 1);
    return lag.basis().at(x - static_cast<double>(at), lag.about().motion[i].derivative);
  }

  // H_ = L L^T in place, its log determinant.
  double factor(Eigen::Index N) {
    double sum = 0.0;
    for (Eigen::Index j = 0; j < N; ++j) {
      if (!(H_(0, j) > 0.0)) return std::nan("");
      H_(0, j) = std::sqrt(H_(0, j));
      sum += std::log(H_(0, j));
      const Eigen::Index below = std::min<Eigen::Index>(kLocal - 1, N - 1 - j);
      for (Eigen::Index i = 1; i <= below; ++i) H_(i, j) /= H_(0, j);
      for (Eigen::Index k = 1; k <= below; ++k)
        for (Eigen::Index i = k; i <= below; ++i) H_(i - k, j + k) -= H_(i, j) * H_(k, j);
    }
    return 2.0 * sum;
  }
  void solve(Eigen::Index N) {
    for (Eigen::Index j = 0; j < N; ++j) {
      x_[j] /= H_(0, j);
      for (Eigen::Index i = 1; i < kLocal && j + i < N; ++i) x_[j + i] -= H_(i, j) * x_[j];
    }
    for (Eigen::Index j = N - 1; j >= 0; --j) {
      for (Eigen::Index i = 1; i < kLocal && j + i < N; ++i) x_[j] -= H_(i, j) * x_[j + i];
      x_[j] /= H_(0, j);
    }
  }
  // The band of the inverse (Takahashi).
  void invert(Eigen::Index N) {
    const auto at = [this](Eigen::Index i, Eigen::Index j) {
      return i >= j ? inverse_(i - j, j) : inverse_(j - i, i);
    };
    for (Eigen::Index j = N - 1; j >= 0; --j) {
      const Eigen::Index last = std::min<Eigen::Index>(N - 1, j + kLocal - 1);
      for (Eigen::Index i = last; i >= j; --i) {
        double sum = i == j ? 1.0 / H_(0, j) : 0.0;
        for (Eigen::Index k = j + 1; k <= last; ++k) sum -= H_(k - j, j) * at(i, k);
        inverse_(i - j, j) = sum / H_(0, j);
      }
    }
  }
  double inner(const Eigen::MatrixXd& band, Eigen::Index N) const {
    return band.row(0).head(N).dot(inverse_.row(0).head(N)) +
           2.0 * band.block(1, 0, kLocal - 1, N).cwiseProduct(inverse_.block(1, 0, kLocal - 1, N)).sum();
  }
};

}  // namespace truewrench
