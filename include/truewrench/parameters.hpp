// The common parameters: the gain shared by all logs, and beside it what is known only so well: payload, offset,
// clock, temperature (docs/method.md, "Common parameters").
#pragma once

#include "truewrench/payload.hpp"

#include <Eigen/Dense>

#include <cmath>
#include <cstddef>
#include <vector>

namespace truewrench {

inline constexpr int kPayloadParameters = 10;

// Where the common parameters of one log stand in its vector:
// [gains row by row | payload | slope with temperature | offset | time offset].
// The first group is shared between logs (the payload with those that carry it), the rest is each log's own.
struct ParameterLayout {
  int channels = 6;
  bool payload = false;      // departures from the stated payload: see `payload_at`
  bool temperature = false;  // of the offset, per K
  bool offset = true;
  bool pool_offsets = false;  // one offset for all logs
  bool time_offset = false;   // t_motion = t_sensor + time_offset [s]

  int gains() const { return 6 * channels; }
  int payload_begin() const { return gains(); }
  int temperature_begin() const { return payload_begin() + (payload ? kPayloadParameters : 0); }
  int offset_begin() const { return temperature_begin() + (temperature ? channels : 0); }
  int time_offset_begin() const { return offset_begin() + (offset ? channels : 0); }
  int size() const { return time_offset_begin() + (time_offset ? 1 : 0); }
  int shared() const { return pool_offsets ? time_offset_begin() : offset_begin(); }
};

// The payload at departures p from what is stated: [mass, relative; centre of mass (3) [m]; xx, yy, zz, xy, xz, yz
// of the inertia, relative to sqrt(I_ii I_jj)].
template <typename Derived>
Payload payload_at(const Payload& stated, const Eigen::MatrixBase<Derived>& p) {
  Payload out = stated;
  out.mass *= 1.0 + p[0];
  out.center_of_mass += p.template segment<3>(1);
  const Vector3 root = stated.inertia.diagonal().cwiseSqrt();
  for (int i = 0; i < 3; ++i) out.inertia(i, i) += p[4 + i] * root[i] * root[i];
  for (int k = 0; k < 3; ++k) {
    const int i = k == 2 ? 1 : 0;
    const int j = k == 0 ? 1 : 2;
    out.inertia(i, j) += p[7 + k] * root[i] * root[j];
    out.inertia(j, i) = out.inertia(i, j);
  }
  return out;
}

// dw/dp at a motion of the centre of mass. A departure of the centre of mass moves it, and not the logged point,
// which is fixed to the sensor: the acceleration there changes by Omegadot x dc + Omega x (Omega x dc).
inline Eigen::Matrix<double, 6, kPayloadParameters> wrench_by_payload(const Payload& stated, const Payload& p,
                                                                      const Vector6& nu, const Vector6& a,
                                                                      const Vector3& g) {
  const Vector3 omega = nu.tail<3>();
  const Vector3 alpha = a.tail<3>();
  const Vector3 specific = a.head<3>() + omega.cross(Vector3(nu.head<3>())) - g;
  const Matrix3 omega_x = cross_matrix(omega);
  const Matrix3 lever = p.mass * (cross_matrix(alpha) + omega_x * omega_x);
  const Vector3 root = stated.inertia.diagonal().cwiseSqrt();
  Eigen::Matrix<double, 6, kPayloadParameters> j;
  j.block<3, 1>(0, 0) = -stated.mass * specific;
  j.block<3, 1>(3, 0) = -stated.mass * p.center_of_mass.cross(specific);
  j.block<3, 3>(0, 1) = -lever;
  j.block<3, 3>(3, 1) = cross_matrix(p.mass * specific) - cross_matrix(p.center_of_mass) * lever;
  j.block<3, 6>(0, 4).setZero();
  for (int k = 0; k < 6; ++k) {
    const int i = k < 3 ? k : (k == 5 ? 1 : 0);
    const int l = k < 3 ? k : (k == 3 ? 1 : 2);
    Matrix3 inertia = Matrix3::Zero();
    inertia(i, l) = inertia(l, i) = root[i] * root[l];
    j.block<3, 1>(3, 4 + k) = -(inertia * alpha + omega.cross(inertia * omega));
  }
  return j;
}

// Information on the common parameters that one window leaves, linearised at theta.
struct Information {
  Eigen::MatrixXd matrix;  // S
  Eigen::VectorXd score;   // s: the Gauss-Newton step is (S + prior)^-1 (s + ...)
};

// A Gaussian on the common parameters of one log.
struct Prior {
  Eigen::MatrixXd information;
  Eigen::VectorXd mean;
};

// Priors of the common parameters, normalised and independent.
struct CommonPrior {
  ParameterLayout layout;
  Eigen::VectorXd mean;                              // of one log's vector
  Eigen::VectorXd information;                       // 1 / variance; the payload's entries are not used
  std::vector<int> payload_of;                       // per log: which payload it carries,
  std::vector<Eigen::VectorXd> payload_information;  // and per payload, what is known of it

  int payloads() const { return layout.payload ? static_cast<int>(payload_information.size()) : 0; }

  // Number of parameters shared by any logs, every payload with its own.
  int shared() const {
    return layout.shared() - (layout.payload ? kPayloadParameters : 0) + kPayloadParameters * payloads();
  }

