// Whole records through `online` and `map`.
#include "truewrench/estimator.hpp"

#include "simulated.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

constexpr double missing = std::numeric_limits<double>::quiet_NaN();

Simulation with_gain(int channels = 6) {
  std::mt19937 random(21);
  Simulation s;
  s.duration = 6.0;
  s.gain = 0.2 * oracle::normal_matrix(random, channels, 6);
  for (int i = 0; i < channels; ++i) s.gain(i, i % 6) += 1.0;
  s.channel = Eigen::VectorXd::LinSpaced(channels, 1.0, 3.0);
  s.offset = 0.05 * oracle::normal_matrix(random, channels, 1);
  return s;
}

CommonPrior prior_of(const Simulation& s, bool pooled = false) {
  const int n = static_cast<int>(s.channel.size());
  CommonPrior prior;
  prior.layout.channels = n;
  prior.layout.offset = true;
  prior.layout.pool_offsets = pooled;
  prior.mean.setZero(7 * n);
  for (int i = 0; i < n; ++i) prior.mean[6 * i + i % 6] = 1.0;
  prior.information.setConstant(7 * n, 1.0 / (0.3 * 0.3));
  prior.information.tail(n).setConstant(1.0 / (0.1 * 0.1));
  return prior;
}

enum class Method { online, map };

template <int N>
Estimate estimate(Method method, const Simulation& s, const std::vector<Recording>& recordings,
                  int threads = 1, const CommonPrior* prior = nullptr) {
  std::vector<LogData> logs;
  logs.reserve(recordings.size());
  for (const Recording& r : recordings) logs.push_back(r.data());
  EstimatorSettings settings;
  settings.threads = threads;
  Estimator<N> estimator(std::move(logs), s.sensor<N>(), prior != nullptr ? *prior : prior_of(s), settings);
  return method == Method::map ? estimator.map() : estimator.online();
}

// Squared error of gain and offset in units of the claimed covariance, per parameter.
double nees(const Estimate& e, const Simulation& s) {
  const Eigen::VectorXd d = e.posterior.mean.back() - s.theta();
  return d.dot(e.posterior.covariance.back().llt().solve(d)) / static_cast<double>(d.size());
}

TEST(ParallelFor, DoesEveryItemOnce) {
  for (const std::size_t count : {0U, 1U, 3U, 1000U}) {
    for (const int threads : {0, 1, 2, 5, 17}) {
      std::vector<std::atomic<int>> done(count);
      parallel_for(count, threads, [&](std::size_t i) { ++done[i]; });
      for (const auto& d : done) EXPECT_EQ(d.load(), 1);
    }
  }
}

class Methods : public testing::TestWithParam<Method> {};
INSTANTIATE_TEST_SUITE_P(Estimator, Methods, testing::Values(Method::online, Method::map));

TEST_P(Methods, RecoverGainAndOffsetAsWellAsTheyClaim) {
  const Simulation s = with_gain();
  double sum = 0.0;
  for (unsigned seed = 0; seed < 6; ++seed) {
    const std::vector<Recording> recordings{s.record(seed)};
    const Estimate e = estimate<6>(GetParam(), s, recordings);
    ASSERT_EQ(e.status, Status::ok);
    EXPECT_TRUE(e.converged);
    EXPECT_LT(nees(e, s), 2.5);
    sum += nees(e, s) / 6.0;
    EXPECT_LT(e.posterior.covariance.back().diagonal().head(36).cwiseSqrt().maxCoeff(), 0.03);
  }
  // chi-square with 6 x 42 degrees of freedom, 99.8%: 0.74 ... 1.30
  EXPECT_GT(sum, 0.71);
  EXPECT_LT(sum, 1.33);
}

