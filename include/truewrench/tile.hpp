// A block of a few rows of a row-major matrix, held in registers: the kernel of the filter's rank-12
// update. Eigen's own small products leave blocks of this shape in memory, so this uses the packets
// underneath them, which exist for every instruction set Eigen knows.
#pragma once

#include <Eigen/Core>

namespace truewrench {

// Columns of a tile that fills the registers of the instruction set without spilling.
inline constexpr int tile_columns = Eigen::internal::packet_traits<double>::size >= 4 ? 8 : 4;

template <int rows, int columns = tile_columns>
class Tile {
 public:
  static Tile zero() {
    Tile t;
    for (auto& row : t.v_)
      for (auto& packet : row) packet = Eigen::internal::pset1<Packet>(0.0);
    return t;
  }

  // Every address is that of an aligned matrix, at a column that is a multiple of `columns`.
  static Tile load(const double* p, int stride) {
    Tile t;
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < packets; ++c)
        t.v_[r][c] = Eigen::internal::pload<Packet>(p + r * stride + c * width);
    return t;
  }

  void store(double* p, int stride) const {
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < packets; ++c) Eigen::internal::pstore(p + r * stride + c * width, v_[r][c]);
  }

  void store_transposed(double* p, int stride) const
    requires(rows == columns)
  {
    for (int r = 0; r < packets; ++r) {
      for (int c = 0; c < packets; ++c) {
        Eigen::internal::PacketBlock<Packet, width> block;
        for (int s = 0; s < width; ++s) block.packet[s] = v_[r * width + s][c];
        if constexpr (width > 1) Eigen::internal::ptranspose(block);
        for (int s = 0; s < width; ++s)
          Eigen::internal::pstore(p + (c * width + s) * stride + r * width, block.packet[s]);
      }
    }
  }

  // row r <- row r + factor * right
  void add_scaled(int r, double factor, const double* right) {
    for (int c = 0; c < packets; ++c)
      v_[r][c] = Eigen::internal::pmadd(Eigen::internal::pset1<Packet>(factor),
                                        Eigen::internal::pload<Packet>(right + c * width), v_[r][c]);
  }

  // row r <- row r + sign * sum over k of left(r, k) right(k, .), where left(r, k) is
  // left[k * k_step + r * r_step] and the rows of right are `stride` apart.
  template <int sign, int terms, int k_step, int r_step>
  void accumulate(const double* left, const double* right, int stride) {
#pragma GCC unroll 12
    for (int k = 0; k < terms; ++k) {
      Packet b[packets];
      for (int c = 0; c < packets; ++c) b[c] = Eigen::internal::pload<Packet>(right + k * stride + c * width);
      for (int r = 0; r < rows; ++r) {
        const Packet a = Eigen::internal::pset1<Packet>(left[k * k_step + r * r_step]);
        for (int c = 0; c < packets; ++c) {
          const Packet product = Eigen::internal::pmul(a, b[c]);
          v_[r][c] =
              sign > 0 ? Eigen::internal::padd(v_[r][c], product) : Eigen::internal::psub(v_[r][c], product);
        }
      }
    }
  }

  // this <- L^-1 this for a lower triangle in columns of `stride` whose inverse diagonal is given.
  template <int stride>
  void solve_lower(const double* l, const double* inverse_diagonal) {
#pragma GCC unroll 4
    for (int r = 0; r < rows; ++r) {
      const Packet pivot = Eigen::internal::pset1<Packet>(inverse_diagonal[r]);
      for (int c = 0; c < packets; ++c) v_[r][c] = Eigen::internal::pmul(v_[r][c], pivot);
#pragma GCC unroll 4
      for (int s = r + 1; s < rows; ++s) {
        const Packet a = Eigen::internal::pset1<Packet>(l[r * stride + s]);
        for (int c = 0; c < packets; ++c)
          v_[s][c] = Eigen::internal::psub(v_[s][c], Eigen::internal::pmul(a, v_[r][c]));
      }
    }
  }

 private:
  using Packet = Eigen::internal::find_best_packet<double, columns>::type;
  static constexpr int width = Eigen::internal::unpacket_traits<Packet>::size;
  static constexpr int packets = columns / width;
  Packet v_[rows][packets];
};

}  // namespace truewrench
