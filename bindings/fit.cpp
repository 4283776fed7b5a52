// The estimator over whole records: include/truewrench/estimation/estimator.hpp.
#include "bindings.hpp"

#include "truewrench/estimation/estimator.hpp"
#include "truewrench/estimation/part.hpp"
#include "truewrench/estimation/samples.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <memory>
#include <utility>
#include <vector>

namespace truewrench::python {
namespace {

// Rows of one log of a fit, in the order of time.
nb::dict rows_of(const Fit& fit, std::size_t l) {
  const LogFit& log = fit.logs().at(l);
  Eigen::Index count = 0;
  for (const Stretch& s : log.stretches) count += samples_of(fit, l, s);
  const int n = fit.channels();
  Eigen::VectorXi source(count), stretch(count);
  Eigen::VectorXd time(count), masked(count);
  RowMatrix residual(count, n), w(count, 6), nu(count, 6), a(count, 6), d = RowMatrix::Zero(count, n);
  Eigen::Index at = 0;
  each_sample(fit, l, [&](const Stretch& s, std::size_t i) {
    for (Eigen::Index k = 0; k < s.raw.rows(); ++k, ++at) {
      source[at] = static_cast<int>(s.raw.source[static_cast<std::size_t>(k)]);
      stretch[at] = static_cast<int>(i);
      time[at] = s.raw.time[k];
      masked[at] = s.raw.masked[static_cast<std::size_t>(k)];
      residual.row(at) = (s.raw.value.row(k).array().isFinite()).select(s.now.residual.row(k), std::nan(""));
      w.row(at) = s.now.w.row(k);
      nu.row(at) = s.now.nu.row(k);
      a.row(at) = s.now.a.row(k);
      if (log.sizes.form != Form::none) d.row(at) = s.value_at(k, 0, s.e);
    }
  });
  nb::dict out;
  // a copy of all rows beside them is what a long record takes most for
  const auto move_to = [&out](const char* name, auto& rows) { out[name] = nb::cast(std::move(rows)); };
  move_to("source", source);
  move_to("stretch", stretch);
  move_to("time", time);
  move_to("masked", masked);
  move_to("residual", residual);
  move_to("w", w);
  move_to("nu", nu);
  move_to("a", a);
  move_to("d", d);
  return out;
}

// Of given knots, nothing estimated.
std::shared_ptr<Fit> bare_fit(const Statement& rig, const std::vector<const RecordedLog*>& logs,
                              const std::vector<double>& h, const std::vector<std::vector<double>>& steps) {
  const auto shared = std::make_shared<const Statement>(rig);
  std::vector<LogFit> fits;
  for (std::size_t l = 0; l < logs.size(); ++l) {
    LogFit log;
    int dropped = 0;
    log.log = logs[l];
    log.h = h.at(l);
    log.period = median_period(sensor_times(*logs[l]));
    for (const Piece& p : pieces_of(*logs[l], std::max(h[l], constants::knot_spacing), dropped))
      log.stretches.emplace_back(*logs[l], *shared, p.begin, p.end, log.period, h[l]);
    fits.push_back(std::move(log));
  }
  return std::make_shared<Fit>(shared, std::move(fits), steps, 1);
}

RowMatrix motion_residual(const Fit& fit, std::size_t l, std::size_t stream) {
  const LogFit& log = fit.logs().at(l);
  std::vector<RowMatrix> parts;
  Eigen::Index count = 0;
  for (const Stretch& s : log.stretches) count += s.motion.at(stream).rows();
  RowMatrix out(count, log.log->components());
  Eigen::Index at = 0;
  for (const Stretch& s : log.stretches) {
    const MotionRows& m = s.motion[stream];
    out.middleRows(at, m.rows()) = (m.value.array().isFinite()).select(m.residual, std::nan(""));
    at += m.rows();
  }
  return out;
}

}  // namespace

void bind_fit(nb::module_& m) {
  nb::enum_<Form>(m, "Form", "Where the discrepancy's process comes from.")
      .value("none", Form::none)
      .value("matern", Form::matern)
      .value("walk", Form::walk)
      .value("bridge", Form::bridge);
  nb::class_<Sizes>(m, "Sizes", "The sizes of one log's nuisances.")
      .def_rw("raw_factor", &Sizes::raw_factor)
      .def_rw("motion_factor", &Sizes::motion_factor)
      .def_rw("q", &Sizes::q)
      .def_rw("delta", &Sizes::delta)
      .def_rw("cap", &Sizes::cap)
      .def_rw("k", &Sizes::k)
      .def_rw("form", &Sizes::form);
  nb::class_<Columns>(m, "Columns", "Where the parameters of one log stand; -1: there is none.")
      .def_ro("C", &Columns::C)
      .def_ro("b", &Columns::b)
      .def_ro("u", &Columns::u)
      .def_ro("body_in_theta", &Columns::body_in_theta)
      .def_ro("slope", &Columns::slope)
      .def_ro("tilt", &Columns::tilt)
      .def_ro("roots", &Columns::roots)
      .def_ro("gamma", &Columns::gamma)
      .def_ro("clock", &Columns::clock)
      .def_ro("bias", &Columns::bias)
      .def_ro("ramps", &Columns::ramps)
      .def_ro("steps", &Columns::steps)
      .def_ro("step_times", &Columns::step_times)
      .def_prop_ro("at", [](const Columns& c) { return c.global; }, "Places in theta.");
  nb::class_<Moment>(m, "Moment", "Size of a slow discrepancy by moments, of one group of channels.")
      .def_ro("tau", &Moment::tau)
      .def_ro("delta2", &Moment::delta2)
      .def_ro("sd", &Moment::sd)
      .def_ro("z", &Moment::z);
  nb::class_<Agreement>(m, "Agreement", "Whether two parts of a record agree.")
      .def_ro("p", &Agreement::p)
      .def_ro("chi2", &Agreement::chi2)
      .def_ro("freedom", &Agreement::freedom);
  nb::class_<PoseShare>(m, "PoseShare", "How far a force that follows the pose can hide in the gain.")
      .def(
          "__init__", [](PoseShare* self, double A, const Matrix6& ww) { new (self) PoseShare{A, ww}; },
          nb::arg("A"), nb::arg("ww"))
      .def_ro("A", &PoseShare::A)
      .def_ro("ww", &PoseShare::ww)
      .def_ro("period", &PoseShare::period)
      .def_prop_ro(
          "unit_covariance",
          [](const PoseShare& share) {
            double unit[6][6];
            if (!unit_covariance(share, unit)) std::fill_n(&unit[0][0], 36, NAN);
            return Matrix6(Eigen::Map<const Matrix6>(&unit[0][0]));
          },
          "A / (1 - A) (E w w^T)^-1 / 6 (6, 6) of (10.10): of a row of C, for a force of unit size.");
  m.def(
      "pose_share",
      [](const Eigen::VectorXd& time, const RowMatrix& twist, const RowMatrix& wrench, bool arm) {
        if (twist.rows() != time.size() || wrench.rows() != time.size() || twist.cols() != 6 ||
            wrench.cols() != 6)
          throw nb::value_error("pose_share: twist and wrench of (N, 6) are expected, with N times");
        PoseSums sums;
        for (Eigen::Index k = 0; k < time.size(); ++k)
          sums.add(time[k], 1.0, false, &twist(k, 0), &wrench(k, 0));
        sums.end_stretch(arm);
        return sums.share();
      },
      nb::arg("time"), nb::arg("twist"), nb::arg("wrench"), nb::arg("arm") = false,
      "Of one gap-free record: times (N,) [s], twist (N, 6) of the sensor in its axes, wrench (N, 6) over "
      "the range; arm: its motion is one's.");
  m.def(
      "with_pose",
      [](Eigen::MatrixXd covariance, const Eigen::VectorXd& prior, const PoseShare& share,
         const Eigen::VectorXd& size2) {
        if (covariance.rows() != 6 * size2.size() || covariance.cols() != covariance.rows() ||
            prior.size() != covariance.rows())
          throw nb::value_error("with_pose: (6n, 6n), (6n,) and (n,) are expected");
        add_pose(covariance, prior.data(), share, [&](int i) { return size2[i]; });
        return covariance;
      },
      nb::arg("covariance"), nb::arg("prior"), nb::arg("share"), nb::arg("size2"),
      "The covariance (6n, 6n) of the normalised gain, row by row, with (10.10), for a force of variance "
      "size2 (n,) in every channel; no variance rises above its prior's (6n,).");
  nb::class_<Fit>(m, "Fit", "One fit of the model to one or several logs.")
      .def_rw("theta", &Fit::theta)
      .def_ro("failed", &Fit::failed)
      .def_rw("prior", &Fit::prior)
      .def_rw("lagged", &Fit::lagged)
      .def_prop_ro("deviance", &Fit::deviance)
      .def_ro("iterations", &Fit::iterations)
      .def_ro("converged", &Fit::converged)
      .def_prop_ro("mean", [](const Fit& f) { return f.layout().mean(); })
      .def_prop_ro("stated", [](const Fit& f) { return f.stated(); })
      .def_prop_ro("active", [](const Fit& f) { return f.active_places(); })
      .def_prop_ro("P", &Fit::P)
      .def_prop_ro("covariance", &Fit::covariance)
      .def_prop_ro("S", &Fit::S)
      .def_prop_ro("step", &Fit::step)
      .def("columns", [](const Fit& f, std::size_t l) { return f.layout().log(l); })
      .def(
          "sizes", [](Fit& f, std::size_t l) -> Sizes& { return f.logs().at(l).sizes; },
          nb::rv_policy::reference_internal)
      .def("spacing", [](const Fit& f, std::size_t l) { return f.logs().at(l).stretches.at(0).spline.h(); })
      .def("pieces",
           [](const Fit& f, std::size_t l) {
             std::vector<std::vector<double>> out;
             for (const Stretch& s : f.logs().at(l).stretches)
               out.push_back({s.spline.begin(), s.spline.end()});
             return out;
           })
      .def("motion",
           [](const Fit& f, std::size_t l, std::size_t s) { return f.logs().at(l).stretches.at(s).c; })
      .def("set_motion", [](Fit& f, std::size_t l, std::size_t s,
                            const RowMatrix& c) { f.logs().at(l).stretches.at(s).c = c; })
      .def("discrepancy",
           [](const Fit& f, std::size_t l, std::size_t s) { return f.logs().at(l).stretches.at(s).e; })
      .def("set_discrepancy", [](Fit& f, std::size_t l, std::size_t s,
                                 const RowMatrix& e) { f.logs().at(l).stretches.at(s).e = e; })
      .def("set_mask",
           [](Fit& f, std::size_t l, const Flags& mask) {
             LogFit& log = f.logs().at(l);
             if (log.whole != nullptr || mask.size() != log.log->time.size())
               throw nb::value_error(
                   "set_mask: a flag for every sample of a log that is not gathered is expected");
             for (Stretch& s : log.stretches)
               for (std::size_t k = 0; k < s.raw.masked.size(); ++k)
                 s.raw.masked[k] = mask[static_cast<Eigen::Index>(s.raw.source[k])] ? 1 : 0;
           })
      .def("predict", &Fit::predict)
      .def("reweigh", &Fit::reweigh)
      .def("linearise", &Fit::linearise)
      .def("solve", &Fit::solve, nb::arg("frozen") = false)
      .def("advance", &Fit::advance, nb::arg("share") = 1.0)
      .def("resize", &Fit::resize)
      .def(
          "run", [](Fit& f) { f.run(); }, nb::call_guard<nb::gil_scoped_release>())
      .def("objective", &Fit::objective)
      .def("likelihood", &Fit::likelihood)
      .def("log_determinant", &Fit::log_determinant)
      .def("slope_of_determinant", &Fit::slope_of_determinant, nb::arg("places"),
           nb::call_guard<nb::gil_scoped_release>(), "d log |H_xx| / d theta at places of theta.")
      .def(
          "traces",
          [](Fit& f, std::size_t l, std::size_t s) {
            LogFit& log = f.logs().at(l);
            const Eigen::MatrixXd P = Fit::gather(f.P(), f.layout().log(l).global);
            const Traces t = log.sweeps.at(s).traces(log.stretches.at(s), f.layout().log(l), log.sizes, P);
            nb::dict out;
            out["raw"] = t.raw;
            out["motion"] = t.motion;
            out["motion_share"] = t.motion_share;
            out["q"] = t.q;
            return out;
          },
          nb::sig("def traces(self, log: int, stretch: int, /) -> dict[str, object]"))
      .def("gradient",
           [](const Fit& f) {
             Eigen::VectorXd g = f.S() * f.step();
             return g;
           })
      .def("rows", &rows_of, nb::sig("def rows(self, log: int, /) -> dict[str, object]"))
      .def("motion_residual", &motion_residual);
  m.def(
      "make_fit",
      [](const Statement& rig, const std::vector<const RecordedLog*>& logs, const std::vector<double>& h,
         const std::vector<std::vector<double>>& steps, Form form) {
        auto fit = bare_fit(rig, logs, h, steps);
        for (std::size_t l = 0; l < logs.size(); ++l) {
          fit->logs()[l].sizes.form = form;
          motion_alone(fit->logs()[l], fit->layout(), l);
        }
        if (form == Form::none) regress(*fit);
        return fit;
      },
      nb::arg("rig"), nb::arg("logs"), nb::arg("h"), nb::arg("steps"), nb::arg("form") = Form::none,
      nb::keep_alive<0, 2>(), "A fit of given knots that stands at START: for tests, stage by stage.");
  m.def(
      "fit_of_sizes",
      [](const Statement& rig, const std::vector<const RecordedLog*>& logs, const std::vector<double>& h,
         const std::vector<Sizes>& sizes) {
        if (sizes.size() != logs.size())
          throw nb::value_error("fit_of_sizes: sizes of every log are expected");
        auto fit = bare_fit(rig, logs, h, std::vector<std::vector<double>>(logs.size()));
        for (std::size_t l = 0; l < logs.size(); ++l) {
          fit->logs()[l].sizes = sizes[l];
          if (!smooth_motion(fit->logs()[l], fit->layout(), l)) fit->failed = true;
        }
        return fit;
      },
      nb::arg("rig"), nb::arg("logs"), nb::arg("h"), nb::arg("sizes"), nb::keep_alive<0, 2>(),
      nb::call_guard<nb::gil_scoped_release>(),
      "A fit of given knots and sizes: its motion that of its own measurements, theta at its prior's mean.");
  nb::class_<Settings>(m, "Settings", "Of the estimator.")
      .def(nb::init<>())
      .def_rw("threads", &Settings::threads)
      .def_rw("discrepancy", &Settings::discrepancy)
      .def_rw("brief", &Settings::brief);
  nb::class_<Estimate>(m, "Estimate", "What the estimator found.")
      .def_ro("fit", &Estimate::fit)
      .def_ro("status", &Estimate::status)
      .def_ro("moments", &Estimate::moments)
      .def_ro("covariance", &Estimate::covariance)
      .def_ro("added", &Estimate::added)
      .def_ro("gain_covariance", &Estimate::gain_covariance)
      .def_ro("discrepancy2", &Estimate::discrepancy2)
      .def_ro("pose", &Estimate::pose)
      .def_ro("halves", &Estimate::halves)
      .def_ro("quarters", &Estimate::quarters)
      .def_ro("logs", &Estimate::logs)
      .def_prop_ro(
          "unresolved",
          [](const Estimate& e) { return std::vector<bool>(e.unresolved.begin(), e.unresolved.end()); })
      .def_ro("unexplained", &Estimate::unexplained)
      .def_ro("dropped", &Estimate::dropped)
      .def_ro("fits", &Estimate::fits);
  m.attr("MOST_LOST") = constants::most_lost;
  m.attr("DEPARTURE_FLOOR") = constants::departure_floor;
  m.attr("DOUBT") = constants::doubt;
  m.attr("UNDETERMINED") = constants::undetermined;
  m.attr("NOISE_TOLD") = constants::noise_told;
  m.attr("MASK_SHORTEST") = constants::mask_shortest;
  m.def("coarsest_spacing", &coarsest_spacing, nb::arg("period"),
        "h of (10.2) at its coarsest [s], for this period of the motion [s].");
  m.def(
      "estimate",
      [](const Statement& rig, std::vector<const RecordedLog*> logs, const Settings& settings) {
        return Estimator(std::make_shared<const Statement>(rig), std::move(logs), settings).run();
      },
      nb::arg("rig"), nb::arg("logs"), nb::arg("settings"), nb::keep_alive<0, 2>(),
      nb::call_guard<nb::gil_scoped_release>());
  nb::class_<Part>(m, "Part", "The fit of a part of a long record, put away.")
      .def("settle", &Part::settle, nb::arg("log"), nb::arg("first"),
           nb::call_guard<nb::gil_scoped_release>(),
           "At these values of the first parameters, with a step of all from there.")
      .def_prop_ro(
          "theta", [](const Part& p) { return Eigen::VectorXd(p.fit().theta + p.fit().step()); },
          "Where the step leads.")
      .def_prop_ro("covariance", [](const Part& p) { return p.fit().covariance(); });
  m.def(
      "put_away", [](Estimate& found) { return Part(std::move(*found.fit)); }, nb::arg("found"),
      "The fit behind an estimate of one log, which has none from here on.");
}

}  // namespace truewrench::python
