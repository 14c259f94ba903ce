#include "parametric/local_scale.hpp"

#include <algorithm>
#include <bit>
#include <cfloat>
#include <cstdint>
#include <vector>

#include "parametric/exponential.hpp"

namespace beltrami::parametric {
namespace {

// Natural logarithm of a positive normal number, as loops over arrays can do it side by side: split into a power of 2
// and a factor from sqrt(1/2) to sqrt(2), whose logarithm is a polynomial. Absolute error below 2e-7 of the result, or
// of 1. Coefficients: S. Moshier, Cephes logf.
float logarithm(float x) {
  constexpr std::int32_t root_of_half = 0x3f3504f3;
  const std::int32_t bits = std::bit_cast<std::int32_t>(x) - root_of_half;
  const auto power = static_cast<float>(bits >> 23);
  const float f = std::bit_cast<float>((bits & 0x7fffff) + root_of_half) - 1.0F;
  float p = f * 7.0376836292e-2F - 1.1514610310e-1F;
  p = p * f + 1.1676998740e-1F;
  p = p * f - 1.2420140846e-1F;
  p = p * f + 1.4249322787e-1F;
  p = p * f - 1.6668057665e-1F;
  p = p * f + 2.0000714765e-1F;
  p = p * f - 2.4999993993e-1F;
  p = p * f + 3.3333331174e-1F;
  return power * 0.693147180559945F + (f + f * f * (p * f - 0.5F));
}

// exp(x), with a relative error below 2e-7 where the result is a normal number.
float exponential(float x) {
  x = x < -87.0F ? -87.0F : x;
  const auto [power, factor] = split_exponential(x > 88.0F ? 88.0F : x);
  return factor * std::bit_cast<float>((static_cast<std::int32_t>(power) + 127) << 23);
}

// Logarithms of the lengths of edges, and how many edges there are: of the two axes at a cell, or of many such.
struct Sums {
  std::vector<float> logarithms, counts;
  explicit Sums(std::size_t size) : logarithms(size), counts(size) {}
};

bool is_length(float squared) { return (squared >= FLT_MIN) & (squared <= FLT_MAX); }

void take_logarithms(const float* right, const float* below, std::size_t count, float* logarithms, float* counts) {
  for (std::size_t i = 0; i < count; ++i) {
    const bool goes_right = is_length(right[i]), goes_below = is_length(below[i]);
    logarithms[i] = logarithm(goes_right ? right[i] : 1.0F) + logarithm(goes_below ? below[i] : 1.0F);
    counts[i] = (goes_right ? 1.0F : 0.0F) + (goes_below ? 1.0F : 0.0F);
  }
}

}  // namespace

void local_scale(std::size_t rows, std::size_t columns, const float* right, const float* below, int window_radius, float* scale) {
  const auto reach = static_cast<std::size_t>(window_radius);
  // Sums over the window's rows, one a column, move down with the window; those over its columns along the row. The rows
  // in the window are kept. In doubles, what is added and taken away again leaves nothing.
  const std::size_t held = 2 * reach + 1;
  Sums kept(held * columns), window(columns);
  // Beyond both ends there is nothing.
  std::vector<double> padded(columns + held), padded_counts(columns + held);
  double *down = padded.data() + reach + 1, *counts_down = padded_counts.data() + reach + 1;
  const auto move = [&](std::size_t row, bool in) {
    float* logarithms = kept.logarithms.data() + row % held * columns;
    float* counts = kept.counts.data() + row % held * columns;
    if (in) take_logarithms(right + row * columns, below + row * columns, columns, logarithms, counts);
    const double sign = in ? 1 : -1;
    for (std::size_t column = 0; column < columns; ++column) {
      down[column] += sign * static_cast<double>(logarithms[column]);
      counts_down[column] += sign * static_cast<double>(counts[column]);
    }
  };
  for (std::size_t row = 0; row < std::min(reach, rows); ++row) move(row, true);
  for (std::size_t row = 0; row < rows; ++row) {
    if (row > reach) move(row - reach - 1, false);
    if (row + reach < rows) move(row + reach, true);
    double logarithm_sum = 0, count = 0;
    for (std::size_t column = 0; column < std::min(reach, columns); ++column) {
      logarithm_sum += down[column];
      count += counts_down[column];
    }
    for (std::size_t column = 0; column < columns; ++column) {
      logarithm_sum += padded[column + held] - padded[column];
      count += padded_counts[column + held] - padded_counts[column];
      window.logarithms[column] = static_cast<float>(logarithm_sum);
      window.counts[column] = static_cast<float>(count);  // whole, so it comes out exactly
    }
    for (std::size_t column = 0; column < columns; ++column) {
      const float edges = window.counts[column] < 1.0F ? 1.0F : window.counts[column];  // without any the sum is 0
      scale[row * columns + column] = exponential(-window.logarithms[column] / edges);
    }
  }
}

}  // namespace beltrami::parametric
