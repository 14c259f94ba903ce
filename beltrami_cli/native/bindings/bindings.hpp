// Common parts of the bindings: array types, transfer of memory, polls for signals and progress, and declarations.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <optional>
#include <vector>

#include "layout.hpp"
#include "parallel.hpp"

namespace beltrami::bindings {

namespace nb = nanobind;

void bind_atlas(nb::module_& module);
void bind_colours(nb::module_& module);
void bind_grid(nb::module_& module);
void bind_noise(nb::module_& module);
void bind_patches(nb::module_& module);
void bind_points(nb::module_& module);
void bind_triangulated(nb::module_& module);

template <class T>
using Matrix = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T>
using Vector = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Stack = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using OpenStack = nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Cells = Matrix<std::uint8_t>;
using Plane = Matrix<float>;
template <class T, class Shape>
using Result = nb::ndarray<nb::numpy, T, Shape, nb::c_contig>;

inline void require(bool holds, const char* what) {
  if (!holds) throw nb::value_error(what);
}

template <class Array>
void require_finite(const Array& array) {
  require(std::all_of(array.data(), array.data() + array.size(), [](auto x) { return std::isfinite(x); }),
          "all positions must be finite");
}

// Of a kernel; a window's slots are numbered by int.
inline void require_metric(double beta) { require(beta >= 0 && std::isfinite(beta), "beta must be a number, 0 or more"); }
inline void require_radius(double radius) { require(radius >= 0, "the radius must be a number, 0 or more"); }
inline void require_time_step(double t) { require(t > 0 && std::isfinite(t), "the time step must be a positive number"); }
inline void require_window(std::int64_t radius) { require(radius >= 0 && radius < 1 << 14, "a window has no such radius"); }

// A part of a list or tuple.
template <class T>
T part(const nb::handle& given) {
  T array;
  if (!nb::try_cast(given, array)) throw nb::type_error("an array or a number of another type is needed");
  return array;
}

// Channels along the first axis; the other axes are samples with a constant stride.
template <class Value>
using Channels = nb::ndarray<Value, nb::device::cpu>;

template <class Value>
std::size_t samples_of(const Channels<Value>& channels) {
  std::size_t count = 1;
  for (std::size_t axis = 1; axis < channels.ndim(); ++axis) count *= channels.shape(axis);
  return count;
}

template <class Value>
std::size_t channels_of(const Channels<Value>& channels) {
  require(channels.ndim() > 1, "channels lie along the first axis, and samples along others");
  return channels.shape(0);
}

template <class Value>
Layout<Value> layout_of(const Channels<Value>& stack, std::size_t channels, std::size_t samples) {
  if (stack.ndim() < 2 || stack.shape(0) != channels || samples_of(stack) != samples)
    throw nb::value_error("all stacks must have one shape");
  // Strides of axes of length 1 are arbitrary in NumPy.
  std::int64_t step = 0, next = 0;
  bool is_last = true;
  for (std::size_t axis = stack.ndim() - 1; axis > 0; --axis) {
    if (stack.shape(axis) == 1) continue;
    if (is_last) step = stack.stride(axis);
    if (!is_last && stack.stride(axis) != next)
      throw nb::value_error("samples must follow each other in even steps");
    next = stack.stride(axis) * static_cast<std::int64_t>(stack.shape(axis));
    is_last = false;
  }
  return {stack.data(), stack.stride(0), step};
}

// Transfers memory to NumPy without a copy.
template <class T, class Shape>
Result<T, Shape> give(std::unique_ptr<T[]> data, std::initializer_list<std::size_t> shape) {
  T* raw = data.release();
  nb::capsule owner(raw, [](void* memory) noexcept { delete[] static_cast<T*>(memory); });
  return Result<T, Shape>(raw, shape, owner);
}

// A copy for NumPy.
template <class T>
auto give_copy(const std::vector<T>& numbers) {
  std::unique_ptr<T[]> copy(new T[numbers.size()]);
  std::copy(numbers.begin(), numbers.end(), copy.get());
  return give<T, nb::ndim<1>>(std::move(copy), {numbers.size()});
}

// Transfers rows to NumPy without a copy.
template <class T, std::size_t N>
auto give_rows(std::vector<std::array<T, N>> rows) {
  auto kept = std::make_unique<std::vector<std::array<T, N>>>(std::move(rows));
  const std::size_t count = kept->size();
  T* first = reinterpret_cast<T*>(kept->data());
  nb::capsule owner(kept.release(), [](void* memory) noexcept { delete static_cast<std::vector<std::array<T, N>>*>(memory); });
  return Result<T, nb::shape<-1, static_cast<nb::ssize_t>(N)>>(first, {count, N}, owner);
}

// A poll that lets Python handle signals and report progress; an exception is kept until threads have joined.
class PythonPoll {
 public:
  explicit PythonPoll(const nb::object& progress) : progress_(progress) {}
  Poll poll() {
    return [this](std::size_t done) {
      const nb::gil_scoped_acquire lock;
      if (PyErr_CheckSignals() != 0) {
        error_.emplace();
        return false;
      }
      if (progress_.is_none()) return true;
      try {
        progress_(done);
      } catch (nb::python_error& error) {
        error_.emplace(error);
        return false;
      }
      return true;
    };
  }
  // Called with the interpreter lock held.
  void rethrow() {
    if (error_) throw nb::python_error(*error_);
  }

 private:
  const nb::object& progress_;
  std::optional<nb::python_error> error_;
};

// Runs work(poll) without the interpreter lock; rethrows an exception raised by Python meanwhile.
template <class Work>
void run_polled(const nb::object& progress, const Work& work) {
  PythonPoll poll(progress);
  try {
    const nb::gil_scoped_release unlock;
    work(poll.poll());
  } catch (const Cancelled&) {
    poll.rethrow();
    throw;
  }
}

}  // namespace beltrami::bindings
