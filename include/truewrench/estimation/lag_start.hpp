// START (METHOD 10.3) on the blocks of a lag, on memory of its own: the motion
// from its own measurements alone, then gain and offset by a robust regression.
// The same as start.hpp does for whole records.
#pragma once

#include "truewrench/estimation/lag.hpp"

#include <algorithm>
#include <cmath>

namespace truewrench {

class LagStart {
 public:
  LagStart() = default;
  LagStart(int blocks, int channels) : most_(static_cast<std::size_t>(kBlock * (blocks + 1))) {
    for (auto& stream : data_)
      for (auto& band : stream) band.assign(kLocal * most_, 0.0);
    for (auto& stream : right_)
      for (auto& b : stream) b.assign(most_, 0.0);
    for (auto* v : {&H_, &inverse_, &R_}) v->assign(kLocal * most_, 0.0);
    x_.assign(most_, 0.0);
    const std::size_t rows = kMostRows * most_;
    size_.resize(rows);
    weight_.resize(rows);
    residual_.resize(rows * static_cast<std::size_t>(channels));
    // log |R_p + A^T A| at unit spacing, by blocks (10.2)
    for (int p = 2; p <= 3; ++p) {
      auto& table = logdet_[static_cast<std::size_t>(p - 2)];
      table.assign(static_cast<std::size_t>(blocks + 1), 0.0);
      for (int g = 2; g <= blocks; ++g)
        table[static_cast<std::size_t>(g)] = Spline(0.0, kBlock * g, 1.0).smoothness_logdet(p);
    }
  }

  double smoothness_logdet(const Lag& lag, int j) const {
    const int p = smoothness_order(lag.about().source, j);
    const double N = static_cast<double>(kBlock * (lag.end() + 1));
    return logdet_[static_cast<std::size_t>(p - 2)][static_cast<std::size_t>(lag.end())] -
           ((2 * p - 1) * (N - p) + p * (p - 1)) * std::log(lag.h());
  }

