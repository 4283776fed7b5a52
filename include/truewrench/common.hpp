// The common parameters of several logs: one gain for all, an offset for each (or one for all), and how what
// the windows leave on them adds up (docs/method.md, "Common parameters").
#pragma once

#include "truewrench/knots.hpp"

#include <Eigen/Dense>

#include <vector>

namespace truewrench {

// Prior of the common parameters, normalised: independent, about the nominal gain and a zero offset.
struct CommonPrior {
  ParameterLayout layout;
  bool pool_offsets = false;
  Eigen::VectorXd mean;         // [gains row by row, offset]
  Eigen::VectorXd information;  // 1 / variance

  // Parameters that all logs share; the rest are each log's own.
  int shared() const { return pool_offsets ? layout.size() : layout.gains(); }
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

// Posterior of [gain, offset of a log] for every log.
struct Posterior {
  Status status = Status::ok;
  std::vector<Eigen::VectorXd> mean;
  std::vector<Eigen::MatrixXd> covariance;
};

// Eliminates each log's own parameters, solves for the shared ones, and substitutes back.
inline Posterior combine(const CommonPrior& prior, const std::vector<InformationSum>& logs) {
  const int c = prior.shared();
  const int own = prior.layout.size() - c;
  Eigen::MatrixXd a = prior.information.head(c).asDiagonal();
  Eigen::VectorXd eta = prior.information.head(c).cwiseProduct(prior.mean.head(c));
  std::vector<Eigen::LLT<Eigen::MatrixXd>> factors(logs.size());
  std::vector<Eigen::VectorXd> own_eta(logs.size());
  Posterior out;
  for (std::size_t l = 0; l < logs.size(); ++l) {
    const InformationSum& log = logs[l];
    a += log.matrix.topLeftCorner(c, c);
    eta += log.vector.head(c);
    if (own == 0) continue;
    Eigen::MatrixXd d = log.matrix.bottomRightCorner(own, own);
    d += Eigen::MatrixXd(prior.information.tail(own).asDiagonal());
    own_eta[l] = log.vector.tail(own) + prior.information.tail(own).cwiseProduct(prior.mean.tail(own));
    factors[l].compute(d);
    if (factors[l].info() != Eigen::Success) out.status = Status::not_factorizable;
    a -= log.matrix.topRightCorner(c, own) * factors[l].solve(log.matrix.bottomLeftCorner(own, c));
    eta -= log.matrix.topRightCorner(c, own) * factors[l].solve(own_eta[l]);
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(a);
  if (factor.info() != Eigen::Success) out.status = Status::not_factorizable;
  if (out.status != Status::ok) return out;
  const Eigen::VectorXd shared = factor.solve(eta);
  const Eigen::MatrixXd p = factor.solve(Eigen::MatrixXd::Identity(c, c));
  for (std::size_t l = 0; l < logs.size(); ++l) {
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

// Two estimates of the same gain, `coarse` the efficient one and `fine` with fewer assumptions on the motion:
// the standard normal deviate of d^T (P_fine - P_coarse)^+ d over the directions in which the finer one gives
// up more than 1% of the variance (Hausman's test, docs/method.md).
inline double disagreement(const Posterior& coarse, const Posterior& fine, int gains) {
  const Eigen::MatrixXd pc = coarse.covariance.back().topLeftCorner(gains, gains);
  const Eigen::MatrixXd pf = fine.covariance.back().topLeftCorner(gains, gains);
  const Eigen::VectorXd d = fine.mean.back().head(gains) - coarse.mean.back().head(gains);
  const Eigen::LLT<Eigen::MatrixXd> l(pc);
  const Eigen::MatrixXd half = l.matrixL().solve(pf - pc);
  const Eigen::MatrixXd m = l.matrixL().solve(half.transpose());
  const Eigen::VectorXd z = l.matrixL().solve(d);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(0.5 * (m + m.transpose()));
  GroupStatistics test;
  for (int i = 0; i < gains; ++i) {
    if (eigen.eigenvalues()[i] < 0.01) continue;
    const double e = eigen.eigenvectors().col(i).dot(z);
    test.sum_of_squares += e * e / eigen.eigenvalues()[i];
    test.count += 1.0;
  }
  return test.deviate();
}

}  // namespace truewrench
