// Whole records through include/truewrench/corrector.hpp.
#include "bindings.hpp"

#include "truewrench/corrector.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/pair.h>

#include <utility>

namespace truewrench::python {
namespace {

// Six channels, the usual case, with loops of fixed length.
struct AnyCorrector {
  Corrector<6> six;
  Corrector<> more;
  Eigen::Index channels = 0;

  AnyCorrector() = default;  // without a calibration: every use of it raises
  AnyCorrector(const RowMatrix& gain, const Eigen::VectorXd& offset, const Eigen::VectorXd& noise,
               const Eigen::MatrixXd& covariance, const Eigen::VectorXd& quadratic,
               const Eigen::VectorXd& discrepancy)
      : channels(gain.rows()) {
    if (channels < 6 || channels > max_channels || gain.cols() != 6 || offset.size() != channels ||
        noise.size() != channels)
      require(Status::wrong_size, "gain, offset and noise of 6 to 32 channels");
    require(channels == 6 ? six.configure({gain, offset, noise}, covariance, quadratic, discrepancy)
                          : more.configure({gain, offset, noise}, covariance, quadratic, discrepancy),
            "calibration");
  }

  Status status() const {
    return six.configured() || more.configured() ? Status::ok : Status::not_configured;
  }

  std::pair<ArrayOut, ArrayOut> correct(const Array2& raw) const {
    require(status(), "corrector");
    const std::size_t n = raw.shape(0);
    expect_shape(raw, n, static_cast<std::size_t>(channels), "raw");
    ArrayOut wrench = new_array({n, 6});
    ArrayOut deviation = new_array({n, 6});
    const nb::gil_scoped_release unlocked;
    Correction sample;
    for (std::size_t i = 0; i < n; ++i) {
      const double* row = raw.data() + i * static_cast<std::size_t>(channels);
      // A sample that is not finite leaves NaN, which is all there is to say of it.
      static_cast<void>(channels == 6 ? six.step(row, sample) : more.step(row, sample));
      Eigen::Map<Vector6>(wrench.data() + 6 * i) = sample.wrench;
      Eigen::Map<Vector6>(deviation.data() + 6 * i) = sample.std;
    }
    return {wrench, deviation};
  }

  Matrix6 covariance(const Vector6& wrench) const {
    require(status(), "corrector");
    return channels == 6 ? six.covariance(wrench) : more.covariance(wrench);
  }
};

}  // namespace

void bind_corrector(nb::module_& m) {
  nb::class_<AnyCorrector>(m, "Corrector", "Raw channels to the true wrench and its uncertainty.")
      .def(nb::init<>(), "Without a calibration: `status` says so, and correcting raises ValueError.")
      .def(nb::init<const RowMatrix&, const Eigen::VectorXd&, const Eigen::VectorXd&, const Eigen::MatrixXd&,
                    const Eigen::VectorXd&, const Eigen::VectorXd&>(),
           nb::arg("gain"), nb::arg("offset"), nb::arg("noise"), nb::arg("covariance"),
           nb::arg("quadratic") = Eigen::VectorXd(), nb::arg("discrepancy") = Eigen::VectorXd(),
           "gain (n, 6), offset (n,), 1-sigma noise per sample (n,) and the covariance (7n, 7n) of [gain row "
           "by row,\n"
           "offset]; quadratic (n,), 1 sigma of a channel's departure from linear over (raw - offset)^2;\n"
           "discrepancy (n,), 1 sigma of a sample beside the noise. Raises ValueError when the gain cannot "
           "be inverted.")
      .def_prop_ro("status", &AnyCorrector::status, "`ok`, or `not_configured` without a calibration.")
      .def("correct", &AnyCorrector::correct, nb::arg("raw"),
           "The true wrench (N, 6) [N, N m] of raw samples (N, n), and its 1 sigma (N, 6); NaN where a "
           "channel has none.")
      .def("covariance", &AnyCorrector::covariance, nb::arg("wrench"),
           "Covariance (6, 6) of one corrected wrench (6,).");
}

}  // namespace truewrench::python