  // Coefficients, q and the factors of the motion's noise of all blocks, clocks
  // at their means. -2 log L (10.7) of the motion.
  double motion_alone(Lag& lag, int most = 80) {
    const auto N = static_cast<std::size_t>(kBlock * (lag.end() + 1));
    const std::size_t streams = lag.streams();
    using Groups = SizeSums::Groups;
    std::array<Groups, kMostStreams> count{}, spread{};
    for (std::size_t i = 0; i < streams; ++i) gather(lag, i, N, count[i], spread[i]);
    Sizes& z = lag.sizes;
    for (Eigen::Index j = 0; j < z.q.size(); ++j) z.q[j] = constants::smoothness_start;
    for (auto& f : z.motion_factor)
      for (Eigen::Index r = 0; r < f.size(); ++r) f[r] = 1.0;
    double deviance = 0.0;
    for (int iteration = 0; iteration < most; ++iteration) {
      std::array<Groups, kMostStreams> rss = spread, used{};
      Groups energy{}, trace{};
      deviance = 0.0;
      for (std::size_t j = 0; j < kComponents; ++j) {
        const int component = static_cast<int>(j);
        const Gram local = lag.smoothness(component);
        const double q = z.q[component], p = smoothness_order(lag.about().source, component);
        std::fill_n(R_.begin(), kLocal * N, 0.0);
        for (std::size_t i = 0; i + kLocal <= N; ++i)
          for (std::size_t k = 0; k < kLocal; ++k)
            for (std::size_t l = 0; l <= k; ++l)
              R_[(i + l) * kLocal + k - l] += local(static_cast<int>(k), static_cast<int>(l));
        double largest = 0.0;
        for (std::size_t k = 0; k < kLocal * N; ++k) H_[k] = R_[k] / q;
        std::fill_n(x_.begin(), N, 0.0);
        for (std::size_t i = 0; i < streams; ++i) {
          const double f = z.motion_factor[i][lag.about().motion[i].group[component]], v = 1.0 / (f * f);
          for (std::size_t k = 0; k < kLocal * N; ++k) H_[k] += v * data_[i][j][k];
          for (std::size_t k = 0; k < N; ++k) x_[k] += v * right_[i][j][k];
        }
        for (std::size_t k = 0; k < N; ++k) largest = std::max(largest, H_[k * kLocal]);
        for (std::size_t k = 0; k < N; ++k)
          H_[k * kLocal] += 1e-14 * largest;  // where no sample lies for a few knots
        const double logdet = factor(N);
        if (!std::isfinite(logdet)) return std::nan("");
        solve(N);
        invert(N);
        for (std::size_t k = 0; k < N; ++k)
          lag.block(static_cast<long>(k) / kBlock)
              .x[kComponents * (static_cast<int>(k) % kBlock) + component] = x_[k];
        for (std::size_t i = 0; i + kLocal <= N; ++i)
          for (std::size_t k = 0; k < kLocal; ++k)
            for (std::size_t l = 0; l < kLocal; ++l)
              energy[j] +=
                  local(static_cast<int>(k), static_cast<int>(l)) * (x_[i + k] - x_[i]) * (x_[i + l] - x_[i]);
        trace[j] = inner(R_, N);
        deviance += logdet + energy[j] / q + (static_cast<double>(N) - p) * std::log(q) -
                    smoothness_logdet(lag, component);
        for (std::size_t i = 0; i < streams; ++i) {
          const MotionStream& stream = lag.about().motion[i];
          const auto group = static_cast<std::size_t>(stream.group[component]);
          const double f = z.motion_factor[i][stream.group[component]];
          double sum = 0.0, n = 0.0;
          Ring<MotionRow>& rows = lag.motion(i);
          for (long k = rows.begin(); k < rows.end(); ++k) {
            const MotionRow& row = rows[k];
            if (row.have[j] == 0.0) continue;
            std::size_t at = 0;
            const Basis b = basis_of(lag, i, row, at);
            double e = row.value[j];
            for (std::size_t l = 0; l < kLocal; ++l) e -= b[static_cast<int>(l)] * x_[at + l];
            sum += row.size * e * e;
            n += 1.0 + row.spared;
          }
          sum /= stream.sigma[component] * stream.sigma[component];
          rss[i][group] += sum;
          used[i][group] += inner(data_[i][j], N) / (f * f);
          deviance += sum / (f * f) + 2.0 * n * std::log(f * stream.sigma[component]);
        }
      }
      double move = 0.0;
      if (iteration >= 8)
        for (std::size_t i = 0; i < streams; ++i)
          for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r) {
            const auto g = static_cast<std::size_t>(r);
            if (count[i][g] <= 0.0) continue;
            const double to = std::sqrt(std::max(rss[i][g], 1e-12) /
                                        std::max(count[i][g] - used[i][g], 1e-3 * count[i][g]));
            move = std::max(move, 2.0 * std::abs(std::log(to / z.motion_factor[i][r])));
            z.motion_factor[i][r] = to;
          }
      for (int j = 0; j < kComponents; ++j) {
        const auto ju = static_cast<std::size_t>(j);
        const double size = static_cast<double>(N) - smoothness_order(lag.about().source, j);
        const double to = smoothness_found(lag.about(), j, lag.h(), energy[ju], size - trace[ju] / z.q[j]);
        move = std::max(move, std::abs(std::log(to / z.q[j])));
        z.q[j] *= std::clamp(to / z.q[j], 1e-3, 1e3);
      }
      if (iteration > 8 && move < 1e-3) break;
    }
    return deviance;
  }

