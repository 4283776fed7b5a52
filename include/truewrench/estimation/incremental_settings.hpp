// What the estimator as samples arrive is set to and takes, and what memory that asks for.
#pragma once

#include "truewrench/estimation/lag_rows.hpp"
#include "truewrench/model/check.hpp"

#include <algorithm>
#include <cmath>

namespace truewrench {

struct IncrementalSettings {
  double lag = 2.0;           // [s], and 20 knots at least: a coefficient forgets what is
                              // beyond to 1e-5. Memory is for samples of 1.25 lag and 2 s, so that 20 knots
                              // of 2.5 samples of the motion must fit: where the fastest of its streams has a
                              // longer period than lag / 50, state a lag of 50 periods
  double rate = 1000.0;       // [Hz] samples of one stream at most
  double spacing = 0.0;       // [s] h; 0: chosen on the first lag
  double finest = 0.0125;     // [s] smallest h that is tried: what memory is for
  double discrepancy = -1.0;  // stated: -1 auto, 0 none, else at least so much
                              // [fraction of range]

  // [s] smallest h that may be laid: of the coarsest that is tried, too.
  double smallest() const {
    const double h = std::min(finest, constants::knot_spacing);
    return spacing > 0.0 ? std::min(h, spacing) : h;
  }
  // [s] of the motion, for which the lag is long enough.
  double longest_period() const { return lag / 50.0; }
  double blocks_of_lag(double h) const { return std::ceil(std::max(lag, 20.0 * h) / (kBlock * h) - 1e-9); }
  // Of one stream, that wait for their blocks or for a first lag.
  double samples() const { return rate * (1.25 * std::max(lag, 20.0 * spacing) + 2.0) + 64.0; }
  // Of one stream in an interval of knots; those beyond are thinned.
  double samples_of_interval() const {
    return std::max(64.0, rate * std::max({2.0 * constants::knot_spacing, lag / 20.0, spacing}) + 16.0);
  }
};

inline Status check(const IncrementalSettings& s) {
  for (const double x : {s.lag, s.rate, s.finest, s.spacing, s.discrepancy})
    if (!std::isfinite(x)) return Status::not_finite;
  if (!(s.lag > 0.0 && s.rate > 0.0 && s.finest > 0.0 && s.spacing >= 0.0)) return Status::not_positive;
  // more than any machine holds
  return s.blocks_of_lag(s.smallest()) > 1e5 || s.samples() > 1e8 ? Status::wrong_size : Status::ok;
}

// Twists or an IMU, of so many channels and streams.
inline Status check(const Statement& rig, const RecordedLog& about, const IncrementalSettings& settings) {
  if (const Status status = check(rig, about); status != Status::ok) return status;
  if (about.source == Source::mapped) return Status::not_configured;
  if (rig.noise.size() > kMostChannels || about.motion.size() > kMostStreams) return Status::wrong_size;
  return check(settings);
}

// What the estimator stands on.
struct Accepted {
  Statement rig;
  RecordedLog about;
  IncrementalSettings settings;
  Status status = Status::ok;

  static Accepted of(const Statement& rig, const RecordedLog& about, const IncrementalSettings& settings) {
    const Status status = check(rig, about, settings);
    return status != Status::ok ? stand_in(status) : Accepted{rig, about, settings, status};
  }

 private:
  // In the place of what is refused, so that nothing is read out of bounds: a sensor of six channels.
  static Accepted stand_in(Status refused) {
    Accepted out;
    out.rig.noise = out.rig.offset_prior = Vector6::Ones();
    out.rig.nominal = Matrix6::Identity();
    out.rig.body_prior = {Eigen::Matrix<double, 10, 1>::Zero()};
    out.about.motion.resize(1);
    out.about.motion[0].sigma = Vector6::Ones();
    out.about.motion[0].group = Eigen::VectorXi::Zero(6);
    out.settings = {.lag = 1.0, .rate = 1.0, .finest = constants::knot_spacing};
    out.status = refused;
    return out;
  }
};

}  // namespace truewrench
