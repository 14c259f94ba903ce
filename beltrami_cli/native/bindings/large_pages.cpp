// Allocation functions that replace those of the language, and request huge pages for large blocks.
//
// Linux clears memory page by page when it is first touched: of 4 KiB that takes eight times as long as of 2 MiB, and
// as long as some of the stages that fill it. Memory from here lies in whole pages of 2 MiB; the system gives
// these or not. Memory comes from malloc as before, so it may be freed by anyone.
#if defined(__linux__)
#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>
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

}  // namespace

void* operator new(std::size_t size) {
  while (true) {
    if (void* const memory = allocate(size)) return memory;
    const auto handler = std::get_new_handler();
    if (handler == nullptr) throw std::bad_alloc();
    handler();
  }
}

void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
#endif
