// One window of motion: residuals of every stream at its own time stamps, their normal equations in
// (spline coefficients, common parameters), and the Schur complement onto the common parameters
// (docs/method.md, "Windows of motion").
#pragma once

#include "truewrench/block_banded.hpp"
#include "truewrench/blocks.hpp"

#include <Eigen/Dense>

#include <array>
#include <cstdint>
#include <vector>

namespace truewrench {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using MotionNormal = BlockBanded<kCoordinates, kDegree>;

enum class Terms : std::uint8_t { motion, all };  // the motion measurements alone, or with the sensor's

// Normal equations of one window at (x, theta): H [dx; dtheta] = g, with the common part eliminated on demand.
template <int N>
class WindowNormal {
 public:
  // Linearises at (x, theta). Without `common`, only the motion's part is formed (theta held). `freedom`: of Student's
  // t, as which the sensor's noise is taken; 0 for a normal one.
  void assemble(const WindowModel<N>& model, const Blocks<N>& blocks, const BSpline& spline,
                const Coefficients& x, const Eigen::VectorXd& theta, Terms terms, bool common,
                double freedom = 0.0) {
    const int p = common ? model.layout().size() : 0;
    hxx_.reset(spline.coefficients());
    rhs_.setZero(kCoordinates * spline.coefficients(), p + 1);
    htt_.setZero(p, p);
    gt_.setZero(p);
    cost_ = 0.0;
    for (const MotionBlock& b : blocks.motion) add_motion(b, blocks.rows, x);
    if (terms == Terms::motion) return;
    const WindowModelAt<N> at(model, theta);
    if (model.log().reference) {
      add_wrench<3>(at, model.layout(), blocks.wrench, x, common, freedom);
    } else {
      add_wrench<2>(at, model.layout(), blocks.wrench, x, common, freedom);
    }
  }

  // Cholesky of the motion part and S = Htt - Htx Hxx^-1 Hxt, s = gt - Htx Hxx^-1 gx.
  Status reduce() {
    if (const Status st = hxx_.factorize(); st != Status::ok) return st;
    hxx_.solve_forward(rhs_);
    const auto p = htt_.rows();
    if (p > 0) {
      const auto y = rhs_.leftCols(p);
      htt_.template selfadjointView<Eigen::Lower>().rankUpdate(y.transpose(), -1.0);
      htt_.template triangularView<Eigen::StrictlyUpper>() = htt_.transpose();
      gt_.noalias() -= y.transpose() * rhs_.col(p);
    }
    return Status::ok;
  }

  const Eigen::MatrixXd& information() const { return htt_; }  // S, after reduce()
  const Eigen::VectorXd& score() const { return gt_; }         // s, after reduce()
  double cost() const { return cost_; }                        // sum of squared normalised residuals
  // Decrease of the cost that the motion alone predicts, theta held: gx^T Hxx^-1 gx.
  double motion_decrement() const { return rhs_.col(rhs_.cols() - 1).squaredNorm(); }

  // dx for a given dtheta (empty: theta held), after reduce().
  Coefficients motion_step(const Eigen::VectorXd& dtheta) const {
    Eigen::VectorXd z = rhs_.col(rhs_.cols() - 1);
    if (dtheta.size() > 0) z.noalias() -= rhs_.leftCols(dtheta.size()) * dtheta;
    hxx_.solve_backward(z);
    return Eigen::Map<const Coefficients>(z.data(), z.size() / kCoordinates, kCoordinates);
  }

  // H^-1 r, r of the motion's coefficients, after reduce().
  void solve(Eigen::MatrixXd& r) const {
    hxx_.solve_forward(r);
    hxx_.solve_backward(r);
  }

  const MotionNormal& factor() const { return hxx_; }  // L of Hxx, after reduce(),
  const RowMatrix& reduced() const { return rhs_; }    // and L^-1 [Hxt, gx]

  MotionNormal covariance_band() const { return hxx_.inverse_band(); }

 private:
  static constexpr int kRegressors = 8;  // of one channel: the wrench, 1, the temperature
  using Regressor = Eigen::Matrix<double, kRegressors, 1>;
  using Extra = Eigen::Matrix<double, N, Eigen::Dynamic, 0, kChannelStorage<N>, kPayloadParameters + 1>;

