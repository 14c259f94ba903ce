"""Smoothing a file, or only levelling it: the painter that does both, and the records of what was done."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override, require_effect
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.formats.registry import OutputFormat, write_mesh
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.progress import Label
from beltrami_cli.jobs.recolour import FileJob, FileReport, Painted, Painter, begin, paint, recolour
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.layer import (
    Change,
    ImageReport,
    Layer,
    LayerReport,
    LevelReport,
    Part,
    SlotReport,
    VertexReport,
    all_images,
)
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.settings import DEFAULTS, LevelSettings, SmoothSettings, describe_settings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.records import ImageFile, TexturedSurface

if TYPE_CHECKING:
    from beltrami_cli.jobs.new_texture import NewTexture

_USUAL_TICKS = 30  # while parameters are chosen


@dataclass(frozen=True, kw_only=True)
class Smoothed(Painted):
    """What smoothing makes of a layer."""

    part: Part  # of the document
    report: LayerReport
    choice: Choice | None
    samples_per_kernel: float  # not rounded, as in the report
    levelled: LevelReport | None = None  # what was done to exposure steps before


def smooth_layer(
    layer: Layer, progress: Callable[[int, int], None] | None = None,
    tick: Callable[[], None] | None = None, resources: Resources = IN_ONE_PIECE,
) -> Smoothed:  # fmt: skip
    """Choose parameters, calling `tick`, run the flow on a layer, and put the colours back.

    If all was chosen from the data, and the kernel is estimated to make the colours worse, they stay.
    """
    layer = layer.normalised()
    plan = layer.plan(tick, resources)
    is_worse = _is_worse(plan.choice, layer.settings.kernel)
    if is_worse:
        # Outliers are replaced all the same.
        kernel = dataclasses.replace(layer.settings.kernel, free=(), patches="off")
        settings = dataclasses.replace(layer.settings, kernel=kernel)
        layer = dataclasses.replace(layer, settings=settings)  # type: ignore[type-var]  # each layer is a dataclass
        plan = dataclasses.replace(layer.plan().stopped_before(0), choice=plan.choice)
    result = smooth_in_place(plan, progress)
    report, new = layer.report(plan, result), result.manifold.new_colours()
    warnings = report.warnings(plan.parameters.max_samples)
    is_smoothed = plan.parameters.iterations > 0 or bool(plan.outliers.get("replaced"))
    if is_worse:
        warnings.append(f"{layer.label}: smoothing was estimated to make the colours worse, so they stay.")
    choice = None if result.choice is None else result.choice.in_unit(layer.unit)
    samples_per_kernel = result.samples_per_kernel
    del plan, result  # before images as large are made
    repainted = layer.repaint(new, is_smoothed=is_smoothed)
    return Smoothed(
        part=layer.part, repainted=repainted,
        report=dataclasses.replace(report, change=repainted.change.summary()), warnings=warnings,
        choice=choice, samples_per_kernel=samples_per_kernel, levelled=layer.level_report,
    )  # fmt: skip


def unsmoothed(kernel: KernelParameters) -> KernelParameters:
    """Return parameters that leave colours as they are."""
    return dataclasses.replace(kernel, iterations=0, free=(), patches="off")


def _is_worse(choice: Choice | None, wanted: KernelParameters) -> bool:
    """Whether a result is estimated to be worse than the input, and no option asks for smoothing all the same."""
    insists = "iterations" not in wanted.free or wanted.given_noise is not None or wanted.strength > 1
    return not insists and choice is not None and choice.gain is not None and choice.gain < 0


def smooth_in_job(layer: Layer, job: Job, label: str) -> Smoothed:
    """Smooth a layer, whose name in progress is `label`."""
    choosing, steps = job.progress_of(Label(f"{label}: choosing parameters", "choosing parameters")), count()

    def tick() -> None:
        # The number of steps is not known before: shown is their share of it and of a usual number more.
        assert choosing is not None
        choosing(number := next(steps), number + _USUAL_TICKS)

    if choosing is not None:
        tick()
    smoothing = job.progress_of(Label(f"{label}: smoothing", "smoothing"))
    resources = Resources(job.chunking, job.chunk_memory)
    return smooth_layer(layer, smoothing, None if choosing is None else tick, resources)


@dataclass(frozen=True)
class Smoothing(Painter[Smoothed]):
    """A painter that removes exposure steps, if that is wanted, and then smooths."""

    colours_only: ClassVar[bool] = False

    settings: SmoothSettings
    levelling: LevelSettings | None = None

    @classmethod
    def of(cls, settings: SmoothSettings) -> Smoothing:
        return cls(settings, LevelSettings() if settings.level_seams else None)

    @property
    def phases(self) -> Sequence[str]:
        return ("choosing parameters", "smoothing") if self.settings.kernel.iterations != 0 else ("painting",)

    @property
    def changes(self) -> bool:
        encodes = self.settings.textures.image_suffix is not None
        return self.settings.kernel.iterations != 0 or self.levelling is not None or encodes

    @property
    def works_in_groups(self) -> bool:
        return self.levelling is None and self.settings.fits_parts

    def check(self, selection: Selection, target: OutputFormat) -> None:
        if self.changes:
            selection.require_geometry(is_patched=target.is_patched)
        selection.require_scale()
        if self.levelling is not None and selection.image:
            cause = "an image has no charts that could differ in exposure; give a model with textures"
            raise UsageError(f"{selection.document.name}: {cause}")

    def paint(self, layer: Layer, job: Job) -> Smoothed:
        if self.levelling is not None:
            layer = layer.levelled(self.levelling)
        return smooth_in_job(layer, job, layer.label) if "smoothing" in self.phases else smooth_layer(layer)


def smooth_report(made: FileReport, done: Sequence[Smoothed], settings: SmoothSettings) -> SmoothReport:
    """Add the changes of layers to the report of a file."""
    groups: dict[object, list[Smoothed]] = {}
    for number, each in enumerate(done):
        report = each.report
        key = (
            (report.slot, str(report.choice), str(report.noise), str(report.wrong_samples))
            if isinstance(report, SlotReport)
            else number
        )
        groups.setdefault(key, []).append(each)
    reports: dict[Part, list[Any]] = {"vertices": [], "textures": [], "image": []}
    for group in groups.values():
        reports[group[0].part].append(_joined(group))
    return SmoothReport(
        **{**vars(made), "parameters": describe_settings(settings)},
        vertices=next(iter(reports["vertices"]), None),
        textures=reports["textures"],
        image=next(iter(reports["image"]), None),
        levelled=[each.levelled for each in done if each.levelled is not None],
    )


def _joined(group: Sequence[Smoothed]) -> LayerReport:
    """Return one report for groups of textures of one slot that have the same noise and parameters."""
    reports = [each.report for each in group if isinstance(each.report, SlotReport)]
    if len(reports) < 2:
        return group[0].report
    texels = [max(1, report.counts["covered"]) for report in reports]

    def mean(name: str) -> float:
        return float(np.average([getattr(report, name) or 0.0 for report in reports], weights=texels))

    return dataclasses.replace(
        reports[0],
        textures=[texture for report in reports for texture in report.textures],
        counts={key: sum(report.counts[key] for report in reports) for key in reports[0].counts},
        pitch=mean("pitch"),
        samples_per_kernel=round(mean("samples_per_kernel"), 2),
        patches=None if reports[0].patches is None else mean("patches"),
        change=Change.joined(each.repainted.change for each in group).summary(),
    )


_HEAD = re.compile(rb'\{\n  "input": ".*",\n  "output": ".*",\n  "format": "\w+",\n  "parameters": \{')


@dataclass(frozen=True, kw_only=True)
class SmoothReport(FileReport):
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Paths of the input and output, and the format written.
    parameters : dict
        The parameters that were requested. Those named in "given" are not as by default; those named in "free" were
        chosen from the data, and the chosen values are in the records below.
    vertices : VertexReport or None
        Statistics of vertex colours, if they were smoothed.
    textures : list of SlotReport
        Statistics of each texture slot that was smoothed.
    stages : dict
        "wall" and "cpu" seconds per stage.
    peak_memory : int or None
        Peak resident size of the process in bytes.
    written : list of str
        The files that were written; none on a dry run.
    warnings : list of str
        Messages for the user.
    image : ImageReport or None
        Statistics of an image, if it was smoothed.
    levelled : list of LevelReport
        What was done to exposure steps before, if that was asked for.
    new_texture : str
        What kind of texture was made, in words; empty if none was.
    """

    vertices: VertexReport | None
    textures: list[SlotReport]
    image: ImageReport | None = None
    levelled: list[LevelReport] = field(default_factory=list)
    new_texture: str = ""


