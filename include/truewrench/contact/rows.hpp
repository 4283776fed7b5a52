// Rows of a table, or messages, as samples of sensor and motion: every row has its contact wrench once the rows after
// it have come, a constant number of them later; more where samples are missing.
#pragma once

#include "truewrench/contact.hpp"
#include "truewrench/contact/even_stamps.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace truewrench {

// One row; NaN where it has no sample.
struct ContactRow {
  std::int64_t time_ns = 0;
  const double* raw = nullptr;  // n channels; none: no sample of the sensor
  // of the sensor's origin, sensor axes; v = 0 of an IMU
  Vector6 twist = Vector6::Constant(std::numeric_limits<double>::quiet_NaN());
  // free fall in sensor axes; less the specific force of an IMU
  Vector3 fall = Vector3::Constant(std::numeric_limits<double>::quiet_NaN());
  // turns vectors of the root into sensor axes
  Matrix3 R_sensor_root = Matrix3::Constant(std::numeric_limits<double>::quiet_NaN());
};

class ContactRows {
 public:
  Contact contact;

  // As Contact::configure. `imu`: the motion is an IMU's, and the direction of gravity plays no part. Allocates.
  Status configure(const contact::Settings& settings, double window, bool newest, bool imu, int capacity) {
    if (const Status status = contact.configure(settings, window, newest, capacity); status != Status::ok)
      return status;
    gravity_ = settings.gravity;
    newest_ = newest;
    imu_ = imu;
    times_.assign(static_cast<std::size_t>(capacity), 0);
    numbers_.assign(static_cast<std::size_t>(capacity), 0);
    given_ = 0;
    restart();
    return Status::ok;
  }

  // As if no row had come yet, where stamps begin again: what tares have taught stays, and the rows' numbers go on.
  void restart() noexcept {
    contact.clear();
    rows_ = next_ = settled_ = reach_ns_ = lag_ = 0;
    first_ = true;
    timed_ = started_ = turned_ = headed_ = lonely_ = too_long_ = false;
    raw_ = motion_ = Intervals();
    raw_stamps_ = motion_stamps_ = contact::EvenStamps();
  }

  // Rows after which a row has its wrench; rows without a sample of sensor or motion are not counted.
  std::int64_t lag() const noexcept { return lag_; }
  // Whether the kernels hold more samples than are kept, at the rates found: no row has a wrench.
  bool too_long() const noexcept { return too_long_; }
  // Number of the row that has its wrench with the latest one, at the earliest; -1: none yet.
  std::int64_t due() const noexcept {
    const std::int64_t row = rows_ - 1 - std::max<std::int64_t>(1, lag_);
    return row < oldest() ? -1 : numbers_[slot(row)];
  }

  // The next row. `sink(number, wrench)` is called for every earlier row (or this one) that has its wrench now.
  template <typename Sink>
  Status feed(const ContactRow& row, Sink&& sink) noexcept {
    if (!contact.configured()) return Status::not_configured;
    if (!contact::Ring::near(row.time_ns) || (!first_ && row.time_ns <= last_time_))
      return Status::not_increasing;
    first_ = false;
    const std::int64_t number = given_++, k = rows_;
    last_time_ = row.time_ns;
    const bool sensed = add_raw(row, k), moved = add_motion(row, k);
    if (!sensed && !moved) return Status::ok;
    const bool apart = k == 0 || row.time_ns - time_of(k - 1) >= apart_ns;
    if (lonely_ && apart && !newest_) give_pose(k - 1, sink);
    times_[slot(k)] = row.time_ns;
    numbers_[slot(k)] = number;
    rows_ = k + 1;
    lonely_ = apart && sensed && moved && row.twist.isZero(0.0);
    if (!started_) {
      if (sensed) raw_.add(raw_stamps_.latest());
      if (moved) motion_.add(motion_stamps_.latest());
      if (raw_.full() && motion_.full()) start(sink);
    } else if (!give_until(k - lag_, sink)) {
      const bool packets = raw_stamps_.packets() || motion_stamps_.packets();
      if (k < settled_ || (packets && last_time_ - time_of(k - lag_) <= reach_ns_)) {
        ++lag_;  // another row needs one more than the first: this one comes with the next
        settled_ = 0;
      }
    }
    if (lonely_ && newest_) give_pose(k, sink);
    return Status::ok;
  }

