// The stencils of fast marching, with their coefficients, rebuilt whenever the metric changes.
//
// When a vertex A is accepted, it may update a vertex C along the edge AC, and together with an accepted
// partner B through the triangle ABC. R. Kimmel, J. Sethian (PNAS 1998) solve a quadratic for that; with A at the
// origin, B at (c, 0) and C at (k c, h) the same plane wave reads
//     phi(C) = phi(A) + k u + s,   s = sqrt(h^2 - n u^2),   u = phi(B) - phi(A),   n = h^2 / c^2,
// and it comes from within the triangle if   k s > n u   and   (k - 1) s < n u.
//
// Their section 4 splits obtuse corners by unfolding: at an obtuse corner C of a triangle ABC the triangles beyond the edge
// AB are unfolded into the plane of ABC, one after the other, until a vertex D falls into the section of directions that
// make acute angles with both CA and CB. D then supports C in two acute stencils, (A, D) and (D, B). Only edge lengths
// enter.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "triangulated/topology.hpp"

namespace beltrami::triangulated {

struct Partner {
  Index vertex = 0;  // B
  float k = 0, squared_height = 0, n = 0;  // all zero: the triangle gives no update, as 0 > 0 is false
};

// An update over the edge to `target`, and through the triangles of partners [first, end of the next).
struct Link {
  Index target;
  float length;
  Index first_partner;
};

// The stencil that splits an obtuse corner: its support updates `target`, alone or with either partner.
struct SplitLink {
  Index target;
  float length;
  std::array<Partner, 2> partners;
};

struct Stencils {
  std::vector<Index> link_offsets;   // [vertex], one more at the end
  std::vector<Link> links;           // one more at the end, to close the last list of partners
  std::vector<Partner> partners;
  std::vector<Index> split_offsets;  // [vertex that supports], one more at the end
  std::vector<SplitLink> splits;
};

// A split before the splits are grouped by their support.
struct FoundSplit {
  Index support;
  SplitLink link;
};

// Groups splits by their support, in the order of the chunks in which they were found. split_offsets must have one entry for
// each vertex, and one more.
void group_splits(Stencils& stencils, const std::vector<std::vector<FoundSplit>>& chunks);

// Takes over the topology's lists of links and slots, which are empty afterwards and not read elsewhere.
Stencils make_stencils(Topology& topology);

// Fills lengths, coefficients and splits for a metric given by its squared edge lengths.
void update_stencils(Stencils& stencils, const Topology& topology, const std::vector<double>& squared_lengths, unsigned threads);

}  // namespace beltrami::triangulated
