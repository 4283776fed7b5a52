// What the estimators are asked for and what they answer (docs/method.md, "Online and map").
#pragma once

#include "truewrench/knots.hpp"

#include <cstddef>
#include <utility>
#include <vector>

namespace truewrench {

struct EstimatorSettings {
  KnotSettings knots;
  double window = 1.0;            // shortest window of `online` [s]; doubled while a window has fewer knot
  int window_intervals = 4;       // intervals than this
  int map_window_intervals = 64;  // knot intervals of a window of `map`, about
  double gap_periods = 5.0;       // no window spans a longer gap
  double dependence_sigma = 3.1;  // the gain must not depend on knots or windows by more than this (99.9%)
  double enough_fitted = 0.9;     // share of the samples in windows that fit, below which a pass is repeated
  double clock_lost = 0.2;        // nor may halved knots make the clock's sigma larger by this share
  double few_samples = 10.0;      // below so many samples per coefficient, doubled windows are tried as well
  double disregard = 1e12;  // times its variance, a sensor's noise that leaves the motion to the velocities
  double believe = 10.0;    // by which the variance of a sensor that does not fit yet is lowered at a time
  double freedom = 4.0;     // of Student's t, as which its noise is taken until then, against contacts
  double few_rejected = 0.02;  // of the samples, in windows that are not worth another search
  double longest_window = 8;   // times that of `map`, where the gain depends on its length
  int max_rounds = 6;
  int max_pushes = 20;  // times that pushes are left out which the gain had taken up,
  double shadow = 0.7;  // all that are this share of the strongest: others may be what it does to the gain
  int max_iterations = 25;
  double tolerance = 1e-9;  // last Gauss-Newton decrement of the common parameters
  double settled = 2.5e-3;  // what may remain of it after the last iteration: a twentieth of a sigma, squared
  int threads = 0;          // 0: all
};

// Where `map` may begin: at what another estimate says of the parameters and knot spacings, per log.
struct Start {
  std::vector<Eigen::VectorXd> mean;  // normalised
  std::vector<Eigen::MatrixXd> covariance;
  std::vector<double> spacing;  // [s]
};

struct WindowReport {
  int log = 0;
  double begin = 0.0;
  double end = 0.0;
  WindowStatus status = WindowStatus::too_short;
  int intervals = 0;
  double samples_per_coefficient = 0.0;
  std::size_t samples = 0;  // rows of the sensor
  Groups groups{};
  std::vector<ComponentStatistics> components;
  double nested = 0.0;
  double nested_expected = 0.0;
};

// Samples in windows that fit, and in all.
inline std::pair<double, double> fitted_samples(const std::vector<WindowReport>& windows) {
  double fitted = 0.0, all = 0.0;
  for (const WindowReport& w : windows) {
    all += static_cast<double>(w.samples);
    if (w.status == WindowStatus::fitted) fitted += static_cast<double>(w.samples);
  }
  return {fitted, all};
}

struct HistoryEntry {
  int log = 0;
  double time = 0.0;     // end of the window [s]
  Eigen::VectorXd mean;  // [gain, offset], normalised
  Eigen::VectorXd sigma;
};

struct Estimate {
  Status status = Status::ok;
  bool converged = false;
  Posterior posterior;  // normalised
  std::vector<WindowReport> windows;
  std::vector<HistoryEntry> history;  // `online`: after every window
  std::vector<RowMatrix>
      wrench;  // per log: the payload's wrench at the sensor's samples, NaN where no window or left out
  std::vector<Gate> gates;         // per log: the samples left out
  std::vector<double> spacing;     // per log: typical knot spacing [s]
  double knot_dependence = 0.0;    // deviate of gain and clock against those of halved knots
  double window_dependence = 0.0;  // and against that of doubled windows, where there are few samples
  int iterations = 0;
};

}  // namespace truewrench
