// The estimator of a control loop: honest, the same as that of the whole record, and never at a loss.
#include "incremental_case.hpp"
#include "truewrench/estimation/corrector_of.hpp"
#include "whole_record.hpp"

#include <gtest/gtest.h>

#include <limits>

namespace truewrench {
namespace {

const IncrementalSettings settings{.rate = LoopCase::motion_rate, .discrepancy = 0.0};

// Error of a gain over its covariance, by the degrees of freedom.
double nees(const Eigen::MatrixXd& found, const Eigen::MatrixXd& truth, const Eigen::MatrixXd& covariance) {
  const RowMatrix error = found - truth;
  const Eigen::Map<const Eigen::VectorXd> e(error.data(), error.size());
  return e.dot(covariance.ldlt().solve(e)) / static_cast<double>(e.size());
}

TEST(Incremental, ErrorsAreAsLargeAsItSays) {
  double sum = 0.0, rms = 0.0;
  constexpr int seeds = 8;
  for (unsigned seed = 0; seed < seeds; ++seed) {
    LoopCase loop(seed);
    Incremental online(loop.rig, loop.about, settings);
    ASSERT_EQ(loop.feed(online, 15.0), Status::ok);
    ASSERT_EQ(online.finish(), Status::ok);
    ASSERT_TRUE(online.ready());
    EXPECT_FALSE(online.unresolved());
    sum += nees(online.gain(), loop.gain, online.covariance()) / seeds;
    rms += (online.gain() - loop.gain).norm() / 6.0 / seeds;
    EXPECT_LT((online.offset() - loop.offset).norm(), 1e-3);
  }
  // chi-square of 8 x 36 degrees of freedom, 99.8 %
  EXPECT_GT(sum, 0.76);
  EXPECT_LT(sum, 1.28);
  EXPECT_LT(rms, 0.002);
}

TEST(Incremental, EndsWhereTheWholeRecordDoes) {
  LoopCase loop(3);
  Incremental online(loop.rig, loop.about, settings);
  RecordedLog whole = loop.about;
  std::vector<double> time[2];
  std::vector<Vector6> value[2];
  loop.run(15.0, [&](bool sensor, double t, const Vector6& v) {
    static_cast<void>(sensor ? online.push_raw(t, v.data()) : online.push_motion(0, t, v.data()));
    time[sensor ? 1 : 0].push_back(t);
    value[sensor ? 1 : 0].push_back(v);
  });
  ASSERT_EQ(online.finish(), Status::ok);
  const auto take = [](const std::vector<double>& t, const std::vector<Vector6>& v, Eigen::VectorXd& at,
                       RowMatrix& rows) {
    at = Eigen::Map<const Eigen::VectorXd>(t.data(), static_cast<Eigen::Index>(t.size()));
    rows.resize(at.size(), 6);
    for (std::size_t k = 0; k < v.size(); ++k) rows.row(static_cast<Eigen::Index>(k)) = v[k].transpose();
  };
  take(time[0], value[0], whole.motion[0].time, whole.motion[0].value);
  take(time[1], value[1], whole.time, whole.raw);
  const WholeRecord map = of_whole_record(loop.rig, whole);
  ASSERT_EQ(map.status, Status::ok);
  const Eigen::Map<const RowMatrix> found = online.gain();
  const Eigen::VectorXd &a = map.sigma, b = online.covariance().diagonal().cwiseSqrt();
  double apart = 0.0;  // in sigma
  for (int i = 0; i < 36; ++i) {
    apart += std::pow((found(i / 6, i % 6) - map.gain(i / 6, i % 6)) / a[i], 2.0) / 36.0;
    EXPECT_NEAR(b[i], a[i], 0.06 * a[i]) << i;
  }
  EXPECT_LT(std::sqrt(apart), 0.1);
}

// Blocks that come are eliminated at a theta that is known: the coefficients are those that belong to it where H_xt is carried along.
TEST(Incremental, KnowsThetaAsOneWhoFindsIt) {
  LoopCase loop(3);
  constexpr double h = 0.05;
  constexpr long blocks = 6;
  Lag known(loop.rig, loop.about, blocks + 1, 64);
  Ring<RawSample> raw;
  Ring<MotionSample> motion;
  raw.reserve(1000);
  motion.reserve(1000);
  loop.run(kBlock * blocks * h, [&](bool sensor, double t, const Vector6& value) {
    if (sensor) {
      RawSample& s = raw.push();
      s = RawSample();
      s.time = t;
      std::copy_n(value.data(), 6, s.value.begin());
    } else {
      MotionSample& s = motion.push();
      s.time = t;
      std::copy_n(value.data(), 6, s.value.begin());
    }
    return Status::ok;
  });
  known.place(0.0, h);
  long raw_at = 0, motion_at = 0;
  for (long at = 0; at < kBlock * blocks; ++at) {
    const long raw_from = raw_at, motion_from = motion_at;
    const double end = h * static_cast<double>(at + 1);
    while (raw_at < raw.end() && raw[raw_at].time < end) ++raw_at;
    while (motion_at < motion.end() && motion[motion_at].time < end) ++motion_at;
    known.take(at, raw, raw_from, raw_at, [](double, double) {});
    known.take(0, motion, motion_from, motion_at);
  }
  known.theta += 0.01 * oracle::normal_matrix(loop.random, known.parameters(), 1);
  Lag found = known;
  Front front = found.make_front(), moving = known.make_moving();
  for (long g = 0; g < blocks; ++g) {
    const bool last = g + 1 == blocks;
    known.expect(moving, g, last);
    known.predict(g);
    known.reweigh(g);
    for (const long b : {g, g + 1}) found.block(b).x = known.block(b).x;
    found.predict(g);
    found.reweigh(g);
    ASSERT_TRUE(known.join(moving, g));
    ASSERT_TRUE(found.eliminate(front, g, g + 1, last));
    known.grow();
    found.grow();
  }
  Eigen::MatrixXd Z = Eigen::MatrixXd::Zero(found.parameters() + 1, found.parameters() + 1);
  ASSERT_TRUE(known.terminal(moving));
  ASSERT_TRUE(std::isfinite(found.terminal(front, Z)));
  known.back(0);
  found.back(0);
  for (long g = 0; g <= blocks; ++g)
    EXPECT_LT((known.block(g).x - found.block(g).x).norm(), 1e-7 * (1.0 + found.block(g).x.norm()));
  // and of the front that is carried along: its upper triangle, the information vector after it
  Front carried = known.make_moving();
  found.know_theta(front, carried);
  const std::size_t ld = carried.panel.size() / kWidth;
  for (std::size_t i = 0; i < kWidth; ++i)
    for (std::size_t j = i; j < ld; ++j) {
      const double expected = moving.panel[i * ld + j];
      EXPECT_NEAR(carried.panel[i * ld + j], expected, 1e-7 * (1.0 + std::abs(expected)));
    }
  // in one go, the gradient turned once, as one by one
  Front one = found.make_front(), all = found.make_front();
  for (long g = 0; g < blocks; ++g) ASSERT_TRUE(found.eliminate(one, g, g + 1, g + 1 == blocks));
  ASSERT_TRUE(found.eliminate(all, 0, blocks, true));
  Eigen::MatrixXd whole = Z;
  EXPECT_NEAR(found.terminal(one, Z), found.terminal(all, whole), 1e-9);
  EXPECT_LT((whole - Z).norm(), 1e-9 * Z.norm());
}

// Logs of one sensor and payload, the last with a channel that reads `more` of itself: p of (10.11), and the noise found in it.
std::pair<double, double> last_of_logs(unsigned seed, int logs, double more) {
  LoopCase loop(seed);
  Incremental online(loop.rig, loop.about, settings);
  for (int k = 0; k < logs; ++k) {
    if (k > 0) {
      EXPECT_EQ(online.next_log(loop.about), Status::ok);
      loop.offset = 0.1 * oracle::normal_matrix(loop.random, 6, 1);
    }
    if (k + 1 == logs) loop.gain.row(0) *= 1.0 + more;
    EXPECT_EQ(loop.feed(online, 8.0), Status::ok);
    EXPECT_EQ(online.finish(), Status::ok);
  }
  online.covariance();
  return {online.agreement_with_logs_before().p, online.sizes().raw_factor.minCoeff()};
}

TEST(Incremental, KnowsALogOfAnotherGain) {
  int below = 0;
  constexpr int seeds = 12;
  for (unsigned seed = 0; seed < seeds; ++seed) {
    const auto [p, factor] = last_of_logs(seed, 3, 0.0);
    below += p < 0.1 ? 1 : 0;
    EXPECT_GT(factor, 0.9) << seed;  // what was known before takes no rows
  }
  EXPECT_LE(below, 5);  // 1 in 1,800 by chance
  EXPECT_LT(last_of_logs(1, 2, 0.01).first, 1e-6);
  EXPECT_LT(last_of_logs(1, 3, 0.01).first, 1e-6);
  EXPECT_EQ(last_of_logs(1, 1, 0.0).first, 1.0);  // of a single log there is nothing to ask
}

TEST(Incremental, SaysWhatItDoesNotTake) {
  LoopCase loop(0);
  Incremental online(loop.rig, loop.about, settings);
  const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  const Vector6 value = Vector6::Constant(0.01), nothing = Vector6::Constant(nan),
                endless = Vector6::Constant(inf);
  EXPECT_EQ(online.push_motion(1, 0.0, value.data()), Status::wrong_size);
  EXPECT_EQ(online.push_motion(0, nan, value.data()), Status::not_finite);
  EXPECT_EQ(online.push_motion(0, 0.0, nothing.data()), Status::not_finite);
  EXPECT_EQ(online.push_raw(0.0, endless.data()), Status::not_finite);
  EXPECT_EQ(online.push_raw(inf, value.data()), Status::not_finite);
  EXPECT_EQ(online.push_raw(1.0, value.data()), Status::ok);
  EXPECT_EQ(online.push_raw(1.0, value.data()), Status::not_increasing);
  EXPECT_EQ(online.push_raw(0.5, value.data()), Status::not_increasing);
  EXPECT_FALSE(online.ready());
  EXPECT_EQ(online.gain(), loop.rig.nominal);
}

TEST(Incremental, CorrectsAsWellAsItSays) {
  LoopCase loop(5);
  Incremental online(loop.rig, loop.about, settings);
  Corrector<6> corrector;
  const Vector6 scale = Vector6::LinSpaced(1.0, 6.0);
  EXPECT_EQ(configure(corrector, online, scale), Status::not_configured);
  ASSERT_EQ(loop.feed(online, 12.0), Status::ok);
  ASSERT_EQ(online.finish(), Status::ok);
  EXPECT_EQ(configure(corrector, online, Eigen::VectorXd::Ones(5)), Status::wrong_size);
  Corrector<8> of_eight;
  EXPECT_EQ(configure(of_eight, online, scale), Status::wrong_size);
  EXPECT_FALSE(of_eight.configured());
  ASSERT_EQ(configure(corrector, online, scale), Status::ok);
  double squares = 0.0;
  constexpr int samples = 500;
  for (int k = 0; k < samples; ++k) {
    const Vector6 w = 0.2 * oracle::normal_matrix(loop.random, 6, 1);  // of range
    const Vector6 noise = LoopCase::noise * oracle::normal_matrix(loop.random, 6, 1);
    const Vector6 raw = scale.cwiseProduct(loop.gain * w + loop.offset + noise);
    Correction out;
    ASSERT_EQ(corrector.step(raw.data(), out), Status::ok);
    squares +=
        (out.wrench - w.cwiseProduct(loop.rig.range)).cwiseQuotient(out.std).squaredNorm() / (6.0 * samples);
  }
  EXPECT_GT(squares, 0.5);  // one gain for all of them
  EXPECT_LT(squares, 1.8);
}

// A payload known to 5 %: the likeliest gain and body together would make every wrench too large by some 0.9 sigma, in the mean.
TEST(Incremental, CorrectsInTheMiddleOfWhatAPayloadLeaves) {
  constexpr int seeds = 12;
  double mean = 0.0;
  for (unsigned seed = 0; seed < seeds; ++seed) {
    LoopCase loop(seed);
    loop.rig.body_prior[0] << 0.05, 0.002, 0.002, 0.002, 0.075, 0.075, 0.02, 0.075, 0.04, 0.04;
    Incremental online(loop.rig, loop.about, settings);
    BodyVector by;
    for (int k = 0; k < kBodyParameters; ++k)
      by[k] = loop.rig.body_prior[0][k] * oracle::normal_matrix(loop.random, 1, 1)(0, 0);
    loop.about.payload = departed(loop.about.payload, by);
    ASSERT_EQ(loop.feed(online, 12.0), Status::ok);
    ASSERT_EQ(online.finish(), Status::ok);
    Corrector<6> corrector;
    ASSERT_EQ(configure(corrector, online, Vector6::Ones()), Status::ok);
    for (int k = 0; k < 6; ++k) {
      const Vector6 w = 0.2 * Vector6::Unit(k);
      Correction out;
      ASSERT_EQ(corrector.step(Vector6(loop.gain * w + loop.offset).data(), out), Status::ok);
      mean += (out.wrench[k] - 0.2 * loop.rig.range[k]) / out.std[k] / (6 * seeds);
    }
  }
  EXPECT_LT(std::abs(mean), 0.6);  // of 12 masses and moments of inertia, a sigma of some 0.2
}

TEST(Incremental, TellsNothingOfARecordThatIsTooShort) {
  LoopCase loop(0);
  Incremental online(loop.rig, loop.about, settings);
  static_cast<void>(loop.feed(online, 0.3));
  static_cast<void>(online.finish());
  EXPECT_FALSE(online.ready());
  EXPECT_EQ(online.samples(), 0);
}

// Whatever comes: no step back in time, no gap, no value and no silence makes it forget that it must answer.
TEST(Incremental, OutlivesAnyStreams) {
  for (unsigned seed = 0; seed < 6; ++seed) {
    LoopCase loop(seed);
    Incremental online(loop.rig, loop.about, settings);
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform;
    double late = 0.0;
    loop.run(12.0, [&](bool sensor, double t, Vector6 value) {
      if (uniform(random) < 2e-3) late += std::pow(10.0, 6.0 * uniform(random) - 5.0);
      if (uniform(random) < 1e-3) late -= uniform(random);
      const double kind = uniform(random);
      if (kind < 0.01)
        value[static_cast<int>(6.0 * uniform(random))] = std::numeric_limits<double>::quiet_NaN();
      else if (kind < 0.02)
        value *= std::pow(10.0, 300.0 * (uniform(random) - 0.5));
      else if (kind < 0.03)
        return;
      static_cast<void>(sensor ? online.push_raw(t + late, value.data())
                               : online.push_motion(0, t + late, value.data()));
    });
    static_cast<void>(online.finish());
    if (online.ready() && online.status() == Status::ok) {
      EXPECT_TRUE(online.gain().allFinite());
      EXPECT_GE(online.covariance().diagonal().minCoeff(), 0.0);
    }
  }
}

}  // namespace
}  // namespace truewrench
