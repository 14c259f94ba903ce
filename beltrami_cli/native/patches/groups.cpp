// Compiled once for each instruction set, see instruction_set.hpp.
#include "patches/groups.hpp"

#include <algorithm>
#include <array>

#include "lanes.hpp"

namespace beltrami::patches::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

// Without a pilot, a share of D is added to Y^T Y: patches may be equal, as where noise was clipped.
constexpr float least_share = 0.05F;

// Minimum regularisation, as a share of the trace, for solving the system in float32.
constexpr float least_of_trace = 1e-6F;

// Number of patches whose noise the detail of a group must exceed to count more than `shrinkage`; and the detail of a
// patch in the pilot, relative to the scaled D, below which there is none.
constexpr float trusted_patches = 10, least_detail = 0.02F;

// Upper bound of weights.
constexpr float least_norm = 1e-6F;

// Rows multiplied together, and registers of columns: as many sums as there are registers.
constexpr std::size_t block = 4;  // the side of `transpose_square`
constexpr std::size_t most_packs = lane_count == 16 ? 4 : 2;

template <std::size_t size, std::size_t length>
class Estimate {
 public:
  explicit Estimate(Group& group) : group_(group) {}

  void run(bool has_pilot) {
    if (has_pilot && !match_detail()) return;
    transpose(has_pilot ? group_.pilot.data() : group_.noisy.data());
    multiply();
    float *theta = group_.theta.data(), *energy = group_.energy.data(), trace = 0;
    for (std::size_t k = 0; k < size; ++k) trace += theta[k * size + k];
    const float share = has_pilot ? 1 : least_share;
    for (std::size_t k = 0; k < size; ++k) {
      energy[k] = std::max(energy[k], least_of_trace / share * trace);
      added_[k] = k < group_.found ? share * energy[k] : 1;
      theta[k * size + k] += added_[k];
    }
    invert();
    constrain();
    combine();
  }

 private:
  static constexpr std::size_t packs = size / lane_count, long_packs = length / lane_count;
  static constexpr std::size_t long_tile = long_packs < most_packs ? long_packs : most_packs;
  template <std::size_t count>
  using Block = std::array<std::array<Lanes, count>, block>;

  // sums += a column of `block` factors times a tile of a row.
  template <std::size_t count>
  static void add_product(const float* factors, const float* row, Block<count>& sums) {
    std::array<Lanes, count> values;
    for (std::size_t v = 0; v < count; ++v) values[v] = load(row + v * lane_count);
    for (std::size_t j = 0; j < block; ++j)
      for (std::size_t v = 0; v < count; ++v) sums[j][v] += values[v] * factors[j];
  }

  // Multiplies D by alpha; returns false if there is no detail, and all patches became their mean.
  bool match_detail() {
    const auto found = static_cast<float>(group_.found);
    float* energy = group_.energy.data();
    float noise = 0;
    for (std::size_t k = 0; k < group_.found; ++k) noise += energy[k];
    noise /= found;
    const float of_pilot = spread_of(group_.pilot.data()), of_noisy = spread_of(group_.noisy.data());
    const float detail = std::max(of_noisy - (found - 1) * noise, 0.0F), trusted = trusted_patches * noise;
    const bool is_known = detail + trusted > 0;  // unless patches are equal and without noise
    const float ratio = is_known ? (of_pilot + group_.shrinkage * trusted) / (detail + trusted) : 1;
    const float alpha = group_.strength * std::max(ratio, group_.least_ratio);
    if (!is_known || of_pilot < least_detail * alpha * noise * (found - 1)) {
      shrink_mean(group_.strength * noise / found);
      for (std::size_t k = 0; k < group_.found; ++k)
        std::copy_n(mean_.data(), length, group_.estimates.data() + k * length);
      std::fill_n(group_.weights.data(), group_.found, found);
      return false;
    }
    for (std::size_t k = 0; k < group_.found; ++k) energy[k] *= alpha;
    return true;
  }

