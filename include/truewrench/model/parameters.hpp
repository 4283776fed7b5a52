// theta: what is unknown beside the motion, its prior, and its place (METHOD 10.1).
#pragma once

#include "truewrench/estimation/constants.hpp"
#include "truewrench/model/body.hpp"
#include "truewrench/model/record.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace truewrench {

// Where the parameters of one log stand in a vector of its own, and in theta.
struct Columns {
  int n = 0;                                                              // channels
  int C = 0, b = 0, u = 0, body = -1, slope = -1, tilt = -1, gamma = -1;  // -1: there is none
  int body_in_theta = 0;      // which has a place for a body that is known exactly, too
  std::vector<int> clock;     // of each motion stream: s, then kappa
  std::vector<int> bias;      // of each motion stream, -1: none
  std::vector<int> ramps;     // of an offset that walks: from each of its knots to the next
  std::vector<double> knots;  // [s]
  std::vector<int> steps;
  std::vector<double> step_times;  // [s]
  std::vector<double> roots;       // [s] from which on root frames hold, each with two places from `tilt` on
  std::vector<int> global;         // place in theta of each of them

  int size() const { return static_cast<int>(global.size()); }
  // The same in places of theta.
  Columns in_theta() const {
    Columns out = *this;
    const auto place = [this](int& at) { at = at < 0 ? at : global[static_cast<std::size_t>(at)]; };
    for (int* at : {&out.C, &out.b, &out.u, &out.body, &out.slope, &out.tilt, &out.gamma}) place(*at);
    for (auto* list : {&out.clock, &out.bias, &out.ramps, &out.steps})
      for (int& at : *list) place(at);
    return out;
  }
  // With `tilt` at that of the root frame at a time.
  Columns in_root(double time) const {
    Columns out = *this;
    for (std::size_t j = 1; tilt >= 0 && j < roots.size() && roots[j] <= time; ++j) out.tilt += 2;
    return out;
  }
  // Share of a ramp at a time.
  double ramped(std::size_t j, double time) const {
    return std::clamp((time - knots[j]) / (knots[j + 1] - knots[j]), 0.0, 1.0);
  }
};

// theta of all logs: shared by all first, then log by log.
class Layout {
 public:
  Layout() = default;
  // `common`: with the root frame that logs share, whether or not one of these has it.
  Layout(const Statement& rig, const std::vector<const RecordedLog*>& logs,
         const std::vector<std::vector<double>>& steps, bool common = false) {
    const int n = static_cast<int>(rig.noise.size());
    const bool gravity = rig.gravity[0] != 0.0 || rig.gravity[1] != 0.0 || rig.gravity[2] != 0.0;
    const bool warm = rig.slope_prior > 0.0 &&
                      std::any_of(logs.begin(), logs.end(),
                                  [](const RecordedLog* log) { return log->temperature.size() > 0; });
    C = add(6 * n, rig.gain_prior);
    std::copy_n(rig.nominal.data(), 6 * n, mean_.data() + C);
    u = add(n, constants::departure_start);
    for (const auto& prior : rig.body_prior) {
      bodies.push_back(add(kBodyParameters, 0.0));
      set(sigma_, prior.data(), kBodyParameters);
    }
    if (warm) slope = add(n, rig.slope_prior);
    // gravity is tilted about axes of a root frame: of the one that logs share, and of those that a log has alone
    std::vector<int> tilts(logs.size(), -1);
    if (gravity && common) tilt = add(2, rig.tilt_prior);
    for (std::size_t l = 0; gravity && l < logs.size(); ++l) {
      const auto own = static_cast<int>(logs[l]->own_roots.size());
      int& at = own > 0 ? tilts[l] : tilt;
      if (at < 0) at = add(2 * std::max(own, 1), rig.tilt_prior);
      tilts[l] = at;
    }
    int pooled = -1;
    for (std::size_t l = 0; l < logs.size(); ++l) {
      const RecordedLog& log = *logs[l];
      Columns c;
      c.n = n;
      const auto take = [&c](int from, int count) {
        const int at = c.size();
        for (int i = 0; i < count; ++i) c.global.push_back(from + i);
        return at;
      };
      c.C = take(C, 6 * n);
      if (pooled < 0 || !rig.pool_offsets) {
        pooled = add(n, 0.0);
        set(sigma_, rig.offset_prior.data(), n);
      }
      c.b = take(pooled, n);
      c.u = take(u, n);
      const auto body = static_cast<std::size_t>(log.body);
      c.body_in_theta = bodies[body];
      if (!rig.body_prior[body].isZero(0.0)) c.body = take(bodies[body], kBodyParameters);
      for (const MotionStream& stream : log.motion) {
        c.clock.push_back(take(add(2, 0.0), 2));
        const double mean[2] = {stream.clock_mean, stream.kappa_mean},
                     width[2] = {stream.time_offset_prior, constants::filter_prior};
        set(mean_, mean, 2);
        set(sigma_, width, 2);
        if (stream.bias_prior.size() > 0) {
          const int m = static_cast<int>(stream.bias_prior.size());
          c.bias.push_back(take(add(m, 0.0), m));
          set(sigma_, stream.bias_prior.data(), m);
        } else {
          c.bias.push_back(-1);
        }
      }
      c.roots = log.own_roots;
      if (gravity) c.tilt = take(tilts[l], 2 * std::max(static_cast<int>(c.roots.size()), 1));
      if (gravity && log.source == Source::twist) {
        c.gamma = take(add(1, constants::filter_prior), 1);
        set(mean_, &rig.gamma_mean, 1);
      }
      if (warm) c.slope = take(slope, n);
      c.knots = log.offset_knots;
      for (std::size_t j = 1; j < c.knots.size(); ++j) {
        c.ramps.push_back(take(add(n, 0.0), n));
        set(sigma_, rig.offset_prior.data(), n);
      }
      if (l < steps.size()) {
        c.step_times = steps[l];
        for (std::size_t j = 0; j < steps[l].size(); ++j)
          c.steps.push_back(take(add(n, constants::departure_start), n));
      }
      in_theta_.push_back(c.in_theta());
      logs_.push_back(std::move(c));
    }
  }

  int size() const { return static_cast<int>(mean_.size()); }
  const Eigen::VectorXd& mean() const { return mean_; }
  const Eigen::VectorXd& sigma() const { return sigma_; }
  const Columns& log(std::size_t l) const { return logs_[l]; }
  const Columns& in_theta(std::size_t l) const { return in_theta_[l]; }
  std::size_t logs() const { return logs_.size(); }

  int C = 0, u = 0, slope = -1, tilt = -1;  // tilt: in the root frame that logs share
  std::vector<int> bodies;

 private:
  Eigen::VectorXd mean_, sigma_;  // theta_0 and the roots of diag Pi
  std::vector<Columns> logs_, in_theta_;

  // The last values of a vector.
  static void set(Eigen::VectorXd& v, const double* values, int count) {
    std::copy_n(values, count, v.data() + v.size() - count);
  }

  int add(int count, double sigma) {
    const int at = size(), now = at + count;
    Eigen::VectorXd mean(now), width(now);
    for (int i = 0; i < now; ++i) {
      mean[i] = i < at ? mean_[i] : 0.0;
      width[i] = i < at ? sigma_[i] : sigma;
    }
    mean_.swap(mean);
    sigma_.swap(width);
    return at;
  }
};

}  // namespace truewrench