TEST_P(Methods, ChannelsCountedAtRunTimeGiveTheSameAsSixAtCompileTime) {
  const Simulation s = with_gain();
  const std::vector<Recording> recordings{s.record(1)};
  const Estimate fixed = estimate<6>(GetParam(), s, recordings);
  const Estimate dynamic = estimate<Eigen::Dynamic>(GetParam(), s, recordings);
  EXPECT_LT((fixed.posterior.mean[0] - dynamic.posterior.mean[0]).norm(), 1e-8);
  EXPECT_LT((fixed.posterior.covariance[0] - dynamic.posterior.covariance[0]).norm(),
            1e-6 * fixed.posterior.covariance[0].norm());
}

TEST_P(Methods, SameBitsForAnyNumberOfThreads) {
  Simulation s = with_gain(8);
  s.duration = 4.0;
  std::vector<Recording> recordings{s.record(1)};
  s.begin = 3.0;
  recordings.push_back(s.record(2));
  const Estimate one = estimate<Eigen::Dynamic>(GetParam(), s, recordings, 1);
  for (const int threads : {2, 5}) {
    const Estimate many = estimate<Eigen::Dynamic>(GetParam(), s, recordings, threads);
    for (std::size_t l = 0; l < 2; ++l) {
      EXPECT_TRUE((one.posterior.mean[l].array() == many.posterior.mean[l].array()).all());
      EXPECT_TRUE((one.posterior.covariance[l].array() == many.posterior.covariance[l].array()).all());
      EXPECT_TRUE((one.wrench[l].array() == many.wrench[l].array() ||
                   (one.wrench[l].array().isNaN() && many.wrench[l].array().isNaN()))
                      .all());
    }
    EXPECT_EQ(one.windows.size(), many.windows.size());
  }
}

TEST_P(Methods, EightGaugesAreHonestToo) {
  const Simulation s = with_gain(8);
  double sum = 0.0;
  for (unsigned seed = 0; seed < 4; ++seed) {
    const std::vector<Recording> recordings{s.record(seed)};
    sum += nees(estimate<Eigen::Dynamic>(GetParam(), s, recordings), s) / 4.0;
  }
  // chi-square with 4 x 56 degrees of freedom, 99.8%: 0.73 ... 1.32
  EXPECT_GT(sum, 0.70);
  EXPECT_LT(sum, 1.35);
}

TEST_P(Methods, NoWindowSpansAGap) {
  Simulation s = with_gain();
  Recording r = s.record(3);
  // The motion is not logged from 2 to 3 s, the sensor not from 4 to 4.5 s.
  const auto drop = [](std::vector<double>& time, RowMatrix& rows, double from, double to) {
    std::vector<double> t;
    RowMatrix kept(rows.rows(), rows.cols());
    for (std::size_t k = 0; k < time.size(); ++k) {
      if (time[k] > from && time[k] < to) continue;
      kept.row(static_cast<Eigen::Index>(t.size())) = rows.row(static_cast<Eigen::Index>(k));
      t.push_back(time[k]);
    }
    rows = kept.topRows(static_cast<Eigen::Index>(t.size()));
    time = std::move(t);
  };
  drop(r.motion_time, r.twist, 2.0, 3.0);
  drop(r.sensor_time, r.raw, 4.0, 4.5);
  const Estimate e = estimate<6>(GetParam(), s, {r});
  ASSERT_EQ(e.status, Status::ok);
  for (const WindowReport& w : e.windows) {
    EXPECT_TRUE(w.end <= 2.01 || w.begin >= 2.99) << w.begin << " ... " << w.end;
    EXPECT_TRUE(w.end <= 4.01 || w.begin >= 4.49) << w.begin << " ... " << w.end;
  }
  EXPECT_LT(nees(e, s), 2.0);
  // The wrench is told where the motion is known, and only there.
  for (std::size_t k = 0; k < r.sensor_time.size(); ++k) {
    const bool known = !e.wrench[0].row(static_cast<Eigen::Index>(k)).hasNaN();
    if (r.sensor_time[k] > 2.01 && r.sensor_time[k] < 2.99) {
      EXPECT_FALSE(known);
    }
    if (r.sensor_time[k] < 1.9) {
      EXPECT_TRUE(known);
    }
  }
}

