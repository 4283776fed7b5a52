// The normal equations of a window against the dense Jacobian of residuals written out here.
#include "truewrench/push.hpp"
#include "truewrench/window.hpp"

#include "truewrench/spatial.hpp"

#include "oracles.hpp"

#include <gtest/gtest.h>

#include <numeric>

namespace truewrench {
namespace {

constexpr double missing = std::numeric_limits<double>::quiet_NaN();
constexpr int one_sample_a_block = 1 << 20;

// One window full of everything: uneven knots and stamps, a twist and its derivative logged apart from the
// sensor, missing components, gravity per sample, a twist of another point than the centre of mass.
struct Scene {
  int channels = 6;
  bool offset = true;
  bool extras = false;  // payload, temperature and clock as well
  bool about = false;   // about a reference motion, with a covariance and a coupling per sample
  Payload payload{3.0, Vector3(0.1, -0.2, 0.15), Vector3(0.3, 0.2, 0.4).asDiagonal()};
  Vector3 point = Vector3(-0.3, 0.2, 0.1);
  std::vector<double> breakpoints{0.0, 0.3, 0.45, 1.0};
  std::vector<double> twist_time, rate_time, sensor_time;
  RowMatrix twist, rate, raw, gravity;
  Vector6 twist_sigma = Vector6(0.01, 0.02, 0.03, 0.04, 0.05, 0.06);
  Vector6 rate_sigma = Vector6(0.5, 0.4, 0.3, 0.2, 0.6, 0.7);
  Vector6 wrench_scale = -Vector6(20, 30, 40, 2, 3, 4).cwiseInverse();
  Eigen::VectorXd channel, sensor_sigma, temperature;
  std::vector<double> reference_breakpoints{-0.2, 0.1, 0.5, 0.8, 1.3};
  Coefficients reference_twist;
  RowMatrix covariance, coupling;  // 6 x 6 in a row, of the twist's samples and those of the rate
  Coefficients x;
  Eigen::VectorXd theta;

  Scene(int n, bool with_offset, bool with_extras = false, bool about_reference = false)
      : channels(n), offset(with_offset), extras(with_extras), about(about_reference) {
    std::mt19937 random(17);
    std::uniform_real_distribution<double> time(0.0, 1.0);
    payload.inertia += 0.05 * (Matrix3::Ones() - Matrix3::Identity());
    const auto stamps = [&](std::vector<double>& t, int count) {
      for (int k = 0; k < count; ++k) t.push_back(time(random));
      std::sort(t.begin(), t.end());
    };
    stamps(twist_time, 23);
    stamps(rate_time, 11);
    stamps(sensor_time, 31);
    twist = oracle::normal_matrix(random, 23, 6);
    rate = oracle::normal_matrix(random, 11, 6);
    raw = 3.0 * oracle::normal_matrix(random, 31, n);
    gravity = 9.81 * oracle::normal_matrix(random, 31, 3).rowwise().normalized();
    channel = Eigen::VectorXd::LinSpaced(n, 2.0, 5.0);
    sensor_sigma = Eigen::VectorXd::LinSpaced(n, 0.01, 0.04);
    x = oracle::normal_matrix(random, static_cast<Eigen::Index>(breakpoints.size()) + 4, 6);
    theta = oracle::normal_matrix(random, layout().size(), 1);
    if (extras) {
      theta.segment<kPayloadParameters>(layout().payload_begin()) *= 0.05;
      theta[layout().time_offset_begin()] = 0.013;
      for (double& t : sensor_time) t = 0.05 + 0.9 * t;  // stays inside the window when shifted
      temperature = oracle::normal_matrix(random, 31, 1);
    }
    for (const auto& [row, column] : {std::pair(2, 1), {2, 5}, {9, 0}, {10, 0}}) twist(row, column) = missing;
    rate.row(4).setConstant(missing);
    for (const auto& [row, column] : {std::pair(0, 3), {7, 0}, {7, 5}, {30, n - 1}})
      raw(row, column) = missing;
    raw.row(12).setConstant(missing);
    if (!about) return;
    reference_twist = oracle::normal_matrix(random, 9, 6);
    covariance.resize(23, 36);
    for (Eigen::Index k = 0; k < 23; ++k) {
      const Matrix6 l = Matrix6::Identity() + 0.3 * oracle::normal_matrix(random, 6, 6);
      const Matrix6 c = 1e-3 * l * l.transpose();
      covariance.row(k) = Eigen::Map<const Eigen::Matrix<double, 1, 36>>(c.data());
      if (twist.row(k).hasNaN()) twist.row(k).setConstant(missing);  // a row is whole or missing
    }
    coupling = oracle::normal_matrix(random, 11, 36);
  }

