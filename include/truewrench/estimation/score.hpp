// Scores (10.8) of constant wrenches on intervals of a record, the discrepancy in V.
#pragma once

#include "truewrench/estimation/discrepancy.hpp"
#include "truewrench/math/chi_square.hpp"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

namespace truewrench {

// Neighbouring blocks of knots of one log, as a source of scores. Together they last about as long as one block at the coarsest
// h, since the scan's time grows with the cube of their number. Row by row, a row padded(n) long.
struct ScoredBlock {
  double begin = 0.0;              // [s]
  Eigen::VectorXd z, information;  // (n) D^T V^-1 r, diag D^T V^-1 D
  int samples = 0;
  std::vector<double> b;  // (nt, n) J_theta^T V^-1 D with the motion eliminated, by the root of P
  std::vector<std::pair<std::size_t, std::vector<double>>>
      y;  // (W, n) by block from here on: R^-T J_x^T V^-1 D, as far as it is felt
};

// J_x^T V^-1 D (rows of two blocks) and J_theta^T V^-1 D of a constant wrench D on one block, `columns` a row.
inline void constant_wrench(const Stretch& s, const Sweep& sweep, const Columns& columns, bool d, int g,
                            int width, double* J, double* T, ScoredBlock& out) {
  const RowSums& of = sweep.sums();
  const int n = s.channels(), M = s.components(), OM = of.orders * M;
  for (int o = 0; o < kBlock; ++o) {
    const auto [first, end] = sweep.of_interval(kBlock * g + o);
    for (std::size_t at = first; at < end; ++at) {
      const RawSums& sums = sweep.pool()[at];
      out.samples += sums.samples;
      for (int i = 0; i < n; ++i) {
        const double v = sums.v[static_cast<std::size_t>(i)], *phi = sums.phi.data(), *X = phi + of.nf + n;
        out.z[i] += sums.z[static_cast<std::size_t>(i)];
        out.information[i] += sums.weight * v;
        for (int x = 0; x < of.nf; ++x)
          T[of.feature[static_cast<std::size_t>(i * of.nf + x)] * width + i] += v * phi[x];
        T[(columns.u + i) * width + i] += v * phi[of.nf + i];
        for (int c = 0; c < 6; ++c)
          for (int y = 0; y < of.nd; ++y)
            T[of.dense_columns[static_cast<std::size_t>(y)] * width + i] +=
                sums.SV[static_cast<std::size_t>(c * n + i)] * X[c * of.nd + y];
        for (int k = 0; k < kLocal; ++k) {
          for (int p = 0; p < of.orders; ++p)
            for (int j = 0; j < M; ++j)
              J[sweep.place(o + k, j) * width + i] += v *
                                                      sums.basis[static_cast<std::size_t>(kLocal * p + k)] *
                                                      sums.J[static_cast<std::size_t>(i * OM + p * M + j)];
          if (d) J[sweep.place_d(o + k, i) * width + i] += v * sums.basis[static_cast<std::size_t>(k)];
        }
      }
    }
  }
}

inline int scored_together(const Stretch& s) {
  return std::max(1, static_cast<int>(std::lround(constants::knot_spacing / s.spline.h())));
}

// [s]
inline double scored_length(const Stretch& s) { return kBlock * s.spline.h() * scored_together(s); }

// What a constant wrench on each of them alone does, from the factorisation that stands.
inline std::vector<ScoredBlock> scored_blocks(const Fit& fit, std::size_t l) {
  const LogFit& log = fit.logs()[l];
  const int n = fit.channels(), width = dense::padded(n);
  const Columns& columns = fit.layout().log(l);
  const std::vector<double> root = dense::root(Fit::gather(fit.P(), columns.global));
  std::vector<ScoredBlock> out;
  std::size_t before = 0;  // blocks of the stretches before
  for (std::size_t s_ = 0; s_ < log.stretches.size(); ++s_) {
    const Stretch& s = log.stretches[s_];
    const Sweep& sweep = log.sweeps[s_];
    const int W = sweep.width(), nt = sweep.parameters(), ldr = dense::padded(nt);
    std::vector<double> J, T;
    const int together = scored_together(s);
    for (int g = 0; g + 1 < sweep.blocks(); g += together) {
      const int end = std::min(g + together, sweep.blocks() - 1);
      ScoredBlock block;
      block.begin = s.spline.begin() + kBlock * s.spline.h() * static_cast<double>(g);
      block.z = block.information = Eigen::VectorXd::Zero(n);
      J.assign(static_cast<std::size_t>(2 * W * width + 8), 0.0);
      T.assign(static_cast<std::size_t>(nt * width + 8), 0.0);
      double largest = 0.0;
      for (int at = g; at < sweep.blocks(); ++at) {
        if (at < end)
          constant_wrench(s, sweep, columns, log.sizes.form != Form::none, at, width, J.data(), T.data(),
                          block);
        double *here = J.data(), *next = here + W * width;
        sweep.descend(at, here, at + 1 < sweep.blocks() ? next : nullptr, T.data(), width);
        double most = 0.0;
        for (int x = 0; x < W * width; ++x) most = std::max(most, std::abs(here[x]));
        largest = std::max(largest, most);
        block.y.emplace_back(before + static_cast<std::size_t>(at), std::vector<double>(here, next));
        if (at >= end && most < 1e-5 * largest) break;
        std::copy_n(next, W * width, here);
        std::fill_n(next, W * width, 0.0);
      }
      block.b.assign(static_cast<std::size_t>(nt * width), 0.0);
      for (int k = 0; k < nt; ++k)
        for (int x = 0; x <= k; ++x)
          dense::add(block.b.data() + x * width, root[static_cast<std::size_t>(k * ldr + x)],
                     T.data() + k * width, width);
      out.push_back(std::move(block));
    }
    before += static_cast<std::size_t>(sweep.blocks());
  }
  return out;
}

// Information and score of the blocks of an interval, as they are added.
struct IntervalSums {
  IntervalSums(int channels, int width_, std::size_t rows)
      : n(channels), width(width_), R(static_cast<std::size_t>(n * width)), b(rows), I(R.size()) {
    clear();
  }

