// What the binding files share: array types at the boundary and one registration function per header.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace truewrench::python {

namespace nb = nanobind;

// Read-only, C-contiguous double arrays from NumPy; anything else is converted by the Python side.
using Array1 = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Array2 = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void bind_payload(nb::module_& m);
void bind_estimator(nb::module_& m);

}  // namespace truewrench::python
