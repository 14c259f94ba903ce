"""A page on which a document is smoothed while its parameters are changed: a part at once, and then the whole.

Two threads work: one smooths the part in view, the other the whole as `smooth` does. Only the latest request of each
page counts; older work ends at its next report of progress.
"""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from queue import Queue
from typing import Any, TypeVar

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.fields import override
from beltrami_cli.formats.image import WRITABLE
from beltrami_cli.formats.image.reading import pictures_kept
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.jobs.file_job import FileReport, open_input
from beltrami_cli.jobs.job import Job, at_intervals
from beltrami_cli.jobs.progress import Share
from beltrami_cli.jobs.recolour import recolour_in_memory
from beltrami_cli.jobs.smooth import Smoothing, SmoothReport, smooth_file, smooth_report
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.pages import LIBRARY, VIEWER_SCRIPTS, asset, rendered
from beltrami_cli.view.parameters import (
    controls,
    given_values,
    plain_settings,
    settings_from,
    used_parameters,
)
from beltrami_cli.view.preview import Focus, Layers, NoPreviewError, Previewer, Shown
from beltrami_cli.view.server import Events, MalformedError, RefusedError
from beltrami_cli.view.settings import RenderSettings
from beltrami_cli.view.views import image_files, require_memory_to_draw

Command = Callable[[SmoothSettings, str], str]
Part = TypeVar("Part")

_SCRIPTS = (LIBRARY, *VIEWER_SCRIPTS, "live.js")
_WITH_PATCHES = " with patches"  # a stage of previews, after that of the kernel alone
_WAIT = 0.5  # seconds after a preview in which the whole is not begun, since another change may follow
_WANTED = 0.1  # seconds of smoothing in a preview
_FIRST_RATE = 4e5  # samples times iterations a second, before any preview was timed
_LEAST, _MOST = 2_000, 400_000  # samples of a preview
_PAUSE = 0.1  # seconds between two messages on progress
_STEPS = 1000  # that progress counts
_PATIENCE = 1.0  # seconds in which work ends
_REACH = 32  # 255ths that are shown brightest first


class SupersededError(Exception):
    """A later request replaces the one that is worked on."""


@dataclass(eq=False)
class _Page:
    """What a page asked for last, and what it shows."""

    events: Events = field(default_factory=Queue)
    number: int = 0
    settings: SmoothSettings | None = None
    layer: int = 0
    focus: Focus | None = None
    asked: float = 0.0
    previewed: int = 0
    done: int = 0
    shown: Shown = field(default_factory=dict)
    chosen: dict[str, float] = field(default_factory=dict)
    chosen_by: tuple[float, str | None] | None = None  # the strength and the noise


