// How d enters FIT (METHOD 10.3): where the moments of a fit without it ask for it, in two forms.
#pragma once

#include "truewrench/estimation/estimate.hpp"
#include "truewrench/estimation/mask.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

namespace truewrench {

// The logs of a fit without its factorisation.
inline std::vector<LogFit> bare(const Fit& fit) {
  std::vector<LogFit> out;
  for (const LogFit& l : fit.logs()) {
    LogFit copy;
    copy.log = l.log;
    copy.whole = l.whole;
    copy.gathered = l.gathered;
    copy.h = l.h;
    copy.period = l.period;
    copy.stretches = l.stretches;
    out.push_back(std::move(copy));
  }
  return out;
}

// d begins at what the moments of a fit without it show, within 0.1 to 1 sigma.
inline void start_slow(const Fit& plain, LogFit& log, std::size_t l, const std::vector<Moment>& found) {
  Sizes& z = log.sizes;
  for (Stretch& s : log.stretches) s.e.setZero();
  z.k = z.form == Form::walk ? 1.0 / log.longest() : 1.0 / 0.3;
  for (int r = 0; r < z.delta.size(); ++r) {
    const double sigma = plain.group_sigma(l, r);
    z.delta[r] = std::clamp(std::sqrt(found[static_cast<std::size_t>(r)].delta2), 0.1 * sigma, sigma);
  }
}

// FIT without d, and what its moments show of something slow.
inline Candidate without_slow(const std::shared_ptr<Fit>& plain) {
  Candidate rows{plain, {}, {}, 0.0, false};
  const int n = plain->channels();
  if (plain->failed) return rows;
  std::vector<LogMoments> sums;
  for (std::size_t l = 0; l < plain->logs().size(); ++l) {
    sums.push_back(unmasked_sums(*plain, l));
    rows.moments.push_back(moments(*plain, sums.back()));
  }
  rows.added = spread(*plain, rows.moments, sums);
  const Eigen::MatrixXd P = plain->covariance();
  for (int i = 0; i < 6 * n; ++i) rows.share = std::max(rows.share, rows.added(i, i) / P(i, i));
  return rows;
}

// The same, or with d in the likelier of both forms; beside a fit that has d, in its form from where it is there, and as a walk:
// that has no tau, which may run away.
inline Candidate with_slow(Candidate rows, int& fits, const Fit* known = nullptr) {
  const std::shared_ptr<Fit> plain = rows.fit;
  if (plain->failed) return rows;
  plain->release();
  for (const Form form : {Form::matern, Form::walk}) {
    const bool begun = known != nullptr && form == known->logs().front().sizes.form;
    if (known != nullptr && !begun && form == Form::matern) continue;
    auto d = std::make_shared<Fit>(plain->shared_rig(), bare(*plain), plain->steps(), plain->threads());
    for (LogFit& log : d->logs()) log.sizes.form = form;
    d->start_from(begun ? *known : *plain);
    for (std::size_t l = 0; l < d->logs().size(); ++l) {
      Sizes& z = d->logs()[l].sizes;
      for (int r = 0; r < z.delta.size(); ++r)
        z.cap[r] = constants::discrepancy_cap * plain->group_sigma(l, r);
      if (!begun) start_slow(*plain, d->logs()[l], l, rows.moments[l]);
    }
    d->run();
    ++fits;
    std::shared_ptr<Fit> loser = d;
    const bool plain_stands = rows.fit == plain;
    if (!d->failed && std::isfinite(d->deviance()) && (plain_stands || d->deviance() < rows.fit->deviance()))
      std::swap(rows.fit, loser);
    loser->release();
  }
  rows.found = rows.fit != plain;
  if (rows.found) rows.added.setZero();
  return rows;
}

// The masked samples, too, where they are more than a record may lose and neither noise nor d is much larger with them: the
// beginning of a drift looks like a contact to ROBUST, which has no d.
inline void keep_masked(Candidate& best, int& fits) {
  std::vector<std::size_t> lost;
  for (std::size_t l = 0; l < best.fit->logs().size() && best.found; ++l)
    if (masked_share(*best.fit, l) > constants::most_lost) lost.push_back(l);
  if (lost.empty()) return;
  auto trial =
      std::make_shared<Fit>(best.fit->shared_rig(), bare(*best.fit), best.fit->steps(), best.fit->threads());
  for (std::size_t l = 0; l < trial->logs().size(); ++l) {
    trial->logs()[l].sizes.form = best.fit->logs()[l].sizes.form;
    trial->logs()[l].sizes.cap = best.fit->logs()[l].sizes.cap;
  }
  for (const std::size_t l : lost) clear_mask(trial->logs()[l]);
  trial->start_from(*best.fit).run();
  ++fits;
  if (trial->failed) return;
  const auto larger = [](const Eigen::VectorXd& with, const Eigen::VectorXd& without) {
    return (with.array() / without.array()).maxCoeff();
  };
  for (const std::size_t l : lost) {
    const Sizes &with = trial->logs()[l].sizes, &without = best.fit->logs()[l].sizes;
    if (std::pow(larger(with.raw_factor, without.raw_factor), 2) > constants::mask_worth ||
        larger(with.delta, without.delta) > constants::mask_worth)
      return;
  }
  best.fit->release();
  best.fit = std::move(trial);
}

}  // namespace truewrench
