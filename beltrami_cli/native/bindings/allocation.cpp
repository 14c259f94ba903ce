// Allocation functions that replace those of the language on Linux.
//
// They request huge pages for large blocks. Linux clears memory page by page when it is first touched: of 4 KiB that takes
// eight times as long as of 2 MiB, and as long as some of the stages that fill it. Memory from here lies in whole pages of
// 2 MiB; the system gives these or not. Memory comes from malloc as before, so it may be freed by anyone.
//
// Before they throw bad_alloc, they give a reserve back to the system: a thread takes memory from malloc for its first
// exception, and if there is none, glibc ends the process with exit code 127.
#if defined(__linux__)
#include <sys/mman.h>

#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <mutex>
#include <new>

namespace {

constexpr std::size_t huge_page = std::size_t{1} << 21;

// Minimum size: below, the partly used last page would waste too much.
constexpr std::size_t least_size = 2 * huge_page;

void* allocate(std::size_t size) {
  if (size < least_size) return std::malloc(size == 0 ? 1 : size);
  void* const memory = std::aligned_alloc(huge_page, (size + huge_page - 1) / huge_page * huge_page);
  if (memory != nullptr) madvise(memory, size, MADV_HUGEPAGE);
  return memory;
}

// A thread that has no arena of malloc yet takes 132 KiB at once: enough for 31 of them.
constexpr std::size_t reserve_size = std::size_t{1} << 22;
constinit std::atomic<bool> has_reserve = false;
constinit std::mutex reserve_mutex;
constinit void* reserve = nullptr;

void fill_reserve() {
  if (has_reserve) return;
  const std::unique_lock lock(reserve_mutex, std::try_to_lock);
  if (!lock || has_reserve) return;
  // Not from malloc, which shares its memory among some threads only.
  reserve = mmap(nullptr, reserve_size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  has_reserve = reserve != MAP_FAILED;
}

[[noreturn]] void throw_with_reserve() {
  const std::lock_guard lock(reserve_mutex);  // until the thread has what it needs
  if (has_reserve.exchange(false)) munmap(reserve, reserve_size);
  throw std::bad_alloc();
}

}  // namespace

void* operator new(std::size_t size) {
  while (true) {
    if (void* const memory = allocate(size)) {
      fill_reserve();
      return memory;
    }
    const auto handler = std::get_new_handler();
    if (handler == nullptr) throw_with_reserve();
    handler();
  }
}

void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
#endif
