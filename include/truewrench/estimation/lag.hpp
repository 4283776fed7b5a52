// A fixed lag of blocks of five knots: linearised at the coefficients and theta as they stand, eliminated block by block, back
// for the motion that belongs to a theta, and the exact traces of (10.6) by selected inversion (METHOD 9, 10.6). What was
// eliminated is a Gaussian on (first block that remains, theta), kept in absolute coordinates: a later theta may use it.
//
// The same information as a sweep over a stretch, on memory that is fixed at construction and with twists or an IMU alone.
#pragma once

#include "truewrench/estimation/lag_rows.hpp"
#include "truewrench/estimation/sweep.hpp"

namespace truewrench {

inline constexpr int kComponents = 6;
inline constexpr int kWidth = kBlock * kComponents;  // coefficients of a block
inline constexpr int kUnder = kLocal * kComponents;  // coefficients under an interval
inline constexpr int kMostDense =
    kBodyParameters + 5;  // parameters that every channel feels alike: body, s, kappa, gamma, tilt

using BlockMatrix = Eigen::Matrix<double, kWidth, kWidth>;
using PairMatrix = Eigen::Matrix<double, 2 * kWidth, 2 * kWidth>;
using BlockVector = Eigen::Matrix<double, kWidth, 1>;
using PairVector = Eigen::Matrix<double, 2 * kWidth, 1>;
using Dense = Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::ColMajor, 6, kMostDense>;
using DenseFlat = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, 6 * kMostDense, 1>;

// Squares, counts and traces of (10.6), by groups of rows and components.
struct SizeSums {
  Eigen::Array2d raw = Eigen::Array2d::Zero(), raw_count = raw, raw_trace = raw;
  std::array<Eigen::Array<double, 6, 1>, kMostStreams> motion{zero(), zero(), zero()}, motion_count = motion,
                                                                                       motion_trace = motion;
  Eigen::Array<double, 6, 1> energy = zero(), energy_trace = zero();  // c^T R c; tr R Sigma / q
  double knots = 0.0;

  SizeSums& operator+=(const SizeSums& o) {
    raw += o.raw;
    raw_count += o.raw_count;
    raw_trace += o.raw_trace;
    for (std::size_t i = 0; i < kMostStreams; ++i) {
      motion[i] += o.motion[i];
      motion_count[i] += o.motion_count[i];
      motion_trace[i] += o.motion_trace[i];
    }
    energy += o.energy;
    energy_trace += o.energy_trace;
    knots += o.knots;
    return *this;
  }

 private:
  static Eigen::Array<double, 6, 1> zero() { return Eigen::Array<double, 6, 1>::Zero(); }
};

using Cursor = std::array<long, kMostStreams>;  // of each motion stream: the next row

// The information that eliminated blocks leave on the next one and on theta: in absolute coordinates, lower triangles; the
// last column of F and the last row of T are the information vector.
struct Front {
  BlockMatrix H = BlockMatrix::Zero();
  Eigen::MatrixXd F, T;
  Cursor next{};        // first motion row that is not in it
  double logdet = 0.0;  // of what was eliminated
};

class Lag {
 public:
  struct Interval {
    int rows = 0;
    double spared = 0.0;  // samples that the remainder counts
    Channels remainder;   // sum of squares within what the rows stand for
    double begin = 0.0, end = 0.0;
    std::array<RawRow, kMostRows> row;
    // as linearised, for the traces
    Gram m00, m01, m11;
    Eigen::Matrix<double, Eigen::Dynamic, 12, Eigen::ColMajor, kMostChannels, 12> J;
    Channels v;
    std::array<Gram, kMostStreams> motion;
  };
  struct Block {
    BlockMatrix L, B;   // of the pivot; the next block's rows times L^-T
    Eigen::MatrixXd Y;  // L^-1 [H_xt, information vector]
    BlockVector x = BlockVector::Zero();
    SizeSums sums;
  };

