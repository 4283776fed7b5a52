// The estimator of a control loop where cells are missing, streams are slow or break off, and where statements make no sense.
#include "incremental_case.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <utility>

namespace truewrench {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
const IncrementalSettings settings{.rate = LoopCase::motion_rate, .discrepancy = 0.0};

struct Found {
  Eigen::MatrixXd error;  // (n, 6) of the gain
  Eigen::MatrixXd sigma;  // (n, 6)
  double raw_factor = 0.0;
  std::int64_t samples = 0, masked = 0, pushed = 0;
};

// 12 s of a loop whose samples `change` has been at.
Found found(unsigned seed, const std::function<void(bool, double, Vector6&)>& change) {
  LoopCase loop(seed);
  Incremental online(loop.rig, loop.about, settings);
  Found out;
  loop.run(12.0, [&](bool sensor, double t, Vector6 value) {
    change(sensor, t, value);
    EXPECT_EQ(sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()), Status::ok);
    out.pushed += sensor ? 1 : 0;
  });
  EXPECT_EQ(online.finish(), Status::ok);
  EXPECT_TRUE(online.ready());
  out.error = online.gain() - loop.gain;
  const Eigen::VectorXd sigma = online.covariance().diagonal().cwiseSqrt();
  out.sigma = Eigen::Map<const RowMatrix>(sigma.data(), 6, 6);
  out.raw_factor = online.sizes().raw_factor.maxCoeff();
  out.samples = online.samples();
  out.masked = online.masked_samples();
  return out;
}
void nothing(bool /*sensor*/, double /*t*/, Vector6& /*value*/) {}

double largest(const Found& f, int rows) {
  return f.error.topRows(rows).cwiseQuotient(f.sigma.topRows(rows)).cwiseAbs().maxCoeff();
}

// 20 samples an interval of knots, which rows replace.
TEST(IncrementalFaults, ADeadChannelLeavesTheOthersAsTheyAre) {
  const Found whole = found(1, nothing), dead = found(1, [](bool sensor, double /*t*/, Vector6& value) {
                                           if (sensor) value[5] = nan;
                                         });
  EXPECT_NEAR(static_cast<double>(dead.samples), static_cast<double>(dead.pushed), 2.0);
  for (int i = 0; i < 5; ++i)
    for (int j = 0; j < 6; ++j) EXPECT_NEAR(dead.sigma(i, j), whole.sigma(i, j), 0.1 * whole.sigma(i, j));
  EXPECT_GT(dead.sigma.row(5).minCoeff(), 0.25);  // the prior's
  EXPECT_LT(largest(dead, 5), 4.5);
  EXPECT_NEAR(dead.raw_factor, 1.0, 0.05);  // only what is there counts
}

// Cells that come and go: for some seconds, for some samples of every interval, at random.
TEST(IncrementalFaults, MissingCellsLeaveOutTheirResiduals) {
  const Found whole = found(2, nothing);
  std::mt19937 random(0);
  std::uniform_real_distribution<double> uniform;
  const std::function<void(bool, double, Vector6&)> cases[] = {
      [](bool sensor, double t, Vector6& value) {
        if (sensor && t > 4.0 && t < 8.0) value.tail<3>().setConstant(nan);
      },
      [&](bool sensor, double t, Vector6& value) {
        if (sensor && std::fmod(t, 0.01) < 0.0025) value[2] = nan;
      },
      [&](bool sensor, double /*t*/, Vector6& value) {
        for (int i = 0; sensor && i < 5; ++i)
          if (uniform(random) < 0.25) value[i] = nan;
      }};
  const double wider[] = {1.6, 1.35, 2.5};  // than with all
  for (std::size_t k = 0; k < 3; ++k) {
    const Found some = found(2, cases[k]);
    const Eigen::MatrixXd ratio = some.sigma.cwiseQuotient(whole.sigma);
    EXPECT_GT(ratio.minCoeff(), 0.95) << k;
    EXPECT_LT(ratio.maxCoeff(), wider[k]) << k;
    EXPECT_LT(largest(some, 6), 4.5) << k;
    EXPECT_NEAR(some.raw_factor, 1.0, 0.1) << k;
    EXPECT_LT(some.masked, some.pushed / 100) << k;
  }
}

