// One sweep over a stretch: interval sums -> blocks of five knots -> information on theta, the motion and the discrepancy
// eliminated on the way; back for the step; traces.hpp: the exact traces of (10.6) (METHOD 9).
#pragma once

#include "truewrench/estimation/intervals.hpp"

#include <array>
#include <utility>
#include <vector>

namespace truewrench {

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
  std::vector<Gram> inside,
      start;  // of each channel: the discrepancy's covariance, summed over the intervals; the first
};

class Sweep {
 public:
  // How much of a sweep is asked for: all; log |H_xx| and nothing else; or that with the sums over the sensor's samples as they
  // stand, where only the smoothness and the motion's clocks differ.
  enum class Extent { whole, determinant, determinant_again };

  // Eliminate the motion (and the discrepancy) of a stretch, at its last prediction. `said`, where it is asked for: what the rows
  // of blocks 0 ... g say by themselves, for every g of `breaks`, increasing.
  Information forward(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta,
                      const RowMatrix& lagged, const Sizes& sizes, Extent extent = Extent::whole,
                      const std::vector<int>& breaks = {}, std::vector<Information>* said = nullptr) {
    setup(s, columns, theta, lagged, sizes, extent);
    Information out;
    const int last = blocks() - 1;
    for (int g = 0; g <= last; ++g) {
      double *P = panel(g), *N = g < last ? panel(g + 1) : nullptr;
      if (g < last)
        for (int o = 0; o < kBlock; ++o) add_interval(s, columns, kBlock * g + o, o, P, N);
      if (!shape_.eliminate(P, N, alone_ ? nullptr : htt_.data(), out.logdet)) {
        out.logdet = std::nan("");
        return out;
      }
      if (said && g < last && said->size() < breaks.size() && breaks[said->size()] == g)
        said->push_back(said_so_far(N));
    }
    if (!alone_) write(htt_, out);
    return out;
  }

  // The step of the coefficients that belongs to a step of theta.
  void back(const Eigen::VectorXd& step, RowMatrix& dc, RowMatrix& de) const {
    // x of a block and, from Wp on, the next; then - step, and 1 for the gradient: a row of a panel times it is what is left
    std::vector<double> x(static_cast<std::size_t>(shape_.ld), 0.0);
    for (int k = 0; k < shape_.nt; ++k) x[static_cast<std::size_t>(2 * shape_.Wp + k)] = step[k];
    x[static_cast<std::size_t>(2 * shape_.Wp + shape_.nt)] = -1.0;
    for (int g = blocks() - 1; g >= 0; --g) {
      const double* P = panel(g);
      std::copy_n(x.begin(), shape_.W, x.begin() + shape_.Wp);
      std::fill_n(x.begin(), shape_.W, 0.0);
      for (int i = shape_.W - 1; i >= 0; --i) {
        const double* row = P + i * shape_.ld;
        const int from = i & ~7;  // x is 0 up to i
        x[static_cast<std::size_t>(i)] = -dense::dot(row + from, x.data() + from, shape_.ld - from) / row[i];
      }
      for (int k = 0; k < kBlock; ++k) {
        std::copy_n(x.data() + k * shape_.m, M_, dc.data() + (kBlock * g + k) * M_);
        if (d_) std::copy_n(x.data() + k * shape_.m + M_, n_, de.data() + (kBlock * g + k) * n_);
      }
    }
  }

  // The traces of (10.6), with P the covariance of the log's parameters.
  Traces traces(const Stretch& s, const Columns& columns, const Sizes& sizes, const Eigen::MatrixXd& P) const;

  // For scores: X (W, columns) <- R^-T X of a block; `next` (W, columns) -= what of it the next block's rows see;
  // `theta` (parameters, columns) -= what theta's see.
  void descend(int g, double* X, double* next, double* theta, int columns) const {
    const double* P = panel(g);
    dense::solve_transposed(P, shape_.ld, shape_.W, X, columns, columns);
    dense::subtract(theta, columns, P + 2 * shape_.Wp, 1, shape_.ld, X, columns, shape_.nt, columns,
                    shape_.W);
    if (next)
      dense::subtract(next, columns, P + shape_.Wp, 1, shape_.ld, X, columns, shape_.W, columns, shape_.W);
  }

