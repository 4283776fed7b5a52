// Six-vectors, status codes and the sign of a wrench: the vocabulary of every other header.
//
// Conventions (docs/notation.md): six-vectors are linear first, angular second; SI units; the twist
// nu = [v; Omega] is that of the payload's centre of mass in sensor axes, a = d(nu)/dt its
// component-wise derivative, w = [f; n] the reaction of the payload on the sensor at the sensor centre.
#pragma once

#include <Eigen/Core>

#include <cstdint>

namespace truewrench {

using Vector3 = Eigen::Vector3d;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix3 = Eigen::Matrix3d;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

// What a call has to say instead of throwing. Zero is success, so `if (status != Status::ok)` reads well.
enum class Status : std::uint8_t {
  ok = 0,
  not_finite,          // an input holds a NaN or an infinity
  not_positive,        // a variance, mass or time step is not positive
  not_factorizable,    // a matrix that must be positive definite is not, to working precision
  wrong_size,          // array lengths disagree
  not_increasing,      // time stamps do not strictly increase
  unphysical_payload,  // the inertia violates positive definiteness or the triangle inequality
  singular,            // a gain cannot be inverted
  not_converged,       // an iteration ended before its tolerance
  not_configured,      // nothing was configured yet, or the last attempt failed
};

// Sign of w in `raw = gain * w + offset` (docs/notation.md, "Sign").
enum class Feels : std::int8_t {
  payload_on_sensor = 1,   // the reaction of the payload, w itself
  sensor_on_payload = -1,  // its negative
};

}  // namespace truewrench
