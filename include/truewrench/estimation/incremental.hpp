// The estimator as samples arrive (METHOD 10.6): the same model on a fixed lag of blocks, fixed memory, no allocation after
// construction, status codes in place of exceptions. For a control loop, without Python.
//
//   Incremental online(statement, about, {});            // about: a log without samples
//   online.push_motion(0, t, twist);                     // as they come, each stream with its own stamps
//   online.push_raw(t, raw, R_sensor_root);
//   if (online.ready()) use(online.gain(), online.covariance());
//   online.finish();
//
// The first lag is fitted like a record: h by (10.7), START, ROBUST (10.2, 10.3). From there a completed block of five knots is
// eliminated once as it comes, and once every lag all of the last two lags are linearised anew at theta as it stands: the older
// half, its mask set, leaves for good, the newer half stays with robust weights. What left is a Gaussian on (next block, theta),
// and running sums give sigma and q (10.6), (10.9), (10.10), and the parts of (10.11). No steps, no repair, no discrepancy in the
// fit. It decides forward only.
#pragma once

#include "truewrench/estimation/lag_start.hpp"
#include "truewrench/estimation/running.hpp"
#include "truewrench/estimation/score.hpp"

#include <cstdint>

namespace truewrench {

struct IncrementalSettings {
  double lag = 2.0;           // [s], and 20 knots at least: a coefficient forgets what is beyond to 1e-5
  double rate = 1000.0;       // [Hz] samples of one stream at most
  double spacing = 0.0;       // [s] h; 0: chosen on the first lag
  double finest = 0.0125;     // [s] smallest h that is tried: what memory is for
  double discrepancy = -1.0;  // stated: -1 auto, 0 none, else at least so much [fraction of range]
};

// A time that was left out: a sample (begin = end), or an interval of knots.
struct MaskedSpan {
  double begin = 0.0, end = 0.0;
};

class Incremental {
 public:
  Incremental(const Statement& rig, const RecordedLog& about, const IncrementalSettings& settings)
      : settings_(settings),
        most_blocks_(2 * lag_blocks(settings.finest) + 2),
        lag_(rig, about, most_blocks_, most_samples(settings)),
        start_(most_blocks_, lag_.channels()),
        moments_(lag_.channels()) {
    const int nt = lag_.parameters(), n = lag_.channels();
    const auto samples = static_cast<std::size_t>(settings.rate * (1.25 * settings.lag + 2.0)) + 64;
    raw_.reserve(samples);
    for (auto& m : motion_) m.reserve(samples);
    past_ = present_ = lag_.make_front();
    S_ = Sp_ = Sl_ = base_ = Eigen::MatrixXd::Zero(nt + 1, nt + 1);
    for (auto& p : parts_) p = S_;
    eta_ = solved_ = Eigen::VectorXd::Zero(nt);
    P_ = M_ = covariance_ = Eigen::MatrixXd::Zero(nt, nt);
    gain_covariance_ = added_ = Eigen::MatrixXd::Zero(6 * n, 6 * n);
    column_ = Eigen::VectorXd::Zero(nt);
    use_.reserve(static_cast<std::size_t>(nt));
    x0_ = x1_ = Eigen::MatrixXd::Zero(kWidth, most_blocks_ + 2);
    theta0_ = theta1_ = Eigen::VectorXd::Zero(nt);
    entries_.reserve(static_cast<std::size_t>(kMostRows * kBlock * (most_blocks_ + 1)));
    masked_.resize(samples);
    found_.resize(2);
    sum9_.assign(static_cast<std::size_t>(n),
                 {Eigen::Matrix<double, 7, 7>::Zero(), Eigen::Matrix<double, 7, 7>::Zero()});
    consistent_ = consistency(n);
    begin_log();
  }

  // ---------------------------------------------------------------- samples
  // Values that are NaN are missing; a row of nothing else is refused.
  Status push_motion(std::size_t stream, double time, const double* value) noexcept {
    if (stream >= lag_.streams()) return Status::wrong_size;
    const Eigen::Map<const Vector6> v(value);
    if (!std::isfinite(time) || v.array().isInf().any() || v.array().isNaN().all()) return Status::not_finite;
    Ring<MotionSample>& in = motion_[stream];
    if (in.end() > 0 && time <= motion_last_[stream]) return Status::not_increasing;
    Status status = Status::ok;
    // all motion, or the sensor, was silent for five periods and six knots: the stretch is over
    if (open() && (time - motion_last() > gap(motion_period()) || time - raw_last_ > gap(raw_period())))
      status = close();
    motion_last_[stream] = time;
    if (in.full() && !standing_ && (raw_.empty() || in[in.begin()].time < raw_[raw_.begin()].time))
      in.drop_before(in.begin() + 1);
    if (in.full()) return Status::wrong_size;
    MotionSample& s = in.push();
    s.time = time;
    s.value = v;
    return worse(status, advance());
  }

