// The model of a log that its windows share: from motion and common parameters to the normalised channels.
//
// Everything here is normalised: wrenches by the sensor's range per axis, channels by their full scale, so the
// gain has elements near one and no unit is mixed with another.
#pragma once

#include "truewrench/parameters.hpp"
#include "truewrench/recording.hpp"
#include "truewrench/sensor.hpp"

#include <Eigen/Dense>

#include <cmath>

namespace truewrench {

template <int N>
inline constexpr int kChannelStorage = N == Eigen::Dynamic ? max_channels : N;
template <int N>
using ChannelVector = Eigen::Matrix<double, N, 1, 0, kChannelStorage<N>, 1>;
template <int N>
using ChannelMatrix = Eigen::Matrix<double, N, 6, 0, kChannelStorage<N>, 6>;

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
        stated_(sensor.sigma.cwiseInverse()),
        precision_(stated_) {}

  // Takes the variance of the sensor's noise for so many times what is stated.
  void disbelieve(double times) { precision_ = stated_ / std::sqrt(times); }

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
  ChannelVector<N> stated_;
  ChannelVector<N> precision_;
};

// The model at given common parameters: from the motion to the normalised channels.
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
    const Matrix6 by_acceleration =
        model.wrench_scale().asDiagonal() * wrench_jacobian_acceleration(payload_);
    raw_by_acceleration_ = gain_ * by_acceleration * shift_;
    raw_by_gravity_ = -gain_ * by_acceleration.leftCols<3>();  // a fall is no load
  }

  double delay() const { return delay_; }

  // w of a motion of the logged point. `spread`: variance of the time stamps when the motion is a mean over a block; the
  // mean of a term quadratic in nu is its value at the mean plus its value at the slope times the spread.
  Vector6 wrench_of(const MotionState& state, double spread = 0.0) const {
    const Vector6 a = shift_ * state.a;
    Vector6 w = wrench(payload_, shift_ * state.nu, a, state.gravity);
    if (spread > 0.0) w += spread * wrench_quadratic(payload_, a);
    return w.cwiseProduct(model_.wrench_scale());
  }

  ChannelVector<N> raw_of(const Vector6& w, double temperature) const {
    return gain_ * w + offset_ + temperature * slope_;
  }

  // Derivatives of the channels by twist, acceleration and gravity.
  ChannelMatrix<N> raw_by_twist(const Vector6& nu) const {
    return gain_ *
           (model_.wrench_scale().asDiagonal() * wrench_jacobian_twist(payload_, shift_ * nu) * shift_);
  }
  const ChannelMatrix<N>& raw_by_acceleration() const { return raw_by_acceleration_; }
  const Eigen::Matrix<double, N, 3, 0, kChannelStorage<N>, 3>& raw_by_gravity() const {
    return raw_by_gravity_;
  }

  Eigen::Matrix<double, N, kPayloadParameters, 0, kChannelStorage<N>, kPayloadParameters> raw_by_payload(
      const MotionState& state) const {
    return gain_ * (model_.wrench_scale().asDiagonal() * wrench_by_payload(model_.log().payload, payload_,
                                                                           shift_ * state.nu,
                                                                           shift_ * state.a, state.gravity));
  }

  // By all common parameters. `jerk`: of the logged point.
  Eigen::MatrixXd raw_by_parameters(const MotionState& state, const Vector6& w, double temperature,
                                    const ChannelMatrix<N>& by_twist, const Vector6& jerk) const {
    const ParameterLayout& layout = model_.layout();
    const int n = layout.channels;
    Eigen::MatrixXd out = Eigen::MatrixXd::Zero(n, layout.size());
    for (int i = 0; i < n; ++i) {
      out.row(i).segment<6>(6 * i) = w.transpose();
      if (layout.offset) out(i, layout.offset_begin() + i) = 1.0;
      if (layout.temperature) out(i, layout.temperature_begin() + i) = temperature;
    }
    if (layout.payload) out.middleCols(layout.payload_begin(), kPayloadParameters) = raw_by_payload(state);
    if (layout.time_offset) out.col(layout.time_offset_begin()) = raw_by_time(by_twist, state, jerk);
    return out;
  }

  // Derivative with respect to time: the motion's, and gravity turning in sensor axes.
  ChannelVector<N> raw_by_time(const ChannelMatrix<N>& by_twist, const MotionState& state,
                               const Vector6& jerk) const {
    const Vector3 turning = -Vector3(state.nu.tail<3>()).cross(state.gravity);
    return by_twist * state.a + raw_by_acceleration_ * jerk + raw_by_gravity_ * turning;
  }

 private:
  const WindowModel<N>& model_;
  Payload payload_;
  Matrix6 shift_;
  double delay_ = 0.0;
  ChannelMatrix<N> gain_;
  ChannelVector<N> offset_;
  ChannelVector<N> slope_;
  ChannelMatrix<N> raw_by_acceleration_;
  Eigen::Matrix<double, N, 3, 0, kChannelStorage<N>, 3> raw_by_gravity_;
};

}  // namespace truewrench