  // Shrinks the mean of the noisy patches towards its own mean; `noise` is the energy of its noise.
  void shrink_mean(float noise) {
    const auto count = static_cast<float>(group_.count);
    float level = 0, squares = 0;
    for (std::size_t p = 0; p < group_.count; ++p) level += mean_[group_.used[p]] / count;
    for (std::size_t p = 0; p < group_.count; ++p) {
      const float difference = mean_[group_.used[p]] - level;
      squares += difference * difference;
    }
    noise *= (count - 1) / count;
    const float kept = squares > noise ? 1 - noise / squares : 0;
    for (std::size_t p = 0; p < group_.count; ++p) {
      float& value = mean_[group_.used[p]];
      value = level + kept * (value - level);
    }
  }

  // The sum of the squared differences of patches from their mean, which is kept.
  float spread_of(const float* patches) {
    std::array<Lanes, long_packs> sums{}, squares{};
    for (std::size_t k = 0; k < group_.found; ++k)
      for (std::size_t v = 0; v < long_packs; ++v) {
        const Lanes values = load(patches + k * length + v * lane_count);
        sums[v] += values;
        squares[v] += values * values;
      }
    const float inverse = 1 / static_cast<float>(group_.found);
    alignas(64) std::array<float, length> totals;
    for (std::size_t v = 0; v < long_packs; ++v) {
      store(mean_.data() + v * lane_count, sums[v] * inverse);
      store(totals.data() + v * lane_count, squares[v] - sums[v] * sums[v] * inverse);
    }
    // In the same order for any number of lanes.
    for (std::size_t half = length / 2; half > 0; half /= 2)
      for (std::size_t i = 0; i < half; ++i) totals[i] += totals[i + half];
    return std::max(totals[0], 0.0F);
  }

  // Transposes the patches: one row for each position in a patch.
  void transpose(const float* patches) {
    float* values = group_.values.data();
    const std::size_t places = (group_.used[group_.count - 1] + block) / block * block;
    for (std::size_t k = 0; k < size; k += block)
      for (std::size_t p = 0; p < places; p += block)
        transpose_square(patches + k * length + p, length, values + p * size + k, size);
    if (group_.found == size) return;
    for (std::size_t p = 0; p < places; ++p) std::fill(values + p * size + group_.found, values + (p + 1) * size, 0.0F);
  }

  // theta = A^T A; the part above the diagonal squares is copied below them.
  void multiply() {
    const float* a = group_.values.data();
    float* theta = group_.theta.data();
    for (std::size_t i = 0; i < size; i += block)
      for_packs<0>([&]<std::size_t first>() {
        if (i / lane_count != first) return;
        constexpr std::size_t tile = (packs - first) % 3 == 0 ? 3 : (packs - first) % 2 == 0 ? 2 : 1;
        for (std::size_t c = first; c < packs; c += tile) {
          Block<tile> sums{};
          for (std::size_t p = 0; p < group_.count; ++p) {
            const float* row = a + group_.used[p] * size;
            add_product<tile>(row + i, row + c * lane_count, sums);
          }
          for (std::size_t j = 0; j < block; ++j)
            for (std::size_t v = 0; v < tile; ++v) store(theta + (i + j) * size + (c + v) * lane_count, sums[j][v]);
        }
      });
    for (std::size_t i = 0; i < size; i += block)
      for (std::size_t j = (i / lane_count + 1) * lane_count; j < size; j += block)
        transpose_square(theta + i * size + j, size, theta + j * size + i, size);
  }

  // Calls f with each pack index as a compile-time constant.
  template <std::size_t first, class F>
  static void for_packs(F f) {
    f.template operator()<first>();
    if constexpr (first + 1 < packs) for_packs<first + 1>(f);
  }

  // Inverts theta, positive definite, in place by Gauss-Jordan elimination, `block` pivots at a time.
  void invert() {
    float* theta = group_.theta.data();
    alignas(64) std::array<float, size> others;  // 1 but in the columns of the pivots
    others.fill(1);
    std::array<std::array<float, block>, size> factors;
    for (std::size_t k = 0; k < size; k += block) {
      invert_rows(k);
      for (std::size_t i = 0; i < size; ++i) std::copy_n(theta + i * size + k, block, factors[i].data());
      std::fill_n(others.data() + k, block, 0.0F);
      for (std::size_t v = 0; v < packs; ++v) {
        std::array<Lanes, block> pivots;
        for (std::size_t j = 0; j < block; ++j) pivots[j] = load(theta + (k + j) * size + v * lane_count);
        const bool has_pivots = k / lane_count == v;
        const Lanes keep = load(others.data() + v * lane_count);
        const auto eliminate = [&](std::size_t first, std::size_t last) {
          for (std::size_t i = first; i < last; ++i) {
            float* row = theta + i * size + v * lane_count;
            Lanes value = load(row);
            if (has_pivots) value = value * keep;
            for (std::size_t j = 0; j < block; ++j) value = value - pivots[j] * factors[i][j];
            store(row, value);
          }
        };
        eliminate(0, k);
        eliminate(k + block, size);
      }
      std::fill_n(others.data() + k, block, 1.0F);
    }
  }

