"""How much is lost where parameters are chosen from the data, against parameters tuned on the truth.

``python benchmarks/bench_tuning.py`` prints the table of docs/tuning.md. Textured models in the folder that the
environment variable BELTRAMI_EXTRA_MESHES names are judged, too; of large textures blocks are, for time. Noise is
Gaussian, rounded to 8 bit, and cut off at 0 and 255.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass

import numpy as np
import tuning_scene
from bench_textures import scenes

SIGMAS = (5, 10, 20, 40)
CONTRASTS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
GROWTHS = (1.0, 1.5, 2.5, 4.0)
GUIDED = (0, 1, 2, 3)
PLAIN = 8  # iterations without the regularised metric, at most
MEAN, WORST = 0.2, 0.7  # dB that may be lost


@dataclass(frozen=True)
class Loss:
    """PSNR of a scene: with noise, by the fixed rule, as chosen, and tuned on the truth."""

    name: str
    sigma: int
    noisy: float
    fixed: float
    chosen: float
    tuned: float
    how: str

    @property
    def lost(self):
        """Decibels lost by choosing; never below 0, for what was chosen could have been found by tuning."""
        return max(0.0, self.tuned - self.chosen)


def main():
    """Judge all scenes; print a table for each kind."""
    parser = argparse.ArgumentParser(description="Judge the choice of parameters.")
    parser.add_argument("--sigma", type=int, nargs="+", default=SIGMAS, help="of the noise, of 255")
    parser.add_argument("--most", type=int, default=30_000, help="texels to look at (default: 30000)")
    parser.add_argument("--only", default="", help="names that begin so")
    options = parser.parse_args()
    met = True
    kinds = {
        "vertex colours": list(tuning_scene.vertices()),
        "textures": tuning_scene.textures(scenes(False), options.most),
    }
    for kind, found in kinds.items():
        rows = [
            judge(scene, sigma)
            for scene in found
            if scene.name.startswith(options.only)
            for sigma in options.sigma
        ]
        met = show(kind, rows) and met
    sys.exit(0 if met else 1)


def judge(scene, sigma):
    """Measure one scene with noise of `sigma` of 255."""
    noise = sigma / 255
    noisy = scene.noisy(noise)
    steps = tuning_scene.Steps(scene, noisy)
    tuned, how = tune(steps, scene, noise)
    reached, plan = tuning_scene.chosen(scene, noisy)
    by_rule, _ = tuning_scene.chosen(scene, noisy, fast=True)
    row = Loss(
        scene.name.split("-clean")[0].split(".")[0],
        sigma,
        tuning_scene.psnr(noisy, scene.clean),
        by_rule,
        reached,
        tuned,
        how,
    )
    if os.isatty(2) or os.environ.get("BELTRAMI_BENCH_LOG"):
        used = plan.parameters
        mine = f"c {plan.beta * noise:.2f}, G {used.beta_growth:g}, t {used.t:g}"
        mine += f", K {used.metric_steps}, n {used.iterations}"
        print(
            row,
            mine,
            [round(float(255 * s), 1) for s in plan.manifold.noise.sigma],
            file=sys.stderr,
            flush=True,
        )
    return row


def tune(steps, scene, noise):
    """Return the best PSNR of a descent over the parameters, one after the other, and what it was reached with."""
    best, place = steps.score(steps.start), (scene.starts[0], 1.5, scene.starts[1], 1)
    how, known, before = "no iterations", {}, None
    while before != place:
        before = place
        for axis, values in ((0, CONTRASTS), (1, GROWTHS), (3, GUIDED), (2, scene.steps)):
            for value in values:
                tried = (*place[:axis], value, *place[axis + 1 :])
                if tried not in known:
                    known[tried] = walk(steps, noise, *tried)
            place = max(
                ((*place[:axis], value, *place[axis + 1 :]) for value in values), key=lambda p: known[p][0]
            )
    if known[place][0] > best:
        best = known[place][0]
        how = "c {:g}, G {:g}, t {:g}, K {}".format(*place) + f", P {known[place][1]}"
    return best, how


def walk(steps, noise, contrast, growth, t, guided):
    """Return the best PSNR over numbers of plain iterations, and that number."""
    state, scores = steps.start, []
    for iteration in range(guided + PLAIN):
        if iteration >= guided:
            scores.append(steps.score(state))
            if len(scores) > 3 and max(scores[-3:]) < max(scores):
                break
        beta = contrast / noise * growth**iteration
        state = steps.step(state, beta, t, regularised=iteration < guided)
    return max(scores), int(np.argmax(scores))


def show(kind, rows):
    """Print the rows as a table in Markdown; return whether the bar is reached."""
    print(f"\n### {kind.capitalize()}\n")
    print("| | sigma | noisy | `--fast` | chosen | tuned on the truth | lost |\n| --- " + "| ---: " * 6 + "|")
    for row in rows:
        values = " | ".join(
            f"{value:.2f}" for value in (row.noisy, row.fixed, row.chosen, row.tuned, row.lost)
        )
        print(f"| {row.name} | {row.sigma} | {values} |")
    lost, fixed = np.array([row.lost for row in rows]), np.array([row.tuned - row.fixed for row in rows])
    if not len(lost):
        return True
    print(
        f"\nLost by choosing: {lost.mean():.2f} dB on average, {lost.max():.2f} at worst; by the fixed rule of "
        f"`--fast`: {fixed.mean():.2f} and {fixed.max():.2f}.",
        flush=True,
    )
    return lost.mean() <= MEAN and lost.max() <= WORST


if __name__ == "__main__":
    main()
