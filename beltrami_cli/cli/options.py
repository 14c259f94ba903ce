"""Every shared option once, with its help; defaults come from the settings records."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, get_args

import click
from click.core import ParameterSource

from beltrami_cli.cli.embedding import GUIDING, MOVING, embedding_from
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import (
    PRESETS,
    Clipping,
    KernelParameters,
    Solver,
    Space,
    Strength,
    Units,
    Weights,
    parameters_with,
)
from beltrami_cli.formats.access import Access
from beltrami_cli.pipeline.memory import limited_memory, memory_of_machine, parse_size
from beltrami_cli.pipeline.settings.bake import DEFAULT_BAKE, BakeSettings
from beltrami_cli.pipeline.settings.image import ImageSettings
from beltrami_cli.pipeline.settings.level_set import MOST_VOXELS, Inside, LevelSetSettings
from beltrami_cli.pipeline.settings.smooth import (
    DEFAULTS,
    IMAGE_FORMATS,
    OUTPUT_FORMATS,
    SLOTS,
    AlphaMode,
    SmoothSettings,
    Target,
    TextureSettings,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


def _size(context: click.Context, parameter: click.Parameter, text: str | None) -> int | None:
    if text is None:
        return None
    try:
        size = parse_size(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is no size such as 500M or 4G") from None
    if size == 0:
        raise click.BadParameter("nothing can be done in no memory")
    return size


_KERNEL, _TEXTURES, _IMAGE, _LEVEL_SET = (
    DEFAULTS.kernel,
    DEFAULTS.textures,
    DEFAULTS.image,
    DEFAULTS.level_set,
)

# A Gaussian of a smaller standard deviation, in sample spacings, has no weight beyond its own sample.
SMALLEST_SCALE = 0.05

iterations = click.option(
    "-n", "--iterations", type=click.IntRange(0), metavar="N",
    help="Kernel iterations; more smooth further. 0 leaves every byte as it is.  [default: chosen from the data]",
)  # fmt: skip
time_step = click.option(
    "-t", "--time-step", "t", type=float, metavar="T",
    help="Time step of an iteration: away from edges it is a Gaussian of variance 2T, in squared sample spacings. "
    "On textures and images the window bounds the kernel, so that it is this Gaussian only if the window holds it: "
    "raise --window for a large T.  [default: chosen from the data]",
)  # fmt: skip
beta = click.option(
    "--beta", type=float, default=_KERNEL.beta, metavar="B",
    help="How strongly edges are kept: sample spacings per unit of colour (full scale 1). 0 is a plain Gaussian "
    "on the surface; 5 to 40 suits strong to slight noise.  [default: chosen from the data]",
)  # fmt: skip
beta_growth = click.option(
    "--beta-growth", type=float, metavar="G",
    help="Multiply beta by G from one iteration to the next: as less noise is left, finer edges count.  [default: "
    "chosen from the data]",
)  # fmt: skip
clipping = click.option(
    "--clipping", type=click.Choice(get_args(Clipping)), default=_KERNEL.clipping, show_default=True,
    help="Where noise was cut off at 0 or full scale, averages are too bright or too dark: restore what they would be "
    "without, or keep them.",
)  # fmt: skip
threshold = click.option(
    "--threshold", type=float, default=_KERNEL.threshold, show_default=True, metavar="K",
    help="Leave out samples whose kernel value is below K.",
)  # fmt: skip
metric_scale = click.option(
    "--metric-scale", type=float, default=_KERNEL.metric_scale, show_default=True, metavar="S",
    help="Take distances from colours smoothed over S sample spacings, so that noise does not make them; the colours "
    "themselves are averaged. 0: never.",
)  # fmt: skip
metric_steps = click.option(
    "--metric-steps", type=click.IntRange(0), metavar="K",
    help="Do so in the first K iterations; the others take distances from the colours as they are.  [default: chosen "
    "from the data]",
)  # fmt: skip
strength = click.option(
    "--strength", type=click.Choice(get_args(Strength)), default=_KERNEL.strength, show_default=True,
    help="Smooth less or more than what is estimated to be closest to the colours without noise. It moves only what is "
    "not given.",
)  # fmt: skip
fast = click.option(
    "--fast", is_flag=True,
    help="Try nothing: what is not given follows a fixed rule for the noise. It takes no time, and results are some "
    "0.2 dB worse on vertices, and 1.1 dB on textures and images. With --beta 0, --preset and --smooth-geometry "
    f"nothing is tried either: there it is -n {_KERNEL.iterations}, -t {_KERNEL.t:g}, --beta-growth "
    f"{_KERNEL.beta_growth:g}, --metric-steps {_KERNEL.metric_steps}.",
)  # fmt: skip
preset = click.option(
    "--preset", type=click.Choice(sorted(PRESETS)),
    help="Parameters as a set, which single options still override. 'paper' is the paper's kernel to the letter: "
    "one iteration, t 0.5, threshold 0.01, a window of 7, on textures and images its parametric fast marching.",
)  # fmt: skip
weights = click.option(
    "--weights", type=click.Choice(get_args(Weights)), default=_KERNEL.weights, show_default=True,
    help="On vertices: count each sample once, or by the surface area that it stands for.",
)  # fmt: skip
units = click.option(
    "--units", type=click.Choice(get_args(Units)), default=_KERNEL.units, show_default=True,
    help="Unit of length of -t and --beta: the local sample spacing, or that of the file, which needs -t. On images, "
    "with or without --height, it is the pixel.",
)  # fmt: skip
max_samples = click.option(
    "--max-samples", type=click.IntRange(1, 2**31 - 1), default=_KERNEL.max_samples, show_default=True, metavar="COUNT",
    help="On vertices: the largest kernel, a guard against a time step that is too large. Warns when it takes effect.",
)  # fmt: skip
solver = click.option(
    "--solver", type=click.Choice(get_args(Solver)), default=_KERNEL.solver, show_default=True,
    help="On vertices: find distances by fast marching, or along straight segments over edges and over one or two "
    "unfolded edges, which is several times faster and closer to the truth. auto takes segments for kernels of a "
    "radius of up to 14 sample spacings (-t below 10), where that is so, and fast marching for larger ones.",
)  # fmt: skip
threads = click.option(
    "--threads", type=click.IntRange(1, 1024), default=_KERNEL.threads, metavar="COUNT",
    help="Threads; the result does not depend on it.  [default: all processors]",
)  # fmt: skip
space = click.option(
    "--space", type=click.Choice(get_args(Space)), default=DEFAULTS.space, show_default=True,
    help="What colour distances and averages are taken in. 'data' takes the stored numbers as they are, for colours "
    "that stand for something else.",
)  # fmt: skip
channels = click.option(
    "--channels", metavar="LIST",
    help="Smooth only these channels, such as r,g; the others stay and do not count. Channels of images have the names "
    "that `beltrami info` shows.",
)  # fmt: skip
on = click.option(
    "--on", type=click.Choice(get_args(Target)), default=DEFAULTS.on, show_default=True,
    help="Smooth the vertex colours, the texture, or both; auto takes the texture where there is one.",
)  # fmt: skip
window = click.option(
    "--window", type=click.IntRange(3, 255), default=_KERNEL.window, show_default=True, metavar="W",
    help="On textures and images: side of the square in which a kernel is looked for, odd, 3 to 15; wider ones are "
    "slow.",
)  # fmt: skip
slots = click.option(
    "--slots", default=",".join(_TEXTURES.slots), show_default=True, metavar="LIST",
    help=f"Textures of which material slots: {', '.join(SLOTS)}. All but the first two are taken as data.",
)  # fmt: skip
materials = click.option(
    "--material", "materials", multiple=True, metavar="GLOB",
    help="Only textures of materials with such a name; may be repeated.",
)  # fmt: skip
texture_names = click.option(
    "--texture", "texture_names", multiple=True, metavar="GLOB",
    help="Only textures with such a file name; may be repeated.",
)  # fmt: skip
alpha = click.option(
    "--alpha", type=click.Choice(get_args(AlphaMode)), default=_TEXTURES.alpha, show_default=True,
    help="Keep the opacity of textures and images, or smooth it with the colours. Invisible texels lend no colour "
    "unless it is smoothed.",
)  # fmt: skip
gutter = click.option(
    "--gutter", default=str(_TEXTURES.gutter), show_default=True, metavar="N|keep",
    help="Refill N texels around every chart, so that lookups across its border see no old noise; or keep them.",
)  # fmt: skip
texture_format = click.option(
    "--texture-format", metavar="EXT",
    help="Write textures as png, jpg, webp, tif, exr ...  [default: each as it was]",
)  # fmt: skip
jpeg_quality = click.option(
    "--jpeg-quality", type=click.IntRange(1, 100), default=_TEXTURES.jpeg_quality, show_default=True,
    help="Quality of JPEG and lossy WebP textures and images; the subsampling stays that of the source.",
)  # fmt: skip
small_png = click.option("--small", is_flag=True, help="Compress PNG files well, which takes longer.")
height = click.option(
    "--height", metavar="FILE",
    help="Of an image: an image of the same size with heights over its plane, which make it the surface (x, y, S h). "
    "Depth images (EXR, 16-bit PNG) do as well. Where a height is no finite number is a hole.",
)  # fmt: skip
height_scale = click.option(
    "--height-scale", type=float, default=_IMAGE.height_scale, show_default=True, metavar="S",
    help="Pixels per unit of --height. Floats are taken as they are, integers as 0 to 1.",
)  # fmt: skip
positions = click.option(
    "--positions", metavar="FILE",
    help="Of an image: an image of the same size with the place x, y, z of every pixel, as range scanners and bakers "
    "write them. Where one is not finite, or has an alpha of 0, is a hole.",
)  # fmt: skip
mask = click.option(
    "--mask", metavar="FILE",
    help="Of an image: an image of the same size that is 0 at holes. They stay as they are, and nothing crosses them.",
)  # fmt: skip
level = click.option(
    "--level", type=float, default=_LEVEL_SET.level, metavar="L",
    help="Of a level set: the value on its surface, such as 0.5 for occupancies.  [default: as INPUT says, or 0]",
)  # fmt: skip
inside = click.option(
    "--inside", type=click.Choice(get_args(Inside)), default=_LEVEL_SET.inside, show_default=True,
    help="Of a level set: which values are inside, below the level as signed distances, or above it as densities. "
    "Triangles face outwards.",
)  # fmt: skip
colours = click.option(
    "--colours", metavar="FILE",
    help="Of a level set: a file with its colours, which may be on a grid of their own (.nrrd, .npz), or at points or "
    "vertices near the surface (.npz, PLY and all other models).  [default: those in INPUT]",
)  # fmt: skip
max_voxels = click.option(
    "--max-voxels", type=click.IntRange(8, MOST_VOXELS), default=_LEVEL_SET.max_voxels, show_default=True,
    metavar="COUNT", help="Of a level set: the largest grid that is read.",
)  # fmt: skip
texture_size = click.option(
    "--texture-size", type=int, default=DEFAULT_BAKE.size, metavar="N",
    help="Longest side of the new texture in texels.  [default: from the triangles, or the old texture]",
)  # fmt: skip
size = click.option(
    "--size", type=int, default=DEFAULT_BAKE.size, metavar="N",
    help="Longest side of a new texture in texels.  [default: two texels along an edge, 256 to 8192]",
)  # fmt: skip
padding = click.option(
    "--padding", type=int, default=DEFAULT_BAKE.padding, show_default=True, metavar="N",
    help="Texels between the charts of a new texture.",
)  # fmt: skip
keep_uv = click.option(
    "--keep-uv", is_flag=True, help="Use the texture coordinates of INPUT rather than make new ones."
)
unwrap = click.option(
    "--unwrap", is_flag=True,
    help="Lay the mesh out on a new texture, put its colours there, and smooth them: for meshes without texture "
    "coordinates, or with hopeless ones. OUTPUT is then a new file with the triangles and the texture.",
)  # fmt: skip
max_unwrap_faces = click.option(
    "--max-unwrap-faces", type=int, default=DEFAULT_BAKE.max_unwrap_faces, show_default=True, metavar="COUNT",
    help="The largest mesh to unwrap. 16 thousand triangles take some 7 s, 82 thousand 2 minutes, and so on.",
)  # fmt: skip
overwrite = click.option(
    "--overwrite", is_flag=True, help="Replace OUTPUT, and the files beside it that it names, if they exist."
)
output_format = click.option(
    "--format", "output_format", type=click.Choice([*OUTPUT_FORMATS, *IMAGE_FORMATS]),
    help="Format of OUTPUT where its name does not tell, as with -.",
)  # fmt: skip
allow_outside = click.option(
    "--allow-outside", is_flag=True,
    help="Also read files that INPUT names beyond its own folder (absolute paths, '..', links). What OUTPUT needs of "
    "them anew goes into its own folder; nothing is written out there.",
)  # fmt: skip
max_memory = click.option(
    "--max-memory", callback=_size, metavar="SIZE",
    help="Take no more memory, such as 500M or 4G: smooth keeps textures that need more in files meanwhile, and all "
    "else that does is refused.  [default: what the machine has]",
)  # fmt: skip
quiet = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
verbose = click.option(
    "-v", "--verbose", count=True, help="Print what is done; twice: also where an error arose."
)

_SMOOTHING = (
    iterations, time_step, beta, beta_growth, threshold, metric_scale, metric_steps, clipping, strength, fast, preset,
    on, space, channels, units, weights, max_samples, window, height, height_scale, positions, mask, level, inside,
    colours, max_voxels, slots, materials, texture_names, alpha, gutter, texture_format, jpeg_quality, small_png,
    *GUIDING, *MOVING, solver, threads,
)  # fmt: skip

# Those of one kernel, which is not written back, and what the others are without being asked for.
_STUDYING = (
    time_step, beta, beta_growth, threshold, metric_scale, metric_steps, preset, on, space, channels, units, weights,
    max_samples, window, height, height_scale, positions, mask, level, inside, colours, max_voxels, slots, materials,
    texture_names, alpha, *GUIDING, solver, threads,
)  # fmt: skip
_UNASKED = {
    "iterations": None,
    "clipping": _KERNEL.clipping,
    "strength": _KERNEL.strength,
    "fast": True,
    "gutter": str(_TEXTURES.gutter),
    "texture_format": _TEXTURES.image_suffix,
    "jpeg_quality": _TEXTURES.jpeg_quality,
    "small": _TEXTURES.small,
}

# Where the value of an option can come from that is not its default.
_BY_DIRECTNESS = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP)

# Options that are parameters of the kernel, under the names that they have there.
_KERNEL_OPTIONS = (
    "iterations", "t", "beta", "beta_growth", "threshold", "weights", "units", "max_samples", "threads", "window",
    "metric_scale", "metric_steps", "clipping", "solver", "strength",
)  # fmt: skip
_LEVEL_SET_OPTIONS = ("level", "inside", "colours", "max_voxels")


def smoothing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that make up `SmoothSettings`."""
    for option in reversed(_SMOOTHING):
        command = option(command)
    return command


