// START of METHOD 10.3: the motion from its own measurements alone, then gain and offset by a robust regression.
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/math/banded.hpp"

#include <algorithm>

namespace truewrench {

// Fit the motion alone: coefficients, q and the factors of the motion's noise, with clocks and biases at their means; the
// noise held for 8 steps, else q may end in a wrong optimum. Returns -2 log L (10.7) of the motion.
inline double motion_alone(LogFit& log, const Layout& layout, std::size_t l, int most = 80) {
  const RecordedLog& recorded = *log.log;
  const int M = recorded.components();
  const auto streams = recorded.motion.size();
  struct Rows {
    std::vector<Eigen::Index> interval;
    std::vector<Basis> basis;
    std::vector<Banded> A;  // sum B B^T / stated^2, a component
    RowMatrix b;            // (N, M)
  };
  std::vector<std::vector<Rows>> rows(log.stretches.size(), std::vector<Rows>(streams));
  std::vector<Eigen::VectorXd> count;
  for (std::size_t i = 0; i < streams; ++i) count.push_back(Eigen::VectorXd::Zero(log.sizes.motion_factor[i].size()));
  std::vector<std::vector<Banded>> R(log.stretches.size());
  for (std::size_t s_ = 0; s_ < log.stretches.size(); ++s_) {
    const Stretch& s = log.stretches[s_];
    for (int j = 0; j < M; ++j) {
      R[s_].emplace_back(s.spline.size());
      const Gram local = s.spline.smoothness(smoothness_order(recorded.source, j)).inside;
      for (Eigen::Index i = 0; i < s.spline.intervals(); ++i) R[s_].back().add(i, local);
    }
    for (std::size_t i = 0; i < streams; ++i) {
      const MotionRows& m = s.motion[i];
      const MotionStream& stream = recorded.motion[i];
      const double late = layout.mean()[layout.log(l).global[static_cast<std::size_t>(layout.log(l).clock[i])]];
      Rows& r = rows[s_][i];
      r.A.assign(static_cast<std::size_t>(M), Banded(s.spline.size()));
      r.b = RowMatrix::Zero(s.spline.size(), M);
      for (Eigen::Index k = 0; k < m.size(); ++k) {
        double u = 0.0;
        r.interval.push_back(s.spline.locate(m.time[k] + late, u));
        r.basis.push_back(s.spline.basis(u, stream.derivative));
        const Gram outer = r.basis.back() * r.basis.back().transpose();
        for (int j = 0; j < M; ++j) {
          if (!std::isfinite(m.value(k, j))) continue;
          const double v = 1.0 / (stream.sigma[j] * stream.sigma[j]);
          r.A[static_cast<std::size_t>(j)].add(r.interval.back(), v * outer);
          r.b.col(j).segment(r.interval.back(), kLocal) += v * m.value(k, j) * r.basis.back();
          count[i][stream.group[j]] += 1.0;
        }
      }
    }
  }
  Sizes& z = log.sizes;
  z.q.setConstant(constants::smoothness_start);
  for (auto& f : z.motion_factor) f.setOnes();
  double deviance = 0.0;
  for (int iteration = 0; iteration < most; ++iteration) {
    std::vector<Eigen::VectorXd> rss, used;
    for (const auto& f : z.motion_factor)
      for (auto* v : {&rss, &used}) v->push_back(Eigen::VectorXd::Zero(f.size()));
    Eigen::VectorXd energy = Eigen::VectorXd::Zero(M), trace = energy, size = energy;
    deviance = 0.0;
    for (std::size_t s_ = 0; s_ < log.stretches.size(); ++s_) {
      Stretch& s = log.stretches[s_];
      for (int j = 0; j < M; ++j) {
        const auto ju = static_cast<std::size_t>(j);
        Banded H(s.spline.size());
        H.a = R[s_][ju].a / z.q[j];
        Eigen::VectorXd x = Eigen::VectorXd::Zero(s.spline.size());
        for (std::size_t i = 0; i < streams; ++i) {
          const double f = z.motion_factor[i][recorded.motion[i].group[j]];
          H.a += rows[s_][i].A[ju].a / (f * f);
          x += rows[s_][i].b.col(j) / (f * f);
        }
        H.a.row(0).array() += 1e-14 * H.a.row(0).maxCoeff();  // where no sample lies for a few knots
        if (!H.factor()) return std::nan("");
        H.solve(x);
        s.c.col(j) = x;
        const Eigen::MatrixXd inverse = H.inverse();
        const int p = smoothness_order(recorded.source, j);
        const double bend = s.spline.smoothness(p).quadratic(s.c, j);
        energy[j] += bend;
        trace[j] += banded_inner(R[s_][ju].a, inverse);
        size[j] += static_cast<double>(s.spline.size() - p);
        deviance += H.logdet() + bend / z.q[j] + static_cast<double>(s.spline.size() - p) * std::log(z.q[j]) -
                    s.spline.smoothness_logdet(p);
        for (std::size_t i = 0; i < streams; ++i) {
          const MotionStream& stream = recorded.motion[i];
          const MotionRows& m = s.motion[i];
          const Rows& r = rows[s_][i];
          const int group = stream.group[j];
          const double f = z.motion_factor[i][group];
          double sum = 0.0, n = 0.0;
          for (Eigen::Index k = 0; k < m.size(); ++k) {
            if (!std::isfinite(m.value(k, j))) continue;
            const auto ku = static_cast<std::size_t>(k);
            const double e = m.value(k, j) - r.basis[ku].dot(x.segment(r.interval[ku], kLocal));
            sum += e * e;
            n += 1.0;
          }
          sum /= stream.sigma[j] * stream.sigma[j];
          rss[i][group] += sum;
          used[i][group] += banded_inner(r.A[ju].a, inverse) / (f * f);
          deviance += sum / (f * f) + 2.0 * n * std::log(f * stream.sigma[j]);
        }
      }
    }
    double move = 0.0;
    if (iteration >= 8)
      for (std::size_t i = 0; i < streams; ++i)
        for (Eigen::Index r = 0; r < rss[i].size(); ++r) {
          if (count[i][r] <= 0.0) continue;
          const double to = std::sqrt(std::max(rss[i][r], 1e-12) / std::max(count[i][r] - used[i][r], 1e-3 * count[i][r]));
          move = std::max(move, 2.0 * std::abs(std::log(to / z.motion_factor[i][r])));
          z.motion_factor[i][r] = to;
        }
    for (int j = 0; j < M; ++j) {
      const double to = std::max(energy[j], 1e-16) / std::max(size[j] - trace[j] / z.q[j], 1.0);
      move = std::max(move, std::abs(std::log(to / z.q[j])));
      z.q[j] *= std::clamp(to / z.q[j], 1e-3, 1e3);
    }
    if (iteration > 8 && move < 1e-3) break;
  }
  return deviance;
}

// Gain and offsets by regression of raw on w, with the prior: Cauchy weights (1 + n) / (1 + chi^2_n), scale 1.48 median and at
// least the stated sigma; or plain (`cauchy` false, the second start of finer levels).
inline void regress(Fit& fit, bool cauchy) {
  const int n = fit.channels();
  const Layout& layout = fit.layout();
  fit.predict();
  const auto logs = fit.logs().size();
  std::vector<int> offset_of(logs);  // place in theta of the offset of each log
  for (std::size_t l = 0; l < logs; ++l) offset_of[l] = layout.log(l).global[static_cast<std::size_t>(layout.log(l).b)];
  std::vector<int> offsets = offset_of;
  offsets.erase(std::unique(offsets.begin(), offsets.end()), offsets.end());
  const auto m = static_cast<Eigen::Index>(offsets.size());
  RowMatrix scale(static_cast<Eigen::Index>(logs), n);
  for (std::size_t l = 0; l < logs; ++l)
    for (int i = 0; i < n; ++i) scale(static_cast<Eigen::Index>(l), i) = fit.rig().noise[i];
  const RowMatrix stated = scale;
  std::vector<std::vector<double>> weight(logs);
  for (std::size_t l = 0; l < logs; ++l)
    for (const Stretch& s : fit.logs()[l].stretches) weight[l].resize(weight[l].size() + static_cast<std::size_t>(s.raw.size()), 1.0);
  RowMatrix found = RowMatrix::Zero(n, 6 + m);
  for (int round = 0; round < (cauchy ? 15 : 1); ++round) {
    for (int i = 0; i < n; ++i) {
      Eigen::MatrixXd A = Eigen::MatrixXd::Zero(6 + m, 6 + m);
      Eigen::VectorXd b = Eigen::VectorXd::Zero(6 + m);
      for (int k = 0; k < 6; ++k) A(k, k) = 1.0 / fit.prior[layout.C + 6 * i + k];
      for (Eigen::Index o = 0; o < m; ++o) A(6 + o, 6 + o) = 1.0 / fit.prior[offsets[static_cast<std::size_t>(o)] + i];
      const Vector6 nominal = fit.rig().nominal.row(i);
      for (std::size_t l = 0; l < logs; ++l) {
        const Eigen::Index o =
            6 + std::distance(offsets.begin(), std::find(offsets.begin(), offsets.end(), offset_of[l]));
        const double v = std::pow(scale(static_cast<Eigen::Index>(l), i), -2.0);
        std::size_t row = 0;
        for (const Stretch& s : fit.logs()[l].stretches)
          for (Eigen::Index k = 0; k < s.raw.size(); ++k, ++row) {
            if (s.raw.masked[static_cast<std::size_t>(k)] != 0 || !std::isfinite(s.raw.value(k, i))) continue;
            const double x = v * weight[l][row];
            const Vector6 w = s.now.w.row(k);
            const double y = s.raw.value(k, i) - nominal.dot(w);
            A.topLeftCorner<6, 6>() += x * w * w.transpose();
            A.row(o).head<6>() += x * w.transpose();
            A.col(o).head<6>() += x * w;
            A(o, o) += x;
            b.head<6>() += x * y * w;
            b[o] += x * y;
          }
      }
      found.row(i) = A.llt().solve(b);
      found.row(i).head<6>() += nominal.transpose();
    }
    if (!cauchy) break;
    for (std::size_t l = 0; l < logs; ++l) {
      const Eigen::Index o = 6 + std::distance(offsets.begin(), std::find(offsets.begin(), offsets.end(), offset_of[l]));
      std::vector<Eigen::VectorXd> residuals;
      std::vector<std::vector<double>> sizes(static_cast<std::size_t>(n));
      for (const Stretch& s : fit.logs()[l].stretches)
        for (Eigen::Index k = 0; k < s.raw.size(); ++k) {
          Eigen::VectorXd r = s.raw.value.row(k).transpose() - found.leftCols<6>() * s.now.w.row(k).transpose() - found.col(o);
          for (int i = 0; i < n; ++i)
            if (std::isfinite(r[i]) && s.raw.masked[static_cast<std::size_t>(k)] == 0)
              sizes[static_cast<std::size_t>(i)].push_back(std::abs(r[i]));
          residuals.push_back(std::move(r));
        }
      for (int i = 0; i < n; ++i) {
        auto& v = sizes[static_cast<std::size_t>(i)];
        if (v.empty()) continue;
        const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
        std::nth_element(v.begin(), middle, v.end());
        scale(static_cast<Eigen::Index>(l), i) = std::max(1.48 * *middle, stated(static_cast<Eigen::Index>(l), i));
      }
      for (std::size_t row = 0; row < residuals.size(); ++row) {
        double chi2 = 0.0;
        int channels = 0;
        for (int i = 0; i < n; ++i) {
          if (!std::isfinite(residuals[row][i])) continue;
          const double z = residuals[row][i] / scale(static_cast<Eigen::Index>(l), i);
          chi2 += z * z;
          ++channels;
        }
        weight[l][row] = (1.0 + channels) / (1.0 + chi2);
      }
    }
  }
  for (int i = 0; i < n; ++i) {
    fit.theta.segment<6>(layout.C + 6 * i) = found.row(i).head<6>();
    for (Eigen::Index o = 0; o < m; ++o) fit.theta[offsets[static_cast<std::size_t>(o)] + i] = found(i, 6 + o);
  }
  if (!cauchy) return;
  for (std::size_t l = 0; l < logs; ++l) {
    Eigen::VectorXd& factor = fit.logs()[l].sizes.raw_factor;
    factor.setZero();
    for (int i = 0; i < n; ++i) {
      double& f = factor[raw_group(i, n)];
      f = std::max(f, scale(static_cast<Eigen::Index>(l), i) / stated(static_cast<Eigen::Index>(l), i));
    }
  }
}

}  // namespace truewrench