def is_report(head: bytes) -> bool:
    """Whether a file is a `SmoothReport` as JSON, by its first bytes."""
    return _HEAD.match(head) is not None


def smooth_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    parameters: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    *,
    unwrap: BakeSettings | None = None,
    **overrides: Any,
) -> SmoothReport:
    """Smooth the colours of a file, at its vertices, in its textures or of its pixels, and change nothing else.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB, points (.xyz, .asc, .txt, .csv, .pts, .npz) or an image; "-" for standard input or
        output. If the extension of `target` is that of another format, the file is converted. `source` may also be a
        mesh format that is read only (OFF, STL, 3MF, COLLADA), or a level set on a grid (.npz, .nrrd), which is
        written as a mesh.
    parameters : SmoothSettings
        The kernel's parameters, the working space, and the choice of colours. By default the kernel's parameters are
        chosen from the data, by the estimated error of the result.
    job : Job
        What may be read, a callback for progress, and whether files are written and replaced.
    unwrap : BakeSettings, optional
        Put the colours into a new texture atlas, smooth these, and write a new file that contains nothing else.
    **overrides
        Single parameters by name, such as ``iterations=3, slots=("normal",)``, which replace those in `parameters`.

    Returns
    -------
    SmoothReport
        The parameters used, counts, noise, changes, times, and the files that were written.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, if parameters contradict each other or the file, or if the format
        of the target is unknown.
    InputError
        If the source cannot be read, is damaged, or has no colours.
    OutputError
        If the target cannot be written, or exists and `job.overwrite` is not set. Existing files stay as they were.
    """
    source, target = os.fspath(source), os.fspath(target)
    settings = override(parameters, **overrides)
    if unwrap is not None:
        return _smooth_unwrapped(source, target, settings, unwrap, job)
    return smooth_report(*recolour(source, target, settings, Smoothing.of(settings), job), settings)


