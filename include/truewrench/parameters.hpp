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
//
// Logs, or parts of one, in the order of time can be linked: a parameter of a log's own is then that of the log before
// plus a step of known variance, a random walk, and only the first of them has the prior.
struct CommonPrior {
  ParameterLayout layout;
  Eigen::VectorXd mean;                              // of one log's vector
  Eigen::VectorXd information;                       // 1 / variance; the payload's entries are not used
  std::vector<int> payload_of;                       // per log: which payload it carries,
  std::vector<Eigen::VectorXd> payload_information;  // and per payload, what is known of it
  bool gains_walk = false;                           // every log has gains of its own
  // Per log: 1 / variance of the step from the log before, 0 where there is none; or empty.
  std::vector<Eigen::VectorXd> links;

  int payloads() const { return layout.payload ? static_cast<int>(payload_information.size()) : 0; }

  // Places in a log's vector of what it shares with other logs (`shared`), or of what is its own.
  std::vector<int> indices(bool shared) const {
    std::vector<int> out;
    for (int i = 0; i < layout.size(); ++i) {
      const bool own = i >= layout.shared() || (gains_walk && i < layout.gains());
      if (own != shared) out.push_back(i);
    }
    return out;
  }

  // Number of parameters shared by any logs, every payload with its own.
  int shared() const {
    return static_cast<int>(indices(true).size()) +
           kPayloadParameters * (payloads() - (layout.payload ? 1 : 0));
  }

  // Where the shared parameters of a log stand among all of them: [gains | payloads | temperature | offset].
  std::vector<int> places(std::size_t log) const {
    std::vector<int> out;
    const int behind = kPayloadParameters * (payloads() - (layout.payload ? 1 : 0));
    const int before = gains_walk ? layout.gains() : 0;
    for (const int i : indices(true)) {
      if (i < layout.gains()) {
        out.push_back(i);
      } else if (i < layout.temperature_begin()) {  // none without an uncertain payload
        out.push_back(i - before + kPayloadParameters * payload_of[log]);
      } else {
        out.push_back(i - before + behind);
      }
    }
    return out;
  }

