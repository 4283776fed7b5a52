// The samples of a window, averaged to a few blocks on every interval of its spline
// (docs/method.md, "Windows of motion").
#pragma once

#include "truewrench/window_model.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

namespace truewrench {

// Consecutive samples of one interval with the same valid components, replaced by their mean. The mean of a
// spline is linear in its coefficients, so averaging loses nothing but the information inside a block, a
// fraction (block / interval)^2 of it.
struct MotionBlock {
  // Rows of the whitened measurement, by the order-th derivative of the coordinates and by the one below.
  struct Rows {
    Matrix6 of;
    Matrix6 of_lower;
    BasisRow lower;
  };

  int interval;
  BasisRow basis;  // mean of the order-th derivative of the active basis functions
  Vector6 value;   // whitened: over its sigma; 0 where missing
  Vector6 scale;   // sqrt(samples) / sigma; 0 where missing
  int rows = -1;   // index of the rows, or -1: `scale` times the derivative itself

  // What coordinates, or a change of them, contribute to the whitened measurement.
  template <typename Active>
  Vector6 of(const Active& xi, const std::vector<Rows>& all) const {
    const Vector6 s = xi.transpose() * basis;
    if (rows < 0) return scale.cwiseProduct(s);
    const Rows& r = all[static_cast<std::size_t>(rows)];
    return r.of * s + r.of_lower * (xi.transpose() * r.lower);
  }
};

// About a reference, the basis functions that the displacement has, and the reference itself.
struct ReferenceBlock {
  BasisRow lower;
  ReferencePoint point;
};

template <int N>
struct WrenchBlock {
  std::size_t first;  // samples of the log, up to
  std::size_t last;   // but without the last one
  int interval;
  BasisRow basis;  // mean of what gives the twist from the coordinates: the active basis functions, or their
  BasisRow basis_rate;    // first derivatives about a reference; of what gives the acceleration,
  BasisRow basis_second;  // and the jerk
  double spread;          // variance of the time stamps inside the block [s^2]
  double temperature;
  Vector3 gravity;
  ChannelVector<N> raw;
  ChannelVector<N> weight;
  std::optional<ReferenceBlock> reference;

  template <typename Active>
  MotionState state(const Active& xi) const {
    const Vector6 s = xi.transpose() * basis;
    const Vector6 ds = xi.transpose() * basis_rate;
    if (!reference) return {s, ds, gravity};
    return reference->point.displaced(xi.transpose() * reference->lower, s, ds, gravity);
  }

  template <typename Active>
  Vector6 jerk(const Active& xi) const {
    Vector6 s = xi.transpose() * basis_second;
    if (!reference) return s;
    return reference->point.displaced_jerk(xi.transpose() * reference->lower, xi.transpose() * basis,
                                           xi.transpose() * basis_rate, s);
  }
};

// The channels' derivatives by the coordinates: sum over terms of `by` times the basis functions.
template <int N>
struct WrenchTerms {
  int count = 2;
  std::array<ChannelMatrix<N>, 3> by;
  std::array<const BasisRow*, 3> basis{};

  WrenchTerms(const WindowModelAt<N>& model, const WrenchBlock<N>& b, const ChannelMatrix<N>& by_twist) {
    by[0] = by_twist;
    by[1] = model.raw_by_acceleration();
    basis[0] = &b.basis;
    basis[1] = &b.basis_rate;
    if (!b.reference) return;
    const Matrix6 turn = twist_adjoint(b.reference->point.nu);
    count = 3;
    by[2] = by_twist * turn + model.raw_by_acceleration() * twist_adjoint(b.reference->point.a);
    by[2].template rightCols<3>() += model.raw_by_gravity() * cross_matrix(b.gravity);
    by[0] += model.raw_by_acceleration() * turn;
    basis[2] = &b.reference->lower;
  }
};

// Bit c is set where component c of a row holds a number.
inline std::uint32_t valid_components(const double* row, int count) {
  std::uint32_t mask = 0;
  for (int c = 0; c < count; ++c) mask |= static_cast<std::uint32_t>(std::isfinite(row[c])) << c;
  return mask;
}

template <int N>
struct Blocks {
  std::vector<MotionBlock> motion;
  std::vector<MotionBlock::Rows> rows;  // of the blocks that need them
  std::vector<WrenchBlock<N>> wrench;

  // `per_interval`: blocks of a series on one interval of the spline, where it has at least that many samples.
  void build(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline, int per_interval,
             double delay, double assigned_at) {
    build_motion(model, window, spline, per_interval);
    build_wrench(model, window, spline, per_interval, delay, assigned_at);
  }

  void build_motion(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline,
                    int per_interval) {
    motion.clear();
    rows.clear();
    for (std::size_t m = 0; m < model.log().motion.size(); ++m) {
      const MotionSeries& series = model.log().motion[m];
      for_each_block(
          spline, series.time, 0.0, window.motion[m], per_interval,
          [&](std::size_t k) { return model.moved(m, k) ? valid_components(series.value + 6 * k, 6) : 0U; },
          [&](int interval, std::size_t first, std::size_t last, std::uint32_t mask) {
            Powers u = Powers::Zero();
            Vector6 sum = Vector6::Zero();
            for (std::size_t k = first; k < last; ++k) {
              u += powers(spline.local(interval, series.time[k]));
              sum += Eigen::Map<const Vector6>(series.value + 6 * k);
            }
            const double count = static_cast<double>(last - first);
            u /= count;
            MotionBlock b{interval, spline.basis(interval, u, series.order), sum / count,
                          std::sqrt(count) * series.sigma.cwiseInverse()};
            for (int c = 0; c < 6; ++c) {
              if (!(mask >> c & 1U)) b.value[c] = b.scale[c] = 0.0;
            }
            if (series.direct()) {
              b.value = b.value.cwiseProduct(b.scale).eval();
            } else {
              add_rows(b, series, first, last, spline.basis(interval, u, std::max(0, series.order - 1)));
            }
            motion.push_back(b);
          });
    }
  }

