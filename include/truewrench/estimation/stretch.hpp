// One gap-free stretch of a log: its samples, its splines, and what the model predicts at them (METHOD 10.1).
#pragma once

#include "truewrench/estimation/row_sums.hpp"
#include "truewrench/model/gravity.hpp"

#include <cstddef>
#include <vector>

namespace truewrench {

using Components = Eigen::Matrix<double, 1, Eigen::Dynamic, Eigen::RowMajor, 1, max_components>;

// Samples of the sensor that one stretch holds, sorted by time.
struct RawRows {
  std::vector<Eigen::Index> source;  // row of the log
  std::vector<Eigen::Index> interval;
  std::vector<std::array<Basis, 3>> basis;  // B, B', B'' at it
  Eigen::VectorXd time;
  RowMatrix value;           // (K, n), NaN where missing
  Eigen::VectorXd size;      // samples that a row stands for
  RowMatrix remainder;       // (K, n) their sum of squares about it
  Eigen::VectorXd weight;    // w_t of 10.3, times size; 0 where masked
  Eigen::VectorXi channels;  // n_t
  std::vector<char> masked;

  Eigen::Index rows() const { return time.size(); }
  // Mean square of a channel's samples about their row.
  double spread(Eigen::Index k, int channel) const {
    return remainder.rows() > 0 ? remainder(k, channel) / size[k] : 0.0;
  }
};

struct MotionRows {
  Eigen::VectorXd time, size;  // [s]; samples that a row stands for
  RowMatrix value;
  Eigen::VectorXd remainder, samples;  // (M) squares about the rows; how many samples are there
  // at t + s, after every prediction:
  std::vector<Eigen::Index> interval;
  RowMatrix basis;           // (K, 6) of the prediction (10.4)
  RowMatrix by_s, by_kappa;  // (K, M)
  RowMatrix residual;        // (K, M), 0 where missing

