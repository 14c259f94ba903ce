"""Layers are immutable: what one of their methods returns does not depend on what was called before."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from beltrami_cli import KernelParameters, SmoothSettings
from beltrami_cli.errors import UsageError
from beltrami_cli.flow import estimation, plan
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.formats.files.access import DEFAULT_ACCESS
from beltrami_cli.jobs.inspect import describe_exposure
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.smoothing import smooth_layer, unsmoothed
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import LevelSettings
from cli.commands import SAMPLES
from cli.pictures import encode

GIVEN = SmoothSettings(kernel=KernelParameters(iterations=1, t=1.0, beta=8.0))
NAMES = ["knot-noisy.ply", "mirrored-noisy.obj", "picture.png", "grid.npz", "points.npz"]


def unchanged(layer):
    """Return the colours that a layer has, as its `encode` takes them."""
    kernel = unsmoothed(layer.settings.kernel)
    still = replace(layer, settings=replace(layer.settings, kernel=kernel))
    return smooth_in_place(still.normalised().plan()).manifold.new_colours()


@pytest.fixture
def layer(request, tmp_path):
    random = np.random.default_rng(2)
    colours = random.integers(80, 120, (24, 30, 3)).astype(np.uint8)
    (tmp_path / "picture.png").write_bytes(encode(colours, "png"))
    places = np.dstack([*np.mgrid[:24, :30], random.random((24, 30))])
    np.savez(tmp_path / "grid.npz", positions=places, colours=colours)
    np.savez(tmp_path / "points.npz", points=places.reshape(-1, 3), point_colours=colours.reshape(-1, 3))
    path = next(path for path in (tmp_path / request.param, SAMPLES / request.param) if path.exists())
    document = open_input(str(path), GIVEN, DEFAULT_ACCESS)
    (only,) = select(document, GIVEN).layers()
    return only


def is_equal(one, other):
    """Whether two results of `encode` are the same to the last bit."""
    assert one.images.keys() == other.images.keys()
    if one.colours is not None:
        return np.array_equal(one.colours, other.colours)
    return all(image.data == other.images[key].data for key, image in one.images.items())


@pytest.mark.slow
@pytest.mark.parametrize("layer", NAMES, indirect=True)
def test_the_order_of_calls_makes_no_difference(layer):
    first = smooth_layer(layer)
    facts = layer.normalised().describe()
    again = smooth_layer(layer)
    assert first.report == again.report
    assert is_equal(first.stored, again.stored)
    assert layer.normalised().describe() == facts
    with pytest.raises(FrozenInstanceError):
        layer.settings = None


@pytest.mark.slow
@pytest.mark.parametrize("layer", ["mirrored-noisy.obj", "points.npz"], indirect=True)
def test_levelling_leaves_the_layer_as_it_was(layer):
    before = smooth_layer(layer)
    if layer.part == "vertices":
        photographs = (layer.vertices.positions[:, 0] > 0).astype(np.int64)
        layer = replace(layer, photographs_of=lambda _: photographs)
    other = layer.levelled(LevelSettings())
    assert layer.level_report is None
    assert other.level_report is not None
    darker = replace(other, levelled_colours=unchanged(layer).table() * np.float32(0.9))
    assert not is_equal(smooth_layer(darker).stored, before.stored)
    assert describe_exposure(darker) == describe_exposure(darker)
    assert is_equal(smooth_layer(layer).stored, before.stored)


@pytest.mark.parametrize("layer", NAMES, indirect=True)
def test_a_layer_is_levelled_before_and_planned_after_it_is_normalised(layer):
    with pytest.raises(AssertionError, match="normalised"):
        layer.plan()
    assert layer.normalised().normalised().unit > 0
    with pytest.raises((AssertionError, UsageError), match=r"as stored|no charts"):
        layer.normalised().levelled(LevelSettings())


@pytest.mark.parametrize("layer", NAMES, indirect=True)
def test_unchanged_colours_change_nothing(layer):
    assert layer.encode(unchanged(layer), is_smoothed=False).change.largest == 0


@pytest.mark.parametrize("layer", ["grid.npz", "picture.png"], indirect=True)
def test_a_layer_without_charts_is_described_without_exposure(layer):
    with pytest.raises(UsageError, match="no charts"):
        layer.levelled(LevelSettings())
    assert describe_exposure(layer) is None


@pytest.mark.parametrize("layer", ["picture.png", "grid.npz", "points.npz"], indirect=True)
def test_colours_stay_that_smoothing_would_make_worse(layer, monkeypatch):
    """The noise is estimated once; parameters are those that were chosen."""
    tune, estimate, estimates = plan.tune, estimation.estimate_noise, []

    def pessimistic(*arguments, **options):
        chosen, choice = tune(*arguments, **options)
        return replace(chosen, iterations=3), replace(choice, gain=-1.0)

    def counted(*arguments, **options):
        estimates.append(arguments)
        return estimate(*arguments, **options)

    monkeypatch.setattr(plan, "tune", pessimistic)
    monkeypatch.setattr(estimation, "estimate_noise", counted)
    done = smooth_layer(replace(layer, settings=SmoothSettings()))
    assert done.stored.change.largest == 0
    assert done.report.iterations == 0
    assert done.choice.gain == -1
    assert any("so they stay" in warning for warning in done.warnings)
    assert len(estimates) == 1
