// Where a record is cut, and how densely its knots lie (METHOD 10.2, 10.6).
#pragma once

#include "truewrench/estimation/gather.hpp"
#include "truewrench/estimation/hyperparameters.hpp"
#include "truewrench/estimation/mask.hpp"
#include "truewrench/estimation/start.hpp"

#include <cmath>
#include <functional>
#include <map>
#include <memory>
#include <vector>

namespace truewrench {

// Where a record is cut: where all motion streams, or the sensor, are silent for five periods and six knots (METHOD 10.6), and
// where a root frame begins.
struct Piece {
  double begin = 0.0, end = 0.0;
};

// Stamps at which the sensor has a sample.
inline Eigen::VectorXd sensor_times(const RecordedLog& log) {
  std::vector<double> at;
  for (Eigen::Index k = 0; k < log.time.size(); ++k)
    if (log.raw.row(k).array().isFinite().any()) at.push_back(log.time[k]);
  return Eigen::Map<const Eigen::VectorXd>(at.data(), static_cast<Eigen::Index>(at.size()));
}

// Of the fastest motion stream [s].
inline double motion_period(const RecordedLog& log) {
  double out = 0.0;
  for (const MotionStream& m : log.motion) {
    const double p = median_period(m.time);
    if (p > 0.0 && (out == 0.0 || p < out)) out = p;
  }
  return out;
}

inline std::vector<Piece> pieces_of(const RecordedLog& log, double h, int& dropped) {
  std::vector<double> motion;
  const Eigen::VectorXd stamps = sensor_times(log);
  const std::vector<double> sensor(stamps.data(), stamps.data() + stamps.size());
  for (const MotionStream& m : log.motion)
    for (Eigen::Index k = 0; k < m.time.size(); ++k)
      if (m.value.row(k).array().isFinite().any()) motion.push_back(m.time[k]);
  std::sort(motion.begin(), motion.end());
  const auto covered = [h, &log](const std::vector<double>& time, double period) {
    std::vector<Piece> out;
    auto root = log.own_roots.begin();
    for (std::size_t k = 0; k < time.size(); ++k) {
      const auto next = std::upper_bound(root, log.own_roots.end(), time[k]);
      if (k == 0 || time[k] - time[k - 1] > std::max(5.0 * period, 6.0 * h) || next != root)
        out.push_back({time[k], time[k]});
      root = next;
      out.back().end = time[k];
    }
    return out;
  };
  const std::vector<Piece> a = covered(sensor, median_period(stamps)),
                           b = covered(motion, motion_period(log));
  std::vector<Piece> out;
  dropped = 0;
  for (std::size_t i = 0, j = 0; i < a.size() && j < b.size();) {
    const Piece both{std::max(a[i].begin, b[j].begin), std::min(a[i].end, b[j].end)};
    if (both.end > both.begin) {
      if (both.end - both.begin >= 12.0 * h)
        out.push_back(both);
      else
        ++dropped;
    }
    (a[i].end < b[j].end ? i : j) += 1;
  }
  return out;
}

// Seconds that some pieces last together.
inline double lasting(const std::vector<Piece>& pieces) {
  double sum = 0.0;
  for (const Piece& p : pieces) sum += p.end - p.begin;
  return sum;
}

// The ladder of spacings: from max(0.05 s, 2.5 periods of the motion), halved down to one sample (10.2).
inline std::vector<double> spacings(double period) {
  std::vector<double> out{coarsest_spacing(period)};
  while (out.back() / 2.0 > 1.01 * period) out.push_back(out.back() / 2.0);
  out.push_back(period);
  return out;
}

// The seconds of a single log, `constants::pilot` long or a whole stretch, that a fit explains worst: sum of chi^2, robust.
inline Piece worst_part(const Fit& fit) {
  const LogFit& log = fit.logs()[0];
  Piece worst;
  double most = -1.0;
  for (const Stretch& s : log.stretches) {
    const double begin = s.spline.begin(), bin = constants::pilot / 8.0;
    std::vector<double> sum(static_cast<std::size_t>((s.spline.end() - begin) / bin) + 1, 0.0);
    const auto at = [&](double t) -> double& {
      return sum[std::min(sum.size() - 1, static_cast<std::size_t>(std::max(0.0, t - begin) / bin))];
    };
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k) at(s.raw.time[k]) += s.raw.weight[k] * fit.chi2(0, s, k);
    for (std::size_t m = 0; m < s.motion.size(); ++m)
      for (int j = 0; j < s.components(); ++j) {
        const MotionStream& stream = log.log->motion[m];
        const double sigma = stream.sigma[j] * log.sizes.motion_factor[m][stream.group[j]];
        for (Eigen::Index k = 0; k < s.motion[m].rows(); ++k)
          at(s.motion[m].time[k]) += s.motion[m].size[k] * std::pow(s.motion[m].residual(k, j) / sigma, 2.0);
      }
    for (std::size_t first = 0; first == 0 || first + 8 <= sum.size(); ++first) {
      double here = 0.0;
      const std::size_t end = std::min(first + 8, sum.size());
      for (std::size_t i = first; i < end; ++i) here += sum[i];
      if (here <= most) continue;
      most = here;
      worst = {begin + bin * static_cast<double>(first),
               std::min(begin + bin * static_cast<double>(end), s.spline.end())};
    }
  }
  return worst;
}

