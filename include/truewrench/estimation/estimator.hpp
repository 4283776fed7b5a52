// The estimator: START, ROBUST, MASK, FIT, how the discrepancy enters, steps of the offset and their repair (METHOD 10.3). It
// returns the estimate, what it left out, the sizes it found and the findings that a judgement needs; it decides nothing.
#pragma once

#include "truewrench/estimation/gather.hpp"
#include "truewrench/estimation/score.hpp"
#include "truewrench/estimation/slow.hpp"
#include "truewrench/estimation/spacing.hpp"
#include "truewrench/model/check.hpp"

#include <cmath>
#include <map>
#include <memory>
#include <utility>
#include <vector>

namespace truewrench {

class Estimator {
 public:
  Estimator(std::shared_ptr<const Statement> rig, std::vector<const RecordedLog*> logs, Settings settings)
      : rig_(std::move(rig)), whole_(std::move(logs)), settings_(settings) {
    if (whole_.empty()) refused_ = Status::wrong_size;
    for (const RecordedLog* log : whole_)
      if (refused_ == Status::ok) refused_ = check_samples(*rig_, *log);
    for (const RecordedLog* log : whole_) {
      gathered_.push_back(refused_ == Status::ok ? gathered(*log, rig_->noise) : nullptr);
      recorded_.push_back(gathered_.back() ? gathered_.back().get() : log);
    }
  }

  Estimate run() {
    Estimate out;
    const std::size_t count = recorded_.size();
    out.unresolved.assign(count, 0);
    out.dropped.assign(count, 0);
    out.unexplained.assign(count, 0.0);
    rungs_.assign(count, 0);
    out.status = refused_;
    if (out.status != Status::ok) return out;
    for (std::size_t l = 0; l < count; ++l) {
      const double coarsest = coarsest_spacing(motion_period(*recorded_[l]));
      pieces_.push_back(pieces_of(*whole_[l], coarsest, out.dropped[l]));
      if (pieces_.back().empty()) {
        out.status = Status::wrong_size;
        return out;
      }
    }
    // h, log by log
    std::vector<std::shared_ptr<Fit>> alone;
    for (std::size_t l = 0; l < count; ++l) {
      alone.push_back(choose_spacing(l, out));
      if (!alone.back()) {
        out.status = Status::not_factorizable;
        return out;
      }
    }
    Steps steps(count);
    std::shared_ptr<Fit> robust = together(alone, out);
    if (robust->failed) {
      out.status = Status::not_factorizable;
      return out;
    }
    // what the samples do not resolve, or no motion explains, is refused: no discrepancy and no step is looked for in it
    bool hopeful = !settings_.brief;
    for (std::size_t l = 0; l < count; ++l)
      hopeful = hopeful && out.unresolved[l] == 0 && out.unexplained[l] <= constants::most_lost;
    if (!robust->sound()) {
      if (hopeful) seek_steps(robust, steps, out);
      set_mask(*robust);
      leave_in(*robust);
    }
    const auto plain = with_masked(plain_fit(bare(*robust), *robust, steps, out), *robust, steps, out);
    Candidate best = without_slow(plain);
    if (hopeful) {
      best = slow_or_step(best, steps, out);
      repair(best, steps, out);
      keep_masked(best, out.fits);
    }
    finish(best, settings_, out);
    if (hopeful) refine(best, steps, out);
    return out;
  }

 private:
  using Steps = std::vector<std::vector<double>>;  // of the offset, of each log [s]

  std::shared_ptr<const Statement> rig_;
  std::vector<const RecordedLog*> whole_, recorded_;  // as given; as fitted
  std::vector<std::shared_ptr<const RecordedLog>> gathered_;
  Settings settings_;
  Status refused_ = Status::ok;  // of what does not make sense
  std::vector<std::vector<Piece>> pieces_;
  std::vector<std::size_t> rungs_;  // by log: h in its ladder
  mutable std::map<const RecordedLog*, double> periods_;

  // Of the sensor's samples, in the median.
  double period_of(const RecordedLog& log) const {
    const auto known = periods_.find(&log);
    if (known != periods_.end()) return known->second;
    return periods_[&log] = median_period(sensor_times(log));
  }

  LogFit log_fit(std::size_t l, const std::vector<Piece>& pieces, double h) const {
    LogFit out;
    out.log = recorded_[l];
    out.whole = gathered_[l] ? whole_[l] : nullptr;
    out.gathered = gathered_[l];
    out.h = h;
    out.period = period_of(*recorded_[l]);
    for (const Piece& p : pieces)
      out.stretches.emplace_back(*recorded_[l], *rig_, p.begin, p.end, period_of(*whole_[l]), h);
    return out;
  }

