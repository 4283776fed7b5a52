// START of METHOD 10.3: gain and offset by a robust regression of the raw output on the wrench of a motion.
#pragma once

#include "truewrench/estimation/sizes.hpp"
#include "truewrench/math/dense.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace truewrench {

// Raw on [w, 1] channel by channel, with the prior; offsets of each log, or of several.
class Regression {
 public:
  // How much memory is taken at once, so that nothing is allocated later.
  void reserve(std::size_t rows, int channels) {
    begin(channels);
    begin_log(0, Eigen::VectorXd::Zero(channels));
    const auto n = static_cast<std::size_t>(channels);
    values_.reserve(rows * (6 + n));
    for (auto* v : {&remainder_, &residual_}) v->reserve(rows * n);
    for (auto* v : {&size_, &weight_, &sizes_}) v->reserve(rows);
    set_work();
  }

  void begin(int channels) {
    n_ = channels;
    offsets_ = 0;
    logs_.clear();
    for (auto* v : {&values_, &remainder_, &size_, &weight_}) v->clear();
  }
  // The rows that follow are of a log whose offset is the one of this number; noise (n): stated.
  void begin_log(int offset, const Eigen::VectorXd& noise) {
    offsets_ = std::max(offsets_, offset + 1);
    Log log;
    log.offset = offset;
    log.first = size_.size();
    std::copy_n(noise.data(), n_, log.scale);
    logs_.push_back(log);
  }
  // w (6), raw (n), NaN where missing; the squares within what the row stands for (n), or null.
  void add(const double* w, const double* raw, const double* remainder, double size) {
    values_.insert(values_.end(), w, w + 6);
    values_.insert(values_.end(), raw, raw + n_);
    for (int i = 0; i < n_; ++i) remainder_.push_back(remainder ? remainder[i] : 0.0);
    size_.push_back(size);
    weight_.push_back(1.0);
  }

  // By up to 15 rounds of weights, until no scale moves by 0.1 %. nominal (n, 6): what the gain departs from; prior(i, k): variances
  // of gains k < 6 of channel i, and of its offsets. False where they determine nothing.
  template <typename Prior>
  bool fit(const double* nominal, const Eigen::VectorXd& noise, const Prior& prior) {
    set_work();
    for (int round = 0; round < 15; ++round) {
      if (!solve(nominal, prior)) return false;
      if (reweigh(noise) < 1e-3) break;
    }
    return true;
  }

  int offsets() const { return offsets_; }
  // Gain k < 6 of a channel, then its offsets.
  double found(int channel, int k) const {
    return found_[static_cast<std::size_t>(channel * unknowns() + k)];
  }
  // Of the noise of a channel of a log.
  double scale(std::size_t log, int channel) const { return logs_[log].scale[channel]; }

 private:
  struct Log {
    int offset = 0;
    std::size_t first = 0;  // row
    double scale[max_components] = {};
  };

  int n_ = 6, offsets_ = 0;
  std::vector<Log> logs_;
  std::vector<double> values_, remainder_, size_, weight_;  // (rows, 6 + n), (rows, n), (rows)
  std::vector<double> residual_, sizes_;                    // (rows, n); work space
  std::vector<double> found_, A_, b_;  // (n, unknowns); of one channel: (unknowns, unknowns), (unknowns)
  // [w, 1]^T [w, 1, raw] (7, width), log by log: of rows with all channels; then, channel by channel, of those that lack one
  std::vector<double> sums_, features_;

  int unknowns() const { return 6 + offsets_; }
  int width() const { return 8 + dense::padded(n_); }
  std::size_t rows_end(std::size_t log) const {
    return log + 1 < logs_.size() ? logs_[log + 1].first : size_.size();
  }
  double* sums(std::size_t log, int which) {
    return sums_.data() + (log * static_cast<std::size_t>(n_ + 1) + static_cast<std::size_t>(which)) *
                              static_cast<std::size_t>(7 * width());
  }

  void set_work() {
    const auto size = [](int x) { return static_cast<std::size_t>(x); };
    residual_.resize(size_.size() * size(n_));
    found_.assign(size(n_ * unknowns()), 0.0);
    A_.resize(size(unknowns() * unknowns()));
    b_.resize(size(unknowns()));
    sums_.resize(logs_.size() * size((n_ + 1) * 7 * width()));
    features_.resize(size(width()));
  }

