// START (METHOD 10.3) on the blocks of a lag, on memory of its own.
#pragma once

#include "truewrench/estimation/lag.hpp"
#include "truewrench/estimation/motion_alone.hpp"
#include "truewrench/estimation/regression.hpp"

#include <algorithm>
#include <cmath>

namespace truewrench {

class LagStart {
 public:
  LagStart() = default;
  LagStart(int blocks, int channels) {
    motion_.reserve(kBlock * (blocks + 1), kComponents, kMostStreams);
    regression_.reserve(static_cast<std::size_t>(kMostRows * kBlock * (blocks + 1)), channels);
  }

  // Of all blocks.
  static Spline spline(const Lag& lag) {
    const auto intervals = static_cast<double>(kBlock * lag.end());
    return {lag.origin(), lag.h() * intervals, lag.h()};
  }

  // Coefficients, q and the factors of the motion's noise, clocks at their means; -2 log L (10.7) of the motion.
  double motion_alone(Lag& lag) {
    MotionAlone::Part& part = motion_.parts[0];
    motion_.begin(part, spline(lag), lag.about());
    for (std::size_t i = 0; i < lag.streams(); ++i) {
      const Ring<MotionRow>& rows = lag.motion(i);
      for (long k = rows.begin(); k < rows.end(); ++k)
        for (std::size_t j = 0; j < kComponents; ++j) {
          if (rows[k].have[j] == 0.0) continue;
          const double sigma = lag.about().motion[i].sigma[static_cast<int>(j)];
          part.samples[i][j] += 1.0 + rows[k].spared;
          part.remainder[i][j] += rows[k].remainder[j] / (sigma * sigma);
        }
    }
    const double deviance =
        motion_.fit(lag.about(), lag.h(), lag.sizes, [&](std::size_t, std::size_t i, const auto& visit) {
          const Ring<MotionRow>& rows = lag.motion(i);
          double size[kComponents];
          for (long k = rows.begin(); k < rows.end(); ++k) {
            double u = 0.0;
            const Eigen::Index at = part.spline.locate(rows[k].time + lag.clock(i), u);
            for (std::size_t j = 0; j < kComponents; ++j) size[j] = rows[k].have[j] * rows[k].size;
            visit(at, part.spline.basis(u, lag.about().motion[i].derivative), size, rows[k].value.data());
          }
        });
    for (long knot = 0; knot < kBlock * (lag.end() + 1); ++knot)
      std::copy_n(part.coefficients(knot), kComponents,
                  lag.block(knot / kBlock).x.data() + kComponents * (knot % kBlock));
    return deviance;
  }

  // Gain and offset (theta, raw_factor) by a robust regression; `gain` false: the offset alone. Rows as predicted; prior:
  // variances of theta.
  void regress(Lag& lag, const Eigen::VectorXd& prior, bool gain) {
    const int n = lag.channels(), C = lag.columns().C, b = lag.columns().b;
    const Statement& rig = lag.rig();
    regression_.begin(n);
    regression_.begin_log(0, rig.noise);
    Channels raw, remainder;
    for (long i = 0; i < kBlock * lag.end(); ++i) {
      const Lag::Interval& v = lag.interval(i);
      for (int r = 0; r < v.rows; ++r) {
        const RawRow& row = v.row[static_cast<std::size_t>(r)];
        for (std::size_t c = 0; c < static_cast<std::size_t>(n); ++c) {
          raw[c] = row.has(static_cast<int>(c)) ? row.value[c] : std::nan("");
          remainder[c] = row.gathered ? v.remainder[c] * row.size / (v.spared + kNodes) : 0.0;
        }
        regression_.add(row.w.data(), raw.data(), remainder.data(), row.size);
      }
    }
    const double* from = gain ? rig.nominal.data() : lag.theta.data() + C;
    const auto prior_of = [&](int i, int k) {
      return k == 6 ? prior[b + i] : gain ? prior[C + 6 * i + k] : 1e-30;
    };
    if (!regression_.fit(from, rig.noise, prior_of)) return;
    lag.sizes.raw_factor.setZero();
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < 6; ++k) lag.theta[C + 6 * i + k] = regression_.found(i, k);
      lag.theta[b + i] = regression_.found(i, 6);
      double& f = lag.sizes.raw_factor[raw_group(i, n)];
      f = std::max(f, regression_.scale(0, i) / rig.noise[i]);
    }
  }

 private:
  MotionAlone motion_;
  Regression regression_;
};

}  // namespace truewrench
