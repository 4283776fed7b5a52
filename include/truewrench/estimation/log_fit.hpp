// One log within a fit, and its quarters: what each adds to those before it is compared (10.11).
#pragma once

#include "truewrench/estimation/traces.hpp"

#include <algorithm>
#include <memory>
#include <vector>

namespace truewrench {

// One log within a fit.
struct LogFit {
  const RecordedLog* log = nullptr;
  const RecordedLog* whole = nullptr;           // of which `log` is gathered, else null
  std::shared_ptr<const RecordedLog> gathered;  // owner of such a `log`
  double h = constants::knot_spacing;
  double period = 0.01;  // [s] of the sensor's rows
  std::vector<Stretch> stretches;
  std::vector<Sweep> sweeps;
  Sizes sizes;
  static constexpr double tau_furthest = 0.7;                        // a move of log k, at most
  double tau_step = 0.0, tau_moved = 0.0, tau_limit = tau_furthest;  // last: argmin's, taken; of the next

  double longest() const {  // stretch [s]
    double out = 0.0;
    for (const Stretch& s : stretches) out = std::max(out, s.spline.end() - s.spline.begin());
    return out;
  }
};

// Place of a time within a log, 0 ... 1.
inline double place(const LogFit& log, double time) {
  const double begin = log.stretches.front().spline.begin(), end = log.stretches.back().spline.end();
  return (time - begin) / (end - begin);
}
inline std::size_t quarter_of(double place) {
  return static_cast<std::size_t>(std::clamp(4.0 * place, 0.0, 3.0));
}
inline std::size_t quarter_of(const LogFit& log, const Stretch& s, int block) {
  return quarter_of(place(log, s.spline.begin() + kBlock * s.spline.h() * (block + 0.5)));
}

// The last blocks of the quarters that end within a stretch.
inline std::vector<int> breaks(const LogFit& log, const Stretch& s) {
  std::vector<int> out;
  for (int g = 0; g + 1 < static_cast<int>(s.spline.blocks()); ++g)
    if (quarter_of(log, s, g) != quarter_of(log, s, g + 1)) out.push_back(g);
  return out;
}

}  // namespace truewrench
