// Samples -> sums over one interval of knots (METHOD 9): of a sample only its residual, its gradient and its features are
// formed; an interval has one Jacobian, the mean of its samples', for H and F alike: the gradient stays exact, so the fixed
// point does not move. Where the samples' own differ from it by more than the motion's information hides, as where a light body
// turns fast under a precise sensor, the interval is cut into parts with one each: else no step comes to the fixed point.
#pragma once

#include "truewrench/estimation/stretch.hpp"
#include "truewrench/math/dense.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace truewrench {

// The sizes of one log's nuisances (METHOD 10.2), and which rows share one.
struct Sizes {
  Eigen::VectorXd raw_factor;  // on the stated noise: force and moment channels, else all together
  std::vector<Eigen::VectorXd> motion_factor;  // of each stream's groups
  Eigen::VectorXd q;                           // (M) of (10.1)
  Eigen::VectorXd delta;                       // as raw_factor: of (10.2)
  double k = 1.0;                              // 1 / tau
  Form form = Form::none;
  Eigen::VectorXd cap;  // of delta
};

inline int raw_groups(int channels) { return channels == 6 ? 2 : 1; }
inline int raw_group(int channel, int channels) { return channels == 6 && channel >= 3 ? 1 : 0; }

// p of (10.1) for a component of the motion spline (METHOD 10.1, 10.6).
inline int smoothness_order(Source source, int component) {
  if (source == Source::mapped) return 4;
  return source == Source::imu && component < 3 ? 2 : 3;
}

// q of a component by (10.6), from e^T R e and what is left of its coefficients; at least so much that the rows of R stay within
// bounds beside a sample's own: where nothing moved q would fall until nothing could be factored.
inline double smoothness_found(const RecordedLog& log, int component, double h, double energy, double left) {
  double sample = std::numeric_limits<double>::infinity();
  for (const MotionStream& m : log.motion)
    sample = std::min(sample, std::pow(m.sigma[component] * std::pow(h, m.derivative), 2.0));
  return std::max(
      energy / std::max(left, 1.0),
      constants::smoothness_least * sample * std::pow(h, 1 - 2 * smoothness_order(log.source, component)));
}

// Places of p <= q among the products of up to three derivatives.
inline constexpr std::size_t order_pair[3][3] = {{0, 1, 3}, {1, 2, 4}, {3, 4, 5}};

// Samples of one interval with the same channels.
struct RawSums {
  Gram m[6];               // [order_pair] sum of weighted products B^(p)_k B^(q)_l, row k, p <= q
  std::vector<double> J;   // (n, orders M) their mean d raw / d (x, x', x'')
  std::vector<double> v;   // (n) 1 / sigma^2, 0 where a channel is missing
  std::vector<double> SV;  // (6, n) (d raw / d w)^T V^-1
  // of a constant wrench in every channel, for scores (10.8)
  std::vector<double> basis;  // (orders, 6) sums of weighted bases
  std::vector<double> phi;    // sum of weighted features
  std::vector<double> z;      // (n) V^-1 r
  double weight = 0.0;
  int samples = 0;
};

// Sums over the samples of the sensor and of the motion, interval by interval.
class Intervals {
 public:
  int M = 6, n = 6, nt = 0, orders = 2;
  // features of a sample, phi: f = [w, 1, temperature, ramps, steps] (nf), which every channel has for itself; (C_0 w)_i^2 (n);
  // d w / d (dense parameters) (6, nd)
  int nf = 7, nd = 10, features = 0, ld = 0;
  std::vector<int> feature;        // (n, nf): columns of f
  std::vector<int> dense_columns;  // (nd)

  // of the last call of sum_raw
  std::vector<double> G;   // (6 orders + nf + 2 n, ld) weighted [B, B', (B'') ; f ; (C_0 w)^2 ; V^-1 r]^T phi
  std::vector<double> XX;  // (nd, ldx) sum of X^T Q X
  std::vector<double> left;  // (6, orders M) Q J_w
  std::vector<double> gx;    // (6, M) gradient of the motion
  std::vector<double> gd;    // (6, n) and of the discrepancy
  std::vector<double> gt;    // (nt) and of theta
  int ldx = 16;

