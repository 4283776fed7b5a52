// START of METHOD 10.3: gain and offset by a robust regression of the raw output on the wrench of a motion.
#pragma once

#include "truewrench/estimation/fit.hpp"
#include "truewrench/math/dense.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace truewrench {

// Raw on [w, 1] channel by channel, with the prior; offsets of each log, or of several.
class Regression {
 public:
  explicit Regression(Fit& fit) : fit_(fit), n_(fit.channels()), width_(8 + dense::padded(n_)) {
    const Layout& layout = fit.layout();
    for (std::size_t l = 0; l < fit.logs().size(); ++l) {
      const int offset = layout.log(l).global[static_cast<std::size_t>(layout.log(l).b)];
      if (offsets_.empty() || offsets_.back() != offset) offsets_.push_back(offset);
      Rows log;
      log.column = 5 + static_cast<int>(offsets_.size());
      log.scale.assign(fit.rig().noise.data(), fit.rig().noise.data() + n_);
      for (const Stretch& s : fit.logs()[l].stretches)
        for (Eigen::Index k = 0; k < s.raw.rows(); ++k)
          if (s.raw.masked[static_cast<std::size_t>(k)] == 0)
            log.rows.push_back({s.now.w.data() + 6 * k, s.raw.value.data() + n_ * k,
                                s.raw.size[k] > 1.0 ? s.raw.remainder.data() + n_ * k : nullptr,
                                s.raw.size[k], 1.0});
      log.residual.resize(log.rows.size() * static_cast<std::size_t>(n_));
      logs_.push_back(std::move(log));
    }
    size_ = 6 + static_cast<int>(offsets_.size());
    found_.assign(static_cast<std::size_t>(n_), Eigen::VectorXd::Zero(size_));
  }

  // At the weights and scales as they stand; false where they determine nothing.
  bool solve() {
    const double* nominal = fit_.rig().nominal.data();
    std::vector<Eigen::MatrixXd> A(found_.size(), Eigen::MatrixXd::Zero(size_, size_));
    std::vector<Eigen::VectorXd> b(found_.size(), Eigen::VectorXd::Zero(size_));
    for (int i = 0; i < n_; ++i)
      for (int k = 0; k < size_; ++k) A[static_cast<std::size_t>(i)](k, k) = 1.0 / fit_.prior[place(i, k)];
    for (const Rows& log : logs_) {
      sum(log);
      const auto at = [&log](int k) { return k < 6 ? k : log.column; };
      for (int i = 0; i < n_; ++i) {
        const auto iu = static_cast<std::size_t>(i);
        const double v = std::pow(log.scale[iu], -2.0);
        for (int k = 0; k < 7; ++k) {
          const double *all = sums_[0].data() + k * width_, *own = sums_[iu + 1].data() + k * width_;
          double y = all[8 + i] + own[8 + i];  // of raw less what it is nominally
          for (int c = 0; c < 6; ++c) y -= nominal[6 * i + c] * (all[c] + own[c]);
          b[iu][at(k)] += v * y;
          for (int c = 0; c < 7; ++c) A[iu](at(k), at(c)) += v * (all[c] + own[c]);
        }
      }
    }
    for (int i = 0; i < n_; ++i) {
      const auto iu = static_cast<std::size_t>(i);
      Eigen::MatrixXd inverse;
      double logdet = 0.0;
      if (!dense::invert(A[iu], inverse, logdet)) return false;
      found_[iu] = dense::times(inverse, b[iu]);
      for (int k = 0; k < 6; ++k) found_[iu][k] += nominal[6 * i + k];
    }
    return true;
  }

