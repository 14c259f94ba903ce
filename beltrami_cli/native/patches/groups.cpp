// Compiled once for each instruction set, see instruction_set.hpp.
#include "patches/groups.hpp"

#include <algorithm>
#include <array>

#include "lanes.hpp"

namespace beltrami::patches::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

// Without a pilot, a share of D is added to Y^T Y: patches may be equal, as where noise was cut off.
constexpr float least_share = 0.05F;

// A bound on weights.
constexpr float least_norm = 1e-6F;

// Rows that are multiplied together, and registers of columns: as many sums as registers hold.
constexpr std::size_t block = 4;
constexpr std::size_t most_packs = lane_count == 16 ? 4 : 2;

// One channel of a group: rows of `size` columns, padded with rows of zeros to whole blocks.
template <std::size_t size>
class Group {
 public:
  static constexpr std::size_t packs = size / lane_count, tile = packs < most_packs ? packs : most_packs;
  using Row = std::array<Lanes, packs>;
  using Block = std::array<std::array<Lanes, tile>, block>;

  Group(float* pilot, float* noisy, float* theta, const float* energy, std::size_t rows, std::size_t found)
      : pilot_(pilot), noisy_(noisy), theta_(theta), energy_(energy), rows_(rows), found_(found) {}

  static std::size_t padded(std::size_t rows) { return (rows + block - 1) / block * block; }

  // Reads the patches as differences from the mean of the first patch, so that sums lose few digits.
  void read(const float* noisy, const float* pilot, const std::int32_t* places) {
    float sum = 0;
    for (std::size_t p = 0; p < rows_; ++p) sum += pilot[places[p * size]];
    mean_ = sum / static_cast<float>(rows_);
    std::fill(pilot_, pilot_ + padded(rows_) * size, 0.0F);
    std::fill(noisy_, noisy_ + padded(rows_) * size, 0.0F);
    for (std::size_t p = 0; p < rows_; ++p) {
      const std::int32_t* place = places + p * size;
      float *of_pilot = pilot_ + p * size, *of_noisy = noisy_ + p * size;
      for (std::size_t k = 0; k < found_; ++k) of_pilot[k] = pilot[place[k]] - mean_;
      for (std::size_t k = 0; k < found_; ++k) of_noisy[k] = noisy[place[k]] - mean_;
    }
  }

  // Makes Theta; returns the weights of the estimates, 1 / |Theta_k|^2.
  Row combine(bool has_pilot) {
    multiply(has_pilot ? pilot_ : noisy_);
    for (std::size_t k = 0; k < size; ++k) {
      const float added = has_pilot ? energy_[k] : least_share * energy_[k];
      theta_[k * size + k] += k < found_ ? added : 1;
    }
    invert();
    return constrain();
  }

  // Adds the estimates at their places.
  void add(const std::int32_t* places, const Row& weights, float* estimates, float* counts) const {
    alignas(64) std::array<float, size> weight;
    alignas(64) std::array<float, block * size> values;
    for (std::size_t v = 0; v < packs; ++v) store(weight.data() + v * lane_count, weights[v]);
    for (std::size_t p = 0; p < rows_; p += block) {
      for (std::size_t c = 0; c < packs; c += tile) {
        Block sums{};
        for (std::size_t i = 0; i < found_; ++i) add_product(noisy_ + p * size + i, size, theta_ + i * size, c, sums);
        for (std::size_t j = 0; j < block; ++j)
          for (std::size_t v = 0; v < tile; ++v)
            store(values.data() + j * size + (c + v) * lane_count, (sums[j][v] + mean_) * weights[c + v]);
      }
      for (std::size_t j = 0; j < std::min(block, rows_ - p); ++j) {
        const std::int32_t* place = places + (p + j) * size;
        const float* value = values.data() + j * size;
        for (std::size_t k = 0; k < found_; ++k) {
          estimates[place[k]] += value[k];
          counts[place[k]] += weight[k];
        }
      }
    }
  }

 private:
  // sums += a column of `block` factors, `step` apart, times a tile of a row.
  static void add_product(const float* factors, std::size_t step, const float* row, std::size_t first, Block& sums) {
    std::array<Lanes, tile> values;
    for (std::size_t v = 0; v < tile; ++v) values[v] = load(row + (first + v) * lane_count);
    for (std::size_t j = 0; j < block; ++j)
      for (std::size_t v = 0; v < tile; ++v) sums[j][v] += values[v] * factors[j * step];
  }

  // theta = A^T A, its upper triangle.
  void multiply(const float* a) {
    for (std::size_t i = 0; i < size; i += block)
      for (std::size_t c = i / (tile * lane_count) * tile; c < packs; c += tile) {
        Block sums{};
        for (std::size_t p = 0; p < rows_; ++p) add_product(a + p * size + i, 1, a + p * size, c, sums);
        for (std::size_t j = 0; j < block; ++j)
          for (std::size_t v = 0; v < tile; ++v) store(theta_ + (i + j) * size + (c + v) * lane_count, sums[j][v]);
      }
  }