  // Where the shared parameters of a log stand among all of them: [gains | payloads | temperature | offset].
  std::vector<int> places(std::size_t log) const {
    std::vector<int> out;
    const int behind = kPayloadParameters * (payloads() - (layout.payload ? 1 : 0));
    for (int i = 0; i < layout.shared(); ++i) {
      if (i < layout.gains()) {
        out.push_back(i);
      } else if (i < layout.temperature_begin()) {  // none without an uncertain payload
        out.push_back(i + kPayloadParameters * payload_of[log]);
      } else {
        out.push_back(i + behind);
      }
    }
    return out;
  }

  // Prior of the shared parameters of all logs.
  Prior shared_prior() const {
    Prior out{Eigen::MatrixXd::Zero(shared(), shared()), Eigen::VectorXd::Zero(shared())};
    for (std::size_t log = 0; log < (layout.payload ? payload_of.size() : 1); ++log) {
      const std::vector<int> at = places(log);
      for (int i = 0; i < layout.shared(); ++i) {
        const auto k = at[static_cast<std::size_t>(i)];
        const bool of_payload = i >= layout.payload_begin() && i < layout.temperature_begin();
        out.information(k, k) =
            of_payload
                ? payload_information[static_cast<std::size_t>(payload_of[log])][i - layout.payload_begin()]
                : information[i];
        out.mean[k] = of_payload ? 0.0 : mean[i];
      }
    }
    return out;
  }
};

// Sum over windows of the information matrix S and vector eta = s + S theta.
struct InformationSum {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd vector;

  explicit InformationSum(int size = 0)
      : matrix(Eigen::MatrixXd::Zero(size, size)), vector(Eigen::VectorXd::Zero(size)) {}

  void add(const Information& i, const Eigen::VectorXd& theta) {
    matrix += i.matrix;
    vector += i.score + i.matrix * theta;
  }
};

// Posterior of every log's common parameters.
struct Posterior {
  Status status = Status::ok;
  std::vector<Eigen::VectorXd> mean;
  std::vector<Eigen::MatrixXd> covariance;
};

// Eliminates each log's own parameters, solves for the shared ones, and substitutes back.
inline Posterior combine(const CommonPrior& prior, const std::vector<InformationSum>& logs) {
  const int c = prior.layout.shared();
  const int own = prior.layout.size() - c;
  const Prior shared_prior = prior.shared_prior();
  Eigen::MatrixXd a = shared_prior.information;
  Eigen::VectorXd eta = a * shared_prior.mean;
  std::vector<Eigen::LLT<Eigen::MatrixXd>> factors(logs.size());
  std::vector<Eigen::VectorXd> own_eta(logs.size());
  Posterior out;
  for (std::size_t l = 0; l < logs.size(); ++l) {
    const InformationSum& log = logs[l];
    Eigen::MatrixXd s = log.matrix.topLeftCorner(c, c);
    Eigen::VectorXd v = log.vector.head(c);
    if (own > 0) {
      Eigen::MatrixXd d = log.matrix.bottomRightCorner(own, own);
      d += Eigen::MatrixXd(prior.information.tail(own).asDiagonal());
      own_eta[l] = log.vector.tail(own) + prior.information.tail(own).cwiseProduct(prior.mean.tail(own));
      factors[l].compute(d);
      if (factors[l].info() != Eigen::Success) out.status = Status::not_factorizable;
      s -= log.matrix.topRightCorner(c, own) * factors[l].solve(log.matrix.bottomLeftCorner(own, c));
      v -= log.matrix.topRightCorner(c, own) * factors[l].solve(own_eta[l]);
    }
    const std::vector<int> at = prior.places(l);
    a(at, at) += s;
    eta(at) += v;
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(a);
  if (factor.info() != Eigen::Success) out.status = Status::not_factorizable;
  if (out.status != Status::ok) return out;
  const Eigen::VectorXd all = factor.solve(eta);
  const Eigen::MatrixXd p_all = factor.solve(Eigen::MatrixXd::Identity(a.rows(), a.cols()));
  for (std::size_t l = 0; l < logs.size(); ++l) {
    const std::vector<int> at = prior.places(l);
    const Eigen::VectorXd shared = all(at);
    const Eigen::MatrixXd p = p_all(at, at);
    Eigen::VectorXd mean(c + own);
    Eigen::MatrixXd covariance(c + own, c + own);
    mean.head(c) = shared;
    covariance.topLeftCorner(c, c) = p;
    if (own > 0) {
      const Eigen::MatrixXd k = factors[l].solve(logs[l].matrix.bottomLeftCorner(own, c));
      mean.tail(own) = factors[l].solve(own_eta[l]) - k * shared;
      covariance.topRightCorner(c, own) = -p * k.transpose();
      covariance.bottomLeftCorner(own, c) = -k * p;
      covariance.bottomRightCorner(own, own) =
          factors[l].solve(Eigen::MatrixXd::Identity(own, own)) + k * p * k.transpose();
    }
    out.mean.push_back(std::move(mean));
    out.covariance.push_back(0.5 * (covariance + covariance.transpose()));
  }
  return out;
}

}  // namespace truewrench