  int blocks() const { return blocks_; }
  int width() const { return shape_.W; }
  int parameters() const { return shape_.nt; }
  // Row of a pair of blocks: coefficient k (0 ... 9) of component j, or of channel i's discrepancy.
  int place(int k, int j) const { return k * shape_.m + j; }
  int place_d(int k, int i) const { return k * shape_.m + M_ + i; }
  const RowSums& sums() const { return intervals_.sums; }
  // The sums of an interval's samples: [first, second) of `pool`.
  const std::vector<RawSums>& pool() const { return pool_; }
  std::pair<std::size_t, std::size_t> of_interval(Eigen::Index interval) const {
    const auto i = static_cast<std::size_t>(interval);
    return {first_[i], first_[i + 1]};
  }

 private:
  Intervals intervals_;
  Shape shape_;
  int M_ = 6, n_ = 6, nc_ = 2, blocks_ = 0;
  bool d_ = false, alone_ = false, again_ = false;
  std::vector<double> panels_, htt_;  // (W, ld) a block; (nt + 1, ldt) upper triangle
  std::vector<RawSums> pool_;
  std::vector<std::size_t> first_;                // by interval
  std::vector<std::vector<double>> motion_sums_;  // by stream: (intervals, pairs, M) sum of B B^T
  std::vector<double> clock_F_;  // (10, M, nc) a block: H_xt of motion rows by clock_columns_
  std::vector<std::vector<Eigen::MatrixXd>> clock_tt_;  // by stream and group
  std::vector<int> clock_columns_;
  std::vector<double> smoothness_;  // (6, 6, M) R_p / q_j of an interval
  Penalty discrepancy_;
  std::vector<double> delta_information_;                // (n) 1 / delta_i^2
  std::vector<std::vector<double>> motion_information_;  // (M) 1 / sigma_j^2
  std::vector<Eigen::Index> motion_next_;
  std::vector<double> band_;  // (pairs, M): what couples a component with itself

  // A pair of blocks on the way back: covariances with theta known, and theta's share.
  struct Pair {
    std::vector<double> here, next;    // (W, 2 Wp) of a block: [its knots; the next block's]
    std::vector<double> A, A_next;     // (W, padded(nt)) what theta moves, by the root of its covariance
    std::vector<double> known, theta;  // (10 knots, lag 0 ... 5, M): covariance of a component with itself
    std::vector<double> ZP, ZP_next;   // (W, nc) - covariance with theta's clock columns
  };
  void trace_interval(const Stretch& s, Eigen::Index interval, int o, const Pair& pair,
                      std::vector<double>& total, Traces& out) const;
  void trace_discrepancy(Eigen::Index interval, int o, const Pair& pair, Traces& out) const;

  double* panel(int g) { return panels_.data() + static_cast<std::ptrdiff_t>(g) * shape_.W * shape_.ld; }
  const double* panel(int g) const {
    return panels_.data() + static_cast<std::ptrdiff_t>(g) * shape_.W * shape_.ld;
  }
  double& tt(int i, int j) { return htt_[shape_.tt(i, j)]; }
  void write(const std::vector<double>& T, Information& out) const {
    const int nt = shape_.nt;
    out.S.resize(nt, nt);
    out.g.resize(nt);
    for (int i = 0; i < nt; ++i) {
      for (int j = i; j < nt; ++j) out.S(i, j) = out.S(j, i) = T[shape_.tt(i, j)];
      out.g[i] = T[shape_.tt(i, nt)];
    }
  }
  // The rows N of the next block eliminated too, as they stand.
  Information said_so_far(const double* N) const {
    Information out;
    std::vector<double> rows(N, N + shape_.W * shape_.ld), T = htt_;
    rows.resize(rows.size() + 8);
    if (!shape_.eliminate(rows.data(), nullptr, T.data(), out.logdet)) out.logdet = std::nan("");
    write(T, out);
    return out;
  }

