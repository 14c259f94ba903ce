// Straight on over an edge: the faces beyond it, unfolded one after the other into the plane of the face before it.
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
  lost   // the way begins at a face without extent, or crosses more than a fixed number of faces
};

// A face in the plane of another one, its corners clockwise, so that the plane outside lies on the left of its edges.
struct Laid {
  Index face = none;
  std::array<std::uint8_t, 3> corner{};  // which corner of the face each is
  std::array<Point2, 3> at;
};

// The plane of a face with one of its edges along the x axis, from the origin, and the face below.
class Plane {
 public:
  Plane(const Mesh& mesh, Edge edge);

  bool is_flat() const { return area_ != 0 && length_ > 0; }
  double length() const { return length_; }
  // The least height of the face, in texels.
  double thickness() const;
  // The unit vector across the edge, in texels.
  Point2 across() const;
  // Uses the steps in space from a texel near the edge to the right and down instead of the face, if it contradicts them.
  void correct(Point3 right, Point3 down);
  // Of a place in the texture's plane, and of the edge's point nearest to it.
  Point2 at(Point2 place) const;
  Point2 nearest(Point2 place) const;
  // That point, in the texture's plane.
  Point2 foot(Point2 place) const { return origin_ + (nearest(place).x / length_) * along_; }

 private:
  Point2 origin_, along_, side_;
  Point3 edge_;
  double area_, length_, foot_ = 0, height_ = 0;  // of the apex, in units of the edge
  bool corrected_ = false;
  Point2 right_, down_;  // if corrected: steps of a texel beyond the edge
};

// The straight way from an edge to a place of the texture's plane, outside the edge's face beyond the edge: the face's map
// to its plane in space is extended, and the line from the edge's point nearest to the place is followed over the unfolded
// faces.
class Way {
 public:
  Way(const Mesh& mesh, Edge edge, const Plane& plane, Point2 place);
  Way(const Mesh& mesh, Edge edge, Point2 place) : Way(mesh, edge, Plane(mesh, edge), place) {}

  End end() const { return end_; }
  // Where it has landed.
  Landing landing() const;
  // How the line ends that leads straight on from there to another place.
  End on_to(const Mesh& mesh, Point2 place) const;

 private:
  Plane plane_;
  Point2 from_, to_;
  End end_;
  Laid laid_;
};

}  // namespace beltrami::atlas
