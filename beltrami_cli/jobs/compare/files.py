"""Compare the colours of two files, and hold the difference to limits."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.formats.registry import kind_of
from beltrami_cli.jobs.compare.limits import Limits, Verdict, judge
from beltrami_cli.jobs.compare.map import draw_images, draw_vertices, require_map
from beltrami_cli.jobs.compare.paired_colours import figures
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import choose_work
from beltrami_cli.samples.settings.level_set import LevelSetSettings
from beltrami_cli.samples.settings.smooth import DEFAULTS

if TYPE_CHECKING:
    from beltrami_cli.flow.parameters import Weights
    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.jobs.compare.paired_colours import PairedColours
    from beltrami_cli.samples.settings.smooth import SmoothSettings

_UNLIMITED = Limits()


@dataclass(frozen=True)
class Comparison:
    """How two files differ; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    reference, test : str
        The files.
    weights, space : str
        What a sample counts, and what colours were taken as.
    parts : list of dict
        The figures of each texture, of the image, or of the vertices; see `figures`, and "name" and "kind".
    overall : dict
        Those of all parts together.
    limits : list of Verdict
        How each part keeps to each limit.
    passed : bool
        Whether all do.
    map_scale : float or None
        The Delta E that the brightest colour of the map stands for.
    notices : list of str
        What the user should know, one sentence each.
    """

    reference: str
    test: str
    weights: str
    space: str
    parts: list[dict[str, Any]]
    overall: dict[str, Any]
    limits: list[Verdict]
    passed: bool
    map_scale: float | None
    notices: list[str]


@dataclass
class _Paired:
    """What was found of two files: parts, the sizes of images or the model of vertices, and notices."""

    images: list[tuple[PairedColours, tuple[int, int]]]
    vertices: tuple[PairedColours, Document] | None
    notices: list[str]

    @property
    def parts(self) -> list[PairedColours]:
        return [*([self.vertices[0]] if self.vertices else []), *(pair for pair, _ in self.images)]

    def map(self, target: str) -> tuple[Written, float]:
        if self.vertices and (not self.images or target.lower().endswith(".ply")):
            return draw_vertices(*self.vertices, target)
        return draw_images(self.images, target)


def compare_files(
    reference: str | os.PathLike[str],
    test: str | os.PathLike[str],
    limits: Limits = _UNLIMITED,
    settings: SmoothSettings = DEFAULTS,
    *,
    weights: Weights = "uniform",
    map_to: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    access: Access = EVERYTHING_INSIDE,
) -> Comparison:
    """Compare the colours of two files of one model, or of two images.

    Parameters
    ----------
    reference, test : path
        What `smooth_file` reads; one may be "-".
    limits : Limits
        What each part is held to.
    settings : SmoothSettings
        Which colours, and the space that they are compared in; the kernel has no meaning.
    weights : {"uniform", "area"}
        Whether each sample counts once, or by its area on the surface.
    map_to : path, optional
        Where to draw the differences: .png, or .ply for vertices.
    overwrite : bool
        Whether an existing map may be replaced.
    access : Access
        What may be read.

    Returns
    -------
    Comparison

    Raises
    ------
    UsageError
        If settings contradict each other or the files.
    InputError
        If a file cannot be read, the two are not alike in anything but colours, or a limit cannot be measured.
    OutputError
        If the map cannot be written.
    """
    names = os.fspath(reference), os.fspath(test)
    if names == ("-", "-"):
        raise UsageError("only one of REFERENCE and TEST can be standard input")
    target = None if map_to is None else os.fspath(map_to)
    output = None
    if target is not None:
        require_map(target)
        output = Output(target, overwrite=overwrite, what="map", reads=names)
        output.files.guard(settings.files_besides())
        access = output.files.watching(access)
    paired = _pair(names, settings, weights, access)
    _require_samples(paired.parts, _shown(names[0]))
    parts = [{"name": pair.name, "kind": pair.kind, **figures([pair])} for pair in paired.parts]
    verdicts, untested = judge(parts, limits, _shown(names[1]))
    scale = None
    if output is not None and target is not None:
        written, scale = paired.map(target)
        output.write(written)
    return Comparison(
        *names,
        weights,
        settings.space,
        parts,
        figures(paired.parts),
        verdicts,
        all(verdict.kept for verdict in verdicts),
        scale,
        [*paired.notices, *_left_out(paired.parts), *untested],
    )


def _require_samples(parts: list[PairedColours], name: str) -> None:
    """Raise InputError if nothing can be compared, or what counts by its area has none."""
    if not sum(len(pair.reference) for pair in parts):
        raise InputError(
            name,
            "nothing of it can be compared: no texel that the surface covers, or no pixel, can be seen",
            "choose something else with --on, --slots or --mask",
        )
    for pair in parts:
        if len(pair.weights) and not pair.weights.sum() > 0:
            cause = f"{pair.name}: the surface has no area that samples could stand for"
            raise InputError(name, cause, "use --weights uniform")


def _left_out(parts: list[PairedColours]) -> list[str]:
    """Say of which parts nothing is compared."""
    return [
        f"{pair.name} is not compared, because no texel of it is both covered by the surface and visible"
        for pair in parts
        if not len(pair.reference)
    ]


def _pair(names: tuple[str, str], settings: SmoothSettings, weights: Weights, access: Access) -> _Paired:
    data = read_source(names[0], access), read_source(names[1], access)
    shown = _shown(names[0]), _shown(names[1])
    images = [is_image(each, name) for each, name in zip(data, names, strict=True)]
    if images[0] != images[1]:
        kinds = ["an image" if image else "a model" for image in images]
        raise InputError(
            shown[1], f"it is {kinds[1]}, but {shown[0]} is {kinds[0]}", "compare two files of one kind"
        )
    if images[0]:
        from beltrami_cli.jobs.compare.images import pair_images

        refuse_options_of_level_sets(settings, shown[0])
        return _Paired([pair_images(data, shown, settings, access)], None, [])
    return _pair_models(_open(names, data, settings, access), settings, weights, access)


def _shown(name: str) -> str:
    return "<stdin>" if name == "-" else name


def _open(
    names: tuple[str, str], data: tuple[bytes, bytes], settings: SmoothSettings, access: Access
) -> tuple[Document, Document]:
    """Open both; one may be a level set, and the other the mesh that was made of it."""
    volumes = [kind_of(each, name) == "volume" for each, name in zip(data, names, strict=True)]
    plain = dataclasses.replace(settings, level_set=LevelSetSettings()) if any(volumes) else settings
    one, other = (
        document_from(each, name, settings if volume else plain, access)
        for each, name, volume in zip(data, names, volumes, strict=True)
    )
    return one, other


def _pair_models(
    documents: tuple[Document, Document], settings: SmoothSettings, weights: Weights, access: Access
) -> _Paired:
    reference, test = documents
    work = choose_work(reference, settings)
    paired = _Paired([], None, [f"{reference.name}: {notice}" for notice in work.notices])
    if work.vertices:
        from beltrami_cli.jobs.compare.vertices import pair_vertices

        pair, notices = pair_vertices(reference, test, settings, weights)
        paired.vertices = pair, reference
        paired.notices += [f"{test.name}: {notice}" for notice in notices]
    for slot in work.slots:
        from beltrami_cli.jobs.compare.textures import pair_slot

        for document in documents:
            require_room_for_textures(document, work.slots, settings.textures, access)
        paired.images += pair_slot(reference, test, slot, settings, weights, access)
    return paired