  void setup(const Stretch& s, const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
             const Sizes& sizes, Extent extent) {
    const bool alone = extent != Extent::whole;
    again_ = extent == Extent::determinant_again;
    intervals_.setup(s, columns, theta, lagged, sizes, alone);
    M_ = s.components();
    n_ = s.channels();
    alone_ = alone;
    d_ = sizes.form != Form::none;
    // where it is of H_xx alone a panel ends in the gradient's column, unread
    shape_ = Shape(M_ + (d_ ? n_ : 0), alone ? 0 : columns.size());
    blocks_ = static_cast<int>(s.spline.blocks()) + 1;
    panels_.assign(static_cast<std::size_t>(blocks_ * shape_.W * shape_.ld + 8), 0.0);
    htt_.assign(static_cast<std::size_t>((shape_.nt + 1) * shape_.ldt + 8), 0.0);
    const auto intervals = static_cast<std::size_t>(s.spline.intervals());
    if (!again_) first_.assign(intervals + 1, 0);
    band_.resize(static_cast<std::size_t>(kPairs * M_));
    smoothness_.resize(static_cast<std::size_t>(kLocal * kLocal * M_));
    for (int j = 0; j < M_; ++j) {
      const Gram R = s.spline.smoothness(smoothness_order(s.log().source, j)).inside;
      for (int k = 0; k < kLocal * kLocal; ++k)
        smoothness_[static_cast<std::size_t>(k * M_ + j)] = R.data()[k] / sizes.q[j];
    }
    if (d_) discrepancy_ = s.spline.discrepancy(sizes.k, sizes.form);
    delta_information_.assign(static_cast<std::size_t>(n_), 0.0);
    for (int i = 0; i < n_ && d_; ++i) {
      const double delta = sizes.delta[raw_group(i, n_)];
      delta_information_[static_cast<std::size_t>(i)] = 1.0 / (delta * delta);
    }
    const std::size_t streams = s.motion.size();
    motion_information_.resize(streams);
    motion_sums_.resize(streams);
    motion_next_.assign(streams, 0);
    clock_columns_.clear();
    for (std::size_t i = 0; i < streams; ++i) {
      const MotionStream& stream = s.log().motion[i];
      motion_information_[i].resize(static_cast<std::size_t>(M_));
      for (int j = 0; j < M_; ++j) {
        const double sigma = stream.sigma[j] * sizes.motion_factor[i][stream.group[j]];
        motion_information_[i][static_cast<std::size_t>(j)] = 1.0 / (sigma * sigma);
      }
      motion_sums_[i].assign(intervals * static_cast<std::size_t>(kPairs * M_), 0.0);
      clock_columns_.insert(clock_columns_.end(), {columns.clock[i], columns.clock[i] + 1});
      if (columns.bias[i] >= 0)
        for (int j = 0; j < M_; ++j) clock_columns_.push_back(columns.bias[i] + j);
    }
    nc_ = static_cast<int>(clock_columns_.size());
    clock_F_.assign(static_cast<std::size_t>((blocks_ - 1) * 2 * kBlock * M_ * nc_), 0.0);
    clock_tt_.resize(streams);
    for (std::size_t i = 0; i < streams; ++i)
      clock_tt_[i].assign(static_cast<std::size_t>(sizes.motion_factor[i].size()),
                          Eigen::MatrixXd::Zero(nc_, nc_));
  }

  void add_interval(const Stretch& s, const Columns& columns, Eigen::Index interval, int o, double* P,
                    double* N) {
    const Places at = shape_.places(o, P, N);
    double* band = band_.data();
    for (int k = 0; k < kLocal; ++k)
      for (int l = k; l < kLocal; ++l)
        std::copy_n(smoothness_.data() + (kLocal * l + k) * M_, M_, band + knot_pair(k, l) * M_);
    add_pull(s, interval, at);
    for (std::size_t i = 0; i < s.motion.size(); ++i) add_motion(s, columns, i, interval, o, at, band);
    for (int k = 0; k < kLocal; ++k)
      for (int l = k; l < kLocal; ++l)
        for (int j = 0; j < M_; ++j)
          at.row[k][j * shape_.ld + at.column[k][l] + j] += band[knot_pair(k, l) * M_ + j];
    RowSums& of = intervals_.sums;
    const auto take = [&](const RawSums& sums) {
      if (M_ == 6)
        of.add_band<6>(sums, at);
      else
        of.add_band<0>(sums, at);
      if (d_) add_discrepancy(columns, sums, at);
      if (alone_) return;
      if (M_ == 6)
        of.add_cross<6>(sums, at, shape_.nt);
      else
        of.add_cross<0>(sums, at, shape_.nt);
      of.add_theta(sums, shape_, htt_.data());
    };
    if (again_) {
      for (auto [k, end] = of_interval(interval); k < end; ++k) take(pool_[k]);
      return;
    }
    std::size_t used = first_[static_cast<std::size_t>(interval)];
    intervals_.raw(s, columns, interval, pool_, used, take);
    first_[static_cast<std::size_t>(interval) + 1] = used;
  }