  // The rows that waited for others, when no more will come.
  template <typename Sink>
  void finish(Sink&& sink) noexcept {
    if (!started_ && raw_.count > 1 && motion_.count > 1) start(sink);
    if (started_)
      for (; next_ < rows_; ++next_) give(next_, sink);
    if (lonely_ && !newest_) give_pose(rows_ - 1, sink);
    lonely_ = false;
  }

 private:
  static constexpr std::int64_t apart_ns = 500'000'000;  // a row at rest so far from its neighbours is a pose
  static constexpr int learned = 20;                     // intervals that tell a nominal period

  // The latest intervals of a stream.
  struct Intervals {
    std::array<std::int64_t, learned> of{};
    std::int64_t count = 0, last = 0;
    bool any = false;

    bool full() const { return count >= learned; }
    bool renewed() const { return count > 0 && count % learned == 0; }
    void add(std::int64_t time) {
      if (any && time - last < apart_ns) of[static_cast<std::size_t>(count++ % learned)] = time - last;
      last = time;
      any = true;
    }
    double median() const {
      std::array<std::int64_t, learned> sorted = of;
      const auto used = static_cast<std::size_t>(std::min<std::int64_t>(count, learned));
      std::sort(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(used));
      return 1e-9 * static_cast<double>(sorted[used / 2]);
    }
  };

  std::size_t slot(std::int64_t row) const noexcept { return static_cast<std::size_t>(row) % times_.size(); }
  std::int64_t time_of(std::int64_t row) const noexcept { return times_[slot(row)]; }
  std::int64_t oldest() const noexcept {
    return std::max<std::int64_t>(0, rows_ - static_cast<std::int64_t>(times_.size()));
  }

  // Whether the row waits for nothing.
  template <typename Sink>
  bool give(std::int64_t row, Sink&& sink) noexcept {
    if (row < oldest()) return true;
    ContactWrench out;
    const ContactState state = contact.evaluate(time_of(row), out);
    if (state == ContactState::ok) sink(numbers_[slot(row)], out);
    return state != ContactState::waiting;
  }

  // The rows that have not been given yet, up to one; whether none of them waits.
  template <typename Sink>
  bool give_until(std::int64_t last, Sink&& sink) noexcept {
    for (next_ = std::max(next_, oldest()); next_ <= last; ++next_)
      if (!give(next_, sink) && last_time_ - time_of(next_) <= reach_ns_) return false;
    return true;
  }

  template <typename Sink>
  void give_pose(std::int64_t row, Sink&& sink) noexcept {
    ContactWrench out;
    if (contact.evaluate_pose(time_of(row), out) == ContactState::ok) sink(numbers_[slot(row)], out);
  }

  // With the periods known, and a first row that has its wrench: how many rows a kernel waits for, and the rows that
  // have waited for that. A kernel may be longer than what tells the periods, samples be missing there, or have come in
  // a burst: then later, and with the periods of then.
  template <typename Sink>
  void start(Sink&& sink) noexcept {
    if (!timed_ || raw_.renewed() || motion_.renewed()) {
      const double raw = raw_.median(), motion = motion_.median();
      const Status status = contact.set_periods(raw, motion);
      timed_ = status == Status::ok;
      too_long_ = status == Status::wrong_size;
      if (!timed_) return;
      reach_ns_ = std::llround(1e9 * (2.0 * contact.delay() + learned * std::max(raw, motion)));
    }
    if (!newest_) {
      std::int64_t least = static_cast<std::int64_t>(times_.size()), most = -1;
      ContactWrench out;
      for (std::int64_t r = rows_ - 1; r >= oldest() && last_time_ - time_of(r) <= reach_ns_; --r) {
        if (contact.evaluate(time_of(r), out) != ContactState::ok) continue;
        least = std::min(least, out.newest - r);
        most = std::max(most, out.newest - r);
      }
      if (most < 0) return;
      lag_ = most + (most > least ? 1 : 0);  // where it varies, another row may need one more
      settled_ = most > least ? 0 : rows_ + learned;
    }
    started_ = true;
    give_until(rows_ - 1 - lag_, sink);
  }

