// The rows of a lag: where theta's parameters stand, what the model predicts at
// a row, and the sums over the rows of an interval. Included by lag.hpp.
#pragma once

#include "truewrench/estimation/lag.hpp"

namespace truewrench {

inline void Lag::carry(const RecordedLog& about) {
  about_ = about;
  for (MotionStream& m : about_.motion) m.value.resize(0, kComponents);  // whatever a log without samples has
  layout_ = Layout(rig_, {&about_}, {}, layout_.tilt >= 0);              // logs to come may share it again
  nt_ = layout_.size();
  columns_ = layout_.in_theta(0);
  streams_ = about_.motion.size();
  felt_ = (rig_.gravity[0] != 0.0 || rig_.gravity[1] != 0.0 || rig_.gravity[2] != 0.0) &&
          about_.source != Source::imu;
  theta = layout_.mean();
  products_ = Products(n_, columns_.C, columns_.body_in_theta, nt_, about_.payload, rig_.range);
  sizes = starting_sizes(about_, n_);
  lagged = rig_.nominal;
}

inline void Lag::resize_work() {
  shape_ = Shape(kComponents, nt_);
  const auto assign = [](std::vector<double>& v, int size) {
    v.assign(static_cast<std::size_t>(size + 8), 0.0);
  };
  for (Block& b : blocks_) assign(b.panel, kWidth * shape_.ld);
  assign(last_, kWidth * shape_.ld);
  assign(work_, 2 * kWidth * alone_.ld);
  assign(T_, (nt_ + 1) * shape_.ldt);
  sums_.setup(columns_, kComponents, 2, felt_);
  sums_.reserve(kMostRows);
  sums_.reserve(spare_);
  for (Interval& v : intervals_) sums_.reserve(v.sums);
  assign(lagged_, 6 * n_);
  assign(z_, nt_);
  assign(full_, nt_ * dense::padded(nt_ + 1));
  for (auto* v : {&here_, &next_, &inverse_}) assign(*v, kWidth * kTheta);
  assign(V_, 2 * kWidth * kPadded);
  for (int r = 0; r < 6; ++r) scale_[r] = rig_.sign / rig_.range[r];
}

// What rows and blocks need of theta.
inline void Lag::refresh() {
  products_.set(theta.data());
  products_.coordinates(theta.data(), z_.data());
  products_.times(lagged.data(), lagged_.data());
  for (int i = 0; i < 3; ++i) point_[i] = about_.point[i] - products_.centre[i];
  gravity_ = Gravity(rig_, columns_, theta.data(), felt_, about_.half_window, about_.clock_set);
  sums_.at(products_.D.data(), theta.data() + columns_.u, lagged_.data());
}

// raw = C w + b + u (C_0 w)^2 + slope dT (10.3)
inline void Lag::predict(long g) {
  refresh();
  double xx[2 * kWidth];
  coefficients(g, xx);
  const int clock = columns_.clock[0];
  const Bending bending = about_.bending(0, theta[clock], theta[clock + 1]);
  for (int o = 0; o < kBlock; ++o) {
    Interval& v = interval(kBlock * g + o);
    const double* c = xx + kComponents * o;
    for (int r = 0; r < v.rows; ++r) {
      RawRow& row = v.row[static_cast<std::size_t>(r)];
      double x[2 * kComponents] = {};
      for (std::size_t l = 0; l < kLocal; ++l) {
        dense::add<6>(x, row.basis[l], c + kComponents * static_cast<int>(l));
        dense::add<6>(x + 6, row.basis[kLocal + l], c + kComponents * static_cast<int>(l));
      }
      const bool imu = about_.source == Source::imu;  // a_s takes the place of vdot + Omega x v - g
      for (int j = 0; j < 6; ++j) {
        row.nu[j] = imu && j < 3 ? 0.0 : x[j];
        row.a[j] = imu && j < 3 ? x[j] : x[6 + j];
      }
      if (!imu && (felt_ || bending.averaged() > 0.0)) {
        row.jerk.setZero();
        for (std::size_t l = 0; l < kLocal; ++l)
          dense::add<6>(row.jerk.data(), row.basis[2 * kLocal + l], c + kComponents * static_cast<int>(l));
      }
      const Vector3 felt = gravity_.felt(row.R, row.nu, row.a, angular(row.jerk));
      row.phi = wrench_read(products_.body, point_, row.nu, row.a, row.jerk, felt, bending, imu);
      for (int k = 0; k < 6; ++k) row.phi[k] *= scale_[k];
      for (int k = 0; k < 6; ++k) {
        double sum = 0.0;
        for (int l = 0; l < 6; ++l) sum += products_.B[k][l] * row.phi[l];
        row.w[k] = sum;
      }
      for (int i = 0; i < n_; ++i) {
        const auto iu = static_cast<std::size_t>(i);
        double cw = 0.0, e = row.value[iu] - theta[columns_.b + i];
        for (int k = 0; k < 6; ++k) {
          cw += lagged(i, k) * row.w[k];
          e -= products_.D[static_cast<std::size_t>(6 * i + k)] * row.phi[k];
        }
        row.cw[iu] = cw;
        e -= theta[columns_.u + i] * cw * cw;
        if (columns_.slope >= 0) e -= row.temperature * theta[columns_.slope + i];
        row.residual[iu] = row.has(i) ? e : 0.0;
      }
    }
  }
}

// Rows of (10.3) of one interval, those with the same cells together: sum(interval, cells, sums).
template <typename Sum>
void Lag::each_cells(Interval& v, const Sum& sum) {
  std::fill(v.sums.v.begin(), v.sums.v.end(), 0.0);
  unsigned done[kMostRows];
  int masks = 0, most = 0, largest = 0;
  for (int r = 0; r < v.rows; ++r) {
    const RawRow& row = v.row[static_cast<std::size_t>(r)];
    if (row.masked || std::find(done, done + masks, row.cells) != done + masks) continue;
    int count = 0;
    for (int l = r; l < v.rows; ++l) {
      const RawRow& other = v.row[static_cast<std::size_t>(l)];
      if (!other.masked && other.cells == row.cells) ++count;
    }
    if (count > most) {
      most = count;
      largest = masks;
    }
    done[masks++] = row.cells;
  }
  for (int m = 0; m < masks; ++m)  // the traces know the largest of them
    sum(v, done[m], m == largest ? v.sums : spare_);
}

// Those with the cells `same`, to row_, and their Jacobians; false where none counts.
inline bool Lag::gather_rows(const Interval& v, unsigned same, RawSums& out) {
  rows_ = 0;
  double total = 0.0;
  for (int r = 0; r < v.rows; ++r) {
    const RawRow& row = v.row[static_cast<std::size_t>(r)];
    if (row.masked || row.cells != same) continue;
    jacobians(row, sums_.J(rows_), sums_.X(rows_));
    total += row.weight * row.size;
    row_[static_cast<std::size_t>(rows_++)] = &row;
  }
  if (!(total > 0.0)) return false;
  Channels information{};
  for (int i = 0; i < n_; ++i)
    if ((same >> i & 1U) != 0) information[static_cast<std::size_t>(i)] = 1.0 / (noise(i) * noise(i));
  sums_.average(0, rows_, [&](int r) {
    const RawRow& row = *row_[static_cast<std::size_t>(r)];
    return row.weight * row.size;
  });
  sums_.begin(out, 0, information.data());
  return true;
}

inline void Lag::sum_rows(Front& f, const Interval& v, unsigned same, RawSums& out, const Places& at,
                          SizeSums& sums) {
  if (!gather_rows(v, same, out)) return;
  double of_gathered = 0.0, gathered = 0.0;
  for (int r = 0; r < rows_; ++r) {
    const RawRow& row = *row_[static_cast<std::size_t>(r)];
    const double weight = row.weight * row.size;
    if (row.gathered) {
      of_gathered += weight;
      gathered += row.size;
    }
    sums_.add(out, weight, row.basis.data(), row.phi.data(), row.cw.data(), row.residual.data(),
              &row.temperature);
    for (int i = 0; i < n_; ++i) {
      const double e = row.residual[static_cast<std::size_t>(i)] / rig_.noise[i];
      const auto group = static_cast<std::size_t>(raw_group(i, n_));
      sums.raw[group] += weight * e * e;
      sums.raw_count[group] += row.has(i) ? 1.0 : 0.0;
    }
  }
  for (int i = 0; i < n_ && gathered > 0.0; ++i) {  // all gathered rows have the same cells
    if ((same >> i & 1U) == 0) continue;
    const auto group = static_cast<std::size_t>(raw_group(i, n_));
    sums.raw[group] +=
        of_gathered / gathered * v.remainder[static_cast<std::size_t>(i)] / (rig_.noise[i] * rig_.noise[i]);
    sums.raw_count[group] += v.spared;
  }
  sums_.finish(out);
  sums_.add_band<kComponents>(out, at);
  sums_.add_cross<kComponents>(out, at, nt_);
  sums_.add_theta(out, shape_, f.T.data());
}

// d phi (fractions of range) by [x, x'] (6, 12) and by the dense parameters (6, ldx), row by row, at one row.
inline void Lag::jacobians(const RawRow& row, double* J, double* X) const {
  const bool known = columns_.body < 0;
  const MotionJacobian j = row_jacobian(products_.body, point_, scale_.data(), gravity_, row.R, row.nu, row.a,
                                        angular(row.jerk), row.phi, known, X, sums_.ldx);
  // the mass and the lever arm are in D: of the centre the point's motion alone
  for (int r = 0; r < 6 && !known; ++r) std::fill_n(X + r * sums_.ldx, r < 3 ? 1 : 4, 0.0);
  by_splines(j, scale_.data(), about_.source == Source::imu, J);
}

}  // namespace truewrench