  // Prior of the shared parameters of all logs.
  Prior shared_prior() const {
    Prior out{Eigen::MatrixXd::Zero(shared(), shared()), Eigen::VectorXd::Zero(shared())};
    const std::vector<int> local = indices(true);
    for (std::size_t log = 0; log < (layout.payload ? payload_of.size() : 1); ++log) {
      const std::vector<int> at = places(log);
      for (std::size_t q = 0; q < at.size(); ++q) {
        const int i = local[q];
        const int k = at[q];
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

  // Information of the steps into a log's own parameters from those of the log before; empty: none.
  Eigen::VectorXd link(std::size_t log) const {
    if (log >= links.size() || links[log].size() == 0) return {};
    return links[log](indices(false));
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

// Eliminates each log's own parameters, solves for the shared ones, and substitutes back. Linked logs form a chain:
// block-tridiagonal in their own parameters, x_l - x_{l-1} being a step of information K_l.
inline Posterior combine(const CommonPrior& prior, const std::vector<InformationSum>& logs) {
  struct Own {  // of one log, what came before eliminated: D x = eta - B shared + K_{l+1} x_{l+1}
    Eigen::LLT<Eigen::MatrixXd> d;
    Eigen::VectorXd eta;
    Eigen::MatrixXd b;
  };
  const std::vector<int> shared = prior.indices(true);
  const std::vector<int> own = prior.indices(false);
  const auto m = static_cast<Eigen::Index>(own.size());
  const Prior shared_prior = prior.shared_prior();
  Eigen::MatrixXd a = shared_prior.information;
  Eigen::VectorXd eta = a * shared_prior.mean;
  const Eigen::VectorXd own_information = prior.information(own);
  const Eigen::VectorXd own_mean = prior.mean(own);
  std::vector<Own> chain(logs.size());
  Posterior out;
  for (std::size_t l = 0; l < logs.size(); ++l) {
    const InformationSum& log = logs[l];
    const std::vector<int> at = prior.places(l);
    a(at, at) += log.matrix(shared, shared);
    eta(at) += log.vector(shared);
    if (m == 0) continue;
    Eigen::MatrixXd d = log.matrix(own, own);
    Own& o = chain[l];
    o.eta = log.vector(own);
    o.b = Eigen::MatrixXd::Zero(m, a.rows());
    o.b(Eigen::seqN(0, m), at) = log.matrix(own, shared);
    const Eigen::VectorXd k = prior.link(l);
    const Eigen::VectorXd next = prior.link(l + 1);
    for (Eigen::Index i = 0; i < m; ++i) {
      const bool linked = k.size() > 0 && k[i] > 0.0;
      d(i, i) += linked ? k[i] : own_information[i];
      if (!linked) o.eta[i] += own_information[i] * own_mean[i];
      if (l + 1 < logs.size() && next.size() > 0) d(i, i) += next[i];
    }
    if (k.size() > 0) {
      const Own& p = chain[l - 1];
      d -= k.asDiagonal() * p.d.solve(Eigen::MatrixXd(k.asDiagonal()));
      o.eta += k.asDiagonal() * p.d.solve(p.eta);
      o.b += k.asDiagonal() * p.d.solve(p.b);
    }
    o.d.compute(d);
    if (o.d.info() != Eigen::Success) out.status = Status::not_factorizable;
    const Eigen::MatrixXd half = o.d.solve(o.b);
    a -= o.b.transpose() * half;
    eta -= half.transpose() * o.eta;
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(a);
  if (factor.info() != Eigen::Success) out.status = Status::not_factorizable;
  if (out.status != Status::ok) return out;
  const Eigen::VectorXd all = factor.solve(eta);
  const Eigen::MatrixXd p_all = factor.solve(Eigen::MatrixXd::Identity(a.rows(), a.cols()));
  out.mean.resize(logs.size());
  out.covariance.resize(logs.size());
  Eigen::VectorXd x;              // of the log after: mean,
  Eigen::MatrixXd x_shared, x_x;  // and covariance with the shared parameters and with itself
  for (std::size_t l = logs.size(); l-- > 0;) {
    const std::vector<int> at = prior.places(l);
    Eigen::VectorXd mean(static_cast<Eigen::Index>(prior.layout.size()));
    Eigen::MatrixXd covariance(mean.size(), mean.size());
    mean(shared) = all(at);
    covariance(shared, shared) = p_all(at, at);
    if (m > 0) {
      const Own& o = chain[l];
      const Eigen::VectorXd next = l + 1 < logs.size() ? prior.link(l + 1) : Eigen::VectorXd();
      const Eigen::MatrixXd inverse = o.d.solve(Eigen::MatrixXd::Identity(m, m));
      const Eigen::MatrixXd by_shared = -inverse * o.b;
      Eigen::VectorXd own_x = inverse * o.eta + by_shared * all;
      Eigen::MatrixXd own_shared = by_shared * p_all;
      Eigen::MatrixXd own_own = inverse + own_shared * by_shared.transpose();
      if (next.size() > 0) {
        const Eigen::MatrixXd by_next = inverse * next.asDiagonal();
        own_x += by_next * x;
        own_own += by_next * x_x * by_next.transpose();
        const Eigen::MatrixXd mixed = by_next * x_shared * by_shared.transpose();
        own_own += mixed + mixed.transpose();
        own_shared += by_next * x_shared;
      }
      mean(own) = own_x;
      const Eigen::MatrixXd here = own_shared(Eigen::seqN(0, m), at);
      covariance(own, shared) = here;
      covariance(shared, own) = here.transpose();
      covariance(own, own) = own_own;
      x = std::move(own_x);
      x_shared = std::move(own_shared);
      x_x = std::move(own_own);
    }
    out.mean[l] = std::move(mean);
    out.covariance[l] = 0.5 * (covariance + covariance.transpose());
  }
  return out;
}

}  // namespace truewrench
