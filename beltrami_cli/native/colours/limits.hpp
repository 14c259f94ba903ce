// What stands at the limits of colours, 0 and full scale.
#pragma once

#include <cstddef>
#include <vector>

namespace beltrami::colours {

// Of one channel; least and most are infinite, the wrong way round, without values.
struct Limits {
  float least, most;
  std::size_t at_0, at_1;
};

// Looks at `count` rows of `channels` values each.
std::vector<Limits> find_limits(const float* values, std::size_t count, std::size_t channels);

}  // namespace beltrami::colours
