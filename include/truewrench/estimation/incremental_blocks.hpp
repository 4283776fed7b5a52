// The life of a block: samples to rows, its arrival, the re-linearisation of two lags, its mask, its departure. Included by
// incremental.hpp.
#pragma once

#include "truewrench/estimation/incremental.hpp"

namespace truewrench {

// [s] to where the sensor and every motion stream that is not silent have come.
inline double Incremental::covered() const {
  double out = raw_last_;
  const double newest = motion_last(), silent = gap(motion_period());
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    if (motion_[i].end() == 0) return -1e300;
    if (newest - motion_last_[i] > silent) continue;
    out = std::min(out, motion_last_[i] + std::min(0.0, lag_.clock(i)));
  }
  return out;
}

inline Status Incremental::advance() noexcept {
  if (!open()) return Status::ok;
  if (standing_) {
    Status out = Status::ok;
    while (covered() >= lag_.start_of(lag_.end() + 1)) out = worse(out, arrive(false));
    return out;
  }
  coarsest_ = std::max(constants::knot_spacing, constants::periods_per_knot * motion_period());
  if (settings_.spacing > 0.0) coarsest_ = settings_.spacing;
  double begin = raw_[raw_.begin()].time;
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    if (motion_[i].empty()) return Status::ok;
    begin = std::max(begin, motion_[i][motion_[i].begin()].time);
  }
  if (covered() - begin + 0.5 * raw_period() < lag_blocks(coarsest_) * kBlock * coarsest_) return Status::ok;
  return start(false);
}

// Rows of block g from the samples that wait; `all`: up to limit_.
inline void Incremental::take_block(long g, bool all) {
  const auto note = [this](double begin, double end) {
    if (masked_count_ < masked_.size()) masked_[masked_count_++] = {begin, end};
    ++masked_samples_;
  };
  for (int o = 0; o < kBlock; ++o) {
    const long at = kBlock * g + o;
    const double end = lag_.origin() + lag_.h() * static_cast<double>(at + 1) - 1e-9 * lag_.h();
    const double stop = all ? std::min(end, limit_) : end;
    long to = raw_at_;
    while (to < raw_.end() && raw_[to].time < stop) ++to;
    lag_.take(at, raw_, raw_at_, to, note);
    raw_at_ = to;
    for (std::size_t i = 0; i < lag_.streams(); ++i) {
      long last = motion_at_[i];
      while (last < motion_[i].end() && motion_[i][last].time < stop) ++last;
      lag_.take(i, motion_[i], motion_at_[i], last);
      motion_at_[i] = last;
    }
  }
}

// All blocks of the first lag at a spacing.
inline void Incremental::lay(double origin, double h, long blocks, bool partial) {
  raw_at_ = raw_.begin();
  lag_.place(origin, h);
  masked_count_ = 0;
  for (std::size_t i = 0; i < lag_.streams(); ++i) {
    motion_at_[i] = motion_[i].begin();
    past_.next[i] = lag_.motion(i).begin();
  }
  while (lag_.end() < blocks) {
    take_block(lag_.end(), partial);
    lag_.grow();
  }
}

// START and ROBUST at a spacing; (10.7).
inline double Incremental::fit_first(double origin, double h, long blocks, bool partial) {
  const auto before = masked_samples_;
  lay(origin, h, blocks, partial);
  masked_samples_ = before;
  kept_ = lag_.sizes;
  if (first_stretch_) {  // theta's own part, and for the first log all of it, at the mean
    const int from = first_log_ ? 0 : lag_.offset_at();
    lag_.theta.tail(lag_.parameters() - from) = lag_.layout().mean().tail(lag_.parameters() - from);
    prior_.tail(lag_.parameters() - from) = stated_.tail(lag_.parameters() - from);
    std::fill(active_.begin(), active_.end(), char{1});
  }
  if (!std::isfinite(start_.motion_alone(lag_))) return std::nan("");
  if (first_stretch_) {
    for (long g = 0; g < blocks; ++g) lag_.predict(g);
    start_.regress(lag_, prior_, first_log_);
  } else {
    lag_.sizes = kept_;
  }
  if (!run(constants::most_iterations, partial)) return std::nan("");
  return likelihood(partial);
}

