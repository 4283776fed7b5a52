// What the loop of METHOD 10.3 returns: the estimate, the sizes found, and the findings that a judgement needs.
#pragma once

#include "truewrench/estimation/agreement_of_fit.hpp"
#include "truewrench/estimation/hyperparameters.hpp"
#include "truewrench/estimation/pose.hpp"
#include "truewrench/estimation/told_by_logs.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

namespace truewrench {

struct Settings {
  int threads = 1;
  double discrepancy = -1.0;  // stated: -1 auto, 0 none, else at least so much [fraction of range]
  bool brief = false;         // nothing but START, ROBUST, MASK and FIT, on the coarsest knots
};

struct Estimate {
  std::shared_ptr<Fit> fit;
  Status status = Status::ok;
  std::vector<std::vector<Moment>> moments;  // by log and group
  Eigen::MatrixXd covariance;                // of theta, held parameters with their prior's width
  Eigen::MatrixXd added;                     // (10.9) (6n, 6n), 0 where d is in the fit
  Eigen::MatrixXd gain_covariance;           // of C: with (10.9) and (10.10)
  Eigen::VectorXd discrepancy2;              // (n) delta_i^2 for (10.10)
  PoseShare pose;
  Agreement halves, quarters;
  std::vector<Agreement> logs;   // each against the others; of a single one nothing
  std::vector<char> unresolved;  // by log: (10.7) still falls at one knot a sample
  std::vector<double>
      unexplained;  // by log: share of the raw output that no motion explains; 0 where its noise is as stated
  std::vector<int> dropped;  // by log: stretches too short
  int fits = 0;
};

// FIT, which may stand, with (10.9).
struct Candidate {
  std::shared_ptr<Fit> fit;
  std::vector<std::vector<Moment>> moments;
  Eigen::MatrixXd added;
  double share = 0.0;  // largest ratio of (10.9) to a gain's variance
  bool found = false;  // d is in the fit, its size found
};

inline bool agree(const Estimate& e) {
  return e.halves.p >= 0.5 * constants::doubt && e.quarters.p >= 0.5 * constants::doubt;
}

// Of all logs, over the unmasked samples.
inline PoseShare pose_share(const Fit& fit) {
  PoseSums sums;
  for (const LogFit& log : fit.logs())
    for (const Stretch& s : log.stretches) {
      for (Eigen::Index k = 0; k < s.raw.rows(); ++k)
        sums.add(s.raw.time[k], s.raw.size[k], s.raw.masked[static_cast<std::size_t>(k)] != 0,
                 &s.now.nu(k, 0), &s.now.w(k, 0));
      sums.end_stretch(s.log().arm || s.log().source == Source::mapped);
    }
  return sums.share();
}

// Covariances, (10.10) and (10.11) of the fit that stands.
inline void finish(const Candidate& best, const Settings& settings, Estimate& out) {
  Fit& fit = *best.fit;
  out.fit = best.fit;
  out.moments = best.moments;
  // where it converged, its last step, which follows the factorisation, is less than 0.05 sigma
  if (fit.failed || !(fit.converged ? fit.stands() : fit.linearise() && fit.solve())) {
    out.status = Status::not_factorizable;
    return;
  }
  const int n = fit.channels();
  // the parts of the record
  const std::vector<std::vector<Moment>> found =
      best.found ? std::vector<std::vector<Moment>>{} : best.moments;
  out.halves = agreement_of_quarters(fit, found, 0, 1);
  out.quarters = agreement_of_quarters(fit, found, 0, 2);
  out.covariance = fit.covariance();
  out.added = best.added;
  out.pose = pose_share(fit);
  // delta_i^2 for (10.10): found, or its moment and 1 sd where d stayed out; over one period of the motion
  const double stated = std::max(settings.discrepancy, 0.0);
  const auto logs = static_cast<Eigen::Index>(fit.logs().size());
  Eigen::MatrixXd of_log(n, logs);
  out.discrepancy2 = Eigen::VectorXd::Zero(n);
  double total = 0.0;
  for (Eigen::Index l = 0; l < logs; ++l) {
    const LogFit& log = fit.logs()[static_cast<std::size_t>(l)];
    double rows = 0.0;
    for (const Stretch& s : log.stretches) rows += s.raw.size.sum();
    const Sizes& z = log.sizes;
    for (int i = 0; i < n; ++i) {
      const int r = raw_group(i, n);
      const Moment& m = best.moments[static_cast<std::size_t>(l)][static_cast<std::size_t>(r)];
      double f2 = best.found ? z.delta[r] * z.delta[r] : m.delta2 + m.sd;
      const double x = z.k * out.pose.period;
      if (z.form == Form::walk) f2 *= 2.0 * (1.0 - std::exp(-x));
      if (z.form == Form::matern) f2 *= std::min(1.0, 2.0 * (1.0 - (1.0 + x) * std::exp(-x)));
      out.discrepancy2[i] += rows * f2;
      of_log(i, l) = std::max(f2, stated * stated);
    }
    total += rows;
  }
  out.discrepancy2 /= total;
  const Eigen::MatrixXd before = out.covariance.topLeftCorner(6 * n, 6 * n) + out.added;
  out.gain_covariance = before;
  const double* prior = fit.prior.data() + fit.layout().C;
  if (settings.discrepancy != 0.0)
    add_pose(out.gain_covariance, prior, out.pose,
             [&](int i) { return std::max(out.discrepancy2[i], stated * stated); });
  if (logs < 2) return;
  // compared as if all were as disturbed: which of them is was for the fit to guess; then each by its share
  const std::optional<ToldByLogs> told = told_by_logs(fit);
  out.logs = agreement_of_logs(fit, told, found, out.gain_covariance - before);
  if (settings.discrepancy == 0.0 || !told) return;
  const Eigen::VectorXd f2 = by_share(fit, *told, of_log);
  if (f2.size() == 0) return;
  out.gain_covariance = before;
  add_pose(out.gain_covariance, prior, out.pose, [&](int i) { return f2[i]; });
}

}  // namespace truewrench