  Eigen::Index rows() const { return time.size(); }
  // Sum of the squares of a component's residuals.
  double squares(int j) const {
    double sum = remainder[j];
    for (Eigen::Index k = 0; k < rows(); ++k) sum += size[k] * residual(k, j) * residual(k, j);
    return sum;
  }
};

// What a prediction leaves behind, a row a sample.
struct Prediction {
  RowMatrix nu, a, g;  // SI; g: that the sensor feels, (10.5)
  RowMatrix jerk;      // (K, 6) nuddot, 0 but for a twist
  RowMatrix w;         // (K, 6) fractions of range, with the sign of the rig
  RowMatrix cw;        // (K, n) C_0 w
  RowMatrix residual;  // (K, n), 0 where missing
};

// How many values of a row are there.
inline int finite_in(const RowMatrix& m, Eigen::Index row) {
  int count = 0;
  for (Eigen::Index j = 0; j < m.cols(); ++j) count += std::isfinite(m(row, j)) ? 1 : 0;
  return count;
}

class Stretch {
 public:
  Stretch() = default;
  // The samples of `log` between two times.
  Stretch(const RecordedLog& log, const Statement& rig, double begin, double end, double period, double h)
      : Stretch(log, rig, Spline(begin - 0.5 * period, end - begin + period, h), begin - 0.5 * period,
                end + 0.5 * period) {}
  // Those of a spline's span that lie between two times.
  Stretch(const RecordedLog& log, const Statement& rig, const Spline& on, double begin, double end)
      : spline(on),
        log_(&log),
        rig_(&rig),
        M_(log.components()),
        n_(static_cast<int>(rig.noise.size())),
        begin_(begin),
        end_(end) {
    raw.source.reserve(static_cast<std::size_t>(log.time.size()));
    for (Eigen::Index k = 0; k < log.time.size(); ++k) {
      if (!(log.time[k] >= begin && log.time[k] <= end)) continue;
      if (finite_in(log.raw, k) == 0) continue;
      raw.source.push_back(k);
    }
    const auto rows = static_cast<Eigen::Index>(raw.source.size());
    raw.time.resize(rows);
    raw.value.resize(rows, n_);
    raw.size = Eigen::VectorXd::Ones(rows);
    raw.remainder = RowMatrix::Zero(log.size.size() > 0 ? rows : 0, n_);
    raw.channels.resize(rows);
    raw.masked.assign(static_cast<std::size_t>(rows), 0);
    raw.interval.reserve(static_cast<std::size_t>(rows));
    raw.basis.reserve(static_cast<std::size_t>(rows));
    for (Eigen::Index k = 0; k < rows; ++k) {
      const Eigen::Index at = raw.source[static_cast<std::size_t>(k)];
      double u = 0.0;
      raw.time[k] = log.time[at];
      raw.interval.push_back(spline.locate(raw.time[k], u));
      raw.basis.emplace_back();
      spline.bases(u, 0, 3, raw.basis.back().data());
      std::copy_n(log.raw.data() + at * n_, n_, raw.value.data() + k * n_);
      raw.channels[k] = finite_in(raw.value, k);
      if (log.size.size() == 0) continue;
      raw.size[k] = log.size[at];
      std::copy_n(log.remainder.data() + at * n_, n_, raw.remainder.data() + k * n_);
    }
    raw.weight = raw.size;
    for (const MotionStream& stream : log.motion) {
      MotionRows m;
      std::vector<Eigen::Index> at;
      at.reserve(static_cast<std::size_t>(stream.time.size()));
      for (Eigen::Index k = 0; k < stream.time.size(); ++k)
        if (stream.time[k] >= begin && stream.time[k] <= end && finite_in(stream.value, k) > 0)
          at.push_back(k);
      m.time.resize(static_cast<Eigen::Index>(at.size()));
      m.value.resize(m.rows(), M_);
      m.size = Eigen::VectorXd::Ones(m.rows());
      m.remainder = m.samples = Eigen::VectorXd::Zero(M_);
      for (Eigen::Index k = 0; k < m.rows(); ++k) {
        const Eigen::Index from = at[static_cast<std::size_t>(k)];
        m.time[k] = stream.time[from];
        std::copy_n(stream.value.data() + from * M_, M_, m.value.data() + k * M_);
        const bool gathered = stream.size.size() > 0;
        if (gathered) m.size[k] = stream.size[from];
        for (int j = 0; j < M_; ++j) {
          if (!std::isfinite(m.value(k, j))) continue;
          m.samples[j] += m.size[k];
          if (gathered) m.remainder[j] += stream.remainder(from, j);
        }
      }
      motion.push_back(std::move(m));
    }
    c = RowMatrix::Zero(spline.size(), M_);
    e = RowMatrix::Zero(spline.size(), n_);
  }

  // Leaves nothing but spline, coefficients and mask; and makes the rest anew, if the log has the same samples.
  void put_away() {
    std::vector<char> masked = std::move(raw.masked);
    raw = RawRows();
    raw.masked = std::move(masked);
    motion = std::vector<MotionRows>();
    now = Prediction();
    mapped = MappedMotion();
    averaged = {};
    mapped_at_ = RowMatrix();
    log_ = nullptr;
    rig_ = nullptr;
  }
  bool take_up(const RecordedLog& log, const Statement& rig) {
    Stretch anew(log, rig, spline, begin_, end_);
    if (anew.raw.masked.size() != raw.masked.size()) return false;
    anew.raw.masked = std::move(raw.masked);
    anew.c = std::move(c);
    anew.e = std::move(e);
    *this = std::move(anew);
    return true;
  }

  const RecordedLog& log() const { return *log_; }
  const Statement& rig() const { return *rig_; }
  int components() const { return M_; }
  int channels() const { return n_; }

  Spline spline;
  RawRows raw;
  std::vector<MotionRows> motion;
  RowMatrix c, e;  // (N, M) and (N, n): coefficients of the motion and of the discrepancy
  Prediction now;
  MappedMotion mapped;                   // of a mapped motion, at the raw samples
  std::array<MappedMotion, 2> averaged;  // and about them, where the sensor averages: see evaluate_motion()

