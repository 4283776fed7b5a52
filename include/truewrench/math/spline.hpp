// Uniform quintic B-splines on the span of one stretch, their smoothness and their log determinants (METHOD 10.1).
//
// N = intervals + 5 coefficients a component. An interval carries 6 of them; 5 intervals make one block, so that a matrix
// on the coefficients is block tridiagonal.
#pragma once

#include <Eigen/Core>

#include <algorithm>
#include <array>
#include <cmath>

namespace truewrench {

inline constexpr int kDegree5 = 5;
inline constexpr int kLocal = 6;  // coefficients under an interval
inline constexpr int kBlock = 5;  // intervals of a block

using Basis = Eigen::Matrix<double, kLocal, 1>;
using Gram = Eigen::Matrix<double, kLocal, kLocal>;

// Coefficients of u^p (column) of the uniform B-splines of a degree over an interval (row), u in [0, 1): Cox and de Boor.
inline Gram spline_pieces(int degree) {
  Gram pieces = Gram::Zero();
  pieces(0, 0) = 1.0;
  for (int d = 1; d <= degree; ++d) {
    Gram next = Gram::Zero();
    for (int k = 0; k <= d; ++k)
      for (int p = 0; p < d; ++p) {
        if (k > 0) {  // (u + d - k) / d times the function before
          next(k, p) += (d - k) * pieces(k - 1, p) / d;
          next(k, p + 1) += pieces(k - 1, p) / d;
        }
        if (k < d) {  // (k + 1 - u) / d times the one at its place
          next(k, p) += (k + 1) * pieces(k, p) / d;
          next(k, p + 1) -= pieces(k, p) / d;
        }
      }
    pieces = next;
  }
  return pieces;
}

// int_0^1 of the products of functions whose polynomials are the rows of a and b.
inline Gram piece_products(const Gram& a, const Gram& b) {
  Gram out = Gram::Zero();
  for (int k = 0; k < kLocal; ++k)
    for (int l = 0; l < kLocal; ++l)
      for (int i = 0; i < kLocal; ++i)
        for (int j = 0; j < kLocal; ++j) out(k, l) += a(k, i) * b(l, j) / (i + j + 1);
  return out;
}

// The quintic pieces and their derivatives, once.
struct SplineTable {
  std::array<Gram, kLocal> derivative;              // [p]: polynomials of the p-th derivative
  std::array<std::array<Gram, 4 + 1>, 4 + 1> gram;  // [p][q] int_0^1 B^(p) B^(q)^T du

  SplineTable() {
    derivative[0] = spline_pieces(kDegree5);
    for (std::size_t p = 1; p < derivative.size(); ++p) {
      derivative[p].setZero();
      for (int k = 1; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l) derivative[p](l, k - 1) = k * derivative[p - 1](l, k);
    }
    for (std::size_t p = 0; p < gram.size(); ++p)
      for (std::size_t q = 0; q < gram.size(); ++q) gram[p][q] = piece_products(derivative[p], derivative[q]);
  }

  static const SplineTable& get() {
    static const SplineTable table;
    return table;
  }
};

// A penalty that repeats on every interval, and what its start adds on the first, its end on the last.
struct Penalty {
  Gram inside = Gram::Zero();
  Gram start = Gram::Zero(), end = Gram::Zero();
  bool of_derivative =
      false;  // it annihilates a constant, beside which what it measures would drown in rounding

