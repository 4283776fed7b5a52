// The estimator as samples arrive (METHOD 10.6): the same model on a fixed lag of blocks, fixed memory, no allocation after
// construction, status codes in place of exceptions. For a control loop, without Python (examples/control_loop.cpp):
//
//     Incremental online(statement, about, {});   // about: a log without samples
//     online.push_motion(0, t, twist);            // as they come, each stream with its own stamps
//     online.push_raw(t, raw, R_sensor_root);
//     if (online.ready()) show(online.gain(), online.covariance());
//     if (online.finish() == Status::ok && online.sound()) use(online.gain(), online.covariance());
//
// The first lag is fitted like a record: h by (10.7), START, ROBUST (10.2, 10.3). From there a completed block of five knots is
// eliminated as it comes, theta known. When two lags are full they are linearised anew: what has 20 knots after it, its mask set,
// leaves for good, and theta follows what left. That is a Gaussian on (next block, theta), and running sums give sigma and q (10.6),
// (10.9), (10.10), and the parts of (10.11). No steps, no repair, no discrepancy in the fit. It decides forward only.
//
// Built with -O3 -march=native a push takes microseconds, one that completes a block some tens, once in two lags two
// milliseconds, the first two times up to five; the push that completes the first lag fits it in ten to twenty, so that a hard loop
// hands its samples to another thread. With -O2 all take six to ten times as long.
#pragma once

#include "truewrench/estimation/agreement.hpp"
#include "truewrench/estimation/delay.hpp"
#include "truewrench/estimation/incremental_settings.hpp"
#include "truewrench/estimation/lag_start.hpp"
#include "truewrench/estimation/moments.hpp"
#include "truewrench/estimation/pose.hpp"

#include <cstdint>
#include <limits>
#include <span>

namespace truewrench {

// A time that was left out: a sample (begin = end), or an interval of knots.
struct MaskedSpan {
  double begin = 0.0, end = 0.0;
};

class Incremental {
 public:
  // What check() refuses is not taken: every push then answers so, and status().
  Incremental(const Statement& rig, const RecordedLog& about, const IncrementalSettings& settings)
      : Incremental(Accepted::of(rig, about, settings)) {}

  // ---------------------------------------------------------------- samples
  // Values that are NaN are missing; a row of nothing else is refused.
  // not_increasing and not_finite: the sample was not taken; wrong_size: nor was it, there is no room, as
  // the other streams have not come along, or all come faster than settings.rate; not_factorizable: the lag
  // was lost.
  Status push_motion(std::size_t stream, double time, const double* value) noexcept {
    if (refused_ != Status::ok) return refused_;
    if (stream >= lag_.streams()) return Status::wrong_size;
    if (!readable(time, value, kComponents)) return Status::not_finite;
    Ring<MotionSample>& in = motion_[stream];
    if (time <= motion_last_[stream]) return Status::not_increasing;
    const Status status = silence(time);
    if (in.full() && !standing_ && (raw_.empty() || in[in.begin()].time < raw_[raw_.begin()].time))
      in.drop_before(in.begin() + 1);
    if (in.full()) return Status::wrong_size;
    motion_last_[stream] = time;
    MotionSample& s = in.push();
    s.time = time;
    std::copy_n(value, kComponents, s.value.begin());
    return worse(status, advance());
  }

