// START of METHOD 10.3: the motion from its own measurements alone, and its roughest.
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/math/banded.hpp"
#include "truewrench/math/dense.hpp"

#include <algorithm>
#include <limits>
#include <numbers>

namespace truewrench {

// Fit the motion alone: coefficients, q and the factors of the motion's noise, with clocks and biases at their means; the
// noise held for 8 steps, else q may end in a wrong optimum. Returns -2 log L (10.7) of the motion.
inline double motion_alone(LogFit& log, const Layout& layout, std::size_t l) {
  constexpr int held = 8, most = 80;
  const RecordedLog& recorded = *log.log;
  const int M = recorded.components();
  const auto streams = recorded.motion.size();
  struct Rows {
    std::vector<Eigen::Index> interval;
    std::vector<Basis> basis;
    Bands A;                // sum B B^T / stated^2
    std::vector<double> b;  // (N + 5, lanes)
  };
  struct Work {
    std::vector<Rows> rows;
    Bands R, H, inverse;
    std::vector<double> x;
  };
  std::vector<Work> work(log.stretches.size());
  std::vector<Eigen::VectorXd> count;
  count.reserve(streams);
  for (std::size_t i = 0; i < streams; ++i)
    count.push_back(Eigen::VectorXd::Zero(log.sizes.motion_factor[i].size()));
  double held_deviance = 0.0;  // what of (10.7) no size changes
  for (std::size_t s_ = 0; s_ < log.stretches.size(); ++s_) {
    const Stretch& s = log.stretches[s_];
    Work& w = work[s_];
    w.R = w.H = w.inverse = Bands(s.spline.size(), M);
    const int lanes = w.R.lanes;
    w.x.resize(static_cast<std::size_t>((s.spline.size() + kDegree5) * lanes));
    for (int j = 0; j < M; ++j) {
      const int p = smoothness_order(recorded.source, j);
      const Gram local = s.spline.smoothness(p).inside;
      held_deviance -= s.spline.smoothness_logdet(p);
      for (Eigen::Index i = 0; i < s.spline.intervals(); ++i)
        for (int k = 0; k < kLocal; ++k)
          for (int h = 0; h <= k; ++h) w.R.at(i + h, k - h)[j] += local(k, h);
    }
    w.rows.resize(streams);
    for (std::size_t i = 0; i < streams; ++i) {
      const MotionRows& m = s.motion[i];
      const MotionStream& stream = recorded.motion[i];
      const double late =
          layout.mean()[layout.log(l).global[static_cast<std::size_t>(layout.log(l).clock[i])]];
      Rows& r = w.rows[i];
      r.A = Bands(s.spline.size(), M);
      r.b.assign(w.x.size(), 0.0);
      r.interval.resize(static_cast<std::size_t>(m.rows()));
      r.basis.resize(r.interval.size());
      double v[max_components] = {}, y[max_components] = {};
      for (Eigen::Index k = 0; k < m.rows(); ++k) {
        double u = 0.0;
        const auto ku = static_cast<std::size_t>(k);
        const Eigen::Index at = r.interval[ku] = s.spline.locate(m.time[k] + late, u);
        const Basis& b = r.basis[ku] = s.spline.basis(u, stream.derivative);
        for (int j = 0; j < M; ++j) {
          const bool here = std::isfinite(m.value(k, j));
          v[j] = here ? m.size[k] / (stream.sigma[j] * stream.sigma[j]) : 0.0;
          y[j] = here ? v[j] * m.value(k, j) : 0.0;
        }
        for (int h = 0; h < kLocal; ++h) {
          dense::add(r.b.data() + (at + h) * lanes, b[h], y, lanes);
          for (int g = h; g < kLocal; ++g) dense::add(r.A.at(at + h, g - h), b[h] * b[g], v, lanes);
        }
      }
      for (int j = 0; j < M; ++j) count[i][stream.group[j]] += m.samples[j];
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
    double energy[max_components] = {}, trace[max_components] = {}, size[max_components] = {};
    for (std::size_t s_ = 0; s_ < log.stretches.size(); ++s_) {
      Stretch& s = log.stretches[s_];
      Work& w = work[s_];
      const int lanes = w.R.lanes;
      double weight[max_components], most_diagonal[max_components] = {};
      for (int j = 0; j < lanes; ++j) weight[j] = j < M ? 1.0 / z.q[j] : 0.0;
      for (std::size_t at = 0; at < w.R.a.size(); at += static_cast<std::size_t>(lanes))
        for (int j = 0; j < lanes; ++j)
          w.H.a[at + static_cast<std::size_t>(j)] = weight[j] * w.R.a[at + static_cast<std::size_t>(j)];
      std::fill(w.x.begin(), w.x.end(), 0.0);
      for (std::size_t i = 0; i < streams; ++i) {
        for (int j = 0; j < M; ++j)
          weight[j] = std::pow(z.motion_factor[i][recorded.motion[i].group[j]], -2.0);
        for (std::size_t at = 0; at < w.R.a.size(); at += static_cast<std::size_t>(lanes))
          for (int j = 0; j < lanes; ++j)
            w.H.a[at + static_cast<std::size_t>(j)] +=
                weight[j] * w.rows[i].A.a[at + static_cast<std::size_t>(j)];
        for (std::size_t at = 0; at < w.x.size(); at += static_cast<std::size_t>(lanes))
          for (int j = 0; j < lanes; ++j)
            w.x[at + static_cast<std::size_t>(j)] +=
                weight[j] * w.rows[i].b[at + static_cast<std::size_t>(j)];
      }
      for (Eigen::Index k = 0; k < w.H.size; ++k)
        for (int j = 0; j < lanes; ++j) {
          if (j >= M) w.H.at(k, 0)[j] = 1.0;
          most_diagonal[j] = std::max(most_diagonal[j], w.H.at(k, 0)[j]);
        }
      for (Eigen::Index k = 0; k < w.H.size; ++k)  // where no sample lies for a few knots
        for (int j = 0; j < lanes; ++j) w.H.at(k, 0)[j] += 1e-14 * most_diagonal[j];
      if (!w.H.factor()) return std::nan("");
      w.H.solve(w.x);
      w.H.inverse(w.inverse);
      w.R.inner(w.inverse, trace);
      for (Eigen::Index k = 0; k < s.c.rows(); ++k)
        std::copy_n(w.x.data() + k * lanes, M, s.c.data() + k * M);
      for (int j = 0; j < M; ++j) {
        const int p = smoothness_order(recorded.source, j);
        energy[j] += s.spline.smoothness(p).quadratic(s.c, j);
        size[j] += static_cast<double>(s.spline.size() - p);
      }
      for (std::size_t i = 0; i < streams; ++i) {
        const MotionStream& stream = recorded.motion[i];
        const MotionRows& m = s.motion[i];
        const Rows& r = w.rows[i];
        double squares[max_components] = {}, inner[max_components] = {}, value[max_components];
        for (Eigen::Index k = 0; k < m.rows(); ++k) {
          const auto ku = static_cast<std::size_t>(k);
          Stretch::combine(r.basis[ku].data(), r.interval[ku], s.c, value);
          for (int j = 0; j < M; ++j) {
            const double e = m.value(k, j) - value[j];
            squares[j] += std::isfinite(e) ? m.size[k] * e * e : 0.0;
          }
        }
        for (int j = 0; j < M; ++j) squares[j] += m.remainder[j];
        r.A.inner(w.inverse, inner);
        for (int j = 0; j < M; ++j) {
          const int group = stream.group[j];
          const double f = z.motion_factor[i][group];
          rss[i][group] += squares[j] / (stream.sigma[j] * stream.sigma[j]);
          used[i][group] += inner[j] / (f * f);
        }
      }
    }
    // the sizes that follow, and (10.7) at those that stand
    std::vector<Eigen::VectorXd> factor = z.motion_factor;
    Eigen::VectorXd q = z.q;
    double move = 0.0;
    if (iteration >= held)
      for (std::size_t i = 0; i < streams; ++i)
        for (Eigen::Index r = 0; r < rss[i].size(); ++r) {
          if (count[i][r] - used[i][r] < constants::fewest_freedom) continue;
          const double to =
              std::sqrt(std::max(rss[i][r], 1e-12) / std::max(count[i][r] - used[i][r], 1e-3 * count[i][r]));
          move = std::max(move, 2.0 * std::abs(std::log(to / z.motion_factor[i][r])));
          factor[i][r] = to;
        }
    for (int j = 0; j < M; ++j) {
      const double to = smoothness_found(recorded, j, log.h, energy[j], size[j] - trace[j] / z.q[j]);
      move = std::max(move, std::abs(std::log(to / z.q[j])));
      q[j] *= std::clamp(to / z.q[j], 1e-3, 1e3);
    }
    const bool last = (iteration > held && move < 1e-3) || iteration + 1 == most;
    if (last) {
      deviance = held_deviance;
      for (const Work& w : work)
        for (Eigen::Index k = 0; k < w.H.size; ++k)
          for (int j = 0; j < M; ++j) deviance -= 2.0 * std::log(w.H.at(k, 0)[j]);
      for (int j = 0; j < M; ++j) deviance += energy[j] / z.q[j] + size[j] * std::log(z.q[j]);
      for (std::size_t i = 0; i < streams; ++i) {
        for (Eigen::Index r = 0; r < rss[i].size(); ++r)
          deviance += rss[i][r] / (z.motion_factor[i][r] * z.motion_factor[i][r]);
        const MotionStream& stream = recorded.motion[i];
        for (const Stretch& s : log.stretches)
          for (int j = 0; j < M; ++j)
            deviance += 2.0 * s.motion[i].samples[j] *
                        std::log(z.motion_factor[i][stream.group[j]] * stream.sigma[j]);
      }
    }
    z.motion_factor = factor;
    z.q = q;
    if (last) break;
  }
  return deviance;
}

// q of the roughest motion that its own measurements cannot deny: at half of the knots' rate it is as large as their noise,
// sigma^2 (pi / h)^2(p - d) h with p the order of (10.2) and d that of the stream; noise as stated. (10.7) has an optimum where
// what the motion's noise covers counts as noise of the sensor, and another where the sensor tells it: 20 Hz ripple, 0.7 sigma
// of the velocities, was 15 to 30 x the noise of the forces in the first.
inline void roughen(Fit& fit) {
  for (LogFit& log : fit.logs()) {
    const double rate = std::numbers::pi / log.h;
    for (auto& f : log.sizes.motion_factor) f.setOnes();
    for (int j = 0; j < log.log->components(); ++j) {
      const int p = smoothness_order(log.log->source, j);
      double least = std::numeric_limits<double>::infinity();
      for (const MotionStream& m : log.log->motion)
        least = std::min(least, m.sigma[j] * std::pow(rate, p - m.derivative));
      log.sizes.q[j] = least * least * log.h;
    }
  }
}

}  // namespace truewrench
