// The contact wrench: what a sensor feels beyond its tool, with the covariance of all that is uncertain in it.
//
//     w_c   = C^+ (k * raw - b) - [ M (k' * nu) + k * q(nu, g) ]                            C short for C R
//     Sigma = J P J^T + C^+ N C^+T |k|^2 + M N_nu M^T |k'|^2 + C^+ W C^+T |t - t_0|
//
// for a sensor that feels the payload; inputs and results have the rig's sign. Samples of sensor and motion come in at
// their own stamps. After configure() nothing allocates and nothing throws.
#pragma once

#include "truewrench/contact/estimate.hpp"
#include "truewrench/contact/kernel.hpp"
#include "truewrench/contact/ring.hpp"

#include <algorithm>
#include <cmath>

namespace truewrench {

enum class ContactState : std::uint8_t {
  ok = 0,
  waiting,         // samples after the moment are still to come
  gap,             // samples around it are missing, or so large that none can be told
  not_configured,  // nothing was configured yet, or its periods are not known
};

class Contact : public contact::Estimate {
 public:
  // `window`: length of the kernels [s]. `newest`: they end at the moment asked for instead of lying around it.
  // `capacity`: samples of each stream that are kept. Allocates.
  Status configure(const contact::Settings& settings, double window, bool newest = false,
                   int capacity = 1024) {
    configured_ = ready_ = valid_ = false;
    if (!(window > 0.0) || !std::isfinite(window)) return Status::not_positive;
    if (capacity < 8) return Status::wrong_size;
    if (const Status status = start(settings); status != Status::ok) return status;
    window_ = window;
    newest_ = newest;
    warmth_ = 0.0;
    raw_.configure(at_.n + 1, capacity);
    motion_.configure(motion_values, capacity);
    for (Eigen::VectorXd* scratch : {&edges_, &slopes_, &times_, &mean_, &slope_, &of_raw_, &second_})
      scratch->setZero(capacity);
    configured_ = true;
    return Status::ok;
  }

  // Nominal periods of the two streams [s], which say how many samples a kernel has and what is a gap.
  Status set_periods(double raw, double motion) noexcept {
    ready_ = false;
    if (!configured_) return Status::not_configured;
    if (!(raw > 0.0) || !(motion > 0.0)) return Status::not_positive;
    if (!std::isfinite(raw) || !std::isfinite(motion)) return Status::not_finite;
    const double halves = newest_ ? window_ / motion : 0.5 * window_ / motion;
    if (std::max(window_ / raw, 3.0 * window_ / motion) + 8.0 > raw_.capacity()) return Status::wrong_size;
    // an odd number of samples around the moment; of the newest at least three, for a parabola
    count_ = newest_ ? 1 + std::max(2, static_cast<int>(std::lround(halves)))
                     : 1 + 2 * std::max(1, static_cast<int>(std::lround(halves)));
    if (count_ + 8 > motion_.capacity()) return Status::wrong_size;
    raw_gap_ = gap(raw);
    motion_gap_ = gap(motion);
    motion_period_ = motion;
    ready_ = true;
    return Status::ok;
  }

  // No sample any more, nor periods; parameters stay as tares have left them.
  void clear() noexcept {
    raw_.clear();
    motion_.clear();
    ready_ = valid_ = false;
  }

  // How long after a moment its wrench is known: (n - 1) dt / 2, and what the motion's stamps are later; or none [s].
  double delay() const noexcept {
    if (newest_ || !ready_) return 0.0;
    return 0.5 * (count_ - 1) * motion_period_ + std::max(settings_.time_offset, 0.0);
  }

  // The temperature from now on [degC].
  void set_temperature(double celsius) noexcept { warmth_ = celsius - settings_.temperature_reference; }

  // Covariance of a sample of the twist, from now on.
  void set_twist_noise(const Matrix6& covariance) noexcept { twist_noise_ = covariance; }

  // The n channels at a stamp; `mark` is the caller's. Stamps increase.
  Status add_raw(std::int64_t time_ns, const double* raw, std::int64_t mark = 0) noexcept {
    if (!configured_) return Status::not_configured;
    double* values = raw_.next(time_ns, mark);
    if (values == nullptr) return Status::not_increasing;
    bool finite = std::isfinite(warmth_);
    for (int i = 0; i < at_.n; ++i) finite = finite && std::isfinite(raw[i]);
    if (!finite) return Status::not_finite;  // before the oldest sample gives its place
    std::copy_n(raw, at_.n, values);
    values[at_.n] = warmth_;
    raw_.keep();
    return Status::ok;
  }