  void add_motion(const MotionBlock& b, const std::vector<MotionBlock::Rows>& rows, const Coefficients& x) {
    const Vector6 r = b.value - b.of(x.middleRows<kActive>(b.interval), rows);
    cost_ += r.squaredNorm();
    const auto last = rhs_.cols() - 1;
    if (b.rows < 0) {
      const Vector6 weight = b.scale.cwiseAbs2();
      const Vector6 weighted = b.scale.cwiseProduct(r);
      for (int k = 0; k < kActive; ++k) {
        for (int l = 0; l <= k; ++l) {
          hxx_(b.interval + k, b.interval + l).diagonal() += (b.basis[k] * b.basis[l]) * weight;
        }
        rhs_.col(last).template segment<6>(6 * (b.interval + k)) += b.basis[k] * weighted;
      }
      return;
    }
    const MotionBlock::Rows& j = rows[static_cast<std::size_t>(b.rows)];
    const Matrix6 ss = j.of.transpose() * j.of;
    const Matrix6 sl = j.of.transpose() * j.of_lower;
    const Matrix6 ls = sl.transpose();
    const Matrix6 ll = j.of_lower.transpose() * j.of_lower;
    const Vector6 gs = j.of.transpose() * r;
    const Vector6 gl = j.of_lower.transpose() * r;
    for (int k = 0; k < kActive; ++k) {
      const double bk = b.basis[k];
      const double ck = j.lower[k];
      for (int l = 0; l <= k; ++l) {
        const double bl = b.basis[l];
        const double cl = j.lower[l];
        hxx_(b.interval + k, b.interval + l) +=
            (bk * bl) * ss + (bk * cl) * sl + (ck * bl) * ls + (ck * cl) * ll;
      }
      rhs_.col(last).template segment<6>(6 * (b.interval + k)) += bk * gs + ck * gl;
    }
  }

  // T terms of the channels' derivatives: by twist and acceleration, and about a reference by the displacement.
  template <int T>
  void add_wrench(const WindowModelAt<N>& model, const ParameterLayout& layout,
                  const std::vector<WrenchBlock<N>>& blocks, const Coefficients& x, bool common,
                  double freedom) {
    const int n = layout.channels;
    const int p = static_cast<int>(rhs_.cols()) - 1;
    moment_.setZero(n * kRegressors, kRegressors);
    cross_.resize(T * kCoordinates, p);
    extra_.resize(n, (layout.payload ? kPayloadParameters : 0) + (layout.time_offset ? 1 : 0));
    std::array<ChannelMatrix<N>, T> weighted;
    std::array<std::array<Matrix6, T>, T> product;
    std::array<Vector6, T> gradient;
    for (const WrenchBlock<N>& b : blocks) {
      const auto xi = x.middleRows<kActive>(b.interval);
      const MotionState state = b.state(xi);
      const Vector6 w = model.wrench_of(state, b.spread);
      const ChannelVector<N> r = b.raw - model.raw_of(w, b.temperature);
      ChannelVector<N> weight = b.weight;
      if (freedom > 0.0) {
        weight.array() *= (freedom + 1.0) / (freedom + weight.array() * r.array().square());
      }
      const ChannelVector<N> wr = weight.cwiseProduct(r);
      cost_ += wr.dot(r);

      const ChannelMatrix<N> by_twist = model.raw_by_twist(state.nu);
      const WrenchTerms<N> terms(model, b, by_twist);
      for (std::size_t i = 0; i < T; ++i) {
        weighted[i] = weight.asDiagonal() * terms.by[i];
        for (std::size_t j = 0; j <= i; ++j) {
          product[j][i] = terms.by[j].transpose() * weighted[i];
          if (j != i) product[i][j] = product[j][i].transpose();
        }
        gradient[i] = terms.by[i].transpose() * wr;
      }
      if (common) {
        Regressor z;
        z << w, 1.0, b.temperature;
        add_linear<T>(layout, weight, z, wr, weighted);
        if (extra_.cols() > 0) {
          if (layout.payload) extra_.template leftCols<kPayloadParameters>() = model.raw_by_payload(state);
          if (layout.time_offset) {
            extra_.col(extra_.cols() - 1) = model.raw_by_time(by_twist, state, b.jerk(xi));
          }
          add_extra<T>(layout, weight, z, wr, weighted);
        }
      }
      for (int k = 0; k < kActive; ++k) {
        std::array<Matrix6, T> of_k;
        for (std::size_t j = 0; j < T; ++j) {
          of_k[j] = (*terms.basis[0])[k] * product[0][j];
          for (std::size_t i = 1; i < T; ++i) of_k[j] += (*terms.basis[i])[k] * product[i][j];
        }
        for (int l = 0; l <= k; ++l) {
          Matrix6& h = hxx_(b.interval + k, b.interval + l);
          for (std::size_t j = 0; j < T; ++j) h += (*terms.basis[j])[l] * of_k[j];
        }
        const int row = kCoordinates * (b.interval + k);
        for (int i = 0; i < T; ++i) {
          const auto s = static_cast<std::size_t>(i);
          const double basis = (*terms.basis[s])[k];
          if (common) {
            rhs_.block(row, 0, kCoordinates, p).noalias() +=
                basis * cross_.template middleRows<kCoordinates>(kCoordinates * i);
          }
          rhs_.col(p).template segment<6>(row) += basis * gradient[s];
        }
      }
    }
    if (common) expand_moments(layout);
  }

