// One sweep over a stretch: samples -> intervals -> blocks of five knots -> information on theta, the motion and the
// discrepancy eliminated on the way; back for the step, and for the exact traces of (10.6) by selected inversion (METHOD 9).
//
// Of a sample only its residual, its gradient and its features are formed; an interval has one Jacobian, the mean of its
// samples', for H and F alike: the gradient stays exact, so the fixed point does not move.
#pragma once

#include "truewrench/estimation/stretch.hpp"

#include <Eigen/Cholesky>

#include <utility>
#include <vector>

namespace truewrench {

// The sizes of one log's nuisances (METHOD 10.2), and which rows share one.
struct Sizes {
  Eigen::VectorXd raw_factor;                   // on the stated noise: force and moment channels, else all together
  std::vector<Eigen::VectorXd> motion_factor;   // of each stream's groups
  Eigen::VectorXd q;                            // (M) of (10.1)
  Eigen::VectorXd delta;                        // as raw_factor: of (10.2)
  double k = 1.0;                               // 1 / tau
  Form form = Form::none;
  Eigen::VectorXd cap;                          // of delta
};

inline int raw_groups(int channels) { return channels == 6 ? 2 : 1; }
inline int raw_group(int channel, int channels) { return channels == 6 && channel >= 3 ? 1 : 0; }

// p of (10.1) for a component of the motion spline (METHOD 10.1, 10.6).
inline int smoothness_order(Source source, int component) {
  if (source == Source::mapped) return 4;
  return source == Source::imu && component < 3 ? 2 : 3;
}

// What a stretch says of its log's parameters: H_tt - H_tx H_xx^-1 H_xt and the gradient likewise.
struct Information {
  Eigen::MatrixXd S;
  Eigen::VectorXd g;
  double logdet = 0.0;  // of H_xx
};

// The traces of (10.6) of one stretch.
struct Traces {
  Eigen::VectorXd raw;                  // tr J Sigma J^T / sigma^2 by group, theta's share apart
  std::vector<Eigen::VectorXd> motion;  // of each stream's groups, theta's share within
  double motion_share = 0.0;            // of theta in all motion rows
  Eigen::VectorXd q;                    // tr R_p Sigma
  std::vector<Gram> inside, start;      // of each channel: the discrepancy's covariance, summed over the intervals; the first
};

class Sweep {
 public:
  // Eliminate the motion (and the discrepancy) of a stretch, at its last prediction.
  Information forward(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
                      const Sizes& sizes) {
    setup(s, columns, sizes);
    Information out;
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(2 * W_, 2 * W_);  // lower triangle
    Eigen::MatrixXd F = Eigen::MatrixXd::Zero(2 * W_, nt_ + 1);
    Eigen::MatrixXd Htt = Eigen::MatrixXd::Zero(nt_ + 1, nt_ + 1);  // lower triangle; last row: gradient
    raw_next_ = 0;
    motion_next_.assign(s.motion.size(), 0);
    const Eigen::Index G = s.spline.blocks();
    for (Eigen::Index g = 0; g <= G; ++g) {
      if (g < G)
        for (int o = 0; o < kBlock; ++o) add_interval(s, columns, theta, lagged, kBlock * g + o, o, H, F, Htt);
      Block& block = blocks_[static_cast<std::size_t>(g)];
      block.L = H.topLeftCorner(W_, W_);
      Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> llt(block.L);
      if (llt.info() != Eigen::Success) {
        out.logdet = std::nan("");
        return out;
      }
      out.logdet += 2.0 * block.L.diagonal().array().log().sum();
      const auto L = block.L.triangularView<Eigen::Lower>();
      block.Y = F.topRows(W_);
      L.solveInPlace(block.Y);
      Htt.selfadjointView<Eigen::Lower>().rankUpdate(block.Y.transpose(), -1.0);
      if (g == G) break;
      block.B = H.bottomLeftCorner(W_, W_);
      block.L.transpose().triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(block.B);
      H.topLeftCorner(W_, W_) = H.bottomRightCorner(W_, W_);
      H.topLeftCorner(W_, W_).selfadjointView<Eigen::Lower>().rankUpdate(block.B, -1.0);
      H.bottomRows(W_).setZero();
      F.topRows(W_) = F.bottomRows(W_);
      F.topRows(W_).noalias() -= block.B * block.Y;
      F.bottomRows(W_).setZero();
    }
    out.S = Htt.topLeftCorner(nt_, nt_).selfadjointView<Eigen::Lower>();
    out.g = Htt.row(nt_).head(nt_).transpose();
    return out;
  }

  // The step of the coefficients that belongs to a step of theta.
  void back(const Eigen::VectorXd& step, RowMatrix& dc, RowMatrix& de) const {
    Eigen::VectorXd x;
    for (Eigen::Index g = static_cast<Eigen::Index>(blocks_.size()) - 1; g >= 0; --g) {
      const Block& block = blocks_[static_cast<std::size_t>(g)];
      Eigen::VectorXd y = block.Y.col(nt_) - block.Y.leftCols(nt_) * step;
      if (x.size() > 0) y.noalias() -= block.B.transpose() * x;
      block.L.transpose().triangularView<Eigen::Upper>().solveInPlace(y);
      x = y;
      for (int k = 0; k < kBlock; ++k) {
        dc.row(kBlock * g + k) = x.segment(k * M_, M_);
        if (d_) de.row(kBlock * g + k) = x.segment(kBlock * M_ + k * n_, n_);
      }
    }
  }