  // raw (n): fractions of range. R_sensor_root: row by row, where gravity acts
  // on what moves (no IMU): wrong_size without. temperature [K] above the reference; NaN: as last told. Where it has a slope,
  // `about` says that there is a thermometer, by one temperature: wrong_size without.
  Status push_raw(double time, const double* raw, const double* R_sensor_root = nullptr,
                  double temperature = std::numeric_limits<double>::quiet_NaN()) noexcept {
    if (refused_ != Status::ok) return refused_;
    if (!readable(time, raw, lag_.channels())) return Status::not_finite;
    if (lag_.felt() && R_sensor_root == nullptr) return Status::wrong_size;
    for (int k = 0; lag_.felt() && k < 9; ++k)
      if (!std::isfinite(R_sensor_root[k])) return Status::not_finite;
    const bool told = std::isfinite(temperature);
    if (told && lag_.rig().slope_prior > 0.0 && lag_.columns().slope < 0) return Status::wrong_size;
    if (time <= raw_last_) return Status::not_increasing;
    const Status status = silence(time);
    // older than a motion that has begun since, or without one
    if (raw_.full() && !standing_ && !(raw_[raw_.begin()].time >= motion_begin()))
      raw_.drop_before(raw_.begin() + 1);
    if (raw_.full()) return Status::wrong_size;
    raw_last_ = time;
    RawSample& s = raw_.push();
    s.time = time;
    if (told) warmth_ = temperature;
    s.temperature = warmth_;
    std::copy_n(raw, lag_.channels(), s.value.begin());
    for (std::size_t i = 0; i < static_cast<std::size_t>(lag_.channels()); ++i) {
      if (std::isnan(first_raw_[i])) first_raw_[i] = raw[i];
      reads_[i] = reads_[i] || (std::isfinite(raw[i]) && raw[i] != first_raw_[i]);
    }
    for (int k = 0; R_sensor_root != nullptr && k < 9; ++k) s.R(k / 3, k % 3) = R_sensor_root[k];
    return worse(status, advance());
  }

  // The record ends here; stamps may begin again, as after one from an absurd future.
  Status finish() noexcept {
    if (refused_ != Status::ok) return refused_;
    const Status status = close();
    raw_last_ = kNever;
    motion_last_.fill(kNever);
    return status;
  }

  // The attitude of the samples from here on has another heading than before, of a log whose root frame is its own: the stretch
  // ends, and how gravity is tilted is not known.
  Status next_root() noexcept;

  // Another log of the same sensor: theta's shared part goes on, with the information on it; what is the
  // log's own starts anew. Allocates. What check() refuses changes nothing.
  Status next_log(const RecordedLog& about);

  // ---------------------------------------------------------------- results,
  // of the first lag, and whenever blocks left since
  bool ready() const { return ready_; }
  std::int64_t blocks() const { return blocks_; }    // completed
  std::int64_t samples() const { return samples_; }  // that left the lag
  std::int64_t masked_samples() const { return masked_samples_; }
  int dropped() const { return dropped_; }  // stretches too short
  // (10.7) still falls at one knot a sample; or at the finest h that memory is for, beside more noise than stated: what these
  // knots do not follow is in it
  bool unresolved() const {
    return at_finest_ && !lag_.about().resolved &&
           (h_ <= 1.01 * motion_period_ || lag_.sizes.raw_factor.maxCoeff() > constants::noise_told);
  }
  Status status() const { return status_; }
  double spacing() const { return h_; }
  const Eigen::VectorXd& theta() const { return lag_.theta; }
  Eigen::Map<const RowMatrix> gain() const {
    return {lag_.theta.data() + lag_.columns().C, lag_.channels(), 6};
  }
  Eigen::Map<const Eigen::VectorXd> offset() const {
    return {lag_.theta.data() + lag_.columns().b, lag_.channels()};
  }
  const Eigen::VectorXd& prior() const { return prior_; }
  const std::vector<char>& active() const { return active_; }
  const Lag& lag() const { return lag_; }
  const Sizes& sizes() const { return lag_.sizes; }

