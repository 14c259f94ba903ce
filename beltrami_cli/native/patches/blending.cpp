// Compiled once for each instruction set, see instruction_set.hpp.
#include "patches/blending.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace beltrami::patches::BELTRAMI_VARIANT {
namespace {

// Number of samples whose values fit the cache.
constexpr std::size_t run = 256;

using Run = std::array<float, run>;

// Distance to a limit in standard deviations, beyond which the tables are negligible in float32 relative to 1.
constexpr float beyond_reach = 5.5F;

// Some samples of one channel.
class Channel {
 public:
  Channel(const BlendNoise& noise, std::size_t channel, std::size_t first, std::size_t count)
      : noise_(noise), channel_noise_(noise.channels[channel]), channel_(channel), first_(first), count_(count) {
    if (channel_noise_.low || channel_noise_.high)
      for (std::size_t i = 0; i < count; ++i) sigma_[i] = channel_noise_.sigma * std::sqrt(noise.relative.at(0, first + i));
  }

  void read(const Values& from, Run& to) const {
    const float* const values = &from.at(channel_, first_);
    if (from.sample_step == 1)  // vectorised
      std::copy_n(values, count_, to.begin());
    else
      for (std::size_t i = 0; i < count_; ++i) to[i] = from.at(channel_, first_ + i);
  }

  // Imputed colours before imputation.
  void clip(Run& values) const {
    if (channel_noise_.low)
      for (std::size_t i = 0; i < count_; ++i) values[i] = std::max(values[i], 0.0F);
    if (channel_noise_.high)
      for (std::size_t i = 0; i < count_; ++i) values[i] = std::min(values[i], 1.0F);
  }

  // Replaces colours without noise by the mean of noisy, clipped colours.
  void expect(Run& values) const {
    Run lost{};
    near_limits(values, noise_.tables.lost,
                [&](std::size_t i, float found, float sign) { lost[i] += sign * sigma_[i] * found; });
    for (std::size_t i = 0; i < count_; ++i) values[i] += lost[i];
  }

  // The share of unclipped samples, given the colours without noise.
  void share_within(const Run& values, Run& within) const {
    within.fill(1);
    near_limits(values, noise_.tables.share, [&](std::size_t i, float found, float) { within[i] -= found; });
  }

  // The same, multiplied by the variance of each sample.
  void variance_within(const Run& values, Run& variances) const {
    share_within(values, variances);
    for (std::size_t i = 0; i < count_; ++i)
      variances[i] = channel_noise_.variance * (variances[i] * noise_.relative.at(0, first_ + i));
  }

 private:
  // Calls f(sample, value of a table, sign) for each limit at which noise is clipped, unless all samples are beyond its
  // reach; the sign is 1 at 0 and -1 at full scale.
  template <class F>
  void near_limits(const Run& values, std::span<const float> table, F f) const {
    for (const bool is_high : {true, false}) {
      if (!(is_high ? channel_noise_.high : channel_noise_.low)) continue;
      Run limits;
      int within_reach = 0;
      for (std::size_t i = 0; i < count_; ++i) {
        limits[i] = (is_high ? 1 - values[i] : values[i]) / sigma_[i];
        within_reach += limits[i] < beyond_reach ? 1 : 0;
      }
      for (std::size_t i = 0; within_reach > 0 && i < count_; ++i) f(i, look_up(limits[i], table), is_high ? -1.0F : 1.0F);
    }
  }

  // Interpolates a table linearly; it is constant beyond its ends.
  float look_up(float limit, std::span<const float> table) const {
    const float furthest = noise_.tables.furthest, steps = static_cast<float>(table.size() - 1) / (2 * furthest);
    const float place = (std::clamp(limit, -furthest, furthest) + furthest) * steps;
    const auto k = std::clamp(static_cast<std::int32_t>(place), 0, static_cast<std::int32_t>(table.size()) - 2);
    const float* here = table.data() + k;
    return here[0] + (place - static_cast<float>(k)) * (here[1] - here[0]);
  }

  const BlendNoise& noise_;
  const ChannelNoise& channel_noise_;
  std::size_t channel_, first_, count_;
  Run sigma_;
};

// Calls f(first sample, count) for runs of samples.
template <class F>
void each_run(const Range& samples, F f) {
  for (std::size_t first = samples.begin; first < samples.end; first += run) f(first, std::min(run, samples.end - first));
}

}  // namespace

void blend_terms(const Values& noisy, const Values& probe, const Estimates& estimates, const BlendNoise& noise,
                 const Range& samples, const Layout<float>& terms) {
  each_run(samples, [&](std::size_t first, std::size_t size) {
    Run slope{}, square{}, z, b, p, q, near_p, near_q, middle, variances;
    for (std::size_t k = 0; k < noise.channels.size(); ++k) {
      const Channel channel(noise, k, first, size);
      channel.read(noisy, z);
      channel.read(probe, b);
      channel.read(estimates.first, p);
      channel.read(estimates.second, q);
      channel.read(estimates.near_first, near_p);
      channel.read(estimates.near_second, near_q);
      for (std::size_t i = 0; i < size; ++i) middle[i] = (p[i] + q[i]) * 0.5F;
      channel.variance_within(middle, variances);
      channel.clip(z);
      for (Run* values : {&p, &q, &near_p, &near_q}) channel.expect(*values);
      for (std::size_t i = 0; i < size; ++i) {
        const float difference = q[i] - p[i], moved = near_q[i] - near_p[i];
        slope[i] += (z[i] - p[i]) * difference - variances[i] * b[i] * (moved - difference);
        square[i] += difference * difference;
      }
    }
    for (std::size_t i = 0; i < size; ++i) {
      terms.at(0, first + i) = slope[i];
      terms.at(1, first + i) = square[i];
    }
  });
}

void blend_residual(const Values& noisy, const Values& estimate, const BlendNoise& noise, const Range& samples,
                    const Layout<float>& residual) {
  each_run(samples, [&](std::size_t first, std::size_t size) {
    Run z, p;
    for (std::size_t k = 0; k < noise.channels.size(); ++k) {
      const Channel channel(noise, k, first, size);
      channel.read(noisy, z);
      channel.read(estimate, p);
      channel.clip(z);
      channel.expect(p);
      for (std::size_t i = 0; i < size; ++i) residual.at(k, first + i) = z[i] - p[i];
    }
  });
}

void blend_share_within(const Values& estimate, const BlendNoise& noise, const Range& samples, const Layout<float>& share) {
  each_run(samples, [&](std::size_t first, std::size_t size) {
    Run p, within;
    for (std::size_t k = 0; k < noise.channels.size(); ++k) {
      const Channel channel(noise, k, first, size);
      channel.read(estimate, p);
      channel.share_within(p, within);
      for (std::size_t i = 0; i < size; ++i) share.at(k, first + i) = within[i];
    }
  });
}

}  // namespace beltrami::patches::BELTRAMI_VARIANT