TEST_P(Methods, WrenchIsToldWhereAWindowFitsAndNoSampleIsLeftOut) {
  const Simulation s = with_gain();
  for (unsigned seed = 0; seed < 4; ++seed) {
    Recording r = s.record(seed);
    // Contacts; the first takes the first window of `online`, which then begins elsewhere.
    for (const auto& [begin, end] :
         {std::pair(0.0, 0.5), std::pair(2.1, 2.2 + 0.1 * seed), std::pair(4.0, 4.2)}) {
      for (std::size_t k = 0; k < r.sensor_time.size(); ++k) {
        const double phase = (r.sensor_time[k] - begin) / (end - begin);
        if (phase < 0.0 || phase > 1.0) continue;
        r.raw.row(static_cast<Eigen::Index>(k)).array() += 0.03 * std::sin(3.0 * phase);
      }
    }
    const Estimate e = estimate<6>(GetParam(), s, {r});
    ASSERT_EQ(e.status, Status::ok);
    int told = 0;
    for (std::size_t k = 0; k < r.sensor_time.size(); ++k) {
      const double t = r.sensor_time[k];
      const bool fitted = std::any_of(e.windows.begin(), e.windows.end(), [&](const WindowReport& w) {
        return w.status == WindowStatus::fitted && w.begin <= t && (t < w.end || &w == &e.windows.back());
      });
      const bool known = !e.wrench[0].row(static_cast<Eigen::Index>(k)).hasNaN();
      EXPECT_EQ(known, fitted && e.gates[0].wrench[k] == 0) << "seed " << seed << " at " << t << " s";
      told += known;
    }
    EXPECT_GT(told, 100);
  }
}

TEST_P(Methods, StreamsOfDifferentRatesNeedNoCommonStamps) {
  Simulation s = with_gain();
  s.motion_rate = 90.0;
  s.sensor_rate = 410.0;
  const Estimate e = estimate<6>(GetParam(), s, {s.record(5)});
  ASSERT_EQ(e.status, Status::ok);
  EXPECT_LT(nees(e, s), 2.0);
  s.motion_rate = 400.0;
  s.sensor_rate = 60.0;
  EXPECT_LT(nees(estimate<6>(GetParam(), s, {s.record(6)}), s), 2.0);
}

TEST_P(Methods, MissingCellsLeaveOutTheirOwnResidualAlone) {
  const Simulation s = with_gain();
  Recording r = s.record(7);
  std::mt19937 random(8);
  std::uniform_int_distribution<Eigen::Index> row(0, r.raw.rows() - 1);
  std::uniform_int_distribution<Eigen::Index> column(0, 5);
  for (int k = 0; k < 100; ++k) {
    r.raw(row(random), column(random)) = missing;
    r.twist(row(random), column(random)) = missing;
  }
  const Estimate e = estimate<6>(GetParam(), s, {r});
  ASSERT_EQ(e.status, Status::ok);
  EXPECT_LT(nees(e, s), 2.0);
}

TEST(Estimator, StartOfTheClockDoesNotMatter) {
  Simulation s = with_gain();
  const Estimate at_zero = estimate<6>(Method::map, s, {s.record(9)});
  Recording later = s.record(9);
  for (double& t : later.motion_time) t += 1024.0;
  for (double& t : later.sensor_time) t += 1024.0;
  const Estimate at_1024 = estimate<6>(Method::map, s, {later});
  EXPECT_LT((at_zero.posterior.mean[0] - at_1024.posterior.mean[0]).norm(), 1e-6);
}

