// What a window says of its own motion: knots where the motion needs them, and rejection of what no knots
// fit.
#include "truewrench/knots.hpp"

#include "simulated.hpp"

#include <gtest/gtest.h>

namespace truewrench {
namespace {

// One window over a whole simulated log, the gain held at the truth. `noise`: of the sensor, over what is stated.
class Held {
 public:
  Held(const Simulation& simulation, unsigned seed, double noise = 1.0)
      : recording(noisier(simulation, noise).record(seed)),
        theta(simulation.theta()),
        data_(recording.data()),
        sensor_(simulation.sensor<6>()),
        model_(data_, sensor_, ParameterLayout{}),
        solver_(model_, KnotSettings{}) {}
  Held(const Held&) = delete;
  Held& operator=(const Held&) = delete;

  WindowFit search(double finest = 0.02) {
    const WindowRange w = whole(recording);
    WindowFit fit = solver_.search(w, BSpline(BSpline::uniform(w.begin, w.end, 1)), theta, nullptr, finest);
    if (fit.status == WindowStatus::fitted) solver_.finish(fit, w, nullptr);  // the leverage of every group
    return fit;
  }
  WindowFit finish(const std::vector<double>& breakpoints) {
    WindowFit fit = solver_.hold(whole(recording), BSpline(breakpoints), theta);
    if (fit.status == WindowStatus::fitted) solver_.finish(fit, whole(recording), nullptr);
    return fit;
  }
  WindowSolver<6>& solver() { return solver_; }

  Recording recording;
  Eigen::VectorXd theta;

 private:
  static Simulation noisier(Simulation simulation, double by) {
    simulation.sensor_sigma *= by;
    return simulation;
  }