  // The traces of (10.6), with P the covariance of the log's parameters.
  Traces traces(const Stretch& s, const Columns& columns, const Sizes& sizes, const Eigen::MatrixXd& P) const {
    Traces out;
    out.raw = Eigen::VectorXd::Zero(sizes.raw_factor.size());
    for (const auto& f : sizes.motion_factor) out.motion.push_back(Eigen::VectorXd::Zero(f.size()));
    out.q = Eigen::VectorXd::Zero(M_);
    if (d_) {
      out.inside.assign(static_cast<std::size_t>(n_), Gram::Zero());
      out.start.assign(static_cast<std::size_t>(n_), Gram::Zero());
    }
    Eigen::MatrixXd root = P;
    root.diagonal().array() += 1e-300;
    Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> llt(root);
    root = root.triangularView<Eigen::Lower>();
    Eigen::MatrixXd pair = Eigen::MatrixXd::Zero(2 * W_, 2 * W_);  // covariance of two blocks, theta known
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(2 * W_, nt_);        // their part that theta moves, by the root of P
    Eigen::MatrixXd Z(W_, nt_), next(W_, W_), Linv(W_, W_), Gt(W_, W_);
    for (Eigen::Index g = static_cast<Eigen::Index>(blocks_.size()) - 1; g >= 0; --g) {
      const Block& block = blocks_[static_cast<std::size_t>(g)];
      const auto L = block.L.triangularView<Eigen::Lower>();
      Linv.setIdentity();
      L.solveInPlace(Linv);
      const bool last = g + 1 == static_cast<Eigen::Index>(blocks_.size());
      next = pair.topLeftCorner(W_, W_);
      if (last) {
        Z = block.Y.leftCols(nt_);
      } else {
        pair.bottomRightCorner(W_, W_) = next;
        A.bottomRows(W_) = A.topRows(W_);
        Gt.noalias() = block.B * Linv.triangularView<Eigen::Lower>();
        pair.bottomLeftCorner(W_, W_).noalias() = next.selfadjointView<Eigen::Lower>() * (-Gt);
        Eigen::MatrixXd before = block.Y.leftCols(nt_);
        before.noalias() -= block.B.transpose() * Z;
        Z = before;
      }
      block.L.transpose().triangularView<Eigen::Upper>().solveInPlace(Z);
      A.topRows(W_).noalias() = Z * root.triangularView<Eigen::Lower>();
      auto top = pair.topLeftCorner(W_, W_);
      top.noalias() = Linv.transpose() * Linv;
      if (!last) top.noalias() -= Gt.transpose() * pair.bottomLeftCorner(W_, W_);
      if (last) continue;
      for (int o = 0; o < kBlock; ++o) trace_interval(s, sizes, kBlock * g + o, o, pair, A, out);
      trace_clock(s, columns, static_cast<std::size_t>(g), A, root, out);
    }
    for (std::size_t i = 0; i < s.motion.size(); ++i)
      for (Eigen::Index r = 0; r < out.motion[i].size(); ++r) {
        const double share = (clock_tt_[i][static_cast<std::size_t>(r)].array() * gather(P, clock_columns_).array()).sum();
        out.motion[i][r] += share;
        out.motion_share += share;
      }
    return out;
  }

  // Sensitivity of the coefficients to theta, block by block: H_xx^-1 H_xt is not kept; scores need L, B and Y alone.
  struct Block {
    Eigen::MatrixXd L;  // of the block's pivot
    Eigen::MatrixXd B;  // the next block's rows times L^-T
    Eigen::MatrixXd Y;  // L^-1 [H_xt, gradient], what came before eliminated
  };
  const std::vector<Block>& blocks() const { return blocks_; }
  int width() const { return W_; }
  int parameters() const { return nt_; }

  // Rows of a pair of blocks: coefficient k (0 ... 9) of component j, or of channel i's discrepancy.
  Eigen::Index place(int k, int j) const { return (k / kBlock) * W_ + (k % kBlock) * M_ + j; }
  Eigen::Index place_d(int k, int i) const { return (k / kBlock) * W_ + kBlock * M_ + (k % kBlock) * n_ + i; }

  // An interval's samples with the same channels: sum of products of bases, and their mean Jacobian by [x, x', x''].
  struct RawSums {
    std::array<std::array<Gram, 3>, 3> m;  // [p][q], q >= p
    Eigen::MatrixXd J;                     // (n, orders M)
    Eigen::VectorXd v;                     // (n) 1 / sigma^2, 0 where a channel is missing
    // of a constant wrench D in every channel, for scores (10.8):
    Eigen::MatrixXd basis;  // (6, orders) sum of weighted bases
    Eigen::MatrixXd T;      // (nt, n) T^T V^-1 D
    Eigen::VectorXd z;      // (n) D^T V^-1 r
    double weight = 0.0;
    int samples = 0;
  };
  const std::vector<std::vector<RawSums>>& raw_sums() const { return raw_sums_; }

