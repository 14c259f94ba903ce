"""The command `beltrami compare`."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command, complete_files
from beltrami_cli.cli.console import Messages, printable, show_table
from beltrami_cli.cli.parameter_options import options_of, record_from
from beltrami_cli.flow.parameters import KernelParameters, Weights
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.layers.settings import SmoothSettings

if TYPE_CHECKING:
    from beltrami_cli.jobs.compare.figures import Figures
    from beltrami_cli.jobs.compare.files import Comparison
    from beltrami_cli.jobs.compare.limits import Verdict
    from beltrami_cli.jobs.writing.output import Output

_COLUMNS = (
    "part", "samples", "PSNR dB", "SSIM", "dE mean", "dE 95 %", "dE worst", "seams: dB", "seams: dE", "jump /255",
)  # fmt: skip
_LIMITS = {
    "min_psnr": ("PSNR", 1.0, " dB"),
    "min_ssim": ("SSIM", 1.0, ""),
    "max_delta_e": ("mean Delta E 2000", 1.0, ""),
    "max_seam_jump": ("colour step over seams beyond the reference's", 255.0, "/255"),
    "max_move": ("largest move of a vertex", 100.0, " % of the model's size"),
}
# The head of JUnit reports, by which they are recognised.
_SUITE = "beltrami compare"
_XML = b'<?xml version="1.0" encoding="utf-8"?>\n'
_JUNIT_HEAD = _XML + f'<testsuite name="{_SUITE}"'.encode()


@command("compare", reference="REFERENCE", test="TEST")
@options_of(Limits)
@options_of(KernelParameters, only=("weights",), changed=options.COMPARED)
@options_of(SmoothSettings, only=options.COLOURS, changed=options.COMPARED)
@options.as_json
@click.option(
    "--map", "map_to", metavar="OUT.png|OUT.ply", shell_complete=complete_files,
    help="Draw where colours differ: a picture, or a mesh of vertices.",
)  # fmt: skip
@click.option(
    "--junit", "junit_to", metavar="FILE.xml", shell_complete=complete_files,
    help="Write a JUnit report, which CI services show, with a test case for each limit and part.",
)  # fmt: skip
@options.writing
def compare(
    reference: str,
    test: str,
    weights: Weights,
    as_json: bool,
    map_to: str | None,
    junit_to: str | None,
    overwrite: bool,
    messages: Messages,
    **values: Any,
) -> int:
    """Measure how much the colours of TEST differ from REFERENCE, and fail beyond given limits."""
    settings = options.compared_from(values)
    from beltrami_cli.jobs.compare.files import compare_files

    limits = record_from(Limits, values)
    replaced = options.overwrite_at("map_to", overwrite=overwrite)
    junit = None if junit_to is None else _open_junit(junit_to, (reference, test), overwrite=overwrite)
    with options.job_from(values, reference, messages) as job:
        comparison = compare_files(
            reference, test, limits, settings, weights=weights, map_to=map_to, overwrite=replaced, job=job
        )
    if junit is not None:
        from beltrami_cli.formats.changes import Written

        junit.write(Written(main=[_junit(comparison)]))
    if as_json:
        click.echo(json.dumps(asdict(comparison), indent=2))
    elif not messages.quiet:
        _show(comparison)
    for notice in comparison.notices:
        messages.warn(notice)
    if map_to is not None:
        bright = f"bright yellow is a Delta E of {comparison.map_scale:.3g}"
        messages.say(f"{map_to}: {bright}, grey is not compared")
    for verdict in comparison.limits:
        if not verdict.kept:
            click.echo(printable(f"beltrami: {test}: {_describe(verdict)}"), err=True)
    return 0 if comparison.passed else 1


def _open_junit(path: str, reads: tuple[str, str], *, overwrite: bool) -> Output:
    """Check that a JUnit report can be written, before anything is computed."""
    from beltrami_cli.jobs.writing.output import Output

    return Output(
        path, overwrite=options.overwrite_at("junit_to", overwrite=overwrite), what="JUnit report",
        is_own=lambda head: head.startswith(_JUNIT_HEAD), is_text=True, reads=reads,
    )  # fmt: skip


def _junit(comparison: Comparison) -> bytes:
    """Encode the verdicts as a test suite, with a test case for each; without limits it is empty."""
    from xml.etree import ElementTree

    broken = [verdict for verdict in comparison.limits if not verdict.kept]
    counts = {"tests": str(len(comparison.limits)), "failures": str(len(broken))}
    suite = ElementTree.Element("testsuite", {"name": _SUITE, **counts})
    for verdict in comparison.limits:
        name = f"{verdict.part}: {_LIMITS[verdict.limit][0]}"
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": printable(comparison.test), "name": printable(name)}
        )
        if not verdict.kept:
            ElementTree.SubElement(case, "failure", {"message": printable(_describe(verdict))})
    return _XML + bytes(ElementTree.tostring(suite, encoding="utf-8")) + b"\n"


def _show(comparison: Comparison) -> None:
    rows = [_row(part["name"], part, is_identical=part["identical"]) for part in comparison.parts]
    if len(rows) > 1:
        rows.append(_row("all", comparison.overall))
    show_table(_COLUMNS, rows)
    worst = comparison.overall["worst"]
    if worst is not None and worst["error"] > 0:
        click.echo(printable(f"worst sample: {_worst(worst)}"))
    around = comparison.overall["around_charts"]
    if around is not None and around["worst"] > 0:
        off = f"PSNR {around['psnr']:.2f}, off by up to {255 * around['worst']:.1f}/255"
        click.echo(f"in the gutter: {around['samples']} texels that faces look up, {off}")
    if comparison.geometry is not None and comparison.geometry.is_rounding:
        click.echo("geometry: equal")
    for verdict in comparison.limits:
        click.echo(printable(f"{'ok' if verdict.kept else 'BROKEN':>6}  {_describe(verdict)}"))


def _describe(verdict: Verdict) -> str:
    name, scale, unit = _LIMITS[verdict.limit]
    measured = "infinite" if verdict.measured is None else f"{scale * verdict.measured:.4g}{unit}"
    word = "at least" if verdict.limit.startswith("min") else "at most"
    return f"{verdict.part}: {name} {measured}, allowed {word} {scale * verdict.allowed:.4g}{unit}"


def _row(name: str, part: Figures, *, is_identical: bool = False) -> list[str]:
    delta_e, near, jump = part["delta_e"], part["near_seams"], part["seam_jump"]
    if is_identical:
        return [name, str(part["samples"] or "-"), "identical", *["-"] * (len(_COLUMNS) - 3)]
    looks = [None] * 3 if delta_e is None else [delta_e["mean"], delta_e["p95"], delta_e["worst"]]
    psnrs = [
        "-" if each is None or not each["samples"] else _number(each["psnr"], "{:.2f}", "equal")
        for each in (part, near)
    ]
    return [
        name, str(part["samples"]), psnrs[0], _number(part["ssim"], "{:.4f}"),
        *(_number(each, "{:.2f}") for each in looks),
        psnrs[1], _number(None if near is None else near["delta_e"], "{:.2f}"),
        _number(None if jump is None else 255 * jump["change"], "{:+.2f}"),
    ]  # fmt: skip


def _number(value: float | None, form: str, missing: str = "-") -> str:
    return missing if value is None else form.format(value)


def _worst(worst: dict[str, Any]) -> str:
    is_vertex = "vertex" in worst
    place = f"vertex {worst['vertex']}" if is_vertex else f"{worst['part']} at {worst['x']},{worst['y']}"
    before, after = ([f"{255 * value:.0f}" for value in worst[which]] for which in ("reference", "test"))
    looks = "" if worst["delta_e"] is None else f", Delta E {worst['delta_e']:.1f}"
    change = f"({', '.join(before)}) became ({', '.join(after)})"
    return f"{place}, off by {255 * worst['error']:.1f}/255{looks}: {change}"
