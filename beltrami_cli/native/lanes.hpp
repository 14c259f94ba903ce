// As many floats side by side as one register of the instruction set holds, see instruction_set.hpp. Lanes never mix, so
// their number does not change any result.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__AVX__) || defined(__SSE__)
#include <immintrin.h>
#endif

#include "exp_log.hpp"

namespace beltrami::lanes::BELTRAMI_VARIANT {

#if defined(__AVX512F__)
constexpr std::size_t lane_count = 16;
#elif defined(__AVX__)
constexpr std::size_t lane_count = 8;
#else
constexpr std::size_t lane_count = 4;
#endif

#if defined(__GNUC__)
using Lanes = float __attribute__((vector_size(4 * lane_count)));
using Mask = std::int32_t __attribute__((vector_size(4 * lane_count)));

inline Lanes splat(float value) { return value - Lanes{}; }
inline Lanes select(Mask mask, Lanes yes, Lanes no) { return mask ? yes : no; }
// Rounds towards zero, and takes bits as they are.
inline Mask to_integers(Lanes value) { return __builtin_convertvector(value, Mask); }
inline Lanes from_bits(Mask bits) { return reinterpret_cast<Lanes>(bits); }
#else
// Other compilers: the same operations lane by lane.
template <class T>
struct Pack {
  T lane[lane_count];  // not set by itself, so that bytes may be copied over it
  T operator[](std::size_t i) const { return lane[i]; }
};
using Lanes = Pack<float>;
using Mask = Pack<std::int32_t>;

template <class R, class F>
R lane_by_lane(F f) {
  R result;
  for (std::size_t i = 0; i < lane_count; ++i) result.lane[i] = f(i);
  return result;
}
inline Lanes splat(float value) { return lane_by_lane<Lanes>([=](std::size_t) { return value; }); }
#define BELTRAMI_ARITHMETIC(op) \
  inline Lanes operator op(Lanes a, Lanes b) { return lane_by_lane<Lanes>([&](std::size_t i) { return a[i] op b[i]; }); } \
  inline Lanes operator op(Lanes a, float b) { return a op splat(b); } \
  inline Lanes operator op(float a, Lanes b) { return splat(a) op b; }
#define BELTRAMI_COMPARISON(op) \
  inline Mask operator op(Lanes a, Lanes b) { return lane_by_lane<Mask>([&](std::size_t i) { return a[i] op b[i] ? -1 : 0; }); } \
  inline Mask operator op(Lanes a, float b) { return a op splat(b); }
BELTRAMI_ARITHMETIC(+)
BELTRAMI_ARITHMETIC(-)
BELTRAMI_ARITHMETIC(*)
BELTRAMI_ARITHMETIC(/)
BELTRAMI_COMPARISON(<)
BELTRAMI_COMPARISON(>)
BELTRAMI_COMPARISON(<=)
BELTRAMI_COMPARISON(>=)
#undef BELTRAMI_ARITHMETIC
#undef BELTRAMI_COMPARISON
inline Lanes operator-(Lanes a) { return 0.0F - a; }
inline Lanes& operator+=(Lanes& a, Lanes b) { return a = a + b; }
inline Mask operator&(Mask a, Mask b) { return lane_by_lane<Mask>([&](std::size_t i) { return a[i] & b[i]; }); }
inline Mask operator+(Mask a, std::int32_t b) { return lane_by_lane<Mask>([&](std::size_t i) { return a[i] + b; }); }
inline Mask operator<<(Mask a, int b) { return lane_by_lane<Mask>([&](std::size_t i) { return a[i] * (1 << b); }); }
inline Lanes select(Mask mask, Lanes yes, Lanes no) {
  return lane_by_lane<Lanes>([&](std::size_t i) { return mask[i] != 0 ? yes[i] : no[i]; });
}
inline Mask to_integers(Lanes value) {
  return lane_by_lane<Mask>([&](std::size_t i) { return static_cast<std::int32_t>(value[i]); });
}
inline Lanes from_bits(Mask bits) {
  Lanes value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}
#endif

inline Lanes load(const float* from) {
  Lanes value;
  std::memcpy(&value, from, sizeof value);
  return value;
}
inline void store(float* to, Lanes value) { std::memcpy(to, &value, sizeof value); }

// a < b ? a : b and a > b ? a : b, which is what the instructions do.
inline Lanes smaller(Lanes a, Lanes b) {
#if defined(__AVX512F__)
  return reinterpret_cast<Lanes>(_mm512_maskz_min_ps(0xffff, reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b)));
#elif defined(__AVX__)
  return reinterpret_cast<Lanes>(_mm256_min_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
#elif defined(__SSE__)
  return reinterpret_cast<Lanes>(_mm_min_ps(reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b)));
#else
  return select(a < b, a, b);
#endif
}
inline Lanes larger(Lanes a, Lanes b) {
#if defined(__AVX512F__)
  return reinterpret_cast<Lanes>(_mm512_maskz_max_ps(0xffff, reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b)));
#elif defined(__AVX__)
  return reinterpret_cast<Lanes>(_mm256_max_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
#elif defined(__SSE__)
  return reinterpret_cast<Lanes>(_mm_max_ps(reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b)));
#else
  return select(a > b, a, b);
#endif
}

// The least of all lanes.
inline float least_lane(Lanes value) {
#if defined(__SSE__)
#if defined(__AVX512F__)
  const auto all = reinterpret_cast<__m512>(value);
  const __m256 eight = _mm256_min_ps(_mm512_maskz_extractf32x8_ps(0xff, all, 0), _mm512_maskz_extractf32x8_ps(0xff, all, 1));
#elif defined(__AVX__)
  const auto eight = reinterpret_cast<__m256>(value);
#endif
#if defined(__AVX__)
  __m128 four = _mm_min_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps(eight, 1));
#else
  auto four = reinterpret_cast<__m128>(value);
#endif
  four = _mm_min_ps(four, _mm_movehl_ps(four, four));
  return _mm_cvtss_f32(_mm_min_ss(four, _mm_shuffle_ps(four, four, 1)));
#else
  float least = value[0];
  for (std::size_t i = 1; i < lane_count; ++i) least = value[i] < least ? value[i] : least;
  return least;
#endif
}

inline Lanes square_root(Lanes value) {
#if defined(__AVX512F__)
  return reinterpret_cast<Lanes>(_mm512_maskz_sqrt_ps(0xffff, reinterpret_cast<__m512>(value)));
#elif defined(__AVX__)
  return reinterpret_cast<Lanes>(_mm256_sqrt_ps(reinterpret_cast<__m256>(value)));
#elif defined(__SSE__)
  return reinterpret_cast<Lanes>(_mm_sqrt_ps(reinterpret_cast<__m128>(value)));
#else
  float lane[lane_count];
  std::memcpy(lane, &value, sizeof lane);
  for (float& part : lane) part = std::sqrt(part);
  std::memcpy(&value, lane, sizeof lane);
  return value;
#endif
}

// exp(x) for x <= 0, with a relative error below 2e-7.
inline Lanes exponential(Lanes x) {
  const auto [power, factor] = split_exponential(larger(x, splat(-87.0F)));
  return factor * from_bits((to_integers(power) + 127) << 23);
}

}  // namespace beltrami::lanes::BELTRAMI_VARIANT
