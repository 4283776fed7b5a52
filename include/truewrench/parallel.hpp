// A loop over independent items on several threads. Which thread takes an item has no influence on its
// result.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace truewrench {

// Calls work(item) for item = 0 ... count - 1 on at most `threads` threads (0: as many as the machine has).
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
  const auto run = [&] {
    for (std::size_t i = next++; i < count; i = next++) work(i);
  };
  std::vector<std::jthread> pool;
  pool.reserve(workers - 1);
  for (std::size_t i = 1; i < workers; ++i) pool.emplace_back(run);
  run();
}

}  // namespace truewrench
