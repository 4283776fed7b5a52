// What residuals show of a slow discrepancy by moments (METHOD (10.9)).
#pragma once

#include "truewrench/estimation/fit.hpp"

#include <algorithm>
#include <functional>

namespace truewrench {

// (10.9) of one group of channels of one log, at the tau of the largest z.
struct Moment {
  double tau = constants::taus[0];
  double delta2 = 0.0;  // delta^2, fraction of range squared
  double sd = 0.0;      // its standard deviation
  double z = 0.0;
};

// Which samples count: of log l, stretch s, row k.
using Keep = std::function<bool(std::size_t, std::size_t, Eigen::Index)>;

inline Keep unmasked(const Fit& fit) {
  return [&fit](std::size_t l, std::size_t s, Eigen::Index k) {
    return fit.logs()[l].stretches[s].raw.masked[static_cast<std::size_t>(k)] == 0;
  };
}

// The Matern-3/2 correlation (1 + t / tau) exp(-t / tau) on increasing times, of rows by the root of the samples they stand for:
// from each to the next, t / tau and exp(-t / tau).
struct Correlation {
  Correlation(const Eigen::VectorXd& time, const Eigen::VectorXd& roots, double tau) : root(roots) {
    for (Eigen::Index i = 1; i < time.size(); ++i) {
      x.push_back((time[i] - time[i - 1]) / tau);
      e.push_back(std::exp(-x.back()));
    }
  }
  Eigen::VectorXd root;
  std::vector<double> x, e;

  // K X: two recursions a column, there and back.
  RowMatrix times(const RowMatrix& X) const {
    const Eigen::Index n = X.rows(), columns = X.cols();
    RowMatrix out(n, columns);
    for (Eigen::Index k = 0; k < n; ++k)
      for (Eigen::Index c = 0; c < columns; ++c) out(k, c) = root[k] * root[k] * X(k, c);
    std::vector<double> a(static_cast<std::size_t>(columns)), b(a.size());
    for (const int direction : {1, -1}) {
      std::fill(a.begin(), a.end(), 0.0);
      std::fill(b.begin(), b.end(), 0.0);
      for (Eigen::Index i = 1; i < n; ++i) {
        const Eigen::Index to = direction > 0 ? i : n - 1 - i, from = to - direction;
        const auto step = static_cast<std::size_t>(std::min(to, from));
        const double xs = x[step], es = e[step], here = root[from], there = root[to],
                     *row = X.data() + from * columns;
        double *sum = out.data() + to * columns, *pa = a.data(), *pb = b.data();
        for (Eigen::Index c = 0; c < columns; ++c) {
          const double ac = pa[c] + here * row[c];
          pb[c] = es * (pb[c] + xs * ac);
          pa[c] = es * ac;
          sum[c] += there * (pa[c] + pb[c]);
        }
      }
    }
    return out;
  }

  // sum over all pairs of K_ij^2.
  double squares() const {
    double a = 0.0, b = 0.0, c = 0.0, sum = 0.0, own = 0.0;
    const auto size = [this](std::size_t i) { return std::pow(root[static_cast<Eigen::Index>(i)], 2); };
    for (std::size_t i = 0; i < x.size(); ++i) {
      const double es = e[i] * e[i];
      own += size(i) * size(i);
      a += size(i);
      c = es * (c + 2.0 * x[i] * b + x[i] * x[i] * a);
      b = es * (b + x[i] * a);
      a *= es;
      sum += size(i + 1) * (a + 2.0 * b + c);
    }
    return own + size(x.size()) * size(x.size()) + 2.0 * sum;
  }
};

// A^T B of tall matrices.
inline Eigen::MatrixXd tall_product(const RowMatrix& A, const RowMatrix& B) {
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(A.cols(), B.cols());
  for (Eigen::Index k = 0; k < A.rows(); ++k) {
    const double *a = A.data() + k * A.cols(), *b = B.data() + k * B.cols();
    for (Eigen::Index j = 0; j < B.cols(); ++j)
      for (Eigen::Index i = 0; i < A.cols(); ++i) out(i, j) += a[i] * b[j];
  }
  return out;
}

// Times, X_i = [w, 1, (C w)_i^2] and residuals of the rows of one channel, both times the root of the samples they stand for.
struct ChannelRows {
  Eigen::VectorXd time, root, residual;
  RowMatrix X;  // (K, 8)
};

inline ChannelRows channel_rows(const Fit& fit, std::size_t l, int channel, const Keep& keep) {
  std::vector<std::pair<std::size_t, Eigen::Index>> at;
  const auto& stretches = fit.logs()[l].stretches;
  for (std::size_t s = 0; s < stretches.size(); ++s)
    for (Eigen::Index k = 0; k < stretches[s].raw.rows(); ++k)
      if (std::isfinite(stretches[s].raw.value(k, channel)) && keep(l, s, k)) at.emplace_back(s, k);
  ChannelRows out;
  const auto rows = static_cast<Eigen::Index>(at.size());
  out.time.resize(rows);
  out.root.resize(rows);
  out.residual.resize(rows);
  out.X.resize(rows, 8);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const auto [s, k] = at[static_cast<std::size_t>(i)];
    const Stretch& stretch = stretches[s];
    out.time[i] = stretch.raw.time[k];
    const double root = out.root[i] = std::sqrt(stretch.raw.size[k]);
    out.residual[i] = root * stretch.now.residual(k, channel);
    double* x = out.X.data() + 8 * i;
    for (int c = 0; c < 6; ++c) x[c] = root * stretch.now.w(k, c);
    x[6] = root;
    x[7] = root * stretch.now.cw(k, channel) * stretch.now.cw(k, channel);
  }
  return out;
}

