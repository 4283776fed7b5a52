// Whether code allocates, to be included before all else: the C allocator is wrapped by the linker, operator new is replaced
// (no_allocation.cpp), and Eigen says when it asks for memory.
#pragma once

namespace truewrench {

// Counts where it is asked to.
void note_allocation();
void count_allocations(bool on);
int allocations();

}  // namespace truewrench

#define EIGEN_RUNTIME_NO_MALLOC
#define eigen_assert(condition) ((condition) ? void() : truewrench::note_allocation())

#include <Eigen/Core>

namespace truewrench {

template <typename Steps>
int allocations_in(const Steps& steps) {
  count_allocations(true);
  Eigen::internal::set_is_malloc_allowed(false);
  steps();
  Eigen::internal::set_is_malloc_allowed(true);
  count_allocations(false);
  return allocations();
}

}  // namespace truewrench
