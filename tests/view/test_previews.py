"""Previews of the live view, and the controls and commands that stand for settings."""

import shlex
from dataclasses import replace
from types import SimpleNamespace

import click
import numpy as np
import pytest

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import smooth, view
from beltrami_cli.fields import override
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.files.access import DEFAULT_ACCESS
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.jobs.job import PLAIN_JOB
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smoothing import Smoothing
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.surface.records import ColouredVertices
from beltrami_cli.view.light import displayed_colours, displayed_pixels
from beltrami_cli.view.live.controls import plain_settings, settings_from, values_of
from beltrami_cli.view.live.layer_view import LayerView
from beltrami_cli.view.live.previews import Focus, obstacle_to, previewer_of
from beltrami_cli.view.pages.models import ModelWriter
from cli.commands import SAMPLES
from cli.pictures import encode
from small_models import textured_squares


def parsed(words):
    """Return the settings that `smooth` makes of options."""
    with smooth.smooth.make_context("smooth", ["in", "out", *words]) as context, context:
        assert click.get_current_context() is context
        return options.settings_from(context.params)


@pytest.mark.parametrize(
    "words",
    [
        "", "-n 5 -t 2.4 --beta 7.5", "--preset paper --beta 3", "--preset paper -n 4",
        "--strength gentle --patches off --window 9", "--noise shot:0.01,read:0.005 --beta 3", "--level -n 3",
        "--slots baseColor,normal --gutter keep --space linear --fast",
        "--material 'a b' --material c --metric-channels none --channels r,g",
        "--guide normal --guide-beta 3.0 --smooth-geometry --texture-format png",
    ],
)  # fmt: skip
def test_the_command_gives_the_settings_that_it_was_made_of(words):
    settings, preset = parsed(shlex.split(words)), "paper" if "paper" in words else None
    assert parsed(view.words_of(settings, preset)) == settings
    assert settings_from(plain_settings(settings), values_of(settings)) == settings


def test_controls_that_are_let_go_are_chosen_again():
    plain = plain_settings(parsed(["-n", "5", "--beta", "3"]))
    assert settings_from(plain, {"slots": ["baseColor"]}) == DEFAULTS


def test_moved_vertices_go_back_on_every_page():
    vertices = ColouredVertices(
        np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.float32), ("red", "green", "blue"),
        "srgb", "uint8",
    )  # fmt: skip
    still, moved = (
        SimpleNamespace(
            kind="mesh",
            slots=tuple,
            has_vertex_colours=lambda: True,
            coloured_vertices=lambda shown=shown: shown,
        )
        for shown in (vertices, replace(vertices, positions=vertices.positions + 0.1))
    )
    layer = LayerView(still, None, ModelWriter(is_live=True))
    layer.whole(moved)
    for _ in range(2):  # two pages
        (update,) = layer.whole(still)
        assert "places" in update


def middle(kind, document):
    """Return a focus on the middle from the front, or on the middle of an image."""
    if kind == "image":
        return Focus(np.array([0.5, 0.5, 0.0]))
    positions = document.coloured_vertices().positions if kind is None else document.textured(kind).positions
    low, high = positions.min(axis=0), positions.max(axis=0)
    return Focus((low + high) / 2 + [0, 0, 3 * (high - low).max()], np.array([0.0, 0, -1]))


@pytest.fixture
def inputs(tmp_path):
    """Files that change the surface: heights for an image; and others."""
    shown = read_image((SAMPLES / "scan-noisy.jpg").read_bytes(), "").pixels
    heights = np.add.outer(np.arange(shown.shape[0]), np.arange(shown.shape[1])) % 97 * 600
    (tmp_path / "heights.png").write_bytes(encode(heights.astype(np.uint16)[..., None], "png"))
    (tmp_path / "square.png").write_bytes(encode(shown, "png"))
    textured_squares(tmp_path / "square.obj", ("square.png", 0, (0, 1)))
    rows, columns = np.indices((90, 110))
    colours = np.random.default_rng(1).integers(80, 120, (90, 110, 3))
    np.savez(
        tmp_path / "grid.npz",
        positions=np.stack([columns, rows, rows * columns / 3e3], axis=2),
        colours=colours,
    )
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "slot", "budget", "more"),
    [
        ("knot-noisy.ply", None, 2000, {}),
        ("knot-noisy.ply", None, 2000, {"smooth_geometry": True, "patches": "off"}),
        ("head-tex-noisy.glb", "baseColor", 20_000, {}),
        ("torus-two-noisy.gltf", "baseColor", 20_000, {}),
        ("{}/square.obj", "baseColor", 20_000, {}),  # whose triangles have 130,000 texels each
        ("scan-noisy.jpg", "image", 40_000, {}),
        ("scan-noisy.jpg", "image", 40_000, {"height": "{}/heights.png"}),
        ("{}/grid.npz", None, 2000, {}),
    ],
)
def test_most_of_a_preview_is_what_the_whole_becomes(inputs, name, slot, budget, more):
    texts = {key: value.format(inputs) for key, value in more.items() if key == "height"}
    kernel = KernelParameters(iterations=2, t=1.0, beta=8.0, metric_steps=1)
    settings = override(replace(DEFAULTS, kernel=kernel), **{**more, **texts})
    document = open_input(str(SAMPLES / name.format(inputs)), settings, DEFAULT_ACCESS)
    previewer = previewer_of(document, None if slot == "image" else slot)
    updates = previewer.smooth(settings, middle(slot, document), budget, None)
    assert budget / 4 < sum(len(update.rows) for update in updates) < 2 * budget
    whole, *_ = recolour_in_memory(document, settings, Smoothing.of(settings), PLAIN_JOB)
    for update in updates:
        if slot is None:
            expected, one = displayed_colours(whole.coloured_vertices())[update.rows], 257
        else:
            data = whole.data if slot == "image" else whole.textured(slot).textures[update.texture].data
            expected, one = displayed_pixels(read_image(data, name))[update.rows, update.columns], 1
        off = np.abs(update.colours.astype(int) - expected).max(axis=1) / one
        # JPEG stores less than the page shows; the outermost samples lack what lies beyond. Where vertices move, the
        # noise of normals is estimated on the part.
        assert np.mean(off <= (4 if slot == "image" else 1)) > (
            0.5 if settings.embedding.smooth_geometry else 0.7
        )
        assert (update.positions is not None) == settings.embedding.smooth_geometry
        if update.positions is not None:
            before, after = (each.coloured_vertices().positions[update.rows] for each in (document, whole))
            moves = np.linalg.norm(after - before, axis=1)
            assert np.median(np.linalg.norm(update.positions - after, axis=1)) < 0.4 * np.median(moves)


@pytest.mark.parametrize(
    ("slot", "changed", "obstacle"),
    [
        ("baseColor", {}, ""),
        (None, {}, "not smoothed"),
        ("baseColor", {"iterations": 0}, "no iteration"),
        ("baseColor", {"level_seams": True}, "levelled over the whole"),
        ("baseColor", {"guides": ("normal",)}, "guides are read"),
    ],
)
def test_a_part_that_cannot_be_smoothed_alone_has_no_preview(slot, changed, obstacle):
    document = open_input(str(SAMPLES / "head-tex-noisy.glb"), DEFAULTS, DEFAULT_ACCESS)
    settings = override(DEFAULTS, **changed)
    reason = obstacle_to(settings, select(document, settings), slot)
    assert obstacle in reason
    assert bool(reason) == bool(obstacle)
