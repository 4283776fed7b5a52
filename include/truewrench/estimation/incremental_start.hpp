// How a stretch begins: its first lag, h, START and ROBUST on it. Included by incremental.hpp.
#pragma once

#include "truewrench/estimation/incremental.hpp"

namespace truewrench {

inline long Incremental::blocks_of(double origin, double h, bool partial) const {
  const double length = partial ? limit_ - origin : lag_blocks(coarsest_) * kBlock * coarsest_;
  const double most = most_blocks_, blocks = std::ceil(length / (kBlock * h) - 1e-6);
  return static_cast<long>(std::max(2.0, std::min(most, blocks)));
}

// All blocks of the first lag at a spacing, as far as there is memory: what then waits comes block by block.
inline void Incremental::lay(double origin, double h, bool partial) {
  raw_at_ = raw_.begin();
  lag_.place(origin, h);
  // of this lag alone: spans of what was before wait to be read
  masked_count_ = kept_.masked_spans;
  masked_samples_ = kept_.masked_samples;
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    motion_at_[i] = motion_[i].begin();
    past_.next[i] = lag_.motion(i).begin();
  }
  for (const long blocks = blocks_of(origin, h, partial); lag_.end() < blocks; lag_.grow())
    take_block(lag_.end(), partial);
}

// START and ROBUST at a spacing; (10.7).
inline double Incremental::fit_first(double origin, double h, bool partial) {
  lay(origin, h, partial);
  if (first_stretch_) {  // theta's own part, and for the first log all of it, at
                         // the mean
    for (int i = 0; i < lag_.parameters(); ++i) {
      if (!first_log_ && !own(i)) continue;
      lag_.theta[i] = lag_.layout().mean()[i];
      prior_[i] = stated_[i];
    }
    std::fill(active_.begin(), active_.end(), char{1});
  }
  if (!std::isfinite(start_.motion_alone(lag_))) return std::nan("");
  if (first_stretch_) {
    for (long g = 0; g < lag_.end(); ++g) lag_.predict(g);
    start_.regress(lag_, prior_, first_log_);
  } else {
    lag_.sizes = kept_.sizes;
  }
  if (!run(3, constants::most_iterations, constants::robust_move, partial) || !sweep(0, partial) || !solve())
    return std::nan("");
  lag_.back(lag_.first());
  predict();
  weigh();
  return likelihood(partial);
}

// h by (10.7) among h, h / 2 and the best for the motion alone, 6 a halving;
// again from there (10.2). Whether the fit that stands is the one at it.
inline bool Incremental::choose_spacing(double origin, bool partial) {
  std::array<double, 8> ladder{}, cost{};
  std::size_t count = 0, now = 0, best_alone = 0, laid = ladder.size();
  for (double h = coarsest_; count < ladder.size(); h = std::max(0.5 * h, motion_period_)) {
    // what memory is for, of this lag and of those after it
    if (count > 0 && std::max<long>(blocks_of(origin, h, partial), lag_blocks(h)) > most_blocks_ / 2) break;
    ladder[count++] = h;
    if (settings_.spacing > 0.0 || h <= 1.01 * motion_period_) break;
  }
  const auto dear = [&](std::size_t i) { return constants::halving_cost * std::log2(ladder[0] / ladder[i]); };
  if (count > 1) {
    double lowest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < count; ++i) {
      lay(origin, ladder[i], partial);
      const double alone = start_.motion_alone(lag_) + dear(i);
      if (alone < lowest) {
        lowest = alone;
        best_alone = i;
      }
    }
    cost.fill(std::nan(""));
    for (;;) {
      // what stands last: often the best, which need not be fitted again
      for (const std::size_t i : {now + 1, best_alone, now})
        if (i >= now && i < count && std::isnan(cost[i])) {
          cost[i] = fit_first(origin, ladder[i], partial) + dear(i);
          laid = i;
        }
      std::size_t best = now;
      for (std::size_t i = now; i < count; ++i)
        if (cost[i] < cost[best] || (std::isnan(cost[best]) && !std::isnan(cost[i]))) best = i;
      if (best <= now) break;
      now = best;
    }
  }
  h_ = ladder[now];
  at_finest_ = count > 1 && now + 1 == count;
  return laid == now && std::isfinite(cost[now]);
}

// Samples that wait, up to a time.
inline void Incremental::forget_until(double time) noexcept {
  while (!raw_.empty() && raw_[raw_.begin()].time < time) raw_.drop_before(raw_.begin() + 1);
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    while (!motion_[i].empty() && motion_[i][motion_[i].begin()].time < time)
      motion_[i].drop_before(motion_[i].begin() + 1);
}

// Whether no stream of the motion has moved by more than noise that would be told, before a time.
inline bool Incremental::resting(double until) noexcept {
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    const auto& rows = motion_[i];
    for (int j = 0; j < kComponents; ++j) {
      const auto ju = static_cast<std::size_t>(j);
      double n = 0.0, mean = 0.0, squares = 0.0;  // Welford's
      for (long k = rows.begin(); k < rows.end() && rows[k].time < until; ++k) {
        const double x = rows[k].value[ju];
        if (!std::isfinite(x)) continue;
        const double d = x - mean;
        mean += d / ++n;
        squares += d * (x - mean);
      }
      const double most = constants::noise_told * lag_.about().motion[i].sigma[j];
      if (squares > most * most * n) return false;
    }
  }
  return true;
}

// What a lag that cannot be fitted must leave as it was; without an allocation.
inline void Incremental::keep() noexcept {
  kept_.sizes = lag_.sizes;
  kept_.theta = lag_.theta;
  kept_.lagged = lag_.lagged;
  kept_.prior = prior_;
  kept_.parts = parts_;
  kept_.last = Zl_;
  kept_.part = part_;
  kept_.active = active_;
  kept_.masked_spans = masked_count_;
  kept_.masked_samples = masked_samples_;
}
inline void Incremental::restore() noexcept {
  lag_.sizes = kept_.sizes;
  lag_.theta = kept_.theta;
  lag_.lagged = kept_.lagged;
  prior_ = kept_.prior;
  parts_ = kept_.parts;
  Zl_ = kept_.last;
  part_ = kept_.part;
  active_ = kept_.active;
  masked_count_ = kept_.masked_spans;
  masked_samples_ = kept_.masked_samples;
}

// The first lag of a stretch. The first of all begins with the motion: what rests tells no gain, and its sizes are those of rest.
inline Status Incremental::start(bool partial) noexcept {
  period_ = raw_period();
  motion_period_ = motion_period();
  if (const double eighth = common_begin() + 0.125 * settings_.lag;
      !partial && first_log_ && first_stretch_ && resting(eighth)) {
    forget_until(eighth);
    return Status::ok;
  }
  const double origin = common_begin() - 0.5 * period_;
  forget_until(origin);
  keep();
  const bool fitted = !chosen_ && choose_spacing(origin, partial);
  if (!fitted && !std::isfinite(fit_first(origin, h_, partial))) {
    restore();
    abandon(Status::not_factorizable);
    return status_ = Status::not_factorizable;
  }
  chosen_ = true;
  lag_.know_theta(present_, moving_);
  raw_.drop_before(raw_at_);
  for (std::size_t i = 0; i < lag_.streams(); ++i) motion_[i].drop_before(motion_at_[i]);
  blocks_ += lag_.end();
  standing_ = ready_ = true;
  first_stretch_ = false;
  arrival_ = 0.0;
  return Status::ok;
}

}  // namespace truewrench
