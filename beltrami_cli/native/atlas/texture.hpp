// The grid of a texture. Texel (x, y) has its centre at the integer point (x, y) of the texture's plane, x to the
// right and y down; beyond the image the plane goes on as the wrap modes say.
#pragma once

#include <cstdint>
#include <vector>

namespace beltrami::atlas {

enum class Wrap : std::uint8_t { repeat, mirror, clamp };

struct Texture {
  std::int32_t width = 0, height = 0;
  Wrap wrap_x = Wrap::repeat, wrap_y = Wrap::repeat;
  std::int64_t offset = 0;  // number of its first texel among the texels of all textures

  std::int64_t texel(std::int32_t x, std::int32_t y) const {
    return offset + static_cast<std::int64_t>(y) * width + x;
  }
};

inline std::int64_t floor_mod(std::int64_t i, std::int64_t n) {
  if (i >= 0 && i < n) return i;
  const std::int64_t remainder = i % n;
  return remainder < 0 ? remainder + n : remainder;
}

// The texel column or row that is seen at place i of the plane.
inline std::int32_t wrapped(std::int64_t i, std::int32_t size, Wrap wrap) {
  if (i >= 0 && i < size) return static_cast<std::int32_t>(i);
  if (wrap == Wrap::clamp) return i < 0 ? 0 : size - 1;
  if (wrap == Wrap::repeat) return static_cast<std::int32_t>(floor_mod(i, size));
  const std::int64_t twofold = floor_mod(i, 2 * static_cast<std::int64_t>(size));
  return static_cast<std::int32_t>(twofold < size ? twofold : 2 * static_cast<std::int64_t>(size) - 1 - twofold);
}

// The place of texel j within [start, start + size), in which each texel has one place (for mirror and clamp the start
// is a multiple of the size).
inline std::int64_t unwrapped(std::int32_t j, std::int64_t start, std::int32_t size, Wrap wrap) {
  if (wrap == Wrap::clamp) return j;
  if (wrap == Wrap::repeat) return start + floor_mod(j - start, size);
  const bool odd = floor_mod(start, 2 * static_cast<std::int64_t>(size)) != 0;
  return odd ? start + size - 1 - j : start + j;
}

}  // namespace beltrami::atlas