  // `delay` added to the sensor's stamps. `assigned_at`: the delay at which samples are dealt out to intervals and
  // blocks; held while the delay moves by less than an interval, it leaves the cost a smooth function of the delay.
  void build_wrench(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline,
                    int per_interval, double delay, double assigned_at) {
    wrench.clear();
    const int n = model.layout().channels;
    const WrenchSeries& series = model.log().wrench;
    const GravitySeries& gravity = model.log().gravity;
    const std::optional<ReferenceMotion>& reference = model.log().reference;
    const int order = reference ? 1 : 0;  // of the coordinates' derivative that is the twist
    const ChannelVector<N> precision = model.precision().cwiseAbs2();
    for_each_block(
        spline, series.time, assigned_at, window.wrench, per_interval,
        [&](std::size_t k) {
          return model.sensed(k) ? valid_components(series.raw + static_cast<std::size_t>(n) * k, n) : 0U;
        },
        [&](int interval, std::size_t first, std::size_t last, std::uint32_t mask) {
          Powers u = Powers::Zero();
          WrenchBlock<N> b;
          b.first = first;
          b.last = last;
          b.interval = interval;
          b.temperature = 0.0;
          b.gravity.setZero();
          b.raw.setZero(n);
          ReferencePoint point;
          for (std::size_t k = first; k < last; ++k) {
            const double t = series.time[k] + delay;
            if (reference) point += reference->at(t);
            u += powers(spline.local(interval, t));
            b.raw += model.raw(k);
            b.temperature += model.temperature(k);
            b.gravity += gravity.at(t);
          }
          const double count = static_cast<double>(last - first);
          u /= count;
          b.raw /= count;
          b.temperature /= count;
          b.gravity /= count;
          b.basis = spline.basis(interval, u, order);
          b.basis_rate = spline.basis(interval, u, order + 1);
          b.basis_second = spline.basis(interval, u, order + 2);
          if (reference) b.reference.emplace(spline.basis(interval, u, 0), point / count);
          const double half = 0.5 * spline.width(interval);
          b.spread = last - first > 1 ? (u[2] - u[1] * u[1]) * half * half : 0.0;
          b.weight = precision * count;
          for (int i = 0; i < n; ++i) {
            if (!(mask >> i & 1U)) b.raw[i] = b.weight[i] = 0.0;
          }
          wrench.push_back(b);
        });
  }

 private:
  // A mean of samples whose covariance and coupling change: unbiased, with the mean of both.
  void add_rows(MotionBlock& b, const MotionSeries& series, std::size_t first, std::size_t last,
                const BasisRow& lower) {
    const double count = static_cast<double>(last - first);
    MotionBlock::Rows r{series.combination.value_or(Matrix6::Identity()), Matrix6::Zero(), lower};
    Matrix6 whitening = b.scale.asDiagonal();
    if (series.covariance != nullptr) {
      Matrix6 mean = Matrix6::Zero();
      for (std::size_t k = first; k < last; ++k) mean += series.covariance_at(k);
      whitening = MotionSeries::whitening(mean / (count * count));
    }
    if (series.coupling != nullptr) {
      for (std::size_t k = first; k < last; ++k) r.of_lower += series.coupling_at(k) / count;
    }
    b.value = whitening * b.value;
    r.of_lower = whitening * r.of * r.of_lower;
    r.of = whitening * r.of;
    b.rows = static_cast<int>(rows.size());
    rows.push_back(r);
  }

  template <typename Mask, typename Emit>
  static void for_each_block(const BSpline& spline, std::span<const double> time, double delay,
                             std::pair<std::size_t, std::size_t> range, int per_interval, Mask mask,
                             Emit emit) {
    std::size_t k = range.first;
    for (int i = 0; i < spline.intervals() && k < range.second; ++i) {
      std::size_t last = range.second;
      if (i + 1 < spline.intervals()) {
        const double edge = spline.breakpoints()[static_cast<std::size_t>(i) + 1] - delay;
        last = static_cast<std::size_t>(
            std::lower_bound(time.begin() + static_cast<std::ptrdiff_t>(k),
                             time.begin() + static_cast<std::ptrdiff_t>(range.second), edge) -
            time.begin());
      }
      const std::size_t count = last - k;
      const std::size_t size = std::max<std::size_t>(1, count / static_cast<std::size_t>(per_interval));
      while (k < last) {
        const std::uint32_t m = mask(k);
        std::size_t end = k + 1;
        while (end < last && end - k < size && mask(end) == m) ++end;
        if (m != 0) emit(i, k, end, m);
        k = end;
      }
    }
  }
};

}  // namespace truewrench
