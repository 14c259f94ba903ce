"""Layers: coloured parts of a document, the way back into the document, and reports of the changes.

Vertices, points, texels, pixels and vertices on a grid differ only in how their colours are read and written. Code that
gives a layer new colours works for all of them. In reports, full scale is 1: noise refers to the working space, changes
to stored values. `dataclasses.asdict` of a report gives JSON types.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Self

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Indices, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.noise.model import Reading
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.image import DecodedImage, is_unchanged, losses, write_image
from beltrami_cli.formats.image.decoded_image import as_stored
from beltrami_cli.layers.settings import COLOUR_SLOTS, LevelSettings, SmoothSettings, TextureSettings
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.colour_values import store_integers
from beltrami_cli.surface.large_arrays import blocks, kept_bytes
from beltrami_cli.surface.records import ColouredVertices, ImageFile, Slot

Part = Literal["vertices", "textures", "image"]


@dataclass(frozen=True)
class SharedImage:
    """New pixels of an image that several slots show, each slot in its own channels."""

    slot: Slot
    key: str
    pixels: Array
    columns: list[int]  # the channels that change
    write: Callable[[Array], tuple[ImageFile, list[str]]]  # returns also notices

    def fits(self, other: SharedImage) -> bool:
        """Whether both can be stored in one file: colours and data are encoded differently."""
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
    """A mesh, and the sample of each of its V vertices."""

    mesh: ColouredVertices
    sample_of: Int64s  # shape (V,); -1: no sample


@dataclass(frozen=True)
class ChosenChannels:
    """The sampled channels, by their numbers among all channels."""

    sampled: list[int]
    changing: list[int]
    written: list[int]  # channels that change, numbered among the sampled ones
    metric: list[int] | None  # channels of the metric, numbered likewise; None: all


def choose_channels(
    names: tuple[str, ...], settings: SmoothSettings, owner_has: str, *,
    used: Collection[str] | None = None, opacity: bool = False, abbreviable: tuple[str, ...] | None = None,
) -> ChosenChannels:  # fmt: skip
    """Choose channels by name, or by first letter among all or `abbreviable` ones; UsageError if one is absent.

    Only the `used` channels may change; channels that only enter the metric are sampled too. `opacity`, if it is
    smoothed, follows them as one more channel.
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
    """Coloured samples of a document, immutable; UsageError if settings name absent channels or contradict it."""

    part: ClassVar[Part]  # part of the document, a section of reports
    label: str  # name in messages
    names: tuple[str, ...]  # of the sampled channels: changing ones, and ones that only enter the metric
    settings: SmoothSettings
    noise: Float32s | None = None  # given standard deviations, one row per sample
    level_report: LevelReport | None = None  # None: exposure steps were not searched for
    notices: Sequence[str] = ()  # about storage and positions, for users

    def normalised(self) -> Self:
        """Return the layer with colours in a unit of their own, so that noise is judged independently of their unit."""
        return self

    def unit_in(self, space: str) -> float:
        """Return the unit of plans, which divides the colours of this layer in `space`."""
        del space
        return 1.0

    @property
    def unit(self) -> float:
        """The unit of plans, which divides colours in the working space."""
        return self.unit_in(self.settings.space)

    @property
    def kernel(self) -> KernelParameters:
        """The requested parameters, in the unit of plans."""
        return self.settings.kernel.in_unit(self.unit, self.unit_in("linear"))

    @property
    def deviations(self) -> Float32s | None:
        """The given standard deviations of samples, in the unit of plans."""
        return None if self.noise is None else self.noise / np.float32(self.unit)

    @abstractmethod
    def plan(self, tick: Callable[[], None] | None = None, resources: Resources = IN_ONE_PIECE) -> Plan[Any]:
        """Plan the smoothing; `tick` is called meanwhile, and may raise to stop."""

    @abstractmethod
    def report(self, plan: Plan[Any], result: FlowResult[Any]) -> LayerReport:
        """Report the smoothing, without the change of colours."""

    @abstractmethod
    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        """Encode the new colours of all samples for the document.

        A texture that neither smoothing nor levelling changed keeps its gutter.
        """

    def levelled(self, wanted: LevelSettings) -> Self:
        """Return the layer without exposure steps, and with a report; UsageError if it has no charts."""
        del wanted
        cause = "there are no charts that could differ in exposure; textures of models have them"
        raise UsageError(f"{self.label}: {cause}")

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Return facts about the layer, its noise, and its plan of smoothing, in JSON types, by topic."""

    @abstractmethod
    def places(self) -> Cells | SampledVertices:
        """Return the locations of the samples, in pictures or at vertices of a mesh."""

    def require_writable(self) -> None:  # noqa: B027
        """Raise errors of output images before anything is computed."""

    def _common_report(self, plan: Plan[Any], result: FlowResult[Any]) -> dict[str, Any]:
        """Return the fields that all reports share."""
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

    def _described_plan(self, plan: Plan[Any]) -> dict[str, Any]:
        """Return the noise and the planned parameters of the kernel, for `describe`."""
        choice, given = describe_choice(plan.choice, self.unit), self.settings.kernel.noise
        used = dataclasses.asdict(
            dataclasses.replace(plan.parameters, beta=plan.beta / self.unit, noise=given)
        )
        del used["free"]  # empty in a plan
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
    """Pair values with the names of their channels."""
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def describe_choice(choice: Choice | None, unit: float) -> dict[str, object] | None:
    """Describe the choice of parameters for colours that were divided by a unit, in JSON types."""
    if choice is None:
        return None
    choice = choice.in_unit(unit)
    interval = None if choice.interval is None else list(choice.interval)
    return {**dataclasses.asdict(choice), "interval": interval}


def describe_reading(reading: Reading | None, unit: float) -> dict[str, float] | None:
    """Describe the estimated size of the noise of colours that were divided by a unit; None if it was given."""
    if reading is None:
        return None
    sizes = {name: unit * getattr(reading, name) for name in ("low", "median", "high")}
    return {"none": reading.none, "visible": reading.visible, **sizes}


@dataclass(frozen=True)
class Change:
    """Sums of changes of colour values: their number, sum, sum of squares and maximum."""

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
    picture: DecodedImage,
    table: Array,
    pixels: Indices,
    values: Float32s,
    channels: Sequence[int],
    threads: int,
) -> Change:
    """Write values of full scale 1, shape (K, M), to M channels of K pixels in place, clipped and rounded once."""
    if table.dtype.kind == "f":
        before = table[pixels[:, None], channels]
        for channel, old, new in zip(channels, before.T, values.T, strict=True):
            moved = new != old  # -0 is not changed to 0
            table[pixels[moved], channel] = as_stored(new[moved], picture.kinds[channel])
        return Change.between(before, table[pixels[:, None], channels])
    return Change(values.size, *store_integers(table, pixels, values, channels, threads))


def dithered(values: Float32s, texels: Indices, width: int) -> Float32s:
    """Add a dither pattern of half a step of 8 bits to texels, so that rounding causes no banding.

    Multiples of a step are not changed. The pattern is interleaved gradient noise: J. Jimenez, "Next generation post
    processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
    """
    row, column = np.divmod(texels.astype(np.int32), np.int32(width))
    pattern = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1)) % 1
    steps = values * np.float32(255)
    is_whole = np.abs(steps - np.rint(steps)) < 2e-3
    spread = (steps + (0.98 * (pattern - 0.5)).astype(np.float32)[:, None]) / np.float32(255)
    return np.where(is_whole, values, spread)


def rewritten(
    picture: DecodedImage, pixels: Array, wanted: TextureSettings, suffix: str | None, *, as_data: bool
) -> tuple[ImageFile, list[str]]:
    """Encode new pixels like a picture's own file, or in another format; return the file and notices.

    If neither a pixel nor the format changed, the picture's own file is returned.
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

    Occlusion is the red channel of an image, roughness and metalness are green and blue, usually of the same image.
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
    """Report on samples of any kind."""

    beta: float  # as used
    iterations: int  # 0 without noise, unless a number was given
    noise: dict[str, float]  # standard deviation per channel, estimated or given; 0: none is removed
    # Estimated size of the noise, RMS of full scale 1: the probabilities of no noise ("none") and of visible noise
    # ("visible"); given that there is noise, its "median", and "low" and "high", its interval with a certainty of 90 %.
    # None: the noise is given.
    reading: dict[str, float] | None
    # Standard deviations at "dark", "middle" and "bright" levels (0.1, 0.5, 0.9), and of "quiet" and "loud" places, if
    # they differ; "grain", the width in samples over which noise is shared.
    noise_model: dict[str, float]
    # Mean, RMS and largest change of a smoothed value; only of covered texels.
    change: dict[str, float] = field(default_factory=dict)
    guides: dict[str, float]  # beta of each guide, by name
    # If parameters were chosen from the data: "chosen" values, the estimated "psnr" in dB, its standard "error" given
    # the noise, the "gain" over the input, and the numbers of "candidates" compared and of "samples" they were compared
    # on. "predicted" has the PSNR "before", "psnr" after, and its "least" and "most" with a certainty of 90 %, as in
    # messages; None: the noise is not known well enough.
    choice: dict[str, object] | None
    patches: float | None  # mean weight of patches; None: only the kernel was run
    # If there are outliers: their "count", "share" of all samples, and whether they were "replaced".
    wrong_samples: dict[str, Any]

    def warnings(self, max_samples: int) -> list[str]:
        """Return warnings for users; `max_samples`: limit of samples per kernel."""
        del max_samples
        return []


