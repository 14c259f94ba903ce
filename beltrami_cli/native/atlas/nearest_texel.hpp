// The nearest marked texel of some texels of an image.
//
// A. Meijster, J. Roerdink, W. Hesselink, "A general algorithm for computing distance transforms in linear time"
// (2000): nearest marks along columns first, then the lower envelope of their parabolas along each row.
#pragma once

#include <cstdint>
#include <vector>

namespace beltrami::atlas {

// Texels as row * width + column.
struct NearestMarks {
  std::vector<std::int64_t> texels, marks;
};

// Returns the wanted texels, ascending, that have a mark within `reach`, and the nearest mark of each by Euclidean
// distance; of several, the leftmost, then the upper one.
NearestMarks nearest_marked(const bool* marked, const bool* wanted, std::int64_t height, std::int64_t width,
                            std::int64_t reach, unsigned threads);

}  // namespace beltrami::atlas
