// START of METHOD 10.3 of a fit: the motion from its own measurements alone, gain and offsets by it.
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/estimation/motion_alone.hpp"
#include "truewrench/estimation/regression.hpp"

#include <algorithm>

namespace truewrench {

// The motion of a log from its own measurements: ask(alone, rows) finds it, and is answered back.
template <typename Ask>
inline auto motion_by(LogFit& log, const Layout& layout, std::size_t l, const Ask& ask) {
  const RecordedLog& recorded = *log.log;
  const int M = recorded.components();
  MotionAlone alone;
  alone.parts.resize(log.stretches.size());
  for (std::size_t k = 0; k < alone.parts.size(); ++k) {
    MotionAlone::Part& part = alone.parts[k];
    const Stretch& s = log.stretches[k];
    alone.begin(part, s.spline, recorded);
    for (std::size_t i = 0; i < recorded.motion.size(); ++i)
      for (int j = 0; j < M; ++j) {
        const auto ju = static_cast<std::size_t>(j);
        part.samples[i][ju] = s.motion[i].samples[j];
        part.remainder[i][ju] = s.motion[i].remainder[j] * std::pow(recorded.motion[i].sigma[j], -2.0);
      }
  }
  const Columns& columns = layout.in_theta(l);
  const auto out = ask(alone, [&](std::size_t k, std::size_t i, const auto& visit) {
    const Stretch& s = log.stretches[k];
    const MotionRows& m = s.motion[i];
    double size[max_components], value[max_components];
    for (Eigen::Index row = 0; row < m.rows(); ++row) {
      double u = 0.0;
      const Eigen::Index at = s.spline.locate(m.time[row] + layout.mean()[columns.clock[i]], u);
      for (int j = 0; j < M; ++j) {
        const bool here = std::isfinite(m.value(row, j));
        size[j] = here ? m.size[row] : 0.0;
        value[j] = here ? m.value(row, j) : 0.0;
      }
      visit(at, s.spline.basis(u, recorded.motion[i].derivative), size, value);
    }
  });
  for (std::size_t k = 0; k < alone.parts.size(); ++k) {
    RowMatrix& c = log.stretches[k].c;
    for (Eigen::Index knot = 0; knot < c.rows(); ++knot)
      std::copy_n(alone.parts[k].coefficients(knot), M, c.data() + knot * M);
  }
  return out;
}

// With its q and the factors of its noise; -2 log L (10.7) of the motion.
inline double motion_alone(LogFit& log, const Layout& layout, std::size_t l) {
  return motion_by(log, layout, l, [&](MotionAlone& alone, const auto& rows) {
    return alone.fit(*log.log, log.h, log.sizes, rows);
  });
}

// With q and factors as they stand in the log; false where the rows determine no motion.
inline bool smooth_motion(LogFit& log, const Layout& layout, std::size_t l) {
  return motion_by(log, layout, l, [&](MotionAlone& alone, const auto& rows) {
    return alone.smooth(*log.log, log.sizes, rows);
  });
}

// Gain and offsets of a fit by the motion as it stands: robust, with the scales of the noise.
inline void regress(Fit& fit) {
  fit.predict();
  const int n = fit.channels();
  const Statement& rig = fit.rig();
  Regression regression;
  regression.begin(n);
  std::vector<int> places;  // of offsets in theta
  for (std::size_t l = 0; l < fit.logs().size(); ++l) {
    const int offset = fit.layout().in_theta(l).b;
    if (places.empty() || places.back() != offset) places.push_back(offset);
    regression.begin_log(static_cast<int>(places.size()) - 1, rig.noise);
    for (const Stretch& s : fit.logs()[l].stretches)
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k)
        if (s.raw.masked[static_cast<std::size_t>(k)] == 0)
          regression.add(s.now.w.data() + 6 * k, s.raw.value.data() + n * k,
                         s.raw.size[k] > 1.0 ? s.raw.remainder.data() + n * k : nullptr, s.raw.size[k]);
  }
  const auto place = [&](int i, int k) {
    return k < 6 ? fit.layout().C + 6 * i + k : places[static_cast<std::size_t>(k - 6)] + i;
  };
  if (!regression.fit(rig.nominal.data(), rig.noise, [&](int i, int k) { return fit.prior[place(i, k)]; }))
    return;
  for (int i = 0; i < n; ++i)
    for (int k = 0; k < 6 + regression.offsets(); ++k) fit.theta[place(i, k)] = regression.found(i, k);
  for (std::size_t l = 0; l < fit.logs().size(); ++l) {
    Eigen::VectorXd& factor = fit.logs()[l].sizes.raw_factor;
    factor.setZero();
    for (int i = 0; i < n; ++i) {
      double& f = factor[raw_group(i, n)];
      f = std::max(f, regression.scale(l, i) / rig.noise[i]);
    }
  }
}

}  // namespace truewrench
