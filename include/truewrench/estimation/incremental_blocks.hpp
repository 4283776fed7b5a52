// The life of a block: samples to rows, its arrival, the re-linearisation of
// two lags, its mask, its departure. Included by incremental.hpp.
#pragma once

#include "truewrench/estimation/incremental.hpp"

namespace truewrench {

// [s] to where the sensor and every motion stream that is not silent have come.
inline double Incremental::covered() const {
  double out = raw_last_;
  const double newest = motion_last(), silent = gap(motion_period());
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    if (motion_last_[i] == kNever) return kNever;
    if (newest - motion_last_[i] > silent) continue;
    out = std::min(out, motion_last_[i] + std::min(0.0, lag_.clock(i)));
  }
  return out;
}

inline Status Incremental::advance() noexcept {
  if (!open()) return Status::ok;
  if (standing_) {
    Status out = Status::ok;
    while (standing_ && covered() >= lag_.start_of(lag_.end() + 1)) out = worse(out, arrive(false));
    return out;
  }
  coarsest_ = settings_.spacing > 0.0 ? settings_.spacing : coarsest_spacing(motion_period());
  const double length = lag_blocks(coarsest_) * kBlock * coarsest_;
  return covered() - common_begin() + 0.5 * raw_period() >= length ? start(false) : Status::ok;
}

// Rows of block g from the samples that wait; `all`: up to limit_.
inline void Incremental::take_block(long g, bool all) {
  for (int o = 0; o < kBlock; ++o) {
    const long at = kBlock * g + o;
    const double end = lag_.origin() + lag_.h() * (static_cast<double>(at + 1) - 1e-9);
    const double stop = all ? std::min(end, limit_) : end;
    long to = raw_at_;
    while (to < raw_.end() && raw_[to].time < stop) ++to;
    lag_.take(at, raw_, raw_at_, to, [this](double from, double until) {
      note_masked(from, until);
      ++masked_samples_;
    });
    raw_at_ = to;
    for (std::size_t i = 0; i < lag_.streams(); ++i) {
      long last = motion_at_[i];
      while (last < motion_[i].end() && motion_[i][last].time < stop) ++last;
      lag_.take(i, motion_[i], motion_at_[i], last);
      motion_at_[i] = last;
    }
  }
}

// The stretch ends; what is known of theta goes on, and where the lag is lost, what left it before.
inline void Incremental::abandon(Status status) noexcept {
  if (status != Status::ok) Z_ = Zl_;
  gather(Z_, 0, S_);
  lag_.set_front(past_, Z_);
  pose_.end_stretch(lag_.about().arm);
  run_ = {-1e300, -1e300};
  standing_ = false;
  drop_samples();
}

// A block has come: its motion as expected, weights against its own scale,
// eliminated behind the others, theta as it stands.
inline Status Incremental::arrive(bool last) noexcept {
  Status status = Status::ok;
  if (lag_.end() - lag_.first() >= 2 * lag_blocks(h_)) status = hop(false);
  if (status != Status::ok) {
    abandon(status);  // a lag that cannot leave must not grow: its memory is fixed
    return status_ = status;
  }
  const long g = lag_.end();
  take_block(g, last);
  raw_.drop_before(raw_at_);
  for (std::size_t i = 0; i < lag_.streams(); ++i) motion_[i].drop_before(motion_at_[i]);
  lag_.expect(moving_, g, last);
  lag_.predict(g);
  // before its motion is known, chi^2 is that of the expectation: the weights
  // compare the samples of the block with each other
  entries_.clear();
  for (long i = kBlock * g; i < kBlock * (g + 1); ++i)
    for (int r = 0; r < lag_.interval(i).rows; ++r) {
      const Lag::Interval& v = lag_.interval(i);
      Entry e;
      const RawRow& row = v.row[static_cast<std::size_t>(r)];
      e.begin = lag_.chi2(v, row) / row.channels;
      entries_.push_back(e);
    }
  double scale = 1.0;
  if (!entries_.empty()) {
    const auto middle = entries_.begin() + static_cast<std::ptrdiff_t>(entries_.size() / 2);
    std::nth_element(entries_.begin(), middle, entries_.end(),
                     [](const Entry& a, const Entry& b) { return a.begin < b.begin; });
    const double level = middle->begin;
    if (arrival_ == 0.0) arrival_ = level;
    scale = std::max(
        1.0, level > 4.0 * arrival_ ? arrival_ : level);  // a contact over half of the block is no scale
    arrival_ += 0.1 * (std::min(level, 4.0 * arrival_) - arrival_);
  }
  lag_.reweigh(g, scale);
  const bool ok = lag_.join(moving_, g);
  lag_.grow();
  ++blocks_;
  return ok ? status : status_ = Status::not_factorizable;
}

