// Which parameters logs share.
#include "oracles.hpp"
#include "truewrench/estimation/stretch.hpp"
#include "truewrench/model/chain.hpp"
#include "truewrench/model/gravity.hpp"
#include "truewrench/model/parameters.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

namespace truewrench {
namespace {

Statement in_gravity() {
  Statement rig;
  rig.noise = Eigen::VectorXd::Constant(6, 1e-3);
  rig.nominal = RowMatrix::Identity(6, 6);
  rig.offset_prior = Eigen::VectorXd::Constant(6, 0.1);
  rig.gravity << 0.0, 0.0, -9.81;
  rig.tilt_prior = 3.5e-3;
  rig.body_prior.emplace_back(Eigen::Matrix<double, 10, 1>::Constant(0.01));
  return rig;
}

TEST(Layout, GravityIsTiltedInTheRootFrameOfALogOrInTheOneThatLogsShare) {
  const Statement rig = in_gravity();
  RecordedLog shared, alone;
  shared.motion.resize(1);
  alone = shared;
  alone.own_roots = {0.0};
  const Layout layout(rig, {&alone, &shared, &alone, &shared}, {});
  const auto tilt = [&](std::size_t l) { return layout.in_theta(l).tilt; };
  EXPECT_EQ(tilt(1), tilt(3));
  EXPECT_EQ((std::vector<int>{tilt(0) + 2, tilt(0) + 4}), (std::vector<int>{tilt(1), tilt(2)}));
  for (const int at : {tilt(0), tilt(1), tilt(2)})
    for (int axis = 0; axis < 2; ++axis) EXPECT_EQ(layout.sigma()[at + axis], rig.tilt_prior);
  EXPECT_EQ(layout.in_theta(0).b, tilt(2) + 2);
}

TEST(Layout, OfOneLogIsTheSameWhosesoeverItsRootFrameIs) {
  const Statement rig = in_gravity();
  RecordedLog log;
  log.motion.resize(1);
  const Layout shared(rig, {&log}, {});
  log.own_roots = {0.0};
  const Layout alone(rig, {&log}, {});
  EXPECT_EQ(alone.log(0).global, shared.log(0).global);
  EXPECT_EQ(alone.in_theta(0).tilt, shared.in_theta(0).tilt);
  EXPECT_EQ(alone.sigma(), shared.sigma());
}

TEST(Layout, EveryRootFrameOfALogHasATiltOfItsOwn) {
  const Statement rig = in_gravity();
  RecordedLog log, shared;
  log.motion.resize(1);
  shared = log;
  log.own_roots = {0.0, 9.0, 11.0};
  const Layout layout(rig, {&log, &shared}, {});
  const int first = layout.in_theta(0).tilt;
  for (const auto& [time, root] : {std::pair{-0.1, 0}, {8.9, 0}, {9.0, 1}, {12.0, 2}}) {
    EXPECT_EQ(layout.in_theta(0).in_root(time).tilt, first + 2 * root) << time;
    EXPECT_EQ(layout.in_theta(1).in_root(time).tilt, layout.tilt) << time;
  }
  EXPECT_EQ(layout.tilt, first + 6);
}

constexpr double kPi = 3.14159265358979323846;

// theta of a log in gravity, and where s, kappa and gamma stand in it.
struct Late {
  Statement rig = in_gravity();
  Columns columns;
  Eigen::VectorXd theta;
  std::array<int, 3> at{};

  explicit Late(const std::array<double, 3>& values) {
    RecordedLog log;
    log.motion.resize(1);
    log.motion[0].time_offset_prior = 0.01;
    const Layout layout(rig, {&log}, {});
    columns = layout.in_theta(0);
    theta = layout.mean();
    at = {columns.clock[0], columns.clock[0] + 1, columns.gamma};
    for (std::size_t i = 0; i < 3; ++i) theta[at[i]] = values[i];
  }
  Gravity gravity(double half_window, double clock_set) const {
    return {rig, columns, theta.data(), true, half_window, clock_set};
  }
};

// By s, kappa and gamma, against differences, where samples are late and means of a time.
TEST(Gravity, IsLateByItsParameters) {
  const std::array<double, 3> values{0.02, 0.3, 0.8};
  const double half_window = 0.04, step = 1e-4;
  Late late(values);
  const Matrix3 R = Eigen::AngleAxisd(0.7, Vector3(1, 2, 3).normalized()).toRotationMatrix();
  Vector6 nu, a;
  nu << 0.1, 0.2, 0.3, 0.9, -0.7, 0.4;
  a << 0.3, 0.1, 0.2, -2.0, 1.5, 3.0;
  const Vector3 jerk(5.0, -9.0, 4.0);
  const auto felt = [&] { return late.gravity(half_window, 0.01).felt(R, nu, a, jerk); };
  std::vector<Vector3> by;
  late.gravity(half_window, 0.01).by_parameters(R, nu.tail<3>(), a.tail<3>(), jerk, [&](const double* x) {
    by.emplace_back(x[0], x[1], x[2]);
  });
  for (std::size_t i = 0; i < 3; ++i) {
    double& x = late.theta[late.at[i]];
    x = values[i] + step;
    const Vector3 plus = felt();
    x = values[i] - step;
    EXPECT_LT((by[i] - (plus - felt()) / (2.0 * step)).norm(), 1e-6) << i;
    x = values[i];
  }
  // a mean without a delay adds the second derivative of g
  late.theta[late.at[0]] = 0.0;
  const Vector3 g = R * late.rig.gravity, omega = nu.tail<3>(), alpha = a.tail<3>();
  const Vector3 second = omega.cross(omega.cross(g)) - alpha.cross(g);
  const Vector3 mean = late.gravity(half_window, 0.0).felt(R, nu, a, jerk);
  EXPECT_LT((mean - g - 0.2 * half_window * half_window * second).norm(), 1e-12);
}

// A sensor that is late by l and filtered by one pole reads E x(t - l - X), X exponential with mean tau.
struct OnePole {
  double late, tau;