  // (10.1) and (10.2): the gradient of c^T R c / q and e^T R_M e / delta^2, and the latter's information.
  void add_pull(const Stretch& s, Eigen::Index interval, const Places& at) const {
    const int gradient = 2 * shape_.Wp + shape_.nt;
    for (int k = 0; k < kLocal; ++k)
      for (int l = 0; l < kLocal; ++l) {
        const double *R = smoothness_.data() + (kLocal * l + k) * M_, *c = s.c.data() + (interval + l) * M_;
        const double* from =
            s.c.data() + interval * M_;  // R annihilates a constant, which would drown the rest in rounding
        for (int j = 0; j < M_; ++j) at.row[k][j * shape_.ld + gradient] -= R[j] * (c[j] - from[j]);
      }
    if (!d_) return;
    for (int k = 0; k < kLocal; ++k)
      for (int l = 0; l < kLocal; ++l) {
        const double R = discrepancy_.inside(k, l) + (interval == 0 ? discrepancy_.start(k, l) : 0.0) +
                         (interval + 1 == s.spline.intervals() ? discrepancy_.end(k, l) : 0.0);
        const double* e = s.e.data() + (interval + l) * n_;
        for (int i = 0; i < n_; ++i) {
          double* row = at.row[k] + (M_ + i) * shape_.ld;
          const double x = delta_information_[static_cast<std::size_t>(i)] * R;
          row[gradient] -= x * e[i];
          if (l >= k) row[at.column[k][l] + M_ + i] += x;
        }
      }
  }

