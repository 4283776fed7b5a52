// Steps of the filter, the corrector and the contact wrench neither allocate nor throw. Three traps: the C allocator is
// wrapped by the linker, operator new is replaced, and Eigen says when it asks for memory.
namespace {
// Volatile, because a compiler knows that malloc does not touch them.
volatile int allocations = 0;
volatile bool counting = false;

void note() {
  if (counting) allocations = allocations + 1;
}
}  // namespace

#define EIGEN_RUNTIME_NO_MALLOC
#define eigen_assert(condition) ((condition) ? void() : note())

#include "truewrench/contact/rows.hpp"
#include "truewrench/corrector.hpp"
#include "truewrench/ekf.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

// The names are the linker's (--wrap). NOLINTBEGIN(bugprone-reserved-identifier)
extern "C" {
void* __real_malloc(std::size_t);
void* __real_calloc(std::size_t, std::size_t);
void* __real_realloc(void*, std::size_t);
int __real_posix_memalign(void**, std::size_t, std::size_t);
void* __real_aligned_alloc(std::size_t, std::size_t);

void* __wrap_malloc(std::size_t n) {
  note();
  return __real_malloc(n);
}
void* __wrap_calloc(std::size_t k, std::size_t n) {
  note();
  return __real_calloc(k, n);
}
void* __wrap_realloc(void* p, std::size_t n) {
  note();
  return __real_realloc(p, n);
}
int __wrap_posix_memalign(void** p, std::size_t alignment, std::size_t n) {
  note();
  return __real_posix_memalign(p, alignment, n);
}
void* __wrap_aligned_alloc(std::size_t alignment, std::size_t n) {
  note();
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

template <typename Steps>
int allocations_in(const Steps& steps) {
  allocations = 0;
  counting = true;
  Eigen::internal::set_is_malloc_allowed(false);
  steps();
  Eigen::internal::set_is_malloc_allowed(true);
  counting = false;
  return allocations;
}

template <bool Offset>
void filter_does_not_allocate() {
  const Payload payload;
  Ekf<Offset> filter(payload, {});
  const Vector6 raw = Vector6::Random();
  const Vector6 twist = Vector6::Random();
  const Vector6 missing = Vector6::Constant(std::numeric_limits<double>::quiet_NaN());
  const Vector3 gravity = Vector3::Zero();
  static_assert(noexcept(filter.predict(0.01)) && noexcept(filter.update(raw, twist, gravity)));
  Status worst = Status::ok;
  double sum = 0.0;
  const int count = allocations_in([&] {
    for (int i = 0; i < 1000; ++i) {
      const Status moved = filter.predict(0.01);
      const Status updated = filter.update(i % 3 == 0 ? missing : raw, i % 5 == 0 ? missing : twist, gravity);
      worst = std::max({worst, moved, updated});
      sum += filter.last_update().nis + filter.state()(12) + filter.covariance()(0, 0) + filter.gain()(0, 0);
    }
  });
  EXPECT_EQ(count, 0);
  EXPECT_EQ(worst, Status::ok);
  EXPECT_TRUE(std::isfinite(sum));
}

template <int N>
void corrector_does_not_allocate(int n) {
  Corrector<N> corrector;
  SensorModel<N> sensor;
  sensor.gain = Eigen::MatrixXd::Identity(n, 6);
  sensor.offset = Eigen::VectorXd::Zero(n);
  sensor.noise = Eigen::VectorXd::Ones(n);
  ASSERT_EQ(corrector.configure(sensor, Eigen::MatrixXd::Identity(7 * n, 7 * n)), Status::ok);
  const Eigen::VectorXd raw = Eigen::VectorXd::Random(n);
  Correction out;
  const double* const samples = raw.data();
  static_assert(noexcept(corrector.step(samples, out)) && noexcept(corrector.covariance(out.wrench)));
  double sum = 0.0;
  const int count = allocations_in([&] {
    for (int i = 0; i < 1000; ++i) {
      if (corrector.step(samples, out) == Status::ok) sum += corrector.covariance(out.wrench)(0, 0);
    }
  });
  EXPECT_EQ(count, 0);
  EXPECT_GT(sum, 0.0);
}

void contact_does_not_allocate(int n) {
  contact::Settings s;
  s.sensor.gain = Eigen::MatrixXd::Identity(n, 6) + 0.1 * Eigen::MatrixXd::Ones(n, 6);
  s.sensor.offset = Eigen::VectorXd::Zero(n);
  s.sensor.noise = Eigen::VectorXd::Ones(n);
  s.covariance = 1e-4 * Eigen::MatrixXd::Identity(7 * n + 15, 7 * n + 15);
  s.time_offset_std = 1e-3;
  s.temperature_slope_std = s.quadratic_std = Eigen::VectorXd::Constant(n, 1e-3);
  s.full_scale = Eigen::VectorXd::Ones(n);
  for (const bool newest : {false, true}) {
    ContactRows rows;
    ASSERT_EQ(rows.configure(s, 0.02, newest, false, 1024), Status::ok);
    const Eigen::VectorXd raw = 0.01 * Eigen::VectorXd::Ones(n);
    int given = 0;
    Tare tare = Tare::nothing;
    const int count = allocations_in([&] {
      for (std::int64_t i = 0; i < 1000; ++i) {
        const ContactRow row{2'000'000 * i, raw.data(),
                             Vector6::Constant(0.01 * std::sin(0.05 * static_cast<double>(i))),
                             Vector3::Zero(), Matrix3::Identity()};
        static_cast<void>(rows.feed(row, [&](std::int64_t, const ContactWrench&) { ++given; }));
      }
      tare = rows.contact.tare();
    });
    EXPECT_EQ(count, 0);
    EXPECT_GT(given, 950);
    EXPECT_EQ(tare, Tare::accepted);
  }
}

// The traps themselves: without this, a build that bypasses them would pass.
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

TEST(NoAllocation, FilterStep) { filter_does_not_allocate<false>(); }
TEST(NoAllocation, FilterStepWithOffset) { filter_does_not_allocate<true>(); }
TEST(NoAllocation, CorrectorStep) {
  corrector_does_not_allocate<6>(6);
  corrector_does_not_allocate<Eigen::Dynamic>(9);
}
TEST(NoAllocation, ContactRowsAndTare) {
  contact_does_not_allocate(6);
  contact_does_not_allocate(8);
}

}  // namespace
}  // namespace truewrench