def _smooth_unwrapped(
    source: str, target: str, settings: SmoothSettings, wanted: BakeSettings, job: Job
) -> SmoothReport:
    """Smooth the base colour, or else the vertex colours, in a new texture, and write a new file with that."""
    _check(settings)
    file = begin(source, target, settings, job, models_only=True)
    with file.watch.stage("read"):
        selection = _selected(file, settings)
        require_effect([*selection.kinds, "textures"], file.document.name)
        stem = file.reserve_new(settings.textures.image_suffix or ".png")
    if settings.kernel.iterations:
        selection.require_scale()
    _require_possible(selection)
    made, image, smoothed = _new_texture(file, selection, wanted)
    notices = [*made.notices]
    if selection.slots and file.document.has_vertex_colours():
        notices.append("Vertex colours are not in the new file; --on vertices takes them, not the texture.")
    notices += [notice for each in smoothed for notice in each.repainted.notices]
    with file.watch.stage("write"):
        written = write_mesh(made.mesh(image), file.format.name, stem)
    report = file.write(written, notices, [warning for each in smoothed for warning in each.warnings])
    return dataclasses.replace(smooth_report(report, smoothed, settings), new_texture=made.in_words)


def _check(settings: SmoothSettings) -> None:
    """Refuse what has no meaning for one new texture."""
    textures, cause = settings.textures, ""
    if settings.level_seams:
        cause = "makes new charts; take exposure steps out with `beltrami level` before"
    elif settings.on == "both":
        cause = "smooths one new texture, so --on cannot be both"
    elif textures.materials or textures.names or textures.slots != ("baseColor",):
        cause = "makes one new base colour texture, so --material, --texture and --slots cannot choose"
    elif settings.embedding.smooth_geometry:
        cause = "writes a new file, in which --smooth-geometry cannot move vertices; use both in turn"
    if cause:
        raise UsageError(f"--unwrap {cause}")


def _selected(file: FileJob, settings: SmoothSettings) -> Selection:
    """Choose the base colour or the vertex colours; InputError if there are no colours at all."""
    document, access = file.document, file.job.access
    shown = document.readable(slot for slot in document.slots() if slot == "baseColor")
    if settings.on == "texture" or (settings.on != "vertices" and shown):
        return Selection(document, settings, access, slots=("baseColor",))
    document.painted()  # raises if there are none
    return Selection(document, settings, access, vertices=True)


def _require_possible(selection: Selection) -> None:
    if selection.vertices:
        from beltrami_cli.layers.vertex_layer import require_surface  # which textures do without

        require_surface(selection.document.painted(), selection.document.name)
        return
    if selection.settings.embedding.guides:
        raise UsageError("--guide cannot guide the new texture that --unwrap makes; use both in turn")
    selection.require_memory()


