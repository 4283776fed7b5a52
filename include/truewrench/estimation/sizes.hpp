// The sizes of one log's nuisances (METHOD 10.2), and which rows and components share one.
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/math/spline.hpp"
#include "truewrench/model/record.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace truewrench {

struct Sizes {
  Eigen::VectorXd raw_factor;  // on the stated noise: force and moment channels, else all together
  std::vector<Eigen::VectorXd> motion_factor;  // of each stream's groups
  Eigen::VectorXd q;                           // (M) of (10.1)
  Eigen::VectorXd delta;                       // as raw_factor: of (10.2)
  double k = 1.0;                              // 1 / tau
  Form form = Form::none;
  Eigen::VectorXd cap;  // of delta
};

inline int raw_groups(int channels) { return channels == 6 ? 2 : 1; }
inline int raw_group(int channel, int channels) { return channels == 6 && channel >= 3 ? 1 : 0; }

// Where a fit of a log begins (10.6).
inline Sizes starting_sizes(const RecordedLog& log, int channels) {
  Sizes out;
  const int groups = raw_groups(channels);
  out.raw_factor = Eigen::VectorXd::Ones(groups);
  for (const MotionStream& m : log.motion)
    out.motion_factor.push_back(Eigen::VectorXd::Ones(m.group.maxCoeff() + 1));
  out.q = Eigen::VectorXd::Constant(log.components(), constants::smoothness_start);
  out.delta = Eigen::VectorXd::Zero(groups);
  out.cap = Eigen::VectorXd::Constant(groups, std::numeric_limits<double>::infinity());
  return out;
}

// p of (10.1) for a component of the motion spline (METHOD 10.1, 10.6).
inline int smoothness_order(Source source, int component) {
  if (source == Source::mapped) return 4;
  return source == Source::imu && component < 3 ? 2 : 3;
}

// q of a component by (10.6), from e^T R e and what is left of its coefficients; at least so much that the rows of R stay within
// bounds beside a sample's own: where nothing moved q would fall until nothing could be factored. Of a motion that is nearly the
// polynomial which R leaves free, less than one coefficient is left.
inline double smoothness_found(const RecordedLog& log, int component, double h, double energy, double left) {
  double sample = std::numeric_limits<double>::infinity();
  for (const MotionStream& m : log.motion)
    sample = std::min(sample, std::pow(m.sigma[component] * std::pow(h, m.derivative), 2.0));
  return std::max(
      energy / std::max(left, 1e-3),
      constants::smoothness_least * sample * std::pow(h, 1 - 2 * smoothness_order(log.source, component)));
}

// What such a step does: to log q, but no more than to (10.7), whose derivative in log q is left - energy / q.
inline double smoothness_move(double ratio, double q, double energy, double left) {
  return std::min(std::abs(std::log(ratio)), std::abs(energy / q - left));
}

// (10.6) of one factor on noise, from squares in the stated sigma, rows, and how many of them the fit used; returns its move. Held
// where nothing is left to find it by.
inline double resize_factor(double& factor, double squares, double rows, double used) {
  if (rows - used < constants::fewest_freedom) return 0.0;
  const double to = std::max(std::sqrt(squares / (rows - used)), constants::size_floor);
  const double ratio = std::clamp(to / factor, 0.2, 5.0);
  factor *= ratio;
  return std::abs(std::log(ratio));
}

// And of one q; its move as a standard deviation.
inline double resize_smoothness(Sizes& sizes, const RecordedLog& log, int component, double h, double energy,
                                double left) {
  double& q = sizes.q[component];
  const double ratio = std::clamp(smoothness_found(log, component, h, energy, left) / q, 1e-3, 1e3);
  const double move = 0.5 * smoothness_move(ratio, q, energy, left);
  q *= ratio;
  return move;
}

}  // namespace truewrench