  double delay() const { return extras ? theta[layout().time_offset_begin()] : 0.0; }

  ParameterLayout layout() const {
    ParameterLayout l;
    l.channels = channels;
    l.offset = offset;
    l.payload = l.temperature = l.time_offset = extras;
    return l;
  }

  LogData data() const {
    LogData d;
    d.payload = payload;
    d.point = point;
    d.motion.push_back({0, twist_time, twist.data(), twist_sigma});
    d.motion.push_back({1, rate_time, rate.data(), rate_sigma});
    if (about) {
      d.motion[0].covariance = covariance.data();
      d.motion[1].coupling = coupling.data();
      d.reference.emplace(reference_breakpoints, reference_twist, 1.0);
    }
    d.wrench = {sensor_time, raw.data(), extras ? temperature.data() : nullptr};
    if (!extras) d.gravity = {sensor_time, gravity.data(), Vector3::Zero()};
    return d;
  }

  WindowRange window() const {
    return {0.0, 1.0, {{0, twist_time.size()}, {0, rate_time.size()}}, {0, sensor_time.size()}};
  }

  // A body displaced by p from the reference: its twist, the derivative of that, and gravity in its axes.
  void displace(double t, Vector6& p, Vector6& dp, const Vector6& ddp, Vector3& g) const {
    const Vector6 nu = reference_twist.transpose() * oracle::basis(reference_breakpoints, t, 0);
    const Vector6 a = reference_twist.transpose() * oracle::basis(reference_breakpoints, t, 1);
    const auto bracket = [](const Vector6& b, const Vector6& c) {  // of two twists
      const Vector3 v = b.head<3>(), omega = b.tail<3>(), u = c.head<3>(), phi = c.tail<3>();
      Vector6 out;
      out << omega.cross(u) + v.cross(phi), omega.cross(phi);
      return out;
    };
    g += g.cross(Vector3(p.tail<3>()));
    const Vector6 twist_there = nu + bracket(nu, p) + dp;
    dp = a + bracket(a, p) + bracket(nu, dp) + ddp;
    p = twist_there;
  }

  // Every residual over its sigma, as a function of motion and common parameters.
  Eigen::VectorXd residuals(const Coefficients& at_x, const Eigen::VectorXd& at_theta,
                            bool sensor = true) const {
    std::vector<double> r;
    const auto motion = [&](const std::vector<double>& t, const RowMatrix& value, const Vector6& sigma,
                            int order) {
      for (std::size_t k = 0; k < t.size(); ++k) {
        const auto row = static_cast<Eigen::Index>(k);
        Vector6 s = at_x.transpose() * oracle::basis(breakpoints, t[k], order);
        if (about && order == 1) {
          for (int c = 0; c < 6; ++c) {
            s[c] += coupling.row(row).segment<6>(6 * c).dot(at_x.transpose() *
                                                            oracle::basis(breakpoints, t[k], 0));
          }
        }
        Vector6 whitened = (value.row(row).transpose() - s).cwiseQuotient(sigma);
        if (about && order == 0) {
          const Matrix6 c = Eigen::Map<const Matrix6>(covariance.data() + 36 * k);
          whitened = c.llt().matrixL().solve(Vector6(value.row(row).transpose() - s));
        }
        for (int c = 0; c < 6; ++c) {
          if (!std::isnan(whitened[c])) r.push_back(whitened[c]);
        }
      }
    };
    motion(twist_time, twist, twist_sigma, 0);
    motion(rate_time, rate, rate_sigma, 1);
    const ParameterLayout at = layout();
    double delay = 0.0;
    double mass = payload.mass;
    Vector3 center = payload.center_of_mass;
    Matrix3 inertia = payload.inertia;
    if (extras) {
      const Eigen::VectorXd p = at_theta.segment<kPayloadParameters>(at.payload_begin());
      delay = at_theta[at.time_offset_begin()];
      mass *= 1.0 + p[0];
      center += p.segment<3>(1);
      Matrix3 relative;
      relative << p[4], p[7], p[8], p[7], p[5], p[9], p[8], p[9], p[6];
      for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
          inertia(i, j) += relative(i, j) * std::sqrt(payload.inertia(i, i) * payload.inertia(j, j));
        }
      }
    }
    for (std::size_t k = 0; sensor && k < sensor_time.size(); ++k) {
      const auto row = static_cast<Eigen::Index>(k);
      const double t = sensor_time[k] + delay;
      Vector6 s = at_x.transpose() * oracle::basis(breakpoints, t, 0);
      Vector6 ds = at_x.transpose() * oracle::basis(breakpoints, t, 1);
      Vector3 g = extras ? Vector3::Zero() : Vector3(gravity.row(row).transpose());
      if (about) displace(t, s, ds, at_x.transpose() * oracle::basis(breakpoints, t, 2), g);
      const Vector6 w = oracle::wrench(mass, center, inertia, point, s, ds, g).cwiseProduct(wrench_scale);
      for (int i = 0; i < channels; ++i) {
        double expected = at_theta.segment<6>(6 * i).dot(w);
        if (offset) expected += at_theta[at.offset_begin() + i];
        if (extras) expected += at_theta[at.temperature_begin() + i] * temperature[row];
        if (!std::isnan(raw(row, i))) r.push_back((raw(row, i) / channel[i] - expected) / sensor_sigma[i]);
      }
    }
    return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
  }

