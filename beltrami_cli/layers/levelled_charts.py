"""Exposure steps between charts of textures, or parts of vertices by their photographs, taken out of colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture
from beltrami_cli.layers.layer import LevelReport
from beltrami_cli.layers.settings import LevelSettings
from beltrami_cli.levelling.correction import Levelled, level_canvas, level_mesh
from beltrami_cli.levelling.exposures import CONFIDENCE, Verdict
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas
from beltrami_cli.surface.records import SampledSurface, Texture

_PHOTOGRAPHS = ("photograph", "photo", "image", "camera", "view")
_NO_SEAMS = "no seam joins two of its charts"
_TOO_SMALL = "the change would be too small to be seen"


def level_charts(
    what: str, planes: Float32s, atlas: Atlas, charts: TextureCharts, wanted: LevelSettings, spans: Sequence[int]
) -> LevelReport:  # fmt: skip
    """Take exposure steps out of colours on a canvas, in place; `spans` as in `level_canvas`."""
    found, change = level_canvas(atlas, planes, wanted.strength, charts.matching(wanted.reference), spans)
    return _report(what, found, change, charts.facts())


def level_photographs(
    what: str, surface: SampledSurface, photograph_of: Int64s, wanted: LevelSettings
) -> tuple[Float32s, LevelReport]:
    """Return the colours of samples without exposure steps between the photographs that they are from."""
    if wanted.reference:
        raise UsageError("--reference is of charts of textures; parts of vertex colours have no names")
    mesh = surface.positions, surface.all_faces
    found, change, colours = level_mesh(*mesh, surface.colours, photograph_of, wanted.strength)
    return colours, _report(what, found, change, [{"chart": part} for part in range(len(found.groups))])


@dataclass(frozen=True)
class TextureCharts:
    """The charts of an atlas by the textures that they lie on."""

    textures: Sequence[Texture]
    pictures: Sequence[Picture]
    areas: Int64s  # (charts,): texels of each
    texture_of: Int64s  # (charts,): -1 where a chart owns no texel
    texel: Int64s  # (charts,): one of its texels, counted from the first of its texture

    @classmethod
    def of(cls, atlas: Atlas, textures: Sequence[Texture], pictures: Sequence[Picture]) -> TextureCharts:
        offsets, areas = atlas.texture_offsets, np.bincount(atlas.chart_of, minlength=max(1, atlas.charts))
        texel = np.zeros(len(areas), np.int64)
        for block in large_arrays.blocks(len(atlas.chart_of)):
            texel[atlas.chart_of[block]] = atlas.owned_texels[block]
        texture_of = np.searchsorted(offsets, texel, side="right") - 1
        texture_of, texel = np.where(areas > 0, texture_of, -1), texel - offsets[texture_of]
        return cls(textures, pictures, areas, texture_of, texel)

    def matching(self, wanted: Sequence[str]) -> Bools | None:
        """Return which charts are the reference, shape (charts,); None: none was asked for."""
        if not wanted:
            return None
        found = np.zeros(len(self.texture_of), bool)
        for word in wanted:
            if word.isdecimal() and int(word) < len(found):
                found[int(word)] = True
                continue
            fits = [
                index
                for index, texture in enumerate(self.textures)
                if any(fnmatch(name, word) for name in (texture.name, *texture.materials))
            ]
            if not fits:
                names = ", ".join(texture.name for texture in self.textures)
                raise UsageError(
                    f"--reference {word} is neither one of the charts 0 to {len(found) - 1} nor a texture or material; "
                    f"there are {names}"
                )
            found |= np.isin(self.texture_of, fits)
        if found[self.texture_of >= 0].all():
            raise UsageError(
                f"--reference {' '.join(wanted)} keeps all charts as they are, so none is levelled"
            )
        return found

    def facts(self) -> list[dict[str, object]]:
        """Return for each chart its number, its texture, a texel of it there, and how many it has."""
        found: list[dict[str, object]] = []
        for chart in np.flatnonzero(self.texture_of >= 0).tolist():
            index = int(self.texture_of[chart])
            row, column = divmod(int(self.texel[chart]), self.pictures[index].pixels.shape[1])
            place = {"texture": self.textures[index].name, "column": column, "row": row}
            found.append({"chart": chart, **place, "samples": int(self.areas[chart])})
        return found


def _report(what: str, found: Levelled, change: float, charts: Sequence[dict[str, object]]) -> LevelReport:
    facts, verdict = found.facts, found.verdict
    reason = "" if change else _TOO_SMALL
    if verdict is None:
        reason = _NO_SEAMS
    elif found.exposures is None:
        reason = _why_not(verdict)
    exposures = []
    if found.exposures is not None:
        terms = np.round(found.exposures.terms, 5)
        for each in charts:
            of_chart = terms[:, int(str(each["chart"]))]
            if of_chart.any():
                pair = {"gain": (1 + of_chart[:, 0]).tolist(), "offset": of_chart[:, 1].tolist()}
                exposures.append({**each, **pair})
    return LevelReport(
        what=what, charts=len(charts), seams=facts.seams, stepped=facts.stepped, painted=facts.painted,
        before=facts.before, after=facts.after if change else facts.before,
        explained=0.0 if verdict is None else verdict.share,
        tilted=verdict is not None and len(verdict.spread) > 2, levelled=change > 0, reason=reason,
        exposures=exposures,
    )  # fmt: skip


def _why_not(verdict: Verdict) -> str:
    share = f"{100 * verdict.share:.0f} %"
    explained = f"one exposure per chart explains {share} of the steps"
    if verdict.confidence >= CONFIDENCE:
        return f"{explained}, but they are paint: the pattern does not continue across the seams"
    if verdict.is_flat and verdict.share > 0:
        return f"{explained}, which could be paint: no pattern crosses the seams"
    return f"the seam steps do not agree with one exposure per chart, which explains {share} of them"


def photograph_attribute(document: Document, wanted: str | None = None) -> str | None:
    """Return the name of the attribute that numbers the photographs of vertices, if there is one."""
    known = {name.lower(): name for name in document.attributes()}
    words = [wanted] if wanted else [*_PHOTOGRAPHS, *(f"{name}_id" for name in _PHOTOGRAPHS)]
    return next((known[word.lower()] for word in words if word.lower() in known), None)


def photographs_of(document: Document, wanted: str | None = None) -> Int64s:
    """Return the number of the photograph of each vertex, shape (V,); InputError if the file does not say it."""
    name = photograph_attribute(document, wanted)
    if name is None:
        has = ", ".join(document.attributes()) or "none"
        cause = (
            "nothing says which photograph each of its vertex colours is from, so there are no seams to level"
        )
        if wanted:
            cause = f"its vertices have no attribute {wanted} that says which photograph each is from"
        raise InputError(document.name, cause, f"name one with --photographs; its attributes: {has}")
    values = document.attribute(name)
    found = np.unique(values, axis=0, return_inverse=True)[1]
    return np.asarray(found.reshape(-1), np.int64)