  Lag() = default;
  Lag(const Statement& rig, const RecordedLog& about, int blocks, int most_samples)
      : rig_(rig), n_(static_cast<int>(rig.noise.size())) {
    intervals_.resize(static_cast<std::size_t>(kBlock * (blocks + 1)));
    for (Interval& i : intervals_) {
      i.remainder = i.v = Channels::Zero(n_);
      i.J.setZero(n_, 12);
      for (RawRow& r : i.row) r.value = r.have = r.residual = r.cw = Channels::Zero(n_);
    }
    blocks_.resize(static_cast<std::size_t>(blocks + 2));
    nodes_.reserve(most_samples);
    picked_.resize(static_cast<std::size_t>(most_samples));
    spikes_.resize(picked_.size());
    sorted_.resize(picked_.size());
    for (int i = 0; i < kMostStreams; ++i)
      motion_[static_cast<std::size_t>(i)].reserve(
          static_cast<std::size_t>(kMostRows * kBlock * (blocks + 2)));
    carry(about);
    resize_work();
    for (auto& b : BX_) b = Eigen::MatrixXd::Zero(6 * kMostDense, kLocal);
    FX_ = Eigen::MatrixXd::Zero(6 * kMostDense, 8);
    UX_ = Eigen::MatrixXd::Zero(6 * kMostDense, n_);
    UT_ = Eigen::MatrixXd::Zero(kMostDense, kMostChannels);
  }

  // A log of the same parameters; theta's places may be other ones.
  void carry(const RecordedLog& about) {
    about_ = about;
    layout_ = Layout(rig_, {&about_}, {});
    nt_ = layout_.size();
    const Columns& c = layout_.log(0);
    const auto at = [&c](int i) { return i < 0 ? -1 : c.global[static_cast<std::size_t>(i)]; };
    C_ = at(c.C), b_ = at(c.b), u_ = at(c.u), body_ = at(c.body), slope_ = at(c.slope), tilt_ = at(c.tilt),
    gamma_ = at(c.gamma);
    streams_ = about_.motion.size();
    for (std::size_t i = 0; i < streams_; ++i) {
      clock_[i] = at(c.clock[i]);
      bias_[i] = at(c.bias[i]);
    }
    gravity_ = rig_.gravity.squaredNorm() > 0.0 && about_.source != Source::imu;
    dense_.clear();
    for (int k = 0; k < kBodyParameters; ++k) dense_.push_back(body_ + k);
    if (gamma_ >= 0) dense_.insert(dense_.end(), {clock_[0], clock_[0] + 1, gamma_});
    if (tilt_ >= 0 && gravity_) dense_.insert(dense_.end(), {tilt_, tilt_ + 1});
    nd_ = static_cast<int>(dense_.size());
    nf_ = slope_ >= 0 ? 8 : 7;
    theta = layout_.mean();
    sizes.raw_factor = Eigen::VectorXd::Ones(raw_groups(n_));
    sizes.q = Eigen::VectorXd::Constant(kComponents, constants::smoothness_start);
    sizes.motion_factor.clear();
    for (const MotionStream& m : about_.motion)
      sizes.motion_factor.push_back(Eigen::VectorXd::Ones(m.group.maxCoeff() + 1));
    lagged = rig_.nominal;
  }

  // Memory that depends on theta's length.
  void resize_work() {
    for (Block& b : blocks_) b.Y = Eigen::MatrixXd::Zero(kWidth, nt_ + 1);
    F_ = Eigen::MatrixXd::Zero(2 * kWidth, nt_ + 1);
    Z_ = Yf_ = Eigen::MatrixXd::Zero(kWidth, nt_ + 1);
    yt_ = Eigen::VectorXd::Zero(nt_);
  }

  Front make_front() const {
    Front f;
    f.F = Eigen::MatrixXd::Zero(kWidth, nt_ + 1);
    f.T = Eigen::MatrixXd::Zero(nt_ + 1, nt_ + 1);
    return f;
  }