  // x^T R x for column j of coefficients (N, columns).
  double quadratic(const double* x, Eigen::Index size, Eigen::Index columns) const {
    double sum = 0.0;
    const Eigen::Index last = size - kLocal;
    Gram outer;
    for (Eigen::Index i = 0; i <= last; ++i) {
      const bool within = i > 0 && i < last;
      if (!within) {
        outer = inside;
        if (i == 0) outer += start;
        if (i == last) outer += end;
      }
      const Gram& at = within ? inside : outer;
      double local[kLocal];
      for (int k = 0; k < kLocal; ++k)
        local[k] = x[(i + k) * columns] - (of_derivative ? x[i * columns] : 0.0);
      for (int l = 0; l < kLocal; ++l) {
        double row = 0.0;
        for (int k = 0; k < kLocal; ++k) row += at(k, l) * local[k];
        sum += row * local[l];
      }
    }
    return sum;
  }
  template <typename Matrix>
  double quadratic(const Matrix& c, int j) const {
    return quadratic(c.data() + j, c.rows(), c.cols());
  }
};

// Where the discrepancy's process comes from (METHOD 10.2, 10.3); bridge: a walk of a stated rate, delta, about the line between
// its ends, which theta holds.
enum class Form { none, matern, walk, bridge };

// Variance of what a walk does over that of a bridge at its ends.
inline constexpr double kPinned = 1e4;

class Spline {
 public:
  Spline() = default;
  // Knots at a spacing of about h over [begin, begin + duration], reduced so that whole blocks fit.
  Spline(double begin, double duration, double h) : begin_(begin) {
    const double blocks = std::ceil(duration / (kBlock * h) - 1e-9);
    blocks_ = std::max<Eigen::Index>(2, static_cast<Eigen::Index>(blocks));
    h_ = duration / static_cast<double>(intervals());
    for (std::size_t p = 1; p < scale_.size(); ++p) scale_[p] = scale_[p - 1] / h_;
  }

  double begin() const { return begin_; }
  double h() const { return h_; }
  Eigen::Index blocks() const { return blocks_; }
  Eigen::Index intervals() const { return kBlock * blocks_; }
  Eigen::Index size() const { return intervals() + kDegree5; }  // N
  double end() const { return begin_ + h_ * static_cast<double>(intervals()); }

  // The interval of a time and the place in it; times outside continue the last polynomial.
  Eigen::Index locate(double t, double& u) const {
    const double x = (t - begin_) / h_;
    const auto i = static_cast<Eigen::Index>(
        std::clamp(std::floor(x + 1e-9), 0.0, static_cast<double>(intervals() - 1)));
    u = x - static_cast<double>(i);
    return i;
  }

  // B^(p) at a place of an interval [1 / s^p].
  Basis basis(double u, int p) const {
    Basis out;
    bases(u, p, 1, &out);
    return out;
  }

  // B^(p), B^(p + 1) ... at a place, `count` of them.
  void bases(double u, int p, int count, Basis* out) const {
    for (int q = p; q < p + count; ++q) {
      double* value = out[q - p].data();
      if (q > kDegree5) {
        std::fill_n(value, kLocal, 0.0);
        continue;
      }
      const double* polynomial =
          SplineTable::get().derivative[static_cast<std::size_t>(q)].data();  // a column a power
      const int power = kDegree5 - q;
      double sum[kLocal];
      for (int l = 0; l < kLocal; ++l) sum[l] = polynomial[kLocal * power + l];
      for (int k = power - 1; k >= 0; --k)
        for (int l = 0; l < kLocal; ++l) sum[l] = sum[l] * u + polynomial[kLocal * k + l];
      for (int l = 0; l < kLocal; ++l) value[l] = sum[l] * scale_[static_cast<std::size_t>(q)];
    }
  }

  Gram gram(int p, int q) const {
    Gram out = SplineTable::get().gram[static_cast<std::size_t>(p)][static_cast<std::size_t>(q)];
    const double scale = std::pow(h_, 1 - p - q);
    for (int k = 0; k < kLocal * kLocal; ++k) out.data()[k] *= scale;
    return out;
  }

  // R_p (10.1) of one interval.
  Penalty smoothness(int p) const { return {gram(p, p), Gram::Zero(), Gram::Zero(), true}; }

  // log |R_p + A^T A| with A the values of the first p derivatives at the beginning, in the coordinates (p coefficients,
  // p-th differences) where it falls apart (10.2, below (10.7)): log |G| - ((2p - 1)(N - p) + p (p - 1)) log h.
  double smoothness_logdet(int p) const {
    const Gram pieces = spline_pieces(kDegree5 - p), local = piece_products(pieces, pieces);
    const Eigen::Index functions = size() - p;
    const double scale = static_cast<double>((2 * p - 1) * functions + p * (p - 1));
    return repeated_logdet(local, Gram::Zero(), kLocal - p, functions) - scale * std::log(h_);
  }

