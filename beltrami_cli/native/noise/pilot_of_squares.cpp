// Compiled once for each instruction set, see instruction_set.hpp.
#include <vector>

#include "lanes.hpp"
#include "noise/pilot.hpp"

namespace beltrami::noise::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

// A square within a border of empty cells, so that all cells have eight neighbours and rows are whole packs of lanes.
class PaddedSquare {
 public:
  explicit PaddedSquare(std::size_t side)
      : side_(side), stride_((side + lane_count - 1) / lane_count * lane_count + 2), size_((side + 2) * stride_),
        before_(channels * size_), after_(channels * size_), limits_(size_), filled_(size_) {}

  void read(const PilotSquares& squares, std::size_t square, const float* colours) {
    for_all_cells(square, [&](std::size_t cell, std::size_t place) {
      limits_[place] = squares.variances.limit(cell);
      filled_[place] = squares.filled == nullptr || squares.filled[cell] ? 1.0F : 0.0F;
      for (std::size_t k = 0; k < channels; ++k) before_[k * size_ + place] = colours[k * squares.cells() + cell];
    });
  }

  void pass(float scale) {
    for (std::size_t row = 0; row < side_; ++row)
      for (std::size_t column = 0; column < side_; column += lane_count) smooth(place_of(row, column), scale);
    before_.swap(after_);
  }

  void write(const PilotSquares& squares, std::size_t square, float* pilot) const {
    for_all_cells(square, [&](std::size_t cell, std::size_t place) {
      for (std::size_t k = 0; k < channels; ++k) pilot[k * squares.cells() + cell] = before_[k * size_ + place];
    });
  }

 private:
  std::size_t place_of(std::size_t row, std::size_t column) const { return (row + 1) * stride_ + column + 1; }

  template <class Body>
  void for_all_cells(std::size_t square, const Body& body) const {
    for (std::size_t row = 0; row < side_; ++row)
      for (std::size_t column = 0; column < side_; ++column)
        body((square * side_ + row) * side_ + column, place_of(row, column));
  }

  void smooth(std::size_t place, float scale) {
    std::array<Lanes, channels> own, sums{};
    for (std::size_t k = 0; k < channels; ++k) own[k] = load(&before_[k * size_ + place]);
    const Lanes own_limit = load(&limits_[place]), least = splat(least_limit), zero = splat(0);
    Lanes weights = splat(1);
    for (const std::size_t there : {place - stride_ - 1, place - stride_, place - stride_ + 1, place - 1, place + 1,
                                    place + stride_ - 1, place + stride_, place + stride_ + 1}) {
      std::array<Lanes, channels> difference;
      Lanes squared = zero;
      for (std::size_t k = 0; k < channels; ++k) {
        difference[k] = load(&before_[k * size_ + there]) - own[k];
        squared = squared + difference[k] * difference[k];
      }
      const Lanes limit = larger((own_limit + load(&limits_[there])) * scale, least);
      const Lanes nearness = larger(limit - squared, zero) / limit;
      const Lanes weight = nearness * nearness * load(&filled_[there]);
      weights = weights + weight;
      for (std::size_t k = 0; k < channels; ++k) sums[k] = sums[k] + difference[k] * weight;
    }
    for (std::size_t k = 0; k < channels; ++k) store(&after_[k * size_ + place], own[k] + sums[k] / weights);
  }

  std::size_t side_, stride_, size_;
  std::vector<float> before_, after_, limits_, filled_;
};

}  // namespace

void smooth_padded_squares(const PilotSquares& squares, const float* colours, float* pilot) {
  PaddedSquare padded(squares.side);
  for (std::size_t square = 0; square < squares.count; ++square) {
    padded.read(squares, square, colours);
    float scale = 0.5F;  // of the mean of two limits
    for (int number = 0; number < passes; ++number, scale *= left_by_pass) padded.pass(scale);
    padded.write(squares, square, pilot);
  }
}

}  // namespace beltrami::noise::BELTRAMI_VARIANT
