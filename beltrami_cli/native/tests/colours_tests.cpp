// Tests of colours, and of the nearest texels, without Python, meant to be run under the sanitizers. That numbers are right is
// tested from Python: in surface/test_colour_values.py and test_baking.py, flow/test_core_passes.py and test_clipping.py.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <numeric>
#include <random>
#include <vector>

#include "atlas/nearest_texel.hpp"
#include "colours/clipping.hpp"
#include "colours/colours.hpp"
#include "tests/check.hpp"

using namespace beltrami;

namespace {

// Some of the numbers from 0 on, each once; in order they have runs.
template <class Index>
std::vector<Index> some_of(std::size_t count, bool in_order, std::mt19937& random) {
  std::vector<Index> all(count);
  std::iota(all.begin(), all.end(), Index{0});
  std::shuffle(all.begin(), all.end(), random);
  all.resize(random() % (count + 1));
  if (in_order) std::sort(all.begin(), all.end());
  return all;
}

std::vector<float> values(std::size_t count, std::mt19937& random) {
  std::vector<float> made(count);
  for (float& value : made) value = static_cast<float>(random() % 600) / 500.0F - 0.1F;
  if (count > 1) made[random() % count] = std::numeric_limits<float>::quiet_NaN();
  return made;
}

template <class Sample, class Index>
void stored_numbers_do_not_depend_on_threads(std::mt19937& random) {
  for (int trial = 0; trial < 120; ++trial) {
    const std::size_t width = 1 + random() % 5, size = 1 + random() % 9000;
    std::vector<std::int32_t> channels(width);
    std::iota(channels.begin(), channels.end(), 0);
    if (trial % 2) channels = some_of<std::int32_t>(width, false, random);
    const std::size_t count = channels.size();
    const auto pixels = some_of<Index>(size, trial % 3 != 0, random);
    const auto rows = values(pixels.size() * count, random);
    std::vector<Sample> samples(size * width);
    for (Sample& sample : samples) sample = static_cast<Sample>(random());
    std::vector<Sample> again = samples;
    const auto moved = colours::store<Sample, Index>({rows.data(), channels}, pixels, width, samples.data(), 1);
    const auto twice = colours::store<Sample, Index>({rows.data(), channels}, pixels, width, again.data(), 3);
    CHECK(samples == again);
    CHECK(moved.total == twice.total && moved.squares == twice.squares && moved.largest == twice.largest);
  }
}

template <class Index>
void rows_come_back_from_planes(std::mt19937& random) {
  for (int trial = 0; trial < 60; ++trial) {
    const std::size_t size = 1 + random() % 20000, channels = 1 + random() % 4;
    const auto cells = some_of<Index>(size, trial % 2 == 0, random);
    std::vector<float> planes(size * channels, -1), rows(cells.size() * channels), back(rows.size());
    std::iota(rows.begin(), rows.end(), 0.0F);
    colours::scatter<Index>({planes.data(), size, channels}, cells, rows.data(), 1 + trial % 3);
    CHECK(static_cast<std::size_t>(std::count(planes.begin(), planes.end(), -1.0F)) == planes.size() - rows.size());
    colours::gather<Index>({planes.data(), size, channels}, cells, back.data(), 1 + trial % 3);
    CHECK(back == rows);
  }
}

// Every second cell shows the one behind it.
template <class Value, class Index>
void cells_show_their_sources_and_others_stay(std::mt19937& random) {
  for (int trial = 0; trial < 60; ++trial) {
    const std::size_t size = 2 + random() % 20000, channels = 1 + random() % 4;
    std::vector<Index> cells = some_of<Index>(size / 2, trial % 2 == 0, random), sources;
    for (Index& cell : cells) cell = static_cast<Index>(2 * cell);
    for (const Index cell : cells) sources.push_back(cell + 1);
    std::vector<Value> planes(size * channels);
    for (Value& value : planes) value = static_cast<Value>(random() % 100);
    std::vector<Value> expected = planes;
    for (std::size_t channel = 0; channel < channels; ++channel)
      for (const Index cell : cells) {
        const std::size_t at = channel * size + static_cast<std::size_t>(cell);
        expected[at] = planes[at + 1];
      }
    colours::copy_cells<Value, Index>({planes.data(), size, channels}, cells, sources, 1 + trial % 3);
    CHECK(planes == expected);
  }
}

// In rows of several channels; only the second is touched.
void colours_at_limits_alone_are_marked_imputed_and_restored(std::mt19937& random) {
  const std::vector<double> limits{-8, -4, 0, 4, 8}, beyond{0, 0.2, 0.8, 4.3, 8.1};
  const std::vector<double> shares{0, 0.25, 0.5, 0.75, 1}, alpha{4, 0.7, 0, -0.7, -4}, gap{4, 0.9, 0.4, 0.2, 0.01};
  for (int trial = 0; trial < 60; ++trial) {
    const std::size_t count = 1 + random() % 20000, channels = 2;
    const colours::CutOff cut{0.1F, trial % 3 != 0, trial % 3 != 1};
    std::vector<float> rows(count * channels), relative(count), marks(count), estimate(count);
    for (float& value : rows) value = std::clamp(static_cast<float>(random() % 700) / 500.0F - 0.2F, 0.0F, 1.0F);
    for (std::size_t i = 0; i < count; ++i) {
      relative[i] = 0.1F + static_cast<float>(random() % 20) / 10.0F;
      estimate[i] = static_cast<float>(random() % 100) / 100.0F;
    }
    const auto before = rows;
    const Layout<float> second{rows.data() + 1, 1, channels};
    const Layout<const float> seen{rows.data() + 1, 1, channels}, around{estimate.data(), 1, 1};
    const colours::Samples samples{{relative.data(), 1, 1}, count};
    const unsigned threads = 1 + trial % 3;
    colours::mark(seen, cut, count, {marks.data(), 1, 1}, threads);
    colours::impute(second, around, cut, {limits, beyond}, samples, threads);
    for (std::size_t i = 0; i < count; ++i) {
      const float colour = before[2 * i + 1];
      const bool high = cut.high && colour == 1, low = cut.low && colour == 0;
      CHECK(rows[2 * i] == before[2 * i]);
      CHECK(marks[i] == (high ? 1.0F : low ? -1.0F : 0.0F));
      if (high) CHECK(rows[2 * i + 1] >= estimate[i]);
      if (low) CHECK(rows[2 * i + 1] <= estimate[i]);
      if (!high && !low) CHECK(rows[2 * i + 1] == colour);
    }
    rows = before;
    for (float& mark : marks) mark *= 0.4F;
    colours::restore(second, {marks.data(), 1, 1}, cut, 1.2F, {shares, alpha}, {shares, gap}, samples, threads);
    for (std::size_t i = 0; i < count; ++i) {
      CHECK(rows[2 * i] == before[2 * i]);
      const float step = rows[2 * i + 1] - before[2 * i + 1];
      CHECK(marks[i] > 0 ? step >= 0 : marks[i] < 0 ? step <= 0 : step == 0);
      CHECK(rows[2 * i + 1] >= 0 && rows[2 * i + 1] <= 1);
    }
  }
}

void limits_are_found_in_any_number_of_channels(std::mt19937& random) {
  for (int trial = 0; trial < 100; ++trial) {
    const std::size_t channels = 1 + random() % 5, count = random() % 200;
    const std::vector<float> rows(count * channels, 1);
    for (const auto& limits : colours::find_limits(rows.data(), count, channels)) CHECK(limits.at_1 == count);
  }
}

void marks_are_within_reach(std::mt19937& random) {
  for (int trial = 0; trial < 150; ++trial) {
    const std::int64_t height = 1 + random() % 30, width = 1 + random() % 40, reach = random() % 20;
    const auto size = static_cast<std::size_t>(height * width);
    std::vector<char> marked(size), wanted(size);
    const unsigned rare = 1 + random() % 50;
    for (std::size_t i = 0; i < size; ++i) marked[i] = random() % rare == 0, wanted[i] = random() % 3 == 0;
    const auto found = atlas::nearest_marked(reinterpret_cast<bool*>(marked.data()), reinterpret_cast<bool*>(wanted.data()),
                                             height, width, reach, 1 + trial % 3);
    CHECK(found.texels.size() == found.marks.size());
    for (std::size_t i = 0; i < found.texels.size(); ++i) {
      const std::int64_t texel = found.texels[i], mark = found.marks[i];
      const std::int64_t down = mark / width - texel / width, across = mark % width - texel % width;
      CHECK(wanted[static_cast<std::size_t>(texel)] && marked[static_cast<std::size_t>(mark)]);
      CHECK(down * down + across * across <= reach * reach);
    }
  }
}

}  // namespace

int main() {
  std::mt19937 random(5);
  stored_numbers_do_not_depend_on_threads<std::uint8_t, std::int32_t>(random);
  stored_numbers_do_not_depend_on_threads<std::uint16_t, std::int64_t>(random);
  rows_come_back_from_planes<std::int32_t>(random);
  rows_come_back_from_planes<std::int64_t>(random);
  cells_show_their_sources_and_others_stay<float, std::int32_t>(random);
  cells_show_their_sources_and_others_stay<float, std::int64_t>(random);
  cells_show_their_sources_and_others_stay<std::int8_t, std::int64_t>(random);
  colours_at_limits_alone_are_marked_imputed_and_restored(random);
  limits_are_found_in_any_number_of_channels(random);
  marks_are_within_reach(random);
  std::puts("colours tests passed");
  return 0;
}
