// One gap-free stretch of a log: its samples, its splines, and what the model predicts at them (METHOD 10.1).
#pragma once

#include "truewrench/math/spline.hpp"
#include "truewrench/model/parameters.hpp"

#include <cstddef>
#include <vector>

namespace truewrench {

inline constexpr int max_components = 32;  // of a motion, or channels
using Components = Eigen::Matrix<double, 1, Eigen::Dynamic, Eigen::RowMajor, 1, max_components>;

// Samples of the sensor that one stretch holds, sorted by time.
struct RawRows {
  std::vector<Eigen::Index> source;    // row of the log
  std::vector<Eigen::Index> interval;
  std::vector<std::array<Basis, 3>> basis;  // B, B', B'' at it
  Eigen::VectorXd time;
  RowMatrix value;    // (K, n), NaN where missing
  Eigen::VectorXd weight;  // w_t of 10.3, 0 where masked
  Eigen::VectorXi channels;  // n_t
  std::vector<char> masked;

  Eigen::Index size() const { return time.size(); }
};

struct MotionRows {
  Eigen::VectorXd time;
  RowMatrix value;
  // at t + s, after every prediction:
  std::vector<Eigen::Index> interval;
  RowMatrix basis;               // (K, 6) of the prediction (10.4)
  RowMatrix by_s, by_kappa;      // (K, M)
  RowMatrix residual;            // (K, M), 0 where missing