  // R_M of (10.2), or that of a random walk (10.3), at k = 1 / tau; of a bridge int d'^2, and zero at both ends to 1 % of what a
  // walk does in between.
  Penalty discrepancy(double k, Form form) const {
    const Basis d0 = basis(0.0, 0), d1 = basis(0.0, 1);
    if (form == Form::bridge) {
      const Basis last = basis(1.0, 0);
      const double pin = kPinned / (end() - begin());
      Penalty out;
      out.inside = gram(1, 1);
      for (int i = 0; i < kLocal; ++i)
        for (int j = 0; j < kLocal; ++j) {
          out.start(i, j) = pin * d0[i] * d0[j];
          out.end(i, j) = pin * last[i] * last[j];
        }
      return out;
    }
    const bool walk = form == Form::walk;
    // of the products of derivatives [p][q]
    const double walk_of[3][3] = {
        {k * k, k, 0.0}, {k, 1.0, 0.0}, {0.0, 0.0, 0.0}};  // int (d' + k d)^2 / (2 k) + d(0)^2
    const double k2 = k * k,
                 matern_of[3][3] = {
                     {k2 * k2, 2.0 * k * k2, k2}, {2.0 * k * k2, 4.0 * k2, 2.0 * k}, {k2, 2.0 * k, 1.0}};
    const double scale = walk ? 1.0 / (2.0 * k) : 1.0 / (4.0 * k * k2);
    Penalty out;
    for (int p = 0; p < 3; ++p)
      for (int q = 0; q < 3; ++q) {
        const Gram G = gram(p, q);
        const double times = scale * (walk ? walk_of[p][q] : matern_of[p][q]);
        for (int i = 0; i < kLocal * kLocal; ++i) out.inside.data()[i] += times * G.data()[i];
      }
    for (int i = 0; i < kLocal; ++i)
      for (int j = 0; j < kLocal; ++j) out.start(i, j) = d0[i] * d0[j] + (walk ? 0.0 : d1[i] * d1[j] / k2);
    return out;
  }

  // What a bridge's end adds: log(1 + pin K(T, T)), K(T, T) = T + 1 / pin of a walk that begins at zero.
  double logdet(const Penalty& penalty) const {
    const double pinned = penalty.end.isZero(0.0) ? 0.0 : std::log(2.0 + kPinned);
    return pinned + repeated_logdet(penalty.inside, penalty.start, kLocal, size());
  }

 private:
  double begin_ = 0.0, h_ = 1.0;
  std::array<double, kLocal> scale_{1.0, 1.0, 1.0, 1.0, 1.0, 1.0};  // h^-p
  Eigen::Index blocks_ = 2;

  // log det of the band of `size` that repeats `inside` (width, width) along the diagonal and adds `start` at its beginning;
  // NaN where it is not positive definite.
  static double repeated_logdet(const Gram& inside, const Gram& start, int width, Eigen::Index size) {
    std::array<Basis, kLocal>
        column;  // of the coefficients under an interval: what earlier ones and intervals left
    for (Basis& c : column) c.fill(0.0);
    double sum = 0.0, pivots = 1.0;
    for (Eigen::Index j = 0; j < size; ++j) {
      if (j + width <= size)
        for (int l = 0; l < width; ++l)
          for (int k = l; k < width; ++k)
            column[static_cast<std::size_t>(l)][k - l] += inside(k, l) + (j == 0 ? start(k, l) : 0.0);
      const Basis pivot = column[0];
      if (!(pivot[0] > 0.0)) return std::nan("");
      pivots *= pivot[0];
      if (j % 4 == 3 || j + 1 == size) {
        sum += std::log(pivots);
        pivots = 1.0;
      }
      for (int k = 1; k < width; ++k)
        for (int i = k; i < width; ++i)
          column[static_cast<std::size_t>(k)][i - k] -= pivot[i] * pivot[k] / pivot[0];
      for (std::size_t l = 0; l + 1 < column.size(); ++l) column[l] = column[l + 1];
      column.back().fill(0.0);
    }
    return sum;
  }
};

}  // namespace truewrench
