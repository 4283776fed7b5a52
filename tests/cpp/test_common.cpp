// How logs add up, against one dense problem in all their unknowns.
#include "truewrench/knots.hpp"

#include "oracles.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

constexpr int n = 6;
constexpr int gains = 36;

CommonPrior prior_of(bool offset, bool pooled) {
  std::mt19937 random(1);
  CommonPrior prior;
  prior.layout.channels = n;
  prior.layout.offset = offset;
  prior.layout.pool_offsets = pooled;
  prior.mean = oracle::normal_matrix(random, prior.layout.size(), 1);
  prior.information = oracle::normal_matrix(random, prior.layout.size(), 1).cwiseAbs2().array() + 0.1;
  return prior;
}

struct Measured {
  Eigen::MatrixXd jacobian;  // of [gain, offset of the log]
  Eigen::VectorXd value;
};

// Linear measurements of the parameters of a log, whitened; fewer than there are unknowns.
std::vector<Measured> measurements(int size, int logs, int rows) {
  std::mt19937 random(2);
  std::vector<Measured> out;
  out.reserve(static_cast<std::size_t>(logs));
  for (int l = 0; l < logs; ++l) {
    out.push_back({oracle::normal_matrix(random, rows, size), oracle::normal_matrix(random, rows, 1)});
  }
  return out;
}

// As windows report them: linearised at some theta, in two parts.
std::vector<InformationSum> summed(const std::vector<Measured>& logs, int size) {
  std::mt19937 random(3);
  std::vector<InformationSum> out;
  for (const Measured& log : logs) {
    InformationSum sum(size);
    for (const bool first : {true, false}) {
      const Eigen::Index half = log.jacobian.rows() / 2;
      const Eigen::MatrixXd j =
          first ? log.jacobian.topRows(half) : log.jacobian.bottomRows(log.jacobian.rows() - half);
      const Eigen::VectorXd y = first ? log.value.head(half) : log.value.tail(log.value.size() - half);
      const Eigen::VectorXd theta = oracle::normal_matrix(random, size, 1);
      sum.add({j.transpose() * j, j.transpose() * (y - j * theta)}, theta);
    }
    out.push_back(sum);
  }
  return out;
}

class Pooling : public testing::TestWithParam<std::tuple<bool, bool, int>> {};

TEST_P(Pooling, EqualsOneDenseProblemInAllUnknowns) {
  const auto [offset, pooled, count] = GetParam();
  const CommonPrior prior = prior_of(offset, pooled);
  const int size = prior.layout.size();
  const int shared = offset && !pooled ? gains : size;
  const int own = size - shared;
  const std::vector<Measured> logs = measurements(size, count, 31);

  const int all = shared + own * count;
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(all, all);
  Eigen::VectorXd vector = Eigen::VectorXd::Zero(all);
  information.diagonal().head(shared) = prior.information.head(shared);
  vector.head(shared) = prior.information.head(shared).cwiseProduct(prior.mean.head(shared));
  std::vector<Eigen::MatrixXd> select;
  for (int l = 0; l < count; ++l) {
    Eigen::MatrixXd s = Eigen::MatrixXd::Zero(size, all);
    s.topLeftCorner(shared, shared).setIdentity();
    s.block(shared, shared + own * l, own, own).setIdentity();
    const Measured& log = logs[static_cast<std::size_t>(l)];
    const Eigen::MatrixXd j = log.jacobian * s;
    information += j.transpose() * j;
    vector += j.transpose() * log.value;
    information.diagonal().segment(shared + own * l, own) += prior.information.tail(own);
    vector.segment(shared + own * l, own) += prior.information.tail(own).cwiseProduct(prior.mean.tail(own));
    select.push_back(s);
  }
  const Eigen::MatrixXd covariance = information.inverse();
  const Eigen::VectorXd mean = covariance * vector;

  const Posterior found = combine(prior, summed(logs, size));
  ASSERT_EQ(found.status, Status::ok);
  ASSERT_EQ(found.mean.size(), static_cast<std::size_t>(count));
  for (std::size_t l = 0; l < found.mean.size(); ++l) {
    EXPECT_LT((found.mean[l] - select[l] * mean).norm(), 1e-9 * mean.norm());
    const Eigen::MatrixXd expected = select[l] * covariance * select[l].transpose();
    EXPECT_LT((found.covariance[l] - expected).norm(), 1e-9 * expected.norm());
    EXPECT_EQ(found.covariance[l], found.covariance[l].transpose());
  }
}

