// Quintic B-splines on any increasing breakpoints: the motion of one window (docs/method.md, "Windows of
// motion").
//
// With K intervals there are K + 5 coefficients; on interval i the six coefficients i ... i+5 are active. The
// end knots are repeated, so halving an interval gives a space that contains the old one: coarse and fine
// splines are nested, which is what the knot search tests.
#pragma once

#include <Eigen/Core>

#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

namespace truewrench {

inline constexpr int kDegree = 5;
inline constexpr int kActive = kDegree + 1;  // basis functions that are not zero on an interval

using BasisRow = Eigen::Matrix<double, kActive, 1>;

// Powers 0 ... 5 of the local coordinate u in [-1, 1], or their mean over a block of samples.
using Powers = Eigen::Matrix<double, kActive, 1>;

inline Powers powers(double u) {
  Powers p;
  p[0] = 1.0;
  for (int k = 1; k < kActive; ++k) p[k] = p[k - 1] * u;
  return p;
}

class BSpline {
 public:
  BSpline() = default;

  // `breakpoints`: at least two, strictly increasing.
  explicit BSpline(std::vector<double> breakpoints) : breakpoints_(std::move(breakpoints)) {
    const int k = intervals();
    pieces_.resize(static_cast<std::size_t>(k));
    for (int i = 0; i < k; ++i) pieces_[static_cast<std::size_t>(i)] = piece(i);
  }

  static std::vector<double> uniform(double begin, double end, int intervals) {
    std::vector<double> t(static_cast<std::size_t>(intervals) + 1);
    for (int i = 0; i <= intervals; ++i) {
      t[static_cast<std::size_t>(i)] = begin + (end - begin) * (static_cast<double>(i) / intervals);
    }
    return t;
  }

  int intervals() const { return static_cast<int>(breakpoints_.size()) - 1; }
  int coefficients() const { return intervals() + kDegree; }
  double begin() const { return breakpoints_.front(); }
  double end() const { return breakpoints_.back(); }
  const std::vector<double>& breakpoints() const { return breakpoints_; }
  double width(int i) const { return at(i + 1) - at(i); }

  // The interval that holds t; times outside the range belong to the first or last one.
  int interval(double t) const {
    const auto it = std::upper_bound(breakpoints_.begin() + 1, breakpoints_.end() - 1, t);
    return static_cast<int>(it - breakpoints_.begin()) - 1;
  }

  double local(int i, double t) const { return (2.0 * t - at(i) - at(i + 1)) / width(i); }

  // The polynomials in u, rows of `x` being coefficients: column k holds the factors of u^k.
  template <int D>
  Eigen::Matrix<double, D, kActive> polynomial(
      int i, const Eigen::Matrix<double, Eigen::Dynamic, D, Eigen::RowMajor>& x) const {
    return x.template middleRows<kActive>(i).transpose() * pieces_[static_cast<std::size_t>(i)];
  }

  // Powers of u differentiated with respect to time: what `polynomial` is multiplied with for the derivative.
  Powers rate(int i, const Powers& u) const {
    const double scale = 2.0 / width(i);
    Powers d;
    d[0] = 0.0;
    for (int k = 1; k < kActive; ++k) d[k] = scale * k * u[k - 1];
    return d;
  }

  // The six active basis functions, or their d-th time derivative, from the (mean) powers of u.
  BasisRow basis(int i, const Powers& u, int derivative) const {
    Powers p = u;
    for (int d = 0; d < derivative; ++d) p = rate(i, p);
    return pieces_[static_cast<std::size_t>(i)] * p;
  }