// Eliminate the first blocks of the lag for good, as predicted and weighted.
inline bool Incremental::leave(long leaving, bool last) {
  const long stay = lag_.first() + leaving;
  for (long from = lag_.first(); from < stay;) {
    const long to = std::min<long>(from + lag_blocks(h_), stay);
    if (!lag_.eliminate(past_, from, to, last && to == lag_.end())) return false;
    if (!std::isfinite(lag_.terminal(past_, Zp_))) return false;
    part(Zp_);
    from = to;
  }
  return true;
}

// The same, and the others behind them.
inline bool Incremental::sweep(long leaving, bool last) {
  if (!leave(leaving, last)) return false;
  present_ = past_;
  return lag_.eliminate(present_, lag_.first() + leaving, lag_.end(), last) &&
         std::isfinite(logdet_x_ = lag_.terminal(present_, Z_));
}

// Gauss-Newton and (10.6) on all blocks of the lag, robust weights, as Fit::run() does: at least so many steps and at most, or until
// theta moves by less than `tolerance` of its sigma.
inline bool Incremental::run(int least, int most, double tolerance, bool last) {
  const int nt = lag_.parameters();
  if (first_log_ && left_.knots == 0.0)
    std::copy_n(lag_.theta.data() + lag_.columns().C, 6 * lag_.channels(), lag_.lagged.data());
  const long first = lag_.first(), end = lag_.end();
  const auto coefficients = [&](std::vector<double>& to) {
    for (long g = first; g <= end; ++g)
      std::copy_n(lag_.block(g).x.data(), kWidth, to.data() + kWidth * (g - first));
  };
  predict();
  weigh();
  for (int iteration = 1; iteration <= most; ++iteration) {
    if (!sweep(0, last)) return false;
    const double before = objective(last);
    theta0_ = lag_.theta;
    coefficients(x0_);
    if (!solve()) return false;
    lag_.back(first);
    theta1_ = lag_.theta;
    coefficients(x1_);
    for (double share = 1.0; share > 0.5 * constants::move; share *= 0.5) {  // less is no move
      for (int i = 0; share < 1.0 && i < nt; ++i)
        lag_.theta[i] = theta0_[i] + share * (theta1_[i] - theta0_[i]);
      for (long g = first; share < 1.0 && g <= end; ++g)
        for (int k = 0; k < kWidth; ++k) {
          const auto at = static_cast<std::size_t>(kWidth * (g - first) + k);
          lag_.block(g).x[k] = x0_[at] + share * (x1_[at] - x0_[at]);
        }
      predict();
      if (objective(last) <= before + 1e-3 * share) break;
    }
    double move = 0.0;
    for (int i = 0; i < nt; ++i)
      for (int j = 0; j < nt; ++j)
        move += (theta1_[i] - theta0_[i]) *
                (S_(std::max(i, j), std::min(i, j)) + (i == j ? 1.0 / prior_[i] : 0.0)) *
                (theta1_[j] - theta0_[j]);
    move = std::sqrt(std::max(move, 0.0) / static_cast<double>(use_.size()));
    weigh();
    invert();
    lag_.traces(first);
    SizeSums sums = window_sums(first);
    sums += left_;
    const double sized = resize(sums);
    weigh();
    if (iteration >= least && move < tolerance && sized < tolerance) break;
  }
  return true;
}

// What blocks of the lag say of sigma and q, under robust weights.
inline SizeSums Incremental::window_sums(long from) const {
  SizeSums out;
  for (long g = from; g < lag_.end(); ++g) out += lag_.block(g).sums;
  for (double& x : out.raw) x /= consistent_;
  return out;
}

// Whether the motion's rows depart from it by more than noise that would be told: what rested when the sizes were found has
// begun to move.
inline bool Incremental::surprised() {
  const SizeSums now = lag_.departures(past_);
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    for (Eigen::Index r = 0; r < lag_.sizes.motion_factor[i].size(); ++r) {
      const auto g = static_cast<std::size_t>(r);
      const double most = constants::noise_told * lag_.sizes.motion_factor[i][r];
      if (now.motion[i][g] > most * most * now.motion_count[i][g]) return true;
    }
  return false;
}

// Two lags are full, or the stretch ends (`last`). A lag that cannot be fitted leaves nothing: a cell of 1e30 would stand in theta and
// in the sizes for ever.
inline Status Incremental::hop(bool last) noexcept {
  keep();
  if (linearise(last)) return Status::ok;
  restore();
  return status_ = Status::not_factorizable;
}

