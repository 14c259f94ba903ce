// exp(x) and log(x) in single precision, without branches or calls, so that compilers vectorise loops over them.
//
// Polynomials of S. Moshier's Cephes library. Static, so that every instruction set keeps its own.
#pragma once

#include <bit>
#include <cstdint>

namespace beltrami {

// exp(x) = 2^power * factor, for a float or for several side by side.
template <class Number>
struct PowerAndFactor {
  Number power, factor;  // the power is whole
};

// Range reduction to [-ln2/2, ln2/2], then a polynomial: relative error below 2e-7 for |x| < 88. Coefficients: expf.
template <class Number>
static inline PowerAndFactor<Number> split_exponential(Number x) {
  // Adding and subtracting 1.5 * 2^23 rounds to the nearest integer.
  const Number whole = (x * 1.44269504088896341F + 12582912.0F) - 12582912.0F;
  const Number rest = x - whole * 0.693359375F + whole * 2.12194440e-4F;
  Number p = rest * 1.9875691500e-4F + 1.3981999507e-3F;
  p = p * rest + 8.3334519073e-3F;
  p = p * rest + 4.1665795894e-2F;
  p = p * rest + 1.6666665459e-1F;
  p = p * rest + 5.0000001201e-1F;
  return {whole, p * rest * rest + rest + 1.0F};
}

// exp(x), with a relative error below 2e-7 where the result is a normal number.
static inline float exponential(float x) {
  x = x < -87.0F ? -87.0F : x;
  const auto [power, factor] = split_exponential(x > 88.0F ? 88.0F : x);
  return factor * std::bit_cast<float>((static_cast<std::int32_t>(power) + 127) << 23);
}

// Natural logarithm of a positive normal number: split into a power of 2 and a factor from sqrt(1/2) to sqrt(2), whose
// logarithm is a polynomial. Error below 2e-7, absolute or relative, whichever is larger. Coefficients: logf.
static inline float logarithm(float x) {
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

}  // namespace beltrami
