// Unfolding: a straight line continued over an edge, through faces unfolded into the plane of the face before.
#pragma once

#include <array>

#include "atlas/mesh.hpp"

namespace beltrami::atlas {

struct Landing {
  Index face;
  std::array<double, 3> weights;  // barycentric, not negative, of its corners
};

enum class End : std::uint8_t {
  landed,
  open,  // at an open edge
  lost   // the path begins at a face without extent, or crosses more than a fixed number of faces
};

// A face in the plane of another one, its corners clockwise, so that the plane outside lies on the left of its edges.
struct UnfoldedFace {
  Index face = none;
  std::array<std::uint8_t, 3> corner{};  // which corner of the face each is
  std::array<Point2, 3> at;
};

// Plane coordinates in which an edge of a face is on the x axis, starting at the origin, with the face below.
class Plane {
 public:
  Plane(const Mesh& mesh, Edge edge);

  bool is_flat() const { return area_ != 0 && length_ > 0; }
  double length() const { return length_; }
  // Minimum height of the face, in texels.
  double thickness() const;
  // The unit vector across the edge, in texels.
  Point2 across() const;
  // Replaces the map of the face by the steps in space from a texel near the edge to the right and down, if they
  // contradict it.
  void correct(Point3 right, Point3 down);
  // Plane coordinates of a point of the texture, and of the point on the edge nearest to it.
  Point2 at(Point2 place) const;
  Point2 nearest(Point2 place) const;
  // The nearest point on the edge, in the texture's plane.
  Point2 foot(Point2 place) const { return origin_ + (nearest(place).x / length_) * along_; }

 private:
  Point2 origin_, along_, side_;
  Point3 edge_;
  double area_, length_, foot_ = 0, height_ = 0;  // of the apex, in units of the edge
  bool corrected_ = false;
  Point2 right_, down_;  // if corrected: steps of a texel beyond the edge
};

// The straight path from an edge to a point of the texture's plane beyond it. The map of the edge's face to space is
// extended to that point, and the line from the nearest point on the edge is followed over the unfolded faces.
class Path {
 public:
  Path(const Mesh& mesh, Edge edge, const Plane& plane, Point2 place);
  Path(const Mesh& mesh, Edge edge, Point2 place) : Path(mesh, edge, Plane(mesh, edge), place) {}

  End end() const { return end_; }
  // End of the path.
  Landing landing() const;
  // Continues straight on to another point; returns where that line ends.
  End continued(const Mesh& mesh, Point2 place) const;

 private:
  Plane plane_;
  Point2 from_, to_;
  End end_;
  UnfoldedFace face_;
};

}  // namespace beltrami::atlas
