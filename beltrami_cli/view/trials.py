"""The trials of a sweep, their figures, and the table of these."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

FigureFormat = Literal["csv", "json"]
FIGURES = {
    "psnr": "PSNR, dB",
    "estimated_psnr": "estimated PSNR, dB",
    "estimated_gain": "estimated gain, dB",
    "psnr_near_seams": "PSNR near seams, dB",
    "ssim": "SSIM",
    "delta_e": "Delta E 2000",
}


@dataclass(frozen=True)
class Trial:
    """The result of one set of the swept parameters: figures against a reference if there is one, and estimates."""

    parameters: dict[str, float]
    figures: dict[str, float]

    @property
    def label(self) -> str:
        words = [f"{name} {value:g}" for name, value in self.parameters.items()] or ["default"]
        return ", ".join(words) + (f": {self.figures['psnr']:.2f} dB" if "psnr" in self.figures else "")


def best_of(trials: Sequence[Trial]) -> int | None:
    """Return the index of the trial with the highest PSNR; None without a reference."""
    known = [number for number, trial in enumerate(trials) if "psnr" in trial.figures]
    return max(known, key=lambda number: trials[number].figures["psnr"], default=None)


def columns_of(trials: Sequence[Trial]) -> tuple[list[str], list[str]]:
    parameters = sorted({key for trial in trials for key in trial.parameters})
    return parameters, [key for key in FIGURES if any(key in trial.figures for trial in trials)]


def table_of(trials: Sequence[Trial], kind: FigureFormat | None) -> str:
    if kind == "json":
        return json.dumps([dataclasses.asdict(trial) for trial in trials], indent=2) + "\n"
    parameters, found = columns_of(trials)
    text = io.StringIO()
    writer = csv.DictWriter(text, [*parameters, *found], lineterminator="\n")
    writer.writeheader()
    writer.writerows({**trial.parameters, **trial.figures} for trial in trials)
    return text.getvalue()
