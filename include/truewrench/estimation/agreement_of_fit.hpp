// The parts of a fit, and its logs, against each other (METHOD (10.11)).
#pragma once

#include "truewrench/estimation/agreement.hpp"
#include "truewrench/estimation/discrepancy.hpp"

#include <cmath>
#include <optional>
#include <utility>
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

// What the rows of a log say of parameters that others have, too: its own eliminated, with their prior (M13). `place`: of all of theta
// among the shared, -1 of others.
inline std::optional<Information> of_shared(const Fit& fit, std::size_t l, const std::vector<int>& place,
                                            Eigen::Index count) {
  const Information& all = fit.of_log(l);
  const std::vector<int>& global = fit.layout().log(l).global;
  std::vector<int> own, shared;  // places in the log's theta
  std::vector<int> own_at, to;   // and in that of all, or among the shared
  for (std::size_t i = 0; i < global.size(); ++i) {
    const auto at = static_cast<std::size_t>(global[i]);
    if (fit.active[at] == 0) continue;
    (place[at] < 0 ? own : shared).push_back(static_cast<int>(i));
    (place[at] < 0 ? own_at : to).push_back(place[at] < 0 ? global[i] : place[at]);
  }
  Eigen::MatrixXd S = Fit::gather(all.S, own), inverse, cross(own.size(), shared.size());
  Eigen::VectorXd pull = Fit::pick(all.g, own);
  for (std::size_t i = 0; i < own.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    S(row, row) += 1.0 / fit.prior[own_at[i]];
    pull[row] += fit.beside_rows(own_at[i]);
    for (std::size_t j = 0; j < shared.size(); ++j)
      cross(row, static_cast<Eigen::Index>(j)) = all.S(own[i], shared[j]);
  }
  double logdet = 0.0;
  if (!dense::invert(S, inverse, logdet)) return std::nullopt;
  const Eigen::MatrixXd by = dense::transposed_times(inverse, cross),
                        told = Fit::gather(all.S, shared) - dense::transposed_times(cross, by);
  const Eigen::VectorXd g = Fit::pick(all.g, shared) - by.transpose() * pull;
  Information out{Eigen::MatrixXd::Zero(count, count), Eigen::VectorXd::Zero(count)};
  for (std::size_t i = 0; i < to.size(); ++i) {
    out.g[to[i]] = g[static_cast<Eigen::Index>(i)];
    for (std::size_t k = 0; k < to.size(); ++k)
      out.S(to[i], to[k]) = told(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k));
  }
  return out;
}

// What each of several logs says of the parameters that others have, too, and their sum; the gains come first.
struct ToldByLogs {
  std::vector<int> shared;  // places in theta
  std::vector<Information> said;
  Information all;
};

inline std::optional<ToldByLogs> told_by_logs(const Fit& fit) {
  ToldByLogs out;
  std::vector<int> logs_of(fit.active.size(), 0);
  for (std::size_t l = 0; l < fit.logs().size(); ++l)
    for (const int at : fit.layout().log(l).global) ++logs_of[static_cast<std::size_t>(at)];
  std::vector<int> place(fit.active.size(), -1);
  for (const int at : fit.active_places())
    if (logs_of[static_cast<std::size_t>(at)] > 1) {
      place[static_cast<std::size_t>(at)] = static_cast<int>(out.shared.size());
      out.shared.push_back(at);
    }
  const auto size = static_cast<Eigen::Index>(out.shared.size());
  out.all = {Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size)};
  for (std::size_t l = 0; l < fit.logs().size(); ++l) {
    const auto of = of_shared(fit, l, place, size);
    if (!of) return std::nullopt;
    out.said.push_back(*of);
    out.all.S += of->S;
    out.all.g += of->g;
  }
  return out;
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
