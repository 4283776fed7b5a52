// A fixed lag of blocks of five knots: linearised at the coefficients as they stand, eliminated block by
// block, back for the motion that belongs to a theta, and the exact traces of (10.6) by selected inversion
// (METHOD 9, 10.6). What was eliminated is a Gaussian on (first block that remains, theta), kept in absolute
// coordinates: a later theta may use it.
//
// The same information as a Sweep over a stretch, by the same sums and eliminations, on memory that is fixed
// at construction, with twists or an IMU alone.
//
// theta's columns, and what waits for a later theta, are in the coordinates of products.hpp.
#pragma once

#include "truewrench/estimation/lag_rows.hpp"
#include "truewrench/estimation/products.hpp"
#include "truewrench/estimation/row_sums.hpp"
#include "truewrench/model/gravity.hpp"

namespace truewrench {

inline constexpr int kComponents = 6;
inline constexpr int kWidth = kBlock * kComponents;  // coefficients of a block
inline constexpr int kPadded = 32;                   // of kWidth, for the tiles
inline constexpr int kTheta = 2 * kPadded;           // theta's columns in a panel begin here

using BlockVector = Eigen::Matrix<double, kWidth, 1>;
using Cursor = std::array<long, kMostStreams>;  // of each motion stream: the next row

// Squares, counts and traces of (10.6), by groups of rows and components.
struct SizeSums {
  using Groups = std::array<double, kComponents>;
  std::array<double, 2> raw{}, raw_count{}, raw_trace{};
  std::array<Groups, kMostStreams> motion{}, motion_count{}, motion_trace{};
  Groups energy{}, energy_trace{};  // c^T R c; tr R Sigma / q
  double knots = 0.0;

  SizeSums& operator+=(const SizeSums& o) {
    const auto add = [](auto& to, const auto& from) {
      for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
    };
    add(raw, o.raw);
    add(raw_count, o.raw_count);
    add(raw_trace, o.raw_trace);
    for (std::size_t i = 0; i < kMostStreams; ++i) {
      add(motion[i], o.motion[i]);
      add(motion_count[i], o.motion_count[i]);
      add(motion_trace[i], o.motion_trace[i]);
    }
    add(energy, o.energy);
    add(energy_trace, o.energy_trace);
    knots += o.knots;
    return *this;
  }
};

// The information that eliminated blocks leave on the next one and on theta, in absolute coordinates: rows of
// the block's [H, - ; H_xt, information vector], and theta's. Upper triangles.
struct Front {
  std::vector<double> panel, T;
  Cursor next{};        // first motion row that is not in it
  double logdet = 0.0;  // of what was eliminated
};

class Lag {
 public:
  struct Interval {
    int rows = 0;
    double spared = 0.0;   // samples that the remainder counts, of the channels that the gathered rows have
    Channels remainder{};  // sum of squares within what the gathered rows stand for
    double begin = 0.0, end = 0.0;
    std::array<RawRow, kMostRows> row;
    RawSums sums;  // as linearised, for the traces
    std::array<std::array<double, kPairs * kComponents>, kMostStreams> motion;  // sum of B B^T by component
  };
  struct Block {
    std::vector<double> panel;  // R of the pivot, R^-T of the next block's
                                // columns, R^-T [H_xt, information vector]
    bool alone = false;         // H_xt is not in it: theta known
    BlockVector x = BlockVector::Zero();
    SizeSums sums;
  };

  Lag() = default;
  Lag(const Statement& rig, const RecordedLog& about, int blocks, int most_samples)
      : rig_(rig), n_(static_cast<int>(rig.noise.size())) {
    intervals_.resize(static_cast<std::size_t>(kBlock * (blocks + 1)));
    blocks_.resize(static_cast<std::size_t>(blocks + 2));
    window_.reserve(most_samples);
    for (auto& m : motion_) m.reserve(static_cast<std::size_t>(kMostRows * kBlock * (blocks + 2)));
    times_.assign(std::size_t{1} << kMostChannels, 0);
    carry(about);
    resize_work();
  }

  // A log of the same rig; theta's places may be other ones.
  void carry(const RecordedLog& about);
  // Memory that depends on theta's length.
  void resize_work();

