"""What a smoothing job is told, with the defaults; light enough for the command line to import."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import TUNABLE, KernelParameters, Space
from beltrami_cli.samples.settings.embedding import EmbeddingSettings
from beltrami_cli.samples.settings.image import ImageSettings
from beltrami_cli.samples.settings.level_set import LevelSetSettings

# What --format can name besides; output names may end in every extension of a format that can be written.
IMAGE_FORMATS = ("png", "jpg", "webp", "tif", "exr", "tga", "bmp", "hdr", "jxl", "jp2", "ppm")

Target = Literal["auto", "vertices", "texture", "both"]
AlphaMode = Literal["keep", "smooth"]
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".exr", ".tga", ".bmp", ".hdr")
SLOTS = ("baseColor", "emissive", "normal", "occlusion", "metallicRoughness")


@dataclass(frozen=True)
class TextureSettings:
    """What smoothing of textures is told.

    Attributes
    ----------
    slots : tuple of str
        Material slots to smooth. Base colour and emissive are colours; the others are taken as data.
    materials, names : tuple of str
        Globs: only textures of these materials, or of these names, are smoothed. Empty: all.
    alpha : {"keep", "smooth"}
        Whether opacity stays, or is smoothed with the colours. Texels of opacity 0 lend no colour if it stays.
    gutter : int or None
        Texels beyond the charts that are filled with what a lookup across the border should see; None: as they are.
    image_suffix : str or None
        Extension of the format that textures are written in; None: each in its own.
    jpeg_quality : int
        1 to 100.
    small : bool
        Whether PNG files are compressed well, which takes long.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """

    slots: tuple[str, ...] = ("baseColor",)
    materials: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    alpha: AlphaMode = "keep"
    gutter: int | None = 16
    image_suffix: str | None = None
    jpeg_quality: int = 98
    small: bool = False

    def __post_init__(self) -> None:
        for slot in self.slots:
            if slot not in SLOTS:
                raise UsageError(f"slots names {slot}, but can name {', '.join(SLOTS)}")
        if self.alpha not in get_args(AlphaMode):
            raise UsageError(f"alpha is {self.alpha}, but must be keep or smooth")
        if self.gutter is not None and self.gutter < 0:
            raise UsageError(f"gutter is {self.gutter}, but must be 0 or more, or keep")
        if self.image_suffix is not None and self.image_suffix not in IMAGE_SUFFIXES:
            raise UsageError(
                f"no image format is known for {self.image_suffix}; choose {', '.join(IMAGE_SUFFIXES)}"
            )
        if not 1 <= self.jpeg_quality <= 100:
            raise UsageError(f"jpeg_quality is {self.jpeg_quality}, but must be between 1 and 100")


@dataclass(frozen=True)
class SmoothSettings:
    """What `smooth` is told.

    Attributes
    ----------
    kernel : KernelParameters
        Iterations, time step, beta and the rest; by default all that can be are chosen from the data.
    space : {"srgb", "linear", "oklab", "data"}
        What colour distances and averages are taken in; "data" takes the stored numbers as they are.
    channels : tuple of str or None
        Names of the channels to smooth, which alone enter the metric unless `embedding` says otherwise; None: all.
        Alpha is always kept.
    on : {"auto", "vertices", "texture", "both"}
        What is smoothed; "auto": the textures, or the vertex colours where there is no texture.
    textures : TextureSettings
        What concerns textures; images obey its alpha, JPEG quality and size of PNG files too.
    image : ImageSettings
        What concerns only images.
    level_set : LevelSetSettings
        What concerns only level sets.
    embedding : EmbeddingSettings
        Guides, which colours enter the metric, and whether positions move.

    Raises
    ------
    UsageError
        If a value is not one of those named, or `space` contradicts `channels`.
    """

    kernel: KernelParameters = field(default_factory=lambda: KernelParameters(free=TUNABLE))
    space: Space = "srgb"
    channels: tuple[str, ...] | None = None
    on: Target = "auto"
    textures: TextureSettings = field(default_factory=TextureSettings)
    image: ImageSettings = field(default_factory=ImageSettings)
    level_set: LevelSetSettings = field(default_factory=LevelSetSettings)
    embedding: EmbeddingSettings = field(default_factory=EmbeddingSettings)

    def __post_init__(self) -> None:
        if self.space not in get_args(Space):
            raise UsageError(f"space is {self.space}, but must be {', '.join(get_args(Space))}")
        if self.on not in get_args(Target):
            raise UsageError(f"on is {self.on}, but must be {', '.join(get_args(Target))}")
        if self.space == "oklab" and self.channels is not None:
            raise UsageError("the space oklab mixes the channels, so --channels cannot choose among them")
        if self.space == "oklab" and self.embedding.metric_channels:
            raise UsageError("the space oklab mixes the channels, so --metric-channels can only be none")

    def files_besides(self, source: str | None = None) -> list[str]:
        """Return the files that are named here, besides the one that is smoothed."""
        image, level_set = self.image, self.level_set
        names = (image.height, image.positions, image.mask, level_set.colours, *self.embedding.guides)
        own = None if source in (None, "-") else Path(str(source)).resolve()
        return [str(name) for name in names if Path(str(name)).is_file() and Path(str(name)).resolve() != own]


DEFAULTS = SmoothSettings()