  template <typename Prior>
  bool solve(const double* nominal, const Prior& prior) {
    std::fill(sums_.begin(), sums_.end(), 0.0);
    for (std::size_t l = 0; l < logs_.size(); ++l) sum(l);
    const int size = unknowns();
    for (int i = 0; i < n_; ++i) {
      std::fill(A_.begin(), A_.end(), 0.0);
      std::fill(b_.begin(), b_.end(), 0.0);
      for (int k = 0; k < size; ++k) A_[static_cast<std::size_t>(k * size + k)] = 1.0 / prior(i, k);
      for (std::size_t l = 0; l < logs_.size(); ++l) {
        const double v = std::pow(logs_[l].scale[i], -2.0);
        const auto at = [&](int k) { return k < 6 ? k : 6 + logs_[l].offset; };
        for (int k = 0; k < 7; ++k) {
          const double *all = sums(l, 0) + k * width(), *own = sums(l, 1 + i) + k * width();
          double y = all[8 + i] + own[8 + i];  // of raw less what it is nominally
          for (int c = 0; c < 6; ++c) y -= nominal[6 * i + c] * (all[c] + own[c]);
          b_[static_cast<std::size_t>(at(k))] += v * y;
          for (int c = 0; c < 7; ++c)
            A_[static_cast<std::size_t>(at(k) * size + at(c))] += v * (all[c] + own[c]);
        }
      }
      if (!dense::solve(A_.data(), b_.data(), size)) return false;
      double* found = found_.data() + i * size;
      for (int k = 0; k < size; ++k)
        found[k] = b_[static_cast<std::size_t>(k)] + (k < 6 ? nominal[6 * i + k] : 0.0);
    }
    return true;
  }

  void sum(std::size_t l) {
    features_[6] = 1.0;
    for (std::size_t k = logs_[l].first; k < rows_end(l); ++k) {
      const double* row = values_.data() + k * static_cast<std::size_t>(6 + n_);
      std::copy_n(row, 6, features_.begin());
      bool whole = true;
      for (int i = 0; i < n_; ++i) {
        const bool there = std::isfinite(row[6 + i]);
        features_[static_cast<std::size_t>(8 + i)] = there ? row[6 + i] : 0.0;
        whole = whole && there;
      }
      const auto add = [&](int to) {
        for (int f = 0; f < 7; ++f)
          dense::add(sums(l, to) + f * width(),
                     size_[k] * weight_[k] * features_[static_cast<std::size_t>(f)], features_.data(),
                     width());
      };
      if (whole) add(0);
      for (int i = 0; i < n_ && !whole; ++i)
        if (std::isfinite(row[6 + i])) add(1 + i);
    }
  }

  // Scales: 1.48 median of the residuals, and at least the stated sigma. Cauchy weights: (1 + n) / (1 + chi^2_n). Returns by how
  // much the scales moved.
  double reweigh(const Eigen::VectorXd& noise) {
    double moved = 0.0;
    for (std::size_t l = 0; l < logs_.size(); ++l) {
      Log& log = logs_[l];
      for (int i = 0; i < n_; ++i) {
        const double* x = found_.data() + i * unknowns();
        sizes_.clear();
        for (std::size_t k = log.first; k < rows_end(l); ++k) {
          const double* row = values_.data() + k * static_cast<std::size_t>(6 + n_);
          double r = row[6 + i] - x[6 + log.offset];
          for (int c = 0; c < 6; ++c) r -= x[c] * row[c];
          const std::size_t at = k * static_cast<std::size_t>(n_) + static_cast<std::size_t>(i);
          // of a row for several samples: RMS
          r = size_[k] > 1.0 ? std::sqrt(r * r + remainder_[at] / size_[k]) : std::abs(r);
          residual_[at] = r;
          if (std::isfinite(r)) sizes_.push_back(size_[k] > 1.0 ? r / 1.48 : r);
        }
        if (sizes_.empty()) continue;
        const auto middle = sizes_.begin() + static_cast<std::ptrdiff_t>(sizes_.size() / 2);
        std::nth_element(sizes_.begin(), middle, sizes_.end());
        const double scale = std::max(1.48 * *middle, noise[i]);
        moved = std::max(moved, std::abs(std::log(scale / log.scale[i])));
        log.scale[i] = scale;
      }
      for (std::size_t k = log.first; k < rows_end(l); ++k) {
        const double* r = residual_.data() + k * static_cast<std::size_t>(n_);
        double chi2 = 0.0;
        int channels = 0;
        for (int i = 0; i < n_; ++i) {
          if (!std::isfinite(r[i])) continue;
          chi2 += std::pow(r[i] / log.scale[i], 2.0);
          ++channels;
        }
        weight_[k] = (1.0 + channels) / (1.0 + chi2);
      }
    }
    return moved;
  }
};

}  // namespace truewrench
