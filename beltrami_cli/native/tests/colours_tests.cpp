// Tests of colours, and of the nearest texels, without Python, meant to be run under the sanitizers: against plain loops.
#include <algorithm>
#include <cmath>
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
void stored_numbers_are_those_of_a_plain_loop(std::mt19937& random) {
  for (int trial = 0; trial < 120; ++trial) {
    const std::size_t width = 1 + random() % 5, size = 1 + random() % 9000;
    std::vector<std::int32_t> channels(width);
    std::iota(channels.begin(), channels.end(), 0);
    if (trial % 2) channels = some_of<std::int32_t>(width, false, random);
    const std::size_t count = channels.size();
    const auto pixels = some_of<Index>(size, trial % 3 != 0, random);
    const auto rows = values(pixels.size() * count, random);
    std::vector<Sample> samples(size * width), expected;
    for (Sample& sample : samples) sample = static_cast<Sample>(random());
    expected = samples;
    std::uint64_t total = 0, squares = 0, largest = 0;
    for (std::size_t row = 0; row < pixels.size(); ++row)
      for (std::size_t i = 0; i < count; ++i) {
        const float value = rows[row * count + i];
        const double inside = std::isnan(value) ? 0.0 : std::clamp(static_cast<double>(value), 0.0, 1.0);
        const auto now = static_cast<Sample>(std::nearbyint(inside * std::numeric_limits<Sample>::max()));
        Sample& sample = expected[static_cast<std::size_t>(pixels[row]) * width + static_cast<std::size_t>(channels[i])];
        const auto step = static_cast<std::uint64_t>(now > sample ? now - sample : sample - now);
        total += step, squares += step * step, largest = std::max(largest, step);
        sample = now;
      }
    const auto moved = colours::store<Sample, Index>({rows.data(), channels}, pixels, width, samples.data(), 1 + trial % 3);
    CHECK(samples == expected);
    CHECK(moved.total == total && moved.squares == squares && moved.largest == largest);
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
    for (std::size_t row = 0; row < cells.size(); ++row)
      for (std::size_t channel = 0; channel < channels; ++channel)
        CHECK(planes[channel * size + static_cast<std::size_t>(cells[row])] == rows[row * channels + channel]);
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

void limits_are_those_of_a_plain_loop(std::mt19937& random) {
  for (int trial = 0; trial < 100; ++trial) {
    const std::size_t channels = 1 + random() % 5, count = random() % 200;
    std::vector<float> rows(count * channels);
    for (float& value : rows) value = static_cast<float>(random() % 7) / 4.0F - 0.25F;
    const auto found = colours::find_limits(rows.data(), count, channels);
    for (std::size_t channel = 0; channel < channels; ++channel) {
      std::size_t at_0 = 0, at_1 = 0;
      for (std::size_t i = channel; i < rows.size(); i += channels) at_0 += rows[i] == 0.0F, at_1 += rows[i] == 1.0F;
      CHECK(found[channel].at_0 == at_0 && found[channel].at_1 == at_1);
    }
  }
}

void marks_are_the_nearest(std::mt19937& random) {
  for (int trial = 0; trial < 150; ++trial) {
    const std::int64_t height = 1 + random() % 30, width = 1 + random() % 40, reach = random() % 20;
    const auto size = static_cast<std::size_t>(height * width);
    std::vector<char> marked(size), wanted(size);
    const unsigned rare = 1 + random() % 50;
    for (std::size_t i = 0; i < size; ++i) marked[i] = random() % rare == 0, wanted[i] = random() % 3 == 0;
    const auto found = atlas::nearest_marked(reinterpret_cast<bool*>(marked.data()), reinterpret_cast<bool*>(wanted.data()),
                                             height, width, reach, 1 + trial % 3);
    std::size_t next = 0;
    for (std::int64_t texel = 0; texel < height * width; ++texel) {
      if (!wanted[static_cast<std::size_t>(texel)]) continue;
      std::int64_t best = reach * reach + 1;
      const auto square_to = [&](std::int64_t mark) {
        const std::int64_t down = mark / width - texel / width, across = mark % width - texel % width;
        return down * down + across * across;
      };
      for (std::int64_t mark = 0; mark < height * width; ++mark)
        if (marked[static_cast<std::size_t>(mark)]) best = std::min(best, square_to(mark));
      if (best > reach * reach) continue;
      CHECK(next < found.texels.size() && found.texels[next] == texel);
      CHECK(marked[static_cast<std::size_t>(found.marks[next])] && square_to(found.marks[next]) == best);
      ++next;
    }
    CHECK(next == found.texels.size() && next == found.marks.size());
  }
}

}  // namespace

int main() {
  std::mt19937 random(5);
  stored_numbers_are_those_of_a_plain_loop<std::uint8_t, std::int32_t>(random);
  stored_numbers_are_those_of_a_plain_loop<std::uint16_t, std::int64_t>(random);
  rows_come_back_from_planes<std::int32_t>(random);
  rows_come_back_from_planes<std::int64_t>(random);
  cells_show_their_sources_and_others_stay<float, std::int32_t>(random);
  cells_show_their_sources_and_others_stay<float, std::int64_t>(random);
  cells_show_their_sources_and_others_stay<std::int8_t, std::int64_t>(random);
  colours_at_limits_alone_are_marked_imputed_and_restored(random);
  limits_are_those_of_a_plain_loop(random);
  marks_are_the_nearest(random);
  std::puts("colours tests passed");
  return 0;
}
