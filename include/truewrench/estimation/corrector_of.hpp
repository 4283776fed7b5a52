// What an online estimate makes of raw channels: the corrector of a control loop.
#pragma once

#include "truewrench/corrector.hpp"
#include "truewrench/estimation/incremental.hpp"
#include "truewrench/estimation/second_order.hpp"

namespace truewrench {

// Configures a corrector with gain, offset, and all that is uncertain in them, in the units of the raw channels: fractions of
// range times `channel_scale` (n), R_i = |nominal_i| @ range (METHOD 10.1); in the middle of their posterior. Before the estimate
// is ready: not_configured. Allocates; a loop keeps two, and changes them over.
template <int N>
Status configure(Corrector<N>& corrector, Incremental& online, const Eigen::VectorXd& channel_scale) {
  const Lag& lag = online.lag();
  const int n = lag.channels(), gain = lag.columns().C, offset = lag.columns().b, quadratic = lag.columns().u,
            body = lag.columns().body_in_theta;
  if (!online.ready()) return Status::not_configured;
  if (channel_scale.size() != n || (N != Eigen::Dynamic && n != N)) return Status::wrong_size;
  const Eigen::MatrixXd& P = online.theta_covariance();
  Carried carried;
  for (int k = 0; k < kBodyParameters; ++k) carried.places[static_cast<std::size_t>(k)] = body + k;
  carried.body = departed(lag.about().payload, online.theta().segment<kBodyParameters>(body));
  const Eigen::VectorXd prior = online.prior().segment(gain, 6 * n),
                        theta = online.theta() + to_the_middle(P, prior, lag.rig().range, {carried});
  Eigen::MatrixXd covariance(7 * n, 7 * n);
  covariance.topRightCorner(6 * n, n) = P.block(gain, offset, 6 * n, n);
  covariance.bottomLeftCorner(n, 6 * n) = P.block(offset, gain, n, 6 * n);
  covariance.bottomRightCorner(n, n) = P.block(offset, offset, n, n);
  Eigen::VectorXd bent(n);  // of upsilon (10.3): what is found, and its sigma
  for (int i = 0; i < n; ++i)
    bent[i] = std::hypot(theta[quadratic + i], std::sqrt(P(quadratic + i, quadratic + i))) / channel_scale[i];
  covariance.topLeftCorner(6 * n, 6 * n) = online.covariance();  // (10.9), (10.10)
  Eigen::VectorXd unit(7 * n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < 6; ++j) unit[6 * i + j] = channel_scale[i] / lag.rig().range[j];
    unit[6 * n + i] = channel_scale[i];
  }
  covariance = unit.asDiagonal() * covariance * unit.asDiagonal();
  const auto units = unit.head(6 * n);
  covariance.topLeftCorner(6 * n, 6 * n) +=
      bend(units.asDiagonal() * P.block(gain, gain, 6 * n, 6 * n) * units.asDiagonal(),
           P.block<3, 3>(body + 1, body + 1), units.cwiseAbs2().cwiseProduct(prior));
  SensorModel<N> sensor;
  sensor.gain = channel_scale.asDiagonal() * Eigen::Map<const RowMatrix>(theta.data() + gain, n, 6) *
                lag.rig().range.cwiseInverse().asDiagonal();
  sensor.offset = channel_scale.cwiseProduct(theta.segment(offset, n));
  sensor.noise = channel_scale.cwiseProduct(lag.rig().noise);
  const Eigen::VectorXd slow = channel_scale.cwiseProduct(online.discrepancy2().cwiseSqrt());
  return corrector.configure(sensor, covariance, bent, slow);
}

}  // namespace truewrench
