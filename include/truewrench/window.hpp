// One window of motion: residuals of every stream at its own time stamps, their normal equations in
// (spline coefficients, common parameters), and the Schur complement onto the common parameters
// (docs/method.md, "Windows of motion").
//
// Everything here is normalised: wrenches by the sensor's range per axis, channels by their full scale, so the
// gain has elements near one and no unit is mixed with another.
#pragma once

#include "truewrench/block_banded.hpp"
#include "truewrench/bspline.hpp"
#include "truewrench/parameters.hpp"
#include "truewrench/recording.hpp"
#include "truewrench/sensor.hpp"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace truewrench {

inline constexpr int kCoordinates = 6;  // motion coordinates: the components of a twist

template <int N>
inline constexpr int kChannelStorage = N == Eigen::Dynamic ? max_channels : N;
template <int N>
using ChannelVector = Eigen::Matrix<double, N, 1, 0, kChannelStorage<N>, 1>;
template <int N>
using ChannelMatrix = Eigen::Matrix<double, N, 6, 0, kChannelStorage<N>, 6>;

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Coefficients = Eigen::Matrix<double, Eigen::Dynamic, kCoordinates, Eigen::RowMajor>;
using MotionNormal = BlockBanded<kCoordinates, kDegree>;

// What is known of the sensor beforehand. `wrench_scale` = sign / range turns w into normalised, signed units.
template <int N>
struct SensorScale {
  ChannelVector<N> channel;  // full scale per channel, raw units
  ChannelVector<N> sigma;    // noise per sample, normalised
  Vector6 wrench_scale;
};

// One log as its windows see it.
template <int N>
class WindowModel {
 public:
  // `gate`: which samples are left out, judged anew by every window; none: all are taken.
  WindowModel(const LogData& log, const SensorScale<N>& sensor, const ParameterLayout& layout,
              Gate* gate = nullptr)
      : log_(log),
        gate_(gate),
        layout_(layout),
        wrench_scale_(sensor.wrench_scale),
        per_channel_(sensor.channel.cwiseInverse()),
        precision_(sensor.sigma.cwiseInverse()) {}

  const ParameterLayout& layout() const { return layout_; }
  const LogData& log() const { return log_; }
  Gate* gate() const { return gate_; }
  bool sensed(std::size_t k) const { return gate_ == nullptr || gate_->wrench[k] == 0; }
  bool moved(std::size_t m, std::size_t k) const { return gate_ == nullptr || gate_->motion[m][k] == 0; }
  const Vector6& wrench_scale() const { return wrench_scale_; }
  const ChannelVector<N>& precision() const { return precision_; }  // 1 / sigma per sample, normalised

  ChannelVector<N> raw(std::size_t k) const {
    const auto n = layout_.channels;
    return Eigen::Map<const ChannelVector<N>>(log_.wrench.raw + static_cast<std::size_t>(n) * k, n)
        .cwiseProduct(per_channel_);
  }

  double temperature(std::size_t k) const {
    return log_.wrench.temperature == nullptr ? 0.0 : log_.wrench.temperature[k];
  }

 private:
  const LogData& log_;
  Gate* gate_;
  ParameterLayout layout_;
  Vector6 wrench_scale_;
  ChannelVector<N> per_channel_;
  ChannelVector<N> precision_;
};

// The model at given common parameters: from motion coordinates to the normalised channels.
template <int N>
class WindowModelAt {
 public:
  WindowModelAt(const WindowModel<N>& model, const Eigen::VectorXd& theta)
      : model_(model), payload_(model.log().payload) {
    const ParameterLayout& layout = model.layout();
    const int n = layout.channels;
    gain_ = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>>(theta.data(), n, 6);
    offset_.setZero(n);
    slope_.setZero(n);
    if (layout.payload) {
      payload_ = truewrench::payload_at(payload_, theta.segment<kPayloadParameters>(layout.payload_begin()));
    }
    if (layout.temperature) slope_ = theta.segment(layout.temperature_begin(), n);
    if (layout.offset) offset_ = theta.segment(layout.offset_begin(), n);
    if (layout.time_offset) delay_ = theta[layout.time_offset_begin()];
    shift_ = twist_shift(payload_.center_of_mass - model.log().point);
    wrench_by_rate_ = model.wrench_scale().asDiagonal() * wrench_jacobian_acceleration(payload_) * shift_;
    raw_by_rate_ = gain_ * wrench_by_rate_;
  }

