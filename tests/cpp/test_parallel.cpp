// A loop on several threads: every item once, and what throws in a thread is thrown in the caller.
#include "truewrench/parallel.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <stdexcept>
#include <string>

namespace truewrench {
namespace {

TEST(Parallel, TakesEveryItemOnce) {
  std::vector<int> taken(1000, 0);
  parallel_for(taken.size(), 4, [&](std::size_t i) { ++taken[i]; });
  EXPECT_EQ(std::count(taken.begin(), taken.end(), 1), 1000);
}

TEST(Parallel, ThrowsWhatTheLowestItemThrew) {
  for (const int threads : {1, 2, 4}) {
    std::atomic<int> taken{0};
    std::string what;
    try {
      parallel_for(64, threads, [&](std::size_t i) {
        ++taken;
        // the lower of them is the later
        std::this_thread::sleep_for(std::chrono::milliseconds(i == 3 ? 30 : 1));
        if (i == 3 || i == 4) throw std::runtime_error(std::to_string(i));
      });
    } catch (const std::runtime_error& e) {
      what = e.what();
    }
    EXPECT_EQ(what, "3") << threads;
    EXPECT_LT(taken, 64) << threads;
  }
}

}  // namespace
}  // namespace truewrench