  // Inverts theta, symmetric and positive definite, by sweeps of its upper triangle, which make minus the inverse.
  void invert() {
    alignas(64) std::array<float, size> column;
    for (std::size_t k = 0; k < size; ++k) {
      float* pivot = theta_ + k * size;
      for (std::size_t i = 0; i < k; ++i) column[i] = theta_[i * size + k];
      std::copy(pivot + k, pivot + size, column.data() + k);
      const float inverse = 1 / column[k];
      Row values;
      for (std::size_t v = 0; v < packs; ++v) values[v] = load(column.data() + v * lane_count);
      for_packs<0>([&]<std::size_t first>() {
        for (std::size_t i = first * lane_count; i < (first + 1) * lane_count; ++i) {
          float* row = theta_ + i * size;
          const Lanes factor = splat(column[i] * inverse);
          for (std::size_t v = first; v < packs; ++v)
            store(row + v * lane_count, load(row + v * lane_count) - values[v] * factor);
        }
      });
      for (std::size_t i = 0; i < k; ++i) theta_[i * size + k] = column[i] * inverse;
      for (std::size_t j = k; j < size; ++j) pivot[j] = column[j] * inverse;
      pivot[k] = -inverse;
    }
    for (std::size_t i = 0; i < size; ++i)
      for (std::size_t j = i; j < size; ++j) theta_[i * size + j] = theta_[j * size + i] = -theta_[i * size + j];
  }

  // Calls f with each pack as a constant, so that loops over the packs from it on are unrolled.
  template <std::size_t first, class F>
  static void for_packs(F f) {
    f.template operator()<first>();
    if constexpr (first + 1 < packs) for_packs<first + 1>(f);
  }

  // From B to Theta.
  Row constrain() {
    Row sums{}, norms{};
    for (std::size_t i = 0; i < found_; ++i)
      for (std::size_t v = 0; v < packs; ++v) sums[v] += load(theta_ + i * size + v * lane_count);
    alignas(64) std::array<float, size> b;
    for (std::size_t v = 0; v < packs; ++v) store(b.data() + v * lane_count, sums[v]);
    float total = 0;
    for (std::size_t i = 0; i < found_; ++i) total += b[i];
    const float inverse = total > 0 ? 1 / total : 0;
    for (std::size_t i = 0; i < found_; ++i) {
      float* row = theta_ + i * size;
      const float share = b[i] * inverse;
      for (std::size_t v = 0; v < packs; ++v) {
        const Lanes energy = load(energy_ + v * lane_count);
        store(row + v * lane_count, (sums[v] * share - load(row + v * lane_count)) * energy);
      }
      row[i] += 1;
      for (std::size_t v = 0; v < packs; ++v) {
        const Lanes value = load(row + v * lane_count);
        norms[v] += value * value;
      }
    }
    for (Lanes& norm : norms) norm = 1 / larger(norm, splat(least_norm));
    return norms;
  }

  float *pilot_, *noisy_, *theta_;
  const float* energy_;
  std::size_t rows_, found_;
  float mean_ = 0;
};

template <std::size_t size>
void add_group_of(const Channels& channels, const std::int32_t* places, std::size_t rows, std::size_t found,
                  bool has_pilot, const Sums& sums, GroupScratch& scratch) {
  float *relative = scratch.relative.data(), *energy = scratch.energy.data();
  std::fill(relative, relative + size, channels.relative == nullptr ? static_cast<float>(rows) : 0);
  if (channels.relative != nullptr)
    for (std::size_t p = 0; p < rows; ++p)
      for (std::size_t k = 0; k < found; ++k) relative[k] += channels.relative[places[p * size + k]];
  for (std::size_t channel = 0; channel < channels.count; ++channel) {
    for (std::size_t k = 0; k < size; ++k) energy[k] = relative[k] * channels.variances[channel];
    const std::size_t plane = channel * channels.stride;
    Group<size> group(scratch.pilot.data(), scratch.noisy.data(), scratch.theta.data(), energy, rows, found);
    group.read(channels.noisy + plane, channels.pilot + plane, places);
    const auto weights = group.combine(has_pilot);
    group.add(places, weights, sums.estimates + plane, sums.weights + plane);
  }
}

}  // namespace

void compare_rows(const float* features, std::size_t length, const float* mask, const std::int32_t* rows, std::size_t count,
                  float* distances) {
  constexpr std::size_t width = 16, packs = width / lane_count;
  const float* own = features + static_cast<std::size_t>(rows[0]) * length;
  for (std::size_t k = 0; k < count; ++k) {
    const float* other = features + static_cast<std::size_t>(rows[k]) * length;
    std::array<Lanes, packs> sums{};
    for (std::size_t i = 0; i < length; i += width)
      for (std::size_t v = 0; v < packs; ++v) {
        const std::size_t at = i + v * lane_count;
        const Lanes difference = (load(other + at) - load(own + at)) * load(mask + at);
        sums[v] += difference * difference;
      }
    // As many partial sums for any number of lanes.
    alignas(64) std::array<float, width> partial;
    for (std::size_t v = 0; v < packs; ++v) store(partial.data() + v * lane_count, sums[v]);
    for (std::size_t half = width / 2; half > 0; half /= 2)
      for (std::size_t i = 0; i < half; ++i) partial[i] += partial[i + half];
    distances[k] = partial[0];
  }
}

void add_group(const Channels& channels, const std::int32_t* places, std::size_t rows, std::size_t size, std::size_t found,
               bool has_pilot, const Sums& sums, GroupScratch& scratch) {
  if (size == few)
    add_group_of<few>(channels, places, rows, found, has_pilot, sums, scratch);
  else if (size == medium)
    add_group_of<medium>(channels, places, rows, found, has_pilot, sums, scratch);
  else
    add_group_of<many>(channels, places, rows, found, has_pilot, sums, scratch);
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
