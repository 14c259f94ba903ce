"""Coloured parts of a document, the way back into the document, and reports of what was done to them.

Vertices, points, texels, pixels and vertices on a grid differ only in how their colours are read and written back:
code that gives a layer new colours works for all of them. In reports, noise and changes are of full scale 1: noise in
the working space, changes as stored; `dataclasses.asdict` gives JSON types.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Self

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.noise.model import Reading
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.image import Picture, is_unchanged, losses, write_image
from beltrami_cli.formats.image.picture import as_stored
from beltrami_cli.layers.settings import COLOUR_SLOTS, LevelSettings, SmoothSettings, TextureSettings
from beltrami_cli.surface.atlas import Indices, store_integers
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.large_arrays import blocks, kept_bytes
from beltrami_cli.surface.records import ColouredVertices, ImageFile, Slot

Part = Literal["vertices", "textures", "image"]


@dataclass(frozen=True)
class SharedImage:
    """New pixels of an image that several slots show, each in channels of its own."""

    slot: Slot
    key: str
    pixels: Array
    columns: list[int]  # the channels that change
    write: Callable[[Array], tuple[ImageFile, list[str]]]  # returns also what users should know

    def fits(self, other: SharedImage) -> bool:
        """Whether both can be one file: colours and data are encoded differently."""
        is_of_kind = (self.slot in COLOUR_SLOTS) == (other.slot in COLOUR_SLOTS)
        return is_of_kind and set(self.columns).isdisjoint(other.columns)


@dataclass(frozen=True)
class StoredColours:
    """New colours for a document: of vertices, with their positions if they moved, or image files."""

    change: Change
    colours: Float32s | None = None
    positions: Float64s | None = None
    images: dict[tuple[Slot, str], ImageFile] = field(default_factory=dict)
    shared: tuple[SharedImage, ...] = ()
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class SampledVertices:
    """A mesh, and the sample that each of its V vertices belongs to."""

    mesh: ColouredVertices
    sample_of: Int64s  # shape (V,); -1: none


@dataclass(frozen=True)
class ChosenChannels:
    """Channels by their numbers among all channels."""

    sampled: list[int]
    changing: list[int]
    written: list[int]  # channels that change, counted among the sampled ones
    metric: list[int] | None  # counted so, too; None: all


def choose_channels(
    names: tuple[str, ...], settings: SmoothSettings, owner_has: str, *,
    used: Collection[str] | None = None, opacity: bool = False, abbreviable: tuple[str, ...] | None = None,
) -> ChosenChannels:  # fmt: skip
    """Choose channels by names or, of all or the `abbreviable` ones, first letters; UsageError if one is absent.

    Only the `used` ones may change; channels that only enter the metric are sampled, too. `opacity`, if it is
    smoothed, is one more behind them.
    """

    def numbers_of(wanted: tuple[str, ...] | None) -> list[int]:
        numbers = set(range(len(names))) if wanted is None else set[int]()
        for word in wanted or ():
            lower = word.lower()
            fits = [lower == name or (lower == name[0] and name in (abbreviable or names)) for name in names]
            if not any(fits):
                raise UsageError(f"there is no channel {word}; {owner_has} {', '.join(names)}")
            numbers.add(fits.index(True))
        return sorted(numbers)

    changing = [i for i in numbers_of(settings.channels) if used is None or names[i] in used]
    if opacity:
        changing.append(len(names))
        names = (*names, "alpha")
    wanted = settings.embedding.metric_channels
    in_metric = changing if wanted is None else numbers_of(wanted)
    sampled = sorted({*changing, *in_metric})
    metric = None if in_metric == sampled else [sampled.index(channel) for channel in in_metric]
    written = [sampled.index(channel) for channel in changing]
    return ChosenChannels(sampled, changing, written, metric)


class Layer(ABC):
    """Coloured samples of a document, immutable; UsageError if settings name absent channels or contradict them."""

    part: ClassVar[Part]  # of the document, that they belong to; its section in reports
    label: str  # their name in messages
    names: tuple[str, ...]  # of the sampled channels: changing ones, and ones that only enter the metric
    settings: SmoothSettings
    noise: Float32s | None = None  # given standard deviations, with a row for each sample
    level_report: LevelReport | None = None  # what was done to exposure steps, if they were looked for
    notices: Sequence[str] = ()  # what users should know about how they are stored, and where they lie

    def normalised(self) -> Self:
        """Return the layer with colours in a unit of their own, so that what counts as noise depends on no unit."""
        return self

    def unit_in(self, space: str) -> float:
        """Return what colours of this layer, in a space, are divided by in plans."""
        del space
        return 1.0

    @property
    def unit(self) -> float:
        """What colours in the working space are divided by in plans."""
        return self.unit_in(self.settings.space)

    @property
    def kernel(self) -> KernelParameters:
        """The wanted parameters, for the unit of plans."""
        return self.settings.kernel.in_unit(self.unit, self.unit_in("linear"))

    @property
    def deviations(self) -> Float32s | None:
        """The given standard deviations of samples, in the unit of plans."""
        return None if self.noise is None else self.noise / np.float32(self.unit)

    @abstractmethod
    def plan(self, tick: Callable[[], None] | None = None, resources: Resources = IN_ONE_PIECE) -> Plan[Any]:
        """Plan their smoothing; `tick` is called meanwhile, and may raise."""

    @abstractmethod
    def report(self, plan: Plan[Any], result: FlowResult[Any]) -> LayerReport:
        """Return the report of what was done, without the change of colours."""

    @abstractmethod
    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        """Write new colours of all samples back.

        Where neither smoothing nor levelling changed a texture, its gutter stays.
        """

    def levelled(self, wanted: LevelSettings) -> Self:
        """Return the layer without exposure steps, with a report; UsageError if it cannot have any."""
        del wanted
        cause = "there are no charts that could differ in exposure; textures of models have them"
        raise UsageError(f"{self.label}: {cause}")

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Return facts about them, their noise, and what smoothing would do, in JSON types, by what they are about."""

    @abstractmethod
    def places(self) -> Cells | SampledVertices:
        """Return where the samples lie: in pictures, or at vertices of a mesh."""

    def require_writable(self) -> None:  # noqa: B027
        """Raise errors about images as outputs, before anything is computed."""

    def _used(self, plan: Plan[Any], result: FlowResult[Any]) -> dict[str, Any]:
        """Return the fields that all reports have in common."""
        return {
            "beta": plan.beta / self.unit,
            "iterations": plan.parameters.iterations,
            **self._noise(plan),
            "guides": plan.guide_betas,
            "choice": describe_choice(result.choice, self.unit),
            "patches": result.patches,
        }

    def _noise(self, plan: Plan[Any]) -> dict[str, Any]:
        model = {
            name: value if name == "grain" else self.unit * value
            for name, value in plan.described_noise.items()
        }
        return {
            "noise": named(self.names, self.unit * plan.noise),
            "noise_model": model,
            "reading": describe_reading(plan.reading, self.unit),
            "wrong_samples": plan.outliers,
        }

    def _planned(self, plan: Plan[Any]) -> dict[str, Any]:
        """Return the noise, and the parameters of the kernel as planned, for `describe`."""
        choice, given = describe_choice(plan.choice, self.unit), self.settings.kernel.noise
        used = dataclasses.asdict(
            dataclasses.replace(plan.parameters, beta=plan.beta / self.unit, noise=given)
        )
        del used["free"]  # nothing is any more
        smooth = {
            **used,
            "patches": "on" if plan.takes_patches else "off",
            "threads": self.settings.kernel.thread_count,
            "space": self.settings.space,
            **({"guide_betas": plan.guide_betas} if plan.guide_betas else {}),
            **({"choice": choice} if choice else {}),
        }
        return {**self._noise(plan), "smooth": smooth}