INSTANTIATE_TEST_SUITE_P(Common, Pooling,
                         testing::Values(std::tuple(true, false, 1), std::tuple(true, false, 4),
                                         std::tuple(true, true, 4), std::tuple(false, false, 3)));

class Walking : public testing::TestWithParam<std::tuple<bool, int>> {};

TEST_P(Walking, LinkedLogsEqualOneDenseProblemWithStepsBetweenThem) {
  const auto [gains_walk, unlinked] = GetParam();
  constexpr int count = 5;
  std::mt19937 random(5);
  CommonPrior prior = prior_of(true, false);
  prior.layout.payload = true;
  prior.layout.time_offset = true;
  const int size = prior.layout.size();
  prior.mean = oracle::normal_matrix(random, size, 1);
  prior.information = oracle::normal_matrix(random, size, 1).cwiseAbs2().array() + 0.1;
  prior.payload_of = {1, 1, 0, 1, 1};
  for (int k = 0; k < 2; ++k) {
    prior.payload_information.push_back(
        oracle::normal_matrix(random, kPayloadParameters, 1).cwiseAbs2().array() + 0.1);
  }
  prior.gains_walk = gains_walk;
  for (int l = 0; l < count; ++l) {
    Eigen::VectorXd link;
    if (l > 0 && l != unlinked) {
      link = oracle::normal_matrix(random, size, 1).cwiseAbs2().array() + 0.5;
      if (l == 1) link.tail(1).setZero();  // a clock that starts anew
    }
    prior.links.push_back(link);
  }
  const std::vector<Measured> logs = measurements(size, count, 31);

  // Everything in one vector: [gains, payload 0, payload 1 | what each log has of its own].
  std::vector<int> own;
  for (int i = 0; i < size; ++i) {
    if (i >= prior.layout.offset_begin() || (gains_walk && i < gains)) own.push_back(i);
  }
  const int shared = (gains_walk ? 0 : gains) + 2 * kPayloadParameters;
  const int m = static_cast<int>(own.size());
  const int all = shared + m * count;
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(all, all);
  Eigen::VectorXd vector = Eigen::VectorXd::Zero(all);
  const auto believe = [&](const Eigen::VectorXd& row, double value, double weight) {
    information += weight * row * row.transpose();
    vector += weight * value * row;
  };
  const auto unit = [&](int at) { return Eigen::VectorXd(Eigen::VectorXd::Unit(all, at)); };
  if (!gains_walk) {
    for (int i = 0; i < gains; ++i) believe(unit(i), prior.mean[i], prior.information[i]);
  }
  for (int k = 0; k < 2; ++k) {
    for (int i = 0; i < kPayloadParameters; ++i) {
      const int at = shared - (2 - k) * kPayloadParameters + i;
      believe(unit(at), 0.0, prior.payload_information[static_cast<std::size_t>(k)][i]);
    }
  }
  std::vector<Eigen::MatrixXd> select;
  for (int l = 0; l < count; ++l) {
    const auto k = static_cast<std::size_t>(l);
    Eigen::MatrixXd s = Eigen::MatrixXd::Zero(size, all);
    if (!gains_walk) s.topLeftCorner(gains, gains).setIdentity();
    for (int i = 0; i < kPayloadParameters; ++i) {
      s(gains + i, shared - (2 - prior.payload_of[k]) * kPayloadParameters + i) = 1.0;
    }
    for (int q = 0; q < m; ++q) {
      const int at = shared + m * l + q;
      s(own[static_cast<std::size_t>(q)], at) = 1.0;
      const int i = own[static_cast<std::size_t>(q)];
      const double link = prior.links[k].size() > 0 ? prior.links[k][i] : 0.0;
      if (link > 0.0) {
        believe(unit(at) - unit(at - m), 0.0, link);
      } else {
        believe(unit(at), prior.mean[i], prior.information[i]);
      }
    }
    const Eigen::MatrixXd j = logs[k].jacobian * s;
    information += j.transpose() * j;
    vector += j.transpose() * logs[k].value;
    select.push_back(s);
  }
  const Eigen::MatrixXd covariance = information.inverse();
  const Eigen::VectorXd mean = covariance * vector;

  const Posterior found = combine(prior, summed(logs, size));
  ASSERT_EQ(found.status, Status::ok);
  for (std::size_t l = 0; l < found.mean.size(); ++l) {
    EXPECT_LT((found.mean[l] - select[l] * mean).norm(), 1e-9 * mean.norm());
    const Eigen::MatrixXd expected = select[l] * covariance * select[l].transpose();
    EXPECT_LT((found.covariance[l] - expected).norm(), 1e-9 * expected.norm());
  }
}

