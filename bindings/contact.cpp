// Rows of a log through include/truewrench/contact/.
#include "bindings.hpp"

#include "truewrench/contact/events.hpp"
#include "truewrench/contact/rows.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <tuple>
#include <utility>
#include <vector>

namespace truewrench::python {
namespace {

using Stamps = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using StampsOut = nb::ndarray<nb::numpy, std::int64_t, nb::ndim<1>, nb::c_contig>;
using Results = std::tuple<StampsOut, StampsOut, ArrayOut, ArrayOut, ArrayOut, ArrayOut, ArrayOut>;
using Event = std::tuple<std::int64_t, std::int64_t, double, Vector3>;

Event told(const ContactEvent& e) { return {e.begin_ns, e.end_ns, e.peak_force, e.point}; }

// Contact wrenches of rows, as NumPy takes them.
struct Found {
  std::vector<std::int64_t> rows, times;
  std::vector<double> wrench, covariance, chi2, turn, heading;

  void add(std::int64_t row, const ContactWrench& w) {
    rows.push_back(row);
    times.push_back(w.time_ns);
    chi2.push_back(w.chi2);
    wrench.insert(wrench.end(), w.wrench.data(), w.wrench.data() + 6);
    covariance.insert(covariance.end(), w.covariance.data(), w.covariance.data() + 36);
    const Matrix3 rowwise = w.R_sensor_root.transpose();
    turn.insert(turn.end(), rowwise.data(), rowwise.data() + 9);
    heading.push_back(w.heading ? 1.0 : 0.0);
  }

  static StampsOut stamps(const std::vector<std::int64_t>& from) {
    auto* storage = new std::vector<std::int64_t>(from);
    const nb::capsule owner(storage,
                            [](void* p) noexcept { delete static_cast<std::vector<std::int64_t>*>(p); });
    return {storage->data(), {storage->size()}, owner};
  }
  static ArrayOut array(const std::vector<double>& from, std::initializer_list<std::size_t> shape) {
    ArrayOut out = new_array(shape);
    std::copy(from.begin(), from.end(), out.data());
    return out;
  }

  Results results() const {
    const std::size_t m = rows.size();
    return {stamps(rows),     stamps(times),          array(wrench, {m, 6}), array(covariance, {m, 6, 6}),
            array(chi2, {m}), array(turn, {m, 3, 3}), array(heading, {m})};
  }
};

struct Rows {
  ContactRows rows;
  ContactEvents events;
  std::vector<Event> ended;

  Rows(const contact::Settings& settings, double window, bool newest, bool imu, int capacity) {
    require(rows.configure(settings, window, newest, imu, capacity), "contact");
  }

  void take(std::int64_t row, const ContactWrench& w, Found& found) {
    found.add(row, w);
    if (const auto event = events.step(w, rows.contact.center_of_mass())) ended.push_back(told(*event));
  }

  Results feed(const Stamps& time, const Array2& raw, const Array2& twist, const Array2& fall,
               const Array2& turn, const Array1& temperature, const Array2& noise) {
    const std::size_t count = time.shape(0), n = static_cast<std::size_t>(rows.contact.channels());
    expect_shape(raw, count, n, "raw");
    expect_shape(twist, count, 6, "twist");
    expect_shape(fall, count, 3, "fall");
    expect_shape(turn, count, 9, "R_sensor_root");
    if (noise.shape(0) != 0) expect_shape(noise, count, 36, "twist_noise");
    if (temperature.shape(0) != count) throw nb::value_error("temperature: expected one per row");
    Found found;
    Status status = Status::ok;
    for (std::size_t i = 0; i < count && status == Status::ok; ++i) {
      rows.contact.set_temperature(temperature.data()[i]);
      if (noise.shape(0) != 0 && std::isfinite(noise.data()[36 * i]))
        rows.contact.set_twist_noise(Eigen::Map<const Matrix6>(noise.data() + 36 * i));
      const ContactRow row{
          time.data()[i], raw.data() + n * i, Eigen::Map<const Vector6>(twist.data() + 6 * i),
          Eigen::Map<const Vector3>(fall.data() + 3 * i),
          Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(turn.data() + 9 * i)};
      status = rows.feed(row, [&](std::int64_t k, const ContactWrench& w) { take(k, w, found); });
    }
    require(status, "rows");
    return found.results();
  }

  Results finish() {
    Found found;
    rows.finish([&](std::int64_t k, const ContactWrench& w) { take(k, w, found); });
    if (const auto event = events.finish()) ended.push_back(told(*event));
    return found.results();
  }

  void restart() {
    if (const auto event = events.finish()) ended.push_back(told(*event));
    rows.restart();
  }

