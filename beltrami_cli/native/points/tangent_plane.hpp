// The tangent plane of a surface at one of its points, from the points around it.
#pragma once

#include <array>
#include <span>

namespace beltrami::points {

using Vector = std::array<double, 3>;

inline double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Orthonormal axes, and the variance of the points along them, in descending order.
struct TangentPlane {
  Vector first{}, second{}, normal{};
  double first_spread = 0, second_spread = 0, normal_spread = 0;
  double height = 0;  // of the mean of the points above the point itself, along the normal
};

// The principal axes of the point itself and those at `offsets` from it: H. Hoppe, T. DeRose, T. Duchamp, J. McDonald,
// W. Stuetzle, "Surface reconstruction from unorganized points", SIGGRAPH 1992. An offset counts by the biweight
// (1 - |offset|^2 / reach^2)^2, so that it makes no difference whether one at `reach` (> 0) is among them.
TangentPlane fit_tangent_plane(std::span<const Vector> offsets, double squared_reach);

}  // namespace beltrami::points
