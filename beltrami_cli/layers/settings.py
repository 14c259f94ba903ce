"""The parameters of a job besides the kernel's; cheap to import for the command line.

Each is declared once (see `beltrami_cli.fields`), and described in JSON types, as requested and as used.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import (
    Checked,
    Parameter,
    described,
    given_parameters,
    named_files,
    parameter,
    parameters,
    part,
    parts,
)
from beltrami_cli.flow.parameters import TUNABLE, KernelParameters, Space
from beltrami_cli.formats.files.paths import is_file
from beltrami_cli.quantities import names_in, share_in
from beltrami_cli.surface.slots import SLOTS

Target = Literal["auto", "vertices", "texture", "both"]
AlphaMode = Literal["keep", "smooth"]
Inside = Literal["below", "above"]

# Values of --format besides extensions; names of outputs may have the extension of any writable format.
IMAGE_FORMATS = ("png", "jpg", "webp", "tif", "exr", "tga", "bmp", "hdr", "jxl", "ppm")
IMAGE_SUFFIXES = (
    ".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".exr", ".tga", ".bmp", ".hdr", ".ktx2", ".avif",
)  # fmt: skip


_MAX_VOXELS = 1 << 31  # rows and columns of the marching cubes are counted in 32 bits
_WIDEST_GUTTER = 99_999


def _suffix(text: str) -> str:
    return "." + text.lower().lstrip(".")


# Usual names of the slots; case, spaces, dashes and underscores are ignored.
_SLOT_NAMES = {slot.lower(): slot for slot in SLOTS} | {
    **dict.fromkeys(("diffuse", "albedo", "color", "colour"), "baseColor"),
    **dict.fromkeys(("emission", "glow"), "emissive"),
    **dict.fromkeys(("normals", "bump"), "normal"),
    "ao": "occlusion",
    **dict.fromkeys(("metallic", "metalness", "roughness", "orm"), "metallicRoughness"),
}


def _slots(text: str) -> tuple[str, ...]:
    names = names_in(text)
    if [name.lower() for name in names] == ["all"]:
        return SLOTS
    plain = ("".join(letter for letter in name.lower() if letter.isalpha()) for name in names)
    return tuple(dict.fromkeys(_SLOT_NAMES.get(key, name) for key, name in zip(plain, names, strict=True)))


def _gutter(text: str) -> int | None:
    if text == "keep":
        return None
    # `isdigit` alone would accept other scripts and ², which `int` rejects.
    if not (text.isascii() and text.isdigit() and len(text) <= len(str(_WIDEST_GUTTER))):
        raise ValueError(f"is {text}, but must be a number of texels from 0 to {_WIDEST_GUTTER}, or keep")
    return int(text)


def _metric_channels(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if names == ("none",):
        return ()
    if not names or "none" in names:
        raise ValueError(f"is {text!r}; give channels with commas between them, or none")
    return names


@described
@dataclass(frozen=True)
class TextureSettings(Checked):
    """Selection of textures, and how they are written."""

    group: ClassVar[str] = "Textures"

    slots: tuple[str, ...] = parameter(
        ("baseColor",),
        f"Slots of materials: {', '.join(SLOTS)}, or all. All but the first two are taken as data.",
        choices=SLOTS, metavar="LIST", parse=_slots, show=",".join, of=("textures",),
    )  # fmt: skip
    materials: tuple[str, ...] = parameter(
        (),
        "Only textures of materials with such a name; may be repeated.",
        flags=("--material", "materials"), metavar="GLOB", repeatable=True, of=("textures",),
    )  # fmt: skip
    names: tuple[str, ...] = parameter(
        (),
        "Only textures with such a file name; may be repeated.",
        flags=("--texture", "texture_names"), metavar="GLOB", repeatable=True, of=("textures",),
    )  # fmt: skip
    alpha: AlphaMode = parameter(
        "keep",
        "Keep the opacity of textures and images, or smooth it with the colours. Unless it is smoothed, "
        "invisible texels contribute no colour.",
        choices=get_args(AlphaMode), of=("textures", "images"),
    )  # fmt: skip
    gutter: int | None = parameter(
        16,
        "Also change up to this many texels around every chart, where they continue its colours, so that "
        "lookups across its border return no old colours; or keep them.",
        optional=True, low=0, high=_WIDEST_GUTTER, unit="texels", metavar="N|keep", parse=_gutter,
        show=lambda width: "keep" if width is None else str(width), of=("textures",),
    )  # fmt: skip
    image_suffix: str | None = parameter(
        None,
        "Write textures as png, jpg, webp, ktx2, avif, tif, exr ...",
        choices=IMAGE_SUFFIXES, unset="each as it was", flags=("--texture-format",), metavar="EXT",
        parse=_suffix, of=("textures",),
    )  # fmt: skip
    jpeg_quality: int = parameter(
        98,
        "Quality of JPEG, lossy WebP, AVIF and ETC1S (KTX2) textures and images; the subsampling of a JPEG stays.",
        low=1, high=100, of=("textures", "images"),
    )  # fmt: skip
    small: bool = parameter(False, "Compress PNG files well, which takes longer.", of=("textures", "images"))


@described
@dataclass(frozen=True)
class LevelSettings(Checked):
    """Removal of exposure steps between charts."""

    group: ClassVar[str] = "Exposure steps"

    exposure_strength: float = parameter(
        1.0,
        "Share of the exposures to remove: 1 levels the seams, 0.5 halves their steps.",
        low=0, high=1, metavar="S", parse=share_in, show=lambda value: f"{value:g}", is_daily=True,
    )  # fmt: skip
    reference_charts: tuple[str, ...] = parameter(
        (),
        "Charts that stay as they are, and to which the others are matched: a number of a chart, as --report lists "
        "them, or a pattern for names of textures or materials; may be repeated.",
        unset="none; the mean of all stays", metavar="CHART|GLOB", repeatable=True, is_daily=True,
    )  # fmt: skip
    photographs: str | None = parameter(
        None,
        "Of vertex colours: the attribute of vertices that numbers the photograph that each is from.",
        unset="photograph, photo, image, camera, view or one of these with _id", metavar="ATTRIBUTE", is_daily=True,
        of=("vertex colours",),
    )  # fmt: skip


@described
@dataclass(frozen=True)
class ImageSettings(Checked):
    """The surface of an image, and its holes."""

    group: ClassVar[str] = "Images"

    height: str | None = parameter(
        None,
        "For images: an image of the same size with heights over its plane, for the surface (x, y, S h). "
        "Depth images (EXR, 16-bit PNG) do as well. Pixels without a finite height are holes.",
        metavar="FILE", is_file=True, of=("images",),
    )  # fmt: skip
    height_scale: float = parameter(
        1.0,
        "Factor of --height. Integer heights are scaled to 0 to 1, floats are not.",
        unit="pixels per unit of height", metavar="S", of=("images",),
    )  # fmt: skip
    positions: str | None = parameter(
        None,
        "For images: an image of the same size with the position x, y, z of every pixel, as range scanners "
        "and bakers write them. Pixels without a finite position, or with an alpha of 0, are holes.",
        metavar="FILE", is_file=True, of=("images",),
    )  # fmt: skip
    mask: str | None = parameter(
        None,
        "For images: an image of the same size that is 0 at holes. Holes stay unchanged and contribute "
        "nothing, and no kernel crosses them.",
        metavar="FILE", is_file=True, of=("images",),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.height is not None and self.positions is not None:
            raise UsageError("height and positions are two surfaces for one image; give one of them")
        if self.height is None and self.height_scale != ImageSettings.height_scale:
            raise UsageError("height_scale is of the heights that --height names; add --height")


@described
@dataclass(frozen=True)
class LevelSetSettings(Checked):
    """The surface in a volume, and its colours."""

    group: ClassVar[str] = "Level sets"

    iso: float | None = parameter(
        None,
        "For level sets: the value on the surface, such as 0.5 for occupancies.",
        kind=float, unset="as INPUT says, or 0", metavar="VALUE", of=("level sets",),
    )  # fmt: skip
    inside: Inside = parameter(
        "below",
        "For level sets: which values are inside: those below the value of the surface, as of signed "
        "distances, or above it, as of densities. Triangles face outwards.",
        choices=get_args(Inside), of=("level sets",),
    )  # fmt: skip
    colours: str | None = parameter(
        None,
        "For level sets: a file with the colours, on any grid (.nrrd, .npz), or at points or vertices near "
        "the surface (.npz, PLY and all other models).",
        unset="those in INPUT", metavar="FILE", is_file=True, of=("level sets",),
    )  # fmt: skip
    max_voxels: int = parameter(
        1 << 28,
        "For level sets: the largest grid that is read.",
        low=8, high=_MAX_VOXELS, unit="voxels", metavar="COUNT", lifts_limit=True, of=("level sets",),
    )  # fmt: skip


@described
@dataclass(frozen=True)
class EmbeddingSettings(Checked):
    """Further channels of the metric, and smoothing of positions."""

    group: ClassVar[str] = "Guides and geometry"

    guides: tuple[str, ...] = parameter(
        (),
        "Channels that count as distance and stay as they are, such as a clean normal map with a noisy "
        "base colour. For textures a slot of the same materials, or an image of the same size; for images "
        "such an image; for vertices an attribute (normal, or as the file calls it), an array (.npy, .npz) "
        "with a row for each vertex, or a model whose vertex colours guide. May be repeated.",
        flags=("--guide", "guides"), metavar="NAME|FILE", repeatable=True, is_file=True,
    )  # fmt: skip
    guide_betas: tuple[float, ...] = parameter(
        (),
        "Weight of a guide (images have full scale 1, other numbers are not scaled); once for all guides, "
        "or once for each.",
        kind=float, low=0, unit="sample spacings per unit of the guide",
        unset="6 / its standard deviation, less if it is noisy or steep",
        flags=("--guide-beta", "guide_betas"), metavar="B", repeatable=True,
    )  # fmt: skip
    metric_channels: tuple[str, ...] | None = parameter(
        None,
        "Which colour channels enter distances, such as r,g. With none, only the surface and the guides "
        "do.",
        kind=str, several=True, unset="all smoothed channels", metavar="LIST|none", parse=_metric_channels,
    )  # fmt: skip
    smooth_geometry: bool = parameter(
        False,
        "Smooth the positions of vertices along with their colours. Creases are kept by the normals, which "
        "count as distance; open borders stay. Curved parts shrink a little.", of=("vertex colours",),
    )  # fmt: skip
    normal_beta: float | None = parameter(
        None,
        "How strongly --smooth-geometry keeps creases. 0 rounds them off.",
        kind=float, low=0, unit="sample spacings per radian that the normal turns",
        unset="from the noise of the normals", metavar="B", of=("vertex colours",),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.guide_betas and not self.guides:
            raise UsageError("guide_beta is of a guide; add --guide")
        if self.guide_betas and len(self.guide_betas) not in (1, len(self.guides)):
            raise UsageError(
                f"guide_beta has {len(self.guide_betas)} values, but must have one for each guide, or one for all"
            )
        if self.normal_beta is not None and not self.smooth_geometry:
            raise UsageError("normal_beta is of a geometry that is smoothed; add --smooth-geometry")

    @property
    def weighted_guides(self) -> list[tuple[str, float | None]]:
        """Each guide with its beta; None: from the guide."""
        if len(self.guide_betas) == len(self.guides):
            return list(zip(self.guides, self.guide_betas, strict=True))
        return [(guide, self.guide_betas[0] if self.guide_betas else None) for guide in self.guides]


@described
@dataclass(frozen=True)
class SmoothSettings(Checked):
    """All parameters of a smoothing; by default the kernel's parameters are chosen from the data as far as possible."""

    group: ClassVar[str] = "Colours"

    kernel: KernelParameters = part(KernelParameters, lambda: KernelParameters(free=TUNABLE))
    space: Space = parameter(
        "srgb",
        "Colour space of distances and averages: display values, linear light, Oklab, or with data the "
        "stored numbers, for colours that encode something else.",
        choices=get_args(Space),
    )  # fmt: skip
    channels: tuple[str, ...] | None = parameter(
        None,
        "Only these channels, such as r,g; the others stay and do not enter distances. `beltrami info` "
        "shows the names of image channels; the name of a layer of an EXR file stands for its colours. Of PLY files "
        "it may be any scalar of the vertices, such as quality.",
        kind=str, several=True, unset="the colours", metavar="LIST", parse=names_in,
    )  # fmt: skip
    on: Target = parameter(
        "auto",
        "The vertex colours, the textures, or both; auto takes the textures where there are any.",
        choices=get_args(Target), is_daily=True, of=("vertex colours", "textures"),
    )  # fmt: skip
    level_seams: bool = parameter(
        False,
        "First remove exposure steps between the charts of textures, as `beltrami level` does.",
        group="Exposure steps", flags=("--level", "level_seams"), of=("vertex colours", "textures"),
    )  # fmt: skip
    textures: TextureSettings = part(TextureSettings)  # images obey its alpha, jpeg_quality and small, too
    image: ImageSettings = part(ImageSettings)
    level_set: LevelSetSettings = part(LevelSetSettings)
    embedding: EmbeddingSettings = part(EmbeddingSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.space == "oklab" and self.channels is not None:
            raise UsageError("the space oklab mixes the channels, so --channels cannot choose among them")
        if self.space == "oklab" and self.embedding.metric_channels:
            raise UsageError("the space oklab mixes the channels, so --metric-channels can only be none")
        given = self.kernel.given_noise
        if given is not None and given.is_by_level and self.space != "srgb":
            cause = "--noise shot:A,read:B is the noise of sRGB colours; leave out --space, or give a number"
            raise UsageError(cause)

    def input_files(self, source: str | None = None) -> list[str]:
        """Return the files that are named here, besides the one that is smoothed."""
        smoothed = None if source in (None, "-") else Path(str(source)).resolve()
        paths = map(Path, named_files(self))
        return [str(path) for path in paths if is_file(path) and path.resolve() != smoothed]

    @property
    def fits_parts(self) -> bool:
        """Whether textures can be smoothed separately: no map covers all of them."""
        return not self.embedding.guides and not self.input_files()


DEFAULTS = SmoothSettings()


def binding_parameters(settings: SmoothSettings) -> list[Parameter]:
    """Return the given parameters that must have an effect: all but the solver, which does not affect grids."""
    return [each for each in given_parameters(settings) if each.name != "solver"]


def given_values(settings: SmoothSettings) -> dict[str, Any]:
    """Return the values that differ from their defaults, by name; tunable ones unless they are free."""
    given: dict[str, Any] = {}
    for record in (settings, *(getattr(settings, name) for name in parts(settings))):
        for declared in parameters(record):
            name, value = declared.name, getattr(record, declared.name)
            is_closed = value is not None and name not in settings.kernel.free
            if declared.flags and (is_closed if name in TUNABLE else value != declared.default):
                given[name] = value
    return given


def describe_settings(settings: SmoothSettings) -> dict[str, object]:
    return {
        "given": [*given_values(settings)],
        **dataclasses.asdict(settings.kernel),
        "threads": settings.kernel.thread_count,
        **{name: getattr(settings, name) for name in ("space", "channels", "on", "level_seams")},
        **{name: dataclasses.asdict(getattr(settings, name)) for name in parts(settings) if name != "kernel"},
    }