  Eigen::Index size() const { return time.size(); }
};

// What a prediction leaves behind, a row a sample.
struct Prediction {
  RowMatrix nu, a, g;  // SI; g: that the sensor feels, (10.5)
  RowMatrix w;         // (K, 6) fractions of range, with the sign of the rig
  RowMatrix cw;        // (K, n) C_0 w
  RowMatrix residual;  // (K, n), 0 where missing
};

class Stretch {
 public:
  Stretch() = default;
  // The samples of `log` between two times.
  Stretch(const RecordedLog& log, const Statement& rig, double begin, double end, double period, double h)
      : log_(&log), rig_(&rig), M_(log.components()), n_(static_cast<int>(rig.noise.size())) {
    spline = Spline(begin - 0.5 * period, end - begin + period, h);
    for (Eigen::Index k = 0; k < log.time.size(); ++k) {
      if (log.time[k] < begin - 0.5 * period || log.time[k] > end + 0.5 * period) continue;
      if (!log.raw.row(k).array().isFinite().any()) continue;
      raw.source.push_back(k);
    }
    const auto rows = static_cast<Eigen::Index>(raw.source.size());
    raw.time.resize(rows);
    raw.value.resize(rows, n_);
    raw.weight = Eigen::VectorXd::Ones(rows);
    raw.channels.resize(rows);
    raw.masked.assign(static_cast<std::size_t>(rows), 0);
    for (Eigen::Index k = 0; k < rows; ++k) {
      const Eigen::Index at = raw.source[static_cast<std::size_t>(k)];
      double u = 0.0;
      raw.time[k] = log.time[at];
      raw.interval.push_back(spline.locate(raw.time[k], u));
      raw.basis.push_back({spline.basis(u, 0), spline.basis(u, 1), spline.basis(u, 2)});
      raw.value.row(k) = log.raw.row(at);
      raw.channels[k] = static_cast<int>(raw.value.row(k).array().isFinite().count());
    }
    for (const MotionStream& stream : log.motion) {
      MotionRows m;
      std::vector<Eigen::Index> at;
      for (Eigen::Index k = 0; k < stream.time.size(); ++k)
        if (stream.time[k] >= begin - 0.5 * period && stream.time[k] <= end + 0.5 * period &&
            stream.value.row(k).array().isFinite().any())
          at.push_back(k);
      m.time.resize(static_cast<Eigen::Index>(at.size()));
      m.value.resize(m.time.size(), M_);
      for (std::size_t k = 0; k < at.size(); ++k) {
        m.time[static_cast<Eigen::Index>(k)] = stream.time[at[k]];
        m.value.row(static_cast<Eigen::Index>(k)) = stream.value.row(at[k]);
      }
      motion.push_back(std::move(m));
    }
    c = RowMatrix::Zero(spline.size(), M_);
    e = RowMatrix::Zero(spline.size(), n_);
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
  MappedMotion mapped;  // of a mapped motion, at the raw samples

  // Residuals of all rows at theta, in the places of `columns`; `lagged`: C_0 (n, 6); with the discrepancy or without.
  void predict(const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged, bool discrepancy) {
    predict_motion(columns, theta);
    predict_raw(columns, theta, lagged, discrepancy);
  }

  // The twist and its derivative at the raw samples alone.
  void evaluate_motion() {
    const Eigen::Index rows = raw.size();
    for (RowMatrix* m : {&now.nu, &now.a}) m->resize(rows, 6);
    if (log_->source == Source::mapped) {
      std::array<RowMatrix, 3> x;
      for (std::size_t p = 0; p < 3; ++p) {
        x[p].resize(rows, M_);
        for (Eigen::Index k = 0; k < rows; ++k) x[p].row(k) = value_at(k, p, c);
      }
      log_->map(raw.time, x[0], x[1], x[2], mapped);
      now.nu = mapped.nu;
      now.a = mapped.a;
      return;
    }
    for (Eigen::Index k = 0; k < rows; ++k) {
      const Eigen::Matrix<double, 1, 6> x0 = value_at(k, 0, c), x1 = value_at(k, 1, c);
      if (log_->source == Source::twist) {
        now.nu.row(k) = x0;
        now.a.row(k) = x1;
      } else {  // IMU: a_s takes the place of vdot + Omega x v - g
        now.nu.row(k) << 0.0, 0.0, 0.0, x0.tail<3>();
        now.a.row(k) << x0.head<3>(), x1.tail<3>();
      }
    }
  }

  // A p-th derivative of splines at a raw sample.
  Components value_at(Eigen::Index k, std::size_t p, const RowMatrix& coefficients) const {
    const auto i = static_cast<std::size_t>(k);
    return raw.basis[i][p].transpose() * coefficients.middleRows(raw.interval[i], kLocal);
  }

  // Gravity in sensor axes without (10.5), and its derivative by the tilt.
  Vector3 gravity_at(Eigen::Index k, const Vector3& root) const {
    return rotation_at(k) * root;
  }
  Matrix3 rotation_at(Eigen::Index k) const {
    using Row = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    if (log_->source == Source::mapped) return Eigen::Map<const Row>(mapped.R_sensor_root.row(k).data());
    return Eigen::Map<const Row>(log_->R_sensor_root.row(raw.source[static_cast<std::size_t>(k)]).data());
  }
  bool gravity() const { return rig_->gravity.squaredNorm() > 0.0 && log_->source != Source::imu; }

 private:
  const RecordedLog* log_ = nullptr;
  const Statement* rig_ = nullptr;
  int M_ = 6, n_ = 6;

  // twist = nu(t + s) + (kappa - 1/2) s^2 nuddot + sigma_v eps                                                     (10.4)
  void predict_motion(const Columns& columns, const Eigen::VectorXd& theta) {
    for (std::size_t i = 0; i < motion.size(); ++i) {
      MotionRows& m = motion[i];
      const int p = log_->motion[i].derivative;
      const double s = theta[columns.clock[i]], kappa = theta[columns.clock[i] + 1];
      const int bias = columns.bias[i];
      const Eigen::Index rows = m.size();
      m.interval.resize(static_cast<std::size_t>(rows));
      m.basis.resize(rows, kLocal);
      for (RowMatrix* x : {&m.by_s, &m.by_kappa, &m.residual}) x->resize(rows, M_);
      for (Eigen::Index k = 0; k < rows; ++k) {
        double u = 0.0;
        const Eigen::Index at = spline.locate(m.time[k] + s, u);
        m.interval[static_cast<std::size_t>(k)] = at;
        const Basis b0 = spline.basis(u, p), b1 = spline.basis(u, p + 1), b2 = spline.basis(u, p + 2),
                    b3 = p + 3 <= kDegree5 ? spline.basis(u, p + 3) : Basis::Zero();
        const auto local = c.middleRows(at, kLocal);
        const Basis basis = b0 + (kappa - 0.5) * s * s * b2;
        m.basis.row(k) = basis.transpose();
        m.by_s.row(k) = (b1 + (kappa - 0.5) * (2.0 * s * b2 + s * s * b3)).transpose() * local;
        m.by_kappa.row(k) = s * s * b2.transpose() * local;
        m.residual.row(k) = m.value.row(k) - basis.transpose() * local;
        if (bias >= 0) m.residual.row(k) -= theta.segment(bias, M_).transpose();
        m.residual.row(k) = m.residual.row(k).array().isFinite().select(m.residual.row(k), 0.0);
      }
    }
  }

  // raw = C w + b + u (C_0 w)^2 + sum a 1[t >= t_j] + d + slope dT                                                  (10.3)
  void predict_raw(const Columns& columns, const Eigen::VectorXd& theta, const RowMatrix& lagged, bool discrepancy) {
    evaluate_motion();
    const Eigen::Index rows = raw.size();
    now.g.resize(rows, 3);
    now.w.resize(rows, 6);
    now.cw.resize(rows, n_);
    now.residual.resize(rows, n_);
    const Payload body = departed(log_->payload, theta.segment<kBodyParameters>(columns.body));
    const Vector6 scale = rig_->sign * rig_->range.cwiseInverse();
    const Eigen::Map<const RowMatrix> C(theta.data() + columns.C, n_, 6);
    Eigen::Matrix<double, 3, 2> unused;
    const Vector3 root = gravity() ? tilted(rig_->gravity, theta.segment<2>(columns.tilt), unused) : rig_->gravity;
    for (Eigen::Index k = 0; k < rows; ++k) {
      const Vector6 nu = now.nu.row(k), a = now.a.row(k);
      Vector3 g = Vector3::Zero();
      if (gravity()) {
        g = gravity_at(k, root);
        if (columns.gamma >= 0) g = retarded(columns, theta, g, nu, a);
      }
      now.g.row(k) = g;
      const Vector6 w = scale.cwiseProduct(wrench_about(body, log_->point, nu, a, g));
      now.w.row(k) = w;
      now.cw.row(k) = w.transpose() * lagged.transpose();
      auto r = now.residual.row(k);
      r = raw.value.row(k) - w.transpose() * C.transpose() - theta.segment(columns.b, n_).transpose();
      r.array() -= theta.segment(columns.u, n_).transpose().array() * now.cw.row(k).array().square();
      for (std::size_t j = 0; j < columns.steps.size(); ++j)
        if (raw.time[k] >= columns.step_times[j]) r -= theta.segment(columns.steps[j], n_).transpose();
      if (columns.slope >= 0) r -= warmth(k) * theta.segment(columns.slope, n_).transpose();
      if (discrepancy) r -= value_at(k, 0, e);
      r = r.array().isFinite().select(r, 0.0);
    }
  }

  // g+ = g + gamma [ s Omega x g + (1 - kappa) s^2 Omega x (Omega x g) + kappa s^2 Omegadot x g ]                    (10.5)
  static Vector3 retarded(const Columns& columns, const Eigen::VectorXd& theta, const Vector3& g, const Vector6& nu,
                          const Vector6& a) {
    const double s = theta[columns.clock[0]], kappa = theta[columns.clock[0] + 1], gamma = theta[columns.gamma];
    const Vector3 omega = nu.tail<3>(), first = omega.cross(g);
    return g + gamma * (s * first + s * s * ((1.0 - kappa) * omega.cross(first) + kappa * a.tail<3>().cross(g)));
  }

 public:
  double warmth(Eigen::Index k) const {
    const double t = log_->temperature.size() > 0 ? log_->temperature[raw.source[static_cast<std::size_t>(k)]] : 0.0;
    return std::isfinite(t) ? t : 0.0;
  }
};

}  // namespace truewrench