  Front make_front() const {
    Front f;
    f.panel.assign(static_cast<std::size_t>(kWidth * shape_.ld + 8), 0.0);
    f.T.assign(static_cast<std::size_t>((nt_ + 1) * shape_.ldt + 8), 0.0);
    return f;
  }
  // Of the motion, theta known: of an information vector alone.
  Front make_moving() const {
    Front f;
    f.panel.assign(static_cast<std::size_t>(kWidth * alone_.ld), 0.0);
    return f;
  }
  // theta's information alone: S (nt + 1, nt + 1), lower triangle, the information vector in its last row.
  void set_front(Front& f, const Eigen::MatrixXd& S) const {
    std::fill(f.panel.begin(), f.panel.end(), 0.0);
    for (int i = 0; i < nt_; ++i)
      for (int j = i; j <= nt_; ++j) f.T[shape_.tt(i, j)] = S(j, i);
    f.logdet = 0.0;
  }

  // Knots of a new stretch.
  void place(double origin, double h) {
    origin_ = origin;
    h_ = h;
    first_ = end_ = 0;
    for (auto& m : motion_) m.clear();
    spline_ = Spline(0.0, 2 * kBlock * h, h);  // for its bases and products alone
  }
  Eigen::VectorXd theta;
  RowMatrix lagged;  // C_0 of (10.3)
  Sizes sizes;

  const Statement& rig() const { return rig_; }
  const RecordedLog& about() const { return about_; }
  const Layout& layout() const { return layout_; }
  int channels() const { return n_; }
  int parameters() const { return nt_; }
  std::size_t streams() const { return streams_; }
  bool felt() const { return felt_; }  // gravity: along an attitude that comes with the samples
  double origin() const { return origin_; }
  double h() const { return h_; }
  double start_of(long block) const { return origin_ + h_ * static_cast<double>(kBlock * block); }
  long first() const { return first_; }
  long end() const { return end_; }
  const Columns& columns() const { return columns_; }  // in theta
  Block& block(long g) { return blocks_[static_cast<std::size_t>(g) % blocks_.size()]; }
  const Block& block(long g) const { return blocks_[static_cast<std::size_t>(g) % blocks_.size()]; }
  Interval& interval(long i) { return intervals_[static_cast<std::size_t>(i) % intervals_.size()]; }
  const Interval& interval(long i) const {
    return intervals_[static_cast<std::size_t>(i) % intervals_.size()];
  }
  Ring<MotionRow>& motion(std::size_t i) { return motion_[i]; }
  const Ring<MotionRow>& motion(std::size_t i) const { return motion_[i]; }
  void grow() { ++end_; }
  void drop_before(long block) { first_ = block; }
  double noise(int i) const { return rig_.noise[i] * sizes.raw_factor[raw_group(i, n_)]; }
  double motion_noise(std::size_t i, int j) const {
    return about_.motion[i].sigma[j] * sizes.motion_factor[i][about_.motion[i].group[j]];
  }
  double clock(std::size_t i) const { return theta[columns_.clock[i]]; }

  // Rows of the sensor's samples [from, to) of one interval; what it leaves out goes to `masked(begin, end)`.
  template <typename Masked>
  void take(long at, const Ring<RawSample>& samples, long from, long to, const Masked& masked);
  // Rows of the motion's samples [from, to) of one interval.
  void take(std::size_t stream, const Ring<MotionSample>& samples, long from, long to);

  // Residuals of the sensor's rows of a block at its coefficients and theta.
  void predict(long g);
  // w_t of 10.3; `scale` divides chi^2. One weight for all that the gathered rows of an interval stand for.
  void reweigh(long g, double scale = 1.0) {
    for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
      Interval& v = interval(i);
      for (int r = 0; r < v.rows; ++r) {
        RawRow& row = v.row[static_cast<std::size_t>(r)];
        row.weight = robust_weight(row.channels, chi2(v, row) / scale);
      }
    }
  }
  // chi^2 of a row, or of a sample of those that gathered rows stand for.
  double chi2(const Interval& v, const RawRow& row) const {
    if (!row.gathered) return chi2(row);
    double sum = 0.0, samples = 0.0;
    for (std::size_t c = 0; c < static_cast<std::size_t>(n_); ++c) {
      const double sigma = noise(static_cast<int>(c));
      sum += v.remainder[c] / (sigma * sigma);
    }
    for (int r = 0; r < v.rows; ++r) {
      const RawRow& one = v.row[static_cast<std::size_t>(r)];
      if (!one.gathered) continue;
      sum += one.size * chi2(one);
      samples += one.size;
    }
    return sum / std::max(samples, 1.0);
  }
  double chi2(const RawRow& row) const {
    double sum = 0.0;
    for (int i = 0; i < n_; ++i) {
      const double z = row.residual[static_cast<std::size_t>(i)] / noise(i);
      sum += z * z;
    }
    return sum;
  }

