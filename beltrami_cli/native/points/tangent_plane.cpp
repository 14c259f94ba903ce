#include "points/tangent_plane.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace beltrami::points {
namespace {

using Matrix = std::array<Vector, 3>;

// Limits of Jacobi's method, which converges quadratically: neither sweeps beyond the sixth nor off-diagonal entries
// this small relative to the diagonal change anything in double precision.
constexpr int sweeps = 8;
constexpr double negligible = 1e-17;

// Rotates rows i and j of a symmetric matrix so that its entry (i, j) becomes zero, and the axes with it.
void rotate(Matrix& matrix, Matrix& axes, std::size_t i, std::size_t j) {
  if (std::abs(matrix[i][j]) <= negligible * (std::abs(matrix[i][i]) + std::abs(matrix[j][j]))) {
    matrix[i][j] = matrix[j][i] = 0;
    return;
  }
  const double theta = (matrix[j][j] - matrix[i][i]) / (2 * matrix[i][j]);
  // If the square overflows, the rotation is none.
  const double t = std::copysign(1.0, theta) / (std::abs(theta) + std::sqrt(theta * theta + 1));
  const double c = 1 / std::sqrt(t * t + 1), s = t * c;
  const std::size_t k = 3 - i - j;
  const double shift = t * matrix[i][j];
  matrix[i][i] -= shift;
  matrix[j][j] += shift;
  matrix[i][j] = matrix[j][i] = 0;
  const double ki = matrix[k][i], kj = matrix[k][j];
  matrix[k][i] = matrix[i][k] = c * ki - s * kj;
  matrix[k][j] = matrix[j][k] = s * ki + c * kj;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double a = axes[i][axis], b = axes[j][axis];
    axes[i][axis] = c * a - s * b;
    axes[j][axis] = s * a + c * b;
  }
}

struct Moments {
  Vector mean{};
  Matrix covariance{};
};

Moments moments_of(std::span<const Vector> offsets, double squared_reach) {
  Moments moments;
  auto& [mean, second] = moments;
  double total = 1;  // the point itself, with offset zero
  for (const Vector& offset : offsets) {
    const double rest = std::max(0.0, 1 - dot(offset, offset) / squared_reach);
    const double weight = rest * rest;
    total += weight;
    for (std::size_t i = 0; i < 3; ++i) {
      mean[i] += weight * offset[i];
      for (std::size_t j = i; j < 3; ++j) second[i][j] += weight * offset[i] * offset[j];
    }
  }
  for (double& component : mean) component /= total;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = i; j < 3; ++j) second[i][j] = second[j][i] = second[i][j] / total - mean[i] * mean[j];
  return moments;
}

}  // namespace

TangentPlane fit_tangent_plane(std::span<const Vector> offsets, double squared_reach) {
  auto [mean, matrix] = moments_of(offsets, squared_reach);
  Matrix axes{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    if (matrix[0][1] == 0 && matrix[0][2] == 0 && matrix[1][2] == 0) break;
    rotate(matrix, axes, 0, 1);
    rotate(matrix, axes, 0, 2);
    rotate(matrix, axes, 1, 2);
  }
  std::array<std::size_t, 3> order{0, 1, 2};
  std::sort(order.begin(), order.end(), [&m = matrix](std::size_t a, std::size_t b) { return m[a][a] > m[b][b]; });
  const auto [a, b, c] = order;
  return {axes[a], axes[b], axes[c], matrix[a][a], matrix[b][b], matrix[c][c], dot(mean, axes[c])};
}

}  // namespace beltrami::points