class Live:
    """The application of a page server: a document, and the pages that are open on it."""

    def __init__(self, source: str, settings: SmoothSettings, job: Job, command: Command) -> None:
        if source == "-":
            raise UsageError("MODEL is opened again and again, so it must be a file and not a pipe")
        self._source, self._job, self._command = source, job, command
        self._plain = plain_settings(settings)
        self._document = open_input(source, settings, job.access)
        select(self._document, settings)  # raises if nothing is coloured
        require_memory_to_draw([self._document], RenderSettings(), job.access)
        self._layers = Layers(self._document)
        self._previewers: dict[int, Previewer] = {}
        self._rates = {"": _FIRST_RATE, _WITH_PATCHES: _FIRST_RATE / 5}
        self._pages: dict[str, _Page] = {}
        self._changed, self._is_over, self._previews = threading.Condition(), False, 0
        self._saving = threading.Lock()
        self.files: Mapping[str, tuple[str, bytes]] = self._pack(settings)
        works = self._preview_all, self._smooth_all
        self._threads = [threading.Thread(target=work, daemon=True) for work in works]
        for thread in self._threads:
            thread.start()

    def close(self) -> bool:
        """End all work; return whether it has ended, which the choice of parameters does not do at once."""
        with self._changed:
            self._is_over = True
            self._pages.clear()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(timeout=_PATIENCE)
        has_saved = self._saving.acquire(timeout=_PATIENCE)
        return has_saved and not any(thread.is_alive() for thread in self._threads)

    def events_of(self, page: str) -> Events:
        with self._changed:
            return self._pages.setdefault(page, _Page()).events

    def leave(self, page: str) -> None:
        with self._changed:
            self._pages.pop(page, None)
            self._changed.notify_all()

    def answer(self, name: str, request: dict[str, Any]) -> dict[str, Any]:
        if name not in ("change", "save"):
            raise MalformedError
        values, target = _part(request, "values", dict), _part(request, "target", str)
        try:
            settings = settings_from(self._plain, values)
            command = self._command(settings, target)
            if name == "change":
                self._take(request, settings)
                return {"command": command}
            if target == "-":
                raise UsageError("the output must be a file, since the page cannot show it")
            report = self._save(settings, target, overwrite=_part(request, "overwrite", bool))
        except BeltramiError as error:
            raise RefusedError(str(error)) from error
        return {"written": report.written, "warnings": report.warnings, "command": command}

    def _save(self, settings: SmoothSettings, target: str, *, overwrite: bool) -> SmoothReport:
        """Do what `smooth` does, one after the other; at the end of the program nothing half done is left."""

        def progress(*_: object) -> None:
            if self._is_over:
                raise SupersededError

        with self._saving:
            progress()
            job = dataclasses.replace(self._job, overwrite=overwrite, progress=progress)
            return smooth_file(self._source, target, settings, job)

    def _take(self, request: dict[str, Any], settings: SmoothSettings) -> None:
        layer, focus = _part(request, "layer", int), _focus(request)
        with self._changed:
            page = self._pages.get(_part(request, "page", str))
            if page is None or not 0 <= layer < len(self._layers.slots):
                raise MalformedError
            page.number += 1
            page.settings, page.layer, page.focus, page.asked = settings, layer, focus, time.monotonic()
            self._changed.notify_all()

    def _pack(self, settings: SmoothSettings) -> dict[str, tuple[str, bytes]]:
        slots = [slot for slot in self._layers.slots if slot is not None]
        target = _target(self._source)
        page = rendered(
            "view.html", title=self._source, controls=controls(), slots=slots, target=target, scripts=_SCRIPTS
        )
        start = {"values": given_values(settings), "target": target}
        scripts = {script: ("text/javascript", asset(script).encode()) for script in _SCRIPTS}
        return {
            "": ("text/html; charset=utf-8", page.encode(errors="replace")),
            "style.css": ("text/css", asset("style.css").encode()),
            "model.glb": ("model/gltf-binary", self._layers.glb(_REACH)),
            "start.json": ("application/json", json.dumps(start).encode()),
            **scripts,
        }

    def _preview_all(self) -> None:
        with pictures_kept(image_files(self._document)):
            while found := self._next(lambda page: page.previewed < page.number, 0):
                page, request = found
                try:
                    self._preview(page, request)
                except SupersededError:
                    pass
                except Exception as error:  # the error of the whole, which follows, is reported
                    is_known = isinstance(error, NoPreviewError)
                    reason = str(error) if is_known else "the part in view cannot be smoothed alone"
                    page.events.put({"kind": "none", "number": request.number, "reason": reason})
                finally:
                    with self._changed:
                        self._previews -= 1
                        page.previewed, page.asked = max(page.previewed, request.number), time.monotonic()
                        self._changed.notify_all()

    def _smooth_all(self) -> None:
        with pictures_kept(image_files(self._document)):
            while found := self._next(lambda page: page.done < page.number <= page.previewed, _WAIT):
                page, request = found
                try:
                    event = self._smooth(page, request)
                except SupersededError:
                    continue
                except BeltramiError as error:
                    event = {"kind": "failed", "message": str(error)}
                except Exception as error:
                    message = f"unexpected error: {type(error).__name__}: {error}"
                    event = {"kind": "failed", "message": message}
                page.done = request.number
                page.events.put({**event, "number": request.number})

    def _next(self, is_due: Callable[[_Page], bool], wait: float) -> tuple[_Page, _Page] | None:
        """Wait for a page that wants something; return it, and what it wants as it is now; None at the end."""
        with self._changed:
            while not self._is_over:
                due = [page for page in self._pages.values() if page.settings is not None and is_due(page)]
                page = min(due, key=lambda each: each.asked, default=None)
                left = 0.0 if page is None else page.asked + wait - time.monotonic()
                if page is not None and left <= 0:
                    if not wait:
                        self._previews += 1
                    return page, dataclasses.replace(page)
                self._changed.wait(left if page is not None else None)
        return None

    def _check(self, page: _Page, request: _Page) -> None:
        if self._is_over or page.number != request.number or page not in self._pages.values():
            raise SupersededError

    def _preview(self, page: _Page, request: _Page) -> None:
        """Smooth the part in view: by the kernel at once, then with patches if the whole has these."""
        settings = request.settings
        if settings is None or request.focus is None:
            return
        slot, selection = self._layers.slots[request.layer], select(self._document, settings)
        if not (selection.image or (selection.vertices if slot is None else slot in selection.slots)):
            raise NoPreviewError("the colours in view are not smoothed")
        if not settings.kernel.iterations:
            raise NoPreviewError("no iteration is wanted, so nothing changes")
        if request.layer not in self._previewers:
            self._previewers[request.layer] = Previewer(self._document, slot, self._job.access)
        self._preview_part(page, request, self._at_once(settings, page), "")
        if settings.kernel.takes_patches and not settings.embedding.smooth_geometry:
            with_patches = override(self._at_once(settings, page), patches="on")
            self._preview_part(page, request, with_patches, _WITH_PATCHES)

    def _preview_part(self, page: _Page, request: _Page, settings: SmoothSettings, stage: str) -> None:
        assert request.focus is not None
        iterations, began = max(1, settings.kernel.iterations), time.perf_counter()
        budget = int(np.clip(_WANTED * self._rates[stage] / iterations, _LEAST, _MOST))
        focus = self._layers.in_space(request.focus, request.layer)
        previewer = self._previewers[request.layer]
        patches = previewer.smooth(settings, focus, budget, lambda *_: self._check(page, request))
        spent = time.perf_counter() - began
        held = sum(len(patch.rows) for patch in patches)
        rate = held * iterations / max(spent, 1e-3)
        self._rates[stage] = 0.5 * self._rates[stage] + 0.5 * rate
        self._check(page, request)
        events = [self._layers.patched(page.shown, request.layer, patch) for patch in patches]
        shown = {"patches": events, "stage": stage, "seconds": spent, "samples": held}
        page.events.put({"kind": "preview", "number": request.number, **shown})

    def _at_once(self, settings: SmoothSettings, page: _Page) -> SmoothSettings:
        """Return settings without a search: free parameters are as they were chosen last, or by the rule."""
        kernel = settings.kernel
        known = {name: page.chosen[name] for name in kernel.free if name in page.chosen}
        if page.chosen_by == _choosing(settings) and len(known) == len(kernel.free):
            kernel = dataclasses.replace(kernel, **known, free=())  # type: ignore[arg-type]
        else:
            kernel = dataclasses.replace(kernel, fast=True)
        # So few samples gain little by more threads, and wait long for them where the machine is busy.
        kernel = dataclasses.replace(kernel, patches="off", threads=1)
        return dataclasses.replace(settings, kernel=kernel)

    def _smooth(self, page: _Page, request: _Page) -> dict[str, Any]:
        """Smooth the whole as `smooth` does."""
        settings = request.settings
        assert settings is not None
        event = {"kind": "progress", "number": request.number}

        def tell(label: str, done: int, total: int) -> None:
            page.events.put({**event, "label": label, "share": done / total})

        at_times = at_intervals(_PAUSE, tell)

        def show(label: str, share: float) -> None:
            with self._changed:
                while self._previews and not self._is_over:  # these shall not share the processors
                    self._changed.wait()
            self._check(page, request)
            at_times(label, round(_STEPS * share), _STEPS)

        painter = Smoothing.of(settings)
        tell("choosing parameters", 0, 1)
        job = dataclasses.replace(self._job, progress=Share(forward=show))
        result, painted = recolour_in_memory(self._document, settings, painter, job)
        self._check(page, request)
        made = FileReport(input=self._source, output="", format="")
        report = smooth_report(made, painted, settings)
        described = json.loads(json.dumps(dataclasses.asdict(report)))
        choices = [done.report.choice for done in painted if done.report.choice is not None]
        chosen = dict(choices[0]["chosen"]) if choices else {}  # type: ignore[call-overload]
        page.chosen, page.chosen_by = chosen, _choosing(settings)
        patches = self._layers.whole(page.shown, result)
        said = [each for done in painted for each in (*done.warnings, *done.repainted.notices)]
        notices = [*dict.fromkeys([*self._document.notices, *said])]
        levels = [level for each in painted for level in each.report.noise.values()]
        return {
            "kind": "whole",
            "patches": patches,
            "used": rendered("parameters.html", used=used_parameters(described)),
            "chosen": chosen,
            "notices": notices,
            "noise": None if settings.kernel.noise or not levels else f"{255 * np.mean(levels):.1f}/255",
        }


