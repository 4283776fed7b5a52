// Residuals of a fitted window at every sample, over their sigma.
#pragma once

#include "truewrench/fit.hpp"
#include "truewrench/window.hpp"

#include <algorithm>
#include <limits>
#include <span>
#include <utility>
#include <vector>

namespace truewrench {

template <int N>
class WindowResiduals {
 public:
  WindowResiduals(const WindowModel<N>& model, const WindowFit& fit, const WindowRange& window)
      : model_(model), fit_(fit), window_(window) {}

  // Calls visit(sample, interval, residual over sigma) for the samples of a series of the motion that are not left out.
  template <typename Visit>
  void for_each_motion(std::size_t m, const Visit& visit) const {
    const MotionSeries& series = model_.log().motion[m];
    const Vector6 precision = series.sigma.cwiseInverse();
    for_each_sample(series.time, 0.0, window_.motion[m],
                    [&](std::size_t k, int i, const Polynomial& x, const Powers& u) {
                      if (!model_.moved(m, k)) return;
                      const Vector6 value = Eigen::Map<const Vector6>(series.value + 6 * k);
                      Vector6 s = x * derivative(i, u, series.order);
                      if (series.coupling != nullptr) {
                        s += series.coupling_at(k) * (x * derivative(i, u, series.order - 1));
                      }
                      if (series.combination) s = (*series.combination * s).eval();
                      visit(k, i,
                            series.covariance != nullptr
                                ? Vector6(MotionSeries::whitening(series.covariance_at(k)) * (value - s))
                                : Vector6((value - s).cwiseProduct(precision)));
                    });
  }

  // The same for the sensor.
  template <typename Visit>
  void for_each_sensor(const Visit& visit) const {
    const WindowModelAt<N> model(model_, fit_.theta);
    for_each_wrench([&](std::size_t k, int i, const Vector6& w) {
      if (!model_.sensed(k)) return;
      visit(k, i, (model_.raw(k) - model.raw_of(w, model_.temperature(k))).cwiseProduct(model_.precision()));
    });
  }

  // Calls visit(sample, interval, normalised wrench) for all samples of the sensor.
  template <typename Visit>
  void for_each_wrench(const Visit& visit) const {
    const WrenchSeries& series = model_.log().wrench;
    const std::optional<ReferenceMotion>& reference = model_.log().reference;
    const WindowModelAt<N> model(model_, fit_.theta);
    for_each_sample(series.time, model.delay(), window_.wrench,
                    [&](std::size_t k, int i, const Polynomial& x, const Powers& u) {
                      const double t = series.time[k] + model.delay();
                      const Vector3 g = model_.log().gravity.at(t);
                      const Powers du = fit_.spline.rate(i, u);
                      if (!reference) return visit(k, i, model.wrench_of({x * u, x * du, g}));
                      const Vector6 ddp = x * fit_.spline.rate(i, du);
                      visit(k, i, model.wrench_of(reference->at(t).displaced(x * u, x * du, ddp, g)));
                    });
  }

  // A row per sample of the window and series (of the motion, or of the sensor), NaN where left out.
  std::vector<RowMatrix> rows(Terms terms) const {
    const auto blank = [](const std::pair<std::size_t, std::size_t>& r, Eigen::Index columns) {
      return RowMatrix(RowMatrix::Constant(static_cast<Eigen::Index>(r.second - r.first), columns,
                                           std::numeric_limits<double>::quiet_NaN()));
    };
    std::vector<RowMatrix> out;
    if (terms == Terms::motion) {
      for (std::size_t m = 0; m < window_.motion.size(); ++m) {
        const std::size_t first = window_.motion[m].first;
        RowMatrix& of_series = out.emplace_back(blank(window_.motion[m], kCoordinates));
        for_each_motion(m, [&](std::size_t k, int, const Vector6& r) {
          of_series.row(static_cast<Eigen::Index>(k - first)) = r;
        });
      }
      return out;
    }
    RowMatrix& of_sensor = out.emplace_back(blank(window_.wrench, model_.layout().channels));
    for_each_sensor([&](std::size_t k, int, const ChannelVector<N>& r) {
      of_sensor.row(static_cast<Eigen::Index>(k - window_.wrench.first)) = r;
    });
    return out;
  }

