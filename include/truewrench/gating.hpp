// Which samples of a window are left out, because what they show is neither noise nor motion
// (docs/method.md, "Contacts and outliers").
#pragma once

#include "truewrench/contact.hpp"
#include "truewrench/residuals.hpp"

#include <algorithm>
#include <utility>
#include <vector>

namespace truewrench {

// The gate of a window's log; a log without one takes every sample, and nothing here has an effect.
template <int N>
class WindowGating {
 public:
  // `false_disturbances`: found by chance in a window without any.
  WindowGating(const WindowModel<N>& model, double false_disturbances)
      : model_(model), gate_(model.gate()), false_disturbances_(false_disturbances) {}

  bool possible() const { return gate_ != nullptr; }

  // Takes all samples of a window again: of the motion, of the sensor, or of both.
  void open(const WindowRange& window, Terms terms) const {
    if (!possible()) return;
    if (terms == Terms::all) return Gate::take(gate_->wrench, window.wrench.first, window.wrench.second);
    for (std::size_t m = 0; m < window.motion.size(); ++m) {
      Gate::take(gate_->motion[m], window.motion[m].first, window.motion[m].second);
    }
  }
  void open(const WindowRange& window) const {
    open(window, Terms::motion);
    open(window, Terms::all);
  }

  // Looks for disturbances in the streams that `terms` adds. They are kept for leave_out().
  bool disturbed(const WindowFit& fit, const WindowRange& window, Terms terms) {
    const std::vector<RowMatrix> rows = WindowResiduals<N>(model_, fit, window).rows(terms);
    found_.clear();
    for (std::size_t s = 0; s < rows.size(); ++s) {
      if (rows[s].rows() == 0) continue;
      const DisturbanceScan scan(rows[s]);
      for (const Disturbance& d : scan.find(scan.samples() / 3, false_disturbances_)) {
        found_.emplace_back(terms == Terms::all ? -1 : static_cast<int>(s), d);
      }
    }
    return !found_.empty();
  }

  void leave_out(const WindowRange& window) const {
    for (const auto& [series, d] : found_) {
      std::vector<char>& g = series < 0 ? gate_->wrench : gate_->motion[static_cast<std::size_t>(series)];
      const std::size_t first =
          series < 0 ? window.wrench.first : window.motion[static_cast<std::size_t>(series)].first;
      Gate::leave_out(g, first + d.first, first + d.last);
    }
  }

  // Stretches left out.
  int disturbances(const WindowRange& window) const {
    if (!possible()) return 0;
    int sum = 0;
    const auto count = [&](const std::vector<char>& g, const Samples& r) {
      for (std::size_t k = r.first; k < r.second; ++k) sum += g[k] != 0 && (k == r.first || g[k - 1] == 0);
    };
    count(gate_->wrench, window.wrench);
    for (std::size_t m = 0; m < window.motion.size(); ++m) count(gate_->motion[m], window.motion[m]);
    return sum;
  }

  // Share of the samples left out, of the series that lost most.
  double left_out_share(const WindowRange& window) const {
    if (!possible()) return 0.0;
    double most = share(gate_->wrench, window.wrench);
    for (std::size_t m = 0; m < window.motion.size(); ++m) {
      most = std::max(most, share(gate_->motion[m], window.motion[m]));
    }
    return most;
  }

 private:
  using Samples = std::pair<std::size_t, std::size_t>;

  static double share(const std::vector<char>& gate, const Samples& r) {
    if (r.first == r.second) return 0.0;
    const auto begin = gate.begin() + static_cast<std::ptrdiff_t>(r.first);
    const auto end = gate.begin() + static_cast<std::ptrdiff_t>(r.second);
    return static_cast<double>(std::count(begin, end, 1)) / static_cast<double>(r.second - r.first);
  }

  const WindowModel<N>& model_;
  Gate* gate_;
  double false_disturbances_;
  std::vector<std::pair<int, Disturbance>> found_;  // the series of the motion, or -1 for the sensor
};

}  // namespace truewrench