// What a channel shows while others are there, too, is weighed by itself.
TEST(IncrementalFaults, SpikesOfAChannelThatComesAndGoesAreLeftOut) {
  long k = 0;
  const Found spiky = found(3, [&](bool sensor, double /*t*/, Vector6& value) {
    if (!sensor) return;
    ++k;
    value[3] = k % 10 != 0 ? nan : k % 40 == 0 ? value[3] + 0.2 : value[3];
  });
  EXPECT_LT(largest(spiky, 6), 5.0);
  EXPECT_GT(spiky.masked, 10);
  EXPECT_LT(spiky.sigma.row(3).maxCoeff(), 0.05);
}

// What Python refuses a loop must not take for sound: channels that hang, nothing that moves, glitches of the velocities.
TEST(IncrementalFaults, WhatTellsNothingOrIsWildIsNotSound) {
  const auto sound = [](unsigned seed, const std::function<void(bool, Vector6&)>& change) {
    LoopCase loop(seed);
    Incremental online(loop.rig, loop.about, settings);
    loop.run(12.0, [&](bool sensor, double t, Vector6 value) {
      change(sensor, value);
      EXPECT_EQ(sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()),
                Status::ok);
    });
    return online.finish() == Status::ok && online.sound();
  };
  for (unsigned seed = 1; seed < 4; ++seed) {
    EXPECT_TRUE(sound(seed, [](bool, Vector6&) {})) << seed;
    EXPECT_FALSE(sound(seed, [](bool sensor, Vector6& value) {
      if (sensor) value.setZero();
    })) << seed;
    EXPECT_FALSE(sound(seed, [](bool sensor, Vector6& value) {
      if (sensor) value[4] = 0.3;
    })) << seed;
    EXPECT_TRUE(sound(seed, [](bool sensor, Vector6& value) {
      if (sensor) value[4] = nan;
    })) << seed;
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    EXPECT_FALSE(sound(seed, [&](bool sensor, Vector6& value) {  // at rest
      for (double& x : value) x = (sensor ? LoopCase::noise : LoopCase::velocity_noise) * normal(random);
    })) << seed;
    int k = 0;
    EXPECT_FALSE(sound(seed, [&](bool sensor, Vector6& value) {
      if (!sensor && ++k % 200 == 0) value[k / 200 % 6] += 1.0;
    })) << seed;
  }
}

TEST(IncrementalFaults, ASensorThatComesBeforeTheMotionIsTaken) {
  for (const double late : {0.5, 3.0, 10.0}) {
    LoopCase loop(5);
    Incremental online(loop.rig, loop.about, settings);
    loop.run(late + 12.0, [&](bool sensor, double t, const Vector6& value) {
      if (!sensor && t <= late) return;
      const Status status =
          sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data());
      EXPECT_EQ(status, Status::ok) << late << " " << t;
    });
    EXPECT_EQ(online.finish(), Status::ok);
    EXPECT_TRUE(online.sound());
    EXPECT_EQ(online.dropped(), 0);
    EXPECT_GT(online.samples(), static_cast<std::int64_t>(11.5 * LoopCase::sensor_rate));
  }
}

TEST(IncrementalFaults, AMotionThatLacksComponentsTellsTheOthers) {
  const auto sigma = [](bool split) {
    LoopCase loop(4);
    if (split) loop.about.motion.push_back(loop.about.motion[0]);
    Incremental online(loop.rig, loop.about, settings);
    loop.run(12.0, [&](bool sensor, double t, const Vector6& value) {
      if (sensor) {
        EXPECT_EQ(online.push_raw(t, value.data()), Status::ok);
        return;
      }
      for (std::size_t i = 0; i < (split ? 2 : 1); ++i) {
        Vector6 half = value;
        if (split) half.segment<3>(i == 0 ? 3 : 0).setConstant(nan);
        EXPECT_EQ(online.push_motion(i, t, half.data()), Status::ok);
      }
    });
    EXPECT_EQ(online.finish(), Status::ok);
    return Eigen::VectorXd(online.covariance().diagonal().cwiseSqrt());
  };
  const Eigen::VectorXd ratio = sigma(true).cwiseQuotient(sigma(false));
  EXPECT_GT(ratio.minCoeff(), 0.97);
  EXPECT_LT(ratio.maxCoeff(), 1.03);
}