 private:
  using Wrenches = Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::ColMajor>;
  int M_ = 6, n_ = 6, nt_ = 0, nf_ = 7, orders_ = 2, W_ = 30;
  bool d_ = false;
  std::vector<Block> blocks_;
  std::vector<std::vector<RawSums>> raw_sums_;                    // by interval
  std::vector<std::vector<std::vector<Gram>>> motion_sums_;       // by stream, interval, component (one for all)
  std::vector<Eigen::MatrixXd> clock_F_;                          // by block: rows of a pair by clock_columns_
  std::vector<std::vector<Eigen::MatrixXd>> clock_tt_;            // by stream and group
  std::vector<int> clock_columns_, dense_columns_;
  std::vector<std::vector<int>> feature_columns_;                 // by channel
  std::vector<Gram> smoothness_;                                  // R_p / q_j of an interval
  Penalty discrepancy_;
  Eigen::VectorXd raw_information_, delta_information_;           // 1 / sigma_i^2, 1 / delta_i^2
  std::vector<Eigen::VectorXd> motion_information_;
  Eigen::Index raw_next_ = 0;
  std::vector<Eigen::Index> motion_next_;

  void setup(const Stretch& s, const Columns& columns, const Sizes& sizes) {
    M_ = s.components();
    n_ = s.channels();
    nt_ = columns.size();
    d_ = sizes.form != Form::none;
    orders_ = s.log().source == Source::mapped ? 3 : 2;
    W_ = kBlock * (M_ + (d_ ? n_ : 0));
    blocks_.resize(static_cast<std::size_t>(s.spline.blocks() + 1));
    raw_sums_.assign(static_cast<std::size_t>(s.spline.intervals()), {});
    motion_sums_.assign(s.motion.size(), std::vector<std::vector<Gram>>(raw_sums_.size()));
    smoothness_.clear();
    for (int j = 0; j < M_; ++j)
      smoothness_.push_back(s.spline.smoothness(smoothness_order(s.log().source, j)).inside / sizes.q[j]);
    if (d_) discrepancy_ = s.spline.discrepancy(sizes.k, sizes.form);
    raw_information_.resize(n_);
    delta_information_ = Eigen::VectorXd::Zero(n_);
    for (int i = 0; i < n_; ++i) {
      const double sigma = s.rig().noise[i] * sizes.raw_factor[raw_group(i, n_)];
      raw_information_[i] = 1.0 / (sigma * sigma);
      if (d_) delta_information_[i] = 1.0 / (sizes.delta[raw_group(i, n_)] * sizes.delta[raw_group(i, n_)]);
    }
    motion_information_.clear();
    for (std::size_t i = 0; i < s.motion.size(); ++i) {
      const MotionStream& stream = s.log().motion[i];
      Eigen::VectorXd v(M_);
      for (int j = 0; j < M_; ++j) {
        const double sigma = stream.sigma[j] * sizes.motion_factor[i][stream.group[j]];
        v[j] = 1.0 / (sigma * sigma);
      }
      motion_information_.push_back(v);
    }
    // columns that channels share in shape: [w, 1, temperature, steps]
    feature_columns_.assign(static_cast<std::size_t>(n_), {});
    for (int i = 0; i < n_; ++i) {
      auto& f = feature_columns_[static_cast<std::size_t>(i)];
      for (int k = 0; k < 6; ++k) f.push_back(columns.C + 6 * i + k);
      f.push_back(columns.b + i);
      if (columns.slope >= 0) f.push_back(columns.slope + i);
      for (const int at : columns.steps) f.push_back(at + i);
    }
    nf_ = static_cast<int>(feature_columns_[0].size());
    dense_columns_.clear();
    for (int k = 0; k < kBodyParameters; ++k) dense_columns_.push_back(columns.body + k);
    if (columns.gamma >= 0)
      dense_columns_.insert(dense_columns_.end(), {columns.clock[0], columns.clock[0] + 1, columns.gamma});
    if (columns.tilt >= 0 && s.gravity()) dense_columns_.insert(dense_columns_.end(), {columns.tilt, columns.tilt + 1});
    clock_columns_.clear();
    clock_tt_.clear();
    for (std::size_t i = 0; i < s.motion.size(); ++i) {
      clock_columns_.insert(clock_columns_.end(), {columns.clock[i], columns.clock[i] + 1});
      if (columns.bias[i] >= 0)
        for (int j = 0; j < M_; ++j) clock_columns_.push_back(columns.bias[i] + j);
    }
    const auto nc = static_cast<Eigen::Index>(clock_columns_.size());
    for (std::size_t i = 0; i < s.motion.size(); ++i)
      clock_tt_.emplace_back(static_cast<std::size_t>(sizes.motion_factor[i].size()), Eigen::MatrixXd::Zero(nc, nc));
    clock_F_.assign(static_cast<std::size_t>(s.spline.blocks()), Eigen::MatrixXd::Zero(2 * W_, nc));
  }