  // raw (n): fractions of range. R_sensor_root: row by row, where gravity acts.
  Status push_raw(double time, const double* raw, const double* R_sensor_root = nullptr,
                  double temperature = 0.0) noexcept {
    bool any = false;
    for (int i = 0; i < lag_.channels(); ++i) {
      if (std::isinf(raw[i])) return Status::not_finite;
      any = any || std::isfinite(raw[i]);
    }
    if (!std::isfinite(time) || !any) return Status::not_finite;
    if (raw_.end() > 0 && time <= raw_last_) return Status::not_increasing;
    Status status = Status::ok;
    if (open() && (time - raw_last_ > gap(raw_period()) || time - motion_last() > gap(motion_period())))
      status = close();
    raw_last_ = time;
    if (raw_.full() && !standing_ && !open()) raw_.drop_before(raw_.begin() + 1);
    if (raw_.full()) return Status::wrong_size;
    RawSample& s = raw_.push();
    s.time = time;
    s.temperature = std::isfinite(temperature) ? temperature : 0.0;
    std::copy(raw, raw + lag_.channels(), s.value.begin());
    if (R_sensor_root != nullptr)
      s.R = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R_sensor_root);
    return worse(status, advance());
  }

  // The record ends here.
  Status finish() noexcept { return close(); }

  // Another log of the same sensor: theta's shared part goes on, with the information on it; what is the log's own starts anew.
  // The one call that allocates.
  Status next_log(const RecordedLog& about);

  // ---------------------------------------------------------------- results, after every completed block
  bool ready() const { return ready_; }
  std::int64_t blocks() const { return blocks_; }    // completed
  std::int64_t samples() const { return samples_; }  // that left the lag
  std::int64_t masked_samples() const { return masked_samples_; }
  int dropped() const { return dropped_; }  // stretches too short
  bool unresolved() const { return unresolved_; }
  Status status() const { return status_; }
  double spacing() const { return lag_.h(); }
  const Eigen::VectorXd& theta() const { return lag_.theta; }
  Eigen::Map<const RowMatrix> gain() const {
    return {lag_.theta.data() + lag_.gain_at(), lag_.channels(), 6};
  }
  Eigen::Map<const Eigen::VectorXd> offset() const {
    return {lag_.theta.data() + lag_.offset_at(), lag_.channels()};
  }
  const Eigen::VectorXd& prior() const { return prior_; }
  const std::vector<char>& active() const { return active_; }
  const Lag& lag() const { return lag_; }
  const Sizes& sizes() const { return lag_.sizes; }

  // Of theta, held parameters with their prior's width.
  const Eigen::MatrixXd& theta_covariance() noexcept;
  // Of C (6n, 6n), with (10.9) and (10.10).
  const Eigen::MatrixXd& covariance() noexcept;
  const Eigen::MatrixXd& added() const { return added_; }                // (10.9), of the last covariance()
  const std::vector<Moment>& moments() const { return found_; }          // likewise
  const Eigen::VectorXd& discrepancy2() const { return discrepancy2_; }  // delta_i^2 for (10.10), likewise
  PoseShare pose() const { return pose_.share(); }
  // (10.11): lags in turn, each with what it adds to what was known before it. Allocates.
  Agreement agreement() const;

  // What was masked since the last call of clear_masked().
  std::size_t masked_spans() const { return masked_count_; }
  const MaskedSpan& masked_span(std::size_t i) const { return masked_[i]; }
  void clear_masked() { masked_count_ = 0; }

 private:
  // One row, or one interval, of the lag for the mask.
  struct Entry {
    double begin = 0.0, end = 0.0;
    bool low = false, masked = false, leaves = false;
    RawRow* row = nullptr;
    Lag::Interval* interval = nullptr;  // all rows of it
  };

  IncrementalSettings settings_;
  int most_blocks_;
  Lag lag_;
  LagStart start_;
  MomentSums moments_;
  PoseSums pose_;
  Ring<RawSample> raw_;
  std::array<Ring<MotionSample>, kMostStreams> motion_;
  std::array<double, kMostStreams> motion_last_{};
  double raw_last_ = 0.0;
  long raw_at_ = 0;  // first sample that is not in the lag
  std::array<long, kMostStreams> motion_at_{};
  double period_ = 0.0, motion_period_ = 0.0;  // [s] as the stretch began with
  bool standing_ = false, ready_ = false, unresolved_ = false, first_stretch_ = true, first_log_ = true,
       chosen_ = false;
  double h_ = 0.0, coarsest_ = constants::knot_spacing;
  std::int64_t blocks_ = 0, samples_ = 0, masked_samples_ = 0;
  int dropped_ = 0, hops_ = 0, part_ = 0;
  Status status_ = Status::ok;
  double arrival_ = 0.0, consistent_ = 1.0, limit_ = 0.0, logdet_x_ = 0.0, logdet_s_ = 0.0;
  Sizes kept_;

