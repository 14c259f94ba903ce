"""Removal of exposure steps between charts of textures, or between vertices of different photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.layers.reports import LevelReport
from beltrami_cli.layers.settings import LevelSettings
from beltrami_cli.levelling.correction import Levelled, level_canvas_in_place, level_mesh
from beltrami_cli.levelling.judgement import CONFIDENCE, Verdict
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas
from beltrami_cli.surface.records import SampledSurface, Texture

_PHOTOGRAPHS = ("photograph", "photo", "image", "camera", "view")
_NO_SEAMS = "no seam joins two of its charts"
_NO_STEPS = "hardly any of its seams has a step beyond the noise"
_INVISIBLE_CHANGE = "the change would be too small to be seen"


@dataclass(frozen=True)
class _Chart:
    number: int
    names: tuple[str, ...] = ()  # of its texture and materials
    place: dict[str, object] = field(default_factory=dict)  # for reports


def level_charts(
    what: str, planes: Float32s, atlas: Atlas, textures: Sequence[Texture], images: Sequence[DecodedImage],
    wanted: LevelSettings, spans: Sequence[int],
) -> LevelReport:  # fmt: skip
    """Remove exposure steps from colours on a canvas, in place; `spans` as in `level_canvas_in_place`."""
    charts = _charts_of(atlas, textures, images)
    fixed = (
        _reference(charts, max(1, atlas.charts), wanted.reference_charts) if wanted.reference_charts else None
    )
    levelled, change = level_canvas_in_place(atlas, planes, wanted.exposure_strength, fixed, spans)
    return _report(what, levelled, change, charts)


def level_photographs(
    what: str, surface: SampledSurface, photograph_of: Int64s, wanted: LevelSettings
) -> tuple[Float32s, LevelReport]:
    """Return the colours of samples without exposure steps between the photographs they come from."""
    if wanted.reference_charts:
        raise UsageError("--reference-charts is of charts of textures; parts of vertex colours have no names")
    mesh = surface.positions, surface.all_faces
    levelled, change, colours = level_mesh(*mesh, surface.colours, photograph_of, wanted.exposure_strength)
    return colours, _report(what, levelled, change, [_Chart(part) for part in range(len(levelled.groups))])


def _charts_of(atlas: Atlas, textures: Sequence[Texture], images: Sequence[DecodedImage]) -> list[_Chart]:
    """Return the charts with texels, each with the place of one of these and their number."""
    areas = np.bincount(atlas.chart_of, minlength=max(1, atlas.charts))
    texel, charts = np.zeros(len(areas), np.int64), list[_Chart]()
    for block in large_arrays.blocks(len(atlas.chart_of)):
        texel[atlas.chart_of[block]] = atlas.owned_texels[block]
    texture_of = atlas.texture_of(texel)
    for chart in np.flatnonzero(areas).tolist():
        index = int(texture_of[chart])
        of_texture = int(texel[chart] - atlas.texture_offsets[index])
        row, column = divmod(of_texture, images[index].pixels.shape[1])
        names = textures[index].name, *textures[index].materials
        place = {"texture": names[0], "column": column, "row": row, "samples": int(areas[chart])}
        charts.append(_Chart(chart, names, place))
    return charts


def _reference(charts: Sequence[_Chart], count: int, wanted: Sequence[str]) -> Bools:
    """Return which charts stay as they are, shape (count,), by their numbers, textures or materials."""
    is_reference = np.zeros(count, bool)
    for word in wanted:
        fits = [chart.number for chart in charts if any(fnmatch(name, word) for name in chart.names)]
        if word.isdecimal() and int(word) < count:
            fits = [int(word)]
        if not fits:
            names = ", ".join(dict.fromkeys(chart.names[0] for chart in charts))
            raise UsageError(
                f"--reference-charts {word} is neither one of the charts 0 to {count - 1} nor a texture or material; "
                f"there are {names}"
            )
        is_reference[fits] = True
    if all(is_reference[chart.number] for chart in charts):
        raise UsageError(
            f"--reference-charts {' '.join(wanted)} keeps all charts as they are, so none is levelled"
        )
    return is_reference


def _report(what: str, levelled: Levelled, change: float, charts: Sequence[_Chart]) -> LevelReport:
    facts, verdict = levelled.facts, levelled.verdict
    reason = "" if change else _INVISIBLE_CHANGE
    if verdict is None:
        reason = _NO_STEPS if facts.seams else _NO_SEAMS
    elif levelled.exposures is None:
        reason = _refusal_reason(verdict)
    exposures = []
    if levelled.exposures is not None:
        terms = np.round(levelled.exposures.terms, 5)
        for each in charts:
            of_chart = terms[:, each.number]
            if of_chart.any():
                pair = {"gain": (1 + of_chart[:, 0]).tolist(), "offset": of_chart[:, 1].tolist()}
                exposures.append({"chart": each.number, **each.place, **pair})
    return LevelReport(
        what=what, charts=len(charts), seams=facts.seams, stepped=facts.stepped, painted=facts.edges,
        before=facts.before, after=facts.after if change else facts.before,
        explained=0.0 if verdict is None else verdict.share,
        tilted=verdict is not None and len(verdict.spread) > 2, levelled=change > 0, reason=reason,
        exposures=exposures,
    )  # fmt: skip


def _refusal_reason(verdict: Verdict) -> str:
    share = f"{100 * verdict.share:.0f} %"
    explained = f"one exposure per chart explains {share} of the steps"
    if verdict.confidence >= CONFIDENCE:
        return f"{explained}, but they are edges of colour: the pattern does not continue across the seams"
    if verdict.is_flat and verdict.share > 0:
        return f"{explained}, which could be edges of colour: no pattern crosses the seams"
    return f"the seam steps do not agree with one exposure per chart, which explains {share} of them"


def photographs_of(document: Document, wanted: str | None = None) -> Int64s:
    """Return the number of the photograph of each vertex, shape (V,); InputError if the file has none."""
    known = {name.lower(): name for name in document.attributes()}
    words = [wanted] if wanted else [*_PHOTOGRAPHS, *(f"{name}_id" for name in _PHOTOGRAPHS)]
    name = next((known[word.lower()] for word in words if word.lower() in known), None)
    if name is None:
        has = ", ".join(document.attributes()) or "none"
        cause = (
            "nothing says which photograph each of its vertex colours is from, so there are no seams to level"
        )
        if wanted:
            cause = f"its vertices have no attribute {wanted} that says which photograph each is from"
        remedy = f"name one with --photographs of `beltrami level`; its attributes: {has}"
        raise InputError(document.name, cause, remedy)
    values = document.attribute(name)
    numbers = np.unique(values, axis=0, return_inverse=True)[1]
    return np.asarray(numbers.reshape(-1), np.int64)