  LogData data_;
  SensorScale<6> sensor_;
  WindowModel<6> model_;
  WindowSolver<6> solver_;
};

Simulation at_frequency(double scale, double duration) {
  Simulation s;
  s.duration = duration;
  oracle::Sines sines;
  sines.frequency *= scale;
  s.twist = [sines](double t) { return sines.twist(t); };
  s.acceleration = [sines](double t) { return sines.acceleration(t); };
  return s;
}

TEST(GroupStatistics, DeviateIsTheNormalQuantileOfChiSquare) {
  // Tabulated quantiles of chi-square: 99% (2.326 sigma) and 0.1% (-3.090 sigma).
  for (const auto& [freedom, upper, lower] :
       {std::array{10.0, 23.209, 1.479}, {50.0, 76.154, 24.674}, {100.0, 135.807, 61.918}}) {
    EXPECT_NEAR((GroupStatistics{upper, freedom + 7.0, 7.0}.deviate()), 2.326, 0.03) << freedom;
    EXPECT_NEAR((GroupStatistics{lower, freedom, 0.0}.deviate()), -3.090, 0.1) << freedom;
  }
}

TEST(Knots, MotionTakesAsManyDegreesOfFreedomAsItHasCoefficients) {
  Held window(at_frequency(1.0, 4.0), 1);
  const WindowFit fit = window.search();
  ASSERT_EQ(fit.status, WindowStatus::fitted);
  double leverage = 0.0;
  double count = 0.0;
  for (const GroupStatistics& g : fit.groups) {
    leverage += g.leverage;
    count += g.count;
  }
  EXPECT_NEAR(leverage, 6.0 * fit.spline.coefficients(), 1e-6);
  EXPECT_EQ(count, 400.0 * 12);
}

TEST(Knots, ResidualsOfEveryStreamAreAsLargeAsItsNoiseSays) {
  Groups total{};
  for (unsigned seed = 0; seed < 10; ++seed) {
    Held window(at_frequency(1.0, 5.0), seed);
    const WindowFit fit = window.search();
    ASSERT_EQ(fit.status, WindowStatus::fitted);
    for (std::size_t k = 0; k < kGroups; ++k) total[k] += fit.groups[k];
  }
  for (const GroupStatistics& g : total) EXPECT_LT(std::abs(g.deviate()), 3.5);
}

TEST(Knots, SlowMotionGetsFewKnotsAndFastMotionMany) {
  const auto intervals = [](double scale) {
    Held window(at_frequency(scale, 5.0), 3);
    const WindowFit fit = window.search();
    EXPECT_EQ(fit.status, WindowStatus::fitted);
    return fit.spline.intervals();
  };
  const int slow = intervals(0.1);
  const int usual = intervals(1.0);
  const int fast = intervals(4.0);
  EXPECT_LE(slow, 3);
  EXPECT_GT(usual, 2 * slow);
  EXPECT_GT(fast, 2 * usual);
}

// Solved for gain and clock on one second of a good sensor with many samples to a block.
WindowFit joint(bool free_clock, double ahead) {
  Simulation s = at_frequency(1.0, 1.0);
  s.motion_rate = s.sensor_rate = 2000.0;
  s.sensor_sigma = 1e-4;
  s.twist_sigma = 3e-4;
  Recording recording = s.record(2);
  for (double& t : recording.sensor_time) t -= ahead;
  const LogData data = recording.data();
  const SensorScale<6> sensor = s.sensor<6>();
  ParameterLayout layout;
  layout.time_offset = free_clock;
  const WindowModel<6> model(data, sensor, layout);
  Eigen::VectorXd sigma = Eigen::VectorXd::Constant(layout.size(), 0.3);
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(layout.size());
  mean.head(s.theta().size()) = s.theta();
  if (free_clock) sigma[layout.time_offset_begin()] = 5e-3;
  const Prior prior{sigma.cwiseAbs2().cwiseInverse().asDiagonal(), mean};
  WindowRange window = whole(recording);
  window.wrench.first += 30;  // 15 ms: samples whose clock may take them out of the window
  window.wrench.second -= 30;
  WindowSolver<6> solver(model, KnotSettings{});
  return solver.search(window, BSpline(BSpline::uniform(window.begin, window.end, 1)), mean, &prior, 2e-3);
}

TEST(Knots, ClockThatIsNotKnownNeedsNoMoreOfThem) {
  const WindowFit known = joint(false, 0.0);
  ASSERT_EQ(known.status, WindowStatus::fitted);
  for (const double ahead : {0.0, 1e-3, -4e-3}) {
    const WindowFit fit = joint(true, ahead);
    ASSERT_EQ(fit.status, WindowStatus::fitted) << ahead;
    EXPECT_LE(fit.spline.intervals(), known.spline.intervals() + 2) << ahead;
    EXPECT_LT(fit.nested - fit.nested_expected, 5.0 * std::sqrt(2.0 * fit.nested_expected)) << ahead;
    EXPECT_LT(fit.iterations, 60) << ahead;
    const Eigen::Index clock = fit.theta.size() - 1;
    Eigen::MatrixXd information = fit.information.matrix;
    information.diagonal().array() += 1.0 / (0.3 * 0.3);
    information(clock, clock) += 1.0 / (5e-3 * 5e-3) - 1.0 / (0.3 * 0.3);
    const double sigma = std::sqrt(information.inverse()(clock, clock));
    EXPECT_LT(sigma, 3e-3) << ahead;  // the prior is 5e-3
    EXPECT_NEAR(fit.theta[clock], ahead, 4.0 * sigma) << ahead;
  }
}

TEST(Knots, LieWhereTheMotionIsFast) {
  // At rest but for a jolt around t = 4.
  Simulation s;
  s.duration = 8.0;
  s.twist = [](double t) {
    return Vector6(Vector6::Constant(0.2 * std::exp(-50.0 * (t - 4.0) * (t - 4.0))));
  };
  s.acceleration = [s](double t) { return Vector6(-100.0 * (t - 4.0) * s.twist(t)); };
  Held window(s, 4);
  const WindowFit fit = window.search();
  ASSERT_EQ(fit.status, WindowStatus::fitted);
  double near = 8.0;
  double far = 0.0;
  for (int i = 0; i < fit.spline.intervals(); ++i) {
    const double middle = fit.spline.breakpoints()[static_cast<std::size_t>(i)] + 0.5 * fit.spline.width(i);
    if (std::abs(middle - 4.0) < 0.3) near = std::min(near, fit.spline.width(i));
    if (std::abs(middle - 4.0) > 2.0) far = std::max(far, fit.spline.width(i));
  }
  EXPECT_GE(far, 4.0 * near);
}

TEST(Knots, WrenchOfTheFitIsThatOfTheMotion) {
  Simulation s;
  s.point = Vector3(-0.1, 0.3, 0.0);
  s.sign = -1.0;
  s.gravity = [](double t) {
    return Vector3(9.81 * Vector3(std::sin(t), 0.6 * std::cos(t), 0.8 * std::cos(t)));
  };
  std::mt19937 random(1);
  s.gain = Matrix6::Identity() + 0.2 * oracle::normal_matrix(random, 6, 6);
  s.offset = 0.05 * oracle::normal_matrix(random, 6, 1);
  Held window(s, 5);
  const WindowFit fit = window.search();
  ASSERT_EQ(fit.status, WindowStatus::fitted);
  RowMatrix predicted = RowMatrix::Zero(window.recording.raw.rows(), 6);
  window.solver().predict(fit, whole(window.recording), predicted);
  double square = 0.0;
  for (Eigen::Index k = 0; k < predicted.rows(); ++k) {
    const Vector6 d =
        predicted.row(k).transpose() - s.wrench(window.recording.sensor_time[static_cast<std::size_t>(k)]);
    square += d.cwiseQuotient(s.range).squaredNorm() / static_cast<double>(predicted.size());
  }
  EXPECT_LT(std::sqrt(square), s.sensor_sigma);  // the fit averages the sensor's noise, 1e-3 of the range
}

TEST(Knots, CostFellByChanceAloneWhereTheSplineHoldsTheMotion) {
  // The motion is a quintic polynomial, so any knots hold it; halving them must gain one unit per new
  // coefficient.
  Simulation s;
  s.duration = 2.0;
  const Vector6 c(0.3, -0.2, 0.25, 0.4, -0.3, 0.2);
  s.twist = [c](double t) { return Vector6(c * (0.2 + t - t * t + 0.2 * t * t * t * t)); };
  s.acceleration = [c](double t) { return Vector6(c * (1.0 - 2.0 * t + 0.8 * t * t * t)); };
  double gained = 0.0;
  double expected = 0.0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    Held window(s, seed);
    const WindowFit fit = window.finish(BSpline::uniform(0.0, 1.99, 4));
    EXPECT_EQ(fit.status, WindowStatus::fitted);
    gained += fit.nested;
    expected += fit.nested_expected;
  }
  EXPECT_EQ(expected, 40.0 * 6 * 4);
  EXPECT_NEAR(gained, expected, 3.5 * std::sqrt(2.0 * expected));
}

TEST(Knots, TooCoarseASplineIsCaughtByTheScoreTestBeforeChiSquareShowsIt) {
  Simulation s = at_frequency(1.0, 4.0);
  double nested = 0.0;
  double expected = 0.0;
  Groups total{};
  for (unsigned seed = 0; seed < 5; ++seed) {
    Held window(s, seed);
    const WindowFit fit = window.finish(BSpline::uniform(0.0, 3.99, 4));
    nested += fit.nested;
    expected += fit.nested_expected;
    for (std::size_t k = 0; k < kGroups; ++k) total[k] += fit.groups[k];
  }
  double largest = 0.0;
  for (const GroupStatistics& g : total) largest = std::max(largest, g.deviate());
  EXPECT_GT((nested - expected) / std::sqrt(2.0 * expected), 2.0 * largest);
}

TEST(Knots, HeldMotionIsStationary) {
  Held window(at_frequency(1.0, 3.0), 6);
  WindowFit fit =
      window.solver().hold(whole(window.recording), BSpline(BSpline::uniform(0.0, 2.99, 12)), window.theta);
  ASSERT_EQ(fit.status, WindowStatus::fitted);
  const Coefficients before = fit.x;
  ASSERT_EQ(window.solver().relinearise(fit, whole(window.recording), window.theta), Status::ok);
  EXPECT_LT((fit.x - before).norm(), 1e-7 * before.norm());
}

TEST(Knots, MotionThatTheSamplesResolveIsFittedAlthoughHalvedKnotsWouldBeTooClose) {
  const double finest = 0.02;
  for (const double scale : {8.0, 9.0, 10.0, 11.0}) {
    Held window(at_frequency(scale, 2.3), 3);
    const WindowFit fit = window.search(finest);
    EXPECT_EQ(fit.status, WindowStatus::fitted) << scale;
    EXPECT_LT(fit.nested - fit.nested_expected, 3.0 * std::sqrt(2.0 * fit.nested_expected)) << scale;
    for (int i = 0; i < fit.spline.intervals(); ++i) EXPECT_GE(fit.spline.width(i), finest);
  }
}

TEST(Knots, VibrationThatTheSamplesDoNotResolveIsRejected) {
  Simulation s = at_frequency(1.0, 3.0);
  const Simulation smooth = s;
  s.twist = [smooth](double t) {
    return Vector6(smooth.twist(t).array() + 0.01 * std::sin(2.0 * M_PI * 31.0 * t));
  };
  s.acceleration = [smooth](double t) {
    return Vector6(smooth.acceleration(t).array() +
                   0.01 * 2.0 * M_PI * 31.0 * std::cos(2.0 * M_PI * 31.0 * t));
  };
  Held window(s, 7);
  const WindowFit fit = window.search(0.04);
  EXPECT_EQ(fit.status, WindowStatus::misfit);
}

TEST(Knots, NoiseTwiceAsLargeAsStatedIsRejected) {
  for (const bool sensor : {true, false}) {
    Simulation s = at_frequency(1.0, 4.0);
    (sensor ? s.sensor_sigma : s.twist_sigma) *= 2.0;
    Recording recording = s.record(8);
    recording.twist_sigma.setConstant(1e-3);
    s.sensor_sigma = 1e-3;
    const LogData data = recording.data();
    const SensorScale<6> scale = s.sensor<6>();
    const WindowModel<6> model(data, scale, ParameterLayout{});
    WindowSolver<6> solver(model, KnotSettings{});
    const WindowRange w = whole(recording);
    const WindowFit fit =
        solver.search(w, BSpline(BSpline::uniform(w.begin, w.end, 1)), s.theta(), nullptr, 0.02);
    EXPECT_EQ(fit.status, WindowStatus::misfit) << (sensor ? "sensor" : "twist");
    const Group noisy = sensor ? kForce : kLinear;
    EXPECT_GT(fit.groups[noisy].deviate(), 5.0);
  }
}

// Of a window that does not fit at a held gain: another search, with the gain free, costs more than all before it.
TEST(Knots, WindowIsLostUnlessAFreeGainOrWhatIsLeftOutMayMendIt) {
  const ParameterLayout layout;
  const Eigen::VectorXd precision = Eigen::VectorXd::Constant(layout.size(), 1.0 / (0.05 * 0.05));
  const auto lost = [&](Held& window) {
    const WindowFit fit = window.search();
    EXPECT_EQ(fit.status, WindowStatus::misfit);
    return window.solver().lost(fit, whole(window.recording), {precision.asDiagonal(), window.theta});
  };
  const Simulation s = at_frequency(1.0, 10.0);

  Held noisy(s, 8, 1.5);
  EXPECT_TRUE(lost(noisy));

  Held wrong_gain(s, 8);
  wrong_gain.theta.head<36>().array() += 0.02;
  EXPECT_FALSE(lost(wrong_gain));

  Held touched(s, 8);
  touched.recording.raw.middleRows(400, 50).rowwise() += 0.02 * s.range.transpose();
  EXPECT_FALSE(lost(touched));
}

TEST(Knots, ATwistWithoutRotationDoesNotDetermineTheMotion) {
  Held window(at_frequency(1.0, 2.0), 9);
  window.recording.twist.col(5).setConstant(std::nan(""));
  EXPECT_EQ(window.search().status, WindowStatus::motion_undetermined);
}

}  // namespace
}  // namespace truewrench
