// The affine map of a face from the texture's plane to space.
#pragma once

#include <algorithm>

#include "atlas/mesh.hpp"

namespace beltrami::atlas {

class FaceMap {
 public:
  FaceMap(const Mesh& mesh, Index face) {
    const auto f = static_cast<std::size_t>(face);
    origin_ = mesh.texels[f][0];
    first_ = mesh.texels[f][1] - origin_;
    second_ = mesh.texels[f][2] - origin_;
    const double area = cross(first_, second_);
    scale_ = area != 0 ? 1 / area : 0;
    base_ = mesh.corner(f, 0);
    along_first_ = mesh.corner(f, 1) - base_;
    along_second_ = mesh.corner(f, 2) - base_;
  }

  // In the plane of the face, inside it or not.
  Point3 extended(Point2 place) const {
    const Point2 offset = place - origin_;
    return base_ + cross(offset, second_) * scale_ * along_first_ + cross(first_, offset) * scale_ * along_second_;
  }

  // Whether a place lies in the face, so that `inside` and `extended` are the same, bit for bit.
  bool holds(Point2 place) const {
    const Point2 offset = place - origin_;
    const double u = cross(offset, second_) * scale_, v = cross(first_, offset) * scale_;
    return u >= 0 && v >= 0 && u + v <= 1;
  }

  // On the face, for a place that lies in it but for rounding (which slivers magnify).
  Point3 inside(Point2 place) const {
    const Point2 offset = place - origin_;
    double u = std::clamp(cross(offset, second_) * scale_, 0.0, 1.0);
    double v = std::clamp(cross(first_, offset) * scale_, 0.0, 1.0);
    const double beyond = std::max(u + v, 1.0);
    u /= beyond;
    v /= beyond;
    return base_ + u * along_first_ + v * along_second_;
  }

 private:
  Point2 origin_, first_, second_;
  Point3 base_, along_first_, along_second_;
  double scale_ = 0;
};

}  // namespace beltrami::atlas
