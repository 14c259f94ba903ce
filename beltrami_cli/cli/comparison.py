"""A comparison as tables: drawn on a terminal, plain otherwise."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.cli.console import printable

if TYPE_CHECKING:
    from beltrami_cli.jobs.compare.files import Comparison
    from beltrami_cli.jobs.compare.limits import Verdict

_COLUMNS = (
    "part", "samples", "PSNR dB", "SSIM", "dE mean", "dE 95 %", "dE worst", "seams: dB", "seams: dE", "jump /255",
)  # fmt: skip


def show(comparison: Comparison) -> None:
    """Print the figures of all parts, the worst sample, and how the limits were kept."""
    rows = [_row(part["name"], part) for part in comparison.parts]
    if len(rows) > 1:
        rows.append(_row("all", comparison.overall))
    _table(_COLUMNS, rows)
    worst = comparison.overall["worst"]
    if worst is not None and worst["error"] > 0:
        click.echo(printable(f"worst sample: {_worst(worst)}"))
    for verdict in comparison.limits:
        click.echo(printable(f"{'ok' if verdict.kept else 'BROKEN':>6}  {describe(verdict)}"))


def describe(verdict: Verdict) -> str:
    """Tell what was measured, and what was allowed."""
    scale, unit = {"min_psnr": (1.0, " dB"), "max_seam_jump": (255.0, "/255")}.get(verdict.limit, (1.0, ""))
    measured = "infinite" if verdict.measured is None else f"{scale * verdict.measured:.4g}{unit}"
    word = "at least" if verdict.limit.startswith("min") else "at most"
    name = {
        "min_psnr": "PSNR",
        "min_ssim": "SSIM",
        "max_delta_e": "mean Delta E 2000",
        "max_seam_jump": "colour step over seams beyond the reference's",
    }[verdict.limit]
    return f"{verdict.part}: {name} {measured}, allowed {word} {scale * verdict.allowed:.4g}{unit}"


def _row(name: str, part: dict[str, Any]) -> list[str]:
    looks, near, jump = part["delta_e"], part["near_seams"], part["seam_jump"]
    psnr = (
        _number(part["psnr"], "{:.2f}") if part["psnr"] is not None else "equal" if part["samples"] else "-"
    )
    near_psnr = "-" if near is None else "equal" if near["psnr"] is None else f"{near['psnr']:.2f}"
    return [
        name,
        str(part["samples"]),
        psnr,
        _number(part["ssim"], "{:.4f}"),
        *(_number(None if looks is None else looks[key], "{:.2f}") for key in ("mean", "p95", "worst")),
        near_psnr,
        _number(None if near is None else near["delta_e"], "{:.2f}"),
        _number(None if jump is None else 255 * jump["change"], "{:+.2f}"),
    ]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _worst(worst: dict[str, Any]) -> str:
    place = (
        f"vertex {worst['vertex']}" if "vertex" in worst else f"{worst['part']} at {worst['x']},{worst['y']}"
    )
    colours = (", ".join(f"{255 * value:.0f}" for value in worst[which]) for which in ("reference", "test"))
    looks = "" if worst["delta_e"] is None else f", Delta E {worst['delta_e']:.1f}"
    return (
        f"{place}, off by {255 * worst['error']:.1f}/255{looks}: {' became '.join(f'({c})' for c in colours)}"
    )


def _table(head: tuple[str, ...], rows: list[list[str]]) -> None:
    rows = [[printable(cell) for cell in row] for row in rows]
    if sys.stdout.isatty():
        from rich import box
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for number, name in enumerate(head):
            table.add_column(name, justify="right" if number else "left", overflow="fold")
        for row in rows:
            table.add_row(*map(Text, row))
        Console().print(table)
        return
    widths = [max(len(row[number]) for row in (list(head), *rows)) for number in range(len(head))]
    for row in (list(head), *rows):
        first, *others = (
            cell.rjust(width) if number else cell.ljust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        click.echo("  ".join([first, *others]))