def named(names: Sequence[str], values: Float64s) -> dict[str, float]:
    """Return values by the names of their channels."""
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def describe_choice(choice: Choice | None, unit: float) -> dict[str, object] | None:
    """Describe the choice of parameters for colours that were divided by a unit, in JSON types."""
    if choice is None:
        return None
    choice = choice.in_unit(unit)
    interval = None if choice.interval is None else list(choice.interval)
    return {**dataclasses.asdict(choice), "interval": interval}


def describe_reading(reading: Reading | None, unit: float) -> dict[str, float] | None:
    """Describe what was read of the size of noise, of colours that were divided by a unit; None: it was given."""
    if reading is None:
        return None
    sizes = {name: unit * getattr(reading, name) for name in ("low", "median", "high")}
    return {"none": reading.none, "visible": reading.visible, **sizes}


@dataclass(frozen=True)
class Change:
    """How much colour values changed: how many there are, the sums of changes and of their squares, the largest."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    @classmethod
    def between(cls, before: Float32s, after: Float32s) -> Change:
        parts = []
        for block in blocks(len(before)) if before.size else ():
            own = np.abs(after[block] - before[block]).ravel()
            squares = float(np.einsum("i,i->", own, own, dtype=np.float64))
            parts.append(cls(own.size, float(own.sum(dtype=np.float64)), squares, float(own.max())))
        return cls.joined(parts)

    @classmethod
    def joined(cls, changes: Iterable[Change]) -> Change:
        parts = [dataclasses.astuple(change) for change in changes]
        counts, totals, squares, largest = zip(*parts, strict=True) if parts else ((), (), (), (0.0,))
        return cls(sum(counts), sum(totals), sum(squares), max(largest))

    def summary(self) -> dict[str, float]:
        count = max(1, self.count)
        return {"mean": self.total / count, "rms": (self.squares / count) ** 0.5, "largest": self.largest}


def store(
    picture: Picture, table: Array, pixels: Indices, values: Float32s, channels: Sequence[int], threads: int
) -> Change:
    """Write values of full scale 1, shape (K, M), to M channels of K pixels, in place, clipped and rounded once."""
    if table.dtype.kind == "f":
        before = table[pixels[:, None], channels]
        for channel, old, new in zip(channels, before.T, values.T, strict=True):
            moved = new != old  # -0 stays what it is
            table[pixels[moved], channel] = as_stored(new[moved], picture.kinds[channel])
        return Change.between(before, table[pixels[:, None], channels])
    return Change(values.size, *store_integers(table, pixels, values, channels, threads))


def dithered(values: Float32s, texels: Indices, width: int) -> Float32s:
    """Add a pattern of half a step of 8 bits to some texels, so that rounding spreads what it takes away.

    Multiples of a step stay. The pattern is interleaved gradient noise: J. Jimenez, "Next generation post
    processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
    """
    row, column = np.divmod(texels.astype(np.int32), np.int32(width))
    pattern = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1)) % 1
    steps = values * np.float32(255)
    is_whole = np.abs(steps - np.rint(steps)) < 2e-3
    spread = (steps + (0.98 * (pattern - 0.5)).astype(np.float32)[:, None]) / np.float32(255)
    return np.where(is_whole, values, spread)


def rewritten(
    picture: Picture, pixels: Array, wanted: TextureSettings, suffix: str | None, *, as_data: bool
) -> tuple[ImageFile, list[str]]:
    """Write new pixels as a file like a picture's own, or in another format; return also what users should know.

    If neither a pixel nor the format changed, the file is the picture's own.
    """
    if suffix is None and is_unchanged(picture, pixels):
        return ImageFile(picture.source, picture.suffix), []
    quality, small = wanted.jpeg_quality, wanted.small
    file = write_image(picture, pixels, suffix=suffix, jpeg_quality=quality, small=small, as_data=as_data)
    lost = losses(picture, suffix) if suffix is not None else ()
    file = dataclasses.replace(file, content=kept_bytes(file.data), is_chosen=suffix is not None)
    return file, [*picture.notices, *file.notices, *lost]


def all_images(
    stored: Iterable[StoredColours],
) -> tuple[dict[tuple[Slot, str], ImageFile], list[str]]:
    """Return the new images of all layers, and notices about images that several slots show.

    Occlusion is the red channel of an image, roughness and metalness are green and blue, mostly of the same image.
    """
    images = dict[tuple[Slot, str], ImageFile]()
    joined = dict[str, list[list[SharedImage]]]()
    for each in stored:
        images |= each.images
        for new in each.shared:
            groups = joined.setdefault(new.key, [])
            if groups and all(new.fits(other) for other in groups[-1]):
                groups[-1].append(new)
            else:
                groups.append([new])
    notices = list[str]()
    for *others, last in (group for groups in joined.values() for group in groups):
        for other in others:
            last.pixels[..., other.columns] = other.pixels[..., other.columns]
        file, said = last.write(last.pixels)
        images |= {(each.slot, last.key): file for each in (*others, last)}
        notices += said
    return images, notices


@dataclass(frozen=True, kw_only=True)
class LayerReport:
    """What was done to samples of any kind."""

    beta: float  # as used
    iterations: int  # how many were run: none if there is no noise, and no number was asked for
    noise: dict[str, float]  # standard deviation per channel, as estimated or given; 0 where none is removed
    # What was read of the size of the noise, root mean squares of full scale 1: the probabilities that there is "none",
    # and that there is some that people see ("visible"); and if there is any, its "median", and "low" and "high", which
    # it lies between with a certainty of 90 %. None: the noise is given.
    reading: dict[str, float] | None
    # Standard deviations at "dark", "middle" and "bright" levels (0.1, 0.5, 0.9), if they differ; of "quiet" and "loud"
    # places, if they do; and "grain", the width in samples of what samples share of it.
    noise_model: dict[str, float]
    # Mean, root mean square and largest change of a smoothed value; of covered texels only.
    change: dict[str, float] = field(default_factory=dict)
    guides: dict[str, float]  # the beta used for each guide, by its name
    # If parameters were chosen from the data: "chosen" with their values, and estimates of the result: its
    # estimated "psnr" in dB, the standard "error" of that if the noise is right, the "gain" over the input, and the
    # numbers of "candidates" that were compared and of "samples" that they were compared on. "predicted" has the PSNR
    # "before", the "psnr" after, and its "least" and "most" with a certainty of 90 %, as messages do; None: the noise
    # is not known well enough.
    choice: dict[str, object] | None
    patches: float | None  # the share of the result that is from patches; None: only the kernel was run
    # If any: the "count" of samples that stand out at random, their "share" of all, and whether they were "replaced".
    wrong_samples: dict[str, Any]

    def warnings(self, max_samples: int) -> list[str]:
        """Return warnings for users; kernels held at most `max_samples`."""
        del max_samples
        return []


@dataclass(frozen=True, kw_only=True)
class VertexReport(LayerReport):
    """What was done to vertex colours, besides."""

    # Vertices, triangles, samples, samples of hard edges, samples per kernel, truncated kernels. For points without
    # faces the triangles are those around each, and there are "outliers": points in none of them, left as they are.
    counts: dict[str, float]
    spacing: float  # mean distance of samples, in the file's own unit of length
    # If positions were smoothed: the estimated noise of the normals in radians, the beta used for them, and the mean,
    # root mean square and largest distance that a vertex moved, in the file's own unit of length.
    geometry: dict[str, float] | None = None

    def warnings(self, max_samples: int) -> list[str]:
        found, outliers = list[str](), self.counts.get("outliers", 0)
        if outliers:
            alone = "is left as it is: it is" if outliers == 1 else "are left as they are: they are"
            where = "too far from others, in one line with them, or nowhere"
            found.append(f"{outliers} of {self.counts['vertices']} points {alone} {where}")
        if truncated := self.counts["truncated_kernels"]:
            remedy = "lower t, or raise --max-samples"
            found.append(f"{truncated} kernels were cut short at {max_samples} samples; {remedy}")
        return found


@dataclass(frozen=True, kw_only=True)
class SlotReport(LayerReport):
    """What was done to the textures of a slot, besides."""

    slot: str
    textures: list[dict[str, object]]  # name, size, type, and how much of its texels the surface covers
    # Charts, seams, jumps, covered and overlapped texels of all textures together; jumps are seams whose two sides
    # really differ, which nothing was smoothed over.
    counts: dict[str, int]
    pitch: float  # mean distance of neighbouring texels on the surface, in the model's own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True, kw_only=True)
class ImageReport(LayerReport):
    """What was done to an image, besides."""

    # Its size, format and channels, which of them were smoothed, on which surface ("plane", "height" or "positions"),
    # and how many of its pixels are holes.
    image: dict[str, object]
    pitch: float  # mean distance of neighbouring pixels on the surface, in its own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True)
class LevelReport:
    """What was found of exposure steps, and done to them."""

    what: str  # which colours
    charts: int  # charts of textures, or parts of vertices by photograph
    seams: int  # between two of them
    stepped: int  # seams with a mean step of 2/255 or more
    painted: int  # seams whose steps are edges of colour
    before: float  # median over all seams, by length, of the mean step, full scale 1, in the working space
    after: float
    explained: float  # the share of the steps at held-out seams that one exposure per chart explains
    tilted: bool  # whether gains change over charts, as by vignetting
    levelled: bool  # whether colours were changed
    reason: str  # why not, if they were not
    change: dict[str, float] = field(default_factory=dict)  # as for `LayerReport`
    # For each chart with seams its number, its texture and place there (the column and row of its centre), its texels,
    # and the gain and offset per channel that it was exposed with, in the working space.
    exposures: list[dict[str, object]] = field(default_factory=list)