  // d(residuals)/d[x row by row, theta]. At most quadratic in each unknown but the time offset: central differences
  // are exact for the others.
  Eigen::MatrixXd jacobian(bool sensor = true) const {
    const Eigen::Index motion = x.size();
    Eigen::MatrixXd j(residuals(x, theta, sensor).size(), motion + theta.size());
    for (Eigen::Index k = 0; k < j.cols(); ++k) {
      const auto moved = [&](double step) {
        Coefficients at_x = x;
        Eigen::VectorXd at_theta = theta;
        (k < motion ? at_x.data()[k] : at_theta[k - motion]) += step;
        return residuals(at_x, at_theta, sensor);
      };
      const double step = extras ? 1e-5 : 1.0;
      j.col(k) = 0.5 / step * (moved(step) - moved(-step));
    }
    return j;
  }
};

double relative(const Eigen::MatrixXd& found, const Eigen::MatrixXd& expected) {
  return (found - expected).norm() / expected.norm();
}

template <int N>
void expect_dense_normal_equations(const Scene& scene, double rounding = 1.0, double freedom = 0.0) {
  const LogData data = scene.data();
  const SensorScale<N> sensor{scene.channel, scene.sensor_sigma, scene.wrench_scale};
  const WindowModel<N> model(data, sensor, scene.layout());
  const BSpline spline(scene.breakpoints);
  Blocks<N> blocks;
  blocks.build(model, scene.window(), spline, one_sample_a_block, scene.delay(), scene.delay());
  WindowNormal<N> normal;

  const Eigen::VectorXd r = scene.residuals(scene.x, scene.theta);
  const Eigen::MatrixXd j = scene.jacobian();
  const Eigen::Index m = scene.x.size();
  const Eigen::Index p = scene.theta.size();
  Eigen::VectorXd weight = Eigen::VectorXd::Ones(r.size());
  if (freedom > 0.0) {
    for (Eigen::Index k = scene.residuals(scene.x, scene.theta, false).size(); k < r.size(); ++k) {
      weight[k] = (freedom + 1.0) / (freedom + r[k] * r[k]);
    }
  }
  const Eigen::MatrixXd h = j.transpose() * weight.asDiagonal() * j;
  const Eigen::VectorXd g = -j.transpose() * weight.asDiagonal() * r;
  const Eigen::MatrixXd hxx = h.topLeftCorner(m, m);
  const Eigen::LLT<Eigen::MatrixXd> factor(hxx);

  normal.assemble(model, blocks, spline, scene.x, scene.theta, Terms::all, true, freedom);
  EXPECT_NEAR(normal.cost(), r.dot(weight.asDiagonal() * r), 1e-10 * r.squaredNorm());
  EXPECT_LT(relative(normal.information(), h.bottomRightCorner(p, p)), 1e-11 * rounding);
  EXPECT_LT(relative(normal.score(), g.tail(p)), 1e-11 * rounding);

  ASSERT_EQ(normal.reduce(), Status::ok);
  const Eigen::MatrixXd schur =
      h.bottomRightCorner(p, p) - h.bottomLeftCorner(p, m) * factor.solve(h.topRightCorner(m, p));
  const Eigen::VectorXd score = g.tail(p) - h.bottomLeftCorner(p, m) * factor.solve(g.head(m));
  EXPECT_LT(relative(normal.information(), schur), 1e-9 * rounding);
  EXPECT_LT(relative(normal.score(), score), 1e-9 * rounding);
  EXPECT_EQ(normal.information(), normal.information().transpose());

  const auto flat = [](const Coefficients& c) {
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(c.data(), c.size()));
  };
  const Eigen::VectorXd held = factor.solve(g.head(m));
  EXPECT_LT(relative(flat(normal.motion_step({})), held), 1e-9 * rounding);
  EXPECT_NEAR(normal.motion_decrement(), g.head(m).dot(held), 1e-9 * std::abs(g.head(m).dot(held)));
  // The step of motion and common parameters together is that of the dense system, here with a unit prior.
  Eigen::MatrixXd with_prior = h;
  with_prior.diagonal().tail(p).array() += 1.0;
  const Eigen::VectorXd dense = with_prior.llt().solve(g);
  const Eigen::VectorXd dtheta =
      (normal.information() + Eigen::MatrixXd::Identity(p, p)).llt().solve(normal.score());
  EXPECT_LT(relative(dtheta, dense.tail(p)), 1e-7 * rounding);
  EXPECT_LT(relative(flat(normal.motion_step(dtheta)), dense.head(m)), 1e-7 * rounding);

  const MotionNormal covariance = normal.covariance_band();
  const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(m, m));
  for (int a = 0; a < spline.coefficients(); ++a) {
    for (int b = std::max(0, a - kDegree); b <= a; ++b) {
      EXPECT_LT((covariance(a, b) - inverse.block<6, 6>(6 * a, 6 * b)).norm(), 1e-9 * inverse.norm());
    }
  }

  // Without the common parameters the motion's part is the same.
  normal.assemble(model, blocks, spline, scene.x, scene.theta, Terms::all, false, freedom);
  ASSERT_EQ(normal.reduce(), Status::ok);
  EXPECT_LT(relative(flat(normal.motion_step({})), held), 1e-9 * rounding);
}

