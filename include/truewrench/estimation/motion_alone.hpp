// START of METHOD 10.3: the motion from its own measurements alone: coefficients, q and the factors of the motion's noise, clocks
// and biases at their means.
#pragma once

#include "truewrench/estimation/sizes.hpp"
#include "truewrench/math/banded.hpp"
#include "truewrench/math/dense.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace truewrench {

class MotionAlone {
 public:
  using Values = std::array<double, max_components>;

  // The normal equations of one stretch.
  struct Part {
    Spline spline;
    Bands R;                        // of (10.1)
    std::vector<double> x;          // (N + 5, lanes) coefficients
    std::vector<Bands> A;           // of each stream: sum B B^T / stated^2
    std::vector<Values> samples;    // how many rows stand for
    std::vector<Values> remainder;  // squares within them, over stated^2

    const double* coefficients(Eigen::Index knot) const { return x.data() + knot * R.lanes; }

   private:
    friend class MotionAlone;
    Bands H, inverse;
    std::vector<std::vector<double>> b;  // of each stream: sum B^T y / stated^2
    // The first value of each component, about which x is until the end: where a component rests, R / q is up to 1e12 times what the
    // rows tell of the slowest, and rounding goes with x.
    Values origin{};
    std::array<bool, max_components> begun{};
    std::vector<double> first;  // x of the first solution; about it, where squares lose no digits:
    std::vector<std::vector<double>> apart;  // sum B^T (y - B first) / stated^2
    std::vector<Values> squares;             // and (y - B first)^2 / stated^2
  };
  std::vector<Part> parts;

  // Memory of one stretch of so many coefficients, so that nothing is allocated later.
  void reserve(Eigen::Index coefficients, int components, std::size_t streams) {
    parts.resize(1);
    set(parts[0], coefficients, components, streams);
    for (auto* v : {&count_, &rss_, &used_, &factor_}) v->resize(streams);
  }

