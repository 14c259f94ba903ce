"""The command `beltrami info`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages, printable, show_table
from beltrami_cli.cli.phrases import NO_AREA, counted, lines_on, outliers_in_words
from beltrami_cli.errors import BeltramiError, InputError
from beltrami_cli.formats.files.paths import is_url
from beltrami_cli.layers.reported_noise import noise_size
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.quantities import show_amount
from beltrami_cli.view.noise_in_words import (
    advice_in_words,
    choice_in_words,
    doubt_in_words,
    noise_in_words,
    noise_of,
    reason_in_words,
)

_SUMMARY = 20  # lines
_SHOWN_IMAGES = 6
_NO_SAMPLES = "there are no samples"
_COLUMNS = ("file", "format", "part", "samples", "noise", "n", "t", "beta")


@command("info", sources="FILE...")
@options.as_json
@options.smoothing
@options.reading
@options.verbose
def info(sources: tuple[str, ...], as_json: bool, verbose: int, **smoothing: Any) -> None:
    """Show the coloured parts of FILE, how noisy they are, and what smoothing would do."""
    from beltrami_cli.batch.plan import find_sources
    from beltrami_cli.jobs.inspect import inspect_file
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.jobs.progress import each_with_progress

    settings = options.settings_from(smoothing)
    is_one = len(sources) == 1 and (sources[0] == "-" or is_url(sources[0]) or Path(sources[0]).is_file())
    facts: dict[str, Any] = {}
    rows: list[list[str]] = []
    failures: list[BeltramiError] = []
    names = list(sources) if is_one else find_sources(sources)
    with Messages(quiet=False, verbose=0).progress() as progress:
        for name, own in [(names[0], progress)] if is_one else each_with_progress(names, "files", progress):
            try:
                with options.reading_from(smoothing, name, is_one=is_one) as access:
                    facts = inspect_file(name, settings, Job(access, own))
            except BeltramiError as error:
                if is_one:
                    raise
                failures.append(error)
                continue
            rows += _parts_of(name, facts)
            if as_json:
                click.echo(json.dumps(facts, indent=2 if is_one else None))
    if is_one and not as_json:
        described = _with_choices_in_words(facts, settings)
        for line in lines_on(described) if verbose else _summary(described):
            click.echo(printable(line))
    elif rows and not as_json:
        show_table(_COLUMNS, rows)
    for failure in failures:
        click.echo(printable(f"beltrami: {failure}"), err=True)
    if failures:
        raise InputError(f"{len(failures)} of {len(names)} files", "cannot be described", "see above")


def _parts_of(source: str, facts: dict[str, Any]) -> Iterator[list[str]]:
    surface, image = facts.get("surface") or facts.get("cloud") or {}, facts.get("image", {})
    parts = [(each["slot"], each.get("covered"), each) for each in facts.get("textures", [])]
    if "smooth" in facts:
        pixels = image.get("width", 0) * image.get("height", 0)
        parts.append(("pixels" if image else "vertices", pixels or surface.get("samples"), facts))
    for what, samples, part in parts:
        plan = part.get("smooth") or {}
        iterations = plan.get("iterations")
        yield [
            source,
            str(facts["file"]["format"]),
            what,
            "" if samples is None else str(samples),
            show_amount(noise_size(part)),
            "" if iterations is None else str(iterations),
            *(f"{plan[key]:.3g}" if iterations and plan[key] is not None else "" for key in ("t", "beta")),
        ]


def _summary(facts: dict[str, Any]) -> Iterator[str]:
    """Yield at most 20 lines: each coloured part with its noise and what smoothing it would do, then the notices."""
    rows = [("file", f"{facts['file']['name']}: {', '.join(_size_in_words(facts))}")]
    for slot in facts.get("textures", []):
        charts = f"{slot['covered']} texels in {counted(slot['charts'], 'chart')}"
        rows += [(f"{slot['slot']} textures", f"{counted(len(slot['images']), 'image')}, {charts}")]
        images = slot["images"] if len(slot["images"]) > 1 else []
        rows += [("", f"{each['name']}: {noise_of(each)}") for each in images[:_SHOWN_IMAGES]]
        rows += [("", f"and {len(images) - _SHOWN_IMAGES} more")] if len(images) > _SHOWN_IMAGES else []
        rows += _noise_and_plan(slot)
        if (slot["exposure"] or {}).get("is_exposure"):
            step = show_amount(slot["exposure"]["step"])
            rows.append(("exposure", f"median step {step} at seams; `beltrami level` removes them"))
    if "smooth" in facts:
        colours = facts.get("colours") or facts["image"]
        names = colours.get("smoothed") or colours["channels"]
        kind = "pixels" if "image" in facts else "vertex colours"
        rows += [(kind, f"{', '.join(names)}, stored as {colours['stored']}"), *_noise_and_plan(facts)]
    space = _SUMMARY - len(rows) - 1
    notices = facts["notices"]
    rows += [("note", text) for text in notices[:space]]
    more = f"{len(notices) - space} more notices, and " if len(notices) > space else ""
    width = max(len(label) for label, _ in rows)
    yield from (
        f"{label:<{width}}  {text}" for label, text in [*rows, ("", f"{more}details with -v or --json")]
    )


def _size_in_words(facts: dict[str, Any]) -> Iterator[str]:
    yield str(facts["file"]["format"])
    if image := facts.get("image"):
        yield f"{image['width']} x {image['height']} pixels"
    for part, names in (
        ("surface", {"vertices": "vertex", "triangles": "triangle"}),
        ("cloud", {"points": "point"}),
    ):
        counts = facts.get(part) or {}
        yield from (counted(counts[key], noun) for key, noun in names.items() if key in counts)


def _noise_and_plan(part: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the noise of a part and what smoothing would do to it."""
    if wrong := outliers_in_words(part.get("wrong_samples", {}), "sample"):
        yield "outliers", wrong
    smooth = part["smooth"]
    yield "noise", noise_in_words(part, is_smoothed=smooth["iterations"] > 0)
    choice = (
        smooth.get("choice")
        or f"iterations {smooth['iterations']}, t {smooth['t']:.3g}, beta {smooth['beta']:.3g}"
    )
    yield "smooth", choice