  bool add_raw(const ContactRow& row, std::int64_t k) noexcept {
    if (row.raw == nullptr) return false;
    for (int i = 0; i < contact.channels(); ++i)
      if (!std::isfinite(row.raw[i])) return false;
    return contact.add_raw(raw_stamps_.stamp(row.time_ns), row.raw, k) == Status::ok;
  }

  bool add_motion(const ContactRow& row, std::int64_t k) noexcept {
    const bool moving = row.twist.allFinite(), fall = row.fall.allFinite();
    const std::int64_t time_ns = moving ? motion_stamps_.stamp(row.time_ns) : row.time_ns;
    if (imu_)
      return moving && fall &&
             contact.add_motion(time_ns, row.twist, row.fall, Matrix3::Zero(), k, false) == Status::ok;
    follow(row, time_ns, moving, fall);
    if (!moving) return false;
    const Vector3 g = fall ? row.fall : Vector3(R_ * gravity_);
    if (!fall && !turned_ && !gravity_.isZero(0.0)) return false;
    return contact.add_motion(time_ns, row.twist, g, turned_ ? R_ : Matrix3::Zero().eval(), k, headed_) ==
           Status::ok;
  }

  // How the sensor is turned: as the row says; else the last turn, carried on by the angular velocity, with the smallest
  // further one that puts the stated direction of gravity on the logged one. Where there is nothing to carry on, the
  // turn about gravity is not known.
  void follow(const ContactRow& row, std::int64_t time_ns, bool moving, bool fall) noexcept {
    const Vector3 omega = moving ? Vector3(row.twist.tail<3>()) : omega_;
    if (row.R_sensor_root.allFinite()) {
      R_ = row.R_sensor_root;
      turned_ = headed_ = true;
    } else {
      const std::int64_t since = time_ns - turn_time_;
      if (turned_ && since < apart_ns) {
        const Vector3 angle = -0.5e-9 * static_cast<double>(since) * (omega + omega_);
        const double size = angle.norm();
        if (size > 0.0) R_ = Eigen::AngleAxisd(size, angle / size).toRotationMatrix() * R_;
      } else if (turned_ && !fall) {
        turned_ = headed_ = false;
      }
      const double weight = gravity_.norm(), found = fall ? row.fall.norm() : 0.0;
      if (weight > 0.0 && found > 0.0) {
        if (!turned_ || since >= apart_ns) {
          contact.forget_heading();
          headed_ = false;
        }
        if (!turned_) R_.setIdentity();
        const Vector3 down = R_ * gravity_ / weight, logged = row.fall / found, axis = down.cross(logged);
        const double sine = axis.norm();  // by angle and axis: Eigen's FromTwoVectors brings an SVD along
        R_ = Eigen::AngleAxisd(std::atan2(sine, down.dot(logged)),
                               sine > 0.0 ? Vector3(axis / sine) : Vector3(down.unitOrthogonal()))
                 .toRotationMatrix() *
             R_;
        R_ = Eigen::Quaterniond(R_).normalized().toRotationMatrix();  // against the rounding of many products
        turned_ = true;
      }
    }
    omega_ = omega;
    turn_time_ = time_ns;
  }

  Vector3 gravity_ = Vector3::Zero(), omega_ = Vector3::Zero();
  Matrix3 R_ = Matrix3::Zero();
  std::vector<std::int64_t> times_, numbers_;  // of the rows with a sample of sensor or motion
  std::int64_t rows_ = 0, given_ = 0, lag_ = 0, turn_time_ = 0, last_time_ = 0;
  std::int64_t next_ = 0;      // row that is given next
  std::int64_t settled_ = 0;   // row from which on the lag stays
  std::int64_t reach_ns_ = 0;  // how far back a row may still wait
  Intervals raw_, motion_;
  contact::EvenStamps raw_stamps_, motion_stamps_;
  bool newest_ = false, imu_ = false, first_ = true, timed_ = false, started_ = false, lonely_ = false;
  bool too_long_ = false;
  bool turned_ = false, headed_ = false;  // R_ is known; its turn about gravity too
};

}  // namespace truewrench