  // rows(k, i, visit): calls visit(interval, basis, size, value) for every row of stream i in stretch k; size (M): samples that it
  // stands for, 0 where a component is missing; value (M). Samples and remainders are the caller's to state. The noise is held until
  // q moves by less than a tenth, and for 8 steps at most, else q may end in a wrong optimum. Returns -2 log L (10.7) of the motion.
  template <typename Rows>
  double fit(const RecordedLog& log, double h, Sizes& z, const Rows& rows) {
    constexpr int longest_held = 8, most = 80;
    const int M = log.components();
    const std::size_t streams = log.motion.size();
    for (auto* v : {&count_, &rss_, &used_, &factor_}) {
      v->resize(streams);
      for (Values& of : *v) of.fill(0.0);
    }
    double standing = 0.0;  // what of (10.7) no size changes
    for (std::size_t k = 0; k < parts.size(); ++k) standing += sum(parts[k], k, log, rows);
    z.q.setConstant(constants::smoothness_start);
    for (auto& f : z.motion_factor) f.setOnes();
    bool held = true;
    for (int iteration = 0; iteration < most; ++iteration) {
      for (auto* v : {&rss_, &used_})
        for (Values& of : *v) of.fill(0.0);
      Values energy{}, trace{}, size{};
      for (std::size_t k = 0; k < parts.size(); ++k) {
        Part& part = parts[k];
        if (!solve(part, log, z)) return std::nan("");
        if (iteration == 0) look_from_here(part, k, log, rows);
        part.H.inverse(part.inverse);
        part.R.inner(part.inverse, trace.data());
        for (int j = 0; j < M; ++j) {
          const int p = smoothness_order(log.source, j);
          energy[at(j)] += part.spline.smoothness(p).quadratic(part.x.data() + j, part.R.size, part.R.lanes);
          size[at(j)] += static_cast<double>(part.R.size - p);
        }
        for (std::size_t i = 0; i < streams; ++i) add_squares(part, i, log.motion[i], z);
      }
      // the sizes that follow, and (10.7) at those that stand
      double move = 0.0;
      for (std::size_t i = 0; i < streams; ++i)
        for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r) {
          const auto ru = static_cast<std::size_t>(r);
          const double now = z.motion_factor[i][r], left = count_[i][ru] - used_[i][ru];
          factor_[i][ru] = now;
          if (held || left < constants::fewest_freedom) continue;
          factor_[i][ru] = std::sqrt(std::max(rss_[i][ru], 1e-12) / std::max(left, 1e-3 * count_[i][ru]));
          move = std::max(move, 2.0 * std::abs(std::log(factor_[i][ru] / now)));
        }
      Values q{};
      for (int j = 0; j < M; ++j) {
        const double left = size[at(j)] - trace[at(j)] / z.q[j];
        q[at(j)] = smoothness_found(log, j, h, energy[at(j)], left);
        move = std::max(move, smoothness_move(q[at(j)] / z.q[j], z.q[j], energy[at(j)], left));
      }
      const bool last = (!held && move < constants::move) || iteration + 1 == most;
      held = held && move >= 0.1 && iteration + 1 < longest_held;
      const double deviance = last ? standing + changing(log, z, energy, size) : 0.0;
      for (std::size_t i = 0; i < streams; ++i)
        std::copy_n(factor_[i].begin(), z.motion_factor[i].size(), z.motion_factor[i].data());
      for (int j = 0; j < M; ++j) z.q[j] *= std::clamp(q[at(j)] / z.q[j], 1e-3, 1e3);
      if (!last) continue;
      for (Part& part : parts) from_origin(part, M);
      return deviance;
    }
    return std::nan("");
  }

  // The coefficients alone, at sizes that are known; rows as of fit(). False where the rows determine none.
  template <typename Rows>
  bool smooth(const RecordedLog& log, const Sizes& z, const Rows& rows) {
    count_.resize(log.motion.size());
    for (std::size_t k = 0; k < parts.size(); ++k) {
      sum(parts[k], k, log, rows);
      if (!solve(parts[k], log, z)) return false;
      from_origin(parts[k], log.components());
    }
    return true;
  }

  // Makes room for a stretch, and R.
  void begin(Part& part, const Spline& spline, const RecordedLog& log) const {
    part.spline = spline;
    set(part, spline.size(), log.components(), log.motion.size());
    for (int j = 0; j < log.components(); ++j) {
      const Gram local = spline.smoothness(smoothness_order(log.source, j)).inside;
      for (Eigen::Index i = 0; i < spline.intervals(); ++i)
        for (int k = 0; k < kLocal; ++k)
          for (int l = 0; l <= k; ++l) part.R.at(i + l, k - l)[j] += local(k, l);
    }
  }

 private:
  std::vector<Values> count_, rss_, used_, factor_;  // of each stream's groups

  static std::size_t at(int j) { return static_cast<std::size_t>(j); }
  static double sum_of(const Basis& basis) {
    double out = 0.0;
    for (int l = 0; l < kLocal; ++l) out += basis[l];
    return out;
  }

  static void set(Part& part, Eigen::Index coefficients, int components, std::size_t streams) {
    for (Bands* m : {&part.R, &part.H, &part.inverse}) m->resize(coefficients, components);
    const auto values = static_cast<std::size_t>((coefficients + kDegree5) * part.R.lanes);
    for (auto* v : {&part.x, &part.first}) v->assign(values, 0.0);
    part.A.resize(streams);
    for (Bands& m : part.A) m.resize(coefficients, components);
    for (auto* v : {&part.b, &part.apart}) {
      v->resize(streams);
      for (auto& b : *v) b.assign(values, 0.0);
    }
    for (auto* v : {&part.samples, &part.remainder, &part.squares}) {
      v->resize(streams);
      for (Values& of : *v) of.fill(0.0);
    }
  }

  template <typename Rows>
  double sum(Part& part, std::size_t k, const RecordedLog& log, const Rows& rows) {
    const int M = log.components(), lanes = part.R.lanes;
    double standing = 0.0;
    part.begun.fill(false);
    part.origin.fill(0.0);
    for (int j = 0; j < M; ++j) standing -= part.spline.smoothness_logdet(smoothness_order(log.source, j));
    for (std::size_t i = 0; i < log.motion.size(); ++i) {
      const MotionStream& stream = log.motion[i];
      Values information{};
      for (int j = 0; j < M; ++j) information[at(j)] = 1.0 / (stream.sigma[j] * stream.sigma[j]);
      rows(k, i, [&](Eigen::Index interval, const Basis& basis, const double* size, const double* value) {
        const double whole = sum_of(basis);  // 1, or 0 of a derivative
        Values v{}, y{};
        for (int j = 0; j < M; ++j) {
          if (!part.begun[at(j)] && size[j] > 0.0 && whole > 0.5) {
            part.origin[at(j)] = value[j];
            part.begun[at(j)] = true;
          }
          v[at(j)] = size[j] * information[at(j)];
          y[at(j)] = v[at(j)] * (value[j] - whole * part.origin[at(j)]);
        }
        for (int l = 0; l < kLocal; ++l) {
          dense::add_some(part.b[i].data() + (interval + l) * lanes, basis[l], y.data(), M);
          for (int g = l; g < kLocal; ++g)
            dense::add_some(part.A[i].at(interval + l, g - l), basis[l] * basis[g], v.data(), M);
        }
      });
      for (int j = 0; j < M; ++j) {
        count_[i][at(stream.group[j])] += part.samples[i][at(j)];
        standing += 2.0 * part.samples[i][at(j)] * std::log(stream.sigma[j]);
      }
    }
    return standing;
  }

  static void from_origin(Part& part, int components) {
    for (Eigen::Index k = 0; k < part.R.size; ++k)
      dense::add(part.x.data() + k * part.R.lanes, 1.0, part.origin.data(), components);
  }

  // x of H = R / q + sum A / factor^2, H factored.
  static bool solve(Part& part, const RecordedLog& log, const Sizes& z) {
    const int M = log.components(), lanes = part.R.lanes;
    Bands& H = part.H;
    Values weight{}, largest{};
    for (int j = 0; j < M; ++j) weight[at(j)] = 1.0 / z.q[j];
    const auto add = [&](std::vector<double>& to, const std::vector<double>& from) {
      for (std::size_t e = 0; e < to.size(); e += static_cast<std::size_t>(lanes))
        for (std::size_t j = 0; j < static_cast<std::size_t>(lanes); ++j)
          to[e + j] += weight[j] * from[e + j];
    };
    std::fill(H.a.begin(), H.a.end(), 0.0);
    std::fill(part.x.begin(), part.x.end(), 0.0);
    add(H.a, part.R.a);
    for (std::size_t i = 0; i < log.motion.size(); ++i) {
      for (int j = 0; j < M; ++j) weight[at(j)] = std::pow(z.motion_factor[i][log.motion[i].group[j]], -2.0);
      add(H.a, part.A[i].a);
      add(part.x, part.b[i]);
    }
    for (Eigen::Index k = 0; k < H.size; ++k)
      for (int j = 0; j < lanes; ++j) {
        if (j >= M) H.at(k, 0)[j] = 1.0;
        largest[at(j)] = std::max(largest[at(j)], H.at(k, 0)[j]);
      }
    for (Eigen::Index k = 0; k < H.size; ++k)  // where no sample lies for a few knots
      for (int j = 0; j < lanes; ++j) H.at(k, 0)[j] += 1e-14 * largest[at(j)];
    if (!H.factor()) return false;
    H.solve(part.x);
    return true;
  }

  template <typename Rows>
  static void look_from_here(Part& part, std::size_t k, const RecordedLog& log, const Rows& rows) {
    const int M = log.components(), lanes = part.R.lanes;
    part.first = part.x;
    for (std::size_t i = 0; i < log.motion.size(); ++i) {
      const Eigen::VectorXd& sigma = log.motion[i].sigma;
      rows(k, i, [&](Eigen::Index interval, const Basis& basis, const double* size, const double* value) {
        const double whole = sum_of(basis);
        Values e{}, y{};
        for (int j = 0; j < M; ++j) e[at(j)] = value[j] - whole * part.origin[at(j)];
        for (int l = 0; l < kLocal; ++l)
          dense::add_some(e.data(), -basis[l], part.first.data() + (interval + l) * lanes, M);
        for (int j = 0; j < M; ++j) {
          y[at(j)] = size[j] / (sigma[j] * sigma[j]) * e[at(j)];
          part.squares[i][at(j)] += y[at(j)] * e[at(j)];
        }
        for (int l = 0; l < kLocal; ++l)
          dense::add_some(part.apart[i].data() + (interval + l) * lanes, basis[l], y.data(), M);
      });
    }
  }

  // Squares about x, in stated sigma, and what H^-1 takes of their freedom.
  void add_squares(const Part& part, std::size_t i, const MotionStream& stream, const Sizes& z) {
    const int M = static_cast<int>(stream.sigma.size());
    Values inner{}, left = part.squares[i];
    part.A[i].inner(part.inverse, inner.data());
    part.A[i].quadratic(part.x, part.first, part.apart[i], left.data());
    for (int j = 0; j < M; ++j) {
      const int group = stream.group[j];
      rss_[i][at(group)] += left[at(j)] + part.remainder[i][at(j)];
      used_[i][at(group)] += inner[at(j)] / (z.motion_factor[i][group] * z.motion_factor[i][group]);
    }
  }

  // (10.7), less what stands.
  double changing(const RecordedLog& log, const Sizes& z, const Values& energy, const Values& size) const {
    double out = 0.0;
    for (int j = 0; j < log.components(); ++j) {
      for (const Part& part : parts)
        for (Eigen::Index k = 0; k < part.R.size; ++k) out -= 2.0 * std::log(part.H.at(k, 0)[j]);
      out += energy[at(j)] / z.q[j] + size[at(j)] * std::log(z.q[j]);
    }
    for (std::size_t i = 0; i < log.motion.size(); ++i)
      for (Eigen::Index r = 0; r < z.motion_factor[i].size(); ++r) {
        const auto ru = static_cast<std::size_t>(r);
        const double f = z.motion_factor[i][r];
        out += rss_[i][ru] / (f * f) + 2.0 * count_[i][ru] * std::log(f);
      }
    return out;
  }
};

}  // namespace truewrench