  std::string tare() {
    switch (rows.contact.tare()) {
      case Tare::accepted:
        return "accepted";
      case Tare::in_contact:
        return "in_contact";
      case Tare::nothing:
        return "nothing";
      case Tare::singular:
        return "singular";
    }
    return "";
  }
};

}  // namespace

void bind_contact(nb::module_& m) {
  using contact::Settings;
  m.attr("contact_limit") = contact_limit;
  m.attr("FARTHEST_NS") = contact::Ring::farthest;
  m.attr("PACKETS_APART") = contact::EvenStamps::apart_ns;
  m.attr("PACKETS_CLOSE") = contact::EvenStamps::close;
  m.attr("PACKETS_SHARE") = contact::EvenStamps::share;
  m.attr("PACKETS_LEARNED") = contact::EvenStamps::learned;
  nb::class_<Settings>(m, "ContactSettings", "What is known of sensor and tool (truewrench.tool.Tool).")
      .def(nb::init<>())
      .def(
          "set_sensor",
          [](Settings& s, const RowMatrix& gain, const Eigen::VectorXd& offset, const Eigen::VectorXd& noise,
             bool payload_on_sensor) {
            if (gain.rows() < 6 || gain.rows() > max_channels || gain.cols() != 6 ||
                offset.size() != gain.rows() || noise.size() != gain.rows())
              require(Status::wrong_size, "gain, offset and noise of 6 to 32 channels");
            s.sensor = {gain, offset, noise};
            s.feels = payload_on_sensor ? Feels::payload_on_sensor : Feels::sensor_on_payload;
          },
          nb::arg("gain"), nb::arg("offset"), nb::arg("noise"), nb::arg("payload_on_sensor"))
      .def_rw("mass", &Settings::mass)
      .def_rw("center_of_mass", &Settings::center_of_mass)
      .def_rw("S", &Settings::S)
      .def_rw("mounting", &Settings::mounting)
      .def_rw("tilt", &Settings::tilt)
      .def_rw("gravity", &Settings::gravity)
      .def_rw("covariance", &Settings::covariance)
      .def_rw("offset_time_ns", &Settings::offset_time_ns)
      .def_rw("offset_walk", &Settings::offset_walk)
      .def_rw("pose_repeatability", &Settings::pose_repeatability)
      .def_rw("slow_error", &Settings::slow_error)
      .def_rw("time_offset", &Settings::time_offset)
      .def_rw("time_offset_std", &Settings::time_offset_std)
      .def_rw("temperature_slope", &Settings::temperature_slope)
      .def_rw("temperature_slope_std", &Settings::temperature_slope_std)
      .def_rw("temperature_reference", &Settings::temperature_reference)
      .def_rw("quadratic_std", &Settings::quadratic_std)
      .def_rw("full_scale", &Settings::full_scale)
      .def_rw("twist_noise", &Settings::twist_noise)
      .def_rw("gravity_noise", &Settings::gravity_noise);
  nb::class_<Rows>(m, "ContactRows", "Contact wrenches of the rows of a log, in their order.")
      .def(nb::init<const Settings&, double, bool, bool, int>(), nb::arg("settings"), nb::arg("window"),
           nb::arg("newest"), nb::arg("imu") = false, nb::arg("capacity") = 1024,
           "Kernels of `window` seconds around each row, or, `newest`, that end at it.")
      .def("feed", &Rows::feed, nb::arg("time_ns"), nb::arg("raw"), nb::arg("twist"), nb::arg("fall"),
           nb::arg("turn"), nb::arg("temperature"), nb::arg("twist_noise"),
           "Rows: stamps (N,), channels (N, n), twist (N, 6), free fall (N, 3), R_sensor_root (N, 9), "
           "temperature "
           "(N,) and,\n"
           "or none of it, the covariance of the twist (N, 36). Gives the M rows that have their contact "
           "wrench "
           "now: their\n"
           "numbers (M,), moments (M,), wrench (M, 6), covariance (M, 6, 6), chi2 (M,), R_sensor_root (M, 3, "
           "3), and\n"
           "(M,) 1 where its turn about gravity is known, else 0.")
      .def("finish", &Rows::finish, "The rows that waited for others, as `feed` gives them.")
      .def("restart", &Rows::restart, "As if no row had come yet, where stamps begin again; tares stay.")
      .def("tare", &Rows::tare, "`accepted`, or why not: `in_contact`, `nothing`, `singular`.")
      .def(
          "ended", [](Rows& r) { return std::exchange(r.ended, {}); },
          "Events that have ended since the last call: begin and end [ns], peak force [N], point (3,) [m].")
      .def_prop_ro("in_contact", [](const Rows& r) { return r.events.active(); })
      .def_prop_ro(
          "lag", [](const Rows& r) { return r.rows.lag(); }, "Rows after which one has its wrench.")
      .def_prop_ro("too_long", [](const Rows& r) { return r.rows.too_long(); })
      .def_prop_ro(
          "due", [](const Rows& r) { return r.rows.due(); },
          "Number of the row that has its wrench with the latest one, at the earliest; -1: none yet.")
      .def_prop_ro(
          "delay", [](const Rows& r) { return r.rows.contact.delay(); }, "The same in seconds.")
      .def_prop_ro(
          "theta", [](const Rows& r) -> Eigen::VectorXd { return r.rows.contact.theta(); },
          "The parameters, which a tare moves.")
      .def_prop_ro("center_of_mass",
                   [](const Rows& r) -> Vector3 { return r.rows.contact.center_of_mass(); });
}

}  // namespace truewrench::python
