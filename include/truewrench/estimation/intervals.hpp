// The sensor's samples of a stretch, interval by interval, to sums (METHOD 9). Where the samples' own Jacobians differ from their
// mean by more than the motion's information hides, as where a light body turns fast under a precise sensor, an interval is cut
// into parts with one each: else no step comes to the fixed point.
#pragma once

#include "truewrench/estimation/row_sums.hpp"
#include "truewrench/estimation/stretch.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace truewrench {

class Intervals {
 public:
  RowSums sums;

  // `alone`: only what H_xx is made of.
  void setup(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
             const Sizes& sizes, bool alone = false) {
    const int M = s.components(), n = s.channels();
    alone_ = alone;
    sums.setup(s.of_root(columns), M, s.log().source == Source::mapped ? 3 : 2, s.gravity());
    sums.at(theta.data() + columns.C, theta.data() + columns.u, lagged.data());
    further_.resize(static_cast<std::size_t>(sums.nf - 7));
    information_.resize(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      const double sigma = s.rig().noise[i] * sizes.raw_factor[raw_group(i, n)];
      information_[static_cast<std::size_t>(i)] = 1.0 / (sigma * sigma);
    }
    v_.resize(information_.size());
    // of x in an interval, by the samples of the motion; and of the wrench, in fractions of range, by one of the sensor's
    const double h = s.spline.h();
    told_.assign(static_cast<std::size_t>(sums.orders * M), 0.0);
    for (std::size_t i = 0; i < s.motion.size(); ++i) {
      const MotionStream& stream = s.log().motion[i];
      for (int j = 0; j < M; ++j)
        told_[static_cast<std::size_t>(j)] +=
            s.motion[i].samples[j] / static_cast<double>(s.spline.intervals()) *
            std::pow(
                stream.sigma[j] * sizes.motion_factor[i][stream.group[j]] * std::pow(h, stream.derivative),
                -2.0);
    }
    for (int p = sums.orders - 1; p >= 0; --p)
      for (int j = 0; j < M; ++j)
        told_[static_cast<std::size_t>(p * M + j)] = told_[static_cast<std::size_t>(j)] * std::pow(h, 2 * p);
    for (int c = 0; c < 6; ++c) {
      felt_[c] = 0.0;
      for (int i = 0; i < n; ++i)
        felt_[c] += information_[static_cast<std::size_t>(i)] * theta[columns.C + 6 * i + c] *
                    theta[columns.C + 6 * i + c];
      scale_[c] = s.rig().sign / s.rig().range[c];
    }
    known_ = columns.body < 0;
    body_ = departed(s.log().payload, Stretch::body_of(columns, theta));
    gravity_ = s.gravity_of(columns, theta);
    next_ = 0;
  }

