// The parameters of sensor and tool with their covariance: the contact wrench of features, its own covariance, and the
// tare that updates all of them.
#pragma once

#include "truewrench/contact/model.hpp"
#include "truewrench/contact/ring.hpp"
#include "truewrench/math/dense.hpp"

#include <Eigen/Cholesky>

#include <cmath>
#include <limits>

namespace truewrench {

// Of six degrees of freedom, exceeded once in 1e8 samples without contact.
inline constexpr double contact_limit = 48.4;

struct ContactWrench {
  Vector6 wrench;            // at the sensor's origin, sensor axes, the rig's sign [N, N m]
  Matrix6 covariance;        // of it
  double chi2 = 0.0;         // wrench^T covariance^-1 wrench; above contact_limit it is a contact
  Matrix3 R_sensor_root;     // turns vectors of the root frame into sensor axes; zero where nothing tells it
  bool heading = false;      // its turn about gravity is known
  std::int64_t time_ns = 0;  // centre of the kernel; of the newest one, its last sample
  std::int64_t newest = 0;   // largest mark of the samples in use
};

enum class Tare : std::uint8_t {
  accepted = 0,
  in_contact,  // the contact test, drift included, says contact
  nothing,     // there has been no contact wrench yet
  singular,    // the gain that would follow cannot be inverted
};

namespace contact {

// L of S = L L^T, and its triangular solves in loops: Eigen's own take a compiler 100 MB.
class Root {
 public:
  bool compute(const Matrix6& S) noexcept {
    factor_.compute(S);
    return factor_.info() == Eigen::Success;
  }
  Vector6 lower(Vector6 x) const noexcept {  // L^-1 x
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < i; ++j) x[i] -= factor_.matrixLLT()(i, j) * x[j];
      x[i] /= factor_.matrixLLT()(i, i);
    }
    return x;
  }
  Vector6 solve(const Vector6& b) const noexcept {  // S^-1 b
    Vector6 x = lower(b);
    for (int i = 5; i >= 0; --i) {
      for (int j = i + 1; j < 6; ++j) x[i] -= factor_.matrixLLT()(j, i) * x[j];
      x[i] /= factor_.matrixLLT()(i, i);
    }
    return x;
  }

 private:
  Eigen::LLT<Matrix6> factor_;
};

class Estimate {
 public:
  // Takes the wrench that was evaluated last for that of no contact: a measurement w_c = 0 with the sigma of the
  // moment, which updates gain, tool and offset jointly. Refused in contact.
  Tare tare() noexcept {
    if (!valid_) return Tare::nothing;
    if (!(chi2_ <= contact_limit)) return Tare::in_contact;
    const int n = at_.n;
    const std::int64_t before = offset_time_;
    const double since = std::abs(static_cast<double>(moment_ - before)) * 1e-9;
    for (int i = 0; i < n; ++i) P_(at_.offset() + i, at_.offset() + i) += walk(i) * since;
    start_ = step_ = theta_;
    Matrix6 of_moment;
    Root factor;
    for (int iteration = 0; iteration < tare_steps; ++iteration) {
      contact_ = linearise();
      of_moment = moment_noise();  // before P_ J, for the offset's walk is in P_ by now
      factor.compute(of_moment + through(P_));
      for (int k = 0; k < 6; ++k) {
        double sum = contact_[k];
        for (int c = 0; c < at_.size(); ++c) sum += J_(k, c) * (start_[c] - step_[c]);
        residual_[k] = sum;
      }
      const Vector6 gain = factor.solve(residual_);
      for (int c = 0; c < at_.size(); ++c) step_[c] = start_[c] - PJ_.row(c).head<6>().dot(gain);
      if (unpack(step_, point_) != Status::ok) {
        static_cast<void>(unpack(theta_, point_));
        for (int i = 0; i < n; ++i) P_(at_.offset() + i, at_.offset() + i) -= walk(i) * since;
        return Tare::singular;
      }
    }
    contact_ = linearise();
    factor.compute(moment_noise() + through(P_));
    // P - P J^T S^-1 J P with S = L L^T, as a product with its own transpose: it stays symmetric
    for (int c = 0; c < at_.size(); ++c) {
      const Vector6 row = PJ_.row(c).transpose();
      const Vector6 scaled = factor.lower(row);
      PJ_.row(c) = scaled.transpose();
    }
    for (int c = 0; c < at_.size(); ++c)
      for (int r = 0; r < at_.size(); ++r) P_(r, c) -= PJ_.row(r).dot(PJ_.row(c));
    theta_ = step_;
    static_cast<void>(unpack(theta_, point_));
    offset_time_ = moment_;
    valid_ = false;  // the moment has been used
    return Tare::accepted;
  }