  // Knots of a new stretch.
  void place(double origin, double h) {
    origin_ = origin;
    h_ = h;
    first_ = end_ = 0;
    for (auto& m : motion_) m.clear();
    spline_ = UnitBasis(h);
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
  double origin() const { return origin_; }
  double h() const { return h_; }
  double start_of(long block) const { return origin_ + h_ * static_cast<double>(kBlock * block); }
  long first() const { return first_; }
  long end() const { return end_; }
  int gain_at() const { return C_; }
  int offset_at() const { return b_; }
  int quadratic_at() const { return u_; }
  int clock_at(std::size_t i) const { return clock_[i]; }
  int gamma_at() const { return gamma_; }
  Block& block(long g) { return blocks_[static_cast<std::size_t>(g) % blocks_.size()]; }
  const Block& block(long g) const { return blocks_[static_cast<std::size_t>(g) % blocks_.size()]; }
  Interval& interval(long i) { return intervals_[static_cast<std::size_t>(i) % intervals_.size()]; }
  Ring<MotionRow>& motion(std::size_t i) { return motion_[i]; }
  void grow() { ++end_; }
  void drop_before(long block) { first_ = block; }
  bool room() const { return end_ - first_ + 2 < static_cast<long>(blocks_.size()); }
  double noise(int i) const { return rig_.noise[i] * sizes.raw_factor[raw_group(i, n_)]; }
  double motion_noise(std::size_t i, int j) const {
    return about_.motion[i].sigma[j] * sizes.motion_factor[i][about_.motion[i].group[j]];
  }

  // Rows of the sensor's samples [from, to) of one interval; what it leaves out goes to `masked(begin, end)`.
  template <typename Masked>
  void take(long at, const Ring<RawSample>& samples, long from, long to, const Masked& masked);
  // Rows of the motion's samples [from, to) of one interval.
  void take(std::size_t stream, const Ring<MotionSample>& samples, long from, long to);

  // Residuals of the sensor's rows of a block at its coefficients and theta.
  void predict(long g);
  // w_t of 10.3; `scale` divides chi^2.
  void reweigh(long g, double scale = 1.0) {
    for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
      Interval& v = interval(i);
      const double mean =
          v.spared > 0.0 ? mean_chi2(v) : 0.0;  // one weight for all that the interval stands for
      for (int r = 0; r < v.rows; ++r) {
        RawRow& row = v.row[static_cast<std::size_t>(r)];
        const double x = v.spared > 0.0 ? mean : chi2(row);
        row.weight = (constants::freedom + row.channels) / (constants::freedom + x / scale);
      }
    }
  }
  // chi^2 a sample of an interval whose rows stand for more.
  double mean_chi2(const Interval& v) const {
    double sum = 0.0, samples = 0.0;
    for (int c = 0; c < n_; ++c) sum += v.remainder[c] / (noise(c) * noise(c));
    for (int r = 0; r < v.rows; ++r) {
      sum += v.row[static_cast<std::size_t>(r)].size * chi2(v.row[static_cast<std::size_t>(r)]);
      samples += v.row[static_cast<std::size_t>(r)].size;
    }
    return sum / std::max(samples, 1.0);
  }
  double chi2(const RawRow& row) const {
    double sum = 0.0;
    for (int i = 0; i < n_; ++i) {
      const double z = row.residual[i] / noise(i);
      sum += z * z;
    }
    return sum;
  }

  // Coefficients of a block and the next from what a front knows of the first, and the block's motion, theta as it stands.
  void expect(const Front& f, long g, bool last);
  // Linearise a block as predicted and weighted and eliminate it; `last`: with all motion rows that remain. False where it
  // cannot be factored.
  bool eliminate(Front& f, long g, bool last);
  // theta's information with the first block that remains eliminated too; log |H|.
  double terminal(const Front& f, Eigen::MatrixXd& S, Eigen::VectorXd& eta);
  // The coefficients that belong to theta, of blocks [from, end()], after terminal() of the front at end().
  void back(long from);
  // Traces of (10.6) into the sums of blocks [from, end()), after terminal() likewise.
  void traces(long from);

  // The terms of (10.7) in the motion and the rows of a block, the sensor's as predicted.
  double objective(long g, Cursor& next, bool last) const;
  // The coefficients of an interval, knot by knot.
  Eigen::Matrix<double, kUnder, 1> coefficients(long i) const {
    const long g = i / kBlock;
    const int o = static_cast<int>(i % kBlock);
    PairVector xx;
    xx << block(g).x, block(g + 1).x;
    return xx.segment<kUnder>(kComponents * o);
  }
  double clock(std::size_t i) const { return theta[clock_[i]]; }
  Gram smoothness(int j) const { return spline_.gram(smoothness_order(about_.source, j)); }

