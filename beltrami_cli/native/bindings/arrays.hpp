// What the bindings share: array types, handing memory over, and polling for signals and progress.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <initializer_list>
#include <memory>
#include <optional>

#include "parallel.hpp"
#include "triangulated/metric.hpp"

namespace beltrami::bindings {

namespace nb = nanobind;

template <class T>
using Matrix = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T>
using Vector = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class T, class Shape>
using Result = nb::ndarray<nb::numpy, T, Shape, nb::c_contig>;

template <class T>
triangulated::Rows<T> rows_of(const Matrix<T>& matrix) {
  return {matrix.data(), matrix.shape(1)};
}

// Hands memory to NumPy without a copy.
template <class T, class Shape>
Result<T, Shape> give(std::unique_ptr<T[]> data, std::initializer_list<std::size_t> shape) {
  T* raw = data.release();
  nb::capsule owner(raw, [](void* memory) noexcept { delete[] static_cast<T*>(memory); });
  return Result<T, Shape>(raw, shape, owner);
}

// A poll that lets Python handle signals and report progress; what it raises is kept for after the join.
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
  // Called with the lock held.
  void rethrow() {
    if (error_) throw nb::python_error(*error_);
  }

 private:
  const nb::object& progress_;
  std::optional<nb::python_error> error_;
};

}  // namespace beltrami::bindings