  // Per interval and group.
  std::vector<Groups> groups(Terms terms) const {
    std::vector<Groups> out(static_cast<std::size_t>(fit_.spline.intervals()));
    for (std::size_t m = 0; m < window_.motion.size(); ++m) {
      for_each_motion(m, [&](std::size_t, int i, const Vector6& r) {
        for (int c = 0; c < 6; ++c) out[static_cast<std::size_t>(i)][motion_group(c)].add(r[c]);
      });
    }
    if (terms == Terms::motion) return out;
    const int n = model_.layout().channels;
    for_each_sensor([&](std::size_t, int i, const ChannelVector<N>& r) {
      for (int c = 0; c < n; ++c) out[static_cast<std::size_t>(i)][wrench_group(c, n)].add(r[c]);
    });
    return out;
  }

  // Per group, of up to so many stretches of equal length, each of whole intervals, that have samples. Coefficients are
  // dealt out to the groups by their samples.
  std::vector<Groups> stretches(int most) const {
    const std::vector<Groups> intervals = groups(Terms::all);
    most = std::min(most, fit_.spline.intervals());
    std::vector<Groups> out(static_cast<std::size_t>(most));
    for (int i = 0; i < fit_.spline.intervals(); ++i) {
      const auto k = static_cast<std::size_t>(i);
      const double middle = fit_.spline.breakpoints()[k] + 0.5 * fit_.spline.width(i);
      const double share = (middle - window_.begin) / (window_.end - window_.begin);
      Groups& stretch =
          out[static_cast<std::size_t>(std::clamp(static_cast<int>(share * most), 0, most - 1))];
      double samples = 0.0;
      for (const GroupStatistics& g : intervals[k]) samples += g.count;
      for (std::size_t g = 0; g < kGroups; ++g) {
        stretch[g] += intervals[k][g];
        if (samples > 0.0) stretch[g].leverage += kCoordinates * intervals[k][g].count / samples;
      }
    }
    std::erase_if(out, [](const Groups& stretch) {
      return std::none_of(stretch.begin(), stretch.end(),
                          [](const GroupStatistics& g) { return g.count > 0.0; });
    });
    return out;
  }

  // Of all channels.
  GroupStatistics sensor() const {
    GroupStatistics out;
    for_each_sensor([&](std::size_t, int, const ChannelVector<N>& r) {
      for (const double c : r) out.add(c);
    });
    return out;
  }

  // Of the whole window: per group, and of every channel and every component of the motion's first series.
  void summarise(Groups& groups, std::vector<ComponentStatistics>& components) const {
    groups = Groups{};
    components.clear();
    const int n = model_.layout().channels;
    for (const Terms terms : {Terms::all, Terms::motion}) {
      const std::vector<RowMatrix> all = rows(terms);
      const int columns = terms == Terms::all ? n : kCoordinates;
      for (int c = 0; c < columns; ++c) {
        ComponentStatistics& s = components.emplace_back();
        if (!all.empty()) s.add(all.front().col(c).eval());
        GroupStatistics& g = groups[terms == Terms::all ? wrench_group(c, n) : motion_group(c)];
        g += s.all;
        for (std::size_t m = 1; m < all.size(); ++m) {
          for (const double r : all[m].col(c)) g.add(r);
        }
      }
    }
  }

 private:
  using Polynomial = Eigen::Matrix<double, kCoordinates, kActive>;

  Powers derivative(int interval, Powers u, int order) const {
    for (int d = 0; d < order; ++d) u = fit_.spline.rate(interval, u);
    return u;
  }

  template <typename Visit>
  void for_each_sample(std::span<const double> time, double delay, std::pair<std::size_t, std::size_t> range,
                       const Visit& visit) const {
    std::size_t k = range.first;
    for (int i = 0; i < fit_.spline.intervals() && k < range.second; ++i) {
      const Polynomial x = fit_.spline.polynomial<kCoordinates>(i, fit_.x);
      const bool last = i + 1 == fit_.spline.intervals();
      const double edge = fit_.spline.breakpoints()[static_cast<std::size_t>(i) + 1];
      for (; k < range.second && (last || time[k] + delay < edge); ++k) {
        visit(k, i, x, powers(fit_.spline.local(i, time[k] + delay)));
      }
    }
  }

  const WindowModel<N>& model_;
  const WindowFit& fit_;
  const WindowRange& window_;
};

}  // namespace truewrench