  // Scales: 1.48 median of the residuals, and at least the stated sigma. Cauchy weights: (1 + n) / (1 + chi^2_n).
  void reweigh() {
    std::vector<double> sizes;
    for (Rows& log : logs_) {
      for (int i = 0; i < n_; ++i) {
        const Eigen::VectorXd& x = found_[static_cast<std::size_t>(i)];
        sizes.clear();
        for (std::size_t k = 0; k < log.rows.size(); ++k) {
          const Row& row = log.rows[k];
          double r = row.raw[i] - x[log.column];
          for (int c = 0; c < 6; ++c) r -= x[c] * row.w[c];
          // of a row for several samples: RMS
          r = row.remainder ? std::sqrt(r * r + row.remainder[i] / row.size) : std::abs(r);
          log.residual[k * static_cast<std::size_t>(n_) + static_cast<std::size_t>(i)] = r;
          if (std::isfinite(r)) sizes.push_back(row.remainder ? r / 1.48 : r);
        }
        if (sizes.empty()) continue;
        const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
        std::nth_element(sizes.begin(), middle, sizes.end());
        log.scale[static_cast<std::size_t>(i)] = std::max(1.48 * *middle, fit_.rig().noise[i]);
      }
      for (std::size_t k = 0; k < log.rows.size(); ++k) {
        const double* r = log.residual.data() + k * static_cast<std::size_t>(n_);
        double chi2 = 0.0;
        int channels = 0;
        for (int i = 0; i < n_; ++i) {
          if (!std::isfinite(r[i])) continue;
          chi2 += std::pow(r[i] / log.scale[static_cast<std::size_t>(i)], 2.0);
          ++channels;
        }
        log.rows[k].weight = (1.0 + channels) / (1.0 + chi2);
      }
    }
  }

  // To theta; and the scales to the factors on the noise.
  void write(bool scales) const {
    for (int i = 0; i < n_; ++i)
      for (int k = 0; k < size_; ++k) fit_.theta[place(i, k)] = found_[static_cast<std::size_t>(i)][k];
    for (std::size_t l = 0; l < logs_.size() && scales; ++l) {
      Eigen::VectorXd& factor = fit_.logs()[l].sizes.raw_factor;
      factor.setZero();
      for (int i = 0; i < n_; ++i) {
        double& f = factor[raw_group(i, n_)];
        f = std::max(f, logs_[l].scale[static_cast<std::size_t>(i)] / fit_.rig().noise[i]);
      }
    }
  }

 private:
  struct Row {                          // unmasked
    const double *w, *raw, *remainder;  // the last of a row for more than a sample, else null
    double size, weight;
  };
  struct Rows {                           // of a log
    int column = 6;                       // of its offset
    std::vector<double> scale, residual;  // (n); (rows, n) sizes
    std::vector<Row> rows;
  };

  Fit& fit_;
  int n_, width_, size_ = 7;
  std::vector<int> offsets_;  // places in theta
  std::vector<Rows> logs_;
  std::vector<Eigen::VectorXd> found_;  // [C, offsets] by channel
  // [w, 1]^T [w, 1, raw] (7, width): of rows with all channels; then, channel by channel, of those that lack one
  std::vector<std::vector<double>> sums_;

  int place(int i, int k) const {  // in theta
    return k < 6 ? fit_.layout().C + 6 * i + k : offsets_[static_cast<std::size_t>(k - 6)] + i;
  }

  void sum(const Rows& log) {
    sums_.assign(static_cast<std::size_t>(n_) + 1,
                 std::vector<double>(static_cast<std::size_t>(7 * width_), 0.0));
    std::vector<double> f(static_cast<std::size_t>(width_), 0.0);
    f[6] = 1.0;
    for (const Row& row : log.rows) {
      std::copy_n(row.w, 6, f.begin());
      bool whole = true;
      for (int i = 0; i < n_; ++i) {
        const bool there = std::isfinite(row.raw[i]);
        f[static_cast<std::size_t>(8 + i)] = there ? row.raw[i] : 0.0;
        whole = whole && there;
      }
      const auto add = [&](std::size_t to) {
        for (int k = 0; k < 7; ++k)
          dense::add(sums_[to].data() + k * width_, row.size * row.weight * f[static_cast<std::size_t>(k)],
                     f.data(), width_);
      };
      if (whole) add(0);
      for (int i = 0; i < n_ && !whole; ++i)
        if (std::isfinite(row.raw[i])) add(static_cast<std::size_t>(1 + i));
    }
  }
};

// Gain and offsets of a fit by the motion as it stands: robust, in 15 rounds, with its scales; or plain (`cauchy` false).
inline void regress(Fit& fit, bool cauchy) {
  fit.predict();
  Regression regression(fit);
  for (int round = 0; round < (cauchy ? 15 : 1); ++round) {
    if (!regression.solve()) return;
    if (cauchy) regression.reweigh();
  }
  regression.write(cauchy);
}

}  // namespace truewrench