// More samples in an interval than there is room for.
TEST(IncrementalFaults, WhatAWindowDoesNotHoldIsThinnedEvenly) {
  LoopCase loop(0);
  Lag lag(loop.rig, loop.about, 4, 16);
  lag.place(0.0, 0.05);
  Ring<RawSample> raw;
  Ring<MotionSample> motion;
  raw.reserve(50);
  motion.reserve(50);
  for (int k = 0; k < 50; ++k) {
    RawSample& r = raw.push();
    r = RawSample();
    r.time = 1e-3 * k;
    for (std::size_t i = 0; i < 6; ++i) r.value[i] = 1e-3 * k;
    MotionSample& m = motion.push();
    m.time = r.time;
    m.value.fill(r.time);
  }
  const auto none = [](double, double) { ADD_FAILURE(); };
  lag.take(0, raw, 0, 50, none);
  lag.take(0, motion, 0, 50);
  const Lag::Interval& v = lag.interval(0);
  ASSERT_EQ(v.rows, kNodes);
  ASSERT_EQ(lag.motion(0).end(), kNodes);
  EXPECT_EQ(v.spared, 16 - kNodes);
  double raw_mean = 0.0, motion_mean = 0.0;
  for (int r = 0; r < kNodes; ++r) {
    raw_mean += v.row[static_cast<std::size_t>(r)].size * v.row[static_cast<std::size_t>(r)].time / 16.0;
    motion_mean += lag.motion(0)[r].size * lag.motion(0)[r].time / 16.0;
  }
  EXPECT_NEAR(raw_mean, 0.0245, 1e-3);  // of all
  EXPECT_NEAR(motion_mean, 0.0245, 1e-3);
  // where no nine agree: eight from beginning to end
  for (long k = 0; k < 50; ++k)
    for (std::size_t i = 0; i < 6; ++i)
      if (i != static_cast<std::size_t>(k % 6)) raw[k].value[i] = motion[k].value[i] = nan;
  lag.place(0.0, 0.05);
  lag.take(0, raw, 0, 48, none);
  lag.take(0, motion, 0, 48);
  ASSERT_EQ(v.rows, kMostRows);
  EXPECT_EQ(v.spared, 0.0);
  const long begin = lag.motion(0).begin();
  for (int r = 0; r < kMostRows; ++r) {
    EXPECT_NEAR(v.row[static_cast<std::size_t>(r)].time, 3e-3 + 6e-3 * r, 1.5e-3);
    EXPECT_NEAR(lag.motion(0)[begin + r].time, 3e-3 + 6e-3 * r, 1.5e-3);
    EXPECT_EQ(v.row[static_cast<std::size_t>(r)].channels, 1);
  }
}

// 20 knots of 2.5 samples: 5 s, an interval 250 samples of the sensor.
TEST(IncrementalFaults, SlowMotionBesideAFastSensorLosesNoSample) {
  LoopCase loop(6);
  Incremental online(loop.rig, loop.about, {.lag = 5.0, .discrepancy = 0.0});
  std::int64_t pushed = 0;
  for (int k = 0; k < 25000; ++k) {
    const double t = 1e-3 * k;
    if (k % 100 == 0) {
      ASSERT_EQ(online.push_motion(0, t, loop.twist_at(t).data()), Status::ok);
    }
    ASSERT_EQ(online.push_raw(t + 5e-4, loop.raw_at(t + 5e-4).data()), Status::ok);
    ++pushed;
  }
  ASSERT_EQ(online.finish(), Status::ok);
  EXPECT_NEAR(static_cast<double>(online.samples() + online.masked_samples()), static_cast<double>(pushed),
              200.0);
}

TEST(IncrementalFaults, MemoryIsForAnySpacing) {
  const std::pair<double, double> all[] = {{0.005, 0.0125}, {0.0, 0.2}, {0.2, 0.0125}, {0.02, 0.5}};
  for (const auto& [spacing, finest] : all) {
    LoopCase loop(7);
    Incremental online(
        loop.rig, loop.about,
        {.rate = LoopCase::motion_rate, .spacing = spacing, .finest = finest, .discrepancy = 0.0});
    EXPECT_EQ(loop.feed(online, 14.0), Status::ok) << spacing;
    EXPECT_EQ(online.finish(), Status::ok) << spacing;
    EXPECT_TRUE(online.ready());
    EXPECT_NEAR(online.spacing(), spacing > 0.0 ? spacing : 0.05, 1e-12);
  }
}