  // What a front knows of its block, theta as it stands.
  void know_theta(const Front& f, Front& moving);
  // Coefficients of a block and the next from what a front knows of the first,
  // and the block's motion, theta known.
  void expect(Front& moving, long g, bool last);
  // The rows of a block whose motion was expected, as predicted and weighted, theta known, and eliminate it. False where it cannot
  // be factored; so terminal(), after which back() may be called.
  bool join(Front& moving, long g);
  bool terminal(const Front& moving);
  // Linearise blocks [from, to) as predicted and weighted and eliminate them; `last`: with all motion rows that remain. False where
  // one cannot be factored.
  bool eliminate(Front& f, long from, long to, bool last);
  SizeSums departures(const Front& f);
  // theta's information with the first block that remains eliminated too, as in set_front(); log |H|.
  double terminal(const Front& f, Eigen::MatrixXd& S);
  // The coefficients that belong to theta, of blocks [from, end()], after terminal() of the front at end().
  void back(long from);
  // Traces of (10.6) into the sums of blocks [from, end()), after terminal() likewise.
  void traces(long from);
  // The terms of (10.7) in the motion and the rows of a block, the sensor's as predicted.
  double objective(long g, Cursor& next, bool last) const;
  // Information on theta, to first order at it, from that on the coordinates.
  void pull(const Eigen::MatrixXd& from, Eigen::MatrixXd& to) {
    refresh();
    products_.pull(from, theta.data(), z_.data(), to, full_);
  }
  // z^T Lambda z - 2 z^T eta of a front, at the coefficients of its block and theta.
  double objective(const Front& f, long g) const;

  // R_p of an interval (10.1).
  Gram smoothness(int j) const { return spline_.smoothness(smoothness_order(about_.source, j)).inside; }

 private:
  Statement rig_;
  RecordedLog about_;
  Layout layout_;
  Columns columns_;
  Shape shape_, alone_{kComponents, 0};  // with theta; the motion alone, theta known
  int n_ = 6, nt_ = 0, rows_ = 0;
  bool felt_ = false;        // gravity
  bool last_alone_ = false;  // last_ is of a motion, theta known
  std::size_t streams_ = 0;
  Products products_;
  RowSums sums_;
  RawSums spare_;
  double origin_ = 0.0, h_ = 1.0;
  Spline spline_;
  long first_ = 0, end_ = 0;  // blocks that stand
  std::vector<Interval> intervals_;
  std::vector<Block> blocks_;
  std::array<Ring<MotionRow>, kMostStreams> motion_;
  Window<kNodes, kMostChannels> window_;
  std::vector<int> times_;  // by cells: how often; zero between uses
  std::array<double, 6> scale_{};
  // the model at theta
  Gravity gravity_;
  Vector3 point_ = Vector3::Zero();  // the twist's, seen from the centre
  std::vector<double> z_, lagged_;   // coordinates; C_0 by phi

  std::array<const RawRow*, kMostRows> row_{};                              // those of one sum, rows_ of them
  std::vector<double> last_, work_, T_, full_, here_, next_, inverse_, V_;  // work space

  template <typename Samples, typename Cells>
  std::pair<unsigned, long> most_cells(const Samples& samples, long from, long to, const Cells& cells);
  template <typename Samples, typename Cells, typename Single>
  std::pair<unsigned, int> pick(const Samples& samples, long from, long to, const Cells& cells,
                                const Single& single);

  void refresh();
  void jacobians(const RawRow& row, double* J, double* X) const;

  // One motion row against the coefficients of its block: which interval of the
  // block, its basis (10.4), its derivatives.
  struct Placed {
    int o = 0;
    Basis b;
    double by_s[kComponents], by_kappa[kComponents], residual[kComponents];
  };
  bool placed(std::size_t i, const MotionRow& row, long g, bool last, const double* xx, Placed& out) const;
  void coefficients(long g, double* xx) const {
    std::copy_n(block(g).x.data(), kWidth, xx);
    std::copy_n(block(g + 1).x.data(), kWidth, xx + kWidth);
  }

  void add_smoothness(const Shape& shape, double* P, double* N, const double* xx, SizeSums* sums) const;
  void add_motion(Front& f, double* P, double* N, long g, bool last, const double* xx, SizeSums& sums);
  template <typename Sum>
  void each_cells(Interval& v, const Sum& sum);
  bool gather_rows(const Interval& v, unsigned same, RawSums& out);
  void sum_rows(Front& f, const Interval& v, unsigned same, RawSums& out, const Places& at, SizeSums& sums);
  void turn(Front& f, const double* x, double sign);
  bool eliminate_block(Front& f, long g, bool last);
};

}  // namespace truewrench

#include "truewrench/estimation/lag_sums.hpp"
#include "truewrench/estimation/lag_sweep.hpp"
#include "truewrench/estimation/lag_take.hpp"
