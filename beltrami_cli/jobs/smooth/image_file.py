"""Smooth an image file: read, sample, iterate, write."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image import (
    WRITABLE,
    check_writable,
    format_of,
    format_of_suffix,
    is_exact,
    is_unchanged,
    label_of,
    losses,
    write_image,
)
from beltrami_cli.jobs.smooth.report import ImageReport, SmoothReport
from beltrami_cli.jobs.smooth.reporting import make_image_report
from beltrami_cli.samples.images.prepare import prepare_image, refuse_options_of_meshes
from beltrami_cli.samples.settings import describe_choice

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.formats.image import Picture
    from beltrami_cli.jobs.smooth.stopwatch import Stopwatch
    from beltrami_cli.jobs.writing.output import Output
    from beltrami_cli.samples.images.prepare import PreparedImage
    from beltrami_cli.samples.settings import SmoothSettings


def smooth_image_file(
    data: bytes,
    source: str,
    target: str,
    settings: SmoothSettings,
    output: Output | None,
    watch: Stopwatch,
    *,
    format: str | None = None,  # noqa: A002 -- the name of the option
    progress: Callable[[str, int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> SmoothReport:
    """Smooth the colours of an image, and change nothing else of its file.

    Parameters
    ----------
    data : bytes
        The file.
    source, target : str
        Paths, or "-". Another extension of `target` converts.
    settings : SmoothSettings
        The kernel's parameters, the working space, the channels, and the surface.
    output : Output or None
        Where to write; None: nowhere.
    watch : Stopwatch
        Measures the stages.
    format : str, optional
        Extension, without its dot, of the format to write where the name of `target` does not tell.
    progress : callable, optional
        Called with a label, the work done so far and the work to do; may raise to stop.
    access : Access
        What may be read.

    Returns
    -------
    SmoothReport

    Raises
    ------
    UsageError
        If the settings contradict the image, or the format cannot be written.
    InputError
        If an image cannot be read or does not fit.
    OutputError
        If the target cannot be written.
    """
    name = "<stdin>" if source == "-" else source
    refuse_options_of_meshes(settings, name)
    suffix = other_format(data, name, target, format)
    report: ImageReport | None = None
    if settings.kernel.iterations == 0 and suffix is None:
        written = Written([data])
    else:
        with watch.stage("read"):
            prepared = prepare_image(data, name, settings, access)
            check_writable(prepared.picture, suffix)
        written, report = _smoothed(prepared, suffix, settings, watch, progress)
    with watch.stage("write"):
        if output is not None:
            output.write(written)
    own = Path(name).suffix or f".{label_of(format_of(data, name) or '')}"
    return make_image_report(
        source,
        target,
        (suffix or own).lower()[1:],
        settings,
        report,
        watch,
        [] if output is None else [target],
        list(written.notices),
    )


def _smoothed(
    prepared: PreparedImage,
    suffix: str | None,
    settings: SmoothSettings,
    watch: Stopwatch,
    progress: Callable[[str, int, int], None] | None,
) -> tuple[Written, ImageReport]:
    """Return the image file with other colours, and what was done to them."""
    with watch.stage("smooth"):
        flow = prepared.flow(settings)
        result = flow.run(None if progress is None else lambda done, total: progress("image", done, total))
        owned, guides = flow.manifold.atlas.owned_texels, flow.manifold.guide_betas
        iterations, colours = flow.parameters.iterations, flow.values()
        del flow  # canvases as large as the pixels that are made now
    with watch.stage("write"):
        pixels, change = prepared.colours.repainted(owned, colours, settings.kernel.thread_count)
        new = _encoded(prepared.picture, pixels, suffix, settings)
    report = ImageReport(
        image=prepared.facts(),
        pitch=result.spacing,
        beta=result.beta,
        iterations=iterations,
        noise=prepared.colours.named(result.sigma),
        samples_per_kernel=round(result.samples_per_kernel, 2),
        guides=guides,
        change=change.summary(),
        choice=describe_choice(result.choice),
    )
    is_copy = new is prepared.picture.source
    return Written([new], notices=_notices(prepared, suffix, is_copy=is_copy)), report


def _encoded(picture: Picture, pixels: NDArray[Any], suffix: str | None, settings: SmoothSettings) -> bytes:
    if suffix is None and is_unchanged(picture, pixels):
        return picture.source
    textures, as_data = settings.textures, settings.space == "data"
    quality, small = textures.jpeg_quality, textures.small
    return write_image(
        picture, pixels, suffix=suffix, jpeg_quality=quality, small=small, as_data=as_data
    ).data


def _notices(prepared: PreparedImage, suffix: str | None, *, is_copy: bool) -> tuple[str, ...]:
    picture = prepared.picture
    told = [notice for notice in prepared.notices if not (is_copy and notice in picture.notices)]
    lost = () if suffix is None else losses(picture, suffix)
    if suffix is None and not prepared.valid.all() and not is_exact(picture):
        lost = (
            f"{picture.name}: {label_of(picture.format)} is not exact, so holes change slightly as well.",
        )
    return (*told, *lost)


def other_format(data: bytes, name: str, target: str, chosen: str | None) -> str | None:
    """Return the extension of the format to write, with its dot; None if it is the source's own.

    Raises
    ------
    UsageError
        If no image format has the extension.
    """
    suffix = f".{chosen}" if chosen else "" if target == "-" else Path(target).suffix
    if not suffix:
        return None
    known = format_of_suffix(suffix)
    if known is None:
        raise UsageError(
            f"{target}: no image format is known for {suffix}; end the name in {', '.join(WRITABLE)}, or say --format"
        )
    return None if known == format_of(data, name) else suffix
