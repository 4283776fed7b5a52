// A part of a long record whose fit is put away between two looks at it: its rows are made anew, and nothing is kept but
// coefficients, sizes and masks.
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/estimation/gather.hpp"

#include <memory>
#include <utility>
#include <vector>

namespace truewrench {

// Of one log.
class Part {
 public:
  explicit Part(Fit fit) : fit_(std::move(fit)), gather_(fit_.logs()[0].whole != nullptr) { put_away(); }

  const Fit& fit() const { return fit_; }

  // The fit at given values of the parameters that all parts share, the first ones: its motion and what it has of its own where
  // they are best then, and a step of all from there. `log`: as it was fitted.
  bool settle(const RecordedLog& log, const Eigen::VectorXd& first) {
    const bool settled = take_up(log) && fit_.settle(first);
    put_away();
    return settled;
  }

 private:
  Fit fit_;
  bool gather_ = false;

  void put_away() {
    fit_.release();
    LogFit& log = fit_.logs()[0];
    log.log = log.whole = nullptr;
    log.gathered = nullptr;
    for (Stretch& s : log.stretches) s.put_away();
  }

  bool take_up(const RecordedLog& recorded) {
    LogFit& log = fit_.logs()[0];
    if (gather_) log.gathered = gathered(recorded, fit_.rig().noise);
    log.whole = gather_ ? &recorded : nullptr;
    log.log = gather_ ? log.gathered.get() : &recorded;
    if (!log.log) return false;
    for (Stretch& s : log.stretches)
      if (!s.take_up(*log.log, fit_.rig())) return false;
    return true;
  }
};

}  // namespace truewrench