// Linearise what is there at what is known now; what has 20 knots after it leaves, at the end all. theta is that of what left; the
// first two times, that of what stays, too.
inline bool Incremental::linearise(bool last) {
  const long first = lag_.first(), leaving = lag_.end() - first - (last ? 0 : staying());
  if (!lag_.terminal(moving_)) return false;
  lag_.back(first);
  int steps = hops_ == 0 ? 6 : hops_ == 1 ? 1 : 0;
  if (surprised()) {  // from START's q again: small q hold the motion, and it is taken for noise
    lag_.sizes.q = lag_.sizes.q.cwiseMax(constants::smoothness_start);
    steps = 6;
  }
  if (steps > 0 && !run(1, steps, last ? constants::move : constants::robust_move, last)) return false;
  predict();
  weigh();
  set_mask(leaving);
  // the traces' share of the rows hardly changes: they are asked for when twice as much has left. Then alone what stays is linearised
  const bool traced = last || steps > 0 || (hops_ & (hops_ - 1)) == 0;
  const bool ok = traced ? sweep(leaving, last) : leave(leaving, last) && lag_.terminal(moving_);
  if (hops_ >= 2) Z_ = Zp_;
  if (!ok || !solve()) return false;
  lag_.back(first);
  depart(leaving, traced);
  if (traced) lag_.know_theta(present_, moving_);
  return true;
}

// Sums of what leaves; sizes by them, and while little has left by what stays too.
inline void Incremental::depart(long leaving, bool traced) {
  const long first = lag_.first(), stay = first + leaving;
  invert();
  SizeSums gone;
  if (traced) lag_.traces(first);
  for (long g = first; g < stay; ++g) gone += lag_.block(g).sums;
  if (!traced) {
    const auto shared = [](auto& trace, const auto& count, const auto& of, const auto& all) {
      for (std::size_t r = 0; r < trace.size(); ++r) trace[r] = count[r] * of[r] / std::max(all[r], 1.0);
    };
    shared(gone.raw_trace, gone.raw_count, left_.raw_trace, left_.raw_count);
    for (std::size_t i = 0; i < lag_.streams(); ++i)
      shared(gone.motion_trace[i], gone.motion_count[i], left_.motion_trace[i], left_.motion_count[i]);
    for (std::size_t j = 0; j < kComponents; ++j)
      gone.energy_trace[j] = left_.energy_trace[j] * gone.knots / left_.knots;
  }
  left_ += gone;
  SizeSums all = left_;
  if (hops_ < 2) all += window_sums(stay);
  resize(all);
  count(first, stay);
  lag_.drop_before(stay);
  for (std::size_t i = 0; i < lag_.streams(); ++i) lag_.motion(i).drop_before(past_.next[i]);
  ++hops_;
}

// Blocks [from, to) into the running sums of (10.9) and (10.10), at theta as it stands.
inline void Incremental::count(long from, long to) {
  for (long g = from; g < to; ++g) {
    lag_.predict(g);
    add_delays(past_delays_, g);
    for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
      const Lag::Interval& v = lag_.interval(i);
      double size = 0.0, masked = 0.0;
      bool whole = false;
      for (int r = 0; r < v.rows; ++r) {
        const RawRow& row = v.row[static_cast<std::size_t>(r)];
        pose_.add(row.time, row.size, row.masked, row.nu.data(), row.w.data());
        size += row.size;
        if (!row.masked) {
          moments_.add(row.time, row.size, row.w.data(), row.cw.data(), row.residual.data());
          continue;
        }
        masked += row.size;
        whole = whole || row.gathered;
        if (!row.gathered) note_masked(row.time, row.time);
      }
      if (whole) note_masked(v.begin, v.end);
      masked_samples_ += std::lround(masked);
      samples_ += std::lround(size);
      log_samples_ += size;
    }
  }
}

