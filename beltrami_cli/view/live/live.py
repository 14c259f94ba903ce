"""A page on which a document is smoothed while parameters are changed: first a preview of a part, then the whole.

Each change is a request of its own, which ends at its next report of progress when the page asks for something else.
"""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.parameters import TUNABLE
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.file_formats import WRITABLE
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.jobs.file_job import FileReport
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.progress import Share, at_intervals
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.jobs.smooth_report import smooth_report
from beltrami_cli.jobs.smoothing import Smoothed, Smoothing
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import SmoothSettings, describe_settings
from beltrami_cli.surface.records import Slot
from beltrami_cli.view.drawing.views import require_memory_to_draw
from beltrami_cli.view.live.controls import CONTROLS, SLIDERS, plain_settings, settings_from, values_of
from beltrami_cli.view.live.layer_view import LayerView
from beltrami_cli.view.live.previews import Focus, obstacle_to
from beltrami_cli.view.live.server import GoneError, MalformedError, PageRequest
from beltrami_cli.view.noise_in_words import noise_of
from beltrami_cli.view.pages.models import ModelWriter
from beltrami_cli.view.pages.rendering import page_with_models, rendered
from beltrami_cli.view.parameter_tables import used_parameters
from beltrami_cli.view.settings import RenderSettings

Command = Callable[[SmoothSettings, str], str]
Value = TypeVar("Value")

_WITH_PATCHES = " with patches"  # stage of previews, after the stage of the kernel alone
# Seconds between a preview and the start of the whole, since another change may follow.
_IDLE_SECONDS = 0.5
_PREVIEW_SECONDS = 0.1  # seconds of smoothing in a preview
_FIRST_RATE = 4e5  # samples times iterations a second, until a preview was timed
_MIN_SAMPLES, _MAX_SAMPLES = 2_000, 400_000  # samples of a preview
_STOP_TIMEOUT = 1.0  # seconds to wait for work to end
_BRIGHTEST_CHANGE = 32  # 255ths: the change that is shown brightest at first


@dataclass(frozen=True)
class _Change:
    """What a page asks for, and the connection on which it is answered."""

    settings: SmoothSettings
    layer: LayerView
    focus: Focus
    page: PageRequest