  // Rows of (10.4).
  void add_motion(const Stretch& s, const Columns& columns, std::size_t i, Eigen::Index interval, int o,
                  const Places& at, double* band) {
    const MotionRows& m = s.motion[i];
    const double* v = motion_information_[i].data();
    const Eigen::VectorXi& group = s.log().motion[i].group;
    double* sums = motion_sums_[i].data() + interval * kPairs * M_;
    double* CF = clock_F_.data() + ((interval / kBlock) * 2 * kBlock + o) * M_ * nc_;
    int first = 0;
    for (std::size_t before = 0; before < i; ++before) first += 2 + (columns.bias[before] >= 0 ? M_ : 0);
    const int s_at = columns.clock[i], bias = columns.bias[i], theta = 2 * shape_.Wp;
    // sums over the samples: [residual; by s; by kappa; 1], weighted, of each knot and component; and their products
    double of_knot[kLocal][4 * max_components], of_theta[6][max_components];
    for (auto& x : of_knot) std::fill_n(x, 4 * M_, 0.0);
    for (auto& x : of_theta) std::fill_n(x, M_, 0.0);
    double plain[3][max_components] = {};  // [residual; by s; by kappa], weighted: beside the bias
    Eigen::Index& k = motion_next_[i];
    for (; k < m.rows() && m.interval[static_cast<std::size_t>(k)] == interval; ++k) {
      const double *b = m.basis.data() + k * kLocal, *by_s = m.by_s.data() + k * M_,
                   *by_kappa = m.by_kappa.data() + k * M_;
      const double *value = m.value.data() + k * M_, *residual = m.residual.data() + k * M_;
      double here[max_components], x[4 * max_components];
      for (int j = 0; j < M_; ++j) {
        here[j] = std::isfinite(value[j]) ? m.size[k] : 0.0;
        const double weight = here[j] * v[j];
        x[j] = weight * residual[j];
        x[M_ + j] = weight * by_s[j];
        x[2 * M_ + j] = weight * by_kappa[j];
        x[3 * M_ + j] = weight;
        of_theta[0][j] += x[M_ + j] * by_s[j];
        of_theta[1][j] += x[M_ + j] * by_kappa[j];
        of_theta[2][j] += x[2 * M_ + j] * by_kappa[j];
        of_theta[3][j] += x[j] * by_s[j];
        of_theta[4][j] += x[j] * by_kappa[j];
        of_theta[5][j] += weight;
        for (int c = 0; c < 3; ++c) plain[c][j] += x[c * M_ + j];
      }
      for (int l = 0; l < kLocal; ++l) {
        dense::add(of_knot[l], b[l], x, 4 * M_);
        for (int h = l; h < kLocal; ++h) dense::add(sums + knot_pair(l, h) * M_, b[l] * b[h], here, M_);
      }
    }
    for (int j = 0; j < M_ && !alone_; ++j) {
      Eigen::MatrixXd& own = clock_tt_[i][static_cast<std::size_t>(group[j])];
      const auto both = [&](int a, int c, double x) {  // of two of the stream's columns
        own(first + a, first + c) += x;
        if (a != c) own(first + c, first + a) += x;
        tt((a < 2 ? s_at : bias - 2) + a, (c < 2 ? s_at : bias - 2) + c) += x;
      };
      both(0, 0, of_theta[0][j]);
      both(0, 1, of_theta[1][j]);
      both(1, 1, of_theta[2][j]);
      tt(s_at, shape_.nt) += of_theta[3][j];
      tt(s_at + 1, shape_.nt) += of_theta[4][j];
      for (int l = 0; l < kLocal; ++l) {
        double *row = at.row[l] + j * shape_.ld + theta, *cross = CF + (l * M_ + j) * nc_ + first;
        const double* x = of_knot[l] + j;
        row[shape_.nt] += x[0];
        for (int c = 0; c < 2; ++c) {
          row[s_at + c] += x[(1 + c) * M_];
          cross[c] += x[(1 + c) * M_];
        }
        if (bias < 0) continue;
        row[bias + j] += x[3 * M_];
        cross[2 + j] += x[3 * M_];
      }
      if (bias < 0) continue;
      both(2 + j, 2 + j, of_theta[5][j]);
      both(0, 2 + j, plain[1][j]);
      both(1, 2 + j, plain[2][j]);
      tt(bias + j, shape_.nt) += plain[0][j];
    }
    for (int pair = 0; pair < kPairs; ++pair)
      for (int j = 0; j < M_; ++j) band[pair * M_ + j] += v[j] * sums[pair * M_ + j];
  }

  // H_xx and H_xt of the discrepancy: d raw / d e = B.
  void add_discrepancy(const Columns& columns, const RawSums& sums, const Places& at) {
    const RowSums& of = intervals_.sums;
    const int OM = of.orders * M_, nf = of.nf, nd = of.nd;
    for (int k = 0; k < kLocal; ++k)
      for (int i = 0; i < n_; ++i) {
        const double v = sums.v[static_cast<std::size_t>(i)];
        double* own = at.row[k] + (M_ + i) * shape_.ld;
        for (int l = 0; l < kLocal; ++l) {
          for (int p = 0; p < of.orders; ++p) {
            const double x = v * sums.m[order_pair[0][p]](k, l);
            const double* J = sums.J.data() + i * OM + p * M_;
            if (k < l)
              for (int j = 0; j < M_; ++j) own[at.column[k][l] + j] += x * J[j];
            else
              for (int j = 0; j < M_; ++j) at.row[l][j * shape_.ld + at.column[l][k] + M_ + i] += x * J[j];
          }
          if (l >= k) own[at.column[k][l] + M_ + i] += v * sums.m[0](k, l);
        }
        if (alone_) continue;
        const double* G = of.G.data() + k * of.ld;
        double* row = own + 2 * shape_.Wp;
        for (int x = 0; x < nf; ++x) row[of.feature[static_cast<std::size_t>(i * nf + x)]] += v * G[x];
        row[columns.u + i] += v * G[nf + i];
        for (int c = 0; c < 6; ++c) {
          const double x = sums.SV[static_cast<std::size_t>(c * n_ + i)];
          for (int y = 0; y < nd; ++y)
            row[of.dense_columns[static_cast<std::size_t>(y)]] += x * G[nf + n_ + c * nd + y];
        }
        row[shape_.nt] += of.gd[static_cast<std::size_t>(k * n_ + i)];
      }
  }
};

}  // namespace truewrench

#include "truewrench/estimation/traces.hpp"