  // Of theta, held parameters with their prior's width.
  const Eigen::MatrixXd& theta_covariance() noexcept;
  // Of C (6n, 6n), with (10.9) and (10.10); to first order in the payload: a centre of mass that is uncertain adds more, which
  // `configure` of corrector_of.hpp has.
  const Eigen::MatrixXd& covariance() noexcept;
  const Eigen::MatrixXd& added() const { return added_; }                // (10.9), of the last covariance()
  const std::vector<Moment>& moments() const { return found_; }          // likewise
  const Eigen::VectorXd& discrepancy2() const { return discrepancy2_; }  // delta_i^2 for (10.10), likewise
  PoseShare pose() const { return pose_.share(lag_.about().arm); }
  // (10.11): lags in turn, each with what it adds to what was known before it. Allocates.
  Agreement agreement();
  // Of this log and all before it; asked once it is over and covariance() was. Allocates.
  Agreement agreement_with_logs_before();
  // Whether nothing that it can tell speaks against the result, once the record is over: no lag was lost, it is resolved, no more
  // is left out than a verdict allows, its parts and logs agree, no channel is noisier than would be told and none always reads the
  // same, velocities are not wild, and some gain was told. Of 288 records with a payload that slips, stuck channels and velocities, or
  // clipped channels 113 ended with a wrong gain, 85 of them resolved: of these all but the 12 whose channel hung from first to last
  // were not sound before that was asked, too. Allocates.
  bool sound();

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
    Lag::Interval* interval = nullptr;  // all gathered rows of it
  };
  struct Spread {
    double A[7][7] = {}, B[7][7] = {};
  };

  explicit Incremental(const Accepted& of)
      : settings_(of.settings),
        refused_(of.status),
        most_blocks_(2 * lag_blocks(of.settings.smallest()) + 2),
        lag_(of.rig, of.about, most_blocks_, static_cast<int>(of.settings.samples_of_interval())),
        start_(most_blocks_, lag_.channels()),
        moments_(lag_.channels()),
        status_(of.status) {
    const int n = lag_.channels();
    const auto samples = static_cast<std::size_t>(of.settings.samples());
    motion_last_.fill(kNever);
    first_raw_.fill(std::nan(""));
    raw_.reserve(samples);
    for (auto& m : motion_) m.reserve(samples);
    entries_.reserve(static_cast<std::size_t>(kMostRows * kBlock * (most_blocks_ + 1)));
    masked_.resize(samples);
    found_.resize(2);
    x0_.resize(static_cast<std::size_t>(kWidth * (most_blocks_ + 2)));
    x1_ = x0_;
    gain_covariance_ = added_ = Eigen::MatrixXd::Zero(6 * n, 6 * n);
    discrepancy2_ = Eigen::VectorXd::Zero(n);
    consistent_ = consistency(n);
    resize_theta();
    Zl_ = S_;
    parts_ = {S_, S_};
    others_ = {S_, S_, S_};
    begin_log();
    keep();  // in place from now on
  }

  IncrementalSettings settings_;
  Status refused_;  // of what does not make sense
  int most_blocks_;
  Lag lag_;
  LagStart start_;
  MomentSums moments_;
  DelaySums past_delays_, delays_;  // of the log that runs: what left the lag, and with what is in it
  PoseSums pose_;
  Ring<RawSample> raw_;
  std::array<Ring<MotionSample>, kMostStreams> motion_;
  static constexpr double kNever = -std::numeric_limits<double>::infinity();
  std::array<double, kMostStreams> motion_last_;  // [s] of the newest samples
  double raw_last_ = kNever, warmth_ = 0.0;
  Channels first_raw_{};
  std::array<bool, kMostChannels> reads_{};  // something else than at first
  long raw_at_ = 0;                          // first sample that is not in the lag
  std::array<long, kMostStreams> motion_at_{};
  double period_ = 0.0, motion_period_ = 0.0;  // [s] as the stretch began with
  double limit_ = 0.0;                         // [s] end of a stretch that is over
  bool imitated_ = false, told_ = false;       // this log, an earlier one: see DelaySums
  bool standing_ = false, ready_ = false, at_finest_ = false, first_stretch_ = true, first_log_ = true,
       chosen_ = false;
  double h_ = 0.0, coarsest_ = constants::knot_spacing;
  std::int64_t blocks_ = 0, samples_ = 0, masked_samples_ = 0;
  int dropped_ = 0, hops_ = 0, part_ = 0;
  Status status_ = Status::ok;
  double arrival_ = 0.0;     // usual chi^2 of a channel as a block comes
  double consistent_ = 1.0;  // of sigma under robust weights
  double logdet_x_ = 0.0, logdet_s_ = 0.0;