class Live:
    """Answers the requests of all open pages of a document."""

    def __init__(self, source: str, settings: SmoothSettings, job: Job, command: Command) -> None:
        if source == "-":
            raise UsageError("MODEL is opened again and again, so it must be a file and not a pipe")
        self._source, self._job, self._command = source, job, command
        self._plain = plain_settings(settings)
        document = open_input(source, settings, job.access)
        select(document, settings)  # raises an error if nothing is selected
        require_memory_to_draw([document], RenderSettings(), job.access)
        self._document = document.keeping_images()
        slots: list[Slot | None] = [*self._document.slots()] if self._document.kind != "image" else [None]
        if slots != [None] and self._document.has_vertex_colours():
            slots.append(None)
        writer = ModelWriter(is_live=True)
        self._layers = [LayerView(self._document, slot, writer, number) for number, slot in enumerate(slots)]
        self._rates = {"": _FIRST_RATE, _WITH_PATCHES: _FIRST_RATE / 5}
        # The values chosen last, by strength and noise.
        self._chosen: dict[tuple[float, str | None], dict[str, float]] = {}
        self._previewing, self._smoothing, self._saving = (threading.Lock() for _ in range(3))
        self.files = {
            "": ("text/html; charset=utf-8", self._html(settings)),
            "model.glb": ("model/gltf-binary", writer.glb(_BRIGHTEST_CHANGE)),
        }

    def close(self) -> bool:
        """Wait for work to end; False if that takes too long, as during the choice of parameters."""
        locks = self._previewing, self._smoothing, self._saving
        return all(lock.acquire(timeout=_STOP_TIMEOUT) for lock in locks)

    def answer(self, name: str, request: dict[str, Any], page: PageRequest) -> None:
        if name not in ("change", "save"):
            raise MalformedError
        settings = settings_from(self._plain, _checked(request, "values", dict))
        target = _checked(request, "target", str)
        command = self._command(settings, target)
        if name == "change":
            self._follow(request, settings, command, page)
        else:
            self._save(settings, target, command, page, overwrite=_checked(request, "overwrite", bool))

    def _save(
        self, settings: SmoothSettings, target: str, command: str, page: PageRequest, *, overwrite: bool
    ) -> None:
        """Save a result as `smooth` does, one at a time; no file is left incomplete when the program ends."""
        if target == "-":
            raise UsageError("the output must be a file, since the page cannot show it")
        with self._saving:
            page.require_running()
            job = dataclasses.replace(
                self._job, overwrite=overwrite, progress=lambda *_: page.require_running()
            )
            report = smooth_file(self._source, target, settings, job)
        page.send(written=report.written, warnings=report.warnings, command=command)

    def _html(self, settings: SmoothSettings) -> bytes:
        slots = [layer.slot for layer in self._layers if layer.slot is not None]
        target = _target(self._source)
        start = {"values": values_of(settings), "target": target}
        return page_with_models(
            "view.html", "live.js", {"start": start}, connect="'self'",
            title=self._source, controls=CONTROLS, sliders=SLIDERS, free=TUNABLE, slots=slots, target=target,
        )  # fmt: skip

    def _follow(
        self, request: dict[str, Any], settings: SmoothSettings, command: str, page: PageRequest
    ) -> None:
        """Smooth the part in view, then the whole, until the page sends another request."""
        layer, focus = _checked(request, "layer", int), _focus(request)
        if not 0 <= layer < len(self._layers):
            raise MalformedError
        change = _Change(settings, self._layers[layer], focus, page)
        page.send(kind="accepted", command=command)
        with self._previewing:
            self._preview(change)
        page.wait(_IDLE_SECONDS)
        with self._smoothing:
            self._smooth(change)
        page.wait()

    def _preview(self, change: _Change) -> None:
        """Smooth the part in view: first by the kernel, then with patches if the settings have them."""
        settings, slot = change.settings, change.layer.slot
        try:
            if obstacle := obstacle_to(settings, select(self._document, settings), slot):
                change.page.send(kind="none", reason=obstacle)
                return
            at_once = self._without_search(settings)
            self._preview_part(change, at_once, "")
            if settings.kernel.takes_patches and not settings.embedding.smooth_geometry:
                self._preview_part(change, override(at_once, patches="on"), _WITH_PATCHES)
        except GoneError:
            raise
        except Exception:  # the same error is reported for the whole, which follows
            change.page.send(kind="none", reason="the part in view cannot be smoothed alone")

    def _preview_part(self, change: _Change, settings: SmoothSettings, stage: str) -> None:
        iterations, began = max(1, settings.kernel.iterations), time.perf_counter()
        budget = int(np.clip(_PREVIEW_SECONDS * self._rates[stage] / iterations, _MIN_SAMPLES, _MAX_SAMPLES))
        updates, samples = change.layer.preview(
            settings, change.focus, budget, lambda *_: change.page.require_page()
        )
        spent = time.perf_counter() - began
        self._rates[stage] = 0.5 * self._rates[stage] + 0.5 * samples * iterations / max(spent, 1e-3)
        change.page.require_page()
        change.page.send(kind="preview", updates=updates, stage=stage, seconds=spent, samples=samples)

    def _without_search(self, settings: SmoothSettings) -> SmoothSettings:
        """Return settings without a search: free parameters have the values chosen last, or the ones of `--fast`."""
        kernel = settings.kernel
        chosen = self._chosen.get((kernel.strength, kernel.noise), {})
        known = {name: chosen[name] for name in kernel.free if name in chosen}
        if len(known) == len(kernel.free):
            kernel = dataclasses.replace(kernel, **known, free=())  # type: ignore[arg-type]
        else:
            kernel = dataclasses.replace(kernel, fast=True)
        # So few samples gain little from more threads, and wait long for them on a busy machine.
        kernel = dataclasses.replace(kernel, patches="off", threads=1)
        return dataclasses.replace(settings, kernel=kernel)

    def _smooth(self, change: _Change) -> None:
        """Smooth the whole as `smooth` does, and send it to the page."""
        page, kernel = change.page, change.settings.kernel
        try:
            result, results, notices = self._whole(change)
            described = self._described(results, notices, change.settings)
        except GoneError:
            raise
        except Exception as error:
            is_known = isinstance(error, BeltramiError)
            message = str(error) if is_known else f"unexpected error: {type(error).__name__}: {error}"
            page.send(kind="failed", message=message)
            return
        with self._previewing:
            page.require_page()
            self._chosen[kernel.strength, kernel.noise] = described["chosen"]
            updates = [update for layer in self._layers for update in layer.whole(result)]
            page.send(kind="whole", updates=updates, **described)

    def _described(
        self, results: Sequence[Smoothed], notices: Sequence[str], settings: SmoothSettings
    ) -> dict[str, Any]:
        """Return the chosen and the used parameters, notices and the noise, as the page shows them."""
        parameters = describe_settings(settings)
        report = FileReport(input=self._source, output="", format="", parameters=parameters)
        described = dataclasses.asdict(smooth_report(report, results))
        used = used_parameters(json.loads(json.dumps(described)))
        choices = [done.report.choice for done in results if done.report.choice is not None]
        further = [each for done in results for each in (*done.warnings, *done.stored.notices)]
        reports = [done.report for done in results]
        noisiest = max(reports, key=lambda report: max(report.noise.values(), default=0.0))
        noise = noise_of(dataclasses.asdict(noisiest)) if any(noisiest.noise.values()) else "none"
        return {
            "chosen": dict(choices[0]["chosen"]) if choices else {},  # type: ignore[call-overload]
            "used": rendered("parameters.html", used=used),
            "notices": [*dict.fromkeys([*self._document.notices, *notices, *further])],
            "noise": None if settings.kernel.noise else noise,
        }

    def _whole(self, change: _Change) -> tuple[Document, list[Smoothed], Sequence[str]]:
        page = change.page

        def announce(label: str, done: float, total: float) -> None:
            page.send(kind="progress", label=label, share=done / total)

        at_times = at_intervals(announce)

        def show(label: str, done: float, total: float) -> None:
            with self._previewing:  # so that previews of other pages do not compete for the processors
                page.require_page()
            at_times(label, done, total)

        announce("choosing parameters", 0, 1)
        job = dataclasses.replace(self._job, progress=Share(forward=show))
        return recolour_in_memory(self._document, change.settings, Smoothing.of(change.settings), job)


def _checked(request: dict[str, Any], name: str, kind: type[Value]) -> Value:
    """Return a value of a request, checked to be of a type."""
    value = request.get(name)
    if type(value) is not kind:  # bool is a subclass of int
        raise MalformedError
    return value


def _focus(request: dict[str, Any]) -> Focus:
    """Return the focus of a request: origin (three numbers), and direction (three numbers) if there is one."""
    numbers = _checked(request, "focus", list)
    is_number = [type(each) in (int, float) and np.isfinite(each) for each in numbers]
    if len(numbers) not in (3, 6) or not all(is_number):
        raise MalformedError
    values = np.array(numbers, np.float64)
    return Focus(values[:3], values[3:] if len(values) > 3 else None)


def _target(source: str) -> str:
    path = Path(source)
    is_written = path.suffix.lower().lstrip(".") in OUTPUT_FORMATS or path.suffix.lower() in WRITABLE
    return str(path.with_name(f"{path.stem}-smooth{path.suffix if is_written else '.ply'}"))
