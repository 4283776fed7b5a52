// Whether what is stated of a sensor and of a log makes sense, before anything is built on it: sizes, signs, finite numbers.
#pragma once

#include "truewrench/math/spline.hpp"
#include "truewrench/model/record.hpp"

#include <cmath>
#include <initializer_list>

namespace truewrench {

namespace checked {

// Sizes of noise, positive, or (`held`) of what is not known, of which 0 holds it.
template <typename Numbers>
Status sigmas(const Numbers& all, bool held) {
  for (Eigen::Index i = 0; i < all.size(); ++i)
    if (!std::isfinite(all.data()[i])) return Status::not_finite;
  for (Eigen::Index i = 0; i < all.size(); ++i)
    if (all.data()[i] < 0.0 || (all.data()[i] == 0.0 && !held)) return Status::not_positive;
  return Status::ok;
}
inline Status prior(double sigma) { return sigmas(Eigen::Matrix<double, 1, 1>(sigma), true); }

inline Status increasing(const double* time, Eigen::Index count) {
  for (Eigen::Index k = 0; k < count; ++k)
    if (!std::isfinite(time[k])) return Status::not_finite;
  for (Eigen::Index k = 1; k < count; ++k)
    if (!(time[k] > time[k - 1])) return Status::not_increasing;
  return Status::ok;
}

// The first that is not ok.
inline Status first(std::initializer_list<Status> all) {
  for (const Status s : all)
    if (s != Status::ok) return s;
  return Status::ok;
}

// An offset that walks.
inline Status walk(const RecordedLog& log) {
  const std::vector<double>& knots = log.offset_knots;
  if (!std::isfinite(log.offset_walk)) return Status::not_finite;
  if (log.offset_walk < 0.0) return Status::not_positive;
  if (knots.size() == 1 || (knots.empty() && log.offset_walk > 0.0)) return Status::wrong_size;
  return increasing(knots.data(), static_cast<Eigen::Index>(knots.size()));
}

// A stream of so many components.
inline Status stream(const MotionStream& m, Eigen::Index components) {
  const auto sized = [components](Eigen::Index size) { return size == components; };
  if (!sized(m.sigma.size()) || !sized(m.group.size()) ||
      (m.bias_prior.size() > 0 && !sized(m.bias_prior.size())) ||
      (m.value.rows() > 0 && !sized(m.value.cols())))
    return Status::wrong_size;
  if (m.derivative < 0 || m.derivative > kDegree5) return Status::wrong_size;
  for (Eigen::Index j = 0; j < components; ++j)
    if (m.group[j] < 0 || m.group[j] >= components) return Status::wrong_size;
  if (!std::isfinite(m.clock_mean) || !std::isfinite(m.kappa_mean)) return Status::not_finite;
  return first(
      {sigmas(m.sigma, false), sigmas(m.bias_prior, true), prior(m.time_offset_prior), prior(m.half_window)});
}

// Rows of a matrix, which may be none: so many, of so many columns.
inline bool rows(const RowMatrix& m, Eigen::Index count, Eigen::Index columns) {
  return m.rows() == 0 || (m.rows() == count && m.cols() == columns);
}

}  // namespace checked

// What a rig states of its sensor.
inline Status check(const Statement& rig) {
  const Eigen::Index n = rig.noise.size();
  if (n < 1 || n > max_components || rig.nominal.rows() != n || rig.nominal.cols() != 6 ||
      rig.offset_prior.size() != n || rig.body_prior.empty())
    return Status::wrong_size;
  if (!rig.nominal.allFinite() || !rig.gravity.allFinite() || !std::isfinite(rig.sign) ||
      !std::isfinite(rig.gamma_mean))
    return Status::not_finite;
  if (std::abs(rig.sign) != 1.0) return Status::not_positive;
  for (const auto& body : rig.body_prior)
    if (const Status status = checked::sigmas(body, true); status != Status::ok) return status;
  return checked::first({checked::sigmas(rig.range, false), checked::sigmas(rig.noise, false),
                         checked::sigmas(rig.offset_prior, true), checked::prior(rig.gain_prior),
                         checked::prior(rig.tilt_prior), checked::prior(rig.slope_prior)});
}

// And what is said of a log, its samples apart.
inline Status check(const Statement& rig, const RecordedLog& log) {
  if (const Status status = check(rig); status != Status::ok) return status;
  if (log.motion.empty() || log.body < 0 || static_cast<std::size_t>(log.body) >= rig.body_prior.size())
    return Status::wrong_size;
  const Eigen::Index M = log.motion.front().sigma.size();
  if (M < 1 || M > max_components || (log.source != Source::mapped && M != 6)) return Status::wrong_size;
  for (const MotionStream& m : log.motion)
    if (const Status status = checked::stream(m, M); status != Status::ok) return status;
  if (!log.point.allFinite() || !std::isfinite(log.clock_set)) return Status::not_finite;
  // a table's rounding, and the solver's of principal moments
  return checked::first(
      {check(log.payload, 1e-6), checked::walk(log), checked::prior(log.half_window),
       checked::increasing(log.own_roots.data(), static_cast<Eigen::Index>(log.own_roots.size()))});
}

// And of its samples: as many of each as there are stamps, which increase; the attitude where gravity is felt along it.
inline Status check_samples(const Statement& rig, const RecordedLog& log) {
  if (const Status status = check(rig, log); status != Status::ok) return status;
  const Eigen::Index count = log.time.size(), n = rig.noise.size();
  const auto each = [](Eigen::Index size, Eigen::Index of) { return size == 0 || size == of; };
  if (log.raw.rows() != count || !checked::rows(log.raw, count, n) ||
      !checked::rows(log.R_sensor_root, count, 9) || !each(log.temperature.size(), count) ||
      !each(log.size.size(), count) || !checked::rows(log.remainder, log.size.size(), n))
    return Status::wrong_size;
  if (const Status status = checked::increasing(log.time.data(), count); status != Status::ok) return status;
  for (const MotionStream& m : log.motion) {
    if (m.value.rows() != m.time.size() || !each(m.size.size(), m.time.size()) ||
        !checked::rows(m.remainder, m.size.size(), m.sigma.size()))
      return Status::wrong_size;
    const Status status = checked::increasing(m.time.data(), m.time.size());
    if (status != Status::ok) return status;
  }
  if (log.source == Source::mapped && !log.map) return Status::not_configured;
  if (log.source != Source::twist || !rig.gravity.cwiseAbs().any() || count == 0) return Status::ok;
  if (log.R_sensor_root.rows() != count) return Status::wrong_size;
  for (Eigen::Index k = 0; k < count; ++k)
    if (log.raw.row(k).array().isFinite().any() && !log.R_sensor_root.row(k).allFinite())
      return Status::not_finite;
  return Status::ok;
}

}  // namespace truewrench