  // Residuals of all rows at theta, in the places of `columns`; `lagged`: C_0 (n, 6); with the discrepancy or without.
  void predict(const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
               bool discrepancy) {
    predict_motion(columns, theta);
    predict_raw(columns, theta, lagged, discrepancy);
  }

  // The twist and its derivative at the raw samples alone; `late` [s]: of what carries the arm, which has the stamps of the
  // motion and not the sensor's. Of a mapped motion X = (x, x', x'') the mean of w over what a filter of the sensor averages is that
  // of X -+ sqrt(v) Xdot, to third order in it: of a quadratic w wrench_read()'s.                                          (10.4)
  void evaluate_motion(double late, bool jerk, const Bending& bending) {
    const Eigen::Index rows = raw.rows();
    for (RowMatrix* m : {&now.nu, &now.a}) m->resize(rows, 6);
    if (now.jerk.rows() != rows) now.jerk = RowMatrix::Zero(rows, 6);
    if (log_->source == Source::mapped) {
      // of theta the delay and the filter alone play a part in it
      const std::array<double, 3> times{late, std::sqrt(bending.averaged()), bending.skewed()};
      if (mapped_at_.size() == c.size() && mapped_at_ == c && mapped_times_ == times) return;
      std::array<RowMatrix, 5> x;
      for (std::size_t p = 0; p < (times[1] > 0.0 ? 5 : 3); ++p) {
        x[p].resize(rows, M_);
        for (Eigen::Index k = 0; k < rows; ++k) derivative_at(k, p, x[p].data() + k * M_);
      }
      const Eigen::VectorXd at = (raw.time.array() - late).matrix();
      log_->map(at, x[0], x[1], x[2], true, mapped);
      for (std::size_t i = 0; times[1] > 0.0 && i < averaged.size(); ++i) {
        const double shift = i == 0 ? -times[1] : times[1];
        std::array<RowMatrix, 3> moved;
        for (std::size_t p = 0; p < 3; ++p) moved[p] = x[p] + shift * (x[p + 1] - times[2] * x[p + 2]);
        log_->map((at.array() + shift).matrix(), moved[0], moved[1], moved[2], false, averaged[i]);
      }
      now.nu = mapped.nu;
      now.a = mapped.a;
      mapped_at_ = c;
      mapped_times_ = times;
      return;
    }
    double x0[max_components], x1[max_components], x2[max_components];
    for (Eigen::Index k = 0; k < rows; ++k) {
      value_at(k, 0, c, x0);
      value_at(k, 1, c, x1);
      double *nu = now.nu.data() + 6 * k, *a = now.a.data() + 6 * k;
      const bool imu = log_->source == Source::imu;  // a_s takes the place of vdot + Omega x v - g
      for (int j = 0; j < 6; ++j) {
        nu[j] = imu && j < 3 ? 0.0 : x0[j];
        a[j] = imu && j < 3 ? x0[j] : x1[j];
      }
      if (imu || !jerk) continue;
      value_at(k, 2, c, x2);
      std::copy_n(x2, 6, now.jerk.data() + 6 * k);
    }
  }

  // A p-th derivative of splines at a raw sample, to `out`.
  void value_at(Eigen::Index k, std::size_t p, const RowMatrix& coefficients, double* out) const {
    const auto i = static_cast<std::size_t>(k);
    combine(raw.basis[i][p].data(), raw.interval[i], coefficients, out);
  }
  // Of the motion; beyond those that raw.basis has, too.
  void derivative_at(Eigen::Index k, std::size_t p, double* out) const {
    if (p < raw.basis[static_cast<std::size_t>(k)].size()) return value_at(k, p, c, out);
    double u = 0.0;
    const Eigen::Index at = spline.locate(raw.time[k], u);
    combine(spline.basis(u, static_cast<int>(p)).data(), at, c, out);
  }
  Components value_at(Eigen::Index k, std::size_t p, const RowMatrix& coefficients) const {
    Components out(coefficients.cols());
    value_at(k, p, coefficients, out.data());
    return out;
  }
  static void combine(const double* basis, Eigen::Index interval, const RowMatrix& coefficients,
                      double* out) {
    const Eigen::Index columns = coefficients.cols();
    const double* x = coefficients.data() + interval * columns;
    if (columns == 6) {
      double sum[6] = {};
      for (int l = 0; l < kLocal; ++l)
        for (int j = 0; j < 6; ++j) sum[j] += basis[l] * x[6 * l + j];
      std::copy_n(sum, 6, out);
      return;
    }
    std::fill_n(out, columns, 0.0);
    for (int l = 0; l < kLocal; ++l)
      for (Eigen::Index j = 0; j < columns; ++j) out[j] += basis[l] * x[l * columns + j];
  }

