// Every sample of a log as a fit predicts it, where the fit itself was of gathered rows.
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace truewrench {

// How many samples of the log a stretch holds.
inline Eigen::Index samples_of(const Fit& fit, std::size_t l, const Stretch& s) {
  const RecordedLog* whole = fit.logs()[l].whole;
  if (!whole) return s.raw.rows();
  Eigen::Index count = 0;
  for (Eigen::Index k = 0; k < whole->time.size(); ++k)
    count += whole->time[k] >= s.spline.begin() && whole->time[k] <= s.spline.end() &&
             finite_in(whole->raw, k) > 0;
  return count;
}

// Calls take(stretch, index) for all samples of a log, as predicted, in the order of time; where rows are gathered, in parts.
template <typename Take>
void each_sample(const Fit& fit, std::size_t l, const Take& take) {
  constexpr double part = 20.0;  // [s]
  const LogFit& log = fit.logs()[l];
  for (std::size_t i = 0; i < log.stretches.size(); ++i) {
    const Stretch& s = log.stretches[i];
    if (!log.whole) {
      take(s, i);
      continue;
    }
    const std::vector<Eigen::Index>& spikes = log.log->spikes;
    Eigen::Index row = 0;
    for (double from = s.spline.begin(); from < s.spline.end(); from += part) {
      const double to = std::min(from + part, s.spline.end());
      Stretch samples(*log.whole, fit.rig(), s.spline, from,
                      to < s.spline.end() ? std::nextafter(to, from) : to);
      if (samples.raw.rows() == 0) continue;
      samples.c = s.c;
      samples.e = s.e;
      samples.predict(fit.layout().log(l), fit.local(l), fit.lagged, log.sizes.form != Form::none);
      for (Eigen::Index k = 0; k < samples.raw.rows(); ++k) {  // masked as the nearest row is
        const double t = samples.raw.time[k];
        while (row + 1 < s.raw.rows() && std::abs(s.raw.time[row + 1] - t) <= std::abs(s.raw.time[row] - t))
          ++row;
        const auto ku = static_cast<std::size_t>(k);
        const bool spike = std::binary_search(spikes.begin(), spikes.end(), samples.raw.source[ku]);
        const bool masked = spike || s.raw.masked[static_cast<std::size_t>(row)] != 0;
        samples.raw.masked[ku] = masked ? 1 : 0;
        samples.raw.weight[k] = masked ? 0.0 : s.raw.weight[row] / s.raw.size[row];
      }
      take(samples, i);
    }
  }
}

}  // namespace truewrench
