// The blocks of a lag: their elimination, the way back and the traces. Included by lag.hpp.
#pragma once

#include "truewrench/estimation/lag.hpp"

namespace truewrench {

// (10.1): c^T R c / q, and its gradient at xx where there is one.
inline void Lag::add_smoothness(const Shape& shape, double* P, double* N, const double* xx,
                                SizeSums* sums) const {
  for (int j = 0; j < kComponents; ++j) {
    const Gram R = smoothness(j);
    const double v = 1.0 / sizes.q[j];
    for (int o = 0; o < kBlock; ++o) {
      const Places at = shape.places(o, P, N);
      double pull[kLocal] = {}, energy = 0.0;
      if (xx != nullptr) {
        const double *x = xx + kComponents * o + j,
                     from = x[0];  // R annihilates a constant, which would drown the rest
        for (int k = 0; k < kLocal; ++k)
          for (int l = 0; l < kLocal; ++l) pull[k] += R(k, l) * (x[kComponents * l] - from);
        for (int k = 0; k < kLocal; ++k) energy += pull[k] * (x[kComponents * k] - from);
      }
      if (sums != nullptr) sums->energy[static_cast<std::size_t>(j)] += energy;
      for (int k = 0; k < kLocal; ++k) {
        double* row = at.row[k] + j * shape.ld;
        if (xx != nullptr) row[kTheta + nt_] -= v * pull[k];
        for (int l = k; l < kLocal; ++l) row[at.column[k][l] + j] += v * R(k, l);
      }
    }
  }
  if (sums != nullptr) sums->knots += kBlock;
}

inline bool Lag::placed(std::size_t i, const MotionRow& row, long g, bool last, const double* xx,
                        Placed& out) const {
  const double s = theta[columns_.clock[i]], x = (row.time + s - origin_) / h_;
  const Bending bending = about_.bending(i, s, theta[columns_.clock[i] + 1]);
  const auto interval_of = static_cast<long>(std::floor(x + 1e-9));
  if (interval_of >= kBlock * (g + 1) && !last) return false;
  out.o = static_cast<int>(std::clamp<long>(interval_of - kBlock * g, 0, kBlock - 1));
  const double u = x - static_cast<double>(kBlock * g + out.o);
  const int p = about_.motion[i].derivative;
  Basis b[5];
  spline_.bases(u, p, 5, b);
  double by_s[kLocal], by_kappa[kLocal];
  bending.rows(b, kLocal, out.b.data(), by_s, by_kappa);
  for (std::size_t j = 0; j < kComponents; ++j) {
    out.by_s[j] = out.by_kappa[j] = 0.0;
    out.residual[j] =
        row.value[j] - (columns_.bias[i] >= 0 ? theta[columns_.bias[i] + static_cast<int>(j)] : 0.0);
  }
  for (int l = 0; l < kLocal; ++l) {
    const double* c = xx + kComponents * (out.o + l);
    dense::add<6>(out.residual, -out.b[l], c);
    dense::add<6>(out.by_s, by_s[l], c);
    dense::add<6>(out.by_kappa, by_kappa[l], c);
  }
  for (std::size_t j = 0; j < kComponents; ++j) out.residual[j] *= row.have[j];
  return true;
}

// Rows of (10.4).
inline void Lag::add_motion(Front& f, double* P, double* N, long g, bool last, const double* xx,
                            SizeSums& sums) {
  for (std::size_t i = 0; i < streams_; ++i) {
    const MotionStream& stream = about_.motion[i];
    double information[kComponents];
    for (int j = 0; j < kComponents; ++j) information[j] = 1.0 / (motion_noise(i, j) * motion_noise(i, j));
    for (int o = 0; o < kBlock; ++o) interval(kBlock * g + o).motion[i].fill(0.0);
    const int s_at = columns_.clock[i], bias = columns_.bias[i];
    Placed row_at;
    for (; f.next[i] < motion_[i].end(); ++f.next[i]) {
      const MotionRow& row = motion_[i][f.next[i]];
      if (!placed(i, row, g, last, xx, row_at)) break;
      const Places at = shape_.places(row_at.o, P, N);
      double* products = interval(kBlock * g + row_at.o).motion[i].data();
      const double* b = row_at.b.data();
      for (int k = 0; k < kLocal; ++k)
        for (int l = k; l < kLocal; ++l)
          dense::add<6>(products + knot_pair(k, l) * kComponents, row.size * b[k] * b[l], row.have.data());
      for (int j = 0; j < kComponents; ++j) {
        const auto ju = static_cast<std::size_t>(j);
        if (row.have[ju] == 0.0) continue;
        const auto group = static_cast<std::size_t>(stream.group[j]);
        sums.motion[i][group] += (row.size * row_at.residual[j] * row_at.residual[j] + row.remainder[ju]) /
                                 (stream.sigma[j] * stream.sigma[j]);
        sums.motion_count[i][group] += 1.0 + row.spared;
        const double y = row.size * information[j], r = y * row_at.residual[j], by_s = row_at.by_s[j],
                     by_kappa = row_at.by_kappa[j];
        for (int k = 0; k < kLocal; ++k) {
          double* to = at.row[k] + j * shape_.ld + kTheta;
          to[nt_] += b[k] * r;
          to[s_at] += y * b[k] * by_s;
          to[s_at + 1] += y * b[k] * by_kappa;
          if (bias >= 0) to[bias + j] += y * b[k];
        }
        f.T[shape_.tt(s_at, s_at)] += y * by_s * by_s;
        f.T[shape_.tt(s_at, s_at + 1)] += y * by_s * by_kappa;
        f.T[shape_.tt(s_at + 1, s_at + 1)] += y * by_kappa * by_kappa;
        f.T[shape_.tt(s_at, nt_)] += r * by_s;
        f.T[shape_.tt(s_at + 1, nt_)] += r * by_kappa;
        if (bias < 0) continue;
        f.T[shape_.tt(bias + j, bias + j)] += y;
        f.T[shape_.tt(bias + j, nt_)] += r;
        f.T[shape_.tt(bias + j, s_at)] += y * by_s;
        f.T[shape_.tt(bias + j, s_at + 1)] += y * by_kappa;
      }
    }
    for (int o = 0; o < kBlock; ++o) {
      const Places at = shape_.places(o, P, N);
      const double* products = interval(kBlock * g + o).motion[i].data();
      for (int k = 0; k < kLocal; ++k)
        for (int l = k; l < kLocal; ++l)
          for (int j = 0; j < kComponents; ++j)
            at.row[k][j * shape_.ld + at.column[k][l] + j] +=
                information[j] * products[knot_pair(k, l) * kComponents + j];
    }
  }
}

// A front's information vector less (sign -1) or plus (1) Lambda [x; theta], x the coefficients of its block.
inline void Lag::turn(Front& f, const double* x, double sign) {
  const double* t = z_.data();
  double Hx[kWidth] = {};
  for (int i = 0; i < kWidth; ++i) {
    const double* row = f.panel.data() + i * shape_.ld;
    Hx[i] += dense::dot(row + i, x + i, kWidth - i) + dense::dot(row + kTheta, t, nt_);
    dense::add(Hx + i + 1, x[i], row + i + 1, kWidth - i - 1);
  }
  double* column = T_.data();
  std::fill_n(column, nt_, 0.0);
  for (int k = 0; k < nt_; ++k) {  // a row of T: what the diagonal and the columns after it see, and
                                   // what they give back
    const double* row = f.T.data() + k * shape_.ldt;
    f.T[shape_.tt(k, nt_)] += sign * dense::dot(row + k, t + k, nt_ - k);
    dense::add(column + k + 1, t[k], row + k + 1, nt_ - k - 1);
  }
  for (int i = 0; i < kWidth; ++i) dense::add(column, x[i], f.panel.data() + i * shape_.ld + kTheta, nt_);
  for (int k = 0; k < nt_; ++k) f.T[shape_.tt(k, nt_)] += sign * column[k];
  for (int i = 0; i < kWidth; ++i)
    f.panel[static_cast<std::size_t>(i * shape_.ld + kTheta + nt_)] += sign * Hx[i];
}

// Squares of the motion's rows about the motion as it stands, from where a front has eliminated on.
inline SizeSums Lag::departures(const Front& f) {
  SizeSums sums;
  auto next = f.next;
  double xx[2 * kWidth];
  Placed at;
  for (long g = first(); g < end(); ++g) {
    coefficients(g, xx);
    for (std::size_t i = 0; i < streams_; ++i)
      for (; next[i] < motion_[i].end(); ++next[i]) {
        const MotionRow& row = motion_[i][next[i]];
        if (!placed(i, row, g, false, xx, at)) break;
        for (int j = 0; j < kComponents; ++j) {
          if (row.have[static_cast<std::size_t>(j)] == 0.0) continue;
          const auto group = static_cast<std::size_t>(about_.motion[i].group[j]);
          const double sigma = about_.motion[i].sigma[j];
          sums.motion[i][group] += row.size * at.residual[j] * at.residual[j] / (sigma * sigma);
          sums.motion_count[i][group] += 1.0;
        }
      }
  }
  return sums;
}

inline bool Lag::eliminate(Front& f, long from, long to, bool last) {
  if (from == to) return true;
  refresh();
  turn(f, block(from).x.data(), -1.0);  // to the gradient at the coefficients and theta as they stand
  for (long g = from; g < to; ++g)
    if (!eliminate_block(f, g, last && g + 1 == to)) return false;
  turn(f, block(to).x.data(), 1.0);
  return true;
}

// A block behind a front that is turned to the gradient.
inline bool Lag::eliminate_block(Front& f, long g, bool last) {
  Block& B = block(g);
  B.alone = false;
  double xx[2 * kWidth];
  coefficients(g, xx);
  std::swap(B.panel, f.panel);
  std::fill(f.panel.begin(), f.panel.end(), 0.0);
  double *P = B.panel.data(), *N = f.panel.data();
  B.sums = SizeSums();
  add_smoothness(shape_, P, N, xx, &B.sums);
  add_motion(f, P, N, g, last, xx, B.sums);
  for (int o = 0; o < kBlock; ++o) {
    const Places at = shape_.places(o, P, N);
    each_cells(interval(kBlock * g + o), [&](const Interval& v, unsigned same, RawSums& out) {
      sum_rows(f, v, same, out, at, B.sums);
    });
  }
  if (!shape_.eliminate(P, N, f.T.data(), f.logdet)) return false;
  // in absolute coordinates: R^-T of [H, H of the next block, H_xt] [x; x of the next; theta]
  for (int i = 0; i < kWidth; ++i) {
    double* row = P + i * shape_.ld;
    row[kTheta + nt_] += dense::dot(row + i, xx + i, kWidth - i) +
                         dense::dot(row + kPadded, xx + kWidth, kWidth) +
                         dense::dot(row + kTheta, z_.data(), nt_);
  }
  return true;
}

inline double Lag::terminal(const Front& f, Eigen::MatrixXd& S) {
  std::copy(f.panel.begin(), f.panel.end(), last_.begin());
  std::copy(f.T.begin(), f.T.end(), T_.begin());
  last_alone_ = false;
  double logdet = f.logdet;
  if (!shape_.eliminate(last_.data(), nullptr, T_.data(), logdet)) return std::nan("");
  for (int i = 0; i <= nt_; ++i)
    std::copy(T_.begin() + i * shape_.ldt + i, T_.begin() + i * shape_.ldt + nt_ + 1,
              S.data() + i * (nt_ + 1) + i);
  return logdet;
}

inline bool Lag::terminal(const Front& moving) {
  std::copy(moving.panel.begin(), moving.panel.end(), last_.begin());
  double logdet = 0.0;
  last_alone_ = true;
  return dense::factor(last_.data(), alone_.ld, kWidth, logdet);
}

inline void Lag::back(long from) {
  refresh();
  double x[2 * kWidth] = {};  // of a block and the next
  for (long g = end_; g >= from; --g) {
    const Shape& shape = (g == end_ ? last_alone_ : block(g).alone) ? alone_ : shape_;
    const double* P = g == end_ ? last_.data() : block(g).panel.data();
    std::copy_n(x, kWidth, x + kWidth);
    for (int i = kWidth - 1; i >= 0; --i) {
      const double* row = P + i * shape.ld;
      double sum = row[kTheta + shape.nt] - dense::dot(row + kTheta, z_.data(), shape.nt) -
                   dense::dot(row + i + 1, x + i + 1, kWidth - i - 1);
      if (g < end_) sum -= dense::dot(row + kPadded, x + kWidth, kWidth);
      x[i] = sum / row[i];
    }
    std::copy_n(x, kWidth, block(g).x.data());
  }
}

inline void Lag::know_theta(const Front& f, Front& moving) {
  refresh();
  std::fill(moving.panel.begin(), moving.panel.end(), 0.0);
  for (int i = 0; i < kWidth; ++i) {
    const double* row = f.panel.data() + i * shape_.ld;
    double* to = moving.panel.data() + i * alone_.ld;
    std::copy(row + i, row + kWidth, to + i);
    to[kTheta] = row[kTheta + nt_] - dense::dot(row + kTheta, z_.data(), nt_);
  }
  moving.next = f.next;
}

inline void Lag::expect(Front& moving, long g, bool last) {
  Block& B = block(g);
  B.alone = true;
  double *P = B.panel.data(), *N = moving.panel.data();
  std::copy(moving.panel.begin(), moving.panel.end(), P);
  std::fill(moving.panel.begin(), moving.panel.end(), 0.0);
  add_smoothness(alone_, P, N, nullptr, nullptr);
  const double none[2 * kWidth] = {};
  for (std::size_t i = 0; i < streams_; ++i) {
    Placed row_at;
    for (long& r = moving.next[i]; r < motion_[i].end(); ++r) {
      const MotionRow& row = motion_[i][r];
      if (!placed(i, row, g, last, none, row_at)) break;  // the residual of nothing: the value
      const Places at = alone_.places(row_at.o, P, N);
      for (int j = 0; j < kComponents; ++j) {
        const double v =
            row.have[static_cast<std::size_t>(j)] * row.size / (motion_noise(i, j) * motion_noise(i, j));
        for (int k = 0; k < kLocal; ++k) {
          double* to = at.row[k] + j * alone_.ld;
          to[kTheta] += v * row_at.b[k] * row_at.residual[j];
          for (int l = k; l < kLocal; ++l) to[at.column[k][l] + j] += v * row_at.b[k] * row_at.b[l];
        }
      }
    }
  }
  double *own = work_.data(), *next = own + kWidth * alone_.ld, square[8] = {}, logdet = 0.0;
  std::copy_n(P, kWidth * alone_.ld, own);
  std::copy_n(N, kWidth * alone_.ld, next);
  if (!alone_.eliminate(own, next, square, logdet) || !dense::factor(next, alone_.ld, kWidth, logdet)) return;
  double x[2 * kWidth] = {};
  for (const bool second : {true, false})
    for (int i = kWidth - 1; i >= 0; --i) {
      const double* row = (second ? next : own) + i * alone_.ld;
      double* to = second ? x + kWidth : x;
      double sum = row[kTheta] - dense::dot(row + i + 1, to + i + 1, kWidth - i - 1);
      if (!second) sum -= dense::dot(row + kPadded, x + kWidth, kWidth);
      to[i] = sum / row[i];
    }
  std::copy_n(x, kWidth, B.x.data());
  std::copy_n(x + kWidth, kWidth, block(g + 1).x.data());
}

inline bool Lag::join(Front& moving, long g) {
  double *P = block(g).panel.data(), *N = moving.panel.data(), xx[2 * kWidth], square[8] = {}, logdet = 0.0;
  coefficients(g, xx);
  // the gradient at what was expected: of the sensor's rows alone
  for (int i = 0; i < kWidth; ++i) P[i * alone_.ld + kTheta] = N[i * alone_.ld + kTheta] = 0.0;
  for (int o = 0; o < kBlock; ++o) {
    const Places at = alone_.places(o, P, N);
    each_cells(interval(kBlock * g + o), [&](const Interval& v, unsigned same, RawSums& out) {
      if (!gather_rows(v, same, out)) return;
      for (int r = 0; r < rows_; ++r) {
        const RawRow& row = *row_[static_cast<std::size_t>(r)];
        sums_.add_motion(out, row.weight * row.size, row.basis.data(), row.cw.data(), row.residual.data());
      }
      sums_.finish_alone(out);
      sums_.add_band<kComponents>(out, at);
      sums_.add_gradient(at, 0);
    });
  }
  if (!alone_.eliminate(P, N, square, logdet)) return false;
  // and back to absolute coordinates
  double Hx[kWidth] = {};
  for (int i = 0; i < kWidth; ++i) {
    double* row = P + i * alone_.ld;
    row[kTheta] += dense::dot(row + i, xx + i, kWidth - i) + dense::dot(row + kPadded, xx + kWidth, kWidth);
    const double *of = N + i * alone_.ld, *x = xx + kWidth;
    Hx[i] += dense::dot(of + i, x + i, kWidth - i);
    dense::add(Hx + i + 1, x[i], of + i + 1, kWidth - i - 1);
  }
  for (int i = 0; i < kWidth; ++i) N[i * alone_.ld + kTheta] += Hx[i];
  return true;
}

// By selected inversion: S_gh = - G S_hh, S_gg = R^-1 R^-T - S_gh G^T, h the
// next block, G = R^-1 R^-T H_gh; theta known.
inline void Lag::traces(long from) {
  std::array<Gram, kComponents> R;
  for (int j = 0; j < kComponents; ++j) R[static_cast<std::size_t>(j)] = smoothness(j);
  for (long g = end_; g >= from; --g) {
    const double* P = g == end_ ? last_.data() : block(g).panel.data();
    const bool free = g == end_;
    std::swap(here_, next_);
    double* here = here_.data();
    shape_.invert(P, free, inverse_.data(), kTheta, V_.data(), here, next_.data());
    if (free) continue;
    SizeSums& sums = block(g).sums;
    sums.raw_trace.fill(0.0);
    sums.energy_trace.fill(0.0);
    for (auto& m : sums.motion_trace) m.fill(0.0);
    for (int o = 0; o < kBlock; ++o) {
      const Interval& v = interval(kBlock * g + o);
      for (int k = 0; k < kLocal; ++k)
        for (int l = k; l < kLocal; ++l) {
          const double* cov = shape_.covariance(here, next_.data(), o + k, o + l);
          for (int j = 0; j < kComponents; ++j) {
            const auto ju = static_cast<std::size_t>(j);
            const double own = (k == l ? 1.0 : 2.0) * cov[j * kTheta + j];
            sums.energy_trace[ju] += own * R[ju](k, l) / sizes.q[j];
            for (std::size_t i = 0; i < streams_; ++i)
              sums.motion_trace[i][static_cast<std::size_t>(about_.motion[i].group[j])] +=
                  own * v.motion[i][static_cast<std::size_t>(knot_pair(k, l) * kComponents + j)] /
                  (motion_noise(i, j) * motion_noise(i, j));
          }
        }
      if (v.rows > 0 && *std::max_element(v.sums.v.begin(), v.sums.v.end()) > 0.0)
        sums_.trace<kComponents>(v.sums, shape_, here, next_.data(), o, sums.raw_trace.data());
    }
  }
}

inline double Lag::objective(long g, Cursor& next, bool last) const {
  double sum = 0.0, xx[2 * kWidth];
  coefficients(g, xx);
  for (int o = 0; o < kBlock; ++o) {
    const Interval& v = interval(kBlock * g + o);
    for (int r = 0; r < v.rows; ++r) {
      const RawRow& row = v.row[static_cast<std::size_t>(r)];
      sum += row.size * robust_sum(row.channels, chi2(v, row));
    }
  }
  for (int j = 0; j < kComponents; ++j) {
    const Gram R = smoothness(j);
    for (int o = 0; o < kBlock; ++o)
      for (int k = 0; k < kLocal; ++k)
        for (int l = 0; l < kLocal; ++l) {
          const double* x = xx + kComponents * o + j;
          sum += R(k, l) / sizes.q[j] * (x[kComponents * k] - x[0]) * (x[kComponents * l] - x[0]);
        }
  }
  for (std::size_t i = 0; i < streams_; ++i) {
    Placed row_at;
    for (; next[i] < motion_[i].end(); ++next[i]) {
      const MotionRow& row = motion_[i][next[i]];
      if (!placed(i, row, g, last, xx, row_at)) break;
      for (int j = 0; j < kComponents; ++j) {
        const double v = 1.0 / (motion_noise(i, j) * motion_noise(i, j));
        sum += v * (row.size * row_at.residual[j] * row_at.residual[j] +
                    row.remainder[static_cast<std::size_t>(j)]);
      }
    }
  }
  return sum;
}

inline double Lag::objective(const Front& f, long g) const {
  double sum = 0.0;
  const double *x = block(g).x.data(), *t = z_.data();
  for (int i = 0; i < kWidth; ++i) {
    const double* row = f.panel.data() + i * shape_.ld;
    sum += x[i] * (row[i] * x[i] + 2.0 * (dense::dot(row + i + 1, x + i + 1, kWidth - i - 1) +
                                          dense::dot(row + kTheta, t, nt_) - row[kTheta + nt_]));
  }
  for (int k = 0; k < nt_; ++k) {
    const double* row = f.T.data() + k * shape_.ldt;
    sum += t[k] * (row[k] * t[k] + 2.0 * (dense::dot(row + k + 1, t + k + 1, nt_ - k - 1) - row[nt_]));
  }
  return sum;
}

}  // namespace truewrench