  Vector6 jerk_at(Eigen::Index k) const { return row_of(now.jerk, k); }
  Matrix3 rotation_at(Eigen::Index k) const {
    return log_->source == Source::mapped
               ? rotation_of(mapped.R_sensor_root, k)
               : rotation_of(log_->R_sensor_root, raw.source[static_cast<std::size_t>(k)]);
  }
  bool gravity() const {
    return log_->source != Source::imu &&
           (rig_->gravity[0] != 0.0 || rig_->gravity[1] != 0.0 || rig_->gravity[2] != 0.0);
  }

 private:
  const RecordedLog* log_ = nullptr;
  const Statement* rig_ = nullptr;
  int M_ = 6, n_ = 6;
  double begin_ = 0.0, end_ = 0.0;        // [s] of the samples
  RowMatrix mapped_at_;                   // the coefficients that `mapped` is of
  std::array<double, 3> mapped_times_{};  // [s] and the delay, and of what is averaged the width and how late

  static Matrix3 rotation_of(const RowMatrix& rows, Eigen::Index k) {
    const double* of = rows.data() + 9 * k;
    Matrix3 R;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) R(i, j) = of[3 * i + j];
    return R;
  }
  static Vector6 row_of(const RowMatrix& rows, Eigen::Index k) {
    return Vector6(Eigen::Map<const Vector6>(rows.data() + 6 * k));
  }

  // twist = nu(t + s) + (kappa - 1/2) (s^2 + r^2) nuddot + sigma_v eps, r half of what a sample averages; third order: Bending
  //                                                                                                               (10.4)
  void predict_motion(const Columns& columns, const Eigen::VectorXd& theta) {
    for (std::size_t i = 0; i < motion.size(); ++i) {
      MotionRows& m = motion[i];
      const int p = log_->motion[i].derivative;
      const double s = theta[columns.clock[i]];
      const Bending bending = log_->bending(i, s, theta[columns.clock[i] + 1]);
      const int bias = columns.bias[i];
      const Eigen::Index rows = m.rows();
      m.interval.resize(static_cast<std::size_t>(rows));
      m.basis.resize(rows, kLocal);
      for (RowMatrix* x : {&m.by_s, &m.by_kappa, &m.residual}) x->resize(rows, M_);
      Basis b[5];
      for (Eigen::Index k = 0; k < rows; ++k) {
        double u = 0.0;
        const Eigen::Index at = spline.locate(m.time[k] + s, u);
        m.interval[static_cast<std::size_t>(k)] = at;
        spline.bases(u, p, 5, b);
        double *basis = m.basis.data() + k * kLocal, by_s[kLocal], by_kappa[kLocal];
        bending.rows(b, kLocal, basis, by_s, by_kappa);
        combine(by_s, at, c, m.by_s.data() + k * M_);
        combine(by_kappa, at, c, m.by_kappa.data() + k * M_);
        double* residual = m.residual.data() + k * M_;
        combine(basis, at, c, residual);
        const double* value = m.value.data() + k * M_;
        for (int j = 0; j < M_; ++j) {
          const double r = value[j] - residual[j] - (bias >= 0 ? theta[bias + j] : 0.0);
          residual[j] = std::isfinite(r) ? r : 0.0;
        }
      }
    }
  }

