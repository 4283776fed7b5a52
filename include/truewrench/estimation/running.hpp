// What follows the pose (10.10), by sums that run along with the rows of a lag.
#pragma once

#include "truewrench/estimation/lag_rows.hpp"
#include "truewrench/estimation/pose_moments.hpp"

namespace truewrench {

// (10.10): w against the pose, the integral of the twist component by component, means by stretch.
class PoseSums {
 public:
  void add(const RawRow& row) {
    const double c = row.size, dt = row.time - time_;
    for (int i = 0; i < 6; ++i) {
      if (started_) pose_[i] += 0.5 * dt * (row.nu[i] + nu_[i]);
      if (started_ && !row.masked && dt > 0.0)
        all_.rate[i] += (row.w[i] - before_[i]) * (row.w[i] - before_[i]) / dt;
      nu_[i] = row.nu[i];
      before_[i] = row.w[i];
    }
    if (started_ && !row.masked && dt > 0.0) rated_ += dt;
    time_ = row.time;
    started_ = true;
    if (row.masked) return;
    now_.samples += c;
    for (int i = 0; i < 6; ++i) {
      w_[i] += c * row.w[i];
      p_[i] += c * pose_[i];
      now_.pp[i] += c * pose_[i] * pose_[i];
      for (int j = 0; j < 6; ++j) {
        now_.ww[i][j] += c * row.w[i] * row.w[j];
        now_.wp[i][j] += c * row.w[i] * pose_[j];
      }
    }
  }

  // What a stretch ends with goes into the whole.
  void end_stretch() {
    fold(all_);
    started_ = false;
    now_ = PoseMoments();
    for (double* v : {pose_, w_, p_}) std::fill_n(v, 6, 0.0);
  }

  PoseShare share() const {
    PoseMoments all = all_;
    fold(all);
    // (dw / dt)^2 by time, as what waits is counted by samples
    for (double& x : all.rate) x *= rated_ > 0.0 ? all.samples / rated_ : 0.0;
    return all.share();
  }

 private:
  PoseMoments all_, now_;  // now_: not yet about its means; rates of all in all_
  bool started_ = false;
  double time_ = 0.0, rated_ = 0.0;
  double nu_[6] = {}, before_[6] = {}, pose_[6] = {}, w_[6] = {}, p_[6] = {};

  void fold(PoseMoments& all) const {
    if (now_.samples == 0.0) return;
    all.samples += now_.samples;
    for (int i = 0; i < 6; ++i) {
      all.pp[i] += std::max(0.0, now_.pp[i] - p_[i] * p_[i] / now_.samples);
      for (int j = 0; j < 6; ++j) {
        all.ww[i][j] += now_.ww[i][j];
        all.centred[i][j] += now_.ww[i][j] - w_[i] * w_[j] / now_.samples;
        all.wp[i][j] += now_.wp[i][j] - w_[i] * p_[j] / now_.samples;
      }
    }
  }
};

}  // namespace truewrench
