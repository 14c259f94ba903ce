// The vertices around one, ring by ring along edges.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace beltrami::patches {

class VertexRings {
 public:
  // Finds the vertices around one, itself first: whole rings, until there are `enough`.
  std::span<const std::int32_t> around(std::int32_t vertex, std::size_t enough, std::span<const std::size_t> first,
                                       std::span<const std::int32_t> neighbours) {
    seen_.resize(first.size() - 1, 0);
    ++visit_;
    found_.assign(1, vertex);
    seen_[static_cast<std::size_t>(vertex)] = visit_;
    for (std::size_t ring = 0; ring < found_.size() && found_.size() < enough;) {
      const std::size_t end = found_.size();
      for (; ring < end; ++ring) {
        const auto own = static_cast<std::size_t>(found_[ring]);
        for (std::size_t i = first[own]; i < first[own + 1] && found_.size() < most; ++i) {
          std::uint32_t& seen = seen_[static_cast<std::size_t>(neighbours[i])];
          if (seen != visit_) found_.push_back(neighbours[i]);
          seen = visit_;
        }
      }
    }
    return found_;
  }

 private:
  static constexpr std::size_t most = 512;  // beside a hub

  std::vector<std::uint32_t> seen_;
  std::vector<std::int32_t> found_;
  std::uint32_t visit_ = 0;
};

}  // namespace beltrami::patches
