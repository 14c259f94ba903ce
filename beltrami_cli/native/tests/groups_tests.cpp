// Tests of groups of patches, which Python cannot reach: against a solution of their equations in double precision.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "patches/groups.hpp"

// Ends a test that is not true, and prints where.
static void check(bool holds, const char* what, const char* file, int line) {
  if (holds) return;
  std::fprintf(stderr, "%s:%d: not true: %s\n", file, line, what);
  std::exit(1);
}
#define CHECK(condition) check((condition), #condition, __FILE__, __LINE__)

using namespace beltrami::patches;

namespace {

using Random = std::mt19937;
using Square = std::vector<std::vector<double>>;

constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();

float normal(Random& random) { return std::normal_distribution<float>()(random); }

// Gauss and Jordan, with the largest pivot of each column.
Square inverse_of(Square a) {
  const std::size_t n = a.size();
  Square b(n, std::vector<double>(n, 0));
  for (std::size_t i = 0; i < n; ++i) b[i][i] = 1;
  for (std::size_t k = 0; k < n; ++k) {
    std::size_t best = k;
    for (std::size_t i = k; i < n; ++i)
      if (std::abs(a[i][k]) > std::abs(a[best][k])) best = i;
    std::swap(a[k], a[best]);
    std::swap(b[k], b[best]);
    const double pivot = a[k][k];
    for (std::size_t j = 0; j < n; ++j) {
      a[k][j] /= pivot;
      b[k][j] /= pivot;
    }
    for (std::size_t i = 0; i < n; ++i) {
      const double factor = a[i][k];
      for (std::size_t j = 0; i != k && j < n; ++j) {
        a[i][j] -= factor * a[k][j];
        b[i][j] -= factor * b[k][j];
      }
    }
  }
  return b;
}

// One channel of a group whose patches hold `count` values, at places of their own in the rows.
Group some_group(std::size_t size, std::size_t length, std::size_t found, std::size_t count, Random& random) {
  Group group{};
  group.size = size;
  group.length = length;
  group.found = found;
  group.count = count;
  std::vector<std::uint8_t> places(length);
  for (std::size_t i = 0; i < length; ++i) places[i] = static_cast<std::uint8_t>(i);
  std::shuffle(places.begin(), places.end(), random);
  std::sort(places.begin(), places.begin() + static_cast<std::ptrdiff_t>(count));
  std::copy_n(places.begin(), count, group.used.begin());
  const float variance = random() % 2 == 0 ? 0.01F : 0.0004F;
  // Some groups hold more detail than their pilot, some less, and some next to none.
  const float detail = random() % 4 == 0 ? 1e-3F : 0.3F, kept = random() % 2 == 0 ? 0.8F : 1.2F;
  group.shrinkage = random() % 2 == 0 ? 1.0F : 6.0F;
  group.least_ratio = random() % 2 == 0 ? 0.0F : 1.0F;
  group.strength = random() % 2 == 0 ? 1.0F : 0.7F;
  for (std::size_t k = 0; k < size; ++k) {
    // Memory beyond the patches holds anything.
    if (k >= found)
      for (auto* rows : {&group.noisy, &group.pilot}) std::fill_n(rows->begin() + static_cast<std::ptrdiff_t>(k * length), length, nowhere);
    const float energy = variance * (0.2F + static_cast<float>(random() % 100) / 50.0F);
    group.energy[k] = energy * static_cast<float>(count);
    for (std::size_t p = 0; p < count; ++p) {
      const std::size_t at = k * length + group.used[p];
      const float colour = detail * std::sin(static_cast<float>(k + p) / 5);
      if (k >= found) continue;
      group.pilot[at] = kept * colour + 0.07F * detail * normal(random);
      group.noisy[at] = colour + std::sqrt(energy) * normal(random);
    }
  }
  return group;
}

// The sum of the squared differences of patches from their mean.
double spread_of(const Group& own, const float* patches) {
  double total = 0;
  for (std::size_t p = 0; p < own.count; ++p) {
    double sum = 0, squares = 0;
    for (std::size_t k = 0; k < own.found; ++k) {
      const double value{patches[k * own.length + own.used[p]]};
      sum += value;
      squares += value * value;
    }
    total += squares - sum * sum / static_cast<double>(own.found);
  }
  return total;
}

// What D is multiplied by with a pilot; 0 where all patches become their mean.
double factor_of(const Group& own) {
  double noise = 0;
  for (std::size_t k = 0; k < own.found; ++k) noise += double{own.energy[k]} / static_cast<double>(own.found);
  const double of_pilot = spread_of(own, own.pilot.data()), others = static_cast<double>(own.found) - 1;
  const double detail = std::max(spread_of(own, own.noisy.data()) - others * noise, 0.0);
  const double ratio = (of_pilot + 10 * double{own.shrinkage} * noise) / (detail + 10 * noise);
  const double factor = double{own.strength} * std::max(ratio, double{own.least_ratio});
  return of_pilot < 0.02 * factor * noise * others ? 0 : factor;
}

// Theta as groups.hpp has it.
Square combinations(Group own, bool has_pilot) {
  constexpr double least_share = 0.05;
  if (has_pilot) {
    const double factor = factor_of(own);
    if (factor == 0) return Square(own.found, std::vector<double>(own.found, 1 / static_cast<double>(own.found)));
    for (float& energy : own.energy) energy = static_cast<float>(factor * double{energy});
  }
  const float* values = (has_pilot ? own.pilot : own.noisy).data();
  Square matrix(own.found, std::vector<double>(own.found, 0));
  std::vector<double> b(own.found, 0);
  for (std::size_t i = 0; i < own.found; ++i)
    for (std::size_t j = 0; j < own.found; ++j)
      for (std::size_t p = 0; p < own.count; ++p)
        matrix[i][j] += double{values[i * own.length + own.used[p]]} * double{values[j * own.length + own.used[p]]};
  for (std::size_t k = 0; k < own.found; ++k) matrix[k][k] += (has_pilot ? 1 : least_share) * double{own.energy[k]};
  Square theta = inverse_of(matrix);
  double total = 0;
  for (std::size_t i = 0; i < own.found; ++i)
    for (std::size_t j = 0; j < own.found; ++j) b[i] += theta[i][j];
  for (const double value : b) total += value;
  for (std::size_t i = 0; i < own.found; ++i)
    for (std::size_t j = 0; j < own.found; ++j)
      theta[i][j] = (i == j ? 1 : 0) - (theta[i][j] - b[i] * b[j] / total) * double{own.energy[j]};
  return theta;
}

// The mean of all noisy patches, as groups.hpp draws it to its own mean.
std::vector<double> shrunk_mean(const Group& own) {
  const auto found = static_cast<double>(own.found), count = static_cast<double>(own.count);
  std::vector<double> mean(own.count, 0);
  double level = 0, squares = 0, noise = 0;
  for (std::size_t p = 0; p < own.count; ++p) {
    for (std::size_t k = 0; k < own.found; ++k) mean[p] += double{own.noisy[k * own.length + own.used[p]]} / found;
    level += mean[p] / count;
  }
  for (const double value : mean) squares += (value - level) * (value - level);
  for (std::size_t k = 0; k < own.found; ++k) noise += double{own.energy[k]} / found;
  noise *= double{own.strength} / found * (count - 1) / count;
  for (double& value : mean) value = level + (squares > noise ? 1 - noise / squares : 0) * (value - level);
  return mean;
}

// Returns whether all patches became their mean.
bool check_against_the_equations(const Group& given, bool has_pilot) {
  const Square theta = combinations(given, has_pilot);
  const bool is_plain = has_pilot && factor_of(given) == 0;
  const std::vector<double> mean = shrunk_mean(given);
  Group own = given;
  baseline::estimate_group(own, has_pilot);
  // A hundredth or, as systems without a pilot are ill-conditioned, a tenth of a step of 8-bit files.
  const double tolerance = has_pilot ? 4e-5 : 4e-4;
  for (std::size_t k = 0; k < own.found; ++k) {
    double norm = 0;
    for (std::size_t i = 0; i < own.found; ++i) norm += theta[i][k] * theta[i][k];
    CHECK(std::abs(double{own.weights[k]} * norm - 1) <= (has_pilot ? 5e-3 : 1e-2));
    for (std::size_t p = 0; p < own.count; ++p) {
      double value = is_plain ? mean[p] : 0;
      for (std::size_t i = 0; i < own.found && !is_plain; ++i) value += theta[i][k] * double{given.noisy[i * own.length + own.used[p]]};
      CHECK(std::abs(double{own.estimates[k * own.length + own.used[p]]} - value) < tolerance);
    }
  }
  return is_plain;
}

// The sizes and lengths that are made.
constexpr std::array<std::array<std::size_t, 2>, 4> shapes{{{few, long_row}, {many, long_row}, {few, short_row}, {medium, short_row}}};

void groups_agree_with_the_equations_in_double_precision() {
  Random random(21);
  std::size_t plain = 0, all = 0;
  for (const auto& [size, length] : shapes)
    for (const std::size_t count : {std::size_t{1}, std::size_t{7}, std::size_t{25}, length - 15})
      for (const std::size_t missing : {std::size_t{0}, std::size_t{3}, size / 2 + 1, size - 1})
        for (int mode = 0; mode < 8; ++mode, ++all)
          plain += check_against_the_equations(some_group(size, length, size - missing, count, random), mode % 2 == 0);
  CHECK(plain > all / 20 && plain < all / 2);
}

// Estimates of groups of noise alone come closer to its mean than the pilot is, and detail that the pilot lost comes back,
// whatever the strength is.
void noise_is_averaged_and_lost_detail_comes_back() {
  Random random(28);
  constexpr float sigma = 0.05F;
  for (const auto& [has_detail, strength] : {std::pair(false, 0.7F), {false, 1.5F}, {true, 0.7F}, {true, 1.5F}}) {
    double errors = 0, of_pilot = 0;
    for (int trial = 0; trial < 20; ++trial) {
      Group own{};
      own.size = own.found = many;
      own.length = long_row;
      own.count = 49;
      own.shrinkage = 2;
      own.strength = strength;
      own.energy.fill(49 * sigma * sigma);
      for (std::size_t p = 0; p < 49; ++p) own.used[p] = static_cast<std::uint8_t>(p);
      std::vector<float> colours;
      for (std::size_t k = 0; k < many; ++k)
        for (std::size_t p = 0; p < 49; ++p) {
          // Four patterns; each patch has some of each.
          const float colour = has_detail ? 3 * sigma * std::sin(static_cast<float>((k % 4 + 1) * p)) : 0;
          own.noisy[k * long_row + p] = colour + sigma * normal(random);
          own.pilot[k * long_row + p] = colour / 2 + 0.2F * sigma * normal(random);
          colours.push_back(colour);
        }
      const Group given = own;
      baseline::estimate_group(own, true);
      for (std::size_t k = 0; k < many; ++k)
        for (std::size_t p = 0; p < 49; ++p) {
          const std::size_t at = k * long_row + p;
          const double colour{colours[k * 49 + p]};
          errors += std::pow(double{own.estimates[at]} - colour, 2);
          of_pilot += std::pow(double{given.pilot[at]} - colour, 2);
        }
    }
    CHECK(errors < (has_detail ? 0.1 : 0.6) * of_pilot);
  }
}

void a_constant_stays_whatever_the_pilot_is() {
  Random random(22);
  for (const bool has_pilot : {false, true}) {
    Group own = some_group(many, long_row, many - 5, 49, random);
    for (std::size_t k = 0; k < own.found; ++k)
      for (std::size_t p = 0; p < own.count; ++p) own.noisy[k * own.length + own.used[p]] = 0.7F;
    baseline::estimate_group(own, has_pilot);
    for (std::size_t k = 0; k < own.found; ++k)
      for (std::size_t p = 0; p < own.count; ++p)
        CHECK(std::abs(own.estimates[k * own.length + own.used[p]] - 0.7F) < 1e-5F);
  }
}

// Rounding must not turn pivots of systems that are all but singular negative.
void equal_patches_with_next_to_no_noise_stay() {
  Random random(27);
  for (const auto& [size, length] : shapes)
    for (const float energy : {1e-4F, 1e-7F, 1e-10F})
      for (const bool has_pilot : {false, true}) {
        Group own = some_group(size, length, size, 25, random);
        own.energy.fill(energy);
        own.shrinkage = own.strength = 1;
        for (std::size_t k = 0; k < size; ++k)
          for (std::size_t p = 0; p < own.count; ++p) {
            const std::size_t at = k * length + own.used[p], in_first = own.used[p];
            if (k > 0) own.noisy[at] = own.noisy[in_first] * (k % 3 == 0 ? 0.999F : 1.0F);
            own.pilot[at] = own.noisy[at];
          }
        const Group given = own;
        baseline::estimate_group(own, has_pilot);
        for (std::size_t k = 0; k < size; ++k)
          for (std::size_t p = 0; p < own.count; ++p) {
            const std::size_t at = k * length + own.used[p];
            CHECK(std::abs(own.estimates[at] - given.noisy[at]) < 2e-2F);
          }
      }
}

// As of a slope in 8 bit that was drawn without noise, whose patches are all but linearly dependent.
void steps_of_a_slope_without_noise_stay() {
  Random random(31);
  for (const auto& [size, length] : shapes)
    for (std::size_t width = 2; width < 7; ++width)
      for (std::size_t count = 12; count <= 28; count += 4)
        for (const float energy : {2e-6F, 2.6e-7F, 3e-8F}) {
          Group own = some_group(size, length, size, count, random);
          own.energy.fill(energy);
          for (std::size_t k = 0; k < size; ++k)
            for (std::size_t p = 0; p < count; ++p) {
              const std::size_t step = (k + 1) / 2 + p / width;  // one of them is left out
              own.noisy[k * length + own.used[p]] = (static_cast<float>(step + step / 12) - 9.97281F) / 255;
            }
          const Group given = own;
          baseline::estimate_group(own, false);
          for (std::size_t k = 0; k < size; ++k)
            for (std::size_t p = 0; p < count; ++p) {
              const std::size_t at = k * length + own.used[p];
              CHECK(std::abs(own.estimates[at] - given.noisy[at]) < 1e-2F);
            }
        }
}

// Nothing may be divided by nothing.
void plain_patches_without_noise_stay() {
  Random random(29);
  for (const auto& [size, length] : shapes) {
    Group own = some_group(size, length, size, 25, random);
    own.energy.fill(0);
    own.noisy.fill(0);
    own.pilot.fill(0);
    baseline::estimate_group(own, true);
    for (std::size_t k = 0; k < size; ++k)
      for (std::size_t p = 0; p < own.count; ++p) CHECK(own.estimates[k * length + own.used[p]] == 0 && own.weights[k] > 0);
  }
}

}  // namespace

int main() {
  groups_agree_with_the_equations_in_double_precision();
  noise_is_averaged_and_lost_detail_comes_back();
  a_constant_stays_whatever_the_pilot_is();
  equal_patches_with_next_to_no_noise_stay();
  steps_of_a_slope_without_noise_stay();
  plain_patches_without_noise_stay();
  std::puts("groups tests passed");
  return 0;
}