  // ROBUST of the logs pooled, each from the motion and the sizes of its own fit; of a single one that fit.
  std::shared_ptr<Fit> together(const std::vector<std::shared_ptr<Fit>>& alone, Estimate& out) const {
    if (alone.size() == 1) return alone.front();
    std::vector<LogFit> logs;
    logs.reserve(alone.size());
    for (const auto& fit : alone) logs.push_back(std::move(bare(*fit)[0]));
    auto pooled = std::make_shared<Fit>(rig_, std::move(logs), std::vector<std::vector<double>>(alone.size()),
                                        settings_.threads);
    for (std::size_t l = 0; l < alone.size(); ++l) pooled->logs()[l].sizes = alone[l]->logs()[0].sizes;
    pooled->robust = true;
    regress(*pooled);
    pooled->run(SpacingSearch::clean);
    pooled->release();
    ++out.fits;
    return pooled;
  }

  SpacingSearch search_of(std::size_t l, const std::vector<Piece>& pieces, double repeated) const {
    return SpacingSearch(
        rig_, [this, l, pieces](double h) { return log_fit(l, pieces, h); },
        spacings(motion_period(*recorded_[l])), repeated, settings_.threads);
  }

  // ROBUST of one log at the h that is best for it (10.2).
  std::shared_ptr<Fit> choose_spacing(std::size_t l, Estimate& out) {
    SpacingSearch whole = search_of(l, pieces_[l], 1.0);
    std::shared_ptr<Fit> coarsest = whole.fit(0);
    std::size_t found = 0;
    // a motion that the coarsest knots do not follow leaves residuals faster than 2 h, the shortest tau of (10.9)
    if (coarsest) out.unexplained[l] = unexplained_by(*coarsest);
    if (settings_.brief || out.unexplained[l] > constants::most_lost) {
      out.fits += whole.fits();
      return coarsest;
    }
    if (coarsest && lasting(pieces_[l]) > 2.0 * constants::pilot) {
      const std::size_t tried = best_of_worst_part(l, *coarsest, out);
      if (tried > 0) found = whole.better(tried) ? tried : whole.best();
    } else {
      found = whole.best();
    }
    out.fits += whole.fits();
    rungs_[l] = found;
    out.unresolved[l] = finest(l) ? 1 : 0;
    std::shared_ptr<Fit> best = whole.fit(found);
    if (out.unresolved[l] != 0 && gathered_[l] && best)
      if (const auto finer = choose_by_samples(l, *best, out)) return finer;
    return best;
  }

  // The place in the ladder that is best for the seconds which a fit explains worst, were the whole log like them.
  std::size_t best_of_worst_part(std::size_t l, const Fit& fit, Estimate& out) const {
    const Piece part = worst_part(fit);
    SpacingSearch pilot = search_of(l, {part}, lasting(pieces_[l]) / (part.end - part.begin));
    const std::size_t best = pilot.best(fit.sound());
    out.fits += pilot.fits();
    return best;
  }

  bool finest(std::size_t l) const {
    return !whole_[l]->resolved && rungs_[l] + 1 == spacings(motion_period(*recorded_[l])).size();
  }

  // What gathered rows do not resolve, the samples themselves may: 20 Hz at 5e-5 of range from 1 kHz on. Null where neither do.
  std::shared_ptr<Fit> choose_by_samples(std::size_t l, const Fit& gathered, Estimate& out) {
    const auto kept = std::exchange(gathered_[l], nullptr);
    const std::size_t rung = rungs_[l];
    recorded_[l] = whole_[l];
    rungs_[l] = best_of_worst_part(l, gathered, out);
    if (!finest(l)) {
      SpacingSearch whole = search_of(l, pieces_[l], 1.0);
      const std::shared_ptr<Fit> fit = whole.fit(rungs_[l]);
      out.fits += whole.fits();
      if (fit) {
        out.unresolved[l] = 0;
        return fit;
      }
    }
    gathered_[l] = kept;
    recorded_[l] = kept.get();
    rungs_[l] = rung;
    return nullptr;
  }

  // Of the only log of a robust fit, where its noise is beyond the stated: what the wrench does not explain.
  static double unexplained_by(const Fit& fit) {
    if (!SpacingSearch::noisy(fit)) return 0.0;
    const Fit masked = with_mask(fit);
    return unexplained(masked, 0, moments(masked, unmasked_sums(masked, 0)));
  }

  // A robust fit that stands where another does, but for its steps.
  std::shared_ptr<Fit> robust_like(const Fit& like, const Steps& steps) const {
    std::vector<LogFit> logs = bare(like);
    for (LogFit& log : logs) clear_mask(log);
    auto fit = std::make_shared<Fit>(rig_, std::move(logs), steps, settings_.threads);
    fit->robust = true;
    fit->start_from(like).lagged = like.lagged;
    return fit;
  }

