// The sweep against dense algebra with Jacobians by differences: one sample an interval, so that the interval's mean Jacobian is
// the sample's and H is exact.
#include "truewrench/estimation/sweep.hpp"

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include <cmath>
#include <limits>
#include <random>

namespace truewrench {
namespace {

struct Case {
  Statement rig;
  RecordedLog log;
  Layout layout;
  Stretch stretch;
  Sizes sizes;
  Eigen::VectorXd theta;
  RowMatrix lagged;

  const Columns& columns() const { return layout.log(0); }
  void predict() { stretch.predict(columns(), theta, lagged, sizes.form != Form::none); }

  // Rows by the square roots of their information, then those of the priors of c and e.
  Eigen::VectorXd whitened() {
    predict();
    const MotionRows& m = stretch.motion[0];
    std::vector<double> r;
    for (Eigen::Index k = 0; k < m.rows(); ++k)
      for (int j = 0; j < 6; ++j)
        r.push_back(std::sqrt(m.size[k]) * m.residual(k, j) /
                    (log.motion[0].sigma[j] * sizes.motion_factor[0][log.motion[0].group[j]]));
    for (Eigen::Index k = 0; k < stretch.raw.rows(); ++k)
      for (int i = 0; i < 6; ++i)
        r.push_back(std::sqrt(stretch.raw.weight[k]) * stretch.now.residual(k, i) /
                    (rig.noise[i] * sizes.raw_factor[raw_group(i, 6)]));
    return Eigen::Map<Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size()));
  }
};

Case make(bool bias) {
  Case c;
  std::mt19937 engine(3);
  std::normal_distribution<double> normal;
  const auto fill = [&](auto& m, double size) {
    for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = size * normal(engine);
  };
  c.rig.range << 500, 500, 500, 50, 50, 50;
  c.rig.noise = Eigen::VectorXd::Constant(6, 1e-3);
  c.rig.nominal = RowMatrix::Identity(6, 6);
  c.rig.offset_prior = Eigen::VectorXd::Constant(6, 0.1);
  c.rig.gravity << 0.5, 0.3, -9.7;
  c.rig.tilt_prior = 0.01;
  c.rig.body_prior.emplace_back(Eigen::Matrix<double, 10, 1>::Constant(0.01));
  c.log.payload = {5.0, Vector3(0.02, 0.03, 0.1), Vector3(0.04, 0.03, 0.02).asDiagonal()};
  c.log.point = Vector3(0.01, 0.02, 0.03);
  constexpr Eigen::Index K = 15;
  const double h = 0.05;
  c.log.time = Eigen::VectorXd::LinSpaced(K, 0.0, h * (K - 1));
  c.log.raw.resize(K, 6);
  fill(c.log.raw, 0.1);
  c.log.raw(4, 2) = c.log.raw(9, 0) = std::numeric_limits<double>::quiet_NaN();
  c.log.R_sensor_root.resize(K, 9);
  for (Eigen::Index k = 0; k < K; ++k) {
    const Matrix3 R =
        Eigen::AngleAxisd(0.3 * static_cast<double>(k), Vector3(1, 2, 3).normalized()).toRotationMatrix();
    for (int i = 0; i < 9; ++i) c.log.R_sensor_root(k, i) = R(i / 3, i % 3);
  }
  MotionStream m;
  m.time = Eigen::VectorXd::LinSpaced(2 * K, 0.0, h * (K - 1));
  m.value.resize(2 * K, 6);
  fill(m.value, 0.3);
  m.size = Eigen::VectorXd::LinSpaced(2 * K, 1.0, 4.0);  // rows that stand for several samples
  m.remainder = RowMatrix::Zero(2 * K, 6);
  m.value(7, 3) = std::numeric_limits<double>::quiet_NaN();
  m.sigma = Eigen::VectorXd::Constant(6, 0.01);
  m.group.resize(6);
  m.group << 0, 0, 0, 1, 1, 1;
  m.time_offset_prior = 0.002;
  m.half_window = 0.04;
  if (bias) m.bias_prior = Eigen::VectorXd::Constant(6, 0.1);
  c.log.motion.push_back(m);
  return c;
}

