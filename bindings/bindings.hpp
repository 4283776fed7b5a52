// What the binding files share: array types at the boundary and one registration function per header.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "truewrench/types.hpp"

#include <initializer_list>
#include <memory>
#include <string>

namespace truewrench::python {

namespace nb = nanobind;
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Flags = Eigen::Array<bool, Eigen::Dynamic, 1>;

// Read-only, C-contiguous double arrays from NumPy; anything else is converted by the Python side.
using Array1 = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Array2 = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Array3 = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

using ArrayOut = nb::ndarray<nb::numpy, double, nb::c_contig>;

// A new NumPy array of the given shape that owns its storage.
inline ArrayOut new_array(std::initializer_list<std::size_t> shape) {
  std::size_t count = 1;
  for (const std::size_t extent : shape) count *= extent;
  auto storage = std::make_unique<double[]>(count);
  const nb::capsule owner(storage.get(), [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return {storage.release(), shape, owner};
}

inline void expect_shape(const Array2& a, std::size_t rows, std::size_t columns, const char* name) {
  if (a.shape(0) == rows && a.shape(1) == columns) return;
  const std::string message = std::string(name) + ": expected " + std::to_string(rows) + " x " +
                              std::to_string(columns) + ", found " + std::to_string(a.shape(0)) + " x " +
                              std::to_string(a.shape(1));
  throw nb::value_error(message.c_str());
}

// ValueError for anything but Status::ok.
void require(Status status, const char* what);

void bind_status(nb::module_& m);
void bind_payload(nb::module_& m);
void bind_sensor(nb::module_& m);
void bind_ekf(nb::module_& m);
void bind_corrector(nb::module_& m);
void bind_contact(nb::module_& m);
void bind_record(nb::module_& m);
void bind_fit(nb::module_& m);
void bind_incremental(nb::module_& m);

}  // namespace truewrench::python