  std::shared_ptr<Fit> robust_from(const Fit& like, const Steps& steps, Estimate& out) const {
    auto fit = robust_like(like, steps);
    fit->run();
    fit->release();
    ++out.fits;
    return fit;
  }

  struct Stepped {
    std::shared_ptr<Fit> fit;
    Steps steps;
    double end;  // [s] from which on the block is past in which the step was proposed
  };

  // ROBUST with one step more in a log, at the sample where it is likeliest; none beside those that there are.
  std::optional<Stepped> with_step(const Fit& like, std::size_t l, double proposed, const Steps& steps,
                                   Estimate& out) const {
    const double length = scored_length(like.logs()[l].stretches.front());
    for (const double t : steps[l])
      if (std::abs(t - proposed) <= length) return std::nullopt;
    Stepped trial{nullptr, steps, proposed + length};
    std::vector<double>& times = trial.steps[l];
    const auto at = times.insert(std::upper_bound(times.begin(), times.end(), proposed), proposed);
    trial.fit = robust_from(like, trial.steps, out);
    if (trial.fit->failed) return std::nullopt;
    *at = likeliest_time(*trial.fit, l, static_cast<std::size_t>(at - times.begin()), length);
    if (*at != proposed) {
      trial.fit = robust_like(*trial.fit, trial.steps);
      trial.fit->predict();
      trial.fit->reweigh();
    }
    return trial;
  }

  // Steps of the offset: where the mask would hide more than 20 % of a log; and one where it hides a log's end, if that step
  // leaves as little of it to hide as of any record: a contact that has not ended is no constant.
  void seek_steps(std::shared_ptr<Fit>& robust, Steps& steps, Estimate& out) const {
    for (std::size_t l = 0; l < steps.size(); ++l)
      while (steps[l].size() < 2) {
        const Fit masked = with_mask(*robust);
        const bool lost = masked_share(masked, l) > constants::most_lost;
        if (!lost && (!steps[l].empty() || !end_masked(masked, l))) break;
        const auto proposed = best_step(*robust, l);
        if (!proposed) break;
        const auto trial = with_step(*robust, l, *proposed, steps, out);
        if (!trial || !(trial->fit->deviance() <= robust->deviance() - 2.0 * robust->channels())) break;
        if (!lost && masked_share(with_mask(*trial->fit), l, trial->end) > constants::masked_told) break;
        robust = trial->fit;
        steps = trial->steps;
      }
    robust->release();
  }

  // What a walk of a stated rate does about the line between its ends: in V unless something slow is found in its place.
  static void bridge_walks(Fit& fit) {
    for (LogFit& log : fit.logs()) {
      if (log.log->offset_walk == 0.0) continue;
      log.sizes.form = Form::bridge;
      log.sizes.delta.setConstant(log.log->offset_walk);
    }
  }

  // FIT on the unmasked rows without d.
  std::shared_ptr<Fit> plain_fit(std::vector<LogFit> logs, const Fit& like, const Steps& steps,
                                 Estimate& out) const {
    auto plain = std::make_shared<Fit>(rig_, std::move(logs), steps, settings_.threads);
    bridge_walks(*plain);
    plain->start_from(like).run();
    ++out.fits;
    return plain;
  }

  // FIT of the masked samples, too, where the noise that it finds is hardly larger; else the one without them. Bursts of jerk that
  // the knots follow in part look like contacts, and without them the motion seems smoother than it is.
  std::shared_ptr<Fit> with_masked(const std::shared_ptr<Fit>& plain, const Fit& robust, const Steps& steps,
                                   Estimate& out) const {
    std::vector<std::size_t> asked;
    for (std::size_t l = 0; l < plain->logs().size() && !plain->failed; ++l) {
      const double added = masked_variance(*plain, l);
      // beyond the noise itself: left in of none of 274 records, and a tenth of the time of a contact
      if (added > 0.0 && added <= 1.0) asked.push_back(l);
    }
    if (asked.empty()) return plain;
    plain->release();
    std::vector<LogFit> logs = bare(robust);
    for (const std::size_t l : asked) clear_mask(logs[l]);
    auto trial = plain_fit(std::move(logs), robust, steps, out);
    if (trial->failed) return plain;
    for (std::size_t l = 0; l < plain->logs().size(); ++l) {
      const Eigen::ArrayXd factor =
          trial->logs()[l].sizes.raw_factor.array() / plain->logs()[l].sizes.raw_factor.array();
      if (factor.square().maxCoeff() > constants::mask_worth) return plain;
    }
    return trial;
  }