  Front past_, present_;
  Eigen::MatrixXd S_, Sp_, Sl_, base_, P_, M_, covariance_, gain_covariance_, added_, x0_, x1_;
  std::array<Eigen::MatrixXd, 2> parts_;
  Eigen::VectorXd eta_, solved_, column_, theta0_, theta1_, stated_, prior_, discrepancy2_;
  std::vector<char> active_;
  std::vector<int> use_;
  SizeSums left_;  // of what left the lag, this log
  std::vector<Entry> entries_;
  std::vector<MaskedSpan> masked_;
  std::size_t masked_count_ = 0;
  std::array<double, 2> run_{-1e300, -1e300};  // begin and end of the last low run that left
  std::vector<Moment> found_;
  std::vector<std::array<Eigen::Matrix<double, 7, 7>, 2>>
      sum9_;                // (10.9) of the logs before: A and B by channel
  Eigen::VectorXd size10_;  // delta^2 of the logs before, times their samples
  double size10_samples_ = 0.0, log_samples_ = 0.0;

  int lag_blocks(double h) const {
    return static_cast<int>(std::ceil(std::max(settings_.lag, 20.0 * h) / (kBlock * h) - 1e-9));
  }
  static int most_samples(const IncrementalSettings& s) {
    return std::max(64, static_cast<int>(s.rate * 2.0 * constants::knot_spacing) + 16);
  }
  static Status worse(Status a, Status b) { return a != Status::ok ? a : b; }
  double gap(double period) const { return std::max(5.0 * period, 6.0 * coarsest_); }
  bool open() const {
    if (standing_) return true;
    if (raw_.empty()) return false;
    for (std::size_t i = 0; i < lag_.streams(); ++i)
      if (!motion_[i].empty()) return true;
    return false;
  }
  double motion_last() const {
    double out = -1e300;
    for (std::size_t i = 0; i < lag_.streams(); ++i)
      if (motion_[i].end() > 0) out = std::max(out, motion_last_[i]);
    return out;
  }
  template <typename Samples>
  static double period_of(const Samples& s) {
    return s.end() - s.begin() < 2
               ? 0.0
               : (s[s.end() - 1].time - s[s.begin()].time) / static_cast<double>(s.end() - s.begin() - 1);
  }
  double raw_period() const { return standing_ ? period_ : period_of(raw_); }
  double motion_period() const {
    if (standing_) return motion_period_;
    double out = 0.0;
    for (std::size_t i = 0; i < lag_.streams(); ++i) {
      const double p = period_of(motion_[i]);
      if (p > 0.0 && (out == 0.0 || p < out)) out = p;
    }
    return out;
  }

  // Share of E w chi^2 that Student-t weights leave of n Gaussian channels, so that sigma in the lag is that of FIT.
  static double consistency(int n) {
    double sum = 0.0, all = 0.0;
    for (double x = 0.01; x < 40.0 + 4.0 * n; x += 0.02) {
      const double p = std::exp((0.5 * n - 1.0) * std::log(x) - 0.5 * x);
      sum += p * x * (constants::freedom + n) / (constants::freedom + x);
      all += p * x;
    }
    return sum / all;
  }

  void begin_log();
  Status advance() noexcept;
  double covered() const;  // [s] to where all streams have come
  Status start(bool partial) noexcept;
  void lay(double origin, double h, long blocks, bool partial);
  double fit_first(double origin, double h, long blocks, bool partial);
  void take_block(long g, bool all);
  Status arrive(bool last) noexcept;
  bool sweep(long leaving, bool last);
  bool run(int most, bool last);
  Status hop() noexcept;
  Status close() noexcept;
  void set_mask(long leaving);
  void depart(long leaving);
  double resize(const SizeSums& sums, const Eigen::MatrixXd& S);
  SizeSums window_sums() const;
  bool solve(const Eigen::MatrixXd& S, bool judge);
  bool invert(const Eigen::MatrixXd& S, bool all);
  void settle(const Eigen::MatrixXd& S);
  double objective(bool last);
  double likelihood(bool last);
  void part(const Eigen::MatrixXd& S);
  Eigen::MatrixXd without_own(const Eigen::MatrixXd& S) const;
};

}  // namespace truewrench

#include "truewrench/estimation/incremental_blocks.hpp"
#include "truewrench/estimation/incremental_theta.hpp"
