"""Phrases of messages: counts with nouns, names of outputs, and facts of reports as lines."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from typing import Any

from beltrami_cli.quantities import show_amount
from beltrami_cli.view.noise_in_words import choice_in_words, reading_in_words

_LABELS = {"pitch": "distance of neighbouring samples", "patches": "share from similar patches"}
NO_AREA = "no face has an area"


def counted(number: int, noun: str) -> str:
    plural = f"{noun[:-2]}ices" if noun.endswith("vertex") else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"


def outliers_in_words(found: dict[str, Any], noun: str) -> str:
    """Return a sentence on outliers and their treatment; empty if there were none."""
    if not found:
        return ""
    done = "replaced" if found["replaced"] else "kept"
    return f"{counted(found['count'], f'wrong {noun}')} ({100 * found['share']:.2g} %) {done}"


def output_name(path: str) -> str:
    return "<stdout>" if path == "-" else path


def head_of_result(path: str, *, dry_run: bool) -> str:
    """Return what a message on OUTPUT begins with."""
    return f"{output_name(path)}: {'not written (dry run), ' if dry_run else ''}"


def lines_on(facts: dict[str, Any]) -> Iterator[str]:
    """Yield a line for each fact, or of a report for each figure; what belongs together is indented below its name."""
    shown = {label_of(key): value for key, value in facts.items() if not _is_empty(value)}
    if isinstance(shown.get("choice"), dict):
        shown["choice"] = choice_in_words(shown["choice"])
    if isinstance(shown.get("reading"), dict):
        shown["reading"] = reading_in_words(shown["reading"])
    width = max((len(label) for label, value in shown.items() if not _parts_in(value)), default=0)
    for label, value in shown.items():
        if label == "notices":
            yield from (label, *(f"  {text}" for text in value))
            continue
        for part in _parts_in(value):
            yield label
            yield from (
                f"  {line}" for line in lines_on(_with_noise_in_words(part) if "noise" in label else part)
            )
        if not _parts_in(value):
            yield f"{label:<{width}}  {_in_words(value)}"


def label_of(key: str) -> str:
    return _LABELS.get(key, key.replace("_", " "))


def _is_empty(value: Any) -> bool:
    return value is None or (isinstance(value, Sized) and not len(value))


def _parts_in(value: Any) -> list[dict[str, Any]]:
    """Return the records of a value: itself, or its items."""
    values = value if isinstance(value, list) else [value]
    return values if all(isinstance(each, dict) for each in values) else []


def _with_noise_in_words(values: dict[str, float]) -> dict[str, str]:
    return {
        name: f"{value:.1f} samples" if name == "grain" else show_amount(value)
        for name, value in values.items()
    }


def _in_words(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(
            f"({_in_words(each)})" if isinstance(each, list) else _in_words(each) for each in value
        )
    return f"{value:.5g}" if isinstance(value, float) else str(value)