  // Where the turn about gravity is not known from here on: the tilt, which is fixed in the root frame, points anywhere
  // about it. Of a tilt turned by an angle that is uniform the mean is 0, the covariance half of E |tilt|^2 in both
  // axes, and none of it goes with anything else.
  void forget_heading() noexcept {
    const int t = at_.tilt();
    const double square = theta_.segment<2>(t).squaredNorm() + P_(t, t) + P_(t + 1, t + 1);
    for (int k = t; k < t + 2; ++k) {
      P_.row(k).setZero();
      P_.col(k).setZero();
      P_(k, k) = 0.5 * square;
      theta_[k] = 0.0;
    }
    static_cast<void>(unpack(theta_, point_));
  }

  int channels() const noexcept { return at_.n; }
  const Places& places() const noexcept { return at_; }
  const Eigen::VectorXd& theta() const noexcept { return theta_; }
  const Vector3& center_of_mass() const noexcept { return point_.c; }
  double covariance(int row, int column) const noexcept { return P_(row, column); }
  // Derivative (6 rows of 8) of the last contact wrench by theta.
  const Eigen::Matrix<double, 8, Eigen::Dynamic>& jacobian() const noexcept { return J_; }

  // The last contact wrench as if theta had been another, for tests of the derivative.
  Vector6 contact_at(const Eigen::VectorXd& theta) noexcept {
    if (unpack(theta, point_) != Status::ok) return Vector6::Constant(std::nan(""));
    const Vector6 w = linearise();
    static_cast<void>(unpack(theta_, point_));
    return w;
  }

 protected:
  struct Sums {  // of squared weights
    double raw = 0.0, slope = 0.0, mean = 0.0;
  };

  static constexpr int tare_steps = 3;  // the offset is nearly linear; gain times offset needs a second look