// h of one log by (10.7) among h, h / 2 and the best for the motion alone, 6 a halving; again from there.
class SpacingSearch {
 public:
  // `at`: the log's fit at a spacing; `repeated`: how often what it holds stands in the record.
  SpacingSearch(std::shared_ptr<const Statement> rig, std::function<LogFit(double)> at,
                std::vector<double> ladder, double repeated, int threads)
      : rig_(std::move(rig)),
        at_(std::move(at)),
        ladder_(std::move(ladder)),
        repeated_(repeated),
        threads_(threads) {}

  // The place of the best h in the ladder. `sound`: the coarsest leaves nothing to mask in the whole log, and no more noise than
  // stated; where the motion alone asks for no finer h either, the wrench asked in none of 330 logs, healthy and imperfect.
  std::size_t best(bool sound = false) {
    std::size_t now = 0, alone = 0;
    for (std::size_t i = 1; i < ladder_.size(); ++i)
      if (cost_alone(i) < cost_alone(alone)) alone = i;
    if (sound && alone == 0) return 0;
    fit(0);
    for (;;) {
      for (const std::size_t i : {now + 1, alone})
        if (i > now && i < ladder_.size()) fit(i);
      std::size_t best = now;
      for (const auto& [i, one] : fits_)
        if (cost(i) < cost(best) && follows(i, now)) best = i;
      if (best <= now && now + 1 < ladder_.size() && resolves(now + 1, now)) best = now + 1;
      if (best <= now) return now;
      now = best;
    }
  }

  // Whether an h is better than the coarsest.
  bool better(std::size_t i) {
    fit(0);
    return fit(i) && ((cost(i) < cost(0) && follows(i, 0)) || resolves(i, 0));
  }

  // ROBUST at a spacing, without the memory of its factorisation; null where none came to an end, or the ladder has none.
  std::shared_ptr<Fit> fit(std::size_t i) {
    if (i >= ladder_.size()) return nullptr;
    const auto known = fits_.find(i);
    if (known != fits_.end()) return known->second;
    const std::shared_ptr<Fit> found = started(i);
    if (found) found->release();
    return fits_[i] = found;
  }

  int fits() const { return count_; }

  // Whether the sensor's noise seems larger than stated.
  static bool noisy(const Fit& fit) {
    return std::any_of(fit.logs().begin(), fit.logs().end(), [](const LogFit& log) {
      return log.sizes.raw_factor.maxCoeff() > constants::noise_told;
    });
  }
  // Whether a first step shows nothing to mask and no more noise than is stated: FIT may go on from there.
  static bool clean(Fit& fit) {
    if (noisy(fit)) return false;
    set_mask(fit);
    const bool kept = leave_in(fit);
    for (LogFit& log : fit.logs()) clear_mask(log);
    return !kept;
  }

 private:
  struct Alone {  // the motion's own fit
    std::vector<RowMatrix> c;
    Sizes sizes;
    double cost = std::numeric_limits<double>::infinity();
  };