// MASK of the first `leaving` blocks: w_t < 0.3; gaps of up to 30 ms closed; what then lasts 30 ms or more
// widened by 20 ms each side, as far as it has not left.
inline void Incremental::set_mask(long leaving) {
  const long first = lag_.first(), stay = first + leaving;
  const double ahead = lag_.start_of(stay) + kAhead;
  entries_.clear();
  for (long g = first; g < lag_.end() && lag_.start_of(g) <= ahead; ++g)
    for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
      Lag::Interval& v = lag_.interval(i);
      const auto enter = [&](RawRow& row, double begin, double end, Lag::Interval* all) {
        entries_.push_back({begin, end, row.weight < constants::mask_weight, false, g < stay, &row, all});
      };
      const auto end = v.row.begin() + v.rows,
                 whole = std::find_if(v.row.begin(), end, [](const RawRow& row) { return row.gathered; });
      if (whole != end) enter(*whole, v.begin, v.end - period_, &v);
      for (auto row = v.row.begin(); row != end; ++row)
        if (!row->gathered) enter(*row, row->time, row->time, nullptr);
    }
  double begin = run_[0], end = run_[1];
  std::size_t next = 0;  // first entry after the run
  const auto widen = [&](std::size_t to) {
    const bool lasting = end - begin + period_ >= constants::mask_shortest - 1e-9;
    const double margin = (lasting ? constants::gather_window : 0.0) + 1e-9, from = begin - margin,
                 until = end + margin;
    // in the order of their begins, the longest an interval of knots, in which single rows may lie
    for (std::size_t k = to; k > 0 && entries_[k - 1].begin >= from - lag_.h(); --k)
      if (entries_[k - 1].begin <= until && entries_[k - 1].end >= from) entries_[k - 1].masked = true;
    for (std::size_t k = to; k < entries_.size() && entries_[k].begin <= until; ++k)
      entries_[k].masked = true;
  };
  run_ = {-1e300, -1e300};
  for (std::size_t k = 0; k < entries_.size(); ++k) {
    const Entry& e = entries_[k];
    if (!e.low) continue;
    if (e.begin - end - period_ > constants::mask_shortest + 1e-9) {
      widen(next);
      begin = e.begin;
    }
    end = std::max(end, e.end);
    next = k + 1;
    if (e.leaves) run_ = {begin, end};
  }
  widen(next);
  for (Entry& e : entries_) {
    if (!e.leaves) continue;
    for (int r = 0; r < (e.interval != nullptr ? e.interval->rows : 1); ++r) {
      RawRow& row = e.interval != nullptr ? e.interval->row[static_cast<std::size_t>(r)] : *e.row;
      if (e.interval != nullptr && !row.gathered) continue;
      row.masked = e.masked;
      row.weight = 1.0;
    }
  }
}

// The stretch is over: what waits becomes its last block, and all blocks leave.
inline Status Incremental::close() noexcept {
  if (!open()) {
    drop_samples();
    return Status::ok;
  }
  limit_ = std::min(raw_last_, motion_last()) + 0.5 * raw_period() + 1e-9;
  Status status = Status::ok;
  if (!standing_) {
    if (!(limit_ - common_begin() >= 12.0 * coarsest_)) {
      ++dropped_;
      drop_samples();
      return Status::ok;
    }
    status = start(true);
  }
  while (standing_ && status == Status::ok && raw_at_ < raw_.end() && raw_[raw_at_].time < limit_)
    status = arrive(true);
  if (standing_ && status == Status::ok) status = hop(true);
  abandon(status);
  return status_ = worse(status, status_);
}

// What a step must lower, the prior and what left the lag with it.
inline double Incremental::objective(bool last) const {
  double sum = lag_.objective(past_, lag_.first());
  Cursor next = past_.next;
  for (long g = lag_.first(); g < lag_.end(); ++g)
    sum += lag_.objective(g, next, last && g + 1 == lag_.end());
  for (int i = 0; i < lag_.parameters(); ++i) {
    if (active_[static_cast<std::size_t>(i)] == 0) continue;
    const double d = lag_.theta[i] - lag_.layout().mean()[i];
    sum += d * d / prior_[i];
  }
  return sum;
}

// (10.7) of the first lag, with the Student-t sum; noise in units of the
// stated, so that what was left out costs nothing.
inline double Incremental::likelihood(bool last) const {
  double sum = objective(last) + logdet_x_ + logdet_s_;
  const Sizes& z = lag_.sizes;
  const SizeSums counts = window_sums(lag_.first());
  for (Eigen::Index r = 0; r < z.raw_factor.size(); ++r)
    sum += 2.0 * counts.raw_count[static_cast<std::size_t>(r)] * std::log(z.raw_factor[r]);
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r)
      sum += 2.0 * counts.motion_count[i][static_cast<std::size_t>(r)] * std::log(z.motion_factor[i][r]);
  const Spline spline = LagStart::spline(lag_);
  for (int j = 0; j < kComponents; ++j) {
    const int p = smoothness_order(lag_.about().source, j);
    sum += static_cast<double>(spline.size() - p) * std::log(z.q[j]) - spline.smoothness_logdet(p);
  }
  for (std::size_t i = 0; i < active_.size(); ++i)
    if (active_[i] != 0) sum += std::log(prior_[static_cast<Eigen::Index>(i)]);
  return sum;
}

}  // namespace truewrench
