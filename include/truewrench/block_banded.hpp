// Cholesky factorisation of a symmetric block-banded matrix: the motion part of the normal equations, where a
// coefficient meets only the five beside it.
#pragma once

#include "truewrench/types.hpp"

#include <Eigen/Cholesky>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace truewrench {

// Blocks of B x B, half bandwidth W blocks. Holds the lower triangle; `factorize` turns it into L in place.
template <int B, int W>
class BlockBanded {
 public:
  using Block = Eigen::Matrix<double, B, B>;
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  int blocks() const { return n_; }

  void reset(int blocks) {
    n_ = blocks;
    storage_.assign(static_cast<std::size_t>(blocks) * (W + 1), Block::Zero());
  }

  // Block (i, j), j <= i <= j + W.
  Block& operator()(int i, int j) { return storage_[index(i, j)]; }
  const Block& operator()(int i, int j) const { return storage_[index(i, j)]; }

  // H = L L^T. The pivots are compared with the diagonal they came from: below `floor` of it, the direction
  // is not determined to working precision and the matrix counts as singular.
  Status factorize(double floor = 1e-13) {
    for (int j = 0; j < n_; ++j) {
      const int last = std::min(j + W, n_ - 1);
      Block& d = (*this)(j, j);
      const Eigen::Matrix<double, B, 1> before = d.diagonal();
      for (int k = std::max(0, j - W); k < j; ++k) {
        d.noalias() -= (*this)(j, k).lazyProduct((*this)(j, k).transpose());
      }
      for (int c = 0; c < B; ++c) {
        double pivot = d(c, c);
        for (int k = 0; k < c; ++k) pivot -= d(c, k) * d(c, k);
        if (!(pivot > floor * before[c])) return Status::not_factorizable;
        pivot = std::sqrt(pivot);
        d(c, c) = pivot;
        for (int r = c + 1; r < B; ++r) {
          double v = d(r, c);
          for (int k = 0; k < c; ++k) v -= d(r, k) * d(c, k);
          d(r, c) = v / pivot;
        }
      }
      d.template triangularView<Eigen::StrictlyUpper>().setZero();
      for (int i = j + 1; i <= last; ++i) {
        Block& a = (*this)(i, j);
        for (int k = std::max(0, i - W); k < j; ++k) {
          a.noalias() -= (*this)(i, k).lazyProduct((*this)(j, k).transpose());
        }
        d.template triangularView<Eigen::Lower>().transpose().template solveInPlace<Eigen::OnTheRight>(a);
      }
    }
    return Status::ok;
  }

  // R <- L^-1 R, R of B * blocks rows.
  template <typename Derived>
  void solve_forward(Eigen::MatrixBase<Derived>& r) const {
    for (int j = 0; j < n_; ++j) forward_row(r, j, 0);
  }

  // Row j of it, after those before. R begins with row `first`, above which it is zero.
  template <typename Derived>
  void forward_row(Eigen::MatrixBase<Derived>& r, int j, int first) const {
    auto rj = r.template middleRows<B>((j - first) * B);
    for (int k = std::max(first, j - W); k < j; ++k) {
      rj.noalias() -= (*this)(j, k).lazyProduct(r.template middleRows<B>((k - first) * B));
    }
    (*this)(j, j).template triangularView<Eigen::Lower>().solveInPlace(rj);
  }

  // R <- L^-T R.
  template <typename Derived>
  void solve_backward(Eigen::MatrixBase<Derived>& r) const {
    for (int j = n_ - 1; j >= 0; --j) {
      auto rj = r.template middleRows<B>(j * B);
      for (int i = j + 1; i <= std::min(j + W, n_ - 1); ++i) {
        rj.noalias() -= (*this)(i, j).transpose().lazyProduct(r.template middleRows<B>(i * B));
      }
      (*this)(j, j).transpose().template triangularView<Eigen::Upper>().solveInPlace(rj);
    }
  }

  // The blocks of H^-1 inside the band, from the factor (Takahashi's recursion, last column first).
  BlockBanded inverse_band() const {
    BlockBanded z;
    z.reset(n_);
    for (int j = n_ - 1; j >= 0; --j) {
      const int last = std::min(j + W, n_ - 1);
      Block inverse = Block::Identity();
      (*this)(j, j).template triangularView<Eigen::Lower>().solveInPlace(inverse);  // L_jj^-1
      std::array<Block, W> column;  // L_kj L_jj^-1 for the blocks below the diagonal
      for (int k = j + 1; k <= last; ++k) {
        column[static_cast<std::size_t>(k - j - 1)] = (*this)(k, j).lazyProduct(inverse);
      }
      for (int i = last; i >= j; --i) {
        Block sum = Block::Zero();
        for (int k = j + 1; k <= last; ++k) {
          const Block& lkj = column[static_cast<std::size_t>(k - j - 1)];
          if (i >= k) {
            sum.noalias() -= z(i, k).lazyProduct(lkj);
          } else {
            sum.noalias() -= z(k, i).transpose().lazyProduct(lkj);
          }
        }
        if (i == j) sum.noalias() += inverse.transpose().lazyProduct(inverse);
        z(i, j) = sum;
      }
    }
    return z;
  }

 private:
  std::size_t index(int i, int j) const {
    return static_cast<std::size_t>(j) * (W + 1) + static_cast<std::size_t>(i - j);
  }

  int n_ = 0;
  std::vector<Block> storage_;
};

}  // namespace truewrench