def _part(request: dict[str, Any], name: str, kind: type[Part]) -> Part:
    """Return a part of a request, which must be of a type."""
    value = request.get(name)
    if type(value) is not kind:  # True is no number
        raise MalformedError
    return value


def _focus(request: dict[str, Any]) -> Focus | None:
    if request.get("focus") is None:
        return None
    focus = _part(request, "focus", dict)
    return Focus(
        _vector(focus, "origin"), None if focus.get("direction") is None else _vector(focus, "direction")
    )


def _vector(focus: dict[str, Any], name: str) -> Float64s:
    numbers = _part(focus, name, list)
    if len(numbers) != 3 or not all(type(each) in (int, float) and np.isfinite(each) for each in numbers):
        raise MalformedError
    return np.array(numbers, np.float64)


def _choosing(settings: SmoothSettings) -> tuple[float, str | None]:
    """Return the settings that the choice of parameters depends on."""
    return settings.kernel.strength, settings.kernel.noise


def _target(source: str) -> str:
    """Return the name that a result is first offered to be saved under."""
    path = Path(source)
    is_written = path.suffix.lower().lstrip(".") in OUTPUT_FORMATS or path.suffix.lower() in WRITABLE
    return str(path.with_name(f"{path.stem}-smooth{path.suffix if is_written else '.ply'}"))