// What refers to the log and the rig, once they stand where they stay.
void settle(Case& c, Form form) {
  std::mt19937 engine(5);
  std::normal_distribution<double> normal;
  c.layout = Layout(c.rig, {&c.log}, {{0.31}});
  c.stretch = Stretch(c.log, c.rig, 0.0, c.log.time[c.log.time.size() - 1], 0.05, 0.05);
  c.sizes.raw_factor = Eigen::Vector2d(1.1, 0.9);
  c.sizes.motion_factor = {Eigen::Vector2d(0.8, 1.3)};
  c.sizes.q = Eigen::VectorXd::LinSpaced(6, 1e2, 1e3);
  c.sizes.delta = Eigen::Vector2d(2e-3, 1e-3);
  c.sizes.k = 3.0;
  c.sizes.form = form;
  c.theta = c.layout.mean();
  for (Eigen::Index i = 0; i < c.theta.size(); ++i) c.theta[i] += 0.01 * normal(engine);
  c.theta[c.columns().clock[0]] = 0.0;  // what (10.5) leaves out is of first order in it
  c.theta[c.columns().clock[0] + 1] =
      0.51;  // below 1/2 the sensor averages products, which steps follow late
  c.lagged = c.rig.nominal;
  for (Eigen::Index i = 0; i < c.stretch.c.size(); ++i) c.stretch.c.data()[i] = 0.3 * normal(engine);
  for (Eigen::Index i = 0; i < c.stretch.e.size(); ++i)
    c.stretch.e.data()[i] = form == Form::none ? 0.0 : 1e-3 * normal(engine);
  for (Eigen::Index k = 0; k < c.stretch.raw.rows(); ++k)
    c.stretch.raw.weight[k] = k == 6 ? 0.0 : 0.5 + 0.1 * static_cast<double>(k % 4);
}

class SweepOf : public testing::TestWithParam<std::pair<Form, bool>> {};