// The first lag of a stretch: h by (10.7) among h, h / 2 and the best for the motion alone, 6 a halving; again from there (10.2).
inline Status Incremental::start(bool partial) noexcept {
  period_ = raw_period();
  motion_period_ = motion_period();
  double begin = raw_[raw_.begin()].time;
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    begin = std::max(begin, motion_[i][motion_[i].begin()].time);
  const double origin = begin - 0.5 * period_;
  while (!raw_.empty() && raw_[raw_.begin()].time < origin) raw_.drop_before(raw_.begin() + 1);
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    while (!motion_[i].empty() && motion_[i][motion_[i].begin()].time < origin)
      motion_[i].drop_before(motion_[i].begin() + 1);
  const auto blocks = [&](double h) {
    const double length = partial ? limit_ - origin : lag_blocks(coarsest_) * kBlock * coarsest_;
    return std::max(2L, static_cast<long>(std::ceil(length / (kBlock * h) - 1e-6)));
  };
  if (!chosen_) {
    std::array<double, 8> ladder{}, cost{}, alone{};
    std::size_t count = 0;
    for (double h = coarsest_; count < ladder.size();) {
      ladder[count++] = h;
      if (settings_.spacing > 0.0 || h <= 1.01 * motion_period_) break;
      h = std::max(0.5 * h, motion_period_);
      if (blocks(h) + 2 > most_blocks_ / 2 + 1) break;  // what memory is for
    }
    cost.fill(std::nan(""));
    const auto dear = [&](std::size_t i) {
      return constants::halving_cost * std::log2(ladder[0] / ladder[i]);
    };
    std::size_t now = 0, best_alone = 0;
    if (count > 1) {
      for (std::size_t i = 0; i < count; ++i) {
        lay(origin, ladder[i], blocks(ladder[i]), partial);
        lag_.theta = lag_.layout().mean();
        alone[i] = start_.motion_alone(lag_) + dear(i);
        if (alone[i] < alone[best_alone]) best_alone = i;
      }
      for (;;) {
        for (const std::size_t i : {now, now + 1, best_alone})
          if (i >= now && i < count && std::isnan(cost[i]))
            cost[i] = fit_first(origin, ladder[i], blocks(ladder[i]), partial) + dear(i);
        std::size_t best = now;
        for (std::size_t i = now; i < count; ++i)
          if (cost[i] < cost[best] || std::isnan(cost[best])) best = i;
        if (best <= now) break;
        now = best;
      }
    }
    h_ = ladder[now];
    unresolved_ = count > 1 && now + 1 == count;
    chosen_ = true;
  }
  if (!std::isfinite(fit_first(origin, h_, blocks(h_), partial))) {
    status_ = Status::not_factorizable;
    raw_.clear();
    for (auto& m : motion_) m.clear();
    return status_;
  }
  raw_.drop_before(raw_at_);
  for (std::size_t i = 0; i < lag_.streams(); ++i) motion_[i].drop_before(motion_at_[i]);
  blocks_ += lag_.end();
  standing_ = ready_ = true;
  first_stretch_ = false;
  hops_ = 0;
  arrival_ = 0.0;
  return Status::ok;
}

// A block has come: its motion as expected, weights against its own scale, eliminated behind the others; theta from all.
inline Status Incremental::arrive(bool last) noexcept {
  Status status = Status::ok;
  if (lag_.end() - lag_.first() >= 2 * lag_blocks(h_)) status = hop();
  const long g = lag_.end();
  take_block(g, last);
  raw_.drop_before(raw_at_);
  for (std::size_t i = 0; i < lag_.streams(); ++i) motion_[i].drop_before(motion_at_[i]);
  lag_.expect(present_, g, last);
  lag_.predict(g);
  entries_.clear();
  for (long i = kBlock * g; i < kBlock * (g + 1); ++i)
    for (int r = 0; r < lag_.interval(i).rows; ++r) {
      Entry e;
      e.begin = lag_.chi2(lag_.interval(i).row[static_cast<std::size_t>(r)]) / lag_.channels();
      entries_.push_back(e);
    }
  double scale = 1.0;
  if (!entries_.empty()) {
    const auto middle = entries_.begin() + static_cast<std::ptrdiff_t>(entries_.size() / 2);
    std::nth_element(entries_.begin(), middle, entries_.end(),
                     [](const Entry& a, const Entry& b) { return a.begin < b.begin; });
    const double level = middle->begin;
    if (arrival_ == 0.0) arrival_ = level;
    scale = std::max(1.0, level > 4.0 * arrival_ ? arrival_ : level);
    arrival_ += 0.1 * (std::min(level, 4.0 * arrival_) - arrival_);
  }
  lag_.reweigh(g, scale);
  const bool ok = lag_.eliminate(present_, g, last);
  lag_.grow();
  ++blocks_;
  if (!ok || !std::isfinite(logdet_x_ = lag_.terminal(present_, S_, eta_)) || !solve(S_, false))
    return status_ = Status::not_factorizable;
  lag_.back(std::max(lag_.first(), g - 3));
  return status;
}