// A second stretch, whose first lag is laid at several spacings.
TEST(IncrementalFaults, SpansOfEarlierStretchesWaitToBeRead) {
  LoopCase loop(8);
  Incremental online(loop.rig, loop.about, settings);
  long spikes = 0, k = 0;
  loop.run(12.0, [&](bool sensor, double t, Vector6 value) {
    if (t > 6.0 && t < 7.0) return;
    if (sensor && ++k % 100 == 50) {
      value[0] += 0.5;
      ++spikes;
    }
    static_cast<void>(sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()));
  });
  ASSERT_EQ(online.finish(), Status::ok);
  EXPECT_GE(online.masked_samples(), spikes);
  EXPECT_LE(online.masked_samples(), spikes + spikes / 4 + 2);
  EXPECT_EQ(static_cast<std::int64_t>(online.masked_spans()), online.masked_samples());
  long early = 0;
  for (std::size_t i = 0; i < online.masked_spans(); ++i) early += online.masked_span(i).begin < 6.0 ? 1 : 0;
  EXPECT_NEAR(static_cast<double>(early), 0.5 * static_cast<double>(spikes), 4.0);
}

TEST(IncrementalFaults, WhatMakesNoSenseIsRefusedAndStaysInert) {
  const auto expect = [](Status told, const std::function<void(LoopCase&, IncrementalSettings&)>& change) {
    LoopCase loop(0);
    IncrementalSettings changed = settings;
    change(loop, changed);
    Incremental online(loop.rig, loop.about, changed);
    const Vector6 value = Vector6::Zero();
    EXPECT_EQ(online.status(), told);
    EXPECT_EQ(online.push_raw(0.0, nullptr), told);  // not read
    EXPECT_EQ(online.push_motion(0, 0.0, value.data()), told);
    EXPECT_EQ(online.push_motion(7, 0.0, nullptr), told);
    EXPECT_EQ(online.finish(), told);
    EXPECT_EQ(online.next_log(LoopCase(0).about), told);
    EXPECT_FALSE(online.ready());
    EXPECT_TRUE(online.covariance().allFinite());
  };
  expect(Status::wrong_size, [](LoopCase& c, IncrementalSettings&) {
    c.rig.noise = c.rig.offset_prior = Eigen::VectorXd::Ones(kMostChannels + 1);
    c.rig.nominal = RowMatrix::Ones(kMostChannels + 1, 6);
  });
  expect(Status::wrong_size, [](LoopCase& c, IncrementalSettings&) {
    c.about.motion.resize(kMostStreams + 1, c.about.motion[0]);
  });
  expect(Status::wrong_size, [](LoopCase& c, IncrementalSettings&) { c.about.motion.clear(); });
  expect(Status::wrong_size, [](LoopCase& c, IncrementalSettings&) {
    c.about.motion[0].sigma = Eigen::VectorXd::Ones(7);
    c.about.motion[0].group = Eigen::VectorXi::Zero(7);
  });
  expect(Status::wrong_size, [](LoopCase& c, IncrementalSettings&) { c.rig.body_prior.clear(); });
  expect(Status::wrong_size, [](LoopCase& c, IncrementalSettings&) { c.about.body = 3; });
  expect(Status::not_configured, [](LoopCase& c, IncrementalSettings&) { c.about.source = Source::mapped; });
  expect(Status::not_positive, [](LoopCase& c, IncrementalSettings&) { c.rig.gain_prior = -1.0; });
  expect(Status::unphysical_payload,
         [](LoopCase& c, IncrementalSettings&) { c.about.payload.inertia(2, 2) = 40.0; });
  for (double IncrementalSettings::* at :
       {&IncrementalSettings::lag, &IncrementalSettings::rate, &IncrementalSettings::finest}) {
    expect(Status::not_finite, [at](LoopCase&, IncrementalSettings& s) { s.*at = nan; });
    expect(Status::not_positive, [at](LoopCase&, IncrementalSettings& s) { s.*at = 0.0; });
    expect(Status::not_positive, [at](LoopCase&, IncrementalSettings& s) { s.*at = -1.0; });
  }
  expect(Status::not_positive, [](LoopCase&, IncrementalSettings& s) { s.spacing = -0.05; });
  expect(Status::not_finite, [](LoopCase&, IncrementalSettings& s) { s.spacing = nan; });
  expect(Status::not_finite, [](LoopCase&, IncrementalSettings& s) { s.discrepancy = nan; });
  expect(Status::wrong_size, [](LoopCase&, IncrementalSettings& s) { s.finest = 1e-12; });
  expect(Status::wrong_size, [](LoopCase&, IncrementalSettings& s) { s.rate = 1e15; });
}

