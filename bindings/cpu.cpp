// The instruction sets this processor offers; compiled for the baseline, so that it loads everywhere.
#include "cpu.hpp"

#include <nanobind/nanobind.h>

NB_MODULE(_cpu, m) {
  m.doc() = "Processor features, for the choice of the compiled core.";
  m.def("supports_x86_64_v3", &truewrench::supports_x86_64_v3,
        "Whether code compiled for x86-64-v3 (AVX2, FMA) runs here.");
}
