// Samples that travel in packets (a serial adapter, a network) have the stamps of their receipt. They were taken evenly all the
// same, the last of a packet when it left: as they come, each gets its stamp on a line that follows the last ones.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace truewrench::contact {

class EvenStamps {
 public:
  static constexpr std::int64_t apart_ns = 250'000'000;  // between packets at most: beyond is a gap
  static constexpr double close = 0.1;                   // of the mean interval: two that came together
  static constexpr double share = 0.4;  // of the intervals that are so short: then samples come in packets
  static constexpr int learned = 64;    // samples that tell packets, and their period

  // The stamp of the next sample, received at `time` (increasing): the same one as long as samples come one by one.
  std::int64_t stamp(std::int64_t time) noexcept {
    if (count_ > 0 && time - latest_ > apart_ns) *this = EvenStamps();  // after a gap as from the beginning
    if (count_ >= learned) {
      const double mean = static_cast<double>(latest_ - received_[slot(count_)]) / (learned - 1);
      if (static_cast<double>(time - latest_) >= close * mean) look(mean);  // the one before ended its packet
    }
    received_[slot(count_)] = latest_ = time;
    ++count_;
    even_ = period_ > 0.0 ? std::max(given_ + 1, even_ + rounded(period_)) : time;
    return given_ = even_;
  }

  std::int64_t latest() const noexcept { return given_; }
  bool packets() const noexcept { return period_ > 0.0; }

 private:
  static constexpr double follow = 0.1;  // of what a packet is off the line: packets scatter, clocks drift
  static constexpr double lost = 0.75;   // of a packet, by which the line begins anew: another was lost

  static std::int64_t rounded(double x) noexcept { return static_cast<std::int64_t>(std::llround(x)); }
  static std::size_t slot(std::int64_t k) noexcept { return static_cast<std::size_t>(k % learned); }

  // At the end of a packet: whether samples come in packets, their period, and how far the line is off.
  void look(double mean) noexcept {
    std::array<double, learned> lasted, held;  // by packets, and their samples
    std::int64_t before = 0;                   // end of the packet before
    bool any = false;
    int together = 0, samples = 0, packets = 0;
    for (std::int64_t k = count_ - learned; k < count_; ++k) {
      const std::int64_t now = received_[slot(k)];
      ++samples;
      if (k + 1 < count_ && static_cast<double>(received_[slot(k + 1)] - now) < close * mean) {
        ++together;
        continue;
      }
      if (any) {
        const auto at = static_cast<std::size_t>(packets++);
        lasted[at] = static_cast<double>(now - before);
        held[at] = samples;
      }
      any = true;
      before = now;
      samples = 0;
    }
    const bool went = period_ > 0.0;
    period_ = 0.0;
    if (together < share * learned || packets < 2) return;
    std::array<double, learned> sorted = lasted;
    std::nth_element(sorted.begin(), sorted.begin() + packets / 2, sorted.begin() + packets);
    const double packet = sorted[static_cast<std::size_t>(packets / 2)],
                 off = static_cast<double>(latest_ - even_);
    double time = 0.0, all = 0.0;
    for (std::size_t at = 0; at < static_cast<std::size_t>(packets); ++at) {
      if (lasted[at] > (1.0 + lost) * packet) continue;
      time += lasted[at];
      all += held[at];
    }
    period_ = time / all;
    even_ = went && std::abs(off) < lost * packet ? even_ + rounded(follow * off) : latest_;
  }

  std::array<std::int64_t, learned> received_{};
  std::int64_t count_ = 0, latest_ = 0, even_ = 0, given_ = 0;  // given: what was told last
  double period_ = 0.0;                                         // [ns]; 0: one by one
};

}  // namespace truewrench::contact