  std::shared_ptr<const Statement> rig_;
  std::function<LogFit(double)> at_;
  std::vector<double> ladder_;
  double repeated_;
  int threads_, count_ = 0;
  std::map<std::size_t, Alone> alone_;
  std::map<std::size_t, std::shared_ptr<Fit>> fits_;

  std::shared_ptr<Fit> bare(std::size_t i) const {
    std::vector<LogFit> one;
    one.push_back(at_(ladder_[i]));
    return std::make_shared<Fit>(rig_, std::move(one), std::vector<std::vector<double>>{}, threads_);
  }

  double priced(std::size_t i, double deviance) const {
    return repeated_ * deviance + constants::halving_cost * std::log2(ladder_[0] / ladder_[i]);
  }

  const Alone& alone(std::size_t i) {
    const auto known = alone_.find(i);
    if (known != alone_.end()) return known->second;
    Alone& out = alone_[i];
    const auto fit = bare(i);
    const double deviance = motion_alone(fit->logs()[0], fit->layout(), 0);
    if (std::isfinite(deviance)) out.cost = priced(i, deviance);
    out.sizes = fit->logs()[0].sizes;
    for (Stretch& s : fit->logs()[0].stretches) out.c.push_back(std::move(s.c));
    return out;
  }
  double cost_alone(std::size_t i) { return alone(i).cost; }

  double cost(std::size_t i) {
    const auto& fit = fits_.at(i);
    const double deviance = fit ? fit->deviance() : std::numeric_limits<double>::infinity();
    if (fit) fit->release();
    return std::isfinite(deviance) ? priced(i, deviance) : std::numeric_limits<double>::infinity();
  }

  // From the motion alone and Cauchy weights.
  std::shared_ptr<Fit> started(std::size_t i) {
    const auto fit = bare(i);
    const Alone& from = alone(i);
    LogFit& log = fit->logs()[0];
    log.sizes = from.sizes;
    for (std::size_t s = 0; s < from.c.size(); ++s) log.stretches[s].c = from.c[s];
    fit->robust = true;
    regress(*fit);
    fit->run(i == 0 ? clean : std::function<bool(Fit&)>());
    ++count_;
    return fit->failed ? nullptr : fit;
  }

  bool follows(std::size_t i, std::size_t now) {
    return i <= now || !fits_[now] || cost_alone(i) < cost_alone(now) ||
           moves(fits_[i]->logs()[0], fits_[now]->logs()[0]);
  }

  // Whether finer knots keep more than half of the samples from the mask: what they follow is no contact, whatever (10.7) says of
  // a motion that is lively in places.
  bool resolves(std::size_t i, std::size_t now) const {
    const auto &fine = fits_.at(i), &coarse = fits_.at(now);
    if (!fine || !coarse) return false;
    const double masked = masked_share(with_mask(*coarse), 0);
    return masked > constants::masked_told &&
           masked > constants::masked_told + 2.0 * masked_share(with_mask(*fine), 0);
  }

  // Whether finer knots follow what moves, where the motion alone does not ask for them: its noise is found smaller, in no group
  // of it larger by more than the one sigma to which it is known. (10.7) alone follows a force that shakes the sensor with a
  // motion that the velocities deny (12 to 40 Hz: NEES 16).
  static bool moves(const LogFit& fine, const LogFit& coarse) {
    double sum = 0.0;
    for (std::size_t m = 0; m < fine.log->motion.size(); ++m)
      for (Eigen::Index g = 0; g < fine.sizes.motion_factor[m].size(); ++g) {
        double rows = 0.0;
        for (const Stretch& s : fine.stretches)
          for (int j = 0; j < s.components(); ++j)
            if (fine.log->motion[m].group[j] == g) rows += s.motion[m].samples[j];
        const double change =
            rows * std::log(fine.sizes.motion_factor[m][g] / coarse.sizes.motion_factor[m][g]);
        if (change > std::sqrt(0.5 * rows)) return false;
        sum += change;
      }
    return sum < 0.0;
  }
};

}  // namespace truewrench