// Eliminate the blocks of the lag as predicted and weighted; the first `leaving` for good.
inline bool Incremental::sweep(long leaving, bool last) {
  const long first = lag_.first(), end = lag_.end();
  const long lag = lag_blocks(h_);
  for (long g = first; g < first + leaving; ++g) {
    if (!lag_.eliminate(past_, g, last && g + 1 == end)) return false;
    if ((g + 1 - first) % lag != 0 && g + 1 != first + leaving) continue;
    if (!std::isfinite(logdet_x_ = lag_.terminal(past_, Sp_, eta_))) return false;
    part(Sp_);
  }
  present_ = past_;
  for (long g = first + leaving; g < end; ++g)
    if (!lag_.eliminate(present_, g, last && g + 1 == end)) return false;
  return std::isfinite(logdet_x_ = lag_.terminal(present_, S_, eta_));
}

// Gauss-Newton and (10.6) on all blocks of the lag, robust weights, as Fit::run() does.
inline bool Incremental::run(int most, bool last) {
  if (left_.knots == 0.0)
    for (int i = 0; i < lag_.channels(); ++i)
      lag_.lagged.row(i) = lag_.theta.segment<6>(lag_.gain_at() + 6 * i).transpose();
  const long first = lag_.first(), end = lag_.end();
  const auto weigh = [&] {
    for (long g = first; g < end; ++g) lag_.reweigh(g);
  };
  const auto column = [&](long g) { return static_cast<Eigen::Index>(g - first); };
  for (long g = first; g < end; ++g) lag_.predict(g);
  weigh();
  for (int iteration = 1; iteration <= most; ++iteration) {
    if (!sweep(0, last)) return false;
    const double before = objective(last);
    theta0_ = lag_.theta;
    for (long g = first; g <= end; ++g) x0_.col(column(g)) = lag_.block(g).x;
    if (!solve(S_, true)) return false;
    lag_.back(first);
    theta1_ = lag_.theta;
    for (long g = first; g <= end; ++g) x1_.col(column(g)) = lag_.block(g).x;
    double share = 1.0;
    for (int halving = 0; halving <= constants::most_halvings; ++halving, share *= 0.5) {
      if (halving > 0) {
        lag_.theta = theta0_ + share * (theta1_ - theta0_);
        for (long g = first; g <= end; ++g)
          lag_.block(g).x = x0_.col(column(g)) + share * (x1_.col(column(g)) - x0_.col(column(g)));
      }
      for (long g = first; g < end; ++g) lag_.predict(g);
      if (objective(last) <= before + 1e-3 * share) break;
    }
    settle(S_);
    solved_ = theta1_ - theta0_;
    column_.noalias() = M_.selfadjointView<Eigen::Lower>() * solved_;
    const double move = std::sqrt(std::max(solved_.dot(column_), 0.0) / static_cast<double>(use_.size()));
    weigh();
    lag_.traces(first);
    SizeSums sums = left_;
    sums += window_sums();
    const double sized = resize(sums, S_);
    weigh();
    if (iteration > 2 && move < constants::theta_move && sized < constants::size_move) break;
  }
  if (!sweep(0, last) || !solve(S_, true)) return false;
  lag_.back(first);
  for (long g = first; g < end; ++g) lag_.predict(g);
  weigh();
  return true;
}

// What the blocks of the lag say of sigma and q, under robust weights.
inline SizeSums Incremental::window_sums() const {
  SizeSums out;
  for (long g = lag_.first(); g < lag_.end(); ++g) out += lag_.block(g).sums;
  out.raw /= consistent_;
  return out;
}

// Two lags are full: linearise all of them at what is known now; the older one leaves.
inline Status Incremental::hop() noexcept {
  const long first = lag_.first(), leaving = lag_blocks(h_);
  lag_.back(first);
  if (hops_ < 2 && !run(hops_ == 0 ? 6 : 1, false)) return status_ = Status::not_factorizable;
  for (long g = first; g < lag_.end(); ++g) {
    lag_.predict(g);
    lag_.reweigh(g);
  }
  set_mask(leaving);
  if (!sweep(leaving, false) || !solve(S_, true)) return status_ = Status::not_factorizable;
  lag_.back(first);
  depart(leaving);
  return Status::ok;
}