  double delay() const { return delay_; }

  // w at coordinates s and rates ds. `spread`: variance of the time stamps when s and ds are means over a block; the
  // mean of a term quadratic in nu is its value at the mean plus its value at the slope times the spread.
  Vector6 wrench_at(const Vector6& s, const Vector6& ds, const Vector3& g, double spread = 0.0) const {
    const Vector6 a = shift_ * ds;
    Vector6 w = wrench(payload_, shift_ * s, a, g);
    if (spread > 0.0) w += spread * wrench_quadratic(payload_, a);
    return w.cwiseProduct(model_.wrench_scale());
  }

  ChannelVector<N> raw_of(const Vector6& w, double temperature) const {
    return gain_ * w + offset_ + temperature * slope_;
  }

  ChannelMatrix<N> raw_by_coordinate(const Vector6& s) const {
    return gain_ *
           (model_.wrench_scale().asDiagonal() * wrench_jacobian_twist(payload_, shift_ * s) * shift_);
  }
  const ChannelMatrix<N>& raw_by_rate() const { return raw_by_rate_; }

  Eigen::Matrix<double, N, kPayloadParameters, 0, kChannelStorage<N>, kPayloadParameters> raw_by_payload(
      const Vector6& s, const Vector6& ds, const Vector3& g) const {
    return gain_ * (model_.wrench_scale().asDiagonal() *
                    wrench_by_payload(model_.log().payload, payload_, shift_ * s, shift_ * ds, g));
  }

  // Derivative with respect to time: the motion's, and gravity turning in sensor axes.
  ChannelVector<N> raw_by_time(const ChannelMatrix<N>& by_coordinate, const Vector6& s, const Vector6& ds,
                               const Vector6& dds, const Vector3& g) const {
    const Vector3 turning = -Vector3(s.tail<3>()).cross(g);
    const Vector6 by_gravity = wrench(payload_, Vector6::Zero(), Vector6::Zero(), turning);
    return by_coordinate * ds + raw_by_rate_ * dds + gain_ * by_gravity.cwiseProduct(model_.wrench_scale());
  }

 private:
  const WindowModel<N>& model_;
  Payload payload_;
  Matrix6 shift_;
  double delay_ = 0.0;
  ChannelMatrix<N> gain_;
  ChannelVector<N> offset_;
  ChannelVector<N> slope_;
  Matrix6 wrench_by_rate_;
  ChannelMatrix<N> raw_by_rate_;
};

// Consecutive samples of one interval with the same valid components, replaced by their mean. The mean of a
// spline is linear in its coefficients, so averaging loses nothing but the information inside a block, a
// fraction (block / interval)^2 of it.
struct MotionBlock {
  int interval;
  const MotionSeries* series;
  BasisRow basis;  // mean of the order-th derivative of the active basis functions
  Vector6 value;
  Vector6 weight;  // samples / variance; 0 where missing
};

template <int N>
struct WrenchBlock {
  int interval;
  BasisRow basis;         // mean of the active basis functions,
  BasisRow basis_rate;    // of their time derivatives,
  BasisRow basis_second;  // and of their second derivatives
  double spread;          // variance of the time stamps inside the block [s^2]
  double temperature;
  Vector3 gravity;
  ChannelVector<N> raw;
  ChannelVector<N> weight;
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

