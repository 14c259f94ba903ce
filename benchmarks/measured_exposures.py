"""Scenes of known exposures, and bounds of the result of levelling them."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
from scene import ROOT  # noqa: F401  # which puts the tests on the path
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from beltrami_cli.flow.manifolds.canvas import painted
from beltrami_cli.levelling.steps import ChartPlaces, deviations, steps_over_seams
from levelling.exposure_scene import ExposureScene


class MeasuredScene(ExposureScene):
    """A scene that knows its exposures and its paint."""

    def restored(self, seed, *, fall_off=False, clipped=False, shown=None):
        """Take the true exposures out of colours, by default the exposed ones."""
        truth, exposed = self.exposed(seed, fall_off=fall_off, clipped=clipped)
        exposed = exposed if shown is None else shown
        _, expose = self.exposures(seed, fall_off=fall_off, clipped=clipped)
        offset = expose(0 * truth)
        return (exposed - offset) / (expose(1 + 0 * truth) - offset)

    def informed(self, seed, *, without_paint, **kind):
        """Level exposed colours with the knowledge of which stretches of seams are painted.

        Or without paint and noise at seams, which shows what exposures and the layout of seams allow.
        """
        truth, exposed = self.exposed(seed, **kind)
        _, expose = self.exposures(seed, **kind)
        true, shown = self.steps(truth), self.steps(exposed)
        if without_paint:
            middle, none = true.colours.mean(axis=1), np.zeros(true.low.shape, bool)
            sides = [expose(middle, true.ends[:, side], true.places[:, side]) for side in (0, 1)]
            steps = replace(true, colours=np.stack(sides, axis=1), low=none, high=none)
        else:
            paint = np.sqrt(np.mean(np.square(np.diff(true.colours, axis=1)), axis=(1, 2)))
            steps = shown.part(paint < 2.5 * deviations(true, true.colours) + 3 / 255)
        with patch("beltrami_cli.levelling.correction.steps_over_seams", return_value=steps):
            return self.levelled(exposed)[0]

    def steps(self, colours):
        """Return the steps of colours of all texels over seams."""
        atlas = self.samples.atlas
        return steps_over_seams(atlas, painted(atlas, colours.astype(np.float32)), ChartPlaces.of(atlas))

    def joined(self):
        """Return which texels are of charts that seams without steps join, as numbers of groups."""
        atlas, steps = self.samples.atlas, self.steps(self.truth)
        signs = np.where(steps.ends[:, 0] < steps.ends[:, 1], 1, -1)[:, None]
        step = signs * (steps.colours[:, 1] - steps.colours[:, 0])
        pairs = []
        for seam in np.unique(steps.seams):
            rows = steps.seams == seam
            if steps.counts[rows].sum() >= 16 and np.abs(np.median(step[rows], axis=0)).max() < 6 / 255:
                pairs.append(steps.ends[rows][0])
        ends = np.array(pairs, int).reshape(-1, 2)
        graph = coo_array((np.ones(len(ends)), ends.T), shape=(atlas.charts,) * 2)
        return connected_components(graph, directed=False)[1][self.charts]