  // Calls take(sums) for every set of samples of an interval that have the same channels; intervals in their order.
  template <typename Take>
  void raw(const Stretch& s, const Columns& columns, Eigen::Index interval, std::vector<RawSums>& pool,
           std::size_t& used, const Take& take) {
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
      const auto weight = [&](int row) { return s.raw.weight[same_[static_cast<std::size_t>(row)]]; };
      const int count = static_cast<int>(same_.size()), parts = parts_of(s, weight);
      for (int part = 0; part < parts; ++part) {
        const int first = count * part / parts, end = count * (part + 1) / parts;
        if (parts > 1) sums.average(first, end - first, weight);
        if (used == pool.size()) pool.emplace_back();
        RawSums& out = pool[used++];
        sum(s, columns, first, end, out);
        take(out);
      }
    }
  }

 private:
  std::vector<double> information_, v_, further_;
  Payload body_;
  Gravity gravity_;
  double scale_[6] = {};
  Eigen::Index next_ = 0;
  std::vector<Eigen::Index> same_;  // of an interval with the same channels
  std::vector<double>
      told_;  // (orders M) information on [x, x', x''] over h^p of an interval's motion samples
  double felt_[6] = {};
  bool alone_ = false, known_ = false;  // known_: the body
  std::vector<char> done_;

  // The Jacobians of `same_` and their mean; and into how many parts it is cut, so that what lies between those of the samples
  // and their mean is at most `jacobian_spread` of what the motion's own samples tell: it falls with the square of the parts.
  template <typename Weight>
  int parts_of(const Stretch& s, const Weight& weight) {
    const int count = static_cast<int>(same_.size()), columns = sums.orders * sums.M;
    sums.reserve(count);
    for (int r = 0; r < count; ++r)
      sample_jacobians(s, same_[static_cast<std::size_t>(r)], sums.J(r), sums.X(r));
    sums.average(0, count, weight);
    double most = 0.0;
    for (int x = 0; x < columns; ++x) {
      double sum = 0.0;
      for (int c = 0; c < 6; ++c) sum += felt_[c] * sums.spread()[c * columns + x];
      most = std::max(most, sum / told_[static_cast<std::size_t>(x)]);
    }
    const double parts = std::ceil(std::sqrt(most / constants::jacobian_spread));
    return static_cast<int>(std::clamp(parts, 1.0, static_cast<double>(count)));
  }

  bool same_channels(const Stretch& s, Eigen::Index k, Eigen::Index l) const {
    if (s.raw.channels[k] != s.raw.channels[l]) return false;
    if (s.raw.channels[k] == sums.n) return true;
    for (int i = 0; i < sums.n; ++i)
      if (std::isfinite(s.raw.value(k, i)) != std::isfinite(s.raw.value(l, i))) return false;
    return true;
  }

  // d w (fractions of range) by [x, x', x''] (6, orders M) and by the dense parameters (6, ldx), row by row, at one sample.
  void sample_jacobians(const Stretch& s, Eigen::Index k, double* J, double* X) const {
    Vector6 nu, a, w;
    for (int r = 0; r < 6; ++r) {
      nu[r] = s.now.nu(k, r);
      a[r] = s.now.a(k, r);
      w[r] = s.now.w(k, r) / scale_[r];
    }
    const Matrix3 R = s.gravity() ? s.rotation_at(k) : Matrix3::Identity();
    const MotionJacobian j = row_jacobian(body_, s.log().point, scale_, gravity_, R, nu, a,
                                          angular(s.jerk_at(k)), w, known_, X, sums.ldx);
    if (s.log().source != Source::mapped) return by_splines(j, scale_, s.log().source == Source::imu, J);
    const int M = sums.M, columns = sums.orders * M;
    const double* by = s.mapped.jacobian.data() + k * s.mapped.jacobian.cols();  // (12, 3M)
    double turn[6][3] = {};  // dR g = [g x] (angular part of d nu / d x') dx
    if (s.gravity()) {
      const Matrix3 turned = cross_matrix(gravity_.in_sensor(R));
      for (int r = 0; r < 6; ++r)
        for (int i = 0; i < 3; ++i)
          turn[r][i] = j.g(r, 0) * turned(0, i) + j.g(r, 1) * turned(1, i) + j.g(r, 2) * turned(2, i);
    }
    for (int r = 0; r < 6; ++r)
      for (int c = 0; c < columns; ++c) {
        double sum = 0.0;
        for (int i = 0; i < 6; ++i)
          sum += j.nu(r, i) * by[i * columns + c] + j.a(r, i) * by[(6 + i) * columns + c];
        for (int i = 0; i < 3 && c < M; ++i) sum += turn[r][i] * by[(3 + i) * columns + M + c];
        J[r * columns + c] = scale_[r] * sum;
      }
  }

  // Rows of (10.3) at same_[first ... end).
  void sum(const Stretch& s, const Columns& columns, int first, int end, RawSums& out) {
    const Eigen::Index any = same_[static_cast<std::size_t>(first)];
    for (int i = 0; i < sums.n; ++i)
      v_[static_cast<std::size_t>(i)] =
          std::isfinite(s.raw.value(any, i)) ? information_[static_cast<std::size_t>(i)] : 0.0;
    sums.begin(out, first, v_.data());
    for (int r = first; r < end; ++r) {
      const Eigen::Index k = same_[static_cast<std::size_t>(r)];
      const double weight = s.raw.weight[k], *basis = s.raw.basis[static_cast<std::size_t>(k)][0].data(),
                   *cw = s.now.cw.data() + sums.n * k;
      if (alone_) {
        sums.add_bases(out, weight, basis, cw);
        continue;
      }
      std::size_t at = 0;
      if (columns.slope >= 0) further_[at++] = s.warmth(k);
      for (std::size_t j = 0; j < columns.ramps.size(); ++j)
        further_[at++] = columns.ramped(j, s.raw.time[k]);
      for (const double begin : columns.step_times) further_[at++] = s.raw.time[k] >= begin ? 1.0 : 0.0;
      sums.add(out, weight, basis, s.now.w.data() + 6 * k, cw, s.now.residual.data() + sums.n * k,
               further_.data());
    }
    if (alone_)
      sums.finish_alone(out);
    else
      sums.finish(out);
  }
};

}  // namespace truewrench