  // `alone`: only what H_xx is made of.
  void setup(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
             const Sizes& sizes, bool alone = false) {
    M = s.components();
    n = s.channels();
    nt = columns.size();
    alone_ = alone;
    orders = s.log().source == Source::mapped ? 3 : 2;
    feature.clear();
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k < 6; ++k) feature.push_back(columns.C + 6 * i + k);
      feature.push_back(columns.b + i);
      if (columns.slope >= 0) feature.push_back(columns.slope + i);
      for (const int at : columns.ramps) feature.push_back(at + i);
      for (const int at : columns.steps) feature.push_back(at + i);
    }
    nf = static_cast<int>(feature.size()) / n;
    dense_columns.clear();
    for (int k = 0; k < kBodyParameters; ++k) dense_columns.push_back(columns.body + k);
    if (columns.gamma >= 0)
      dense_columns.insert(dense_columns.end(), {columns.clock[0], columns.clock[0] + 1, columns.gamma});
    if (columns.tilt >= 0 && s.gravity())
      dense_columns.insert(dense_columns.end(), {columns.tilt, columns.tilt + 1});
    nd = static_cast<int>(dense_columns.size());
    features = nf + n + 6 * nd;
    ld = dense::padded(features);
    ldx = dense::padded(nd);
    information_.resize(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      const double sigma = s.rig().noise[i] * sizes.raw_factor[raw_group(i, n)];
      information_[static_cast<std::size_t>(i)] = 1.0 / (sigma * sigma);
    }
    // of x in an interval, by the samples of the motion; and of the wrench, in fractions of range, by one of the sensor's
    const double h = s.spline.h();
    told_.assign(static_cast<std::size_t>(orders * M), 0.0);
    for (std::size_t i = 0; i < s.motion.size(); ++i) {
      const MotionStream& stream = s.log().motion[i];
      for (int j = 0; j < M; ++j)
        told_[static_cast<std::size_t>(j)] +=
            s.motion[i].samples[j] / static_cast<double>(s.spline.intervals()) *
            std::pow(
                stream.sigma[j] * sizes.motion_factor[i][stream.group[j]] * std::pow(h, stream.derivative),
                -2.0);
    }
    for (int p = orders - 1; p >= 0; --p)
      for (int j = 0; j < M; ++j)
        told_[static_cast<std::size_t>(p * M + j)] = told_[static_cast<std::size_t>(j)] * std::pow(h, 2 * p);
    for (int c = 0; c < 6; ++c) {
      felt_[c] = 0.0;
      for (int i = 0; i < n; ++i)
        felt_[c] += information_[static_cast<std::size_t>(i)] * theta[columns.C + 6 * i + c] *
                    theta[columns.C + 6 * i + c];
    }
    body_ = departed(s.log().payload, Stretch::body_of(columns, theta));
    root_ = s.root_gravity(columns, theta, &by_tilt_);
    C_ = theta.data() + columns.C;
    u_ = theta.data() + columns.u;
    lagged_ = lagged.data();
    next_ = 0;
    G.resize(static_cast<std::size_t>((6 * orders + nf + 2 * n) * ld + 8));
    XX.resize(static_cast<std::size_t>(nd * ldx + 8));
    left.resize(static_cast<std::size_t>(6 * orders * M));
    gx.resize(static_cast<std::size_t>(kLocal * M));
    gd.resize(static_cast<std::size_t>(kLocal * n));
    gt.assign(static_cast<std::size_t>(nt), 0.0);
    slope_.resize(static_cast<std::size_t>(6 * n));
  }

  // Calls take(sums) for every set of samples of an interval that have the same channels; intervals in their order.
  template <typename Take>
  void raw(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, Eigen::Index interval,
           std::vector<RawSums>& pool, std::size_t& used, const Take& take) {
    const auto& at = s.raw.interval;
    const Eigen::Index begin = next_;
    while (next_ < s.raw.rows() && at[static_cast<std::size_t>(next_)] == interval) ++next_;
    done_.assign(static_cast<std::size_t>(next_ - begin), 0);
    for (Eigen::Index k = begin; k < next_; ++k) {
      if (done_[static_cast<std::size_t>(k - begin)] || s.raw.weight[k] <= 0.0) continue;
      same_.clear();
      for (Eigen::Index l = k; l < next_; ++l) {
        if (done_[static_cast<std::size_t>(l - begin)] || s.raw.weight[l] <= 0.0 || !same_channels(s, k, l))
          continue;
        done_[static_cast<std::size_t>(l - begin)] = 1;
        same_.push_back(l);
      }
      const int count = static_cast<int>(same_.size()), parts = parts_of(s, columns, theta);
      for (int part = 0; part < parts; ++part) {
        first_ = count * part / parts;
        rows_.assign(same_.begin() + first_, same_.begin() + count * (part + 1) / parts);
        if (parts > 1) average(s, first_, static_cast<int>(rows_.size()));
        if (used == pool.size()) pool.emplace_back();
        RawSums& sums = pool[used++];
        sum_raw(s, columns, sums);
        take(sums);
      }
    }
  }

 private:
  std::vector<double> information_, mean_, slope_, phi_, weights_, jacobian_, X_, q_;
  Payload body_;
  Vector3 root_ = Vector3::Zero();
  Eigen::Matrix<double, 3, 2> by_tilt_;
  const double *C_ = nullptr, *u_ = nullptr, *lagged_ = nullptr;  // (n, 6), (n), (n, 6)
  Eigen::Index next_ = 0;
  std::vector<Eigen::Index> same_,
      rows_;  // of an interval with the same channels; of the part in hand, from same_[first_] on
  int first_ = 0;
  std::vector<double>
      told_;  // (orders M) information on [x, x', x''] over h^p of an interval's motion samples
  double felt_[6] = {};
  bool alone_ = false;
  std::vector<double> spread_;  // (6, orders M) sums of squares of the Jacobians about their mean
  std::vector<char> done_;

  // The Jacobians of `same_` and their mean; and into how many parts it is cut, so that what lies between those of the samples
  // and their mean is at most `jacobian_spread` of what the motion's own samples tell: it falls with the square of the parts.
  int parts_of(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta) {
    const int count = static_cast<int>(same_.size()), size = 6 * orders * M;
    jacobian_.resize(static_cast<std::size_t>(count * size));
    X_.resize(static_cast<std::size_t>(6 * count * ldx + 8));
    for (int r = 0; r < count; ++r)
      sample_jacobians(s, columns, theta, same_[static_cast<std::size_t>(r)], jacobian_.data() + r * size,
                       X_.data() + 6 * r * ldx);
    average(s, 0, count);
    double most = 0.0;
    for (int x = 0; x < orders * M; ++x) {
      double sum = 0.0;
      for (int c = 0; c < 6; ++c) sum += felt_[c] * spread_[static_cast<std::size_t>(c * orders * M + x)];
      most = std::max(most, sum / told_[static_cast<std::size_t>(x)]);
    }
    const double parts = std::ceil(std::sqrt(most / constants::jacobian_spread));
    return static_cast<int>(std::clamp(parts, 1.0, static_cast<double>(count)));
  }

  // Mean and spread of the Jacobians of same_[first ... first + count), by Welford's recursion.
  void average(const Stretch& s, int first, int count) {
    const int size = 6 * orders * M;
    mean_.assign(static_cast<std::size_t>(size), 0.0);
    spread_.assign(static_cast<std::size_t>(size), 0.0);
    double total = 0.0;
    for (int r = first; r < first + count; ++r) {
      const double* J = jacobian_.data() + r * size;
      const double weight = s.raw.weight[same_[static_cast<std::size_t>(r)]],
                   share = weight / (total + weight);
      for (int x = 0; x < size; ++x) {
        const auto at = static_cast<std::size_t>(x);
        const double d = J[x] - mean_[at];
        mean_[at] += share * d;
        spread_[at] += weight * (1.0 - share) * d * d;
      }
      total += weight;
    }
  }

  bool same_channels(const Stretch& s, Eigen::Index k, Eigen::Index l) const {
    if (s.raw.channels[k] != s.raw.channels[l]) return false;
    if (s.raw.channels[k] == n) return true;
    for (int i = 0; i < n; ++i)
      if (std::isfinite(s.raw.value(k, i)) != std::isfinite(s.raw.value(l, i))) return false;
    return true;
  }

  // d w (fractions of range) by [x, x', x''] (6, orders M) and by the dense parameters (6, ldx), row by row, at one sample.
  void sample_jacobians(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta,
                        Eigen::Index k, double* J, double* X) const {
    const RecordedLog& log = s.log();
    Vector6 nu, a, w;
    double scale[6];
    for (int r = 0; r < 6; ++r) {
      nu[r] = s.now.nu(k, r);
      a[r] = s.now.a(k, r);
      scale[r] = s.rig().sign / s.rig().range[r];
      w[r] = s.now.w(k, r) / scale[r];
    }
    MotionJacobian j = motion_jacobian(body_, log.point, nu);
    const BodyJacobian by_body = body_jacobian(body_, nu, a, w);
    for (int c = 0; c < kBodyParameters; ++c)
      for (int r = 0; r < 6; ++r) X[r * ldx + c] = scale[r] * by_body(r, c);
    int at = kBodyParameters;
    Vector3 g = Vector3::Zero();
    if (s.gravity()) {
      const auto put = [&](const double* by) {  // a parameter of gravity
        for (int r = 0; r < 6; ++r)
          X[r * ldx + at] = scale[r] * (j.g(r, 0) * by[0] + j.g(r, 1) * by[1] + j.g(r, 2) * by[2]);
        ++at;
      };
      g = s.gravity_at(k, root_);
      const Vector3 omega = angular(nu), alpha = angular(a);
      const Matrix3 R = s.rotation_at(k);
      const bool late = columns.gamma >= 0;  // (10.5)
      const double t = late ? theta[columns.clock[0]] : 0.0, kappa = late ? theta[columns.clock[0] + 1] : 0.0,
                   gamma = late ? theta[columns.gamma] : 0.0;
      if (late) {
        const Vector3 first = cross(omega, g), turn = cross(omega, first), spin = cross(alpha, g);
        double by[3][3];  // s, kappa, gamma
        for (int i = 0; i < 3; ++i) {
          const double second = (1.0 - kappa) * turn[i] + kappa * spin[i];
          by[0][i] = gamma * (first[i] + 2.0 * t * second);
          by[1][i] = gamma * t * t * (spin[i] - turn[i]);
          by[2][i] = t * first[i] + t * t * second;
        }
        for (const auto& x : by) put(x);
      }
      for (int c = 0; c < 2; ++c) {
        const Vector3 x = product(R, Vector3(by_tilt_(0, c), by_tilt_(1, c), by_tilt_(2, c)));
        const Vector3 first = cross(omega, x), turn = cross(omega, first), spin = cross(alpha, x);
        double by[3];
        for (int i = 0; i < 3; ++i)
          by[i] = x[i] + gamma * (t * first[i] + t * t * ((1.0 - kappa) * turn[i] + kappa * spin[i]));
        put(by);
      }
      const Matrix3 turned = cross_matrix(g);
      for (int r = 0; r < 6 && late; ++r)  // to first order in s
        for (int c = 0; c < 3; ++c)
          j.nu(r, 3 + c) -=
              gamma * t * (j.g(r, 0) * turned(0, c) + j.g(r, 1) * turned(1, c) + j.g(r, 2) * turned(2, c));
    }
    const int columns_of = orders * M;
    if (log.source == Source::mapped) {
      const double* by = s.mapped.jacobian.data() + k * s.mapped.jacobian.cols();  // (12, 3M)
      const Matrix3 turned = cross_matrix(g);  // dR g = [g x] (angular part of d nu / d x') dx
      double turn[6][3];
      for (int r = 0; r < 6; ++r)
        for (int i = 0; i < 3; ++i)
          turn[r][i] = j.g(r, 0) * turned(0, i) + j.g(r, 1) * turned(1, i) + j.g(r, 2) * turned(2, i);
      for (int r = 0; r < 6; ++r)
        for (int c = 0; c < columns_of; ++c) {
          double sum = 0.0;
          for (int i = 0; i < 6; ++i)
            sum += j.nu(r, i) * by[i * columns_of + c] + j.a(r, i) * by[(6 + i) * columns_of + c];
          if (c < M && s.gravity())
            for (int i = 0; i < 3; ++i) sum += turn[r][i] * by[(3 + i) * columns_of + M + c];
          J[r * columns_of + c] = scale[r] * sum;
        }
      return;
    }
    for (int r = 0; r < 6; ++r)
      for (int c = 0; c < 6; ++c) {
        const bool imu =
            log.source == Source::imu;  // the specific force in place of v, and no derivative of it
        J[r * 12 + c] = scale[r] * (imu && c < 3 ? j.a(r, c) : j.nu(r, c));
        J[r * 12 + 6 + c] = imu && c < 3 ? 0.0 : scale[r] * j.a(r, c);
      }
  }

  // Rows of (10.3) at `rows_`.
  void sum_raw(const Stretch& s, const Columns& columns, RawSums& out) {
    const int OM = orders * M, left_rows = kLocal * orders + nf + 2 * n, ldw = dense::padded(left_rows);
    const auto count = static_cast<int>(rows_.size());
    out.v = information_;
    for (int i = 0; i < n; ++i)
      if (!std::isfinite(s.raw.value(rows_[0], i))) out.v[static_cast<std::size_t>(i)] = 0.0;
    if (alone_) {
      sum_alone(s, out);
      return;
    }
    const double* v = out.v.data();
    phi_.resize(static_cast<std::size_t>(count * ld + 8));
    weights_.resize(static_cast<std::size_t>(count * ldw + 8));
    std::fill(gx.begin(), gx.end(), 0.0);
    std::fill(gd.begin(), gd.end(), 0.0);
    double cw_mean[max_components] = {}, z[3 * max_components], by_dense[max_components] = {};
    double total = 0.0;
    for (int r = 0; r < count; ++r) {
      const Eigen::Index k = rows_[static_cast<std::size_t>(r)];
      const double weight = s.raw.weight[k];
      total += weight;
      const double *J = jacobian_.data() + (first_ + r) * 6 * OM, *X = X_.data() + 6 * (first_ + r) * ldx;
      double* phi = phi_.data() + r * ld;
      double *left_row = weights_.data() + r * ldw,
             *vr = left_row + kLocal * orders + nf + n;  // less what they weigh
      for (int c = 0; c < 6; ++c) std::copy_n(X + c * ldx, nd, phi + nf + n + c * nd);
      const double *w = s.now.w.data() + 6 * k, *cw = s.now.cw.data() + n * k,
                   *residual = s.now.residual.data() + n * k;
      std::copy_n(w, 6, phi);
      phi[6] = 1.0;
      int at = 7;
      if (columns.slope >= 0) phi[at++] = s.warmth(k);
      for (std::size_t j = 0; j < columns.ramps.size(); ++j) phi[at++] = columns.ramped(j, s.raw.time[k]);
      for (const double begin : columns.step_times) phi[at++] = s.raw.time[k] >= begin ? 1.0 : 0.0;
      // the exact gradient: J^T V^-1 r
      double y[6] = {};
      for (int i = 0; i < n; ++i) {
        phi[nf + i] = cw[i] * cw[i];
        cw_mean[i] += weight * cw[i];
        const double x = weight * v[i] * residual[i];
        vr[i] = -x;
        dense::add<6>(y, x, C_ + 6 * i);
        dense::add<6>(y, 2.0 * u_[i] * cw[i] * x, lagged_ + 6 * i);
      }
      std::fill_n(z, OM, 0.0);
      for (int c = 0; c < 6; ++c) {
        dense::add(by_dense, y[c], X + c * ldx, nd);
        dense::add(z, y[c], J + c * OM, OM);
      }
      for (int p = 0; p < orders; ++p) {
        const Basis& b = s.raw.basis[static_cast<std::size_t>(k)][static_cast<std::size_t>(p)];
        for (int l = 0; l < kLocal; ++l) {
          left_row[kLocal * p + l] = -weight * b[l];
          dense::add(gx.data() + l * M, b[l], z + p * M, M);
          if (p == 0) dense::add(gd.data() + l * n, -b[l], vr, n);
        }
      }
      for (int x = 0; x < nf + n; ++x) left_row[kLocal * orders + x] = -weight * phi[x];
    }
    set_slope(cw_mean, total);
    dense::subtract(G.data(), ld, weights_.data(), 1, ldw, phi_.data(), ld, left_rows, ld, count,
                    dense::Mode::fresh);
    out.z.resize(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      const double* g = G.data() + (kLocal * orders + nf + n + i) * ld;
      out.z[static_cast<std::size_t>(i)] = g[6];
      for (int x = 0; x < nf; ++x)
        gt[static_cast<std::size_t>(feature[static_cast<std::size_t>(i * nf + x)])] += g[x];
      gt[static_cast<std::size_t>(columns.u + i)] += g[nf + i];
    }
    for (int x = 0; x < nd; ++x)
      gt[static_cast<std::size_t>(dense_columns[static_cast<std::size_t>(x)])] += by_dense[x];
    sum_bases(s, out);
    finish_raw(s, out, count);
    out.weight = total;
    out.samples = count;
  }

  // J_x and the bases alone.
  void sum_alone(const Stretch& s, RawSums& out) {
    double cw_mean[max_components] = {}, total = 0.0;
    for (const Eigen::Index k : rows_) {
      total += s.raw.weight[k];
      for (int i = 0; i < n; ++i) cw_mean[i] += s.raw.weight[k] * s.now.cw(k, i);
    }
    set_slope(cw_mean, total);
    sum_bases(s, out);
    out.J.assign(static_cast<std::size_t>(n * orders * M), 0.0);
    add_J(out);
  }

  // d raw / d w, by the sum of weighted C w.
  void set_slope(const double* cw, double total) {
    for (int i = 0; i < n; ++i)
      for (int c = 0; c < 6; ++c)
        slope_[static_cast<std::size_t>(6 * i + c)] =
            C_[6 * i + c] + 2.0 * u_[i] * (cw[i] / total) * lagged_[6 * i + c];
  }

  void add_J(RawSums& out) const {
    const int OM = orders * M;
    for (int i = 0; i < n; ++i)
      for (int c = 0; c < 6; ++c)
        dense::add(out.J.data() + i * OM, slope_[static_cast<std::size_t>(6 * i + c)], mean_.data() + c * OM,
                   OM);
  }

  void sum_bases(const Stretch& s, RawSums& out) const {
    for (int p = 0; p < orders; ++p)
      for (int q = p; q < orders; ++q) {
        double* m = out.m[order_pair[p][q]].data();  // column by column
        std::fill_n(m, kLocal * kLocal, 0.0);
        for (const Eigen::Index k : rows_) {
          const auto& basis = s.raw.basis[static_cast<std::size_t>(k)];
          const double *a = basis[static_cast<std::size_t>(p)].data(),
                       *b = basis[static_cast<std::size_t>(q)].data();
          for (int l = 0; l < kLocal; ++l) {
            const double y = s.raw.weight[k] * b[l];
            for (int h = 0; h < kLocal; ++h) m[kLocal * l + h] += a[h] * y;
          }
        }
      }
  }

  // What needs the interval's own d raw / d w.
  void finish_raw(const Stretch& s, RawSums& out, int count) {
    const int OM = orders * M;
    out.J.assign(static_cast<std::size_t>(n * OM), 0.0);
    out.SV.resize(static_cast<std::size_t>(6 * n));
    double Q[36] = {};  // less (d raw / d w)^T V^-1 (d raw / d w)
    for (int i = 0; i < n; ++i)
      for (int c = 0; c < 6; ++c) {
        const double x = slope_[static_cast<std::size_t>(6 * i + c)],
                     y = x * out.v[static_cast<std::size_t>(i)];
        out.SV[static_cast<std::size_t>(c * n + i)] = y;
        dense::add<6>(Q + 6 * c, -y, slope_.data() + 6 * i);
      }
    add_J(out);
    std::fill(left.begin(), left.end(), 0.0);
    for (int h = 0; h < 6; ++h)
      for (int c = 0; c < 6; ++c) dense::add(left.data() + h * OM, -Q[6 * h + c], mean_.data() + c * OM, OM);
    q_.resize(static_cast<std::size_t>(6 * count * ldx + 8));
    const double* X = X_.data() + 6 * first_ * ldx;
    for (int r = 0; r < count; ++r) {
      double weighted[36];
      for (int c = 0; c < 36; ++c) weighted[c] = -s.raw.weight[rows_[static_cast<std::size_t>(r)]] * Q[c];
      dense::tile<6>(q_.data() + 6 * r * ldx, ldx, weighted, 6, 1, X + 6 * r * ldx, ldx, ldx, 6, nullptr, 0,
                     dense::Mode::fresh);
    }
    dense::subtract(XX.data(), ldx, X, 1, ldx, q_.data(), ldx, nd, ldx, 6 * count, dense::Mode::fresh);
    out.basis.resize(static_cast<std::size_t>(kLocal * orders));
    for (int p = 0; p < orders; ++p)
      for (int l = 0; l < kLocal; ++l)
        out.basis[static_cast<std::size_t>(kLocal * p + l)] =
            G[static_cast<std::size_t>((kLocal * p + l) * ld + 6)];
    const double* ones = G.data() + (kLocal * orders + 6) * ld;  // the row of the feature 1
    out.phi.assign(ones, ones + features);
  }
};

}  // namespace truewrench