TEST(WindowNormal, SixChannelsAndOffsetGiveTheDenseNormalEquations) {
  expect_dense_normal_equations<6>(Scene(6, true));
}

TEST(WindowNormal, StudentsNoiseWeighsTheSensorAlone) {
  expect_dense_normal_equations<6>(Scene(6, true), 1e2, 4.0);
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(8, true), 1e2, 1.0);
}

// What a constant push of samples [first, last), on all channels or on one, lowers the dense cost by, with a unit prior on
// the common parameters whose optimum they are.
template <int N>
void expect_dense_push(const Scene& scene, std::size_t first, std::size_t last, double rounding = 1.0) {
  const LogData data = scene.data();
  const SensorScale<N> sensor{scene.channel, scene.sensor_sigma, scene.wrench_scale};
  const WindowModel<N> model(data, sensor, scene.layout());
  WindowFit fit;
  fit.spline = BSpline(scene.breakpoints);
  fit.x = scene.x;
  fit.theta = scene.theta;
  Blocks<N> blocks;
  blocks.build(model, scene.window(), fit.spline, one_sample_a_block, scene.delay(), scene.delay());
  WindowNormal<N> normal;
  normal.assemble(model, blocks, fit.spline, fit.x, fit.theta, Terms::all, true);
  ASSERT_EQ(normal.reduce(), Status::ok);
  const Eigen::Index m = scene.x.size(), p = scene.theta.size(), n = scene.channels;
  const Eigen::MatrixXd prior = Eigen::MatrixXd::Identity(p, p);
  const Eigen::MatrixXd covariance = (normal.information() + prior).inverse();

  const Eigen::VectorXd r = scene.residuals(scene.x, scene.theta);
  Eigen::MatrixXd j = Eigen::MatrixXd::Zero(r.size(), m + p + n);
  j.leftCols(m + p) = scene.jacobian();
  Eigen::Index row = scene.residuals(scene.x, scene.theta, false).size();
  for (Eigen::Index k = 0; k < scene.raw.rows(); ++k) {
    for (Eigen::Index i = 0; i < n; ++i) {
      if (std::isnan(scene.raw(k, i))) continue;
      const auto sample = static_cast<std::size_t>(k);
      j(row++, m + p + i) = first <= sample && sample < last ? -1.0 : 0.0;
    }
  }
  Eigen::MatrixXd h = j.transpose() * j;
  h.block(m, m, p, p) += prior;
  Eigen::VectorXd g = -j.transpose() * r;
  g.segment(m, p) -= normal.score();  // what the prior pulls
  const auto decrease = [&](Eigen::Index at, Eigen::Index channels) {
    std::vector<Eigen::Index> unknowns(static_cast<std::size_t>(m + p));
    std::iota(unknowns.begin(), unknowns.end(), 0);
    for (Eigen::Index c = 0; c < channels; ++c) unknowns.push_back(m + p + at + c);
    const Eigen::VectorXd of = g(unknowns);
    return of.dot(h(unknowns, unknowns).ldlt().solve(of));
  };
  const double without = decrease(0, 0);
  const double expected = decrease(0, n) - without;
  double largest = 0.0;
  for (Eigen::Index c = 0; c < n; ++c) largest = std::max(largest, decrease(c, 1) - without);

  const PushScan<N> scan(model, fit, blocks, normal, covariance);
  const auto block = [&](std::size_t sample) {  // the first that does not lie before it
    std::size_t b = 0;
    while (b < blocks.wrench.size() && blocks.wrench[b].first < sample) ++b;
    return b;
  };
  const ShiftTest found = scan.test(block(first), block(last));
  EXPECT_EQ(found.components, n);
  EXPECT_NEAR(found.sum_of_squares / expected, 1.0, 1e-8 * rounding);
  EXPECT_NEAR(found.largest / largest, 1.0, 1e-8 * rounding);
}