  // raw = C w + b + u (C_0 w)^2 + ramps + sum a 1[t >= t_j] + d + slope dT                                         (10.3)
  void predict_raw(const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged,
                   bool discrepancy) {
    const bool imu = log_->source == Source::imu;
    const int clock = columns.clock[0];
    const Bending bending = log_->bending(0, theta[clock], theta[clock + 1]);
    evaluate_motion(log_->carried ? theta[clock] : 0.0, gravity() || bending.averaged() > 0.0, bending);
    const bool beside = log_->source == Source::mapped && bending.averaged() > 0.0;
    const Eigen::Index rows = raw.rows();
    now.g.resize(rows, 3);
    now.w.resize(rows, 6);
    now.cw.resize(rows, n_);
    now.residual.resize(rows, n_);
    const Payload body = departed(log_->payload, body_of(columns, theta));
    const double *C = theta.data() + columns.C, *b = theta.data() + columns.b,
                 *quadratic = theta.data() + columns.u;
    const Gravity gravity_now = gravity_of(columns, theta);
    double d[max_components] = {};
    for (Eigen::Index k = 0; k < rows; ++k) {
      const Vector6 nu = row_of(now.nu, k), a = row_of(now.a, k), jerk = jerk_at(k);
      const Vector3 g = gravity() ? gravity_now.felt(rotation_at(k), nu, a, angular(jerk)) : Vector3::Zero();
      Vector6 wrench = Vector6::Zero();
      for (std::size_t i = 0; beside && i < averaged.size(); ++i) {
        const MappedMotion& at = averaged[i];
        const Vector3 felt =
            gravity() ? gravity_now.in_sensor(rotation_of(at.R_sensor_root, k)) : Vector3::Zero();
        const Vector6 one = wrench_about(body, log_->point, row_of(at.nu, k), row_of(at.a, k), felt);
        for (int j = 0; j < 6; ++j) wrench[j] += 0.5 * one[j];
      }
      if (!beside) wrench = wrench_read(body, log_->point, nu, a, jerk, g, bending, imu);
      double *w = now.w.data() + 6 * k, *cw = now.cw.data() + n_ * k,
             *residual = now.residual.data() + n_ * k;
      for (int j = 0; j < 3; ++j) now.g(k, j) = g[j];
      for (int j = 0; j < 6; ++j) w[j] = rig_->sign / rig_->range[j] * wrench[j];
      if (discrepancy) value_at(k, 0, e, d);
      const double warm = columns.slope >= 0 ? warmth(k) : 0.0, *value = raw.value.data() + n_ * k;
      for (int i = 0; i < n_; ++i) {
        double sum = b[i], with = 0.0;
        for (int j = 0; j < 6; ++j) {
          sum += C[6 * i + j] * w[j];
          with += lagged.data()[6 * i + j] * w[j];
        }
        cw[i] = with;
        sum += quadratic[i] * with * with + d[i];
        for (std::size_t j = 0; j < columns.ramps.size(); ++j)
          sum += columns.ramped(j, raw.time[k]) * theta[columns.ramps[j] + i];
        for (std::size_t j = 0; j < columns.steps.size(); ++j)
          if (raw.time[k] >= columns.step_times[j]) sum += theta[columns.steps[j] + i];
        if (columns.slope >= 0) sum += warm * theta[columns.slope + i];
        residual[i] = std::isfinite(value[i]) ? value[i] - sum : 0.0;
      }
    }
  }

 public:
  static BodyVector body_of(const Columns& columns, const Eigen::VectorXd& theta) {
    BodyVector out = BodyVector::Zero();
    if (columns.body >= 0) std::copy_n(theta.data() + columns.body, kBodyParameters, out.data());
    return out;
  }
  Gravity gravity_of(const Columns& columns, const Eigen::VectorXd& theta) const {
    return {*rig_, of_root(columns), theta.data(), gravity(), log_->half_window, log_->clock_set};
  }
  Columns of_root(const Columns& columns) const { return columns.in_root(0.5 * (begin_ + end_)); }
  double warmth(Eigen::Index k) const {
    const double t =
        log_->temperature.size() > 0 ? log_->temperature[raw.source[static_cast<std::size_t>(k)]] : 0.0;
    return std::isfinite(t) ? t : 0.0;
  }
};

}  // namespace truewrench