  // `per_interval`: blocks of a series on one interval of the spline, where it has at least that many samples.
  void build(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline, int per_interval,
             double delay) {
    build_motion(model, window, spline, per_interval);
    build_wrench(model, window, spline, per_interval, delay);
  }

  void build_motion(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline,
                    int per_interval) {
    motion.clear();
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
            MotionBlock b{interval, &series, spline.basis(interval, u / count, series.order), sum / count,
                          series.sigma.cwiseAbs2().cwiseInverse() * count};
            for (int c = 0; c < 6; ++c) {
              if (!(mask >> c & 1U)) b.value[c] = b.weight[c] = 0.0;
            }
            motion.push_back(b);
          });
    }
  }

  // `delay` added to the sensor's stamps.
  void build_wrench(const WindowModel<N>& model, const WindowRange& window, const BSpline& spline,
                    int per_interval, double delay) {
    wrench.clear();
    const int n = model.layout().channels;
    const WrenchSeries& series = model.log().wrench;
    const GravitySeries& gravity = model.log().gravity;
    const ChannelVector<N> precision = model.precision().cwiseAbs2();
    for_each_block(
        spline, series.time, delay, window.wrench, per_interval,
        [&](std::size_t k) {
          return model.sensed(k) ? valid_components(series.raw + static_cast<std::size_t>(n) * k, n) : 0U;
        },
        [&](int interval, std::size_t first, std::size_t last, std::uint32_t mask) {
          Powers u = Powers::Zero();
          WrenchBlock<N> b;
          b.interval = interval;
          b.temperature = 0.0;
          b.gravity.setZero();
          b.raw.setZero(n);
          for (std::size_t k = first; k < last; ++k) {
            const double t = series.time[k] + delay;
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
          b.basis = spline.basis(interval, u, 0);
          b.basis_rate = spline.basis(interval, u, 1);
          b.basis_second = spline.basis(interval, u, 2);
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

enum class Terms { motion, all };  // the motion measurements alone, or with the sensor's

// Normal equations of one window at (x, theta): H [dx; dtheta] = g, with the common part eliminated on demand.
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
    if (terms == Terms::all)
      add_wrench(WindowModelAt<N>(model, theta), model.layout(), blocks.wrench, x, common);
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

  // H^-1 r, r of the motion's coefficients, after reduce().
  void solve(Eigen::MatrixXd& r) const {
    hxx_.solve_forward(r);
    hxx_.solve_backward(r);
  }

  MotionNormal covariance_band() const { return hxx_.inverse_band(); }

 private:
  static constexpr int kRegressors = 8;  // of one channel: the wrench, 1, the temperature
  using Regressor = Eigen::Matrix<double, kRegressors, 1>;
  using Extra = Eigen::Matrix<double, N, Eigen::Dynamic, 0, kChannelStorage<N>, kPayloadParameters + 1>;

  void add_motion(const MotionBlock& b, const Coefficients& x) {
    const Vector6 s = x.middleRows<kActive>(b.interval).transpose() * b.basis;
    const Vector6 r = b.value - b.series->of(s);
    Vector6 wr = b.weight.cwiseProduct(r);
    cost_ += wr.dot(r);
    const auto last = rhs_.cols() - 1;
    const Matrix6& m = b.series->combination;
    Matrix6 mwm;
    if (!b.series->direct) {
      mwm = m.transpose() * b.weight.asDiagonal() * m;
      wr = m.transpose() * wr;
    }
    for (int k = 0; k < kActive; ++k) {
      for (int l = 0; l <= k; ++l) {
        const double kl = b.basis[k] * b.basis[l];
        if (b.series->direct) {
          hxx_(b.interval + k, b.interval + l).diagonal() += kl * b.weight;
        } else {
          hxx_(b.interval + k, b.interval + l) += kl * mwm;
        }
      }
      rhs_.col(last).template segment<6>(6 * (b.interval + k)) += b.basis[k] * wr;
    }
  }

  void add_wrench(const WindowModelAt<N>& model, const ParameterLayout& layout,
                  const std::vector<WrenchBlock<N>>& blocks, const Coefficients& x, bool common) {
    const int n = layout.channels;
    const int p = static_cast<int>(rhs_.cols()) - 1;
    const ChannelMatrix<N>& by_rate = model.raw_by_rate();
    moment_.setZero(n * kRegressors, kRegressors);
    cross_.resize(2 * kCoordinates, p);
    extra_.resize(n, (layout.payload ? kPayloadParameters : 0) + (layout.time_offset ? 1 : 0));
    for (const WrenchBlock<N>& b : blocks) {
      const auto xi = x.middleRows<kActive>(b.interval);
      const Vector6 s = xi.transpose() * b.basis;
      const Vector6 ds = xi.transpose() * b.basis_rate;
      const Vector6 w = model.wrench_at(s, ds, b.gravity, b.spread);
      const ChannelVector<N> r = b.raw - model.raw_of(w, b.temperature);
      const ChannelVector<N> wr = b.weight.cwiseProduct(r);
      cost_ += wr.dot(r);

      const ChannelMatrix<N> by_coordinate = model.raw_by_coordinate(s);
      const ChannelMatrix<N> weighted_c = b.weight.asDiagonal() * by_coordinate;
      const ChannelMatrix<N> weighted_r = b.weight.asDiagonal() * by_rate;
      const Matrix6 cc = by_coordinate.transpose() * weighted_c;
      const Matrix6 cr = by_coordinate.transpose() * weighted_r;
      const Matrix6 rr = by_rate.transpose() * weighted_r;
      const Matrix6 rc = cr.transpose();
      const Vector6 gc = by_coordinate.transpose() * wr;
      const Vector6 gr = by_rate.transpose() * wr;
      if (common) {
        Regressor z;
        z << w, 1.0, b.temperature;
        add_linear(layout, b.weight, z, wr, weighted_c, weighted_r);
        if (extra_.cols() > 0) {
          if (layout.payload)
            extra_.template leftCols<kPayloadParameters>() = model.raw_by_payload(s, ds, b.gravity);
          if (layout.time_offset) {
            extra_.col(extra_.cols() - 1) =
                model.raw_by_time(by_coordinate, s, ds, xi.transpose() * b.basis_second, b.gravity);
          }
          add_extra(layout, b.weight, z, wr, weighted_c, weighted_r);
        }
      }
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
    if (common) expand_moments(layout);
  }

  // Gains, temperature slope and offset: channel i is linear in them, with the regressors z = [w, 1, temperature].
  void add_linear(const ParameterLayout& layout, const ChannelVector<N>& weight, const Regressor& z,
                  const ChannelVector<N>& wr, const ChannelMatrix<N>& weighted_c,
                  const ChannelMatrix<N>& weighted_r) {
    const Eigen::Matrix<double, kRegressors, kRegressors> zz = z * z.transpose();
    const auto w = z.template head<6>();
    for (int i = 0; i < layout.channels; ++i) {
      cross_.block<kCoordinates, 6>(0, 6 * i).noalias() = weighted_c.row(i).transpose() * w.transpose();
      cross_.block<kCoordinates, 6>(kCoordinates, 6 * i).noalias() =
          weighted_r.row(i).transpose() * w.transpose();
      moment_.template middleRows<kRegressors>(kRegressors * i) += weight[i] * zz;
      gt_.segment<6>(6 * i) += wr[i] * w;
      const auto add = [&](int at, double factor) {
        cross_.col(at).template head<kCoordinates>() = factor * weighted_c.row(i).transpose();
        cross_.col(at).template tail<kCoordinates>() = factor * weighted_r.row(i).transpose();
        gt_[at] += wr[i] * factor;
      };
      if (layout.offset) add(layout.offset_begin() + i, 1.0);
      if (layout.temperature) add(layout.temperature_begin() + i, z[7]);
    }
  }

  // Payload and time offset, on which every channel depends: the columns of extra_.
  void add_extra(const ParameterLayout& layout, const ChannelVector<N>& weight, const Regressor& z,
                 const ChannelVector<N>& wr, const ChannelMatrix<N>& weighted_c,
                 const ChannelMatrix<N>& weighted_r) {
    const Extra weighted = weight.asDiagonal() * extra_;
    const auto place = [&](int first, int count, int at) {
      const auto columns = extra_.middleCols(first, count);
      cross_.block(0, at, kCoordinates, count).noalias() = weighted_c.transpose() * columns;
      cross_.block(kCoordinates, at, kCoordinates, count).noalias() = weighted_r.transpose() * columns;
      gt_.segment(at, count).noalias() += columns.transpose() * wr;
      htt_.block(at, at, count, count).noalias() += columns.transpose() * weighted.middleCols(first, count);
      for (int i = 0; i < layout.channels; ++i) {
        const auto row = weighted.row(i).segment(first, count);
        htt_.block(6 * i, at, 6, count).noalias() += z.template head<6>() * row;
        if (layout.offset) htt_.row(layout.offset_begin() + i).segment(at, count) += row;
        if (layout.temperature) htt_.row(layout.temperature_begin() + i).segment(at, count) += z[7] * row;
      }
    };
    if (layout.payload) place(0, kPayloadParameters, layout.payload_begin());
    if (!layout.time_offset) return;
    const int last = static_cast<int>(extra_.cols()) - 1;
    place(last, 1, layout.time_offset_begin());
    if (layout.payload) {
      htt_.block(layout.payload_begin(), layout.time_offset_begin(), kPayloadParameters, 1).noalias() +=
          extra_.template leftCols<kPayloadParameters>().transpose() * weighted.col(last);
    }
  }

  // The moments of z into their places, and the lower triangle of what add_extra left above the diagonal.
  void expand_moments(const ParameterLayout& layout) {
    for (int i = 0; i < layout.channels; ++i) {
      const auto m = moment_.template middleRows<kRegressors>(kRegressors * i);
      htt_.block<6, 6>(6 * i, 6 * i) = m.template topLeftCorner<6, 6>();
      const int o = layout.offset_begin() + i;
      const int t = layout.temperature_begin() + i;
      if (layout.offset) {
        htt_.block<6, 1>(6 * i, o) = m.template block<6, 1>(0, 6);
        htt_(o, o) = m(6, 6);
      }
      if (layout.temperature) {
        htt_.block<6, 1>(6 * i, t) = m.template block<6, 1>(0, 7);
        htt_(t, t) = m(7, 7);
      }
      if (layout.offset && layout.temperature) htt_(t, o) = m(6, 7);
    }
    if (layout.payload && layout.offset) move_below(layout.offset_begin(), layout.payload_begin(), layout);
    if (layout.payload && layout.temperature)
      move_below(layout.temperature_begin(), layout.payload_begin(), layout);
    htt_.template triangularView<Eigen::StrictlyLower>() = htt_.transpose();
  }

  // Rows `from` ... against the payload stand below the diagonal: onto their mirror images above it.
  void move_below(int from, int payload, const ParameterLayout& layout) {
    htt_.block(payload, from, kPayloadParameters, layout.channels) =
        htt_.block(from, payload, layout.channels, kPayloadParameters).transpose();
  }

  MotionNormal hxx_;
  RowMatrix rhs_;  // [Hxt, gx]; after reduce() L^-1 of it
  Eigen::MatrixXd htt_;
  Eigen::VectorXd gt_;
  double cost_ = 0.0;
  Eigen::Matrix<double, Eigen::Dynamic, kRegressors, Eigen::RowMajor> moment_;
  Eigen::Matrix<double, 2 * kCoordinates, Eigen::Dynamic, Eigen::RowMajor> cross_;
  Extra extra_;
};

}  // namespace truewrench
