#include "colours/clipping.hpp"

#include <algorithm>
#include <cmath>

#include "parallel.hpp"

namespace beltrami::colours {
namespace {

constexpr std::size_t samples_per_chunk = 1 << 13;

template <class F>
void each_sample(std::size_t count, unsigned threads, F f) {
  parallel_chunks(count, samples_per_chunk, threads, [&](std::size_t begin, std::size_t end, unsigned) {
    for (std::size_t i = begin; i < end; ++i) f(i);
  });
}

}  // namespace

void restore(const Layout<float>& averages, const Layout<const float>& share, const Clipping& clipping, float trusted,
             const Table& alpha, const Table& gap, const Samples& samples, unsigned threads) {
  each_sample(samples.count, threads, [&](std::size_t i) {
    const float marked = share.at(0, i);
    if (!(marked > 0) && !(marked < 0)) return;
    float& average = averages.at(0, i);
    // For a true colour within the limits, the share is at most one half.
    const float clipped = std::min(std::abs(marked), 0.5F), gap_of_one = gap(clipped);
    const float most = clipping.sigma * std::sqrt(samples.relative.at(0, i)) * trusted;
    const float from_limit = marked > 0 ? 1 - average : average;
    const float local = std::min(from_limit / gap_of_one, most);
    const float closer = std::max(local * (gap_of_one - alpha(clipped)), 0.0F);
    average = marked > 0 ? std::min(average + closer, std::max(average, 1.0F))
                         : std::max(average - closer, std::min(average, 0.0F));
  });
}

void impute(const Layout<float>& colours, const Layout<const float>& estimate, const Clipping& clipping,
            const Table& beyond, const Samples& samples, unsigned threads) {
  each_sample(samples.count, threads, [&](std::size_t i) {
    float& colour = colours.at(0, i);
    const bool high = clipping.high && colour >= 1, low = clipping.low && colour <= 0;
    if (!high && !low) return;
    const float around = estimate.at(0, i), sigma = clipping.sigma * std::sqrt(samples.relative.at(0, i));
    colour = high ? around + sigma * beyond((1 - around) / sigma) : around - sigma * beyond(around / sigma);
  });
}

}  // namespace beltrami::colours
