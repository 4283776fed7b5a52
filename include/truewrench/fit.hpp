// What the search for a window's knots is told, and what it finds.
#pragma once

#include "truewrench/blocks.hpp"
#include "truewrench/statistics.hpp"

#include <cstdint>
#include <vector>

namespace truewrench {

struct KnotSettings {
  int blocks_per_interval = 12;  // samples of an interval are averaged into this many blocks, if it has more
  double samples_per_coefficient = 2;  // the finest spacing, in periods of the slower stream
  double interval_sigma = 4;  // an interval is halved when its score test exceeds its mean by this much,
  double window_sigma = 3;    // all that exceed their mean, when the window's sum exceeds its own by this
  double residual_sigma = 5;  // or when a stream's residuals on it exceed their noise by this
  double reject_sigma = 5;    // a window is rejected when a stream's residuals exceed their noise by this
  int max_iterations = 12;
  double tolerance = 1e-3;  // remaining decrease of the cost (chi-square units) that counts as converged
  int max_levels = 30;
  double false_disturbances = 0.01;  // disturbances found by chance in a window without any
  double false_pushes = 0.05;        // the same of those that motion and gain have taken up
  double disturbance_price = 40;     // decrease of the cost (chi-square units) that one must be worth
  double hopeless_sigma = 2;         // residuals of a stretch that do not fit; where more stretches than
  double hopeless_share = 0.9;  // this share do not, neither disturbances nor another gain are looked for
  double most_disturbed = 0.4;  // share of a window's samples that may be left out
};

enum class WindowStatus : std::uint8_t {
  fitted,
  too_short,            // fewer samples than coefficients of the coarsest spline
  motion_undetermined,  // the streams present do not determine the motion
  not_converged,
  misfit,      // residuals above their noise at every admissible spacing
  unresolved,  // finer knots would still fit better, but the samples do not resolve them
};

struct WindowFit {
  WindowStatus status = WindowStatus::too_short;
  BSpline spline;
  Coefficients x;
  Eigen::VectorXd theta;
  Information information;
  Information finer;             // the same with every interval halved
  double nested = 0.0;           // decrease of the cost by halving every interval,
  double nested_expected = 0.0;  // and what chance alone gives
  Groups groups{};
  std::vector<ComponentStatistics> components;  // channels, then those of the first series of the motion
  double assigned_at = 0.0;  // delay at which the sensor's samples were dealt out to blocks
  int disturbances = 0;
  int iterations = 0;
};

}  // namespace truewrench