  Status start(const Settings& settings) {
    valid_ = false;
    if (const Status status = check(settings); status != Status::ok) return status;
    const int n = static_cast<int>(settings.sensor.gain.rows());
    settings_ = settings;
    sign_ = settings.feels == Feels::payload_on_sensor ? 1.0 : -1.0;
    at_ = {n, settings.temperature_slope_std.size() == n, settings.quadratic_std.size() == n};
    const int p = at_.size(), padded = (p + 7) / 8 * 8;
    P_.setZero(padded, p);
    P_.topLeftCorner(7 * n + 15, 7 * n + 15) = settings.covariance;
    P_(at_.clock(), at_.clock()) = settings.time_offset_std * settings.time_offset_std;
    for (int i = 0; i < n; ++i) {
      if (at_.warm) P_(at_.slope() + i, at_.slope() + i) = std::pow(settings.temperature_slope_std[i], 2);
      if (at_.curved) P_(at_.quadratic() + i, at_.quadratic() + i) = std::pow(settings.quadratic_std[i], 2);
    }
    J_.setZero(8, p);
    PJ_.setZero(padded, 6);
    theta_.setZero(p);
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < 6; ++j) theta_[6 * i + j] = settings.sensor.gain(i, j);
    theta_[at_.mass()] = std::log(settings.mass);
    theta_.segment<3>(at_.center()) = settings.center_of_mass;
    theta_.segment<6>(at_.S()) = settings.S;
    theta_.segment(at_.offset(), n) = settings.sensor.offset;
    theta_.segment<3>(at_.mounting()) = settings.mounting;
    theta_.segment<2>(at_.tilt()) = settings.tilt;
    theta_[at_.clock()] = settings.time_offset;
    if (at_.warm && settings.temperature_slope.size() == n)
      theta_.segment(at_.slope(), n) = settings.temperature_slope;
    start_ = step_ = theta_;
    if (const Status status = unpack(theta_, point_); status != Status::ok) return status;
    offset_time_ = settings.offset_time_ns;
    twist_noise_ = settings.twist_noise;
    return Status::ok;
  }

  static Status check(const Settings& s) {
    if (const Status status = truewrench::check(s.sensor); status != Status::ok) return status;
    const Eigen::Index n = s.sensor.gain.rows(), p = 7 * n + 15;
    if (n > max_channels || s.covariance.rows() != p || s.covariance.cols() != p) return Status::wrong_size;
    for (const Eigen::VectorXd* v : {&s.offset_walk, &s.pose_repeatability, &s.slow_error,
                                     &s.temperature_slope, &s.temperature_slope_std, &s.quadratic_std}) {
      if (v->size() != 0 && v->size() != n) return Status::wrong_size;
      if (!v->allFinite()) return Status::not_finite;
    }
    if (s.quadratic_std.size() == n && s.full_scale.size() != n) return Status::wrong_size;
    if (!s.covariance.allFinite() || !std::isfinite(s.mass) || !s.center_of_mass.allFinite() ||
        !s.S.allFinite() || !s.mounting.allFinite() || !s.tilt.allFinite() || !s.gravity.allFinite() ||
        !std::isfinite(s.time_offset) || !std::isfinite(s.time_offset_std) || !s.twist_noise.allFinite() ||
        !s.gravity_noise.allFinite() || !std::isfinite(s.temperature_reference) || !s.full_scale.allFinite())
      return Status::not_finite;
    if (!Ring::near(s.offset_time_ns)) return Status::not_finite;  // as a stamp
    if (s.mass <= 0.0 || s.time_offset_std < 0.0) return Status::not_positive;
    for (const Eigen::VectorXd* v :
         {&s.offset_walk, &s.pose_repeatability, &s.slow_error, &s.temperature_slope_std, &s.quadratic_std})
      if (v->size() != 0 && v->minCoeff() < 0.0) return Status::not_positive;
    for (const Eigen::MatrixXd& P :
         {s.covariance, Eigen::MatrixXd(s.twist_noise), Eigen::MatrixXd(s.gravity_noise)})
      if (!dense::is_covariance(P)) return Status::not_positive;
    if (s.full_scale.size() > 0 && s.full_scale.minCoeff() <= 0.0) return Status::not_positive;
    return Status::ok;
  }

  double walk(int i) const noexcept {
    return settings_.offset_walk.size() ? settings_.offset_walk[i] * settings_.offset_walk[i] : 0.0;
  }

  // Everything that follows from theta once; the features stay as they are.
  Status unpack(const Eigen::VectorXd& theta, Point& p) noexcept {
    const int n = at_.n;
    p.at = at_;
    Inverse inverse;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < 6; ++j) settings_.sensor.gain(i, j) = theta[6 * i + j];
    if (const Status status = generalised_inverse(settings_.sensor, inverse); status != Status::ok)
      return status;
    p.mass = std::exp(theta[at_.mass()]);
    p.c = theta.segment<3>(at_.center());
    p.S = symmetric(theta.segment<6>(at_.S()));
    p.R = channel_turn(theta.segment<3>(at_.mounting()), p.R_by);
    p.fall_off = tilted_fall(settings_.gravity, theta.segment<2>(at_.tilt()), p.fall_by) - settings_.gravity;
    p.clock_off = theta[at_.clock()] - settings_.time_offset;
    p.offset = theta.segment(at_.offset(), n);
    p.slope.setZero(n);
    p.quadratic.setZero(n);
    if (at_.warm)
      p.slope = theta.segment(at_.slope(), n);
    else if (settings_.temperature_slope.size() == n)
      p.slope = settings_.temperature_slope;
    if (at_.curved) p.quadratic = theta.segment(at_.quadratic(), n);
    p.inverse.resize(6, n);
    for (int i = 0; i < n; ++i) {
      p.inverse.col(i).head<3>() = p.R.transpose() * inverse.col(i).head<3>();
      p.inverse.col(i).tail<3>() = p.R.transpose() * inverse.col(i).tail<3>();
    }
    return Status::ok;
  }

  // The contact wrench of the features at the point in use; fills the derivative by theta.
  Vector6 linearise() noexcept {
    const Point& p = point_;
    const Features& f = features_;
    const int n = at_.n;
    const Channels v = f.raw - p.offset - f.warmth * p.slope;
    Vector6 total = Vector6::Zero();
    for (int i = 0; i < n; ++i) {
      const double curved = at_.curved ? p.quadratic[i] * v[i] * v[i] / settings_.full_scale[i] : 0.0;
      total += p.inverse.col(i) * (v[i] - curved);
    }
    const Vector3 extra = -(f.R_sensor_root * p.fall_off);
    const Vector6 tool = sign_ * p.tool(f.acceleration, f.apparent, f.turning, extra);
    const Vector6 rate = sign_ * p.tool(f.jerk, f.apparent_rate, f.turning_rate, Vector3::Zero());
    Vector6 turned;  // in the channels' axes
    turned << p.R * total.head<3>(), p.R * total.tail<3>();
    const auto column = [&](int c, const Vector6& value) { J_.col(c).head<6>() = value; };
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < 6; ++j) column(6 * i + j, -turned[j] * p.inverse.col(i));
    column(at_.mass(), -tool);
    const Vector3 alpha = f.acceleration.tail<3>();
    const Vector3 of_mass = f.acceleration.head<3>() + f.apparent + alpha.cross(p.c) + f.turning * p.c -
                            f.turning.trace() * p.c + extra;
    const double scale = sign_ * p.mass;  // -d(tool) = scale * [d of_mass; d moment]
    const auto by_point = [&](int c, const Vector3& moved, const Vector3& arm) {
      Vector6 w;
      w << scale * moved, scale * (arm.cross(of_mass) + p.c.cross(moved));
      column(c, w);
    };
    for (int k = 0; k < 3; ++k) {
      const Vector3 e = Vector3::Unit(k);
      by_point(at_.center() + k, alpha.cross(e) + f.turning * e - f.turning.trace() * e, e);
    }
    for (int k = 0; k < 6; ++k) {
      Vector6 w = Vector6::Zero();
      w.tail<3>() = scale * spin_moment(symmetric(Vector6::Unit(k)), alpha, f.turning);
      column(at_.S() + k, w);
    }
    for (int i = 0; i < n; ++i) column(at_.offset() + i, -p.inverse.col(i));
    for (int k = 0; k < 3; ++k) {
      const Matrix3 turn = p.R.transpose() * p.R_by[k];
      Vector6 w;
      w << -(turn * total.head<3>()), -(turn * total.tail<3>());
      column(at_.mounting() + k, w);
    }
    for (int k = 0; k < 2; ++k)
      by_point(at_.tilt() + k, -(f.R_sensor_root * p.fall_by.col(k)), Vector3::Zero());
    column(at_.clock(), -rate);
    for (int i = 0; i < n; ++i) {
      if (at_.warm) column(at_.slope() + i, -f.warmth * p.inverse.col(i));
      if (at_.curved)
        column(at_.quadratic() + i, -(v[i] * v[i] / settings_.full_scale[i]) * p.inverse.col(i));
    }
    return total - tool - rate * p.clock_off;
  }

  // J P J^T, by columns of P and eight rows at a time, which stay in registers; P J^T is left in PJ_.
  Matrix6 through(const Eigen::MatrixXd& P) noexcept {
    using Eight = Eigen::Array<double, 8, 1>;
    const int p = at_.size();
    Matrix6 sum = Matrix6::Zero();
    for (Eigen::Index row = 0; row < P.rows(); row += 8) {
      Eight acc[6];
      for (Eight& a : acc) a.setZero();
      for (int c = 0; c < p; ++c) {
        const Eight column = Eigen::Map<const Eight>(P.data() + c * P.rows() + row);
        const double* j = J_.data() + 8 * c;
        for (int k = 0; k < 6; ++k) acc[k] += column * j[k];
      }
      for (int k = 0; k < 6; ++k) PJ_.col(k).segment<8>(row) = acc[k];
    }
    for (int c = 0; c < p; ++c)
      for (int k = 0; k < 6; ++k) sum.col(k) += J_.col(c).head<6>() * PJ_(c, k);
    return 0.5 * (sum + sum.transpose());
  }

  // Covariance of what the moment alone adds: samples of sensor and motion.
  Matrix6 moment_noise() const noexcept {
    Matrix6 sum = Matrix6::Zero();
    for (int i = 0; i < at_.n; ++i) {
      double variance = sums_.raw * settings_.sensor.noise[i] * settings_.sensor.noise[i];
      if (pose_ && settings_.pose_repeatability.size())
        variance += settings_.pose_repeatability[i] * settings_.pose_repeatability[i];
      else if (settings_.slow_error.size())
        variance += settings_.slow_error[i] * settings_.slow_error[i];
      sum += variance * point_.inverse.col(i) * point_.inverse.col(i).transpose();
    }
    const Matrix6 M = point_.by_acceleration();
    if (!pose_) sum += sums_.slope * (M * twist_noise_ * M.transpose());
    const auto of_fall = M.leftCols<3>();
    sum += sums_.mean * (of_fall * settings_.gravity_noise * of_fall.transpose());
    return sum;
  }

  // False where the numbers are so large that there is no wrench with a sigma.
  bool finish(ContactWrench& out) noexcept {
    contact_ = linearise();
    Matrix6 sigma = through(P_) + moment_noise();
    const double since = std::abs(static_cast<double>(moment_ - offset_time_)) * 1e-9;
    for (int i = 0; i < at_.n; ++i)
      sigma += walk(i) * since * point_.inverse.col(i) * point_.inverse.col(i).transpose();
    Root factor;
    chi2_ = factor.compute(sigma) ? factor.lower(contact_).squaredNorm()
                                  : std::numeric_limits<double>::quiet_NaN();
    valid_ = std::isfinite(chi2_) && sigma.allFinite();
    out.wrench = contact_;
    out.covariance = sigma;
    out.chi2 = chi2_;
    return valid_;
  }

  Settings settings_;
  Places at_;
  Point point_;
  Features features_;
  Eigen::MatrixXd P_, PJ_;                      // rows padded to a multiple of eight
  Eigen::Matrix<double, 8, Eigen::Dynamic> J_;  // a column a parameter, two rows of padding
  Eigen::VectorXd theta_, start_, step_;        // and of a tare, where it began and where it is
  Matrix6 twist_noise_ = Matrix6::Zero();
  Vector6 contact_ = Vector6::Zero(), residual_ = Vector6::Zero();
  Sums sums_;
  double sign_ = 1.0, chi2_ = 0.0;
  std::int64_t offset_time_ = 0, moment_ = 0;
  bool valid_ = false, pose_ = false;
};

}  // namespace contact
}  // namespace truewrench