  // Gains, temperature slope and offset: channel i is linear in them, with the regressors z = [w, 1, temperature].
  template <int T>
  void add_linear(const ParameterLayout& layout, const ChannelVector<N>& weight, const Regressor& z,
                  const ChannelVector<N>& wr, const std::array<ChannelMatrix<N>, T>& weighted) {
    const Eigen::Matrix<double, kRegressors, kRegressors> zz = z * z.transpose();
    const auto w = z.template head<6>();
    for (int i = 0; i < layout.channels; ++i) {
      for (int k = 0; k < T; ++k) {
        cross_.block<kCoordinates, 6>(kCoordinates * k, 6 * i).noalias() =
            weighted[static_cast<std::size_t>(k)].row(i).transpose() * w.transpose();
      }
      moment_.template middleRows<kRegressors>(kRegressors * i) += weight[i] * zz;
      gt_.segment<6>(6 * i) += wr[i] * w;
      const auto add = [&](int at, double factor) {
        for (int k = 0; k < T; ++k) {
          cross_.col(at).template segment<kCoordinates>(kCoordinates * k) =
              factor * weighted[static_cast<std::size_t>(k)].row(i).transpose();
        }
        gt_[at] += wr[i] * factor;
      };
      if (layout.offset) add(layout.offset_begin() + i, 1.0);
      if (layout.temperature) add(layout.temperature_begin() + i, z[7]);
    }
  }

  // Payload and time offset, on which every channel depends: the columns of extra_.
  template <int T>
  void add_extra(const ParameterLayout& layout, const ChannelVector<N>& weight, const Regressor& z,
                 const ChannelVector<N>& wr, const std::array<ChannelMatrix<N>, T>& weighted) {
    const Extra weighted_extra = weight.asDiagonal() * extra_;
    const auto place = [&](int first, int count, int at) {
      const auto columns = extra_.middleCols(first, count);
      for (int k = 0; k < T; ++k) {
        cross_.block(kCoordinates * k, at, kCoordinates, count).noalias() =
            weighted[static_cast<std::size_t>(k)].transpose() * columns;
      }
      gt_.segment(at, count).noalias() += columns.transpose() * wr;
      htt_.block(at, at, count, count).noalias() +=
          columns.transpose() * weighted_extra.middleCols(first, count);
      for (int i = 0; i < layout.channels; ++i) {
        const auto row = weighted_extra.row(i).segment(first, count);
        htt_.block(6 * i, at, 6, count).noalias() += z.template head<6>() * row;
        if (layout.offset) htt_.row(layout.offset_begin() + i).segment(at, count) += row;
        if (layout.temperature) htt_.row(layout.temperature_begin() + i).segment(at, count) += z[7] * row;
      }
    };
    if (layout.payload) place(0, kPayloadParameters, layout.payload_begin());
    if (!layout.time_offset) return;
    const int last = static_cast<int>(extra_.cols()) - 1;
    place(last, 1, layout.time_offset_begin());
    if (layout.payload) {
      htt_.block(layout.payload_begin(), layout.time_offset_begin(), kPayloadParameters, 1).noalias() +=
          extra_.template leftCols<kPayloadParameters>().transpose() * weighted_extra.col(last);
    }
  }

  // The moments of z into their places, and the lower triangle of what add_extra left above the diagonal.
  void expand_moments(const ParameterLayout& layout) {
    for (int i = 0; i < layout.channels; ++i) {
      const auto m = moment_.template middleRows<kRegressors>(kRegressors * i);
      htt_.block<6, 6>(6 * i, 6 * i) = m.template topLeftCorner<6, 6>();
      const int o = layout.offset_begin() + i;
      const int t = layout.temperature_begin() + i;
      if (layout.offset) {
        htt_.block<6, 1>(6 * i, o) = m.template block<6, 1>(0, 6);
        htt_(o, o) = m(6, 6);
      }
      if (layout.temperature) {
        htt_.block<6, 1>(6 * i, t) = m.template block<6, 1>(0, 7);
        htt_(t, t) = m(7, 7);
      }
      if (layout.offset && layout.temperature) htt_(t, o) = m(6, 7);
    }
    if (layout.payload && layout.offset) move_below(layout.offset_begin(), layout.payload_begin(), layout);
    if (layout.payload && layout.temperature)
      move_below(layout.temperature_begin(), layout.payload_begin(), layout);
    htt_.template triangularView<Eigen::StrictlyLower>() = htt_.transpose();
  }

  // Rows `from` ... against the payload stand below the diagonal: onto their mirror images above it.
  void move_below(int from, int payload, const ParameterLayout& layout) {
    htt_.block(payload, from, kPayloadParameters, layout.channels) =
        htt_.block(from, payload, layout.channels, kPayloadParameters).transpose();
  }

  MotionNormal hxx_;
  RowMatrix rhs_;  // [Hxt, gx]; after reduce() L^-1 of it
  Eigen::MatrixXd htt_;
  Eigen::VectorXd gt_;
  double cost_ = 0.0;
  Eigen::Matrix<double, Eigen::Dynamic, kRegressors, Eigen::RowMajor> moment_;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, 3 * kCoordinates> cross_;
  Extra extra_;
};

}  // namespace truewrench