def _new_texture(
    file: FileJob, selection: Selection, wanted: BakeSettings
) -> tuple[NewTexture, ImageFile, list[Smoothed]]:
    """Smooth the colours, then make the texture of them; in the opposite order where textures are too small."""
    from beltrami_cli.jobs.new_texture import texture_from_textures, texture_from_vertices

    # Between texels and vertices the new texture shows mixtures of the old colours. Their noise is spread over several
    # texels, where it looks like a pattern and stays.
    document, job, settings = file.document, file.job, selection.settings
    textures = settings.textures
    smooths, smoothed = bool(settings.kernel.iterations), list[Smoothed]()
    if smooths and (selection.vertices or _are_large_enough(document.textured("baseColor"))):
        # The images are only read by what follows, so they are written in a format that loses nothing.
        exact = dataclasses.replace(
            settings, textures=dataclasses.replace(textures, image_suffix=".tif", small=False)
        )
        with file.watch.stage("smooth"):
            smoothed = paint(dataclasses.replace(selection, settings=exact), Smoothing(exact), job)
    with file.watch.stage("unwrap"):
        if selection.vertices:
            colours = smoothed[0].repainted.colours if smoothed else None
            made = texture_from_vertices(document, wanted, job.progress, colours)
        else:
            images = all_images(each.repainted for each in smoothed)[0]
            exact_document = document.repainted(None, {key: image.data for key, image in images.items()})
            made = texture_from_textures(exact_document, wanted, job.progress)
    if smoothed or not smooths:
        return (
            made,
            made.encoded(textures.image_suffix, textures.jpeg_quality, small=textures.small),
            smoothed,
        )
    with file.watch.stage("smooth"):
        layer = TextureLayer.read(made.surface(), "baseColor", settings)
        layer.require_writable()
        again = smooth_in_job(layer, job, "the new texture")
    (image,) = again.repainted.images.values()
    return made, image, [again]


def _are_large_enough(surface: TexturedSurface) -> bool:
    """Whether textures have a texel for each triangle, unlike palettes."""
    from beltrami_cli.jobs.new_texture import texels_of

    sizes = [measure_image(texture.data) for texture in surface.textures]
    sides = np.array([(0, 0) if size is None else (size.width, size.height) for size in sizes], np.int64)
    return texels_of(surface, sides.reshape(-1, 2)) >= int(np.count_nonzero(surface.texture_of >= 0))


@dataclass(frozen=True, kw_only=True)
class LevelFileReport(FileReport):
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    levelled : list of LevelReport
        What was found and done: of each texture slot, or of vertex colours.
    input, output, format, parameters, stages, peak_memory, written, warnings
        As for `SmoothReport`.
    """

    levelled: list[LevelReport]


def level_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    wanted: LevelSettings = LevelSettings(),  # noqa: B008
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
    **overrides: Any,
) -> LevelFileReport:
    """Take exposure steps between charts out of the colours of a model, and change nothing else.

    Parameters
    ----------
    source, target : path
        As for `smooth_file`: a model with textures, or with vertex colours that name the photograph of each vertex.
    wanted : LevelSettings
        How strongly, and which charts stay as they are.
    settings : SmoothSettings
        Which colours are meant and how they are written: the working space, channels, slots, textures and their format.
        Gains and offsets are taken in the working space.
    job : Job
        What may be read, a callback for progress, and whether files are written and replaced.
    **overrides
        Single parameters of `wanted` or `settings` by name, such as ``strength=0.5, slots=("emissive",)``.

    Returns
    -------
    LevelFileReport
        For each slot, whether there were exposure steps, how large, and the exposures of the charts.

    Raises
    ------
    UsageError
        If a parameter is unknown or out of its range, or the colours cannot have exposure steps, as in an image.
    InputError
        If the source cannot be read, has no colours, or does not say which photograph its vertex colours are from.
    OutputError
        If the target cannot be written, or exists and `job.overwrite` is not set. Existing files stay as they were.
    """
    own = {field.name for field in dataclasses.fields(LevelSettings)}
    wanted = override(wanted, **{name: value for name, value in overrides.items() if name in own})
    settings = override(settings, **{name: value for name, value in overrides.items() if name not in own})
    if settings.space == "oklab":
        cause = "exposures are gains of channels, which the space oklab mixes"
        raise UsageError(f"{cause}; choose srgb or linear")
    source, target = os.fspath(source), os.fspath(target)
    still = dataclasses.replace(settings, kernel=unsmoothed(settings.kernel))
    made, done = recolour(source, target, still, Smoothing(still, wanted), job)
    levelled = [
        dataclasses.replace(each.levelled, change=each.report.change)
        for each in done
        if each.levelled is not None
    ]
    described, used = describe_settings(settings), ("threads", "space", "channels", "on", "textures")
    parameters = {name: value for name, value in described.items() if name in used}
    parameters |= dataclasses.asdict(wanted)
    return LevelFileReport(**{**vars(made), "parameters": parameters}, levelled=levelled)
