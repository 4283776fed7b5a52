// The parts of a fit, and its logs, against each other (METHOD (10.11)).
#pragma once

#include "truewrench/estimation/agreement.hpp"
#include "truewrench/estimation/discrepancy.hpp"
#include "truewrench/estimation/told_by_logs.hpp"

#include <cmath>
#include <optional>
#include <vector>

namespace truewrench {

// (10.11) of two quarters of each log against the others, at the last linearisation and sizes; `found`: (10.9), empty where d is in
// the fit.
inline Agreement agreement_of_quarters(const Fit& fit, const std::vector<std::vector<Moment>>& found,
                                       std::size_t first, std::size_t second) {
  const std::vector<int> use = fit.active_places();
  const Eigen::VectorXd prior = Fit::pick(fit.prior, use);
  const Information &a = fit.quarters()[first], &b = fit.quarters()[second], all = fit.all();
  const Information part{a.S + b.S, a.g + b.g};
  Eigen::MatrixXd added = Eigen::MatrixXd::Zero(6 * fit.channels(), 6 * fit.channels());
  for (const bool rest : {false, true}) {
    if (found.empty()) break;
    const Keep clean = unmasked(fit);
    added +=
        spread(fit, found, sums_for_spread(fit, found, [&](std::size_t l, std::size_t s, Eigen::Index k) {
                 const LogFit& log = fit.logs()[l];
                 const std::size_t q = quarter_of(place(log, log.stretches[s].raw.time[k]));
                 return clean(l, s, k) && (q == first || q == second) != rest;
               }));
  }
  return compare({Fit::gather(part.S, use), Fit::pick(fit.pull(part.g, 0.5), use), prior},
                 {Fit::gather(all.S - part.S, use), Fit::pick(fit.pull(all.g - part.g, 0.5), use), prior},
                 added, prior);
}

// (10.11) of each log against the others. `pose`: (10.10), since what follows the pose need not be the same in two.
inline std::vector<Agreement> agreement_of_logs(const Fit& fit, const std::optional<ToldByLogs>& told,
                                                const std::vector<std::vector<Moment>>& found,
                                                const Eigen::MatrixXd& pose) {
  const std::size_t count = fit.logs().size();
  if (!told) return std::vector<Agreement>(count, {std::nan("")});
  const std::vector<int>& shared = told->shared;
  const std::vector<Information>& said = told->said;
  const Eigen::MatrixXd& S = told->all.S;
  const Eigen::VectorXd& g = told->all.g;
  const Eigen::VectorXd prior = Fit::pick(fit.prior, shared),
                        away = (Fit::pick(fit.theta, shared) - Fit::pick(fit.layout().mean(), shared))
                                   .cwiseQuotient(prior);
  std::vector<LogMoments> others, alone;
  if (!found.empty()) {
    others = sums_for_spread(fit, found, unmasked(fit));
    alone.assign(count,
                 LogMoments(fit, 0, [](std::size_t, std::size_t, Eigen::Index) { return false; }, {}, false));
  }
  std::vector<Agreement> out;
  for (std::size_t l = 0; l < count; ++l) {
    Eigen::MatrixXd added = 2.0 * pose;
    if (!found.empty()) {
      std::swap(alone[l], others[l]);
      added += spread(fit, found, alone) + spread(fit, found, others);
      std::swap(alone[l], others[l]);
    }
    out.push_back(compare({said[l].S, said[l].g - away, prior}, {S - said[l].S, g - said[l].g - away, prior},
                          added, prior));
  }
  return out;
}

}  // namespace truewrench