inline bool same_times(const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  return a.size() == b.size() && std::equal(a.data(), a.data() + a.size(), b.data());
}

// [A, B]^T [C, D] of tall matrices whose product is symmetric.
inline Eigen::MatrixXd tall_product(const RowMatrix& A, const RowMatrix& B, const RowMatrix& C,
                                    const RowMatrix& D) {
  const Eigen::Index a = A.cols(), b = B.cols();
  Eigen::MatrixXd out(a + b, a + b);
  out.topLeftCorner(a, a) = tall_product(A, C);
  out.topRightCorner(a, b) = tall_product(A, D);
  out.bottomLeftCorner(b, a) = out.topRightCorner(a, b).transpose();
  out.bottomRightCorner(b, b) = tall_product(B, D);
  return out;
}

// A correlation, and what it makes of [w, 1], which the channels with samples at the same times share.
struct Correlated {
  Correlation K;
  RowMatrix KW;
};

// (10.9) for the groups of one log, from the residuals of a fit without d.
inline std::vector<Moment> moments(const Fit& fit, std::size_t l) {
  const int groups = raw_groups(fit.channels());
  std::vector<Moment> out(static_cast<std::size_t>(groups));
  Eigen::VectorXd time;  // of what is shared
  RowMatrix W;           // [w, 1]
  std::vector<Correlated> shared;
  for (int group = 0; group < groups; ++group) {
    constexpr std::size_t count = std::size(constants::taus);
    std::array<double, count> num{}, t1{}, t2{};
    double nu = 0.0, rss = 0.0;
    for (int i = 0; i < fit.channels(); ++i) {
      if (raw_group(i, fit.channels()) != group) continue;
      const ChannelRows rows = channel_rows(fit, l, i, unmasked(fit));
      const auto n = static_cast<double>(rows.time.size());
      if (n < 10.0) continue;
      if (!same_times(rows.time, time)) {
        time = rows.time;
        W = rows.X.leftCols<7>();
        shared.clear();
        for (const double tau : constants::taus) {
          const Correlation K(time, rows.root, tau);
          shared.push_back({K, K.times(W)});
        }
      }
      RowMatrix own(rows.X.rows(), 2);  // [(C w)_i^2, r]
      own << rows.X.col(7), rows.residual;
      // Q = X T: an orthonormal basis of X; M r = [X, r] m
      const Eigen::MatrixXd products = tall_product(W, own, W, own);
      Eigen::MatrixXd scaled(8, 8);
      const auto length = [&](Eigen::Index c) { return std::sqrt(std::max(products(c, c), 1e-300)); };
      for (Eigen::Index c = 0; c < 8; ++c)
        for (Eigen::Index d = 0; d < 8; ++d) scaled(c, d) = products(c, d) / (length(c) * length(d));
      const dense::Spectrum spectrum = dense::eigen(scaled);
      const Eigen::Index rank = (spectrum.values.array() > 1e-12).count();
      Eigen::MatrixXd T = Eigen::MatrixXd::Zero(9, rank);
      for (Eigen::Index c = 0, q = 0; c < 8; ++c) {
        if (!(spectrum.values[c] > 1e-12)) continue;
        for (Eigen::Index d = 0; d < 8; ++d)
          T(d, q) = spectrum.vectors(d, c) / (length(d) * std::sqrt(spectrum.values[c]));
        ++q;
      }
      Eigen::VectorXd m = -dense::times(T, dense::transposed_times(T, products.col(8)));
      m[8] += 1.0;
      const double squares = m.dot(dense::times(products, m));
      for (std::size_t t = 0; t < count; ++t) {
        const auto& [K, KW] = shared[t];
        const RowMatrix Kown = K.times(own);
        const Eigen::MatrixXd XKX = tall_product(W, own, KW, Kown), XKKX = tall_product(KW, Kown, KW, Kown),
                              S = dense::transposed_times(T, dense::transposed_times(XKX, T));
        num[t] += m.dot(dense::times(XKX, m));  // r^T M K M r
        const double outside = dense::transposed_times(T, dense::transposed_times(XKKX, T)).trace();
        t1[t] += rows.root.squaredNorm() - S.trace();                    // tr M K
        t2[t] += K.squares() - 2.0 * outside + S.cwiseProduct(S).sum();  // tr M K M K
      }
      nu += n - static_cast<double>(rank);
      rss += squares;
    }
    Moment& best = out[static_cast<std::size_t>(group)];
    best.z = -std::numeric_limits<double>::infinity();
    if (nu <= 0.0) continue;
    for (std::size_t t = 0; t < count; ++t) {
      const double top = num[t] - t1[t] * rss / nu, den = std::max(t2[t] - t1[t] * t1[t] / nu, 1e-300);
      const double sd = rss / nu * std::sqrt(2.0 / den), z = sd > 0.0 ? top / den / sd : 0.0;
      if (z > best.z) best = {constants::taus[t], std::max(0.0, top / den), sd, z};
    }
  }
  return out;
}

