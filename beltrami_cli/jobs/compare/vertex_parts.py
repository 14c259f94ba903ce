"""The vertex colours of two files of one model."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Float64s, Indices, Int32s
from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.jobs.compare.measured import ComparedPart, Pair, opacities_differ
from beltrami_cli.jobs.compare.same_model import Documents, require_one_model
from beltrami_cli.layers.channels import choose_channels
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.colour_values import to_space
from beltrami_cli.surface.geometry import vertex_areas
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.points import with_surface
from beltrami_cli.surface.records import ColouredVertices


def compare_vertices(
    documents: Documents, settings: SmoothSettings, weights: Weights, *, is_extra: bool
) -> list[ComparedPart]:
    """Match the vertex colours of two models, which are one part; `is_extra`: textures are compared, too."""
    one, other = _on_one_scale(*(document.coloured_vertices() for document in documents))
    require_one_model(documents, (one, other))
    rows = np.intersect1d(one.coloured_rows(), other.coloured_rows())
    channels, space = choose_channels(one.channels, settings, "the colours have").changing, settings.space

    def read(vertices: Indices) -> Pair:
        first, second = (
            to_space(each.colours[vertices][:, channels], each.encoding, space) for each in (one, other)
        )
        return first, second

    reference, test = read(rows)
    if not np.isfinite(test).all():
        cause = "some of its colours are not finite numbers, which cannot be compared"
        raise InputError(documents[1].name, cause)
    place, _ = group_places(one.positions[rows], None if one.space_of is None else one.space_of[rows])
    split = np.bincount(place)[place] > 1 if len(place) else np.zeros(0, bool)
    opacities = (None if each.kind == "volume" else each.contents().alpha for each in documents)
    part = ComparedPart(
        name="vertex colours", kind="vertices", index=rows, read=read, space=space,
        weights=_vertex_areas(one, rows, settings) if weights == "area" else None,
        near_seams=split if split.any() else None,
        jumps=_vertex_jumps([reference, test], place) if split.any() else None,
        is_identical=is_extra and np.array_equal(reference, test),
        other_opacity=opacities_differ(*opacities),
    )  # fmt: skip
    return [part]


def _on_one_scale(
    one: ColouredVertices, other: ColouredVertices
) -> tuple[ColouredVertices, ColouredVertices]:
    """Return colours of one full scale, since a smoothed file may fit into fewer bits."""
    scales = np.array([one.full_scale, other.full_scale])
    if one.stored != other.stored or scales[0] == scales[1] or scales.min() <= 1:
        return one, other
    shares = (scales / scales.max()).astype(np.float32)
    first, second = (
        dataclasses.replace(each, colours=each.colours * share)
        for each, share in zip((one, other), shares, strict=True)
    )
    return first, second


def _vertex_areas(vertices: ColouredVertices, rows: NDArray[np.intp], settings: SmoothSettings) -> Float64s:
    """Return the part of the surface area that belongs to each vertex or point."""
    if len(vertices.faces):
        return vertex_areas(vertices.positions, vertices.faces)[rows].astype(np.float64)
    surface = with_surface(vertices.only(rows), settings.kernel.thread_count)
    return vertex_areas(surface.positions, surface.faces).astype(np.float64)


def _vertex_jumps(colours: list[Float32s], place: Int32s) -> tuple[Float64s, Float64s]:
    """Return the range of the colours of vertices at one place, as the mean over channels."""
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.r_[True, place[order][1:] != place[order][:-1]])
    several = np.diff(np.r_[starts, len(order)]) > 1
    reference, test = (
        (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).mean(axis=1)
        for values in colours
    )
    return reference[several].astype(np.float64), test[several].astype(np.float64)
