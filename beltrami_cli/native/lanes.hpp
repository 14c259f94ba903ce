// A pack of floats, as many as a register of the instruction set holds, see instruction_set.hpp. Lanes never mix, so
// their number does not affect results.
//
// All that depends on the compiler or the instruction set is here, each with what other compilers do instead; they do it
// everywhere with BELTRAMI_PLAIN_LANES, to try that.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

// The register width in bits for which intrinsics are used.
#if !defined(__GNUC__) || !defined(__SSE__) || defined(BELTRAMI_PLAIN_LANES)
#define BELTRAMI_REGISTER 0
#elif defined(__AVX512F__)
#define BELTRAMI_REGISTER 512
#elif defined(__AVX__)
#define BELTRAMI_REGISTER 256
#else
#define BELTRAMI_REGISTER 128
#endif
#if BELTRAMI_REGISTER > 0
#include <immintrin.h>
#endif

#include "exp_log.hpp"

namespace beltrami::lanes::BELTRAMI_VARIANT {

constexpr std::size_t lane_count = BELTRAMI_REGISTER == 0 ? 4 : BELTRAMI_REGISTER / 32;

#if defined(__GNUC__) && !defined(BELTRAMI_PLAIN_LANES)
template <class T, std::size_t count>
using Pack [[gnu::vector_size(sizeof(T) * count)]] = T;
using Lanes = Pack<float, lane_count>;
using Mask = Pack<std::int32_t, lane_count>;

inline Lanes splat(float value) { return value - Lanes{}; }
inline Lanes select(Mask mask, Lanes yes, Lanes no) { return mask ? yes : no; }
// Conversion that rounds towards zero, and reinterpretation of bits.
inline Mask to_integers(Lanes value) { return __builtin_convertvector(value, Mask); }
inline Lanes from_bits(Mask bits) { return reinterpret_cast<Lanes>(bits); }
#else
// Other compilers: the same operations lane by lane.
template <class T, std::size_t count>
struct Pack {
  T lane[count];  // not set by itself, so that bytes may be copied over it
  T operator[](std::size_t i) const { return lane[i]; }
  template <class F>
  static Pack of(F f) {
    Pack result;
    for (std::size_t i = 0; i < count; ++i) result.lane[i] = f(i);
    return result;
  }
};
template <std::size_t count>
using Floats = Pack<float, count>;
using Lanes = Floats<lane_count>;
using Mask = Pack<std::int32_t, lane_count>;

inline Lanes splat(float value) { return Lanes::of([=](std::size_t) { return value; }); }
#define BELTRAMI_ARITHMETIC(op)                                           \
  template <std::size_t count>                                            \
  Floats<count> operator op(Floats<count> a, Floats<count> b) {           \
    return Floats<count>::of([&](std::size_t i) { return a[i] op b[i]; }); \
  }                                                                       \
  template <std::size_t count>                                            \
  Floats<count> operator op(Floats<count> a, float b) {                   \
    return Floats<count>::of([&](std::size_t i) { return a[i] op b; });   \
  }                                                                       \
  inline Lanes operator op(float a, Lanes b) { return splat(a) op b; }
#define BELTRAMI_COMPARISON(op) \
  inline Mask operator op(Lanes a, Lanes b) { return Mask::of([&](std::size_t i) { return a[i] op b[i] ? -1 : 0; }); } \
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
inline Mask operator&(Mask a, Mask b) { return Mask::of([&](std::size_t i) { return a[i] & b[i]; }); }
inline Mask operator+(Mask a, std::int32_t b) { return Mask::of([&](std::size_t i) { return a[i] + b; }); }
inline Mask operator<<(Mask a, int b) { return Mask::of([&](std::size_t i) { return a[i] * (1 << b); }); }
inline Lanes select(Mask mask, Lanes yes, Lanes no) {
  return Lanes::of([&](std::size_t i) { return mask[i] != 0 ? yes[i] : no[i]; });
}
inline Mask to_integers(Lanes value) {
  return Mask::of([&](std::size_t i) { return static_cast<std::int32_t>(value[i]); });
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
#if BELTRAMI_REGISTER == 512
  return reinterpret_cast<Lanes>(_mm512_maskz_min_ps(0xffff, reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b)));
#elif BELTRAMI_REGISTER == 256
  return reinterpret_cast<Lanes>(_mm256_min_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
#elif BELTRAMI_REGISTER == 128
  return reinterpret_cast<Lanes>(_mm_min_ps(reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b)));
#else
  return select(a < b, a, b);
#endif
}
inline Lanes larger(Lanes a, Lanes b) {
#if BELTRAMI_REGISTER == 512
  return reinterpret_cast<Lanes>(_mm512_maskz_max_ps(0xffff, reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b)));
