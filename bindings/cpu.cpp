// The instruction sets this processor offers; compiled for the baseline, so that it loads everywhere.
#include <nanobind/nanobind.h>

namespace {

// Every processor with these four has the rest of x86-64-v3 (LZCNT, MOVBE, F16C) too.
bool supports_x86_64_v3() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
         __builtin_cpu_supports("bmi2");
#else
  return false;
#endif
}

}  // namespace

NB_MODULE(_cpu, m) {
  m.doc() = "Processor features, for the choice of the compiled core.";
  m.def("supports_x86_64_v3", &supports_x86_64_v3,
        "Whether code compiled for x86-64-v3 (AVX2, FMA) runs here.");
}
