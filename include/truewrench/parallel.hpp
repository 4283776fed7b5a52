// A loop over independent items on several threads. Which thread takes an item has no influence on its
// result, nor on which exception ends the loop.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace truewrench {

// Calls work(item) for item = 0 ... count - 1 on at most `threads` threads (0: as many as the machine has). Where some throw, no
// further item is taken, and what the lowest of them threw goes on from here: all items below it were taken before it.
template <typename Work>
void parallel_for(std::size_t count, int threads, const Work& work) {
  const std::size_t available = threads > 0 ? static_cast<std::size_t>(threads)
                                            : std::max<std::size_t>(1, std::thread::hardware_concurrency());
  const std::size_t workers = std::min(available, count);
  if (workers <= 1) {
    for (std::size_t i = 0; i < count; ++i) work(i);
    return;
  }
  std::atomic<std::size_t> next{0};
  std::mutex lock;
  std::exception_ptr thrown;  // out of a thread it would end the process
  std::size_t lowest = count;
  const auto run = [&] {
    for (std::size_t i = next++; i < count; i = next++) {
      try {
        work(i);
      } catch (...) {
        next = count;
        const std::scoped_lock held(lock);
        if (i >= lowest) continue;
        lowest = i;
        thrown = std::current_exception();
      }
    }
  };
  {
    std::vector<std::jthread> pool;  // joins
    pool.reserve(workers - 1);
    for (std::size_t i = 1; i < workers; ++i) pool.emplace_back(run);
    run();
  }
  if (thrown) std::rethrow_exception(thrown);
}

}  // namespace truewrench
