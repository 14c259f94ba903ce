#include "parallel.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace beltrami {
namespace {

// Interval of polls: short enough for a smooth progress bar and a prompt Ctrl-C, long enough to be free.
constexpr auto poll_interval = std::chrono::milliseconds(50);

class Crew {
 public:
  Crew(std::size_t count, std::size_t chunk, const ChunkBody& body) : count_(count), chunk_(chunk), body_(body) {}

  void work(unsigned worker) {
    try {
      while (!stop_) {
        const std::size_t begin = next_.fetch_add(chunk_);
        if (begin >= count_) break;
        const std::size_t end = std::min(count_, begin + chunk_);
        body_(begin, end, worker);
        done_ += end - begin;
      }
    } catch (...) {
      const std::lock_guard lock(mutex_);
      if (!failure_) failure_ = std::current_exception();
      stop_ = true;
    }
    const std::lock_guard lock(mutex_);
    ++finished_;
    all_done_.notify_one();
  }

  // Waits for all workers and polls; returns whether the poll asked to stop.
  bool wait(unsigned workers, const Poll& poll) {
    std::unique_lock lock(mutex_);
    bool cancelled = false;
    while (!all_done_.wait_for(lock, poll_interval, [&] { return finished_ == workers; })) {
      if (!poll || cancelled) continue;
      lock.unlock();
      cancelled = !poll(done_);
      if (cancelled) stop_ = true;
      lock.lock();
    }
    if (failure_) std::rethrow_exception(failure_);
    return cancelled;
  }

  void stop() { stop_ = true; }

 private:
  std::size_t count_, chunk_;
  const ChunkBody& body_;
  std::atomic<std::size_t> next_{0}, done_{0};
  std::atomic<bool> stop_{false};
  std::mutex mutex_;
  std::condition_variable all_done_;
  unsigned finished_ = 0;
  std::exception_ptr failure_;
};

}  // namespace

void parallel_chunks(std::size_t count, std::size_t chunk, unsigned threads, const ChunkBody& body, const Poll& poll) {
  if (count == 0) return;
  const std::size_t chunks = (count + chunk - 1) / chunk;
  const auto workers = static_cast<unsigned>(std::clamp<std::size_t>(threads, 1, chunks));
  Crew crew(count, chunk, body);
  std::vector<std::thread> pool;
  pool.reserve(workers);
  bool cancelled = false;
  try {
    try {
      for (unsigned worker = 0; worker < workers; ++worker) pool.emplace_back(&Crew::work, &crew, worker);
    } catch (const std::system_error&) {
      // No memory for another stack, or too many threads: the running threads do all the work.
      if (pool.empty()) crew.work(0);
    }
    cancelled = crew.wait(static_cast<unsigned>(std::max<std::size_t>(1, pool.size())), poll);
  } catch (...) {
    crew.stop();
    for (auto& thread : pool) thread.join();
    throw;
  }
  for (auto& thread : pool) thread.join();
  if (cancelled) throw Cancelled();
  if (poll && !poll(count)) throw Cancelled();
}

}  // namespace beltrami
