// The traps of no_allocation.hpp, and that they see.
#include "no_allocation.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

namespace {
// Volatile, because a compiler knows that malloc does not touch them.
volatile int counted = 0;
volatile bool counting = false;
}  // namespace

namespace truewrench {
void note_allocation() {
  if (counting) counted = counted + 1;
}
void count_allocations(bool on) {
  if (on) counted = 0;
  counting = on;
}
int allocations() { return counted; }
}  // namespace truewrench

// The names are the linker's (--wrap). NOLINTBEGIN(bugprone-reserved-identifier)
extern "C" {
void* __real_malloc(std::size_t);
void* __real_calloc(std::size_t, std::size_t);
void* __real_realloc(void*, std::size_t);
int __real_posix_memalign(void**, std::size_t, std::size_t);
void* __real_aligned_alloc(std::size_t, std::size_t);

void* __wrap_malloc(std::size_t n) {
  truewrench::note_allocation();
  return __real_malloc(n);
}
void* __wrap_calloc(std::size_t k, std::size_t n) {
  truewrench::note_allocation();
  return __real_calloc(k, n);
}
void* __wrap_realloc(void* p, std::size_t n) {
  truewrench::note_allocation();
  return __real_realloc(p, n);
}
int __wrap_posix_memalign(void** p, std::size_t alignment, std::size_t n) {
  truewrench::note_allocation();
  return __real_posix_memalign(p, alignment, n);
}
void* __wrap_aligned_alloc(std::size_t alignment, std::size_t n) {
  truewrench::note_allocation();
  return __real_aligned_alloc(alignment, n);
}
}
// NOLINTEND(bugprone-reserved-identifier)

void* operator new(std::size_t n) {
  if (void* p = std::malloc(n)) return p;
  throw std::bad_alloc();
}
void* operator new(std::size_t n, std::align_val_t alignment) {
  const auto a = static_cast<std::size_t>(alignment);
  if (void* p = std::aligned_alloc(a, (n + a - 1) / a * a)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }
void operator delete(void* p, std::align_val_t) noexcept { std::free(p); }
void operator delete(void* p, std::size_t, std::align_val_t) noexcept { std::free(p); }

namespace truewrench {
namespace {

// Without this, a build that bypasses them would pass.
TEST(NoAllocation, TrapsSeeAllocations) {
  void* volatile block = nullptr;
  int* volatile number = nullptr;
  EXPECT_EQ(allocations_in([&] { block = std::malloc(16); }), 1);
  EXPECT_EQ(allocations_in([&] { number = new int(1); }), 1);
  std::free(block);
  delete number;
  // Eigen's word and the malloc behind it.
  EXPECT_EQ(allocations_in([] { EXPECT_EQ(Eigen::MatrixXd::Zero(3, 3).eval()(0, 0), 0.0); }), 2);
}

}  // namespace
}  // namespace truewrench