@dataclass(frozen=True, kw_only=True)
class VertexReport(LayerReport):
    """Report on vertex colours."""

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
    """Report on the textures of a slot."""

    slot: str
    textures: list[dict[str, object]]  # name, size, type, and coverage
    # Numbers of charts, seams, jumps, covered and overlapped texels of all textures together. Jumps are seams whose
    # sides differ; nothing is smoothed across them.
    counts: dict[str, int]
    pitch: float  # mean distance of neighbouring texels on the surface, in the model's own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True, kw_only=True)
class ImageReport(LayerReport):
    """Report on an image."""

    # Size, format, channels, smoothed channels, kind of surface ("plane", "height" or "positions"), and number of
    # holes.
    image: dict[str, object]
    pitch: float  # mean distance of neighbouring pixels on the surface, in its own unit of length
    samples_per_kernel: float  # mean


@dataclass(frozen=True)
class LevelReport:
    """Report on exposure steps."""

    what: str  # name of the colours
    charts: int  # number of charts, or of connected vertices of one photograph
    seams: int  # number of seams between charts
    stepped: int  # number of seams with a mean step of 2/255 or more
    painted: int  # seams whose steps are edges of colour
    before: float  # median over all seams, by length, of the mean step, full scale 1, in the working space
    after: float
    explained: float  # share of the steps at held-out seams explained by one exposure per chart
    tilted: bool  # whether gains vary within charts, as with vignetting
    levelled: bool  # whether colours were changed
    reason: str  # of not changing them
    change: dict[str, float] = field(default_factory=dict)  # as for `LayerReport`
    # For each chart with seams: its number, texture, location (column and row of its centre), number of texels, and
    # gain and offset per channel of its exposure, in the working space.
    exposures: list[dict[str, object]] = field(default_factory=list)
