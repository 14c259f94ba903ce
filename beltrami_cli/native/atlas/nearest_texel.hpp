// The nearest marked texel of each texel of an image.
//
// A. Meijster, J. Roerdink, W. Hesselink, "A general algorithm for computing distance transforms in linear time"
// (2000): nearest marks along columns first, then the lower envelope of their parabolas along each row.
#pragma once

#include <cstdint>
#include <memory>

namespace beltrami::atlas {

// Returns row * width + column of the mark at the least Euclidean distance, the leftmost of several, then the upper one;
// -1 where there is none within `reach`.
std::unique_ptr<std::int64_t[]> nearest_marked(const bool* marked, std::int64_t height, std::int64_t width,
                                               std::int64_t reach, unsigned threads);

}  // namespace beltrami::atlas