  // Twist of the sensor's origin, free fall there, both in sensor axes, and how the sensor is turned. An IMU's motion
  // has no v, and the negative of the specific force for the fall. R_sensor_root: zero for an IMU; where else nothing tells
  // it, ContactRows follows the turn, without which the tilt of gravity has no part in Sigma. `heading`: its turn about
  // gravity is known too.
  Status add_motion(std::int64_t time_ns, const Vector6& twist, const Vector3& fall,
                    const Matrix3& R_sensor_root, std::int64_t mark = 0, bool heading = true) noexcept {
    if (!configured_) return Status::not_configured;
    double* values = motion_.next(time_ns, mark);
    if (values == nullptr) return Status::not_increasing;
    if (!twist.allFinite() || !fall.allFinite() || !R_sensor_root.allFinite()) return Status::not_finite;
    const Vector3 omega = twist.tail<3>();
    Eigen::Map<Vector6>{values} = twist;
    Eigen::Map<Vector3>{values + 6} = omega.cross(twist.head<3>()) - fall;
    Eigen::Map<Vector6>{values + 9} << omega.cwiseAbs2(), omega[0] * omega[1], omega[0] * omega[2],
        omega[1] * omega[2];
    Eigen::Map<Matrix3>{values + 15} = R_sensor_root;
    values[24] = heading ? 1.0 : 0.0;
    motion_.keep();
    return Status::ok;
  }

  // The contact wrench at a moment of the sensor's clock.
  ContactState evaluate(std::int64_t time_ns, ContactWrench& out) noexcept {
    if (!ready_) return ContactState::not_configured;
    const ContactState state = gather(time_ns, out);
    return state == ContactState::ok && !finish(out) ? ContactState::gap : state;
  }

  // The contact wrench of a pose: of one sample at rest, of both streams at this very stamp.
  ContactState evaluate_pose(std::int64_t time_ns, ContactWrench& out) noexcept {
    if (!configured_) return ContactState::not_configured;
    const std::int64_t r = raw_.find(time_ns), m = motion_.find(time_ns);
    if (r < 0 || m < 0) return ContactState::gap;
    features_ = contact::Features();
    features_.raw.setZero(at_.n);
    add_raw_mean(r, 1.0);
    add_motion_mean(m, 1.0);
    out.R_sensor_root = features_.R_sensor_root;
    out.heading = motion_.values(m)[24] != 0.0;
    out.time_ns = moment_ = time_ns;
    out.newest = std::max(raw_.mark(r), motion_.mark(m));
    sums_ = {1.0, 0.0, 1.0};
    pose_ = true;
    return finish(out) ? ContactState::ok : ContactState::gap;
  }

  bool configured() const noexcept { return configured_; }

 private:
  static constexpr int motion_values =
      25;  // twist, apparent acceleration, six of Omega Omega^T, R_sensor_root, whether its heading is known
  // Neighbours further apart have a gap between them; a sample or two may be missing [s].
  double gap(double period) const noexcept {
    return std::min(5.0 * period, std::max(2.5 * period, 0.5 * window_));
  }