TEST(PushScan, DecreaseOfTheCostIsThatOfTheDenseProblem) {
  expect_dense_push<6>(Scene(6, true), 5, 20);
  expect_dense_push<6>(Scene(6, true), 20, 27);
  expect_dense_push<6>(Scene(6, true, true), 5, 20, 1e3);
  expect_dense_push<6>(Scene(6, true, false, true), 5, 20, 1e2);
  expect_dense_push<Eigen::Dynamic>(Scene(8, true), 3, 15);
}

TEST(WindowNormal, WithoutOffsetTheGainsAlone) { expect_dense_normal_equations<6>(Scene(6, false)); }

TEST(WindowNormal, PayloadClockAndTemperatureGiveTheDenseNormalEquations) {
  // Finite differences of the time offset are exact to about 1e-8.
  expect_dense_normal_equations<6>(Scene(6, true, true), 1e4);
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(7, false, true), 1e4);
}

TEST(WindowNormal, DisplacementFromAReferenceGivesTheDenseNormalEquations) {
  expect_dense_normal_equations<6>(Scene(6, true, false, true), 1e2);
  expect_dense_normal_equations<6>(Scene(6, true, true, true), 1e4);
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(7, true, false, true), 1e2);
}

TEST(ReferenceMotion, DisplacedBodyMovesAsTheProductOfThePosesDoes) {
  // Poses by the exponential of SE(3), differentiated numerically.
  const auto pose = [](const Vector6& x) {
    Eigen::Matrix4d m = Eigen::Matrix4d::Zero();
    m.topLeftCorner<3, 3>() = cross_matrix(x.tail<3>());
    m.topRightCorner<3, 1>() = x.head<3>();
    Eigen::Matrix4d sum = Eigen::Matrix4d::Identity(), term = sum;
    for (int k = 1; k < 20; ++k) sum += term = (term * m / k).eval();
    return sum;
  };
  const Vector6 nu(0.3, -0.2, 0.5, 0.4, 0.7, -0.6);
  const Vector6 p0 = 1e-5 * Vector6(1, 2, -1, 3, -2, 1), p1 = 1e-5 * Vector6(-4, 1, 2, 2, 5, -3);
  const auto at = [&](double t) { return Eigen::Matrix4d(pose(nu * t) * pose(p0 + p1 * t)); };
  const double h = 1e-3;
  const Eigen::Matrix4d rate = at(0.0).inverse() * (at(h) - at(-h)) / (2.0 * h);
  ReferencePoint reference;
  reference.nu = nu;
  const MotionState s = reference.displaced(p0, p1, Vector6::Zero(), Vector3(0, 0, -9.81));
  // Second order in the displacement, and in the step.
  EXPECT_LT((Vector3(rate.topRightCorner<3, 1>()) - Vector3(s.nu.head<3>())).norm(), 1e-6);
  EXPECT_LT((Vector3(rate(2, 1), rate(0, 2), rate(1, 0)) - Vector3(s.nu.tail<3>())).norm(), 1e-6);
  const Eigen::Matrix3d turned = pose(p0).topLeftCorner<3, 3>();
  EXPECT_LT((turned.transpose() * Vector3(0, 0, -9.81) - s.gravity).norm(), 1e-8);
  EXPECT_GT((s.nu - nu - p1).norm(), 5e-6);  // which the bracket gives
}

