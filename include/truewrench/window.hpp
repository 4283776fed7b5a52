// One window of motion: residuals of every stream at its own time stamps, their normal equations in
// (spline coefficients, common parameters), and the Schur complement onto the common parameters
// (docs/method.md, "Windows of motion").
//
// Everything here is normalised: wrenches by the sensor's range per axis, channels by their full scale, so
// the gain has elements near one and no unit is mixed with another.
#pragma once

#include "truewrench/block_banded.hpp"
#include "truewrench/bspline.hpp"
#include "truewrench/payload.hpp"

#include <Eigen/Dense>

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace truewrench {

inline constexpr int kCoordinates = 6;  // motion coordinates: the components of a twist
inline constexpr int kMaxChannels =
    32;  // storage bound when the number of channels is known only at run time

template <int N>
inline constexpr int kChannelStorage = N == Eigen::Dynamic ? kMaxChannels : N;
template <int N>
using ChannelVector = Eigen::Matrix<double, N, 1, 0, kChannelStorage<N>, 1>;
template <int N>
using ChannelMatrix = Eigen::Matrix<double, N, 6, 0, kChannelStorage<N>, 6>;

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Coefficients = Eigen::Matrix<double, Eigen::Dynamic, kCoordinates, Eigen::RowMajor>;
using MotionNormal = BlockBanded<kCoordinates, kDegree>;

// Where the common parameters of one log stand in its vector: gains row by row, then the offset.
struct ParameterLayout {
  int channels = 6;
  bool offset = true;

  int gains() const { return 6 * channels; }
  int size() const { return gains() + (offset ? channels : 0); }
};

// Direct measurements of a derivative of the motion coordinates, NaN where there is none. For a logged twist:
// order 0 is the twist, order 1 its component-wise derivative.
struct MotionSeries {
  int order = 0;
  std::span<const double> time;   // [s]
  const double* value = nullptr;  // rows of six
  Vector6 sigma = Vector6::Ones();
};

struct WrenchSeries {
  std::span<const double> time;     // [s]
  const double* raw = nullptr;      // rows of n, NaN where there is no sample
  const double* gravity = nullptr;  // rows of three in sensor axes, or none: `gravity_constant` then holds
  Vector3 gravity_constant = Vector3::Zero();
};

// The linear map from the motion coordinates to the payload's motion. For a twist logged at a point of the
// body: nu = shift s, a = shift ds/dt.
struct TwistMap {
  Matrix6 shift = Matrix6::Identity();
};

// One recording of one payload.
struct LogData {
  Payload payload;
  TwistMap map;
  std::vector<MotionSeries> motion;
  WrenchSeries wrench;
};

// What is known of the sensor beforehand. `wrench_scale` = sign / range turns w into normalised, signed
// units.
template <int N>
struct SensorScale {
  ChannelVector<N> channel;  // full scale per channel, raw units
  ChannelVector<N> sigma;    // noise per sample, normalised
  Vector6 wrench_scale;
};

// A stretch of one log: sample ranges per series.
struct WindowRange {
  double begin = 0.0;
  double end = 0.0;
  std::vector<std::pair<std::size_t, std::size_t>> motion;  // [first, last) per motion series
  std::pair<std::size_t, std::size_t> wrench{0, 0};
};

// Consecutive samples of one interval with the same valid components, replaced by their mean. The mean of a
// spline is linear in its coefficients, so averaging loses nothing but the information inside a block, a
// fraction (block / interval)^2 of it.
struct MotionBlock {
  int interval;
  int order;
  BasisRow basis;  // mean of the order-th derivative of the active basis functions
  Vector6 value;
  Vector6 weight;  // samples / variance; 0 where missing
};

template <int N>
struct WrenchBlock {
  int interval;
  BasisRow basis;       // mean of the active basis functions
  BasisRow basis_rate;  // and of their time derivatives
  double spread;        // variance of the time stamps inside the block [s^2]
  Vector3 gravity;
  ChannelVector<N> raw;
  ChannelVector<N> weight;
};

template <int N>
class WindowModel {
 public:
  WindowModel(const LogData& log, const SensorScale<N>& sensor, const ParameterLayout& layout)
      : log_(log),
        sensor_(sensor),
        layout_(layout),
        per_channel_(sensor.channel.cwiseInverse()),
        precision_(sensor.sigma.cwiseInverse()),
        dw_da_(wrench_jacobian_acceleration(log.payload)) {}

  const ParameterLayout& layout() const { return layout_; }
  const LogData& log() const { return log_; }

  Vector6 wrench_at(const Vector6& s, const Vector6& ds, const Vector3& g, double spread = 0.0) const {
    const Vector6 nu = log_.map.shift * s;
    const Vector6 a = log_.map.shift * ds;
    Vector6 w = wrench(log_.payload, nu, a, g);
    // Mean over a block of a term quadratic in nu: its value at the mean plus its value at the slope times
    // the spread of the time stamps.
    if (spread > 0.0) w += spread * wrench_quadratic(log_.payload, a);
    return w.cwiseProduct(sensor_.wrench_scale);
  }

  ChannelVector<N> predict(const Eigen::VectorXd& theta, const Vector6& w) const {
    ChannelVector<N> y(layout_.channels);
    for (int i = 0; i < layout_.channels; ++i) {
      y[i] = theta.segment<6>(6 * i).dot(w) + (layout_.offset ? theta[layout_.gains() + i] : 0.0);
    }
    return y;
  }

  ChannelMatrix<N> gain(const Eigen::VectorXd& theta) const {
    ChannelMatrix<N> g(layout_.channels, 6);
    for (int i = 0; i < layout_.channels; ++i) g.row(i) = theta.segment<6>(6 * i);
    return g;
  }

  // d(w normalised)/d(s) and d/d(ds/dt).
  Matrix6 wrench_by_coordinates(const Vector6& s) const {
    return sensor_.wrench_scale.asDiagonal() * wrench_jacobian_twist(log_.payload, log_.map.shift * s) *
           log_.map.shift;
  }
  Matrix6 wrench_by_rates() const { return sensor_.wrench_scale.asDiagonal() * dw_da_ * log_.map.shift; }

  Vector3 gravity(std::size_t k) const {
    if (log_.wrench.gravity == nullptr) return log_.wrench.gravity_constant;
    return Eigen::Map<const Vector3>(log_.wrench.gravity + 3 * k);
  }

  ChannelVector<N> raw(std::size_t k) const {
    const auto n = layout_.channels;
    return Eigen::Map<const ChannelVector<N>>(log_.wrench.raw + static_cast<std::size_t>(n) * k, n)
        .cwiseProduct(per_channel_);
  }

  const ChannelVector<N>& precision() const { return precision_; }  // 1 / sigma per sample, normalised
  const Vector6& wrench_scale() const { return sensor_.wrench_scale; }

 private:
  const LogData& log_;
  const SensorScale<N>& sensor_;
  ParameterLayout layout_;
  ChannelVector<N> per_channel_;
  ChannelVector<N> precision_;
  Matrix6 dw_da_;
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
  std::vector<WrenchBlock<N>> wrench;

  // `per_interval`: blocks of a series on one interval of the spline, where it has at least that many
  // samples.
  void build(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline,
             int per_interval) {
    motion.clear();
    wrench.clear();
    for (std::size_t m = 0; m < model.log().motion.size(); ++m) {
      const MotionSeries& series = model.log().motion[m];
      for_each_block(
          spline, series.time, window.motion[m], per_interval,
          [&](std::size_t k) { return valid_components(series.value + 6 * k, 6); },
          [&](int interval, std::size_t first, std::size_t last, std::uint32_t mask) {
            Powers u = Powers::Zero();
            Vector6 sum = Vector6::Zero();
            for (std::size_t k = first; k < last; ++k) {
              u += powers(spline.local(interval, series.time[k]));
              sum += Eigen::Map<const Vector6>(series.value + 6 * k);
            }
            const double count = static_cast<double>(last - first);
            MotionBlock b{interval, series.order, spline.basis(interval, u / count, series.order),
                          sum / count, series.sigma.cwiseAbs2().cwiseInverse() * count};
            for (int c = 0; c < 6; ++c) {
              if (!(mask >> c & 1U)) b.value[c] = b.weight[c] = 0.0;
            }
            motion.push_back(b);
          });
    }
    const int n = model.layout().channels;
    const WrenchSeries& series = model.log().wrench;
    const ChannelVector<N> precision = model.precision().cwiseAbs2();
    for_each_block(
        spline, series.time, window.wrench, per_interval,
        [&](std::size_t k) { return valid_components(series.raw + static_cast<std::size_t>(n) * k, n); },
        [&](int interval, std::size_t first, std::size_t last, std::uint32_t mask) {
          Powers u = Powers::Zero();
          WrenchBlock<N> b;
          b.interval = interval;
          b.gravity.setZero();
          b.raw.setZero(n);
          for (std::size_t k = first; k < last; ++k) {
            u += powers(spline.local(interval, series.time[k]));
            b.raw += model.raw(k);
            b.gravity += model.gravity(k);
          }
          const double count = static_cast<double>(last - first);
          u /= count;
          b.raw /= count;
          b.gravity /= count;
          b.basis = spline.basis(interval, u, 0);
          b.basis_rate = spline.basis(interval, u, 1);
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
  template <typename Mask, typename Emit>
  static void for_each_block(const BSpline& spline, std::span<const double> time,
                             std::pair<std::size_t, std::size_t> range, int per_interval, Mask mask,
                             Emit emit) {
    std::size_t k = range.first;
    for (int i = 0; i < spline.intervals() && k < range.second; ++i) {
      std::size_t last = range.second;
      if (i + 1 < spline.intervals()) {
        const double edge = spline.breakpoints()[static_cast<std::size_t>(i) + 1];
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

enum class Terms { motion, all };  // the motion measurements alone, or with the sensor's

// Normal equations of one window at (x, theta): H [dx; dtheta] = g, with the common part eliminated on
// demand.
template <int N>
class WindowNormal {
 public:
  // Linearises at (x, theta). Without `common`, only the motion's part is formed (theta held).
  void assemble(const WindowModel<N>& model, const Blocks<N>& blocks, const BSpline& spline,
                const Coefficients& x, const Eigen::VectorXd& theta, Terms terms, bool common) {
    const int p = common ? model.layout().size() : 0;
    hxx_.reset(spline.coefficients());
    rhs_.setZero(kCoordinates * spline.coefficients(), p + 1);
    htt_.setZero(p, p);
    gt_.setZero(p);
    cost_ = 0.0;
    for (const MotionBlock& b : blocks.motion) add_motion(b, x);
    if (terms == Terms::all) add_wrench(model, blocks.wrench, x, theta, common);
  }

  // Cholesky of the motion part and S = Htt - Htx Hxx^-1 Hxt, s = gt - Htx Hxx^-1 gx.
  Status reduce() {
    if (const Status st = hxx_.factorize(); st != Status::ok) return st;
    hxx_.solve_forward(rhs_);
    const auto p = htt_.rows();
    if (p > 0) {
      const auto y = rhs_.leftCols(p);
      htt_.template selfadjointView<Eigen::Lower>().rankUpdate(y.transpose(), -1.0);
      htt_.template triangularView<Eigen::StrictlyUpper>() = htt_.transpose();
      gt_.noalias() -= y.transpose() * rhs_.col(p);
    }
    return Status::ok;
  }

  const Eigen::MatrixXd& information() const { return htt_; }  // S, after reduce()
  const Eigen::VectorXd& score() const { return gt_; }         // s, after reduce()
  double cost() const { return cost_; }                        // sum of squared normalised residuals
  // Decrease of the cost that the motion alone predicts, theta held: gx^T Hxx^-1 gx.
  double motion_decrement() const { return rhs_.col(rhs_.cols() - 1).squaredNorm(); }

  // dx for a given dtheta (empty: theta held), after reduce().
  Coefficients motion_step(const Eigen::VectorXd& dtheta) const {
    Eigen::VectorXd z = rhs_.col(rhs_.cols() - 1);
    if (dtheta.size() > 0) z.noalias() -= rhs_.leftCols(dtheta.size()) * dtheta;
    hxx_.solve_backward(z);
    return Eigen::Map<const Coefficients>(z.data(), z.size() / kCoordinates, kCoordinates);
  }

  MotionNormal covariance_band() const { return hxx_.inverse_band(); }

 private:
  void add_motion(const MotionBlock& b, const Coefficients& x) {
    const Vector6 s = x.middleRows<kActive>(b.interval).transpose() * b.basis;
    const Vector6 r = b.value - s;
    const Vector6 wr = b.weight.cwiseProduct(r);
    cost_ += wr.dot(r);
    const auto last = rhs_.cols() - 1;
    for (int k = 0; k < kActive; ++k) {
      for (int l = 0; l <= k; ++l) {
        hxx_(b.interval + k, b.interval + l).diagonal() += (b.basis[k] * b.basis[l]) * b.weight;
      }
      rhs_.col(last).template segment<6>(6 * (b.interval + k)) += b.basis[k] * wr;
    }
  }

  void add_wrench(const WindowModel<N>& model, const std::vector<WrenchBlock<N>>& blocks,
                  const Coefficients& x, const Eigen::VectorXd& theta, bool common) {
    const int n = model.layout().channels;
    const int p = static_cast<int>(rhs_.cols()) - 1;
    const ChannelMatrix<N> gain = model.gain(theta);
    const ChannelMatrix<N> by_rate = gain * model.wrench_by_rates();
    moment_.setZero(n * 7, 7);
    cross_.resize(2 * kCoordinates, p);
    for (const WrenchBlock<N>& b : blocks) {
      const auto xi = x.middleRows<kActive>(b.interval);
      const Vector6 s = xi.transpose() * b.basis;
      const Vector6 ds = xi.transpose() * b.basis_rate;
      const Vector6 w = model.wrench_at(s, ds, b.gravity, b.spread);
      const ChannelVector<N> r = b.raw - model.predict(theta, w);
      const ChannelVector<N> wr = b.weight.cwiseProduct(r);
      cost_ += wr.dot(r);

      const ChannelMatrix<N> by_coordinate = gain * model.wrench_by_coordinates(s);
      const ChannelMatrix<N> weighted_c = b.weight.asDiagonal() * by_coordinate;
      const ChannelMatrix<N> weighted_r = b.weight.asDiagonal() * by_rate;
      const Matrix6 cc = by_coordinate.transpose() * weighted_c;
      const Matrix6 cr = by_coordinate.transpose() * weighted_r;
      const Matrix6 rr = by_rate.transpose() * weighted_r;
      const Matrix6 rc = cr.transpose();
      const Vector6 gc = by_coordinate.transpose() * wr;
      const Vector6 gr = by_rate.transpose() * wr;
      if (common) fill_cross(weighted_c, weighted_r, w, wr, b.weight, n, model.layout());
      for (int k = 0; k < kActive; ++k) {
        const double bk = b.basis[k];
        const double dk = b.basis_rate[k];
        for (int l = 0; l <= k; ++l) {
          const double bl = b.basis[l];
          const double dl = b.basis_rate[l];
          hxx_(b.interval + k, b.interval + l) +=
              (bk * bl) * cc + (bk * dl) * cr + (dk * bl) * rc + (dk * dl) * rr;
        }
        const int row = kCoordinates * (b.interval + k);
        if (common) {
          rhs_.block(row, 0, kCoordinates, p).noalias() +=
              bk * cross_.topRows<kCoordinates>() + dk * cross_.bottomRows<kCoordinates>();
        }
        rhs_.col(p).template segment<6>(row) += bk * gc + dk * gr;
      }
    }
    if (common) expand_moments(n, model.layout());
  }

  // Cross terms with the gains (rows of w) and the offset, and the moments of [w; 1] per channel.
  void fill_cross(const ChannelMatrix<N>& weighted_c, const ChannelMatrix<N>& weighted_r, const Vector6& w,
                  const ChannelVector<N>& wr, const ChannelVector<N>& weight, int n,
                  const ParameterLayout& layout) {
    Eigen::Matrix<double, 7, 1> w1;
    w1 << w, 1.0;
    const Eigen::Matrix<double, 7, 7> w1w1 = w1 * w1.transpose();
    for (int i = 0; i < n; ++i) {
      cross_.block<kCoordinates, 6>(0, 6 * i).noalias() = weighted_c.row(i).transpose() * w.transpose();
      cross_.block<kCoordinates, 6>(kCoordinates, 6 * i).noalias() =
          weighted_r.row(i).transpose() * w.transpose();
      moment_.template middleRows<7>(7 * i) += weight[i] * w1w1;
      gt_.segment<6>(6 * i) += wr[i] * w;
      if (layout.offset) {
        cross_.col(layout.gains() + i).template head<kCoordinates>() = weighted_c.row(i).transpose();
        cross_.col(layout.gains() + i).template tail<kCoordinates>() = weighted_r.row(i).transpose();
        gt_[layout.gains() + i] += wr[i];
      }
    }
  }

  void expand_moments(int n, const ParameterLayout& layout) {
    for (int i = 0; i < n; ++i) {
      const auto m = moment_.template middleRows<7>(7 * i);
      htt_.block<6, 6>(6 * i, 6 * i) = m.template topLeftCorner<6, 6>();
      if (!layout.offset) continue;
      const int o = layout.gains() + i;
      htt_.block<6, 1>(6 * i, o) = m.template topRightCorner<6, 1>();
      htt_.block<1, 6>(o, 6 * i) = m.template bottomLeftCorner<1, 6>();
      htt_(o, o) = m(6, 6);
    }
  }

  MotionNormal hxx_;
  RowMatrix rhs_;  // [Hxt, gx]; after reduce() L^-1 of it
  Eigen::MatrixXd htt_;
  Eigen::VectorXd gt_;
  double cost_ = 0.0;
  Eigen::Matrix<double, Eigen::Dynamic, 7, Eigen::RowMajor> moment_;
  Eigen::Matrix<double, 2 * kCoordinates, Eigen::Dynamic, Eigen::RowMajor> cross_;
};

}  // namespace truewrench