// Share of what the raw output of one log does, white noise apart, that the wrench does not explain: delta^2 of (10.9) over it and
// the variance of C w, in the group where it is smallest.
inline double unexplained(const Fit& fit, std::size_t l, const std::vector<Moment>& found) {
  const int n = fit.channels();
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n), squares = sum;
  double rows = 0.0;
  for (const Stretch& s : fit.logs()[l].stretches)
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k) {
      if (s.raw.masked[static_cast<std::size_t>(k)] != 0) continue;
      rows += s.raw.size[k];
      for (int i = 0; i < n; ++i) {
        sum[i] += s.raw.size[k] * s.now.cw(k, i);
        squares[i] += s.raw.size[k] * s.now.cw(k, i) * s.now.cw(k, i);
      }
    }
  double least = 1.0;
  for (std::size_t r = 0; r < found.size(); ++r) {
    double variance = 0.0, channels = 0.0;
    for (int i = 0; i < n; ++i)
      if (raw_group(i, n) == static_cast<int>(r)) {
        variance += std::max(0.0, squares[i] / rows - std::pow(sum[i] / rows, 2));
        ++channels;
      }
    const double all = found[r].delta2 + variance / channels;
    least = std::min(least, all > 0.0 ? found[r].delta2 / all : 0.0);
  }
  return least;
}

// What (10.9) adds to the covariance of C (6n, 6n) where the samples that `keep` names determine it:
// delta^2 (X^T X)^-1 X^T K X (X^T X)^-1, the prior's information beside X^T X.
inline Eigen::MatrixXd spread(const Fit& fit, const std::vector<std::vector<Moment>>& found,
                              const Keep& keep) {
  const int n = fit.channels();
  const Layout& layout = fit.layout();
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  std::vector<int> offset_of, offsets;
  for (std::size_t l = 0; l < fit.logs().size(); ++l)
    offset_of.push_back(layout.log(l).global[static_cast<std::size_t>(layout.log(l).b)]);
  offsets = offset_of;
  offsets.erase(std::unique(offsets.begin(), offsets.end()), offsets.end());
  const auto m = static_cast<Eigen::Index>(offsets.size());
  struct Known {
    Eigen::VectorXd time;
    double tau;
    Correlation K;
  };
  std::vector<Known> known;
  for (int i = 0; i < n; ++i) {
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(7 + m, 7 + m), B = A;  // of [C_i, u_i, offsets]
    for (int k = 0; k < 6; ++k) A(k, k) = 1.0 / fit.prior[layout.C + 6 * i + k];
    A(6, 6) = 1.0 / fit.prior[layout.u + i];
    for (Eigen::Index o = 0; o < m; ++o)
      A(7 + o, 7 + o) = 1.0 / fit.prior[offsets[static_cast<std::size_t>(o)] + i];
    for (std::size_t l = 0; l < fit.logs().size(); ++l) {
      const ChannelRows rows = channel_rows(fit, l, i, keep);
      if (rows.time.size() == 0) continue;
      const Moment& moment = found[l][static_cast<std::size_t>(raw_group(i, n))];
      const auto o = static_cast<Eigen::Index>(
          7 + std::distance(offsets.begin(), std::find(offsets.begin(), offsets.end(), offset_of[l])));
      const auto to = [o](Eigen::Index c) { return c < 6 ? c : (c == 6 ? o : Eigen::Index{6}); };
      const auto add = [&](Eigen::MatrixXd& sum, double v, const Eigen::MatrixXd& part) {
        for (Eigen::Index c = 0; c < 8; ++c)
          for (Eigen::Index d = 0; d < 8; ++d) sum(to(c), to(d)) += v * part(c, d);
      };
      const double v = std::pow(fit.sigma(l, i), -2.0);
      add(A, v, tall_product(rows.X, rows.X));
      if (!(moment.delta2 > 0.0)) continue;
      auto at = std::find_if(known.begin(), known.end(), [&](const Known& k) {
        return k.tau == moment.tau && same_times(k.time, rows.time);
      });
      if (at == known.end()) {
        known.push_back({rows.time, moment.tau, Correlation(rows.time, rows.root, moment.tau)});
        at = known.end() - 1;
      }
      add(B, v * v * moment.delta2, tall_product(rows.X, at->K.times(rows.X)));
    }
    Eigen::MatrixXd G;
    double logdet = 0.0;
    if (!dense::invert(A, G, logdet)) continue;
    const Eigen::MatrixXd GBG = dense::transposed_times(G, dense::transposed_times(B, G));
    for (int c = 0; c < 6; ++c)
      for (int d = 0; d < 6; ++d) out(6 * i + c, 6 * i + d) = GBG(c, d);
  }
  return out;
}

}  // namespace truewrench
