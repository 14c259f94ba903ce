// Tests of the atlas without Python, meant to be run under the sanitizers: any triangles with any texture coordinates.
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <random>
#include <set>
#include <vector>

#include "atlas/atlas.hpp"
#include "atlas/packing.hpp"
#include "tests/check.hpp"

using namespace beltrami::atlas;

namespace {

struct Soup {
  std::vector<double> positions, uv;
  std::vector<Index> places, texture_of;
  std::vector<Texture> textures;
  Surface surface() const {
    return {positions.data(), static_cast<Index>(positions.size() / 3), places, uv.data(), texture_of, textures};
  }
};

double coordinate(std::mt19937& random, int style) {
  const double fraction = static_cast<double>(random() % 65) / 64;
  switch (style) {
    case 0: return fraction;                                        // in the image, often equal
    case 1: return 8 * fraction - 4;                                // over many periods
    case 2: return random() % 2 == 0 ? fraction : 1e-7 * fraction;  // slivers
    case 3: return (random() % 3 == 0 ? 1e12 : 1.0) * fraction;     // far outside
    default: return random() % 5 == 0 ? std::numeric_limits<double>::quiet_NaN() : std::ldexp(fraction, 24);
  }
}

// Few places, so that faces share edges, two by two or many at once, and repeat places.
Soup make_soup(std::mt19937& random) {
  Soup soup;
  const auto places = 1 + random() % 12, faces = random() % 40;
  for (std::size_t i = 0; i < 3 * places; ++i)
    soup.positions.push_back(static_cast<double>(random() % 4) * (random() % 4 == 0 ? 1e-12 : 1.0));
  std::int64_t offset = 0;
  for (std::size_t i = 0; i < 1 + random() % 2; ++i) {
    const auto width = static_cast<std::int32_t>(1 + random() % 24), height = static_cast<std::int32_t>(1 + random() % 24);
    soup.textures.push_back({width, height, static_cast<Wrap>(random() % 3), static_cast<Wrap>(random() % 3), offset});
    offset += static_cast<std::int64_t>(width) * height;
  }
  const int style = static_cast<int>(random() % 5);
  for (std::size_t face = 0; face < faces; ++face) {
    soup.texture_of.push_back(static_cast<Index>(random() % (soup.textures.size() + 1)) - 1);
    for (int k = 0; k < 3; ++k) soup.places.push_back(static_cast<Index>(random() % places));
    for (int k = 0; k < 6; ++k) soup.uv.push_back(coordinate(random, style));
  }
  return soup;
}

// A strip of quads around a cylinder, unrolled in the image, so that it has a seam and a proper halo.
Soup make_cylinder(std::mt19937& random) {
  Soup soup;
  const auto sides = static_cast<Index>(3 + random() % 9);
  for (Index i = 0; i < sides; ++i)
    for (int level = 0; level < 2; ++level) {
      const double angle = 2 * 3.14159265358979 * i / sides;
      soup.positions.insert(soup.positions.end(), {std::cos(angle), std::sin(angle), static_cast<double>(level)});
    }
  soup.textures.push_back({static_cast<std::int32_t>(16 + random() % 60), 20, Wrap::repeat, Wrap::clamp, 0});
  const auto add = [&](Index column, Index level) {
    soup.places.push_back(2 * (column % sides) + level);
    soup.uv.insert(soup.uv.end(), {0.05 + 0.9 * column / sides, 0.2 + 0.6 * level});
  };
  for (Index i = 0; i < sides; ++i) {
    add(i, 0), add(i + 1, 0), add(i + 1, 1);
    add(i, 0), add(i + 1, 1), add(i, 1);
    soup.texture_of.insert(soup.texture_of.end(), {0, 0});
  }
  return soup;
}

template <class T>
bool same(const Array<T>& a, const Array<T>& b) {
  return a.size == b.size && (a.size == 0 || std::memcmp(a.data(), b.data(), a.size * sizeof(T)) == 0);
}

void check_lists(const Atlas& atlas) {
  CHECK(static_cast<std::int64_t>(atlas.owned_cells.size) == atlas.covered);
  CHECK(atlas.overlapped <= atlas.covered);
  for (std::size_t i = 0; i < atlas.owned_cells.size; ++i) {
    CHECK(atlas.kind[static_cast<std::size_t>(atlas.owned_cells[i])] == 1);
    CHECK(i == 0 || atlas.owned_cells[i - 1] < atlas.owned_cells[i]);
  }
  for (std::size_t i = 0; i < atlas.halo_cells.size; ++i) {
    CHECK(atlas.kind[static_cast<std::size_t>(atlas.halo_cells[i])] == 2);
    CHECK(-1 <= atlas.halo_seams[i] && atlas.halo_seams[i] < atlas.seams);
    float sum = 0;
    for (std::size_t k = 4 * i; k < 4 * i + 4; ++k) {
      CHECK(atlas.kind[static_cast<std::size_t>(atlas.halo_taps[k])] == 1);
      CHECK(atlas.halo_weights[k] >= 0);
      sum += atlas.halo_weights[k];
    }
    CHECK(std::abs(sum - 1) < 1e-6F);
  }
  for (std::size_t i = 0; i < atlas.gutter_cells.size; ++i)
    CHECK(atlas.kind[static_cast<std::size_t>(atlas.gutter_cells[i])] == 2);
}

// Each texel that faces look up is listed once, and no face covers it.
void check_looked_up(const Atlas& atlas) {
  std::set<Index> covered(atlas.owned_texels.data(), atlas.owned_texels.data() + atlas.owned_texels.size);
  for (const Array<Index>* list : {&atlas.border_texels, &atlas.lone_texels})
    for (std::size_t i = 0; i < list->size; ++i) {
      CHECK(i == 0 || (*list)[i - 1] < (*list)[i]);
      CHECK(covered.insert((*list)[i]).second);
    }
  const std::set<Index> lone(atlas.lone_texels.data(), atlas.lone_texels.data() + atlas.lone_texels.size);
  for (std::size_t i = 0; i < atlas.gutter_texels.size; ++i) CHECK(lone.count(atlas.gutter_texels[i]) == 0);
}

// Lengths are finite exactly between cells that are not empty, and never lead out of a rectangle's margin.
void check_lengths(const Atlas& atlas) {
  const std::int64_t down[] = {0, 1, 1, 1}, right[] = {1, 0, 1, -1};
  for (int which = 0; which < 4; ++which)
    for (std::int64_t row = 0; row < atlas.rows; ++row)
      for (std::int64_t column = 0; column < atlas.columns; ++column) {
        const auto cell = static_cast<std::size_t>(row * atlas.columns + column);
        const float length = atlas.squared_lengths[static_cast<std::size_t>(which) * atlas.kind.size + cell];
        const std::int64_t to_row = row + down[which], to_column = column + right[which];
        CHECK(length >= 0);
        if (!(length < std::numeric_limits<float>::infinity())) continue;
        CHECK(to_row < atlas.rows && to_column >= 0 && to_column < atlas.columns);
        CHECK(atlas.kind[cell] != 0);
        CHECK(atlas.kind[static_cast<std::size_t>(to_row * atlas.columns + to_column)] != 0);
      }
}

void test(const Soup& soup, std::int64_t margin) {
  const Surface surface = soup.surface();
  const Atlas atlas = make_atlas(surface, margin, 1), again = make_atlas(surface, margin, 3);
  check_lists(atlas);
  check_lengths(atlas);
  check_looked_up(atlas);
  CHECK(same(atlas.kind, again.kind) && same(atlas.squared_lengths, again.squared_lengths));
  CHECK(same(atlas.owned_texels, again.owned_texels) && same(atlas.halo_taps, again.halo_taps));
  CHECK(same(atlas.halo_weights, again.halo_weights) && same(atlas.gutter_texels, again.gutter_texels));
}

Bits make_shape(std::mt19937& random) {
  Bits shape(static_cast<std::int64_t>(1 + random() % 20), static_cast<std::int64_t>(1 + random() % 150));
  const auto density = 1 + random() % 9;
  for (std::int64_t row = 0; row < shape.rows; ++row)
    for (std::int64_t column = 0; column < shape.columns; ++column)
      if (random() % 10 <= density) shape.row(row)[column / 64] |= std::uint64_t{1} << (column % 64);
  return shape;
}

void test_packing(std::mt19937& random) {
  std::vector<Bits> shapes;
  for (auto count = random() % 30; count > 0; --count) shapes.push_back(make_shape(random));
  const Packing packing = pack(shapes);
  CHECK(packing.spots.size() == shapes.size());
  std::vector<int> taken(static_cast<std::size_t>(packing.rows * packing.columns), 0);
  for (std::size_t i = 0; i < shapes.size(); ++i) {
    const auto [top, left] = packing.spots[i];
    CHECK(top >= 0 && left >= 0);
    CHECK(top + shapes[i].rows <= packing.rows && left + shapes[i].columns <= packing.columns);
    for (std::int64_t row = 0; row < shapes[i].rows; ++row)
      for (std::int64_t column = 0; column < shapes[i].columns; ++column)
        if ((shapes[i].row(row)[column / 64] >> (column % 64) & 1) != 0)
          CHECK(taken[static_cast<std::size_t>((top + row) * packing.columns + left + column)]++ == 0);
  }
}

}  // namespace

int main() {
  std::mt19937 random(1);
  for (int i = 0; i < 100; ++i) test_packing(random);
  for (int i = 0; i < 250; ++i) test(make_soup(random), 1 + static_cast<std::int64_t>(random() % 7));
  for (int i = 0; i < 40; ++i) {
    const Soup cylinder = make_cylinder(random);
    test(cylinder, 3);
    CHECK(make_atlas(cylinder.surface(), 3, 1).halo_cells.size > 0);
  }
  std::puts("atlas tests passed");
  return 0;
}