TEST(Estimator, LogsPooledShareTheGainAndKeepTheirOffsets) {
  Simulation s = with_gain();
  std::vector<Recording> recordings;
  std::vector<Eigen::VectorXd> truth;
  std::mt19937 random(10);
  for (unsigned l = 0; l < 3; ++l) {
    s.offset = 0.05 * oracle::normal_matrix(random, 6, 1);
    s.begin = 2.0 * l;
    recordings.push_back(s.record(30 + l));
    truth.push_back(s.offset);
  }
  const Estimate single = estimate<6>(Method::map, s, {recordings[0]});
  for (const Method method : {Method::map, Method::online}) {
    const Estimate e = estimate<6>(method, s, recordings);
    ASSERT_EQ(e.posterior.mean.size(), 3U);
    for (std::size_t l = 0; l < 3; ++l) {
      EXPECT_EQ(e.posterior.mean[l].head(36), e.posterior.mean[0].head(36));
      const Eigen::VectorXd sigma = e.posterior.covariance[l].diagonal().tail(6).cwiseSqrt();
      EXPECT_LT((e.posterior.mean[l].tail(6) - truth[l]).cwiseQuotient(sigma).cwiseAbs().maxCoeff(), 4.0);
    }
    const double gain_variance = e.posterior.covariance[0].diagonal().head(36).sum();
    const double alone = single.posterior.covariance[0].diagonal().head(36).sum();
    EXPECT_NEAR(alone / gain_variance, 3.0, 0.6);
  }
}

TEST(Estimator, MapGoesOnFromWhatOnlineFinds) {
  const Simulation s = with_gain();
  const Recording recording = s.record(5);
  const auto estimator = [&] {
    EstimatorSettings settings;
    settings.threads = 1;
    return Estimator<6>({recording.data()}, s.sensor<6>(), prior_of(s), settings);
  };
  const Estimate cold = estimator().map();
  const Estimate online = estimator().online();
  const Estimate warm = estimator().map({online.posterior.mean, online.posterior.covariance, online.spacing});
  ASSERT_EQ(warm.status, Status::ok);
  EXPECT_TRUE(warm.converged);
  EXPECT_LT(warm.iterations, cold.iterations);
  const Eigen::VectorXd sigma = cold.posterior.covariance[0].diagonal().cwiseSqrt();
  const Eigen::VectorXd apart = (warm.posterior.mean[0] - cold.posterior.mean[0]).cwiseQuotient(sigma);
  EXPECT_LT(apart.cwiseAbs().maxCoeff(), 0.3);
}

TEST(Estimator, OneOffsetForAllLogsIsKnownBetterThanOneEach) {
  const Simulation s = with_gain();
  const std::vector<Recording> recordings{s.record(1), s.record(2)};
  const CommonPrior pooled = prior_of(s, true);
  const Estimate each = estimate<6>(Method::map, s, recordings);
  const Estimate one = estimate<6>(Method::map, s, recordings, 1, &pooled);
  EXPECT_EQ(one.posterior.mean[0], one.posterior.mean[1]);
  EXPECT_LT(one.posterior.covariance[0].diagonal().tail(6).sum(),
            each.posterior.covariance[0].diagonal().tail(6).sum());
  EXPECT_LT(nees(one, s), 2.0);
}

TEST(Estimator, OnlineGainOnlyGetsSurer) {
  const Simulation s = with_gain();
  const Estimate e = estimate<6>(Method::online, s, {s.record(11)});
  ASSERT_GT(e.history.size(), 3U);
  for (std::size_t k = 1; k < e.history.size(); ++k) {
    EXPECT_GT(e.history[k].time, e.history[k - 1].time);
    EXPECT_TRUE((e.history[k].sigma.array() <= e.history[k - 1].sigma.array() * (1.0 + 1e-9)).all());
  }
}

TEST(Estimator, OnlyAPriorIsLeftOfALogThatIsTooShort) {
  Simulation s = with_gain();
  s.duration = 0.05;
  for (const Method method : {Method::map, Method::online}) {
    const Estimate e = estimate<6>(method, s, {s.record(12)});
    ASSERT_EQ(e.status, Status::ok);
    for (const WindowReport& w : e.windows) EXPECT_NE(w.status, WindowStatus::fitted);
    EXPECT_LT((e.posterior.mean[0] - prior_of(s).mean).norm(), 1e-9);
  }
}

}  // namespace
}  // namespace truewrench