  double s() const { return late + tau; }
  double kappa() const { return 0.5 - 0.5 * tau * tau / (s() * s()); }
  // Of x(t): integral over exp(-y) by steps whose error is of no account.
  template <typename Value>
  auto read(const Value& x, double t) const {
    auto sum = x(t);
    sum -= x(t);
    constexpr double step = 2e-3;
    for (double y = 0.5 * step; y < 30.0; y += step) sum += step * std::exp(-y) * x(t - late - tau * y);
    return sum;
  }
};

class Bends : public testing::TestWithParam<OnePole> {};

// The motion as logged from the motion that the sensor read, of 1 rad/s.
TEST_P(Bends, AsOnePoleToThirdOrder) {
  const OnePole& pole = GetParam();
  const double t = 0.4;
  const auto x = [](int p) { return [p](double at) { return std::sin(at + 0.5 * kPi * p); }; };
  const Bending bending(pole.s(), 0.0, pole.kappa() - 0.5);
  const double late = t + pole.s();
  const double told =
      pole.read(x(0), late) + bending.second * pole.read(x(2), late) + bending.third * pole.read(x(3), late);
  EXPECT_NEAR(told, std::sin(t), 0.4 * std::pow(pole.tau, 4.0) + 1e-6);
  EXPECT_GT(std::abs(told - bending.third * pole.read(x(3), late) - std::sin(t)),
            0.05 * std::pow(pole.tau, 3.0));
}

// Products of two motions, each as the sensor read it.
TEST_P(Bends, AndProducts) {
  const OnePole& pole = GetParam();
  const double t = 0.4;
  const Bending bending(pole.s(), 0.0, pole.kappa() - 0.5);
  const auto x = [](int p) { return [p](double at) { return std::sin(at + 0.5 * kPi * p); }; };
  const auto y = [](int p) {
    return [p](double at) { return std::pow(0.7, p) * std::cos(0.7 * at + 0.5 * kPi * p); };
  };
  const double read = pole.read([&](double at) { return x(0)(at) * y(0)(at); }, t);
  double rate[2];
  for (int p : {0, 1})
    rate[p] = p == 0 ? pole.read(x(1), t) - bending.skewed() * pole.read(x(2), t)
                     : pole.read(y(1), t) - bending.skewed() * pole.read(y(2), t);
  const double told = pole.read(x(0), t) * pole.read(y(0), t) + bending.averaged() * rate[0] * rate[1];
  EXPECT_NEAR(told, read, 4.0 * std::pow(pole.tau, 4.0) + 1e-6);
}

// Gravity of a body that swings about an axis, its turning as the sensor read it.
TEST_P(Bends, AndGravity) {
  const OnePole& pole = GetParam();
  const Late late({pole.s(), pole.kappa(), 1.0});
  const Vector3 axis = Vector3(1, 2, 3).normalized();
  const double t = 0.4;
  const auto R = [&](double at) {
    return Matrix3(Eigen::AngleAxisd(-0.8 * std::sin(at), axis).toRotationMatrix());
  };
  const auto turn = [&](int p) {
    return 0.8 * pole.read([p](double at) { return std::sin(at + 0.5 * kPi * (p + 1)); }, t);
  };
  Vector6 nu = Vector6::Zero(), a = Vector6::Zero();
  nu.tail<3>() = turn(0) * axis;
  a.tail<3>() = turn(1) * axis;
  const Vector3 jerk = turn(2) * axis;
  const Vector3 read = pole.read([&](double at) { return Vector3(R(at) * late.rig.gravity); }, t);
  const Vector3 told = late.gravity(0.0, 0.0).felt(R(t), nu, a, jerk);
  EXPECT_LT((told - read).norm(), late.rig.gravity.norm() * (4.0 * std::pow(pole.s(), 4.0) + 1e-6));
}

// The wrench of what two joints carry in gravity, their positions as the sensor read them.
TEST_P(Bends, AndTheWrenchOfAnArm) {
  const OnePole& pole = GetParam();
  const Late late({pole.s(), pole.kappa(), 1.0});
  Chain arm;
  arm.xi = {Vector6(0.0, 0.0, 0.0, 0.0, 0.0, 1.0), Vector6(-0.5, 0.0, 0.0, 0.0, 1.0, 0.0)};
  arm.p = Vector3(0.3, 0.1, 0.8);
  const double rate[2] = {1.0, 0.7}, size[2] = {0.8, 0.6}, phase[2] = {0.3, 1.1};
  // p-th derivatives, as they are or as one pole reads them
  const auto joints = [&](double t, int p, bool read) {
    RowMatrix q(1, 2);
    for (int j = 0; j < 2; ++j) {
      const double lag = read ? rate[j] * pole.late + std::atan(rate[j] * pole.tau) : 0.0,
                   gain = read ? 1.0 / std::hypot(1.0, rate[j] * pole.tau) : 1.0;
      q(0, j) =
          size[j] * gain * std::pow(rate[j], p) * std::sin(rate[j] * t + phase[j] - lag + 0.5 * kPi * p);
    }
    return q;
  };
  RecordedLog log;
  log.source = Source::mapped;
  log.payload.mass = 4.0;
  log.payload.center_of_mass = {0.05, -0.02, 0.1};
  log.payload.inertia = Vector3(0.04, 0.05, 0.02).asDiagonal();
  log.map = [&](const Eigen::VectorXd&, const RowMatrix& q, const RowMatrix& qd, const RowMatrix& qdd,
                bool jacobian, MappedMotion& out) {
    ASSERT_EQ(chain_motion(arm, q, qd, qdd, {}, true, jacobian, out), Status::ok);
  };
  log.time = Eigen::VectorXd::LinSpaced(3, 1.0, 2.0);
  log.raw = RowMatrix::Zero(3, 6);
  log.motion.resize(1);
  log.motion[0].time = log.time;
  log.motion[0].value = RowMatrix::Zero(3, 2);
  log.motion[0].sigma = Eigen::VectorXd::Ones(2);
  log.motion[0].group = Eigen::VectorXi::Zero(2);
  Stretch stretch(log, late.rig, 0.0, 3.0, 0.01, 0.05);
  Eigen::MatrixXd basis = Eigen::MatrixXd::Zero(600, stretch.spline.size()), q(600, 2);
  for (int k = 0; k < 600; ++k) {
    double u = 0.0;
    const Eigen::Index at = stretch.spline.locate(0.005 * k, u);
    const Basis b = stretch.spline.basis(u, 0);
    for (int l = 0; l < kLocal; ++l) basis(k, at + l) = b[static_cast<std::size_t>(l)];
    q.row(k) = joints(0.005 * k, 0, true);
  }
  stretch.c = basis.householderQr().solve(q);
  const Layout layout(late.rig, {&log}, {});
  const Columns columns = layout.in_theta(0);
  Eigen::VectorXd theta = layout.mean();
  theta[columns.clock[0]] = pole.s();
  theta[columns.clock[0] + 1] = pole.kappa();
  stretch.predict(columns, theta, late.rig.nominal, false);
  const auto wrench = [&](double t, bool read) {
    MappedMotion m;
    EXPECT_EQ(
        chain_motion(arm, joints(t, 0, read), joints(t, 1, read), joints(t, 2, read), {}, true, false, m),
        Status::ok);
    const Matrix3 R = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(m.R_sensor_root.data());
    return oracle::wrench(log.payload.mass, log.payload.center_of_mass, log.payload.inertia, Vector3::Zero(),
                          m.nu.row(0).transpose(), m.a.row(0).transpose(), R * late.rig.gravity);
  };
  for (Eigen::Index k = 0; k < 3; ++k) {
    const Vector6 truth = pole.read([&](double at) { return Vector6(wrench(at, false)); }, log.time[k]);
    const double error = (stretch.now.w.row(k).transpose() - truth).norm();
    EXPECT_LT(error, truth.norm() * (2.0 * std::pow(pole.tau, 4.0) + 1e-6));
    EXPECT_LT(error, 0.2 * (wrench(log.time[k], true) - truth).norm());  // of the mean motion
  }
}

INSTANTIATE_TEST_SUITE_P(Filters, Bends,
                         testing::Values(OnePole{0.0, 0.1}, OnePole{0.05, 0.1}, OnePole{0.1, 0.05}));

}  // namespace
}  // namespace truewrench