#elif BELTRAMI_REGISTER == 256
  return reinterpret_cast<Lanes>(_mm256_max_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b)));
#elif BELTRAMI_REGISTER == 128
  return reinterpret_cast<Lanes>(_mm_max_ps(reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b)));
#else
  return select(a > b, a, b);
#endif
}

// The minimum over all lanes.
inline float least_lane(Lanes value) {
#if BELTRAMI_REGISTER > 0
#if BELTRAMI_REGISTER == 512
  const auto all = reinterpret_cast<__m512>(value);
  const __m256 eight = _mm256_min_ps(_mm512_maskz_extractf32x8_ps(0xff, all, 0), _mm512_maskz_extractf32x8_ps(0xff, all, 1));
#elif BELTRAMI_REGISTER == 256
  const auto eight = reinterpret_cast<__m256>(value);
#endif
#if BELTRAMI_REGISTER > 128
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
#if BELTRAMI_REGISTER == 512
  return reinterpret_cast<Lanes>(_mm512_maskz_sqrt_ps(0xffff, reinterpret_cast<__m512>(value)));
#elif BELTRAMI_REGISTER == 256
  return reinterpret_cast<Lanes>(_mm256_sqrt_ps(reinterpret_cast<__m256>(value)));
#elif BELTRAMI_REGISTER == 128
  return reinterpret_cast<Lanes>(_mm_sqrt_ps(reinterpret_cast<__m128>(value)));
#else
  float lane[lane_count];
  std::memcpy(lane, &value, sizeof lane);
  for (float& part : lane) part = std::sqrt(part);
  std::memcpy(&value, lane, sizeof lane);
  return value;
#endif
}

// One bit per lane: a < b.
inline std::uint32_t where_smaller(Lanes a, Lanes b) {
#if BELTRAMI_REGISTER == 512
  return _mm512_cmp_ps_mask(reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b), _CMP_LT_OQ);
#elif BELTRAMI_REGISTER == 256
  return static_cast<std::uint32_t>(
      _mm256_movemask_ps(_mm256_cmp_ps(reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b), _CMP_LT_OQ)));
#elif BELTRAMI_REGISTER == 128
  return static_cast<std::uint32_t>(_mm_movemask_ps(_mm_cmplt_ps(reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b))));
#else
  const Mask mask = a < b;
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < lane_count; ++i) bits |= mask[i] != 0 ? 1U << i : 0U;
  return bits;
#endif
}

// Gathers the values at `lane_count` offsets.
inline Lanes gather(const float* from, const std::int32_t* at) {
#if BELTRAMI_REGISTER == 512
  return reinterpret_cast<Lanes>(
      _mm512_mask_i32gather_ps(_mm512_setzero_ps(), 0xffff, _mm512_loadu_si512(at), from, sizeof(float)));
#elif BELTRAMI_REGISTER == 256 && defined(__AVX2__)
  const __m256i places = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(at));
  return reinterpret_cast<Lanes>(_mm256_i32gather_ps(from, places, sizeof(float)));
#else
  float values[lane_count];
  for (std::size_t i = 0; i < lane_count; ++i) values[i] = from[at[i]];
  return load(values);
#endif
}

// Transposes a square of 4 x 4 values.
inline void transpose_square(const float* from, std::size_t from_step, float* to, std::size_t to_step) {
#if BELTRAMI_REGISTER > 0
  __m128 a = _mm_loadu_ps(from), b = _mm_loadu_ps(from + from_step), c = _mm_loadu_ps(from + 2 * from_step),
         d = _mm_loadu_ps(from + 3 * from_step);
  _MM_TRANSPOSE4_PS(a, b, c, d);
  _mm_storeu_ps(to, a);
  _mm_storeu_ps(to + to_step, b);
  _mm_storeu_ps(to + 2 * to_step, c);
  _mm_storeu_ps(to + 3 * to_step, d);
#else
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t j = 0; j < 4; ++j) to[j * to_step + i] = from[i * from_step + j];
#endif
}

// Prefetches memory.
inline void prefetch([[maybe_unused]] const void* address) {
#if defined(__GNUC__)
  __builtin_prefetch(address);
#endif
}

// exp(x) for x <= 0, with a relative error below 2e-7.
inline Lanes exponential(Lanes x) {
  const auto [power, factor] = split_exponential(larger(x, splat(-87.0F)));
  return factor * from_bits((to_integers(power) + 127) << 23);
}

}  // namespace beltrami::lanes::BELTRAMI_VARIANT
