// The sizes by marginal likelihood: (10.6), tau, upsilon and alpha.
#pragma once

#include "truewrench/estimation/clocks.hpp"

namespace truewrench {

inline double Fit::resize() {
  double move = 0.0;
  for (std::size_t l = 0; l < logs_.size(); ++l) {
    LogFit& log = logs_[l];
    Sizes& z = log.sizes;
    const Columns& columns = layout_.log(l);
    const Eigen::MatrixXd P = gather(P_, columns.global);
    std::vector<Traces> traces(log.stretches.size());
    parallel_for(traces.size(), threads_,
                 [&](std::size_t i) { traces[i] = log.sweeps[i].traces(log.stretches[i], columns, z, P); });
    // theta's share in the raw rows: what of tr P S is not in the motion's, by whose parameters it is
    Eigen::VectorXd share(P.rows());
    for (Eigen::Index i = 0; i < P.rows(); ++i) share[i] = P.col(i).dot(of_log_[l].S.col(i));
    double motion_share = 0.0;
    for (const Traces& t : traces) motion_share += t.motion_share;
    Eigen::VectorXd of_group = Eigen::VectorXd::Zero(z.raw_factor.size());
    for (int i = 0; i < n_; ++i)
      of_group[raw_group(i, n_)] +=
          share.segment(columns.C + 6 * i, 6).cwiseMax(0.0).sum() + std::max(share[columns.b + i], 0.0);
    const double rest = std::max(0.0, share.sum() - motion_share);
    of_group *= rest / std::max(of_group.sum(), 1e-300);

    Eigen::VectorXd trace = of_group;
    std::vector<Eigen::VectorXd> m_squares, m_count, m_trace;
    for (const auto& f : z.motion_factor)
      for (auto* v : {&m_squares, &m_count, &m_trace}) v->push_back(Eigen::VectorXd::Zero(f.size()));
    Eigen::VectorXd energy = Eigen::VectorXd::Zero(z.q.size()), q_trace = energy, size = energy;
    for (std::size_t s_ = 0; s_ < traces.size(); ++s_) {
      const Stretch& s = log.stretches[s_];
      const Traces& t = traces[s_];
      trace += t.raw;
      for (std::size_t i = 0; i < s.motion.size(); ++i) {
        const MotionStream& stream = log.log->motion[i];
        m_trace[i] += t.motion[i];
        for (int j = 0; j < s.components(); ++j) {
          const int r = stream.group[j];
          m_squares[i][r] += s.motion[i].squares(j) / (stream.sigma[j] * stream.sigma[j]);
          m_count[i][r] += s.motion[i].samples[j];
        }
      }
      for (int j = 0; j < s.components(); ++j) {
        const int p = smoothness_order(log.log->source, j);
        energy[j] += s.spline.smoothness(p).quadratic(s.c, j);
        size[j] += static_cast<double>(s.spline.size() - p);
      }
      q_trace += t.q;
    }
    move = std::max(move, resize_raw(l, trace));
    for (std::size_t i = 0; i < m_squares.size(); ++i)
      for (Eigen::Index r = 0; r < m_squares[i].size(); ++r)
        if (m_count[i][r] > 0.0)
          move = std::max(
              move, resize_factor(z.motion_factor[i][r], m_squares[i][r], m_count[i][r], m_trace[i][r]));
    for (int j = 0; j < z.q.size(); ++j)
      move =
          std::max(move, resize_smoothness(z, *log.log, j, log.h, energy[j], size[j] - q_trace[j] / z.q[j]));
    if (z.form == Form::none || z.form == Form::bridge) continue;
    Eigen::VectorXd d_energy = Eigen::VectorXd::Zero(z.delta.size()), d_trace = d_energy, d_size = d_energy;
    for (std::size_t s_ = 0; s_ < traces.size(); ++s_) {
      const Stretch& s = log.stretches[s_];
      const Penalty R = s.spline.discrepancy(z.k, z.form);
      for (int i = 0; i < n_; ++i) {
        const int r = raw_group(i, n_);
        d_energy[r] += R.quadratic(s.e, i);
        d_size[r] += static_cast<double>(s.spline.size());
        d_trace[r] += R.inside.cwiseProduct(traces[s_].inside[static_cast<std::size_t>(i)]).sum() +
                      R.start.cwiseProduct(traces[s_].start[static_cast<std::size_t>(i)]).sum();
      }
    }
    for (Eigen::Index r = 0; r < z.delta.size(); ++r) {
      const double variance = z.delta[r] * z.delta[r], sigma_r = group_sigma(l, static_cast<int>(r));
      const double ratio = d_energy[r] / variance / std::max(d_size[r] - d_trace[r] / variance, 1e-6);
      double to =
          z.delta[r] * std::sqrt(std::clamp(std::pow(ratio, constants::discrepancy_power), 0.01, 100.0));
      to = std::min(std::max(to, constants::size_floor * sigma_r), z.cap[r]);
      if (std::max(to, z.delta[r]) > 0.1 * sigma_r && to < z.cap[r])
        move = std::max(move, std::abs(std::log(to / z.delta[r])));
      z.delta[r] = to;
    }
    if (z.form == Form::matern) move = std::max(move, resize_tau(log, traces));
  }
  return move;
}

// The factors on the sensor's noise; robust ones with the weights that belong to them.
inline double Fit::resize_raw(std::size_t l, const Eigen::VectorXd& trace) {
  LogFit& log = logs_[l];
  Eigen::VectorXd& factor = log.sizes.raw_factor;
  const Eigen::VectorXd before = factor;
  for (int round = 0; round < (robust ? 20 : 1); ++round) {
    reweigh_log(l);
    Eigen::VectorXd squares = Eigen::VectorXd::Zero(factor.size()), count = squares;
    double samples = 0.0, weights = 0.0, move = 0.0;
    for (const Stretch& s : log.stretches)
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
        if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
        samples += s.raw.size[k];
        weights += s.raw.weight[k];
        for (int i = 0; i < n_; ++i) {
          if (!std::isfinite(s.raw.value(k, i))) continue;
          const double r = s.now.residual(k, i), v = rig_->noise[i];
          squares[raw_group(i, n_)] += s.raw.weight[k] * (r * r + s.raw.spread(k, i)) / (v * v);
          count[raw_group(i, n_)] += s.raw.size[k];
        }
      }
    // In the end 1, as sum w (4 + chi^2) = sum (4 + n_t); on the way there it halves the number of steps (Kent, Tyler and
    // Vardi 1994).
    if (robust && weights > 0.0) squares *= (samples + trace.sum() / constants::freedom) / weights;
    for (Eigen::Index r = 0; r < squares.size(); ++r)
      if (count[r] > 0.0) move = std::max(move, resize_factor(factor[r], squares[r], count[r], trace[r]));
    if (move < 1e-3) break;
  }
  reweigh_log(l);
  return (factor.array() / before.array()).log().abs().maxCoeff();
}

