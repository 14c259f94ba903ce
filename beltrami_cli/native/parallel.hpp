// Parallel loops in fixed chunks, so that results do not depend on the number of threads.
#pragma once

#include <cstddef>
#include <functional>
#include <stdexcept>

namespace beltrami {

// Called from the calling thread a few times per second with the number of items done; returns false to stop.
using Poll = std::function<bool(std::size_t done)>;

// Handles items [begin, end); worker is in [0, threads).
using ChunkBody = std::function<void(std::size_t begin, std::size_t end, unsigned worker)>;

struct Cancelled : std::runtime_error {
  Cancelled() : std::runtime_error("cancelled") {}
};

// Runs body over [0, count) in chunks on `threads` threads. Chunks run in any order, so each must write only to its own
// items. Throws Cancelled if poll returned false, or the first exception of a body.
void parallel_chunks(std::size_t count, std::size_t chunk, unsigned threads, const ChunkBody& body,
                     const Poll& poll = {});

}  // namespace beltrami
