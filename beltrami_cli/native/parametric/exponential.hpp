// exp(x) as a power of 2 and a factor, for floats and for as many of them side by side as there are.
#pragma once

namespace beltrami::parametric {

template <class Number>
struct PowerAndFactor {
  Number power, factor;  // the power is whole
};

// Range reduction to [-ln2/2, ln2/2], then a polynomial: relative error below 2e-7 for |x| < 88. Coefficients: S. Moshier,
// Cephes expf. Static, so that every instruction set keeps its own.
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

}  // namespace beltrami::parametric