// Sums of what leaves; sizes by them, and while little has left by what stays too.
inline void Incremental::depart(long leaving) {
  const long first = lag_.first(), stay = first + leaving;
  settle(S_);
  const bool traced = hops_ < 4 || hops_ % 4 == 0;  // their share of the rows hardly changes
  SizeSums gone, kept;
  if (traced) lag_.traces(first);
  for (long g = first; g < lag_.end(); ++g) (g < stay ? gone : kept) += lag_.block(g).sums;
  if (!traced) {
    const auto shared = [](auto& trace, const auto& count, const auto& of, const auto& all) {
      trace = count * of / all.max(1.0);
    };
    shared(gone.raw_trace, gone.raw_count, left_.raw_trace, left_.raw_count);
    for (std::size_t i = 0; i < lag_.streams(); ++i)
      shared(gone.motion_trace[i], gone.motion_count[i], left_.motion_trace[i], left_.motion_count[i]);
    gone.energy_trace = left_.energy_trace * (gone.knots / left_.knots);
  }
  left_ += gone;
  if (hops_ < 4) {
    kept.raw /= consistent_;
    kept += left_;
    resize(kept, S_);
  } else {
    resize(left_, Sp_);
  }
  for (long g = first; g < stay; ++g) {
    lag_.predict(g);
    for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
      const Lag::Interval& v = lag_.interval(i);
      double size = 0.0;
      bool masked = false;
      for (int r = 0; r < v.rows; ++r) {
        const RawRow& row = v.row[static_cast<std::size_t>(r)];
        pose_.add(row);
        size += row.size;
        if (!row.masked) {
          moments_.add(row);
          continue;
        }
        masked = true;
        if (v.spared > 0.0) continue;
        ++masked_samples_;
        if (masked_count_ < masked_.size()) masked_[masked_count_++] = {row.time, row.time};
      }
      const auto count = static_cast<std::int64_t>(std::lround(size));
      samples_ += count;
      log_samples_ += size;
      if (!(v.spared > 0.0)) continue;
      if (!masked) continue;
      masked_samples_ += count;
      if (masked_count_ < masked_.size()) masked_[masked_count_++] = {v.begin, v.end};
    }
  }
  lag_.drop_before(stay);
  for (std::size_t i = 0; i < lag_.streams(); ++i) lag_.motion(i).drop_before(past_.next[i]);
  ++hops_;
}

// MASK of the first `leaving` blocks: w_t < 0.3; gaps of up to 30 ms closed; what then lasts 30 ms or more widened by 20 ms each
// side, as far as it has not left.
inline void Incremental::set_mask(long leaving) {
  const long first = lag_.first(), stay = first + leaving;
  const double ahead =
      lag_.start_of(stay) + constants::mask_join + constants::mask_length + constants::mask_margin;
  entries_.clear();
  for (long g = first; g < lag_.end() && lag_.start_of(g) <= ahead; ++g)
    for (long i = kBlock * g; i < kBlock * (g + 1); ++i) {
      Lag::Interval& v = lag_.interval(i);
      for (int r = 0; r < v.rows; ++r) {
        Entry e;
        RawRow& row = v.row[static_cast<std::size_t>(r)];
        e.begin = v.spared > 0.0 ? v.begin : row.time;
        e.end = v.spared > 0.0 ? v.end - period_ : row.time;
        e.low = row.weight < constants::mask_weight;
        e.leaves = g < stay;
        e.row = &row;
        if (v.spared > 0.0) e.interval = &v;
        if (v.spared == 0.0 || r == 0) entries_.push_back(e);
      }
    }
  double begin = run_[0], end = run_[1];
  std::size_t next = 0;  // first entry after the run
  const auto widen = [&](std::size_t to) {
    const bool lasting = end - begin + period_ >= constants::mask_length - 1e-9;
    const double from = begin - (lasting ? constants::mask_margin : 0.0) - 1e-9,
                 until = end + (lasting ? constants::mask_margin : 0.0) + 1e-9;
    for (std::size_t k = to; k-- > 0 && entries_[k].end >= from;)
      if (entries_[k].begin <= until) entries_[k].masked = true;
    for (std::size_t k = to; k < entries_.size() && entries_[k].begin <= until; ++k)
      entries_[k].masked = true;
  };
  run_ = {-1e300, -1e300};
  for (std::size_t k = 0; k < entries_.size(); ++k) {
    if (!entries_[k].low) continue;
    if (entries_[k].begin - end - period_ > constants::mask_join + 1e-9) {
      widen(next);
      begin = entries_[k].begin;
    }
    end = std::max(end, entries_[k].end);
    next = k + 1;
    if (entries_[k].leaves) run_ = {begin, end};
  }
  widen(next);
  for (Entry& e : entries_) {
    if (!e.leaves) continue;
    const int rows = e.interval != nullptr ? e.interval->rows : 1;
    for (int r = 0; r < rows; ++r) {
      RawRow& row = e.interval != nullptr ? e.interval->row[static_cast<std::size_t>(r)] : *e.row;
      row.masked = e.masked;
      row.weight = 1.0;
    }
  }
}