  Front past_, present_, moving_;  // what left the lag; with what is in it; that, theta known
  // information (nt + 1, nt + 1), lower triangle, the information vector in the last row. Of the coordinates:
  // what theta is by, of what left, at the last part, at the beginning of the log, since then; of theta: the first, and the last
  Eigen::MatrixXd Z_, Zp_, Zl_, Zb_, Zo_, S_, own_;
  std::array<Eigen::MatrixXd, 2> parts_;  // (10.11)
  // of theta: all, and the parts, of logs with another body
  std::array<Eigen::MatrixXd, 3> others_;
  Eigen::MatrixXd P_, covariance_, gain_covariance_, added_;
  Eigen::VectorXd column_, theta0_, theta1_, stated_, prior_, discrepancy2_;
  std::vector<double> work_, x0_, x1_;
  std::vector<char> active_;
  std::vector<int> use_;
  // Before a lag is fitted.
  struct Known {
    Sizes sizes;
    Eigen::VectorXd theta, prior;
    RowMatrix lagged;
    std::array<Eigen::MatrixXd, 2> parts;
    Eigen::MatrixXd last;
    int part = 0;
    std::vector<char> active;
    std::size_t masked_spans = 0;
    std::int64_t masked_samples = 0;
  };
  Known kept_;
  SizeSums left_;  // of what left the lag, this log
  std::vector<Entry> entries_;
  std::vector<MaskedSpan> masked_;
  std::size_t masked_count_ = 0;
  std::array<double, 2> run_{-1e300, -1e300};  // begin and end of the last low run that left
  std::vector<Moment> found_;
  std::array<Spread, kMostChannels> sum9_;  // (10.9) of the logs before
  Channels size10_{};                       // delta^2 of the logs before, times their samples
  double size10_samples_ = 0.0, log_samples_ = 0.0;

