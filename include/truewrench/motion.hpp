// The double integrator the filter takes for the motion ([A00] 18-21): nu' = a, a' = white noise.
#pragma once

#include "truewrench/types.hpp"

namespace truewrench {

using Matrix12 = Eigen::Matrix<double, 12, 12>;

// What white noise of unit density on a' leaves on nu and a after a step of dt seconds:
// Q = [twist s, cross s; cross s, acceleration s] for the densities s of the six components.
struct ProcessWeights {
  double twist;         // dt^3 / 3
  double cross;         // dt^2 / 2
  double acceleration;  // dt
};

inline ProcessWeights process_weights(double dt) { return {dt * dt * dt / 3.0, 0.5 * dt * dt, dt}; }

// F on [nu; a]: nu(t + dt) = nu + dt a.
inline Matrix12 transition(double dt) {
  Matrix12 f = Matrix12::Identity();
  f.topRightCorner<6, 6>().diagonal().setConstant(dt);
  return f;
}

// Q on [nu; a] for the spectral densities of a' ([(m/s^2)^2/s], [(rad/s^2)^2/s]).
inline Matrix12 process_noise(double dt, const Vector6& density) {
  const ProcessWeights weights = process_weights(dt);
  Matrix12 q = Matrix12::Zero();
  q.topLeftCorner<6, 6>().diagonal() = weights.twist * density;
  q.topRightCorner<6, 6>().diagonal() = weights.cross * density;
  q.bottomLeftCorner<6, 6>().diagonal() = weights.cross * density;
  q.bottomRightCorner<6, 6>().diagonal() = weights.acceleration * density;
  return q;
}

}  // namespace truewrench