TEST(IncrementalFaults, ALogThatMakesNoSenseChangesNothing) {
  LoopCase loop(9);
  Incremental online(loop.rig, loop.about, settings);
  ASSERT_EQ(loop.feed(online, 8.0), Status::ok);
  const Eigen::VectorXd theta = online.theta();
  const std::int64_t blocks = online.blocks();
  RecordedLog other = loop.about;
  other.body = 1;
  EXPECT_EQ(online.next_log(other), Status::wrong_size);
  EXPECT_EQ(online.theta(), theta);
  EXPECT_EQ(online.blocks(), blocks);
  const Vector6 twist = loop.twist_at(8.0);
  EXPECT_EQ(online.push_motion(0, 8.0, twist.data()), Status::ok);  // it goes on
  EXPECT_EQ(online.status(), Status::ok);
}

TEST(IncrementalFaults, AnAttitudeThatIsNotThereIsSaidAtOnce) {
  LoopCase loop(1);
  loop.rig.gravity = {0.0, 0.0, -9.81};
  const Vector6 raw = Vector6::Zero();
  Matrix3 R = Matrix3::Identity();
  Incremental online(loop.rig, loop.about, settings);
  EXPECT_EQ(online.push_raw(0.0, raw.data()), Status::wrong_size);
  R(1, 1) = nan;
  EXPECT_EQ(online.push_raw(0.0, raw.data(), R.data()), Status::not_finite);
  R(1, 1) = 1.0;
  EXPECT_EQ(online.push_raw(0.0, raw.data(), R.data()), Status::ok);  // what was refused is not in it
  // an accelerometer feels it by itself
  loop.about.source = Source::imu;
  Incremental imu(loop.rig, loop.about, settings);
  EXPECT_EQ(imu.push_raw(0.0, raw.data()), Status::ok);
}

// A stretch that no fit comes to an end on, then what is sound.
TEST(IncrementalFaults, ALostFirstLagChoosesNoSpacing) {
  LoopCase loop(10);
  Incremental online(loop.rig, loop.about, settings);
  Status worst = Status::ok;
  loop.run(16.0, [&](bool sensor, double t, Vector6 value) {
    if (!sensor && t < 2.2) value = 1e200 * Vector6::Constant(std::fmod(t, 0.004) < 0.002 ? 1.0 : -1.0);
    if (t > 2.2 && t < 3.0) return;
    worst =
        std::max(worst, sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()));
  });
  EXPECT_EQ(worst, Status::not_factorizable);
  ASSERT_TRUE(online.ready());
  static_cast<void>(online.finish());
  EXPECT_NEAR(online.spacing(), 0.05, 1e-12);
  EXPECT_LT((online.gain() - loop.gain).norm() / 6.0, 0.01);
}

double nees(Incremental& online, const Eigen::MatrixXd& gain) {
  const Eigen::MatrixXd error = online.gain() - gain;
  const Eigen::VectorXd sigma = online.covariance().diagonal().cwiseSqrt();
  return error.cwiseQuotient(Eigen::Map<const RowMatrix>(sigma.data(), 6, 6)).squaredNorm() / 36.0;
}

// A lag that cannot be fitted leaves nothing of itself: neither in theta and the sizes, nor in the parts.
TEST(IncrementalFaults, ACellOfGarbageIsForgotten) {
  for (const double garbage : {1e30, 1e60, 1e100, 1e150}) {
    LoopCase loop(11);
    Incremental online(loop.rig, loop.about, settings);
    bool once = true;
    Status worst = Status::ok;
    loop.run(25.0, [&](bool sensor, double t, Vector6 value) {
      if (!sensor && t > 6.0 && std::exchange(once, false)) value[0] = garbage;
      worst =
          std::max(worst, sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()));
    });
    EXPECT_EQ(worst, Status::not_factorizable);
    static_cast<void>(online.finish());
    EXPECT_LT(nees(online, loop.gain), 2.0) << garbage;
    EXPECT_GE(online.agreement().p, 0.5 * constants::doubt) << garbage;
  }
}

