// The instruction sets of the processor that asks; compiled for the baseline.
#pragma once

namespace truewrench {

// Every processor with these four has the rest of x86-64-v3 (LZCNT, MOVBE, F16C) too.
inline bool supports_x86_64_v3() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
         __builtin_cpu_supports("bmi2");
#else
  return false;
#endif
}

}  // namespace truewrench