INSTANTIATE_TEST_SUITE_P(Common, Walking, testing::Combine(testing::Bool(), testing::Values(0, 3)));

TEST(Common, ParametersThatNothingDeterminesAreReported) {
  CommonPrior prior = prior_of(true, false);
  prior.information.setZero();
  EXPECT_EQ(combine(prior, summed(measurements(42, 2, 5), 42)).status, Status::not_factorizable);
}

Posterior gains_of(const Eigen::MatrixXd& covariance, const Eigen::VectorXd& mean) {
  Posterior p;
  p.mean.push_back(mean);
  p.covariance.push_back(covariance);
  return p;
}

TEST(Common, EqualEstimatesDoNotDisagree) {
  const Posterior p = gains_of(Matrix6::Identity(), Vector6::Ones());
  EXPECT_LE(disagreement(p, p, 6), 0.0);
}

TEST(Common, DisagreementIsTheChiSquareDeviateOverDirectionsThatTheFinerOneGivesUp) {
  // Variances 1 and 1 + k: the difference of the two estimates has the covariance k in three of six
  // directions.
  Matrix6 fine = Matrix6::Identity();
  fine.diagonal() << 1.5, 1.02, 3.0, 1.0, 1.0, 1.005;
  const Posterior coarse = gains_of(Matrix6::Identity(), Vector6::Zero());
  Vector6 d;
  // 99.9% of chi-square with three degrees of freedom is 16.27; nothing in directions without lost
  // information counts.
  d << std::sqrt(0.5 * 16.27 / 3.0), std::sqrt(0.02 * 16.27 / 3.0), -std::sqrt(2.0 * 16.27 / 3.0), 0.0, 0.0,
      0.0;
  EXPECT_NEAR(disagreement(coarse, gains_of(fine, d), 6), 3.09, 0.1);
  d.tail<3>() << 0.5, -0.5, 0.5;
  EXPECT_NEAR(disagreement(coarse, gains_of(fine, d), 6), 3.09, 0.1);
}

TEST(Common, DisagreementDoesNotDependOnTheUnitsOfTheGain) {
  std::mt19937 random(4);
  const Eigen::MatrixXd root = oracle::normal_matrix(random, 6, 6);
  const Eigen::MatrixXd extra = oracle::normal_matrix(random, 6, 2);
  const Eigen::MatrixXd coarse = root * root.transpose();
  const Eigen::MatrixXd fine = coarse + extra * extra.transpose();
  const Eigen::VectorXd d = 2.0 * extra * oracle::normal_matrix(random, 2, 1);
  const Eigen::MatrixXd unit = oracle::normal_matrix(random, 6, 6);
  const double once = disagreement(gains_of(coarse, Vector6::Zero()), gains_of(fine, d), 6);
  const double again = disagreement(gains_of(unit * coarse * unit.transpose(), Vector6::Zero()),
                                    gains_of(unit * fine * unit.transpose(), unit * d), 6);
  EXPECT_NEAR(once, again, 1e-6);
  EXPECT_GT(once, 0.0);
}

TEST(Common, OffsetsTakeNoPartInTheDisagreementOfTheGain) {
  Eigen::MatrixXd coarse = Eigen::MatrixXd::Identity(8, 8);
  Eigen::MatrixXd fine = 2.0 * coarse;
  Eigen::VectorXd d = Eigen::VectorXd::Zero(8);
  d.tail<2>().setConstant(100.0);
  EXPECT_LT(disagreement(gains_of(coarse, Eigen::VectorXd::Zero(8)), gains_of(fine, d), 6), 0.0);
}

TEST(Common, ChanceDifferencesGiveAStandardNormalDeviate) {
  std::mt19937 random(5);
  const Eigen::MatrixXd extra = oracle::normal_matrix(random, 36, 20);
  const Eigen::MatrixXd coarse = Eigen::MatrixXd::Identity(36, 36);
  const Eigen::MatrixXd fine = coarse + 0.1 * extra * extra.transpose();
  double sum = 0.0;
  double square = 0.0;
  for (int i = 0; i < 200; ++i) {
    const Eigen::VectorXd d = std::sqrt(0.1) * extra * oracle::normal_matrix(random, 20, 1);
    const double z = disagreement(gains_of(coarse, Eigen::VectorXd::Zero(36)), gains_of(fine, d), 36);
    sum += z / 200.0;
    square += z * z / 200.0;
  }
  EXPECT_NEAR(sum, 0.0, 0.25);
  EXPECT_NEAR(std::sqrt(square), 1.0, 0.2);
}

}  // namespace
}  // namespace truewrench
