#include "triangulated/kernel_average.hpp"

#include <algorithm>
#include <cmath>

namespace beltrami::triangulated {

void average(std::span<const Reached> samples, Rows<float> colours, const float* weights, float quarter_inverse_t,
             std::vector<double>& sums, float* smoothed) {
  const float* centre = colours[samples.front().vertex];
  std::fill(sums.begin(), sums.end(), 0.0);
  double total = 0;
  for (const auto& [vertex, distance] : samples) {
    float kernel = std::exp(-distance * distance * quarter_inverse_t);
    if (weights != nullptr) kernel *= weights[vertex];
    const float* colour = colours[vertex];
    total += static_cast<double>(kernel);
    for (std::size_t channel = 0; channel < sums.size(); ++channel)
      sums[channel] += static_cast<double>(kernel * (colour[channel] - centre[channel]));
  }
  for (std::size_t channel = 0; channel < sums.size(); ++channel) {
    const double change = total > 0 ? sums[channel] / total : 0;
    smoothed[channel] = static_cast<float>(static_cast<double>(centre[channel]) + change);
  }
}

}  // namespace beltrami::triangulated
