// The extension module: one registration call per header of the core.
#include "bindings.hpp"

NB_MODULE(TRUEWRENCH_MODULE, m) {
  m.doc() = "Numerical core of truewrench (C++20). The public face is the truewrench package.";
  truewrench::python::bind_status(m);
  truewrench::python::bind_payload(m);
  truewrench::python::bind_sensor(m);
  truewrench::python::bind_ekf(m);
  truewrench::python::bind_corrector(m);
  truewrench::python::bind_contact(m);
  truewrench::python::bind_record(m);
  truewrench::python::bind_fit(m);
  truewrench::python::bind_incremental(m);
}