// The stretch is over: what waits becomes its last block, and all blocks leave.
inline Status Incremental::close() noexcept {
  const auto clear = [this] {
    raw_.clear();
    for (auto& m : motion_) m.clear();
  };
  if (!open()) {
    clear();
    return Status::ok;
  }
  limit_ = std::min(raw_last_, motion_last()) + 0.5 * raw_period() + 1e-9;
  Status status = Status::ok;
  if (!standing_) {
    double begin = raw_[raw_.begin()].time;
    for (std::size_t i = 0; i < lag_.streams(); ++i)
      begin = std::max(begin, motion_[i].empty() ? 1e300 : motion_[i][motion_[i].begin()].time);
    if (limit_ - begin < 12.0 * coarsest_) {
      ++dropped_;
      clear();
      return Status::ok;
    }
    status = start(true);
  }
  while (standing_ && status == Status::ok && raw_at_ < raw_.end() && raw_[raw_at_].time < limit_)
    status = arrive(true);
  if (standing_ && status == Status::ok) {
    const long first = lag_.first(), leaving = lag_.end() - first;
    lag_.back(first);
    if (!run(3, true)) status = Status::not_factorizable;
    set_mask(leaving);
    if (status == Status::ok && sweep(leaving, true) && solve(S_, true)) {
      lag_.back(first);
      depart(leaving);
      solve(S_, true);
    } else {
      status = Status::not_factorizable;
    }
  }
  // what is known of theta goes on
  past_.H.setZero();
  past_.F.setZero();
  past_.T = status == Status::ok ? S_ : Sl_;
  past_.logdet = 0.0;
  if (status != Status::ok) S_ = Sl_;
  pose_.end_stretch();
  run_ = {-1e300, -1e300};
  standing_ = false;
  clear();
  return status_ = worse(status, status_);
}

// What a step must lower, the prior and what left the lag with it.
inline double Incremental::objective(bool last) {
  double sum = 0.0;
  Cursor next = past_.next;
  for (long g = lag_.first(); g < lag_.end(); ++g)
    sum += lag_.objective(g, next, last && g + 1 == lag_.end());
  const BlockVector& x = lag_.block(lag_.first()).x;
  const int nt = lag_.parameters();
  column_.noalias() = past_.T.topLeftCorner(nt, nt).selfadjointView<Eigen::Lower>() * lag_.theta;
  column_ -= 2.0 * past_.T.row(nt).head(nt).transpose();
  sum += lag_.theta.dot(column_);
  BlockVector y = past_.H.selfadjointView<Eigen::Lower>() * x;
  y.noalias() += 2.0 * (past_.F.leftCols(nt) * lag_.theta);
  y -= 2.0 * past_.F.col(nt);
  sum += x.dot(y);
  for (int i = 0; i < nt; ++i)
    if (active_[static_cast<std::size_t>(i)] != 0) {
      const double d = lag_.theta[i] - lag_.layout().mean()[i];
      sum += d * d / prior_[i];
    }
  return sum;
}

// (10.7) of the first lag, with the Student-t sum; noise in units of the stated, so that what was left out costs nothing.
inline double Incremental::likelihood(bool last) {
  double sum = objective(last) + logdet_x_ + logdet_s_;
  const Sizes& z = lag_.sizes;
  SizeSums counts;
  for (long g = lag_.first(); g < lag_.end(); ++g) counts += lag_.block(g).sums;
  for (Eigen::Index r = 0; r < z.raw_factor.size(); ++r)
    sum += 2.0 * counts.raw_count[r] * std::log(z.raw_factor[r]);
  for (std::size_t i = 0; i < lag_.streams(); ++i)
    for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r)
      sum += 2.0 * counts.motion_count[i][r] * std::log(z.motion_factor[i][r]);
  const auto N = static_cast<double>(kBlock * (lag_.end() - lag_.first() + 1));
  for (int j = 0; j < kComponents; ++j)
    sum +=
        (N - smoothness_order(lag_.about().source, j)) * std::log(z.q[j]) - start_.smoothness_logdet(lag_, j);
  for (std::size_t i = 0; i < active_.size(); ++i)
    if (active_[i] != 0) sum += std::log(prior_[static_cast<Eigen::Index>(i)]);
  return sum;
}

}  // namespace truewrench