  // FIT without d of the rows that a robust fit leaves in.
  Candidate fit_rows(const Fit& robust, const Steps& steps, Estimate& out) const {
    return without_slow(plain_fit(bare(robust), robust, steps, out));
  }

  // Whether (10.7) has a step, one of as many as there are blocks, rather than d.
  static bool likelier(const Candidate& step, const Candidate& d, std::size_t l) {
    double blocks = 0.0;
    for (const Stretch& s : step.fit->logs()[l].stretches) blocks += static_cast<double>(s.spline.blocks());
    return step.fit->deviance() <= d.fit->deviance() - 2.0 * std::log(blocks);
  }

  // Where a fit without d asks for it: d, or a step that leaves nothing slow, whichever is likelier on the same rows. A walk that is
  // in V takes a step of 0.3 % of range for its own: 3 of 13 such records were refused for a drift.
  Candidate slow_or_step(const Candidate& plain, Steps& steps, Estimate& out) const {
    if (!(plain.share > 1.0)) return plain;
    for (std::size_t l = 0; l < steps.size(); ++l) {
      const auto proposed = steps[l].size() < 2 ? best_step(*plain.fit, l) : std::nullopt;
      const auto trial = proposed ? with_step(*plain.fit, l, *proposed, steps, out) : std::nullopt;
      if (!trial) continue;
      set_mask(*trial->fit);
      leave_in(*trial->fit);
      Candidate stepped = fit_rows(*trial->fit, trial->steps, out);
      if (stepped.fit->failed || stepped.share > 1.0) continue;
      stepped.fit->release();
      const Candidate same =
          same_mask(*plain.fit, *stepped.fit) ? stepped : fit_rows(*plain.fit, trial->steps, out);
      Candidate slow = with_slow(plain, out.fits);
      if (same.fit->failed || !likelier(same, slow, l)) return slow;
      steps = trial->steps;
      return stepped;
    }
    return with_slow(plain, out.fits);
  }

  // At most three times: where the scan finds something with d in V, its best suffix becomes a step.
  void repair(Candidate& best, Steps& steps, Estimate& out) const {
    for (int round = 0; round < 3; ++round) {
      std::size_t l = 0;
      std::optional<double> proposed;
      for (; l < steps.size(); ++l) {
        proposed = best_step(*best.fit, l);
        if (proposed) break;
      }
      if (proposed && !best.found) {  // d must be in V before a step is sought
        best = with_slow(best, out.fits);
        proposed = best_step(*best.fit, l);
      }
      const auto trial = proposed ? with_step(*best.fit, l, *proposed, steps, out) : std::nullopt;
      if (!trial) return;
      set_mask(*trial->fit);
      leave_in(*trial->fit);
      const Fit* known = best.found ? best.fit.get() : nullptr;
      Candidate with = fit_rows(*trial->fit, trial->steps, out);
      if (with.share > 1.0) with = with_slow(with, out.fits, known);
      // of the same rows without the step
      const Candidate without = same_mask(*trial->fit, *best.fit)
                                    ? best
                                    : with_slow(fit_rows(*trial->fit, steps, out), out.fits, known);
      if (with.fit->failed || !likelier(with, without, l)) return;
      best = with;
      steps = trial->steps;
    }
  }

  // Where the parts of the record disagree and residuals show nothing slow, its knots halved once more, if they then agree: too
  // coarse in places for the gain, by too little for (10.7). Needless refusals of clean records 7 -> 5 of 374; of 16 imperfect
  // ones that disagree it let none pass.
  void refine(const Candidate& best, const Steps& steps, Estimate& out) const {
    if (out.status != Status::ok || agree(out) || best.share > 1.0) return;
    std::vector<std::shared_ptr<Fit>> alone;
    for (std::size_t l = 0; l < pieces_.size(); ++l) {
      SpacingSearch search = search_of(l, pieces_[l], 1.0);
      alone.push_back(search.fit(rungs_[l] + 1));
      out.fits += search.fits();
      if (!alone.back()) return;
    }
    std::shared_ptr<Fit> robust = together(alone, out);
    if (!robust->failed && std::any_of(steps.begin(), steps.end(), [](const auto& t) { return !t.empty(); }))
      robust = robust_from(*robust, steps, out);
    if (robust->failed) return;
    set_mask(*robust);
    Estimate finer = out;
    finish(fit_rows(*robust, steps, finer), settings_, finer);
    out.fits = finer.fits;
    if (finer.status == Status::ok && agree(finer)) out = std::move(finer);
  }
};

}  // namespace truewrench
