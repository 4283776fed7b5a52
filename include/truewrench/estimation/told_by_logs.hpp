// What each of several logs says of the parameters that they share.
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <algorithm>
#include <optional>
#include <vector>

namespace truewrench {

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

// f_i^2 (n) of several logs, found as f_il^2 (n, L): the mean by the share that a log has in the estimate of a channel's gains,
// tr T_l, T_l = (sum_l S_l + Pi^-1)^-1 S_l; and no less than the median of the logs, as of two that contradict each other either may
// have been given the disturbance. Of size 0: no log tells any.
inline Eigen::VectorXd by_share(const Fit& fit, const ToldByLogs& told, const Eigen::MatrixXd& f2) {
  const Eigen::Index gains = 6 * f2.rows(), size = told.all.S.rows();
  Eigen::MatrixXd S = told.all.S, P;
  for (Eigen::Index i = 0; i < size; ++i)
    S(i, i) += 1.0 / fit.prior[told.shared[static_cast<std::size_t>(i)]];
  double logdet = 0.0;
  if (size < gains || !dense::invert(S, P, logdet)) return {};
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(f2.rows()), all = sum;
  for (Eigen::Index l = 0; l < f2.cols(); ++l) {
    const Eigen::MatrixXd T = dense::transposed_times(P, told.said[static_cast<std::size_t>(l)].S);
    for (Eigen::Index k = 0; k < gains; ++k) {
      sum[k / 6] += std::max(T(k, k), 0.0) * f2(k / 6, l);
      all[k / 6] += std::max(T(k, k), 0.0);
    }
  }
  if (!(all.minCoeff() > 0.0)) return {};
  std::vector<double> sorted(static_cast<std::size_t>(f2.cols()));
  for (Eigen::Index i = 0; i < f2.rows(); ++i) {
    for (Eigen::Index l = 0; l < f2.cols(); ++l) sorted[static_cast<std::size_t>(l)] = f2(i, l);
    std::sort(sorted.begin(), sorted.end());
    const double median = 0.5 * (sorted[(sorted.size() - 1) / 2] + sorted[sorted.size() / 2]);
    sum[i] = std::max(sum[i] / all[i], median);
  }
  return sum;
}

}  // namespace truewrench