  static Eigen::MatrixXd gather(const Eigen::MatrixXd& P, const std::vector<int>& at) {
    Eigen::MatrixXd out(at.size(), at.size());
    for (std::size_t i = 0; i < at.size(); ++i)
      for (std::size_t j = 0; j < at.size(); ++j)
        out(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = P(at[i], at[j]);
    return out;
  }

  void add_interval(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
                    Eigen::Index interval, int o, Eigen::MatrixXd& H, Eigen::MatrixXd& F, Eigen::MatrixXd& Htt) {
    add_smoothness(s, interval, o, H, F);
    for (std::size_t i = 0; i < s.motion.size(); ++i) add_motion(s, columns, i, interval, o, H, F, Htt);
    const auto& at = s.raw.interval;
    const Eigen::Index begin = raw_next_;
    while (raw_next_ < s.raw.size() && at[static_cast<std::size_t>(raw_next_)] == interval) ++raw_next_;
    std::vector<Eigen::Index> rows;
    std::vector<char> done(static_cast<std::size_t>(raw_next_ - begin), 0);
    for (Eigen::Index k = begin; k < raw_next_; ++k) {  // samples with the same channels together
      if (done[static_cast<std::size_t>(k - begin)] || s.raw.weight[k] <= 0.0) continue;
      rows.clear();
      for (Eigen::Index l = k; l < raw_next_; ++l) {
        if (done[static_cast<std::size_t>(l - begin)] || s.raw.weight[l] <= 0.0 ||
            (s.raw.value.row(l).array().isFinite() != s.raw.value.row(k).array().isFinite()).any())
          continue;
        done[static_cast<std::size_t>(l - begin)] = 1;
        rows.push_back(l);
      }
      add_raw(s, columns, theta, lagged, interval, o, rows, H, F, Htt);
    }
  }

  // (10.1) and (10.2): c^T R c / q, e^T R_M e / delta^2.
  void add_smoothness(const Stretch& s, Eigen::Index interval, int o, Eigen::MatrixXd& H, Eigen::MatrixXd& F) const {
    for (int j = 0; j < M_; ++j) {
      const Gram& R = smoothness_[static_cast<std::size_t>(j)];
      const Basis pull = R * s.c.col(j).segment(interval, kLocal);
      for (int k = 0; k < kLocal; ++k) {
        F(place(o + k, j), nt_) -= pull[k];
        for (int l = 0; l <= k; ++l) H(place(o + k, j), place(o + l, j)) += R(k, l);
      }
    }
    if (!d_) return;
    const Gram R = interval == 0 ? Gram(discrepancy_.inside + discrepancy_.start) : discrepancy_.inside;
    for (int i = 0; i < n_; ++i) {
      const Basis pull = R * s.e.col(i).segment(interval, kLocal);
      for (int k = 0; k < kLocal; ++k) {
        F(place_d(o + k, i), nt_) -= delta_information_[i] * pull[k];
        for (int l = 0; l <= k; ++l) H(place_d(o + k, i), place_d(o + l, i)) += delta_information_[i] * R(k, l);
      }
    }
  }

  // Rows of (10.4).
  void add_motion(const Stretch& s, const Columns& columns, std::size_t i, Eigen::Index interval, int o, Eigen::MatrixXd& H,
                  Eigen::MatrixXd& F, Eigen::MatrixXd& Htt) {
    const MotionRows& m = s.motion[i];
    const Eigen::VectorXd& v = motion_information_[i];
    const Eigen::VectorXi& group = s.log().motion[i].group;
    auto& sums = motion_sums_[i][static_cast<std::size_t>(interval)];
    sums.assign(1, Gram::Zero());
    Eigen::MatrixXd& CF = clock_F_[static_cast<std::size_t>(interval / kBlock)];
    const int first = static_cast<int>(std::find(clock_columns_.begin(), clock_columns_.end(), columns.clock[i]) -
                                       clock_columns_.begin());
    const int s_at = columns.clock[i], bias = columns.bias[i];
    Eigen::Index& k = motion_next_[i];
    for (; k < m.size() && m.interval[static_cast<std::size_t>(k)] == interval; ++k) {
      const Basis b = m.basis.row(k);
      const bool whole = m.value.row(k).array().isFinite().all();
      if (!whole && sums.size() == 1) sums.assign(static_cast<std::size_t>(M_), sums[0]);
      for (std::size_t j = 0; j < sums.size(); ++j)
        if (whole || std::isfinite(m.value(k, static_cast<Eigen::Index>(j)))) sums[j] += b * b.transpose();
      for (int j = 0; j < M_; ++j) {
        if (!whole && !std::isfinite(m.value(k, j))) continue;
        const Eigen::Vector2d T(m.by_s(k, j), m.by_kappa(k, j));
        const double r = v[j] * m.residual(k, j);
        for (int l = 0; l < kLocal; ++l) {
          const Eigen::Index at = place(o + l, j);
          F(at, nt_) += b[l] * r;
          F.row(at).segment<2>(s_at) += v[j] * b[l] * T.transpose();
          CF.row(at).segment<2>(first) += v[j] * b[l] * T.transpose();
          if (bias >= 0) {
            F(at, bias + j) += v[j] * b[l];
            CF(at, first + 2 + j) += v[j] * b[l];
          }
        }
        Htt.block<2, 2>(s_at, s_at) += v[j] * T * T.transpose();
        Htt.row(nt_).segment<2>(s_at) += r * T.transpose();
        Eigen::MatrixXd& tt = clock_tt_[i][static_cast<std::size_t>(group[j])];
        tt.block<2, 2>(first, first) += v[j] * T * T.transpose();
        if (bias < 0) continue;
        Htt(bias + j, bias + j) += v[j];
        Htt.row(bias + j).segment<2>(s_at) += v[j] * T.transpose();
        Htt(nt_, bias + j) += r;
        tt(first + 2 + j, first + 2 + j) += v[j];
        tt.row(first + 2 + j).segment<2>(first) += v[j] * T.transpose();
        tt.col(first + 2 + j).segment<2>(first) += v[j] * T;
      }
    }
    for (int j = 0; j < M_; ++j) {
      const Gram& sum = sums[sums.size() == 1 ? 0 : static_cast<std::size_t>(j)];
      for (int l = 0; l < kLocal; ++l)
        for (int h = 0; h <= l; ++h) H(place(o + l, j), place(o + h, j)) += v[j] * sum(l, h);
    }
  }

  // d w (fractions of range) by [x, x', x''] (6, orders M) and by the dense parameters (6, nd), at one sample.
  void sample_jacobians(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const Payload& body,
                        const Vector3& root, const Eigen::Matrix<double, 3, 2>& by_tilt, Eigen::Index k, Wrenches& J,
                        Wrenches& X) const {
    const RecordedLog& log = s.log();
    const Vector6 nu = s.now.nu.row(k), a = s.now.a.row(k);
    const Vector6 scale = s.rig().sign * s.rig().range.cwiseInverse();
    const Vector6 w = s.now.w.row(k).transpose().cwiseQuotient(scale);
    MotionJacobian j = motion_jacobian(body, log.point, nu);
    X.leftCols<kBodyParameters>() = body_jacobian(body, nu, a, w);
    int at = kBodyParameters;
    if (s.gravity()) {
      const Vector3 g = s.gravity_at(k, root), omega = nu.tail<3>(), alpha = a.tail<3>();
      Matrix3 late = Matrix3::Identity();  // d g+ / d g
      if (columns.gamma >= 0) {            // of (10.5)
        const double t = theta[columns.clock[0]], kappa = theta[columns.clock[0] + 1], gamma = theta[columns.gamma];
        const Vector3 first = omega.cross(g), turn = omega.cross(first), spin = alpha.cross(g);
        const Vector3 second = (1.0 - kappa) * turn + kappa * spin;
        X.col(at) = j.g * (gamma * (first + 2.0 * t * second));
        X.col(at + 1) = j.g * (gamma * t * t * (spin - turn));
        X.col(at + 2) = j.g * (t * first + t * t * second);
        at += 3;
        const Matrix3 O = cross_matrix(omega);
        late += gamma * (t * O + t * t * ((1.0 - kappa) * O * O + kappa * cross_matrix(alpha)));
        j.nu.rightCols<3>() -= gamma * t * j.g * cross_matrix(g);  // to first order in s
      }
      X.middleCols<2>(at) = j.g * (late * (s.rotation_at(k) * by_tilt));
    }
    if (log.source == Source::twist) {
      J << j.nu, j.a;
    } else if (log.source == Source::imu) {
      J << j.a.leftCols<3>(), j.nu.rightCols<3>(), Matrix6::Zero().leftCols<3>(), j.a.rightCols<3>();
    } else {
      const Eigen::Map<const RowMatrix> by(s.mapped.jacobian.row(k).data(), 12, 3 * M_);
      J = j.nu * by.topRows<6>() + j.a * by.bottomRows<6>();
      // dR g = [g x] (angular part of d nu / d x') dx
      if (s.gravity()) J.leftCols(M_) += j.g * cross_matrix(s.gravity_at(k, root)) * by.block(3, M_, 3, M_);
    }
    J = scale.asDiagonal() * J;
    X = scale.asDiagonal() * X;
  }

  // Rows of (10.3): samples of one interval with the same channels.
  void add_raw(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
               Eigen::Index interval, int o, const std::vector<Eigen::Index>& rows, Eigen::MatrixXd& H, Eigen::MatrixXd& F,
               Eigen::MatrixXd& Htt) {
    const int nd = static_cast<int>(dense_columns_.size()), OM = orders_ * M_;
    const Payload body = departed(s.log().payload, theta.segment<kBodyParameters>(columns.body));
    Eigen::Matrix<double, 3, 2> by_tilt = Eigen::Matrix<double, 3, 2>::Zero();
    const Vector3 root = s.gravity() ? tilted(s.rig().gravity, theta.segment<2>(columns.tilt), by_tilt) : Vector3::Zero();
    const Eigen::Map<const RowMatrix> C(theta.data() + columns.C, n_, 6);
    const Eigen::VectorXd u = theta.segment(columns.u, n_);
    RawSums sums;
    for (auto& row : sums.m) row.fill(Gram::Zero());
    sums.v = raw_information_;
    for (int i = 0; i < n_; ++i)
      if (!std::isfinite(s.raw.value(rows[0], i))) sums.v[i] = 0.0;
    const Eigen::VectorXd& v = sums.v;
    Wrenches mean = Wrenches::Zero(6, OM), J(6, OM);
    std::vector<Wrenches> X(rows.size(), Wrenches(6, nd));
    Eigen::VectorXd cw_mean = Eigen::VectorXd::Zero(n_);
    double total = 0.0;
    Eigen::VectorXd z(OM), vr(n_);
    for (std::size_t r = 0; r < rows.size(); ++r) {
      const Eigen::Index k = rows[r];
      const double weight = s.raw.weight[k];
      sample_jacobians(s, columns, theta, body, root, by_tilt, k, J, X[r]);
      mean += weight * J;
      cw_mean += weight * s.now.cw.row(k).transpose();
      total += weight;
      // the exact gradient: J^T V^-1 r
      vr = weight * v.cwiseProduct(s.now.residual.row(k).transpose());
      const Vector6 y = C.transpose() * vr + 2.0 * lagged.transpose() * u.cwiseProduct(s.now.cw.row(k).transpose()).cwiseProduct(vr);
      z.noalias() = J.transpose() * y;
      const auto& basis = s.raw.basis[static_cast<std::size_t>(k)];
      for (int l = 0; l < kLocal; ++l) {
        for (int p = 0; p < orders_; ++p)
          F.col(nt_).segment(place(o + l, 0), M_) += basis[static_cast<std::size_t>(p)][l] * z.segment(p * M_, M_);
        if (d_) F.col(nt_).segment(place_d(o + l, 0), n_) += basis[0][l] * vr;
      }
      for (int p = 0; p < orders_; ++p)
        for (int q = p; q < orders_; ++q)
          sums.m[static_cast<std::size_t>(p)][static_cast<std::size_t>(q)] +=
              weight * basis[static_cast<std::size_t>(p)] * basis[static_cast<std::size_t>(q)].transpose();
      for (int x = 0; x < nd; ++x) Htt(nt_, dense_columns_[static_cast<std::size_t>(x)]) += X[r].col(x).dot(y);
      for (int i = 0; i < n_; ++i) Htt(nt_, columns.u + i) += vr[i] * s.now.cw(k, i) * s.now.cw(k, i);
    }
    mean /= total;
    cw_mean /= total;
    const RowMatrix slope = C + 2.0 * u.cwiseProduct(cw_mean).asDiagonal() * lagged;  // d raw / d w
    sums.J = slope * mean;
    const Eigen::MatrixXd SV = slope.transpose() * v.asDiagonal();                    // (6, n)
    const Matrix6 Q = SV * slope;
    add_raw_band(sums, o, H);
    sums.weight = total;
    sums.samples = static_cast<int>(rows.size());
    add_raw_theta(s, columns, rows, X, sums, mean, SV, Q, o, F, Htt);
    raw_sums_[static_cast<std::size_t>(interval)].push_back(std::move(sums));
  }

  void add_raw_band(const RawSums& sums, int o, Eigen::MatrixXd& H) const {
    Eigen::MatrixXd T(M_, M_), VJ = sums.v.asDiagonal() * sums.J;
    for (int p = 0; p < orders_; ++p)
      for (int q = p; q < orders_; ++q) {
        const Gram& m = sums.m[static_cast<std::size_t>(p)][static_cast<std::size_t>(q)];
        T.noalias() = sums.J.middleCols(p * M_, M_).transpose() * VJ.middleCols(q * M_, M_);
        for (int k = 0; k < kLocal; ++k)
          for (int l = 0; l <= k; ++l) {
            auto block = H.block(place(o + k, 0), place(o + l, 0), M_, M_);
            if (p == q) {
              block += m(k, l) * T;
            } else {
              block += m(k, l) * T;
              block += m(l, k) * T.transpose();
            }
          }
      }
    if (!d_) return;
    for (int k = 0; k < kLocal; ++k)
      for (int l = 0; l < kLocal; ++l) {
        const Eigen::Index row = place_d(o + k, 0), column = place(o + l, 0);
        for (int p = 0; p < orders_; ++p) {
          const double m = sums.m[0][static_cast<std::size_t>(p)](k, l);  // B_k B^(p)_l
          if (row > column)
            H.block(row, column, n_, M_) += m * VJ.middleCols(p * M_, M_);
          else
            H.block(column, row, M_, n_) += m * VJ.middleCols(p * M_, M_).transpose();
        }
        if (l <= k)
          for (int i = 0; i < n_; ++i) H(place_d(o + k, i), place_d(o + l, i)) += sums.m[0][0](k, l) * sums.v[i];
      }
  }

  // H_xt and H_tt of the samples of one interval.
  void add_raw_theta(const Stretch& s, const Columns& columns, const std::vector<Eigen::Index>& rows,
                     const std::vector<Wrenches>& X, RawSums& sums, const Wrenches& mean, const Eigen::MatrixXd& SV,
                     const Matrix6& Q, int o, Eigen::MatrixXd& F, Eigen::MatrixXd& Htt) const {
    const int nd = static_cast<int>(dense_columns_.size());
    const Eigen::VectorXd& v = sums.v;
    Eigen::VectorXd f(nf_), cw2(n_);
    RowMatrix FF = RowMatrix::Zero(nf_, nf_), FU = RowMatrix::Zero(nf_, n_), FX = RowMatrix::Zero(nf_, 6 * nd),
              UX = RowMatrix::Zero(n_, 6 * nd);
    Eigen::VectorXd UU = Eigen::VectorXd::Zero(n_);
    Eigen::MatrixXd XX = Eigen::MatrixXd::Zero(nd, nd);
    std::array<RowMatrix, 3> BF, BU, BX;
    for (int p = 0; p < orders_; ++p) {
      const auto i = static_cast<std::size_t>(p);
      BF[i] = RowMatrix::Zero(kLocal, nf_);
      BU[i] = RowMatrix::Zero(kLocal, n_);
      BX[i] = RowMatrix::Zero(kLocal, 6 * nd);
    }
    for (std::size_t r = 0; r < rows.size(); ++r) {
      const Eigen::Index k = rows[r];
      const double weight = s.raw.weight[k];
      f.head<6>() = s.now.w.row(k);
      f[6] = 1.0;
      int at = 7;
      if (columns.slope >= 0) f[at++] = s.warmth(k);
      for (const double begin : columns.step_times) f[at++] = s.raw.time[k] >= begin ? 1.0 : 0.0;
      cw2 = s.now.cw.row(k).transpose().cwiseAbs2();
      const Eigen::Map<const Eigen::RowVectorXd> flat(X[r].data(), 6 * nd);
      const Eigen::VectorXd wf = weight * f, wu = weight * cw2;
      FF.noalias() += wf * f.transpose();
      FU.noalias() += wf * cw2.transpose();
      UU.noalias() += wu.cwiseProduct(cw2);
      FX.noalias() += wf * flat;
      UX.noalias() += wu * flat;
      XX.noalias() += X[r].transpose() * (weight * (Q * X[r]));
      const auto& basis = s.raw.basis[static_cast<std::size_t>(k)];
      for (int p = 0; p < orders_; ++p) {
        const auto i = static_cast<std::size_t>(p);
        BF[i].noalias() += basis[i] * wf.transpose();
        BU[i].noalias() += basis[i] * wu.transpose();
        BX[i].noalias() += (weight * basis[i]) * flat;
      }
      for (int i = 0; i < n_; ++i) {
        const double y = v[i] * s.now.residual(k, i);
        const auto& at_f = feature_columns_[static_cast<std::size_t>(i)];
        for (int x = 0; x < nf_; ++x) Htt(nt_, at_f[static_cast<std::size_t>(x)]) += y * wf[x];
      }
    }
    // H_xt
    const Eigen::MatrixXd VJ = v.asDiagonal() * sums.J;
    Eigen::MatrixXd left(M_, 6), part(M_, nd);
    for (int p = 0; p < orders_; ++p) {
      const auto ip = static_cast<std::size_t>(p);
      left.noalias() = mean.middleCols(p * M_, M_).transpose() * Q;
      for (int l = 0; l < kLocal; ++l) {
        const Eigen::Index at = place(o + l, 0);
        for (int i = 0; i < n_; ++i) {
          if (v[i] == 0.0) continue;
          const auto row = VJ.row(i).segment(p * M_, M_).transpose();
          F.block(at, feature_columns_[static_cast<std::size_t>(i)][0], M_, 6).noalias() += row * BF[ip].row(l).head<6>();
          for (int x = 6; x < nf_; ++x)
            F.col(feature_columns_[static_cast<std::size_t>(i)][static_cast<std::size_t>(x)]).segment(at, M_) += BF[ip](l, x) * row;
          F.col(columns.u + i).segment(at, M_) += BU[ip](l, i) * row;
        }
        const Eigen::Map<const Wrenches> x(BX[ip].row(l).data(), 6, nd);
        part.noalias() = left * x;
        for (int x_ = 0; x_ < nd; ++x_) F.col(dense_columns_[static_cast<std::size_t>(x_)]).segment(at, M_) += part.col(x_);
      }
    }
    if (d_) {
      Eigen::MatrixXd dense(n_, nd);
      for (int l = 0; l < kLocal; ++l) {
        const Eigen::Map<const Wrenches> x(BX[0].row(l).data(), 6, nd);
        dense.noalias() = SV.transpose() * x;
        for (int i = 0; i < n_; ++i) {
          const Eigen::Index at = place_d(o + l, i);
          for (int y = 0; y < nf_; ++y)
            F(at, feature_columns_[static_cast<std::size_t>(i)][static_cast<std::size_t>(y)]) += v[i] * BF[0](l, y);
          F(at, columns.u + i) += v[i] * BU[0](l, i);
          for (int y = 0; y < nd; ++y) F(at, dense_columns_[static_cast<std::size_t>(y)]) += dense(i, y);
        }
      }
    }
    // a constant wrench in every channel: the bases of an interval sum to one
    sums.basis.resize(kLocal, orders_);
    for (int p = 0; p < orders_; ++p) sums.basis.col(p) = BF[static_cast<std::size_t>(p)].col(6);
    sums.T = Eigen::MatrixXd::Zero(nt_, n_);
    sums.z = Eigen::VectorXd::Zero(n_);
    const Eigen::RowVectorXd WX = BX[0].colwise().sum();
    for (int i = 0; i < n_; ++i) {
      for (int x = 0; x < nf_; ++x)
        sums.T(feature_columns_[static_cast<std::size_t>(i)][static_cast<std::size_t>(x)], i) = v[i] * FF(6, x);
      sums.T(columns.u + i, i) = v[i] * FU(6, i);
      for (int y = 0; y < nd; ++y)
        sums.T(dense_columns_[static_cast<std::size_t>(y)], i) = SV.col(i).dot(WX.segment<6>(6 * y));
      for (const Eigen::Index k : rows) sums.z[i] += v[i] * s.raw.weight[k] * s.now.residual(k, i);
    }
    // H_tt, lower triangle
    const auto add = [&Htt](int a, int b, double x) { Htt(std::max(a, b), std::min(a, b)) += x; };
    for (int i = 0; i < n_; ++i) {
      if (v[i] == 0.0) continue;
      const auto& at = feature_columns_[static_cast<std::size_t>(i)];
      for (int x = 0; x < nf_; ++x)
        for (int y = 0; y <= x; ++y) add(at[static_cast<std::size_t>(x)], at[static_cast<std::size_t>(y)], v[i] * FF(x, y));
      for (int x = 0; x < nf_; ++x) add(columns.u + i, at[static_cast<std::size_t>(x)], v[i] * FU(x, i));
      add(columns.u + i, columns.u + i, v[i] * UU[i]);
      for (int y = 0; y < nd; ++y) {
        const int column = dense_columns_[static_cast<std::size_t>(y)];
        for (int x = 0; x < nf_; ++x)
          add(at[static_cast<std::size_t>(x)], column, SV.col(i).dot(FX.row(x).segment<6>(6 * y)));
        add(columns.u + i, column, SV.col(i).dot(UX.row(i).segment<6>(6 * y)));
      }
    }
    for (int x = 0; x < nd; ++x)
      for (int y = 0; y <= x; ++y)
        add(dense_columns_[static_cast<std::size_t>(x)], dense_columns_[static_cast<std::size_t>(y)], XX(x, y));
  }

  // <J^T V^-1 J, Sigma> of an interval by group, <R, Sigma> of the smoothness, and theta's share in the motion rows.
  void trace_interval(const Stretch& s, const Sizes& sizes, Eigen::Index interval, int o, const Eigen::MatrixXd& pair,
                      const Eigen::MatrixXd& A, Traces& out) const {
    const auto cov = [&](int k, int l) {  // (M, M) of knots k >= l
      return pair.block(place(o + k, 0), place(o + l, 0), M_, M_);
    };
    const auto i_ = static_cast<std::size_t>(interval);
    for (int j = 0; j < M_; ++j) {
      Gram local, theta;
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l <= k; ++l) {
          local(k, l) = local(l, k) = pair(place(o + k, j), place(o + l, j));
          theta(k, l) = theta(l, k) = A.row(place(o + k, j)).dot(A.row(place(o + l, j)));
        }
      out.q[j] += sizes.q[j] * smoothness_[static_cast<std::size_t>(j)].cwiseProduct(local).sum();
      for (std::size_t i = 0; i < s.motion.size(); ++i) {
        const auto& sums = motion_sums_[i][i_];
        const Gram& m = sums[sums.size() == 1 ? 0 : static_cast<std::size_t>(j)];
        const double share = motion_information_[i][j] * m.cwiseProduct(theta).sum();
        out.motion[i][s.log().motion[i].group[j]] += motion_information_[i][j] * m.cwiseProduct(local).sum() + share;
        out.motion_share += share;
      }
    }
    for (const RawSums& sums : raw_sums_[i_]) {
      for (int p = 0; p < orders_; ++p)
        for (int q = p; q < orders_; ++q) {
          const Gram& m = sums.m[static_cast<std::size_t>(p)][static_cast<std::size_t>(q)];
          Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(M_, M_);  // sum over k, l of m(k, l) Cov(x_k, x_l)
          for (int k = 0; k < kLocal; ++k)
            for (int l = 0; l <= k; ++l) {
              if (k == l) {
                sum += m(k, k) * symmetric(cov(k, k));
              } else {
                sum += m(k, l) * cov(k, l);
                sum += m(l, k) * cov(k, l).transpose();
              }
            }
          for (int i = 0; i < n_; ++i) {
            const double value = sums.J.row(i).segment(p * M_, M_) * sum * sums.J.row(i).segment(q * M_, M_).transpose();
            out.raw[raw_group(i, n_)] += (p == q ? 1.0 : 2.0) * sums.v[i] * value;
          }
        }
      if (!d_) continue;
      for (int i = 0; i < n_; ++i) {
        double value = 0.0;
        for (int k = 0; k < kLocal; ++k)
          for (int l = 0; l < kLocal; ++l) {
            const Eigen::Index row = place_d(o + k, i), column = place(o + l, 0);
            for (int p = 0; p < orders_; ++p) {
              const double m = 2.0 * sums.m[0][static_cast<std::size_t>(p)](k, l);
              if (row > column)
                value += m * sums.J.row(i).segment(p * M_, M_).dot(pair.row(row).segment(column, M_));
              else
                value += m * sums.J.row(i).segment(p * M_, M_).dot(pair.col(row).segment(column, M_));
            }
            value += sums.m[0][0](k, l) * pair(place_d(o + std::max(k, l), i), place_d(o + std::min(k, l), i));
          }
        out.raw[raw_group(i, n_)] += sums.v[i] * value;
      }
    }
    if (!d_) return;
    for (int i = 0; i < n_; ++i) {
      Gram local;
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l <= k; ++l)
          local(k, l) = local(l, k) = pair(place_d(o + k, i), place_d(o + l, i)) + A.row(place_d(o + k, i)).dot(A.row(place_d(o + l, i)));
      out.inside[static_cast<std::size_t>(i)] += local;
      if (interval == 0) out.start[static_cast<std::size_t>(i)] = local;
    }
  }

  static Eigen::MatrixXd symmetric(const Eigen::MatrixXd& lower) {
    return lower.selfadjointView<Eigen::Lower>();
  }

  // - 2 <H_xt, Z P> of the motion rows, by group.
  void trace_clock(const Stretch& s, const Columns& columns, std::size_t g, const Eigen::MatrixXd& A,
                   const Eigen::MatrixXd& root, Traces& out) const {
    const Eigen::MatrixXd& CF = clock_F_[g];
    int first = 0;
    for (std::size_t i = 0; i < s.motion.size(); ++i) {
      const int count = 2 + (columns.bias[i] >= 0 ? M_ : 0);
      for (int x = 0; x < count; ++x) {
        const Eigen::VectorXd ZP = A * root.row(clock_columns_[static_cast<std::size_t>(first + x)]).transpose();
        for (int k = 0; k < 2 * kBlock; ++k)
          for (int j = 0; j < M_; ++j) {
            const Eigen::Index at = place(k, j);
            const double share = -2.0 * CF(at, first + x) * ZP[at];
            out.motion[i][s.log().motion[i].group[j]] += share;
            out.motion_share += share;
          }
      }
      first += count;
    }
  }
};

}  // namespace truewrench