  void clear() {
    std::fill(R.begin(), R.end(), 0.0);
    std::fill(b.begin(), b.end(), 0.0);
    z = information = Eigen::VectorXd::Zero(n);
    samples = 0;
  }

  void add(const ScoredBlock& block) {
    dense::add(b.data(), 1.0, block.b.data(), static_cast<int>(b.size()));
    z += block.z;
    information += block.information;
    samples += block.samples;
  }

  // I = diag information - R - b^T b, (n, n) a row padded(n) long.
  const std::vector<double>& finish() {
    for (std::size_t x = 0; x < I.size(); ++x) I[x] = -R[x];
    dense::subtract(I.data(), width, b.data(), 1, width, b.data(), width, n, width,
                    static_cast<int>(b.size()) / width);
    for (int i = 0; i < n; ++i) I[static_cast<std::size_t>(i * width + i)] += information[i];
    return I;
  }

  int n, width, samples = 0;
  std::vector<double> R, b;  // (n, n) sum of y^T y over all pairs of blocks; (nt, n) sum of theirs
  Eigen::VectorXd z, information;

 private:
  std::vector<double> I;
};

// y_a^T y_b of every block with itself and, symmetric, with the next ones: (n, n).
inline std::vector<std::vector<std::vector<double>>> crossed(const std::vector<ScoredBlock>& blocks, int n,
                                                             int width) {
  std::vector<std::vector<std::vector<double>>> out(blocks.size());
  std::vector<double> sum(static_cast<std::size_t>(n * width));
  for (std::size_t a = 0; a < blocks.size(); ++a) {
    const auto& x = blocks[a].y;
    for (std::size_t b = a; b < blocks.size() && blocks[b].y.front().first <= x.back().first; ++b) {
      const auto& y = blocks[b].y;
      std::fill(sum.begin(), sum.end(), 0.0);
      for (std::size_t i = 0, j = 0; i < x.size() && j < y.size();) {
        if (x[i].first != y[j].first) {
          (x[i].first < y[j].first ? i : j) += 1;
          continue;
        }
        const std::vector<double>&left = x[i].second, &right = y[j].second;
        ++i;
        ++j;
        dense::subtract(sum.data(), width, left.data(), 1, width, right.data(), width, n, width,
                        static_cast<int>(left.size()) / width);
      }
      std::vector<double> both(sum.size(), 0.0);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
          both[static_cast<std::size_t>(i * width + j)] =
              -sum[static_cast<std::size_t>(i * width + j)] -
              (a == b ? 0.0 : sum[static_cast<std::size_t>(j * width + i)]);
      out[a].push_back(std::move(both));
    }
  }
  return out;
}

// The begin [s] of the best suffix of a log where the scan of z^T I^-1 z of intervals of blocks up to 30 s long and of all
// suffixes, and the suffixes alone, find p times their number below `doubt` (10.8).
inline std::optional<double> best_step(Fit& fit, std::size_t l) {
  if (!fit.stands()) return std::nullopt;
  const std::vector<ScoredBlock> blocks = scored_blocks(fit, l);
  const int n = fit.channels(), width = dense::padded(n);
  const std::size_t G = blocks.size();
  if (G < 2) return std::nullopt;
  const auto with = crossed(blocks, n, width);
  const double length = scored_length(fit.logs()[l].stretches.front());
  const auto longest = static_cast<std::size_t>(std::max(1.0, std::round(constants::scan_longest / length)));
  IntervalSums sums(n, width, blocks.front().b.size());
  std::vector<std::vector<double>> suffixes(G + 1, std::vector<double>(sums.R.size(), 0.0));
  std::vector<Eigen::VectorXd> suffix_z(G + 1, Eigen::VectorXd::Zero(n));
  std::vector<int> suffix_samples(G + 1, 0);
  for (std::size_t i = G; i-- > 0;) {
    for (const auto& c : with[i]) dense::add(sums.R.data(), 1.0, c.data(), n * width);
    sums.add(blocks[i]);
    suffixes[i] = sums.finish();
    suffix_z[i] = sums.z;
    suffix_samples[i] = sums.samples;
  }
  Eigen::VectorXd v(n);
  for (int i = 0; i < n; ++i) v[i] = std::pow(fit.sigma(l, i), -2.0);
  double best = 0.0, count = 0.0, begin = 0.0;
  std::vector<double> I(sums.R.size());
  const auto score = [&](const Eigen::VectorXd& z, const std::vector<double>& of, std::size_t i,
                         std::size_t j) {
    const std::vector<double>&a = suffixes[i], &b = suffixes[j];
    for (std::size_t x = 0; x < I.size(); ++x) I[x] = of[x] + 1e-5 * (a[x] + b[x]);
    // an interval that tells nothing: I = 0
    for (int c = 0; c < n; ++c) I[static_cast<std::size_t>(c * width + c)] += 1e-3 * v[c];
    return dense::quadratic_inverse(I.data(), width, z);
  };
  for (std::size_t i = 1; i < G; ++i) {
    if (suffix_samples[i] < 3) break;
    const double x = score(suffix_z[i], suffixes[i], i, G);
    count += 1.0;
    if (x <= best) continue;
    best = x;
    begin = blocks[i].begin;
  }
  const auto doubted = [&] {
    return chi_square_log_tail(best, n) + std::log(std::max(count, 1.0)) <= std::log(constants::doubt);
  };
  if (!doubted()) return std::nullopt;
  for (std::size_t i = 0; i < G; ++i) {
    sums.clear();
    for (std::size_t j = i; j < std::min(G - 1, i + longest); ++j) {  // [i, j + 1)
      for (std::size_t back = 0; back <= j - i && back < with[j - back].size(); ++back)
        dense::add(sums.R.data(), 1.0, with[j - back][back].data(), n * width);
      sums.add(blocks[j]);
      if (sums.samples < 3) continue;
      count += 1.0;
      best = std::max(best, score(sums.z, sums.finish(), i, j + 1));
    }
  }
  return doubted() ? std::optional(begin) : std::nullopt;
}

// Where within `reach` [s] of a step of a robust fit (10.3) its sum over the samples is least, were the step there and as large:
// blocks place it to 0.25 s only, in which 0.3 % of range outweigh all else.
inline double likeliest_time(const Fit& fit, std::size_t l, std::size_t j, double reach) {
  const Columns& columns = fit.layout().log(l);
  const int n = fit.channels();
  const double placed = columns.step_times[j];
  const Eigen::VectorXd size = fit.local(l).segment(columns.steps[j], n);
  Eigen::VectorXd v(n);
  for (int i = 0; i < n; ++i) v[i] = std::pow(fit.sigma(l, i), 2.0);
  struct Sample {
    double time, gain;  // of the robust sum, where the step comes after it and not before
  };
  std::vector<Sample> near;
  for (const Stretch& s : fit.logs()[l].stretches)
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
      const double t = s.raw.time[k];
      if (std::abs(t - placed) > reach || s.raw.channels[k] == 0) continue;
      double before = 0.0, after = 0.0;
      for (int i = 0; i < n; ++i) {
        if (!std::isfinite(s.raw.value(k, i))) continue;
        const double r = s.now.residual(k, i) + (t >= placed ? size[i] : 0.0), spread = s.raw.spread(k, i);
        before += (r * r + spread) / v[i];
        after += ((r - size[i]) * (r - size[i]) + spread) / v[i];
      }
      const int channels = s.raw.channels[k];
      near.push_back({t, s.raw.size[k] * (robust_sum(channels, before) - robust_sum(channels, after))});
    }
  double best = 0.0, sum = 0.0, found = placed;
  for (const Sample& sample : near) {
    best += sample.time < placed ? 0.0 : sample.gain;
    sum += sample.gain;
  }
  for (const Sample& sample : near) {
    if (sum > best) {
      best = sum;
      found = sample.time;
    }
    sum -= sample.gain;
  }
  return found;
}

}  // namespace truewrench
