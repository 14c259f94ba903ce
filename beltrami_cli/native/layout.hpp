// Memory layout of channels: in planes or in rows.
#pragma once

#include <cstddef>

namespace beltrami {

template <class Value>
struct Layout {
  Value* values;
  std::ptrdiff_t channel_step, sample_step;

  Value& at(std::size_t channel, std::size_t sample) const {
    return values[static_cast<std::ptrdiff_t>(channel) * channel_step + static_cast<std::ptrdiff_t>(sample) * sample_step];
  }
};

}  // namespace beltrami