  // B^(p) of uniform quintic splines of spacing h.
  struct UnitBasis {
    double h = 1.0;
    std::array<double, 6> scale{};
    UnitBasis() = default;
    explicit UnitBasis(double h_) : h(h_) {
      scale[0] = 1.0;
      for (std::size_t p = 1; p < 6; ++p) scale[p] = scale[p - 1] / h;
    }
    Basis at(double u, int p) const {
      if (p > kDegree5) return Basis::Zero();
      const auto i = static_cast<std::size_t>(p);
      const Gram& polynomial = SplineTable::get().derivative[i];
      Basis value = polynomial.col(kLocal - 1);
      for (int k = kLocal - 2; k >= 0; --k) value = value * u + polynomial.col(k);
      return value * scale[i];
    }
    Gram gram(int p) const {
      const auto i = static_cast<std::size_t>(p);
      return SplineTable::get().gram[i][i] * (scale[i] * scale[i] * h);
    }
  };
  const UnitBasis& basis() const { return spline_; }

 private:
  using Wrenches = Eigen::Matrix<double, 6, 12>;

  Statement rig_;
  RecordedLog about_;
  Layout layout_;
  int n_ = 6, nt_ = 0, nd_ = 0, nf_ = 7;
  int C_ = 0, b_ = 0, u_ = 0, body_ = 0, slope_ = -1, tilt_ = -1, gamma_ = -1;
  std::array<int, kMostStreams> clock_{}, bias_{};
  std::size_t streams_ = 0;
  bool gravity_ = false;
  std::vector<int> dense_;
  double origin_ = 0.0, h_ = 1.0;
  UnitBasis spline_;
  long first_ = 0, end_ = 0;  // blocks that stand
  std::vector<Interval> intervals_;
  std::vector<Block> blocks_;
  std::array<Ring<MotionRow>, kMostStreams> motion_;
  Nodes nodes_;
  std::vector<long> picked_;
  std::vector<double> spikes_, sorted_;

  // work space
  PairMatrix H_, pair_;
  Eigen::MatrixXd F_, Z_, Yf_, FX_, UX_, UT_;
  std::array<Eigen::MatrixXd, 2> BX_;
  std::array<Dense, kMostRows> X_;
  BlockMatrix Lf_, Linv_, next_, Gt_;
  Eigen::VectorXd yt_;
  // the model at theta, for a block
  Payload payload_;
  Vector3 root_ = Vector3::Zero();
  Eigen::Matrix<double, 3, 2> by_tilt_ = Eigen::Matrix<double, 3, 2>::Zero();
  Vector6 scale_ = Vector6::Ones();
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::ColMajor, kMostChannels, 6> gain_;

  void model() {
    payload_ = departed(about_.payload, theta.segment<kBodyParameters>(body_));
    scale_ = rig_.sign * rig_.range.cwiseInverse();
    root_ = gravity_ ? tilted(rig_.gravity, theta.segment<2>(tilt_), by_tilt_) : rig_.gravity;
    gain_.resize(n_, 6);
    for (int i = 0; i < n_; ++i) gain_.row(i) = theta.segment<6>(C_ + 6 * i).transpose();
  }

  // One motion row against the coefficients of its block: which interval of the block, its basis (10.4), its derivatives.
  struct Placed {
    int o = 0;
    Basis b, by_s, by_kappa;  // the last two: bases of the derivatives
    Vector6 residual;
  };
  bool placed(std::size_t i, const MotionRow& row, long g, bool last, const PairVector& xx,
              Placed& out) const {
    const double s = theta[clock_[i]], kappa = theta[clock_[i] + 1];
    const double x = (row.time + s - origin_) / h_;
    const auto at = static_cast<long>(std::floor(x + 1e-9));
    if (at >= kBlock * (g + 1) && !last) return false;
    out.o = static_cast<int>(std::clamp<long>(at - kBlock * g, 0, kBlock - 1));
    const double u = x - static_cast<double>(kBlock * g + out.o);
    const int p = about_.motion[i].derivative;
    const Basis b1 = spline_.at(u, p + 1), b2 = spline_.at(u, p + 2), b3 = spline_.at(u, p + 3);
    out.b = spline_.at(u, p) + (kappa - 0.5) * s * s * b2;
    out.by_s = b1 + (kappa - 0.5) * (2.0 * s * b2 + s * s * b3);
    out.by_kappa = s * s * b2;
    const Eigen::Map<const Gram> local(xx.data() + kComponents * out.o);  // a column a knot
    out.residual = row.value - local * out.b;
    if (bias_[i] >= 0) out.residual -= theta.segment<6>(bias_[i]);
    out.residual = out.residual.cwiseProduct(row.have);
    return true;
  }

