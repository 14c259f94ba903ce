// Compiled once for each instruction set, see instruction_set.hpp.
#include "triangulated/length_sweep.hpp"

#include <algorithm>

#include "lanes.hpp"

namespace beltrami::triangulated::BELTRAMI_VARIANT {
namespace {

using namespace beltrami::lanes::BELTRAMI_VARIANT;

inline Mask where_larger(Lanes a, float b) { return a > splat(b); }

// |dI|^2 over edges, channel by channel.
Lanes colour_distance(const std::array<Index, 2>* edges, std::size_t count, Rows<float> colours) {
  Lanes sum{};
  for (std::size_t channel = 0; channel < colours.width; ++channel) {
    std::array<float, lane_count> difference{};
    for (std::size_t i = 0; i < count; ++i)
      difference[i] = colours[edges[i][0]][channel] - colours[edges[i][1]][channel];
    const Lanes d = load(difference.data());
    sum += d * d;
  }
  return sum;
}

void measure_edges(LengthTables& tables, Rows<float> colours, float squared_beta, std::size_t begin, std::size_t end) {
  for (std::size_t edge = begin; edge < end; edge += lane_count) {
    const std::size_t count = std::min(lane_count, end - edge);
    const Lanes apart = colour_distance(tables.edges.data() + edge, count, colours);
    store(tables.squared.data() + edge, load(tables.in_space.data() + edge) + squared_beta * apart);
  }
}

void set_lengths(LengthTables& tables, std::size_t begin, std::size_t end) {
  float* to = tables.segments.lengths.data();
  for (std::size_t edge = begin; edge < end; edge += lane_count) {
    std::array<float, lane_count> lengths;
    store(lengths.data(), square_root(load(tables.squared.data() + edge)));
    const std::array<std::uint32_t, 2>* places = tables.segments.over_edges.data() + edge;
    for (std::size_t i = 0; i < std::min(lane_count, end - edge); ++i) to[places[i][0]] = to[places[i][1]] = lengths[i];
  }
}

// A vertex in plane coordinates in which an opposite edge runs from its lower vertex, the origin, along the first axis.
struct Place {
  Lanes along, height;
};

// A triangle ABC unfolded with the three beyond its edges; [k]: of the corner k, or of the edge that faces it.
struct Unfolded {
  std::array<Place, 3> own, beyond;
  std::array<Lanes, 3> lengths, inverse;
};

// Twice the area of triangles from their squared sides, in any order; computed from the angle between the longer two
// sides, which is least affected by rounding.
Lanes area(Lanes a, Lanes b, Lanes c) {
  const Lanes low = smaller(a, b), high = larger(a, b);
  const Lanes least = smaller(low, c), most = larger(high, c), middle = larger(low, smaller(high, c));
  const Lanes product = 0.5F * (most + middle - least);
  return square_root(larger(most * middle - product * product, Lanes{}));
}

Unfolded unfold(const LengthTables& tables, std::size_t face) {
  const float* squared = tables.squared.data();
  const TrianglePlanes& planes = tables.planes;
  // Corners of faces ascend, so the lower end of the edge facing corner 0 is corner 1, of the others corner 0; the edge
  // from the apex to the lower end faces the higher end.
  constexpr std::array<std::size_t, 3> to_low{2, 2, 1}, to_high{1, 0, 0};
  std::array<Lanes, 3> square;
  for (std::size_t k = 0; k < 3; ++k) square[k] = gather(squared, planes.edges.data() + k * planes.stride + face);
  const Lanes own_area = area(square[0], square[1], square[2]);
  Unfolded at;
  for (std::size_t k = 0; k < 3; ++k) {
    at.lengths[k] = square_root(square[k]);
    at.inverse[k] = select(where_larger(at.lengths[k], 0), 1.0F / at.lengths[k], Lanes{});
    const auto place = [&](Lanes low, Lanes high, Lanes area) {
      return Place{0.5F * (low + square[k] - high) * at.inverse[k], area * at.inverse[k]};
    };
    at.own[k] = place(square[to_low[k]], square[to_high[k]], own_area);
    const Lanes low = gather(squared, planes.beyond_low.data() + k * planes.stride + face);
    const Lanes high = gather(squared, planes.beyond_high.data() + k * planes.stride + face);
    at.beyond[k] = place(low, high, area(square[k], low, high));
  }
  return at;
}

// The straight line between the apexes on either side of an edge.
Lanes across(const Place& c, const Place& d, Lanes length) {
  const Lanes apart = c.along - d.along, heights = c.height + d.height;
  const Lanes crossing = c.along * d.height + d.along * c.height;
  const Mask straight = where_larger(crossing, 0) & (crossing < length * heights);
  return select(straight, square_root(apart * apart + heights * heights), splat(no_segment));
}

// Around the corner A = k of triangles ABC: from D beyond AB to E beyond AC, passing A on its left.
template <std::size_t k>
Lanes around(const Unfolded& at) {
  constexpr std::size_t kb = (k + 1) % 3, kc = (k + 2) % 3;
  const Lanes ab = at.lengths[kc], ac = at.lengths[kb];
  // Measured from A, which is the lower end of AB and AC or the higher one.
  const auto from_a = [](const Place& place, Lanes length, bool low) {
    return Place{low ? place.along : length - place.along, place.height};
  };
  const Place c = from_a(at.own[kc], ab, k < kb), d = from_a(at.beyond[kc], ab, k < kb);
  const Place e = from_a(at.beyond[kb], ac, k < kc);
  const Lanes inverse = at.inverse[kb];
  const Lanes ex = (e.along * c.along - e.height * c.height) * inverse;
  const Lanes ey = (e.along * c.height + e.height * c.along) * inverse;
  const Lanes dx = ex - d.along, dy = ey + d.height;
  // > 0: the point lies on the left of the line from D to E.
  const auto side = [&](Lanes x, Lanes y) { return dx * (y + d.height) - dy * (x - d.along); };
  const Mask straight = where_larger(ey, 0) & where_larger(side(Lanes{}, Lanes{}), 0) & (side(ab, Lanes{}) < splat(0)) &
                        (side(c.along, c.height) < splat(0));
  return select(straight, square_root(dx * dx + dy * dy), splat(no_segment));
}

void cross_edges(LengthTables& tables, std::size_t begin, std::size_t end) {
  const Segments& segments = tables.segments;
  float* lengths = tables.segments.lengths.data();
  for (std::size_t face = begin; face < end; face += lane_count) {
    const Unfolded at = unfold(tables, face);
    std::array<std::array<float, lane_count>, 3> over_one, over_two;
    for (std::size_t k = 0; k < 3; ++k) store(over_one[k].data(), across(at.own[k], at.beyond[k], at.lengths[k]));
    store(over_two[0].data(), around<0>(at));
    store(over_two[1].data(), around<1>(at));
    store(over_two[2].data(), around<2>(at));
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t corner = k * tables.planes.stride + face;
      for (std::size_t i = 0; i < lane_count; ++i) {
        // Both triangles of an edge compute the same length, and each stores it for the direction from its own corner.
        const std::uint32_t place = segments.across_edges[corner + i];
        if (place != no_place) lengths[place] = over_one[k][i];
        const auto [one, other] = segments.round_corners[corner + i];
        if (one != no_place) lengths[one] = lengths[other] = over_two[k][i];
      }
    }
  }
}

}  // namespace

const LengthSweep length_sweep{measure_edges, set_lengths, cross_edges};

}  // namespace beltrami::triangulated::BELTRAMI_VARIANT