def studying(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `smoothing` that bear on a single kernel."""
    for option in reversed(_STUDYING):
        command = option(command)
    return command


def reading(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that `reading_from` takes."""
    return allow_outside(max_memory(command))


@contextmanager
def reading_from(options: dict[str, Any], source: str) -> Iterator[Access]:
    """Give what a job on a file may read, and hold it to its memory, by the options that `reading` adds.

    Raises
    ------
    InputError
        If the job wants more memory.
    """
    size = options.pop("max_memory") or memory_of_machine()
    with limited_memory(size, source):
        yield Access(outside=options.pop("allow_outside"), memory=size)


def unwrapping(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that `unwrapping_from` takes."""
    for option in (max_unwrap_faces, texture_size, unwrap):
        command = option(command)
    return command


def unwrapping_from(options: dict[str, Any]) -> BakeSettings | None:
    """Make the settings of a new texture from the values of the options that `unwrapping` adds; None: none is wanted.

    Raises
    ------
    UsageError
        If a value is out of its range, or a size is given and no new texture is wanted.
    """
    if options["unwrap"]:
        return BakeSettings(size=options["texture_size"], max_unwrap_faces=options["max_unwrap_faces"])
    if options["texture_size"] is not None:
        raise UsageError("--texture-size is of the new texture that --unwrap makes; add --unwrap")
    return None


def settings_from(options: dict[str, Any]) -> SmoothSettings:
    """Make the settings from the values of the options that `smoothing` or `studying` adds.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    options = {**_UNASKED, **options}
    return SmoothSettings(
        kernel=_kernel_from(options),
        space=options["space"],
        channels=None if options["channels"] is None else names_in(options["channels"], "--channels"),
        on=options["on"],
        textures=TextureSettings(
            slots=names_in(options["slots"], "--slots"),
            materials=options["materials"],
            names=options["texture_names"],
            alpha=options["alpha"],
            gutter=gutter_width(options["gutter"]),
            image_suffix=suffix_of(options["texture_format"]),
            jpeg_quality=options["jpeg_quality"],
            small=options["small"],
        ),
        image=ImageSettings(
            height=options["height"],
            height_scale=options["height_scale"],
            positions=options["positions"],
            mask=options["mask"],
        ),
        embedding=embedding_from(options),
        level_set=LevelSetSettings(**{name: options[name] for name in _LEVEL_SET_OPTIONS}),
    )


def _kernel_from(options: dict[str, Any]) -> KernelParameters:
    values: dict[str, Any] = dict(PRESETS[options["preset"]]) if options["preset"] else {}
    for name in _KERNEL_OPTIONS:
        if is_given(name) or name not in values:
            values[name] = options[name]
    if values["units"] == "world" and not is_given("t"):
        raise UsageError("--units world needs -t, in squared units of the file")
    if 0 < values["metric_scale"] < SMALLEST_SCALE:
        scale = values["metric_scale"]
        raise UsageError(f"metric_scale is {scale}, but must be 0, or between {SMALLEST_SCALE} and 3")
    return parameters_with(values, choose=not options["preset"], fast=options["fast"])


def is_given(name: str) -> bool:
    """Tell whether an option was given: on the command line, by a variable of the environment, or in a file.

    What a preset says counts for more than what was given less directly than the preset.
    """
    context = click.get_current_context()
    source, preset = context.get_parameter_source(name), context.get_parameter_source("preset")
    if source not in _BY_DIRECTNESS:
        return False
    if name not in PRESETS.get(context.params.get("preset") or "", {}) or preset not in _BY_DIRECTNESS:
        return True
    return _BY_DIRECTNESS.index(source) <= _BY_DIRECTNESS.index(preset)


def names_in(text: str, option: str) -> tuple[str, ...]:
    """Return the names of a list with commas; UsageError if there are none."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise UsageError(f"{option} names nothing; give names, with commas between them, or leave it out")
    return names


def suffix_of(text: str | None) -> str | None:
    """Return an extension in lower case and with its dot."""
    return None if text is None else "." + text.lower().lstrip(".")


def gutter_width(text: str) -> int | None:
    """Return a number of texels, None for "keep"; UsageError if it is neither."""
    if text == "keep":
        return None
    # Alone, isdigit would let other scripts and ² pass, which int does not take.
    if not (text.isascii() and text.isdigit() and len(text) <= 5):
        raise UsageError(f"gutter is {text}, but must be a number of texels from 0 to 99999, or keep")
    return int(text)
