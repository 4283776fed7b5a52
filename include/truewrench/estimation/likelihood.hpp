// What a fit costs: -2 log L (10.7), by which fits are compared, and the terms of it that a step must lower.
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <cmath>

namespace truewrench {

inline double Fit::objective() const {
  double sum = 0.0;
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    const Sizes& z = logs_[l].sizes;
    for (const Stretch& s : logs_[l].stretches) {
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
        if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
        const double x = chi2(l, s, k);
        sum += s.raw.size[k] * (robust ? robust_sum(s.raw.channels[k], x) : x);
      }
      for (std::size_t i = 0; i < s.motion.size(); ++i) {
        const MotionStream& stream = logs_[l].log->motion[i];
        for (int j = 0; j < s.components(); ++j) {
          const double sigma_j = stream.sigma[j] * z.motion_factor[i][stream.group[j]];
          sum += s.motion[i].squares(j) / (sigma_j * sigma_j);
        }
      }
      for (int j = 0; j < s.components(); ++j)
        sum += s.spline.smoothness(smoothness_order(logs_[l].log->source, j)).quadratic(s.c, j) / z.q[j];
      if (z.form != Form::none) {
        const Penalty R = s.spline.discrepancy(z.k, z.form);
        for (int i = 0; i < n_; ++i) {
          const double delta = z.delta[raw_group(i, n_)];
          sum += R.quadratic(s.e, i) / (delta * delta);
        }
      }
    }
  }
  for (Eigen::Index i = 0; i < layout_.size(); ++i)
    if (active[static_cast<std::size_t>(i)] != 0) {
      const double d = theta[i] - layout_.mean()[i];
      sum += d * d / prior[i];
    }
  return sum;
}

inline double Fit::likelihood() const {
  double sum = objective() + log_determinant();
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    const Sizes& z = logs_[l].sizes;
    for (const Stretch& s : logs_[l].stretches) {
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
        if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
        for (int i = 0; i < n_; ++i)
          if (std::isfinite(s.raw.value(k, i))) sum += 2.0 * s.raw.size[k] * std::log(sigma(l, i));
      }
      for (std::size_t i = 0; i < s.motion.size(); ++i) {
        const MotionStream& stream = logs_[l].log->motion[i];
        for (int j = 0; j < s.components(); ++j)
          sum +=
              2.0 * std::log(stream.sigma[j] * z.motion_factor[i][stream.group[j]]) * s.motion[i].samples[j];
      }
      const auto N = static_cast<double>(s.spline.size());
      for (int j = 0; j < s.components(); ++j) {
        const int p = smoothness_order(logs_[l].log->source, j);
        sum += (N - p) * std::log(z.q[j]) - s.spline.smoothness_logdet(p);
      }
      if (z.form == Form::none) continue;
      for (int i = 0; i < n_; ++i) sum += 2.0 * N * std::log(z.delta[raw_group(i, n_)]);
      sum -= n_ * s.spline.logdet(s.spline.discrepancy(z.k, z.form));
    }
  }
  for (const int i : active_places()) sum += std::log(prior[i]);
  return sum;
}

inline Eigen::VectorXd Fit::slope_of_determinant(const std::vector<int>& places) {
  const auto determinant = [this] {
    double sum = 0.0;
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      LogFit& log = logs_[l];
      std::vector<double> found(log.stretches.size());
      parallel_for(found.size(), threads_, [&](std::size_t i) {
        Stretch& s = log.stretches[i];
        s.predict(layout_.log(l), local(l), lagged, log.sizes.form != Form::none);
        found[i] = log.sweeps[i]
                       .forward(s, layout_.log(l), local(l), lagged, log.sizes, Sweep::Extent::determinant)
                       .logdet;
      });
      for (const double x : found) sum += x;
    }
    return sum;
  };
  const double here = determinant();
  Eigen::VectorXd out = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(places.size()));
  for (std::size_t i = 0; i < places.size(); ++i) {
    double& x = theta[places[i]];
    const double from = x, by = constants::move * std::sqrt(P_(places[i], places[i]));
    if (by == 0.0) continue;  // held
    x += by;
    out[static_cast<Eigen::Index>(i)] = (determinant() - here) / by;
    x = from;
  }
  predict();
  release();
  return out;
}

}  // namespace truewrench