// upsilon and alpha: (10.6) with R = E, exponent 1, to its end at what this linearisation says of the block after its step. With
// the noise's sizes, after the step, u would go on to where the new prior has it by a step of its own.
inline void Fit::resize_blocks() {
  const auto resize_block = [this](int at, double floor) {
    Eigen::MatrixXd told, P = P_.block(at, at, n_, n_);
    double logdet = 0.0;
    if (!dense::invert(P, told, logdet)) return;
    const Eigen::VectorXd pull = dense::times(told, theta.segment(at, n_) + step_.segment(at, n_));
    double size = prior[at];
    told.diagonal().array() -= 1.0 / size;
    for (int round = 0; round < 200; ++round) {
      Eigen::MatrixXd with = told;
      with.diagonal().array() += 1.0 / size;
      if (!dense::invert(with, P, logdet)) return;
      const double freedom = n_ - P.trace() / size;
      const double to =
          std::max(dense::times(P, pull).squaredNorm() / std::max(freedom, 0.05), floor * floor);
      const double ratio = to / size;
      size = to;
      if (std::abs(std::log(ratio)) < 1e-3) break;
    }
    prior.segment(at, n_).setConstant(size);
  };
  resize_block(layout_.u, constants::departure_floor);
  for (std::size_t l = 0; l < logs_.size(); ++l)
    for (const int step : layout_.in_theta(l).steps) resize_block(step, constants::departure_floor);
}

// k <- argmin sum_i [ S_i(k) / rho_i^2 - log |R(k)| ], rho_i^2 = 4 k^3 delta_i^2 held (10.3). Such steps creep along the ridge on
// which rho^2 is the same: two in one direction are followed by their secant. Of 10 drifts none had converged after 25 steps, one
// with tau of 28 lengths of its record.
inline double Fit::resize_tau(LogFit& log, const std::vector<Traces>& traces) {
  Sizes& z = log.sizes;
  const double k3 = 4.0 * z.k * z.k * z.k;
  const auto objective_of = [&](double log_k) {
    const double k = std::exp(log_k), scale = 4.0 * k * k * k;
    double sum = 0.0;
    for (std::size_t s_ = 0; s_ < traces.size(); ++s_) {
      const Stretch& s = log.stretches[s_];
      Penalty R = s.spline.discrepancy(k, Form::matern);
      R.inside *= scale;
      R.start *= scale;
      for (int i = 0; i < n_; ++i) {
        const double delta = z.delta[raw_group(i, n_)];
        sum += (R.quadratic(s.e, i) +
                R.inside.cwiseProduct(traces[s_].inside[static_cast<std::size_t>(i)]).sum() +
                R.start.cwiseProduct(traces[s_].start[static_cast<std::size_t>(i)]).sum()) /
               (k3 * delta * delta);
      }
      sum -= n_ * s.spline.logdet(R);
    }
    return sum;
  };
  const double now = std::log(z.k), d = 0.15;
  const double before = objective_of(now - d), here = objective_of(now), after = objective_of(now + d);
  const double bend = before - 2.0 * here + after;
  const double step = bend > 0.0 ? 0.5 * d * (before - after) / bend
                                 : (before > after ? LogFit::tau_furthest : -LogFit::tau_furthest);
  double taken = step;
  if (log.tau_step * step < 0.0) {  // it turns
    log.tau_limit *= 0.5;
  } else if (log.tau_step * step > 0.0) {  // it goes on
    log.tau_limit = std::min(2.0 * log.tau_limit, LogFit::tau_furthest);
    const double fall = (log.tau_step - step) / log.tau_moved;
    taken = fall > 0.0 ? step / fall : std::copysign(log.tau_limit, step);
  }
  // tau from 2 h to the longest stretch's length: no stretch tells of a longer one
  const double highest = -std::log(2.0 * log.stretches.front().spline.h());
  const double lowest = std::min(-std::log(log.longest()), highest);
  const double to = std::clamp(now + std::clamp(taken, -log.tau_limit, log.tau_limit), lowest, highest);
  log.tau_moved = to - now;
  log.tau_step = step;
  z.k = std::exp(to);
  return std::abs(to - now);
}

}  // namespace truewrench