TEST(IncrementalFaults, SaysWhetherItIsSound) {
  for (unsigned seed = 0; seed < 3; ++seed) {
    using Fault = std::function<void(const LoopCase&, bool, double, Vector6&)>;
    const Fault faults[] = {
        [](const LoopCase& /*loop*/, bool /*sensor*/, double /*t*/, Vector6& /*value*/) {},
        [](const LoopCase& /*loop*/, bool sensor, double t, Vector6& value) {  // a channel that hangs first
          if (sensor && t < 6.0) value[1] = 0.02;
        },
        [](const LoopCase& /*loop*/, bool sensor, double /*t*/,
           Vector6& value) {  // velocities in another unit
          if (!sensor) value[0] *= 0.8;
        },
        [](const LoopCase& loop, bool sensor, double t,
           Vector6& value) {  // a payload that is not whole at first
          if (sensor && t < 6.0) value = loop.offset + 0.6 * (value - loop.offset);
        },
        [](const LoopCase& loop, bool sensor, double /*t*/, Vector6& value) {  // a channel at its end
          if (sensor) value[2] = loop.offset[2] + std::clamp(value[2] - loop.offset[2], -0.02, 0.02);
        }};
    for (const auto& fault : faults) {
      LoopCase loop(20 + seed);
      Incremental online(loop.rig, loop.about, settings);
      EXPECT_FALSE(online.sound());
      loop.run(12.0, [&](bool sensor, double t, Vector6 value) {
        fault(loop, sensor, t, value);
        static_cast<void>(sensor ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()));
      });
      EXPECT_EQ(online.finish(), Status::ok);
      EXPECT_EQ(online.sound(), &fault == &faults[0]) << seed << " " << &fault - &faults[0];
    }
  }
}

// A lag of fifty periods is enough for streams of any rate.
TEST(IncrementalFaults, SlowStreamsAreNoSilence) {
  for (const bool slow_sensor : {false, true}) {
    LoopCase loop(12);
    Incremental online(loop.rig, loop.about, {.lag = 25.0, .rate = 100.0, .discrepancy = 0.0});
    double next[2] = {0.0, 0.003};
    const double step[2] = {slow_sensor ? 0.02 : 0.5, slow_sensor ? 0.5 : 0.02};
    while (next[0] < 80.0) {
      const int of = next[1] < next[0] ? 1 : 0;
      const double t = next[of];
      const Vector6 value = of == 1 ? loop.raw_at(t) : loop.twist_at(t);
      EXPECT_EQ(of == 1 ? online.push_raw(t, value.data()) : online.push_motion(0, t, value.data()),
                Status::ok);
      next[of] += step[of];
    }
    EXPECT_EQ(online.dropped(), 0);
    EXPECT_TRUE(online.ready());
  }
}

// A thermometer is slower than the sensor, and what is not said is as it was.
TEST(IncrementalFaults, ATemperatureStandsUntilTheNext) {
  LoopCase loop(13);
  loop.rig.slope_prior = 1e-3;
  const Vector6 raw = Vector6::Zero();
  EXPECT_EQ(Incremental(loop.rig, loop.about, settings).push_raw(0.0, raw.data(), nullptr, 20.0),
            Status::wrong_size);
  loop.about.temperature = Eigen::VectorXd::Zero(1);
  Incremental online(loop.rig, loop.about, settings);
  const Vector6 slope = 1e-3 * oracle::normal_matrix(loop.random, 6, 1);
  double told = -1.0;
  loop.run(20.0, [&](bool sensor, double t, Vector6 value) {
    const double warmth = 20.0 + std::floor(0.5 * t);
    if (sensor) value += warmth * slope;
    const bool anew = warmth != told;
    EXPECT_EQ(sensor ? online.push_raw(t, value.data(), nullptr, anew ? warmth : nan)
                     : online.push_motion(0, t, value.data()),
              Status::ok);
    if (sensor) told = warmth;
  });
  EXPECT_EQ(online.finish(), Status::ok);
  EXPECT_TRUE(online.sound());
  EXPECT_LT(nees(online, loop.gain), 2.0);
}

TEST(IncrementalFaults, StampsMayBeginAgainWhereARecordEnds) {
  LoopCase loop(14);
  Incremental online(loop.rig, loop.about, settings);
  EXPECT_EQ(loop.feed(online, 4.0), Status::ok);
  const Vector6 raw = loop.raw_at(5.0);
  EXPECT_EQ(online.push_raw(3600.0, raw.data()), Status::ok);
  EXPECT_EQ(loop.feed(online, 1.0), Status::not_increasing);
  EXPECT_EQ(online.finish(), Status::ok);
  const std::int64_t before = online.samples();
  EXPECT_EQ(loop.feed(online, 4.0), Status::ok);
  EXPECT_EQ(online.finish(), Status::ok);
  EXPECT_GT(online.samples(), 2 * before - 20);
}

}  // namespace
}  // namespace truewrench