def _with_choices_in_words(facts: dict[str, Any], settings: SmoothSettings) -> dict[str, Any]:
    """Return facts whose parts have a sentence on what smoothing would do, instead of the choice."""
    image: Any = facts.get("image", {"width": 1, "height": 1, "holes": 0})
    samples = image["width"] * image["height"] - image["holes"]
    iterations = (facts.get("smooth") or {}).get("iterations")
    is_flat = facts.get("surface", {}).get("mean_edge_length") == 0 and not iterations
    obstacle = NO_AREA if is_flat else "" if samples else _NO_SAMPLES
    slots = [
        _with_choice_in_words(slot, "" if slot["covered"] else _NO_SAMPLES, settings)
        for slot in facts.get("textures", [])
    ]
    return {**_with_choice_in_words(facts, obstacle, settings), "textures": slots}


def _with_choice_in_words(part: dict[str, Any], obstacle: str, settings: SmoothSettings) -> dict[str, Any]:
    smooth = dict(part.get("smooth") or {})
    if not smooth:  # only textures are smoothed
        return part
    if settings.kernel.iterations:
        smooth["choice"] = f"nothing to smooth: {obstacle}" if obstacle else _choice(part)
    if "samples_per_kernel" in smooth:  # `smooth` gives the mean over all iterations
        smooth["samples_per_kernel"] = f"{smooth['samples_per_kernel']:.5g} in the first iteration"
    return {**part, "smooth": smooth}


def _choice(part: dict[str, Any]) -> str | None:
    """Return a sentence on the choice of parameters; None if all are given."""
    smooth = part["smooth"]
    if "choice" in smooth and smooth["iterations"]:
        return choice_in_words(smooth["choice"])
    if smooth["iterations"]:
        return None
    if doubt_in_words(part, is_smoothed=False):  # which the noise is described by
        return "nothing to smooth"
    return f"nothing to smooth: {reason_in_words(part)}{advice_in_words(part)}"