  void jacobians(const RawRow& row, Wrenches& J, Dense& X) const;
  void add_motion(Front& f, long g, bool last, const PairVector& xx, SizeSums& sums);
  void add_smoothness(long g, const PairVector& xx, SizeSums& sums);
  void add_raw(Front& f, Interval& v, int o, SizeSums& sums);
  void add_raw_theta(Front& f, const Interval& v, int o, const Wrenches& mean,
                     const Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::ColMajor, 6, kMostChannels>& SV,
                     const Matrix6& Q);
};

// ------------------------------------------------------------------------------------------------ rows

template <typename Masked>
void Lag::take(long at, const Ring<RawSample>& samples, long from, long to, const Masked& masked) {
  Interval& v = interval(at);
  v.rows = 0;
  v.spared = 0.0;
  v.remainder.setZero();
  v.begin = origin_ + h_ * static_cast<double>(at);
  v.end = v.begin + h_;
  const auto finish = [&](RawRow& row) {
    const double u = (row.time - v.begin) / h_;
    row.b0 = spline_.at(u, 0);
    row.b1 = spline_.at(u, 1);
    row.masked = false;
    row.weight = 1.0;
    row.channels = static_cast<int>(row.have.sum());
    for (int c = 0; c < n_; ++c)
      if (row.have[c] == 0.0) row.value[c] = 0.0;
  };
  const auto whole = [&](const RawSample& s) {
    for (int c = 0; c < n_; ++c)
      if (!std::isfinite(s.value[static_cast<std::size_t>(c)])) return false;
    return true;
  };
  if (to - from <= kMostRows) {
    for (long k = from; k < to; ++k) {
      RawRow& row = v.row[static_cast<std::size_t>(v.rows++)];
      const RawSample& s = samples[k];
      row.time = s.time;
      row.size = 1.0;
      row.temperature = s.temperature;
      row.R = s.R;
      for (int c = 0; c < n_; ++c) {
        row.value[c] = s.value[static_cast<std::size_t>(c)];
        row.have[c] = std::isfinite(row.value[c]) ? 1.0 : 0.0;
      }
      finish(row);
    }
    return;
  }
  int count = 0;
  for (long k = from; k < to && count < nodes_.capacity(); ++k)
    if (whole(samples[k])) picked_[static_cast<std::size_t>(count++)] = k;
  if (count < kMostRows) return;
  std::array<std::array<double, kNodes>, kMostChannels> value{};
  for (int round = 0; round <= kMostRows; ++round) {
    nodes_.sample(count, [&](int k) { return samples[picked_[static_cast<std::size_t>(k)]].time - v.begin; });
    for (int c = 0; c < n_; ++c)
      v.remainder[c] = nodes_.project(
          count,
          [&](int k) {
            return samples[picked_[static_cast<std::size_t>(k)]].value[static_cast<std::size_t>(c)];
          },
          value[static_cast<std::size_t>(c)]);
    // a spike: what its own interval's polynomial does not take (METHOD 10.3)
    if (round == kMostRows || count <= kMostRows + 1) break;
    double expected = 0.0;
    for (int c = 0; c < n_; ++c) expected += v.remainder[c] / (noise(c) * noise(c));
    if (expected < 2.0 * n_ * (count - kNodes)) break;
    for (int k = 0; k < count; ++k) {
      double sum = 0.0;
      for (int c = 0; c < n_; ++c) {
        const auto cu = static_cast<std::size_t>(c);
        const double z =
            (samples[picked_[static_cast<std::size_t>(k)]].value[cu] - nodes_.back(k, value[cu])) / noise(c);
        sum += z * z;
      }
      spikes_[static_cast<std::size_t>(k)] = sorted_[static_cast<std::size_t>(k)] = sum;
    }
    std::nth_element(sorted_.begin(), sorted_.begin() + count / 2, sorted_.begin() + count);
    const double scale = std::max(
        1.0, sorted_[static_cast<std::size_t>(count / 2)] / n_);  // the noise may be more than stated
    const int worst =
        static_cast<int>(std::max_element(spikes_.begin(), spikes_.begin() + count) - spikes_.begin());
    if (spikes_[static_cast<std::size_t>(worst)] / scale <
        (constants::freedom + n_) / constants::mask_weight - constants::freedom)
      break;
    const double t = samples[picked_[static_cast<std::size_t>(worst)]].time;
    masked(t, t);
    for (int k = worst; k + 1 < count; ++k)
      picked_[static_cast<std::size_t>(k)] = picked_[static_cast<std::size_t>(k + 1)];
    --count;
  }
  v.rows = kNodes;
  v.spared = count - kNodes;
  int k = 0;
  for (int m = 0; m < kNodes; ++m) {
    const auto mu = static_cast<std::size_t>(m);
    RawRow& row = v.row[mu];
    row.time = v.begin + nodes_.time[mu];
    row.size = nodes_.weight[mu];
    while (k + 2 < count && samples[picked_[static_cast<std::size_t>(k + 1)]].time < row.time) ++k;
    const RawSample &before = samples[picked_[static_cast<std::size_t>(k)]],
                    &after = samples[picked_[static_cast<std::size_t>(k + 1)]];
    const double share = std::clamp((row.time - before.time) / (after.time - before.time), 0.0, 1.0);
    row.R = (1.0 - share) * before.R + share * after.R;
    row.temperature = before.temperature;
    row.have.setOnes();
    for (int c = 0; c < n_; ++c) row.value[c] = value[static_cast<std::size_t>(c)][mu];
    finish(row);
  }
}

inline void Lag::take(std::size_t stream, const Ring<MotionSample>& samples, long from, long to) {
  Ring<MotionRow>& out = motion_[stream];
  int count = 0;
  if (to - from > kMostRows)
    for (long k = from; k < to && count < nodes_.capacity(); ++k)
      if (samples[k].value.allFinite()) picked_[static_cast<std::size_t>(count++)] = k;
  if (to - from <= kMostRows || count <= kMostRows) {
    for (long k = from; k < std::min(to, from + kMostRows) && !out.full(); ++k) {
      MotionRow& row = out.push();
      row.time = samples[k].time;
      row.size = 1.0;
      row.spared = 0.0;
      row.remainder.setZero();
      row.have = samples[k].value.array().isFinite().cast<double>();
      row.value = samples[k].value.array().isFinite().select(samples[k].value, 0.0);
    }
    return;
  }
  const double begin = samples[from].time;
  nodes_.sample(count, [&](int k) { return samples[picked_[static_cast<std::size_t>(k)]].time - begin; });
  std::array<std::array<double, kNodes>, 6> value{};
  Vector6 remainder;
  for (int j = 0; j < 6; ++j)
    remainder[j] = nodes_.project(
        count, [&](int k) { return samples[picked_[static_cast<std::size_t>(k)]].value[j]; },
        value[static_cast<std::size_t>(j)]);
  for (int m = 0; m < kNodes && !out.full(); ++m) {
    const auto mu = static_cast<std::size_t>(m);
    MotionRow& row = out.push();
    row.time = begin + nodes_.time[mu];
    row.size = nodes_.weight[mu];
    row.have.setOnes();
    for (int j = 0; j < 6; ++j) row.value[j] = value[static_cast<std::size_t>(j)][mu];
    row.remainder = m == 0 ? remainder : Vector6::Zero();
    row.spared = m == 0 ? count - kNodes : 0.0;
  }
}

}  // namespace truewrench

#include "truewrench/estimation/lag_sweep.hpp"