TEST(WindowNormal, EightGaugesGiveTheDenseNormalEquations) {
  expect_dense_normal_equations<Eigen::Dynamic>(Scene(8, true));
}

TEST(WindowNormal, MotionTermsAloneLeaveTheSensorOut) {
  const Scene scene(6, true);
  const LogData data = scene.data();
  const SensorScale<6> sensor{scene.channel, scene.sensor_sigma, scene.wrench_scale};
  const WindowModel<6> model(data, sensor, scene.layout());
  const BSpline spline(scene.breakpoints);
  Blocks<6> blocks;
  blocks.build(model, scene.window(), spline, one_sample_a_block, 0.0, 0.0);
  WindowNormal<6> normal;
  normal.assemble(model, blocks, spline, scene.x, scene.theta, Terms::motion, false);
  const Eigen::VectorXd r = scene.residuals(scene.x, scene.theta, false);
  EXPECT_NEAR(normal.cost(), r.squaredNorm(), 1e-10 * r.squaredNorm());
  ASSERT_EQ(normal.reduce(), Status::ok);
  // Linear: one step is the least-squares spline, where the gradient is zero.
  Scene solved = scene;
  solved.x += normal.motion_step({});
  const Eigen::VectorXd gradient = scene.jacobian(false).leftCols(scene.x.size()).transpose() *
                                   solved.residuals(solved.x, scene.theta, false);
  const Eigen::VectorXd before = scene.jacobian(false).leftCols(scene.x.size()).transpose() * r;
  EXPECT_LT(gradient.norm(), 1e-9 * before.norm());
}

TEST(WindowNormal, MotionThatNoStreamDeterminesIsReported) {
  Scene scene(6, true);
  scene.twist.col(4).setConstant(missing);
  scene.rate.col(4).setConstant(missing);
  const LogData data = scene.data();
  const SensorScale<6> sensor{scene.channel, scene.sensor_sigma, scene.wrench_scale};
  const WindowModel<6> model(data, sensor, scene.layout());
  const BSpline spline(scene.breakpoints);
  Blocks<6> blocks;
  blocks.build(model, scene.window(), spline, one_sample_a_block, 0.0, 0.0);
  WindowNormal<6> normal;
  normal.assemble(model, blocks, spline, scene.x, scene.theta, Terms::motion, false);
  EXPECT_EQ(normal.reduce(), Status::not_factorizable);
}

// 480 samples in one second, of a motion that the spline holds exactly.
struct Averaged {
  Scene scene{6, true};

  explicit Averaged(bool noise) {
    scene.breakpoints = {0.0, 0.25, 0.5, 0.75, 1.0};
    std::mt19937 random(2);
    scene.x = oracle::normal_matrix(random, 9, 6);
    scene.rate_time.clear();
    scene.twist_time.clear();
    scene.sensor_time.clear();
    for (int k = 0; k < 480; ++k) {
      scene.twist_time.push_back((k + 0.5) / 480.0);
      scene.sensor_time.push_back((k + 0.5) / 480.0);
    }
    scene.twist =
        (noise ? 1.0 : 0.0) * oracle::normal_matrix(random, 480, 6) * scene.twist_sigma.asDiagonal();
    scene.raw = (noise ? 1.0 : 0.0) * oracle::normal_matrix(random, 480, 6) *
                scene.channel.cwiseProduct(scene.sensor_sigma).asDiagonal();
    scene.gravity.resize(480, 3);
    for (Eigen::Index k = 0; k < 480; ++k) {
      const double t = scene.sensor_time[static_cast<std::size_t>(k)];
      scene.gravity.row(k) = 9.81 * Eigen::RowVector3d(std::sin(t), std::cos(t), 0.0);
      const Vector6 s = scene.x.transpose() * oracle::basis(scene.breakpoints, t, 0);
      const Vector6 ds = scene.x.transpose() * oracle::basis(scene.breakpoints, t, 1);
      const Vector6 w =
          oracle::wrench(scene.payload.mass, scene.payload.center_of_mass, scene.payload.inertia, scene.point,
                         s, ds, scene.gravity.row(k).transpose())
              .cwiseProduct(scene.wrench_scale);
      scene.twist.row(k) += s;
      for (int i = 0; i < 6; ++i) {
        scene.raw(k, i) += scene.channel[i] * (scene.theta.segment<6>(6 * i).dot(w) + scene.theta[36 + i]);
      }
    }
  }