  // The same for the rows of the pivots alone: multiplied by the inverse of their own square, which replaces it.
  void invert_rows(std::size_t first) {
    float* rows = group_.theta.data() + first * size;
    for (std::size_t j = 0; j < block; ++j) {
      float* pivot = rows + j * size;
      // A pivot is at least what was added to the diagonal, up to rounding.
      const float inverse = 1 / std::max(pivot[first + j], added_[first + j]);
      std::array<float, block> factors;
      for (std::size_t i = 0; i < block; ++i) {
        factors[i] = rows[i * size + first + j];
        rows[i * size + first + j] = i == j ? 1.0F : 0.0F;
      }
      for (std::size_t v = 0; v < packs; ++v) {
        const Lanes value = load(pivot + v * lane_count) * inverse;
        store(pivot + v * lane_count, value);
        for (std::size_t i = 0; i < block; ++i) {
          float* row = rows + i * size + v * lane_count;
          if (i != j) store(row, load(row) - value * factors[i]);
        }
      }
    }
  }

  // From B to Theta.
  void constrain() {
    float* theta = group_.theta.data();
    std::array<Lanes, packs> sums{}, norms{};
    for (std::size_t i = 0; i < group_.found; ++i)
      for (std::size_t v = 0; v < packs; ++v) sums[v] += load(theta + i * size + v * lane_count);
    alignas(64) std::array<float, size> b;
    for (std::size_t v = 0; v < packs; ++v) store(b.data() + v * lane_count, sums[v]);
    float total = 0;
    for (std::size_t i = 0; i < group_.found; ++i) total += b[i];
    const float inverse = total > 0 ? 1 / total : 0;
    for (std::size_t i = 0; i < group_.found; ++i) {
      float* row = theta + i * size;
      const float share = b[i] * inverse;
      for (std::size_t v = 0; v < packs; ++v) {
        const Lanes energy = load(group_.energy.data() + v * lane_count);
        store(row + v * lane_count, (sums[v] * share - load(row + v * lane_count)) * energy);
      }
      row[i] += 1;
      for (std::size_t v = 0; v < packs; ++v) {
        const Lanes value = load(row + v * lane_count);
        norms[v] += value * value;
      }
    }
    for (std::size_t v = 0; v < packs; ++v)
      store(group_.weights.data() + v * lane_count, 1 / larger(norms[v], splat(least_norm)));
  }

  // Estimates are combinations of the noisy patches.
  void combine() {
    const float *theta = group_.theta.data(), *noisy = group_.noisy.data();
    for (std::size_t k = 0; k < size; k += block)
      for (std::size_t c = 0; c < long_packs; c += long_tile) {
        Block<long_tile> sums{};
        for (std::size_t i = 0; i < group_.found; ++i)
          add_product<long_tile>(theta + i * size + k, noisy + i * length + c * lane_count, sums);
        for (std::size_t j = 0; j < block; ++j)
          for (std::size_t v = 0; v < long_tile; ++v)
            store(group_.estimates.data() + (k + j) * length + (c + v) * lane_count, sums[j][v]);
      }
  }

  Group& group_;
  std::array<float, size> added_;
  alignas(64) std::array<float, length> mean_;
};

}  // namespace

void estimate_group(Group& group, bool has_pilot) {
  if (group.length == long_row)
    group.size == few ? Estimate<few, long_row>(group).run(has_pilot) : Estimate<many, long_row>(group).run(has_pilot);
  else
    group.size == few ? Estimate<few, short_row>(group).run(has_pilot) : Estimate<medium, short_row>(group).run(has_pilot);
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
