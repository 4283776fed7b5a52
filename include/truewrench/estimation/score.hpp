// Scores (10.8) of constant wrenches on intervals of a record, the discrepancy in V; and whether the parts of a record agree
// (10.11).
#pragma once

#include "truewrench/estimation/discrepancy.hpp"
#include "truewrench/math/chi_square.hpp"

#include <optional>

namespace truewrench {

// A block of knots of one log, as a source of scores.
struct ScoredBlock {
  double begin = 0.0;                              // [s]
  Eigen::VectorXd z, information;                  // (n) D^T V^-1 r, diag D^T V^-1 D
  int samples = 0;
  Eigen::MatrixXd b;                               // (nt, n) D^T V^-1 J_theta with the motion eliminated, by the root of P
  std::vector<std::pair<std::size_t, Eigen::MatrixXd>> y;  // by block from here on: L^-1 J_x^T V^-1 D, as far as it is felt
};

// What a constant wrench on each block alone does, from the factorisation that stands.
inline std::vector<ScoredBlock> scored_blocks(const Fit& fit, std::size_t l) {
  const LogFit& log = fit.logs()[l];
  const int n = fit.channels();
  const Columns& columns = fit.layout().log(l);
  Eigen::MatrixXd root = Fit::gather(fit.P(), columns.global);
  root.diagonal().array() += 1e-300;
  root = Eigen::MatrixXd(root.llt().matrixL());
  std::vector<ScoredBlock> out;
  std::size_t before = 0;  // blocks of the stretches before
  for (std::size_t s_ = 0; s_ < log.stretches.size(); ++s_) {
    const Stretch& s = log.stretches[s_];
    const Sweep& sweep = log.sweeps[s_];
    const int W = sweep.width(), M = s.components(), nt = sweep.parameters();
    const bool d = log.sizes.form != Form::none;
    for (Eigen::Index g = 0; g < s.spline.blocks(); ++g) {
      ScoredBlock block;
      block.begin = s.spline.begin() + kBlock * s.spline.h() * static_cast<double>(g);
      block.z = block.information = Eigen::VectorXd::Zero(n);
      Eigen::MatrixXd J = Eigen::MatrixXd::Zero(2 * W, n), T = Eigen::MatrixXd::Zero(nt, n);
      for (int o = 0; o < kBlock; ++o)
        for (const auto& sums : sweep.raw_sums()[static_cast<std::size_t>(kBlock * g + o)]) {
          block.z += sums.z;
          block.information += sums.weight * sums.v;
          block.samples += sums.samples;
          T += sums.T;
          for (int k = 0; k < kLocal; ++k) {
            for (Eigen::Index p = 0; p < sums.basis.cols(); ++p)
              J.middleRows(sweep.place(o + k, 0), M) +=
                  sums.basis(k, p) * sums.J.middleCols(p * M, M).transpose() * sums.v.asDiagonal();
            if (d)
              for (int i = 0; i < n; ++i) J(sweep.place_d(o + k, i), i) += sums.basis(k, 0) * sums.v[i];
          }
        }
      Eigen::MatrixXd rest = J.topRows(W), after = J.bottomRows(W);
      double largest = 0.0;
      for (std::size_t at = static_cast<std::size_t>(g); at < sweep.blocks().size(); ++at) {
        const auto& factor = sweep.blocks()[at];
        factor.L.triangularView<Eigen::Lower>().solveInPlace(rest);
        largest = std::max(largest, rest.cwiseAbs().maxCoeff());
        T.noalias() -= factor.Y.leftCols(nt).transpose() * rest;
        block.y.emplace_back(before + at, rest);
        if (at + 1 == sweep.blocks().size()) break;
        if (at > static_cast<std::size_t>(g) && rest.cwiseAbs().maxCoeff() < 1e-7 * largest) break;
        rest = -factor.B * rest;
        if (at == static_cast<std::size_t>(g)) rest += after;
      }
      block.b = root.transpose() * T;
      out.push_back(std::move(block));
    }
    before += static_cast<std::size_t>(s.spline.blocks() + 1);
  }
  return out;
}

struct Scan {
  double log_p = 0.0;         // of the most striking interval, times their number
  double log_p_suffix = 0.0;  // and of the most striking suffix, times theirs
  double begin = 0.0;         // [s] of that suffix
};

// z^T I^-1 z of intervals of blocks up to 30 s long, and of all suffixes.
inline Scan scan(const Fit& fit, std::size_t l) {
  const std::vector<ScoredBlock> blocks = scored_blocks(fit, l);
  const int n = fit.channels();
  const auto G = static_cast<int>(blocks.size());
  Scan out;
  if (G < 2) return out;
  const auto cross = [&](int a, int b) {  // y_a^T y_b, a <= b
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(n, n);
    std::size_t i = 0, j = 0;
    const auto &x = blocks[static_cast<std::size_t>(a)].y, &y = blocks[static_cast<std::size_t>(b)].y;
    while (i < x.size() && j < y.size()) {
      if (x[i].first < y[j].first) ++i;
      else if (y[j].first < x[i].first) ++j;
      else sum.noalias() += x[i++].second.transpose() * y[j++].second;
    }
    return sum;
  };
  // of each block: itself, and its symmetric products with the next ones
  std::vector<std::vector<Eigen::MatrixXd>> with(static_cast<std::size_t>(G));
  for (int a = 0; a < G; ++a) {
    const std::size_t last = blocks[static_cast<std::size_t>(a)].y.back().first;
    for (int b = a; b < G && blocks[static_cast<std::size_t>(b)].y.front().first <= last; ++b) {
      const Eigen::MatrixXd c = cross(a, b);
      with[static_cast<std::size_t>(a)].push_back(a == b ? c : Eigen::MatrixXd(c + c.transpose()));
    }
  }
  const double length = kBlock * fit.logs()[l].stretches.front().spline.h();
  const int longest = std::max(1, static_cast<int>(std::lround(constants::scan_longest / length)));
  const auto nt = blocks.front().b.rows();
  const auto suffix_info = [&](const Eigen::VectorXd& information, const Eigen::MatrixXd& R, const Eigen::MatrixXd& b) {
    return Eigen::MatrixXd(Eigen::MatrixXd(information.asDiagonal()) - R - b.transpose() * b);
  };
  std::vector<Eigen::MatrixXd> suffixes(static_cast<std::size_t>(G + 1), Eigen::MatrixXd::Zero(n, n));
  std::vector<Eigen::VectorXd> suffix_z(suffixes.size(), Eigen::VectorXd::Zero(n));
  std::vector<int> suffix_samples(suffixes.size(), 0);
  {
    Eigen::MatrixXd R = Eigen::MatrixXd::Zero(n, n), b = Eigen::MatrixXd::Zero(nt, n);
    Eigen::VectorXd information = Eigen::VectorXd::Zero(n);
    for (int i = G - 1; i >= 0; --i) {
      const auto iu = static_cast<std::size_t>(i);
      for (const Eigen::MatrixXd& c : with[iu]) R += c;
      b += blocks[iu].b;
      information += blocks[iu].information;
      suffixes[iu] = suffix_info(information, R, b);
      suffix_z[iu] = suffix_z[iu + 1] + blocks[iu].z;
      suffix_samples[iu] = suffix_samples[iu + 1] + blocks[iu].samples;
    }
  }
  Eigen::VectorXd v(n);
  for (int i = 0; i < n; ++i) v[i] = std::pow(fit.sigma(l, i), -2.0);
  double best = 0.0, best_suffix = 0.0;
  double count = 0.0, count_suffix = 0.0;
  const auto score = [&](const Eigen::VectorXd& z, Eigen::MatrixXd I, int i, int j) {
    I.diagonal() += 1e-3 * v;  // an interval that tells nothing: I = 0
    I += 1e-5 * (suffixes[static_cast<std::size_t>(i)] + suffixes[static_cast<std::size_t>(j)]);
    return z.dot(I.ldlt().solve(z));
  };
  for (int i = 1; i < G; ++i) {
    if (suffix_samples[static_cast<std::size_t>(i)] < 3) break;
    const double x = score(suffix_z[static_cast<std::size_t>(i)], suffixes[static_cast<std::size_t>(i)], i, G);
    count_suffix += 1.0;
    if (x <= best_suffix) continue;
    best_suffix = x;
    out.begin = blocks[static_cast<std::size_t>(i)].begin;
  }
  for (int i = 0; i < G; ++i) {
    Eigen::MatrixXd R = Eigen::MatrixXd::Zero(n, n), b = Eigen::MatrixXd::Zero(nt, n);
    Eigen::VectorXd z = Eigen::VectorXd::Zero(n), information = z;
    int samples = 0;
    for (int j = i; j < std::min(G - 1, i + longest); ++j) {  // [i, j + 1)
      const ScoredBlock& block = blocks[static_cast<std::size_t>(j)];
      for (int a = j; a >= i; --a) {
        const auto& c = with[static_cast<std::size_t>(a)];
        if (static_cast<std::size_t>(j - a) >= c.size()) break;
        R += c[static_cast<std::size_t>(j - a)];
      }
      b += block.b;
      z += block.z;
      information += block.information;
      samples += block.samples;
      if (samples < 3) continue;
      count += 1.0;
      best = std::max(best, score(z, suffix_info(information, R, b), i, j + 1));
    }
  }
  best = std::max(best, best_suffix);
  count += count_suffix;
  out.log_p = chi_square_log_tail(best, n) + std::log(std::max(count, 1.0));
  out.log_p_suffix = chi_square_log_tail(best_suffix, n) + std::log(std::max(count_suffix, 1.0));
  return out;
}

// The begin [s] of the best suffix of a log where the scan, and the suffixes alone, find p * intervals < level.
inline std::optional<double> best_step(Fit& fit, std::size_t l) {
  if (!fit.linearise() || !fit.solve()) return std::nullopt;
  const Scan found = scan(fit, l);
  if (std::max(found.log_p, found.log_p_suffix) > std::log(constants::scan_level)) return std::nullopt;
  return found.begin;
}

// One comparison of two parts of the record (10.11).
struct Agreement {
  double p = 1.0;
  double chi2 = 0.0;
  int freedom = 0;
};

// p of (10.11) for the samples of the sensor that `part` names against the others, all motion rows kept, at the last
// linearisation and sizes; `found`: (10.9), empty where d is in the fit.
inline Agreement agreement(Fit& fit, const std::vector<std::vector<Moment>>& found, const Keep& part) {
  std::vector<std::vector<Eigen::VectorXd>> weight;
  for (const LogFit& log : fit.logs()) {
    weight.emplace_back();
    for (const Stretch& s : log.stretches) weight.back().push_back(s.raw.weight);
  }
  const int n = fit.channels();
  const std::vector<int> use = fit.active_places();
  std::vector<Eigen::VectorXd> mean;
  std::vector<Eigen::MatrixXd> P, added;
  Agreement out;
  bool solved = true;
  for (const bool first : {true, false}) {
    const Keep keep = [&](std::size_t l, std::size_t s, Eigen::Index k) { return part(l, s, k) == first; };
    for (std::size_t l = 0; l < fit.logs().size(); ++l)
      for (std::size_t s = 0; s < fit.logs()[l].stretches.size(); ++s)
        for (Eigen::Index k = 0; k < weight[l][s].size(); ++k)
          fit.logs()[l].stretches[s].raw.weight[k] = keep(l, s, k) ? weight[l][s][k] : 0.0;
    solved = solved && fit.linearise() && fit.solve(true);
    if (!solved) break;
    mean.push_back(fit.theta + fit.step());
    P.push_back(Fit::gather(fit.P(), use));
    const Keep clean = unmasked(fit);
    added.push_back(found.empty() ? Eigen::MatrixXd::Zero(6 * n, 6 * n)
                                  : spread(fit, found, [&](std::size_t l, std::size_t s, Eigen::Index k) {
                                      return keep(l, s, k) && clean(l, s, k);
                                    }));
  }
  for (std::size_t l = 0; l < fit.logs().size(); ++l)
    for (std::size_t s = 0; s < weight[l].size(); ++s) fit.logs()[l].stretches[s].raw.weight = weight[l][s];
  if (!solved) return out;
  Eigen::VectorXd prior(use.size());
  for (std::size_t i = 0; i < use.size(); ++i) prior[static_cast<Eigen::Index>(i)] = fit.prior[use[i]];
  const Eigen::VectorXd information = prior.cwiseInverse();
  // V = P_a + P_b - P_a Pi^-1 P_b - P_b Pi^-1 P_a                                                                  (10.11)
  const Eigen::MatrixXd both = P[0] * information.asDiagonal() * P[1];
  const Eigen::MatrixXd V = (P[0] + P[1] - both - both.transpose()).topLeftCorner(6 * n, 6 * n) + added[0] + added[1];
  const Eigen::VectorXd delta = (mean[0] - mean[1]).head(6 * n), scale = prior.head(6 * n).cwiseSqrt();
  const Eigen::MatrixXd normal = scale.cwiseInverse().asDiagonal() * V * scale.cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(normal);
  const Eigen::VectorXd projected = eigen.eigenvectors().transpose() * delta.cwiseQuotient(scale);
  for (int i = 0; i < 6 * n; ++i) {
    if (eigen.eigenvalues()[i] <= 1e-9) continue;
    out.chi2 += projected[i] * projected[i] / eigen.eigenvalues()[i];
    ++out.freedom;
  }
  out.p = out.freedom > 0 ? std::exp(chi_square_log_tail(out.chi2, out.freedom)) : 1.0;
  return out;
}

}  // namespace truewrench