  struct Sums {
    double cost;
    Eigen::MatrixXd information;
    Eigen::VectorXd score;
  };
  Sums sums(int per_interval) const {
    const LogData data = scene.data();
    const SensorScale<6> sensor{scene.channel, scene.sensor_sigma, scene.wrench_scale};
    const WindowModel<6> model(data, sensor, scene.layout());
    const BSpline spline(scene.breakpoints);
    Blocks<6> blocks;
    blocks.build(model, scene.window(), spline, per_interval, 0.0, 0.0);
    WindowNormal<6> normal;
    normal.assemble(model, blocks, spline, scene.x, scene.theta, Terms::all, true);
    EXPECT_EQ(normal.reduce(), Status::ok);
    return {normal.cost(), normal.information(), normal.score()};
  }
};

TEST(Blocks, MeanWrenchIsRightToTheFourthOrderOfTheBlockLength) {
  const Averaged log(false);
  EXPECT_LT(log.sums(one_sample_a_block).cost, 1e-18);
  const double coarse = log.sums(5).cost;
  const double middle = log.sums(10).cost;
  const double fine = log.sums(20).cost;
  // Residuals of fourth order, squared.
  EXPECT_NEAR(std::log2(coarse / middle), 8.0, 1.0);
  EXPECT_NEAR(std::log2(middle / fine), 8.0, 1.0);
  EXPECT_LT(log.sums(12).cost, 0.05);  // of a chi-square whose expectation is one per degree of freedom
}

TEST(Blocks, InformationLostByAveragingIsOfSecondOrder) {
  const Averaged log(false);
  const Eigen::MatrixXd exact = log.sums(one_sample_a_block).information;
  const double coarse = relative(log.sums(10).information, exact);
  const double fine = relative(log.sums(20).information, exact);
  EXPECT_LT(fine, 0.02);
  EXPECT_NEAR(std::log2(coarse / fine), 2.0, 0.5);
}

TEST(Blocks, StepFromNoisySamplesIsThatOfTheSamplesToAFractionOfSigma) {
  const Averaged log(true);
  const auto step = [](const Averaged::Sums& s) {
    const Eigen::MatrixXd prior = Eigen::MatrixXd::Identity(s.score.size(), s.score.size()) / (0.3 * 0.3);
    return Eigen::VectorXd((s.information + prior).llt().solve(s.score));
  };
  const Averaged::Sums exact = log.sums(one_sample_a_block);
  const Eigen::VectorXd d = step(log.sums(12)) - step(exact);
  const Eigen::VectorXd sigma =
      (exact.information + Eigen::MatrixXd::Identity(42, 42) / 0.09).inverse().diagonal().cwiseSqrt();
  EXPECT_LT((d.cwiseQuotient(sigma)).cwiseAbs().maxCoeff(), 0.5);
}

TEST(Blocks, MissingComponentsAreMissingInTheInformationToo) {
  Averaged log(true);
  for (int k = 100; k < 140; ++k) log.scene.raw(k, 2) = log.scene.twist(k, 4) = missing;
  const Averaged::Sums averaged = log.sums(12);
  const Averaged::Sums exact = log.sums(one_sample_a_block);
  EXPECT_LT(relative(averaged.information, exact.information), 0.02);
  EXPECT_LT(relative(averaged.information, Averaged(true).sums(12).information), 0.2);
  EXPECT_GT(relative(averaged.information, Averaged(true).sums(12).information), 0.02);
}

}  // namespace
}  // namespace truewrench