  // Gain and offset (theta, raw_factor) by Cauchy weights (1 + n) / (1 +
  // chi^2_n), scale 1.48 median and at least the stated sigma; `gain` false:
  // the offset alone. Rows as predicted; prior: variances of theta.
  void regress(Lag& lag, const Eigen::VectorXd& prior, bool gain) {
    const int n = lag.channels();
    const Statement& rig = lag.rig();
    Channels scale{};
    std::array<std::array<double, 7>, kMostChannels> found{};
    for (int i = 0; i < n; ++i) scale[static_cast<std::size_t>(i)] = rig.noise[i];
    std::size_t count = 0;
    const auto rows = [&lag](const auto& work) {
      std::size_t at = 0;
      for (long v = 0; v < kBlock * lag.end(); ++v)
        for (int r = 0; r < lag.interval(v).rows; ++r)
          work(at++, lag.interval(v).row[static_cast<std::size_t>(r)]);
      return at;
    };
    count = rows([this](std::size_t at, const RawRow&) { weight_[at] = 1.0; });
    for (int round = 0; round < 15; ++round) {
      for (int i = 0; i < n; ++i) {
        const auto iu = static_cast<std::size_t>(i);
        double A[7][7] = {}, b[7] = {}, from[6];
        for (int k = 0; k < 6; ++k) {
          from[k] = gain ? rig.nominal(i, k) : lag.theta[lag.gain_at() + 6 * i + k];
          A[k][k] = gain ? 1.0 / prior[lag.gain_at() + 6 * i + k] : 1e30;
        }
        A[6][6] = 1.0 / prior[lag.offset_at() + i];
        rows([&](std::size_t at, const RawRow& row) {
          if (!row.has(i)) return;
          const double v = row.size * weight_[at] / (scale[iu] * scale[iu]);
          double x[7], y = row.value[iu];
          for (int k = 0; k < 6; ++k) {
            x[k] = row.w[k];
            y -= from[k] * x[k];
          }
          x[6] = 1.0;
          for (int k = 0; k < 7; ++k) {
            b[k] += v * y * x[k];
            for (int l = 0; l <= k; ++l) A[k][l] += v * x[k] * x[l];
          }
        });
        solve_small(A, b);
        for (std::size_t k = 0; k < 7; ++k) found[iu][k] = b[k] + (k < 6 ? from[k] : 0.0);
      }
      rows([&](std::size_t at, const RawRow& row) {
        for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
          double e = row.value[i] - found[i][6];
          for (int k = 0; k < 6; ++k) e -= found[i][static_cast<std::size_t>(k)] * row.w[k];
          residual_[at * static_cast<std::size_t>(n) + i] = row.has(static_cast<int>(i)) ? e : 0.0;
        }
      });
      for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
        for (std::size_t k = 0; k < count; ++k)
          size_[k] = std::abs(residual_[k * static_cast<std::size_t>(n) + i]);
        const auto middle = size_.begin() + static_cast<std::ptrdiff_t>(count / 2);
        std::nth_element(size_.begin(), middle, size_.begin() + static_cast<std::ptrdiff_t>(count));
        scale[i] = std::max(1.48 * *middle, rig.noise[static_cast<int>(i)]);
      }
      for (std::size_t k = 0; k < count; ++k) {
        double chi2 = 0.0;
        for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
          const double x = residual_[k * static_cast<std::size_t>(n) + i] / scale[i];
          chi2 += x * x;
        }
        weight_[k] = (1.0 + n) / (1.0 + chi2);
      }
    }
    for (Eigen::Index r = 0; r < lag.sizes.raw_factor.size(); ++r) lag.sizes.raw_factor[r] = 0.0;
    for (int i = 0; i < n; ++i) {
      const auto iu = static_cast<std::size_t>(i);
      for (int k = 0; k < 6; ++k)
        lag.theta[lag.gain_at() + 6 * i + k] = found[iu][static_cast<std::size_t>(k)];
      lag.theta[lag.offset_at() + i] = found[iu][6];
      double& f = lag.sizes.raw_factor[raw_group(i, n)];
      f = std::max(f, scale[iu] / rig.noise[i]);
    }
  }

 private:
  std::size_t most_ = 0;  // coefficients
  // bands of symmetric matrices: kLocal of the lower triangle, column by column
  std::array<std::array<std::vector<double>, kComponents>, kMostStreams> data_;
  std::array<std::array<std::vector<double>, kComponents>, kMostStreams> right_;
  std::vector<double> H_, inverse_, R_, x_, size_, weight_, residual_;
  std::array<std::vector<double>, 2> logdet_;

  static Basis basis_of(const Lag& lag, std::size_t i, const MotionRow& row, std::size_t& at) {
    const double x = (row.time + lag.clock(i) - lag.origin()) / lag.h();
    const long interval =
        std::clamp<long>(static_cast<long>(std::floor(x + 1e-9)), 0, kBlock * lag.end() - 1);
    at = static_cast<std::size_t>(interval);
    return lag.basis().basis(x - static_cast<double>(interval), lag.about().motion[i].derivative);
  }

  // Normal equations of one stream in its stated noise.
  void gather(Lag& lag, std::size_t i, std::size_t N, SizeSums::Groups& count, SizeSums::Groups& spread) {
    const MotionStream& stream = lag.about().motion[i];
    for (std::size_t j = 0; j < kComponents; ++j) {
      std::fill_n(data_[i][j].begin(), kLocal * N, 0.0);
      std::fill_n(right_[i][j].begin(), N, 0.0);
    }
    Ring<MotionRow>& rows = lag.motion(i);
    for (long k = rows.begin(); k < rows.end(); ++k) {
      const MotionRow& row = rows[k];
      std::size_t at = 0;
      const Basis b = basis_of(lag, i, row, at);
      for (std::size_t j = 0; j < kComponents; ++j) {
        if (row.have[j] == 0.0) continue;
        const double sigma = stream.sigma[static_cast<int>(j)], v = row.size / (sigma * sigma);
        for (std::size_t a = 0; a < kLocal; ++a) {
          const double x = v * b[static_cast<int>(a)];
          for (std::size_t c = 0; c <= a; ++c)
            data_[i][j][(at + c) * kLocal + a - c] += x * b[static_cast<int>(c)];
          right_[i][j][at + a] += x * row.value[j];
        }
        const auto group = static_cast<std::size_t>(stream.group[static_cast<int>(j)]);
        count[group] += 1.0 + row.spared;
        spread[group] += row.remainder[j] / (sigma * sigma);
      }
    }
  }

  // H_ = L L^T in place, its log determinant.
  double factor(std::size_t N) {
    double sum = 0.0;
    for (std::size_t j = 0; j < N; ++j) {
      double* column = H_.data() + j * kLocal;
      if (!(column[0] > 0.0)) return std::nan("");
      column[0] = std::sqrt(column[0]);
      sum += std::log(column[0]);
      const std::size_t below = std::min<std::size_t>(kLocal - 1, N - 1 - j);
      for (std::size_t i = 1; i <= below; ++i) column[i] /= column[0];
      for (std::size_t k = 1; k <= below; ++k)
        for (std::size_t i = k; i <= below; ++i) column[k * kLocal + i - k] -= column[i] * column[k];
    }
    return 2.0 * sum;
  }
  void solve(std::size_t N) {
    for (std::size_t j = 0; j < N; ++j) {
      x_[j] /= H_[j * kLocal];
      for (std::size_t i = 1; i < kLocal && j + i < N; ++i) x_[j + i] -= H_[j * kLocal + i] * x_[j];
    }
    for (std::size_t j = N; j-- > 0;) {
      for (std::size_t i = 1; i < kLocal && j + i < N; ++i) x_[j] -= H_[j * kLocal + i] * x_[j + i];
      x_[j] /= H_[j * kLocal];
    }
  }
  // The band of the inverse (Takahashi).
  void invert(std::size_t N) {
    for (std::size_t j = N; j-- > 0;) {
      const std::size_t last = std::min(N - 1, j + kLocal - 1);
      const double* column = H_.data() + j * kLocal;
      for (std::size_t i = last + 1; i-- > j;) {
        double sum = i == j ? 1.0 / column[0] : 0.0;
        for (std::size_t k = j + 1; k <= last; ++k)
          sum -= column[k - j] * (i >= k ? inverse_[k * kLocal + i - k] : inverse_[i * kLocal + k - i]);
        inverse_[j * kLocal + i - j] = sum / column[0];
      }
    }
  }
  double inner(const std::vector<double>& band, std::size_t N) const {
    double sum = 0.0;
    for (std::size_t j = 0; j < N; ++j)
      for (std::size_t i = 0; i < kLocal && j + i < N; ++i)
        sum += (i == 0 ? 1.0 : 2.0) * band[j * kLocal + i] * inverse_[j * kLocal + i];
    return sum;
  }
};

}  // namespace truewrench