  // The same spline on other breakpoints, of which this one's are a subset, or else one close to it: rows of `x` are
  // coefficients.
  // A coefficient is the polar form of a polynomial piece inside its support, taken at its five inner knots.
  template <int D>
  Eigen::Matrix<double, Eigen::Dynamic, D, Eigen::RowMajor> refined(
      const Eigen::Matrix<double, Eigen::Dynamic, D, Eigen::RowMajor>& x, const BSpline& fine) const {
    static constexpr std::array<double, kActive> binomial{1, 5, 10, 10, 5, 1};
    Eigen::Matrix<double, Eigen::Dynamic, D, Eigen::RowMajor> y(fine.coefficients(), x.cols());
    for (int j = 0; j < fine.coefficients(); ++j) {
      // Fine intervals in the support of coefficient j run from j - 5 to j; take a middle one.
      const int f = std::clamp(j - kDegree / 2, std::max(0, j - kDegree), std::min(j, fine.intervals() - 1));
      const int i = interval(0.5 * (fine.at(f) + fine.at(f + 1)));
      std::array<double, kActive> e{1, 0, 0, 0, 0, 0};  // elementary symmetric polynomials of the inner knots
      for (int k = 1; k <= kDegree; ++k) {
        const double u = local(i, fine.knot(j + k));
        for (int p = k; p >= 1; --p) {
          e[static_cast<std::size_t>(p)] += u * e[static_cast<std::size_t>(p) - 1];
        }
      }
      Powers polar;
      for (int p = 0; p < kActive; ++p) {
        polar[p] = e[static_cast<std::size_t>(p)] / binomial[static_cast<std::size_t>(p)];
      }
      y.row(j).noalias() =
          (pieces_[static_cast<std::size_t>(i)] * polar).transpose() * x.middleRows(i, kActive);
    }
    return y;
  }

  // Breakpoints with every marked interval halved. Where halves would be shorter than `finest`, marked intervals and
  // their neighbours, as short, are dealt out anew, a third more of them if that allows it.
  std::vector<double> halved(std::span<const char> marked, double finest = 0.0) const {
    const auto is_marked = [&](int i) {
      return i >= 0 && i < intervals() && marked[static_cast<std::size_t>(i)];
    };
    const auto is_dealt = [&](int i) {
      return 0.5 * width(i) < finest && (is_marked(i - 1) || is_marked(i) || is_marked(i + 1));
    };
    std::vector<double> t;
    t.reserve(2 * breakpoints_.size());
    for (int i = 0; i < intervals();) {
      int next = i + 1;
      if (is_dealt(i)) {
        while (next < intervals() && is_dealt(next)) ++next;
        const int before = next - i;
        const int count = std::min(static_cast<int>((at(next) - at(i)) / finest), (4 * before + 2) / 3);
        if (count >= kWorthwhile * before) {
          const std::vector<double> dealt = uniform(at(i), at(next), count);
          t.insert(t.end(), dealt.begin(), dealt.end() - 1);
        } else {
          t.insert(t.end(), breakpoints_.begin() + i, breakpoints_.begin() + next);
        }
      } else {
        t.push_back(at(i));
        if (is_marked(i)) t.push_back(0.5 * (at(i) + at(next)));
      }
      i = next;
    }
    t.push_back(end());
    return t;
  }

 private:
  static constexpr double kWorthwhile = 1.1;  // so many times as many intervals, or they stay as they are

  // Row r: the polynomial of active basis function r in powers of u.
  using Piece = Eigen::Matrix<double, kActive, kActive>;

  double at(int i) const { return breakpoints_[static_cast<std::size_t>(i)]; }

  // Knot j of the clamped knot vector: the ends six-fold.
  double knot(int j) const { return at(std::clamp(j - kDegree, 0, intervals())); }

  // Cox and de Boor's recursion with polynomials in u in place of numbers.
  Piece piece(int i) const {
    const double middle = 0.5 * (at(i) + at(i + 1));
    const double half = 0.5 * width(i);
    const int first = i + kDegree;  // knot index of the interval's left end
    Piece n = Piece::Zero();        // row r holds N_{first - degree + r} of the current degree
    n(kDegree, 0) = 1.0;
    for (int d = 1; d <= kDegree; ++d) {
      Piece next = Piece::Zero();
      for (int r = kDegree - d; r <= kDegree; ++r) {
        const int j = first - kDegree + r;
        if (r > kDegree - d) add_linear(next, r, n.row(r), knot(j), knot(j + d), middle, half, 1.0);
        if (r < kDegree) add_linear(next, r, n.row(r + 1), knot(j + 1), knot(j + d + 1), middle, half, -1.0);
      }
      n = next;
    }
    return n;
  }

  // next.row(r) += p(u) (t - a) / (b - a) for sign +1, and p(u) (b - t) / (b - a) for sign -1.
  static void add_linear(Piece& next, int r, const Eigen::Matrix<double, 1, kActive>& p, double a, double b,
                         double middle, double half, double sign) {
    const double c0 = (sign > 0 ? middle - a : b - middle) / (b - a);
    const double c1 = sign * half / (b - a);
    next.row(r) += c0 * p;
    next.row(r).tail<kDegree>() += c1 * p.head<kDegree>();
  }

  std::vector<double> breakpoints_;
  std::vector<Piece> pieces_;
};

}  // namespace truewrench
