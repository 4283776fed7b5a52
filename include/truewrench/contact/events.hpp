// Contacts as events: when they begin and end, how hard they were, and where.
#pragma once

#include "truewrench/contact/estimate.hpp"

#include <Eigen/Geometry>

#include <cstdint>
#include <optional>

namespace truewrench {

struct ContactEvent {
  std::int64_t begin_ns = 0;        // first sample above the limit
  std::int64_t end_ns = 0;          // last one
  double peak_force = 0.0;          // largest norm of the force [N]
  Vector3 point = Vector3::Zero();  // of the wrench's axis, nearest to the centre of mass, at the peak [m]
};

// The point of a wrench's axis that is nearest to c, both seen from where the wrench acts; c itself without a force.
inline Vector3 nearest_on_axis(const Vector6& w, const Vector3& c) {
  const Vector3 f = w.head<3>();
  const double square = f.squaredNorm();
  if (square == 0.0) return c;
  return c + f.cross(w.tail<3>() - c.cross(f)) / square;
}

class ContactEvents {
 public:
  // One contact wrench after the other; gives the event that has ended by now, if one has.
  std::optional<ContactEvent> step(const ContactWrench& w, const Vector3& center_of_mass) noexcept {
    std::optional<ContactEvent> ended;
    if (active_ && w.time_ns - event_.end_ns > merged_ns) ended = finish();
    if (!(w.chi2 > contact_limit)) return ended;
    const double force = w.wrench.head<3>().norm();
    if (!active_) event_ = {w.time_ns, w.time_ns, -1.0, center_of_mass};
    active_ = true;
    event_.end_ns = w.time_ns;
    if (force > event_.peak_force) {
      event_.peak_force = force;
      event_.point = nearest_on_axis(w.wrench, center_of_mass);
    }
    return ended;
  }

  // The event that still lasts, at the end of all samples.
  std::optional<ContactEvent> finish() noexcept {
    if (!active_) return std::nullopt;
    active_ = false;
    return event_;
  }

  bool active() const noexcept { return active_; }

 private:
  static constexpr std::int64_t merged_ns = 100'000'000;  // what is closer in time is one event

  ContactEvent event_;
  bool active_ = false;
};

}  // namespace truewrench
