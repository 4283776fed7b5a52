// Samples of one stream, the newest of them, in storage that is allocated once.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <vector>

namespace truewrench::contact {

// Samples are counted from the first that was ever kept; the last `capacity` of them are there.
class Ring {
 public:
  void configure(int values, int capacity) {
    values_.setZero(values, capacity);
    stamps_.assign(static_cast<std::size_t>(capacity), 0);
    marks_.assign(static_cast<std::size_t>(capacity), 0);
    end_ = 0;
  }

  void clear() noexcept { end_ = 0; }

  int capacity() const noexcept { return static_cast<int>(stamps_.size()); }
  std::int64_t end() const noexcept { return end_; }
  std::int64_t begin() const noexcept { return end_ > capacity() ? end_ - capacity() : 0; }
  std::int64_t time(std::int64_t i) const noexcept { return stamps_[slot(i)]; }
  std::int64_t mark(std::int64_t i) const noexcept { return marks_[slot(i)]; }
  const double* values(std::int64_t i) const noexcept {
    return values_.col(static_cast<Eigen::Index>(slot(i))).data();
  }

  // Of a stamp, on either side of zero [ns], so that differences are numbers: the year 2116.
  static constexpr std::int64_t farthest = (std::int64_t{1} << 62) - 2'000'000'000;
  static constexpr bool near(std::int64_t time) noexcept { return -farthest < time && time < farthest; }

  // Place for the next sample, none where its stamp does not lie after the last; keep() makes it one.
  double* next(std::int64_t time, std::int64_t mark) noexcept {
    if (!near(time) || (end_ > 0 && time <= this->time(end_ - 1))) return nullptr;
    pending_time_ = time;
    pending_mark_ = mark;
    return values_.col(static_cast<Eigen::Index>(slot(end_))).data();
  }
  void keep() noexcept {
    stamps_[slot(end_)] = pending_time_;
    marks_[slot(end_)] = pending_mark_;
    ++end_;
  }

  // The first sample at a stamp or after it; end() where there is none.
  std::int64_t from(std::int64_t time) const noexcept {
    std::int64_t low = begin(), high = end_;
    while (low < high) {
      const std::int64_t middle = low + (high - low) / 2;
      if (this->time(middle) < time)
        low = middle + 1;
      else
        high = middle;
    }
    return low;
  }

  // The sample at this very stamp, -1 where there is none.
  std::int64_t find(std::int64_t time) const noexcept {
    const std::int64_t i = from(time);
    return i < end_ && this->time(i) == time ? i : -1;
  }

 private:
  std::size_t slot(std::int64_t i) const noexcept { return static_cast<std::size_t>(i) % stamps_.size(); }

  Eigen::MatrixXd values_;
  std::vector<std::int64_t> stamps_, marks_;
  std::int64_t end_ = 0, pending_time_ = 0, pending_mark_ = 0;
};

}  // namespace truewrench::contact