  // [s] of what leaves, that the mask looks beyond
  static constexpr double kAhead = 2.0 * constants::mask_shortest + constants::gather_window;
  // Blocks that stay when the others leave: 20 knots, beyond which nothing moves a coefficient by 1e-5.
  long staying() const {
    return std::min<long>(lag_blocks(h_), std::max(4L, std::lround(std::ceil(kAhead / (kBlock * h_)))));
  }
  int lag_blocks(double h) const { return static_cast<int>(settings_.blocks_of_lag(h)); }
  static Status worse(Status a, Status b) { return a != Status::ok ? a : b; }
  static bool readable(double time, const double* value, int count) {
    bool any = false;
    for (int i = 0; i < count; ++i) {
      if (std::isinf(value[i])) return false;
      any = any || std::isfinite(value[i]);
    }
    return any && std::isfinite(time);
  }
  // Before two samples tell the period it is the longest for which the lag is long enough.
  double gap(double period) const {
    return std::max(5.0 * (period > 0.0 ? period : settings_.longest_period()), 6.0 * coarsest_);
  }
  // All motion, or the sensor, was silent for five periods and six knots: the stretch is over.
  Status silence(double time) noexcept {
    const bool over =
        open() && (time - motion_last() > gap(motion_period()) || time - raw_last_ > gap(raw_period()));
    return over ? close() : Status::ok;
  }
  bool open() const {
    if (standing_) return true;
    bool any = false;
    for (std::size_t i = 0; i < lag_.streams(); ++i) any = any || !motion_[i].empty();
    return any && !raw_.empty();
  }
  double motion_last() const { return *std::max_element(motion_last_.begin(), motion_last_.end()); }
  // To which all streams have samples, of a stretch that has not begun; NaN where one has none.
  double common_begin() const { return std::max(motion_begin(), raw_[raw_.begin()].time); }
  double motion_begin() const {
    double out = kNever;
    for (std::size_t i = 0; i < lag_.streams(); ++i) {
      if (motion_[i].empty()) return std::nan("");
      out = std::max(out, motion_[i][motion_[i].begin()].time);
    }
    return out;
  }
  template <typename Samples>
  static double period_of(const Samples& s) {
    const long count = s.end() - s.begin();
    return count < 2 ? 0.0 : (s[s.end() - 1].time - s[s.begin()].time) / static_cast<double>(count - 1);
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
  void note_masked(double begin, double end) {
    if (masked_count_ < masked_.size()) masked_[masked_count_++] = {begin, end};
  }

  // Share of E w chi^2 that Student-t weights leave of n Gaussian channels, so
  // that sigma in the lag is that of FIT.
  static double consistency(int n) {
    double sum = 0.0, all = 0.0;
    for (double x = 0.01; x < 40.0 + 4.0 * n; x += 0.02) {
      const double p = std::exp((0.5 * n - 1.0) * std::log(x) - 0.5 * x);
      sum += p * x * (constants::freedom + n) / (constants::freedom + x);
      all += p * x;
    }
    return sum / all;
  }

  // blocks: incremental_blocks.hpp
  Status advance() noexcept;
  double covered() const;  // [s] to where all streams have come
  void keep() noexcept;
  void restore() noexcept;
  Status start(bool partial) noexcept;
  bool resting(double until) noexcept;
  void forget_until(double time) noexcept;
  bool choose_spacing(double origin, bool partial);
  long blocks_of(double origin, double h, bool partial) const;
  void lay(double origin, double h, bool partial);
  double fit_first(double origin, double h, bool partial);
  void take_block(long g, bool all);
  Status arrive(bool last) noexcept;
  bool leave(long leaving, bool last);
  bool sweep(long leaving, bool last);
  bool run(int least, int most, double tolerance, bool last);
  void predict() {
    for (long g = lag_.first(); g < lag_.end(); ++g) lag_.predict(g);
  }
  void weigh() {
    for (long g = lag_.first(); g < lag_.end(); ++g) lag_.reweigh(g);
  }
  bool surprised();
  Status hop(bool last) noexcept;
  bool linearise(bool last);
  void abandon(Status status) noexcept;
  void drop_samples() noexcept {  // that wait
    raw_.clear();
    for (auto& m : motion_) m.clear();
  }
  Status close() noexcept;
  void set_mask(long leaving);
  void depart(long leaving, bool traced);
  void count(long from, long to);
  SizeSums window_sums(long from) const;
  double objective(bool last) const;
  double likelihood(bool last) const;

  // theta: incremental_solve.hpp, incremental_theta.hpp
  void resize_theta();
  void begin_log();
  // Whether a place of theta is of the root frame that the log has alone; whether it is the log's own.
  bool in_root(int i) const {
    const int tilt = lag_.columns().tilt;
    return tilt >= 0 && tilt != lag_.layout().tilt && (i == tilt || i == tilt + 1);
  }
  bool own(int i) const {
    return i >= lag_.columns().b + (lag_.rig().pool_offsets ? lag_.channels() : 0) || in_root(i);
  }
  static constexpr int kMostLoose = 2 * kMostStreams + 1;
  struct Loose {
    double variance, departure;
  };
  int lay_out(bool all, int columns);
  bool invert();
  const Eigen::MatrixXd& of_log();
  bool look(std::span<const int> places, std::array<Loose, kMostLoose>& out);
  bool hold_rules();
  void gather(const Eigen::MatrixXd& Z, std::size_t of, Eigen::MatrixXd& S);
  bool solve();
  void add_delays(DelaySums& sums, long block) const noexcept;
  void imitate(int order) noexcept;
  double resize(const SizeSums& sums);
  void part(const Eigen::MatrixXd& S);
  template <typename Chosen>
  void forget(Eigen::MatrixXd& S, const Chosen& chosen) const;
  Agreement compare_parts(const std::array<Eigen::MatrixXd, 2>& parts, const Eigen::MatrixXd& apart) const;
};

}  // namespace truewrench

#include "truewrench/estimation/incremental_blocks.hpp"
#include "truewrench/estimation/incremental_solve.hpp"
#include "truewrench/estimation/incremental_start.hpp"
#include "truewrench/estimation/incremental_theta.hpp"
