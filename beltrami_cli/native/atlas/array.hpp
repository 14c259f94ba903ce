// Arrays with one element per texel, in memory that the caller provides, possibly of a mapped file.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <new>

namespace beltrami::atlas {

// A block of memory, kept alive by references.
using Memory = std::shared_ptr<void>;
// Called from the calling thread only.
using Allocate = std::function<Memory(std::size_t bytes)>;

inline Memory allocate_on_heap(std::size_t bytes) {
  return {::operator new(bytes), [](void* memory) { ::operator delete(memory); }};
}

template <class T>
class Array {
 public:
  Array() = default;
  Array(std::size_t count, const Allocate& allocate) : size(count), memory_(allocate(count * sizeof(T))) {}
  T* data() { return static_cast<T*>(memory_.get()); }
  const T* data() const { return static_cast<const T*>(memory_.get()); }
  T& operator[](std::size_t i) { return data()[i]; }
  const T& operator[](std::size_t i) const { return data()[i]; }
  const Memory& memory() const { return memory_; }
  std::size_t size = 0;

 private:
  Memory memory_;
};

}  // namespace beltrami::atlas
