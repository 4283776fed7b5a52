// The estimator as samples arrive: include/truewrench/estimation/incremental.hpp.
#include "bindings.hpp"

#include "truewrench/estimation/estimator.hpp"
#include "truewrench/estimation/incremental.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

namespace truewrench::python {
namespace {

// What `estimate` tells, as far as it exists without a second look at the record.
struct OnlineEstimate {
  Status status = Status::ok;
  Eigen::VectorXd theta, mean, prior;
  std::vector<int> active;
  Eigen::MatrixXd added, gain_covariance;
  Eigen::VectorXd discrepancy2;
  std::vector<std::vector<Moment>> moments;  // by log and group
  PoseShare pose;
  Agreement halves, quarters;   // halves: not told
  std::vector<Agreement> logs;  // each against those before it
  std::vector<bool> unresolved;
  std::vector<int> dropped;
  std::vector<double> spacing;
  std::vector<Sizes> sizes;                 // by log
  std::vector<Eigen::VectorXd> own;         // by log: theta as its record ended
  std::vector<Eigen::MatrixXd> covariance;  // by log: of it
  std::vector<std::vector<double>> tilts;  // by log: of gravity, as the root frames before its last one ended
  std::vector<Flags> masked;               // by log: samples
  std::vector<Eigen::VectorXd> history_time;  // by log: [s] ends of blocks
  std::vector<RowMatrix> history_gain;        // (blocks, 6n)
  std::vector<std::int64_t> samples;          // by log: that were used or masked
  std::vector<Columns> columns;               // by log, in theta
  std::int64_t blocks = 0;
};

RecordedLog without_samples(const RecordedLog& log) {
  RecordedLog out = log;
  out.time.resize(0);
  out.raw.resize(0, log.raw.cols());
  out.R_sensor_root.resize(0, 9);
  if (out.temperature.size() > 1) out.temperature.conservativeResize(1);
  if (out.own_roots.size() > 1) out.own_roots.resize(1);  // one at a time
  for (MotionStream& m : out.motion) {
    m.time.resize(0);
    m.value.resize(0, m.value.cols());
  }
  return out;
}

double rate_of(const Eigen::VectorXd& time) {  // half of the samples are closer than twice the median
  return time.size() < 2 ? 1.0 : 1.5 / std::max(median_period(time), 1e-6);
}

// All samples of a log in the order of time; `spans`: what was left out of it, read after every push, as memory for them is fixed.
Status feed(Incremental& online, const RecordedLog& log, OnlineEstimate& out,
            std::vector<MaskedSpan>& spans) {
  if (online.lag().streams() != log.motion.size()) return Status::wrong_size;
  if (const Status status = check_samples(online.lag().rig(), log); status != Status::ok) return status;
  std::vector<Eigen::Index> at(log.motion.size(), 0);
  Eigen::Index k = 0;
  std::size_t root = 1;
  Status worst = Status::ok;
  std::vector<double> time, tilts;
  std::vector<Eigen::VectorXd> gain;
  std::int64_t blocks = online.blocks();
  const auto note = [&](Status s, double t) {
    if (s != Status::ok && s != Status::not_finite) worst = s;
    for (std::size_t i = 0; i < online.masked_spans(); ++i) spans.push_back(online.masked_span(i));
    online.clear_masked();
    if (online.blocks() == blocks || !online.ready()) return;
    blocks = online.blocks();
    const auto C = online.gain();
    const Eigen::Map<const Eigen::VectorXd> now(C.data(), C.size());
    if (!gain.empty() && gain.back() == now) return;
    time.push_back(t);
    gain.emplace_back(now);
  };
  for (;;) {
    double next = k < log.time.size() ? log.time[k] : 1e300;
    int stream = -1;
    for (std::size_t i = 0; i < at.size(); ++i)
      if (at[i] < log.motion[i].time.size() && log.motion[i].time[at[i]] <= next) {
        next = log.motion[i].time[at[i]];
        stream = static_cast<int>(i);
      }
    if (next == 1e300) break;
    for (; root < log.own_roots.size() && log.own_roots[root] <= next; ++root) {
      note(online.finish(), next);
      const int tilt = online.lag().columns().tilt;
      for (int axis = 0; axis < 2 && tilt >= 0; ++axis) tilts.push_back(online.theta()[tilt + axis]);
      note(online.next_root(), next);
    }
    if (stream >= 0) {
      const auto i = static_cast<std::size_t>(stream);
      const Vector6 v = log.motion[i].value.row(at[i]);
      note(online.push_motion(i, next, v.data()), next);
      ++at[i];
    } else {
      const double* R = log.R_sensor_root.rows() > 0 ? log.R_sensor_root.row(k).data() : nullptr;
      note(online.push_raw(next, log.raw.row(k).data(), R,
                           log.temperature.size() > 0 ? log.temperature[k] : std::nan("")),
           next);
      ++k;
    }
  }
  note(online.finish(), log.time.size() > 0 ? log.time[log.time.size() - 1] : 0.0);
  out.history_time.emplace_back(
      Eigen::Map<const Eigen::VectorXd>(time.data(), static_cast<Eigen::Index>(time.size())));
  RowMatrix all(static_cast<Eigen::Index>(gain.size()), gain.empty() ? 0 : gain[0].size());
  for (std::size_t i = 0; i < gain.size(); ++i) all.row(static_cast<Eigen::Index>(i)) = gain[i].transpose();
  out.history_gain.push_back(std::move(all));
  out.tilts.push_back(std::move(tilts));
  return worst;
}

OnlineEstimate estimate_online(const Statement& rig, const std::vector<const RecordedLog*>& logs,
                               IncrementalSettings settings) {
  if (logs.empty()) throw nb::value_error("estimate_online: no logs");
  for (const RecordedLog* log : logs) {
    if (log->source == Source::mapped || log->components() != kComponents)
      throw nb::value_error("estimate_online: a log of twists or of an IMU is expected");
    if (log->raw.cols() > kMostChannels || log->motion.size() > kMostStreams)
      throw nb::value_error("estimate_online: more channels or streams than there are places");
  }
  OnlineEstimate out;
  std::vector<int> short_of(logs.size(), 0);  // stretches too short, as Estimator::run counts them
  for (const RecordedLog* log : logs)
    for (const Status status : {check_samples(rig, *log), check(rig, *log, settings)})
      if (out.status == Status::ok) out.status = status;
  if (out.status != Status::ok) {
    out.dropped = short_of;
    return out;
  }
  double period = 1e300;  // of the fastest motion
  for (const RecordedLog* log : logs) {
    settings.rate = std::max(settings.rate, rate_of(log->time));
    for (const MotionStream& m : log->motion) settings.rate = std::max(settings.rate, rate_of(m.time));
    // so that the first lag of slow motion finds room
    settings.lag = std::max(settings.lag, 20.0 * coarsest_spacing(motion_period(*log)));
    period = std::min(period, motion_period(*log));
  }
  settings.finest = std::max(settings.finest, std::min(0.5 * period, constants::knot_spacing));
  for (std::size_t l = 0; l < logs.size(); ++l) {
    const double coarsest = coarsest_spacing(motion_period(*logs[l]));
    if (pieces_of(*logs[l], coarsest, short_of[l]).empty()) out.status = Status::wrong_size;
  }
  if (out.status != Status::ok) {
    out.dropped = short_of;
    return out;
  }
  auto online = std::make_unique<Incremental>(rig, without_samples(*logs[0]), settings);
  out.status = online->status();  // of settings that no memory holds
  if (out.status != Status::ok) {
    out.dropped = short_of;
    return out;
  }
  for (std::size_t l = 0; l < logs.size(); ++l) {
    const RecordedLog& log = *logs[l];
    const Status begun = l > 0 ? online->next_log(without_samples(log)) : Status::ok;
    if (begun != Status::ok) out.status = begun;
    const std::int64_t before = online->samples();
    const int dropped = online->dropped();
    std::vector<MaskedSpan> spans;
    const Status status = feed(*online, log, out, spans);
    if (status != Status::ok) out.status = status;
    online->covariance();
    out.logs.push_back(online->agreement_with_logs_before());
    out.moments.emplace_back(online->moments().begin(),
                             online->moments().begin() + raw_groups(static_cast<int>(rig.noise.size())));
    out.unresolved.push_back(online->unresolved());
    out.dropped.push_back(online->dropped() - dropped);
    out.spacing.push_back(online->spacing());
    out.sizes.push_back(online->sizes());
    out.own.push_back(online->theta());
    out.covariance.push_back(online->theta_covariance());
    out.columns.push_back(online->lag().layout().log(0));
    out.samples.push_back(online->samples() - before);
    Flags masked = Flags::Constant(log.time.size(), false);
    Eigen::Index k = 0;
    std::sort(spans.begin(), spans.end(),
              [](const MaskedSpan& a, const MaskedSpan& b) { return a.begin < b.begin; });
    for (const MaskedSpan& s : spans) {
      while (k < log.time.size() && log.time[k] < s.begin - 1e-9) ++k;
      for (Eigen::Index j = k; j < log.time.size() && log.time[j] <= s.end + 1e-9; ++j) masked[j] = true;
    }
    out.masked.push_back(std::move(masked));
  }
  out.theta = online->theta();
  out.mean = online->lag().layout().mean();
  out.prior = online->prior();
  for (std::size_t i = 0; i < online->active().size(); ++i)
    if (online->active()[i] != 0) out.active.push_back(static_cast<int>(i));
  out.gain_covariance = online->covariance();
  out.added = online->added();
  out.discrepancy2 = online->discrepancy2();
  out.pose = online->pose();
  out.quarters = online->agreement();
  out.blocks = online->blocks();
  return out;
}

}  // namespace

void bind_incremental(nb::module_& m) {
  nb::class_<IncrementalSettings>(m, "IncrementalSettings", "Of the estimator as samples arrive.")
      .def(nb::init<>())
      .def_rw("lag", &IncrementalSettings::lag)
      .def_rw("rate", &IncrementalSettings::rate)
      .def_rw("spacing", &IncrementalSettings::spacing)
      .def_rw("finest", &IncrementalSettings::finest)
      .def_rw("discrepancy", &IncrementalSettings::discrepancy);
  nb::class_<Incremental>(m, "Incremental", "The estimator as samples arrive: fixed lag, fixed memory.")
      .def(
          "__init__",
          [](Incremental* self, const Statement& rig, const RecordedLog& about,
             const IncrementalSettings& settings) {
            if (about.source == Source::mapped || about.components() != kComponents ||
                about.motion.size() > kMostStreams || rig.noise.size() > kMostChannels)
              throw nb::value_error("Incremental: twists or an IMU, at most 3 streams and 12 channels");
            require(check(rig, about, settings), "Incremental");
            new (self) Incremental(rig, without_samples(about), settings);
          },
          nb::arg("rig"), nb::arg("about"), nb::arg("settings"))
      .def(
          "push_motion",
          [](Incremental& self, std::size_t stream, const Array1& time, const Array2& value) {
            expect_shape(value, time.shape(0), kComponents, "value");
            std::vector<Status> out;
            for (std::size_t k = 0; k < time.shape(0); ++k)
              out.push_back(self.push_motion(stream, time(k), value.data() + 6 * k));
            return out;
          },
          nb::arg("stream"), nb::arg("time"), nb::arg("value"))
      .def(
          "push_raw",
          [](Incremental& self, const Array1& time, const Array2& raw, const std::optional<Array2>& R) {
            expect_shape(raw, time.shape(0), static_cast<std::size_t>(self.lag().channels()), "raw");
            if (R) expect_shape(*R, time.shape(0), 9, "R_sensor_root");
            std::vector<Status> out;
            for (std::size_t k = 0; k < time.shape(0); ++k)
              out.push_back(
                  self.push_raw(time(k), raw.data() + raw.shape(1) * k, R ? R->data() + 9 * k : nullptr));
            return out;
          },
          nb::arg("time"), nb::arg("raw"), nb::arg("R_sensor_root") = nb::none())
      .def("finish", &Incremental::finish)
      .def("next_log",
           [](Incremental& self, const RecordedLog& about) { return self.next_log(without_samples(about)); })
      .def_prop_ro("status", [](const Incremental& self) { return self.status(); })
      .def_prop_ro("gain", [](const Incremental& self) { return RowMatrix(self.gain()); });
  nb::class_<OnlineEstimate>(m, "OnlineEstimate", "What the estimator found as samples arrived.")
      .def_ro("status", &OnlineEstimate::status)
      .def_ro("theta", &OnlineEstimate::theta)
      .def_ro("mean", &OnlineEstimate::mean)
      .def_ro("prior", &OnlineEstimate::prior)
      .def_ro("active", &OnlineEstimate::active)
      .def_ro("covariance", &OnlineEstimate::covariance)
      .def_ro("added", &OnlineEstimate::added)
      .def_ro("gain_covariance", &OnlineEstimate::gain_covariance)
      .def_ro("discrepancy2", &OnlineEstimate::discrepancy2)
      .def_ro("moments", &OnlineEstimate::moments)
      .def_ro("pose", &OnlineEstimate::pose)
      .def_ro("halves", &OnlineEstimate::halves)
      .def_ro("quarters", &OnlineEstimate::quarters)
      .def_ro("logs", &OnlineEstimate::logs)
      .def_ro("unresolved", &OnlineEstimate::unresolved)
      .def_ro("dropped", &OnlineEstimate::dropped)
      .def_ro("spacing", &OnlineEstimate::spacing)
      .def_ro("sizes", &OnlineEstimate::sizes)
      .def_ro("own", &OnlineEstimate::own)
      .def_ro("tilts", &OnlineEstimate::tilts)
      .def_ro("masked", &OnlineEstimate::masked)
      .def_ro("history_time", &OnlineEstimate::history_time)
      .def_ro("history_gain", &OnlineEstimate::history_gain)
      .def_ro("samples", &OnlineEstimate::samples)
      .def_ro("columns", &OnlineEstimate::columns)
      .def_ro("blocks", &OnlineEstimate::blocks);
  m.def("estimate_online", &estimate_online, nb::arg("rig"), nb::arg("logs"), nb::arg("settings"),
        nb::call_guard<nb::gil_scoped_release>(),
        "Logs through the estimator as samples arrive, each in the order of time.");
}

}  // namespace truewrench::python