  // Kernels around a moment, and the means under them.
  ContactState gather(std::int64_t moment, ContactWrench& out) noexcept {
    if (!contact::Ring::near(moment)) return ContactState::gap;
    if (raw_.end() == 0 || motion_.end() == 0) return ContactState::waiting;
    const double s =
        settings_.time_offset;  // t_motion = t_sensor + s; what a tare adds acts through the rates
    const auto shift = static_cast<std::int64_t>(std::llround(s * 1e9));
    if (newest_) {  // what both streams have
      moment = std::min({moment, raw_.time(raw_.end() - 1), motion_.time(motion_.end() - 1) - shift});
    }
    const auto relative = [&](std::int64_t t) { return static_cast<double>(t - shift - moment) * 1e-9; };
    // the motion's sample of the middle, or of the end
    std::int64_t middle = motion_.from(moment + shift);
    if (newest_) {
      if (middle == motion_.end() || relative(motion_.time(middle)) > 0.0) --middle;
    } else if (middle == motion_.end() || (middle > motion_.begin() && -relative(motion_.time(middle - 1)) <
                                                                           relative(motion_.time(middle)))) {
      --middle;
    }
    const std::int64_t first = newest_ ? middle - (count_ - 1) : middle - (count_ - 1) / 2;
    const std::int64_t last = first + count_ - 1;
    if (middle < motion_.begin() || first < motion_.begin()) return ContactState::gap;
    if (last >= motion_.end()) return ContactState::waiting;
    // the stamps of that kernel, moved so that it lies around the moment
    const double move = -relative(motion_.time(middle));
    if (std::abs(move) > motion_gap_)
      return move > 0.0 && !newest_ ? ContactState::waiting : ContactState::gap;
    std::int64_t low = first, high = last;
    if (move < 0.0 && --low < motion_.begin()) return ContactState::gap;
    if (move > 0.0 && ++high >= motion_.end()) return ContactState::waiting;
    const int m = static_cast<int>(high - low + 1);
    for (int i = 0; i < m; ++i) {
      times_[i] = relative(motion_.time(low + i));
      if (i > 0 && times_[i] - times_[i - 1] > motion_gap_) return ContactState::gap;
    }
    for (int i = 0; i < count_; ++i) edges_[i] = times_[static_cast<int>(first - low) + i] + move;
    if (newest_)
      contact::parabola(edges_.data(), count_, 1, slopes_.data());
    else
      contact::line_slope(edges_.data(), count_, slopes_.data());
    if (!contact::slope_weights(edges_.data(), slopes_.data(), count_, times_.data(), m, slope_.data()))
      return ContactState::gap;
    contact::mean_weights(edges_.data(), slopes_.data(), count_, times_.data(), m, mean_.data());

    const auto ns = [&](double t) { return moment + static_cast<std::int64_t>(std::llround(t * 1e9)); };
    std::int64_t begin = raw_.from(ns(edges_[0])), end = raw_.from(ns(edges_[count_ - 1]));
    if (begin < raw_.end() && raw_.time(begin) > ns(edges_[0])) --begin;
    if (end >= raw_.end()) return ContactState::waiting;
    if (begin < raw_.begin()) return ContactState::gap;
    const int r = static_cast<int>(end - begin + 1);
    if (r < 2 || r > of_raw_.size()) return ContactState::gap;
    for (int i = 0; i < r; ++i) {
      second_[i] = static_cast<double>(raw_.time(begin + i) - moment) * 1e-9;
      if (i > 0 && second_[i] - second_[i - 1] > raw_gap_) return ContactState::gap;
    }
    // stamps are whole nanoseconds: a kernel may stand out by the rounding of one
    const double covered =
        contact::mean_weights(edges_.data(), slopes_.data(), count_, second_.data(), r, of_raw_.data());
    if (!(std::abs(covered - 1.0) < 1e-3)) return ContactState::gap;

    features_ = contact::Features();
    features_.raw.setZero(at_.n);
    sums_ = Sums();
    for (int i = 0; i < r; ++i) {
      add_raw_mean(begin + i, of_raw_[i] / covered);
      sums_.raw += of_raw_[i] * of_raw_[i];
    }
    for (int i = 0; i < m; ++i) {
      features_.acceleration += slope_[i] * Eigen::Map<const Vector6>(motion_.values(low + i));
      add_motion_mean(low + i, mean_[i]);
      sums_.slope += slope_[i] * slope_[i];
      sums_.mean += mean_[i] * mean_[i];
    }
    if (P_(at_.clock(), at_.clock()) > 0.0) add_rates(low, high, relative);
    out.R_sensor_root = Eigen::Map<const Matrix3>(motion_.values(middle) + 15);
    out.heading = motion_.values(middle)[24] != 0.0;
    out.time_ns = moment_ = moment;
    out.newest = std::max(raw_.mark(end), motion_.mark(high));
    pose_ = false;
    return ContactState::ok;
  }

  void add_raw_mean(std::int64_t i, double weight) noexcept {
    const double* values = raw_.values(i);
    for (int k = 0; k < at_.n; ++k) features_.raw[k] += weight * values[k];
    features_.warmth += weight * values[at_.n];
  }

  void add_motion_mean(std::int64_t i, double weight) noexcept {
    const double* values = motion_.values(i);
    features_.apparent += weight * Eigen::Map<const Vector3>(values + 6);
    features_.turning += weight * contact::symmetric(Eigen::Map<const Vector6>(values + 9));
    features_.R_sensor_root += weight * Eigen::Map<const Matrix3>(values + 15);
  }

  // How the motion's part changes with time, which is what an error of the clock multiplies: over a kernel before the
  // present one and itself, where there are samples, since a second derivative is noisy.
  template <typename Relative>
  void add_rates(std::int64_t low, std::int64_t high, const Relative& relative) noexcept {
    std::int64_t from = std::max(motion_.begin(), low - (count_ - 1));
    for (std::int64_t i = high; i > from; --i)
      if (relative(motion_.time(i)) - relative(motion_.time(i - 1)) > motion_gap_) from = i;
    const int m = static_cast<int>(high - from + 1);
    if (m < 3 || m > times_.size()) return;
    for (int i = 0; i < m; ++i) times_[i] = relative(motion_.time(from + i));
    contact::parabola(times_.data(), m, 2, second_.data());
    contact::line_slope(times_.data(), m, slope_.data());
    for (int i = 0; i < m; ++i) {
      const double* values = motion_.values(from + i);
      features_.jerk += second_[i] * Eigen::Map<const Vector6>(values);
      features_.apparent_rate += slope_[i] * Eigen::Map<const Vector3>(values + 6);
      features_.turning_rate += slope_[i] * contact::symmetric(Eigen::Map<const Vector6>(values + 9));
    }
  }

  contact::Ring raw_, motion_;
  Eigen::VectorXd edges_, slopes_, times_, mean_, slope_, of_raw_, second_;
  double window_ = 0.02, warmth_ = 0.0, raw_gap_ = 0.0, motion_gap_ = 0.0, motion_period_ = 0.0;
  int count_ = 3;
  bool newest_ = false, configured_ = false, ready_ = false;
};

}  // namespace truewrench