TEST_P(SweepOf, DenseAlgebra) {
  const auto [form, bias] = GetParam();
  Case c = make(bias);
  if (form == Form::bridge) c.log.offset_knots = {0.0, 0.3, 0.7};
  settle(c, form);
  const bool d = form != Form::none;
  const Eigen::Index N = c.stretch.spline.size(), nc = 6 * N, nx = d ? 2 * nc : nc, nt = c.theta.size();
  // [x, theta], x = [c, e] row by row
  const auto variable = [&](Eigen::Index v) -> double& {
    return v < nc ? c.stretch.c.data()[v] : v < nx ? c.stretch.e.data()[v - nc] : c.theta[v - nx];
  };
  const Eigen::VectorXd r = c.whitened();
  Eigen::MatrixXd J(r.size(), nx + nt);
  for (Eigen::Index v = 0; v < nx + nt; ++v) {
    double& x = variable(v);
    const double was = x, step = 1e-5;
    x = was + step;
    const Eigen::VectorXd plus = c.whitened();
    x = was - step;
    J.col(v) = -(plus - c.whitened()) / (2.0 * step);
    x = was;
  }
  const Eigen::Index motion = 6 * c.stretch.motion[0].rows(), raw = r.size() - motion;
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(nx + nt, nx + nt);
  Eigen::MatrixXd smoothness[6];
  const Gram R3 = c.stretch.spline.smoothness(3).inside;
  const Penalty RM = d ? c.stretch.spline.discrepancy(c.sizes.k, form) : Penalty{};
  for (int j = 0; j < 6; ++j) {
    smoothness[j] = Eigen::MatrixXd::Zero(nx, nx);
    const double delta = c.sizes.delta[raw_group(j, 6)];
    for (Eigen::Index i = 0; i + kLocal <= N; ++i)
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l) {
          smoothness[j](6 * (i + k) + j, 6 * (i + l) + j) += R3(k, l);
          R(6 * (i + k) + j, 6 * (i + l) + j) += R3(k, l) / c.sizes.q[j];
          if (d)
            R(nc + 6 * (i + k) + j, nc + 6 * (i + l) + j) +=
                (RM.inside(k, l) + (i == 0 ? RM.start(k, l) : 0.0) + (i + kLocal == N ? RM.end(k, l) : 0.0)) /
                (delta * delta);
        }
  }
  Eigen::VectorXd x(nx + nt);
  for (Eigen::Index v = 0; v < nx + nt; ++v) x[v] = variable(v);
  const Eigen::MatrixXd H = J.transpose() * J + R;
  const Eigen::VectorXd g = J.transpose() * r - R * x;
  const Eigen::MatrixXd Hxx = H.topLeftCorner(nx, nx), Hxt = H.topRightCorner(nx, nt);
  const Eigen::MatrixXd Z = Hxx.llt().solve(Hxt);
  const Eigen::VectorXd y = Hxx.llt().solve(g.head(nx));
  const Eigen::MatrixXd S = H.bottomRightCorner(nt, nt) - Hxt.transpose() * Z;

  c.predict();
  Sweep sweep;
  const Information found = sweep.forward(c.stretch, c.columns(), c.theta, c.lagged, c.sizes);
  EXPECT_NEAR(found.logdet, 2.0 * Eigen::MatrixXd(Hxx.llt().matrixL()).diagonal().array().log().sum(), 1e-4);
  Sweep alone;
  const auto determinant = [&](Sweep& of, const Sizes& sizes, Sweep::Extent extent) {
    return of.forward(c.stretch, c.columns(), c.theta, c.lagged, sizes, extent).logdet;
  };
  EXPECT_EQ(determinant(alone, c.sizes, Sweep::Extent::determinant), found.logdet);
  Sizes rougher = c.sizes;
  rougher.q *= 3.0;
  Sweep fresh;
  const double expected = determinant(fresh, rougher, Sweep::Extent::determinant);
  EXPECT_EQ(determinant(alone, rougher, Sweep::Extent::determinant_again), expected);
  EXPECT_NE(expected, found.logdet);
  const Eigen::VectorXd scale = H.diagonal().tail(nt).cwiseMax(1e-12).cwiseSqrt();

  // what the rows of the first blocks say by themselves: dense algebra of those alone
  const std::vector<int> breaks{0, 1};
  std::vector<Information> said;
  sweep.forward(c.stretch, c.columns(), c.theta, c.lagged, c.sizes, Sweep::Extent::whole, breaks, &said);
  ASSERT_EQ(said.size(), breaks.size());
  for (std::size_t b = 0; b < breaks.size(); ++b) {
    const Eigen::Index intervals = kBlock * (breaks[b] + 1);
    Eigen::MatrixXd own = J;
    for (Eigen::Index k = 0; k < motion; ++k)
      if (c.stretch.motion[0].interval[static_cast<std::size_t>(k / 6)] >= intervals) own.row(k).setZero();
    for (Eigen::Index k = 0; k < raw; ++k)
      if (c.stretch.raw.interval[static_cast<std::size_t>(k / 6)] >= intervals) own.row(motion + k).setZero();
    Eigen::MatrixXd penalty = Eigen::MatrixXd::Zero(nx + nt, nx + nt);
    for (Eigen::Index i = 0; i < intervals; ++i)
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l)
          for (int j = 0; j < 6; ++j) {
            penalty(6 * (i + k) + j, 6 * (i + l) + j) += R3(k, l) / c.sizes.q[j];
            const double delta = c.sizes.delta[raw_group(j, 6)];
            if (d)
              penalty(nc + 6 * (i + k) + j, nc + 6 * (i + l) + j) +=
                  (RM.inside(k, l) + (i == 0 ? RM.start(k, l) : 0.0)) / (delta * delta);
          }
    Eigen::MatrixXd A = own.transpose() * own + penalty;
    const Eigen::VectorXd pull = own.transpose() * r - penalty * x;
    for (Eigen::Index i = 0; i < nx; ++i)  // knots that nothing sees
      if (A(i, i) == 0.0) A(i, i) = 1.0;
    const Eigen::MatrixXd Axt = A.topRightCorner(nx, nt), part = A.topLeftCorner(nx, nx);
    const Eigen::MatrixXd expected_S = A.bottomRightCorner(nt, nt) - Axt.transpose() * part.ldlt().solve(Axt);
    const Eigen::VectorXd expected_g = pull.tail(nt) - Axt.transpose() * part.ldlt().solve(pull.head(nx));
    EXPECT_LT(
        (scale.cwiseInverse().asDiagonal() * (said[b].S - expected_S) * scale.cwiseInverse().asDiagonal())
            .cwiseAbs()
            .maxCoeff(),
        1e-6);
    EXPECT_LT((said[b].g - expected_g).cwiseQuotient(scale).norm(),
              1e-5 * expected_g.cwiseQuotient(scale).norm());
  }
  const Eigen::MatrixXd off =
      scale.cwiseInverse().asDiagonal() * (found.S - S) * scale.cwiseInverse().asDiagonal();
  EXPECT_LT(off.cwiseAbs().maxCoeff(), 1e-6);
  EXPECT_LT((found.g - (g.tail(nt) - Hxt.transpose() * y)).cwiseQuotient(scale).norm(),
            1e-5 * g.tail(nt).cwiseQuotient(scale).norm());

  Eigen::VectorXd step(nt);
  for (Eigen::Index i = 0; i < nt; ++i) step[i] = 1e-3 * std::sin(static_cast<double>(i));
  const Eigen::VectorXd dx = y - Z * step;
  RowMatrix dc = RowMatrix::Zero(N, 6), de = dc;
  sweep.back(step, dc, de);
  EXPECT_LT((Eigen::Map<Eigen::VectorXd>(dc.data(), nc) - dx.head(nc)).norm(), 1e-5 * dx.head(nc).norm());
  if (d) {
    EXPECT_LT((Eigen::Map<Eigen::VectorXd>(de.data(), nc) - dx.tail(nc)).norm(), 1e-5 * dx.tail(nc).norm());
  }

  // the traces, theta's covariance P: theta's share within for the motion rows, apart for the sensor's, none for q
  Eigen::MatrixXd P = S;
  P.diagonal() += c.layout.sigma().cwiseMax(1e-4).cwiseAbs2().cwiseInverse();
  P = P.inverse().eval();
  const Eigen::MatrixXd known = Hxx.inverse();
  Eigen::MatrixXd full(nx + nt, nx + nt);
  full << known + Z * P * Z.transpose(), -Z * P, -P * Z.transpose(), P;
  const Traces t = sweep.traces(c.stretch, c.columns(), c.sizes, P);
  for (int group = 0; group < 2; ++group) {
    double of_motion = 0.0, of_raw = 0.0;
    for (Eigen::Index k = 0; k < motion; ++k)
      if (c.log.motion[0].group[k % 6] == group) of_motion += J.row(k) * full * J.row(k).transpose();
    for (Eigen::Index k = 0; k < raw; ++k)
      if (raw_group(static_cast<int>(k % 6), 6) == group) {
        const Eigen::VectorXd row = J.row(motion + k).head(nx);
        of_raw += row.dot(known * row);
      }
    EXPECT_NEAR(t.motion[0][group], of_motion, 1e-5 * of_motion);
    EXPECT_NEAR(t.raw[group], of_raw, 1e-5 * of_raw);
  }
  for (int j = 0; j < 6; ++j) {
    const double trace = smoothness[j].cwiseProduct(known).sum();
    EXPECT_NEAR(t.q[j], trace, 1e-5 * std::abs(trace));
    if (!d) continue;
    Gram inside = Gram::Zero();
    for (Eigen::Index i = 0; i + kLocal <= N; ++i)
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l) inside(k, l) += full(nc + 6 * (i + k) + j, nc + 6 * (i + l) + j);
    EXPECT_LT((t.inside[static_cast<std::size_t>(j)] - inside).norm(), 1e-5 * inside.norm());
  }
}

INSTANTIATE_TEST_SUITE_P(Forms, SweepOf,
                         testing::Values(std::pair{Form::none, false}, std::pair{Form::none, true},
                                         std::pair{Form::matern, false}, std::pair{Form::walk, true},
                                         std::pair{Form::bridge, true}));

}  // namespace
}  // namespace truewrench
