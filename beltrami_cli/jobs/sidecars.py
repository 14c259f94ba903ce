"""The files that belong to a model beside it, when it is written with other colours."""

from __future__ import annotations

import dataclasses
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import BeltramiError, OutputError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_regular
from beltrami_cli.formats.image.recognition import suffix_for
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.conversion import make_files
from beltrami_cli.surface.records import ImageFile

if TYPE_CHECKING:
    from collections.abc import Iterable

    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.jobs.writing.output import Output
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import SmoothSettings


@dataclass(frozen=True)
class Sidecars:
    """What lies beside an output.

    The source's folder; unchanged files of the source, relative to it, that go along; whether changed files keep the
    names of the source's (`moved` of `Document.patch`); the output's folder, and files in it that something else
    names.
    """

    folder: Path
    references: tuple[str, ...]
    keep_names: bool
    target_folder: Path | None = None
    strangers: frozenset[str] = frozenset()
    notices: tuple[str, ...] = ()

    def complete(self, written: Written, access: Access = EVERYTHING_INSIDE) -> Written:
        """Add the unchanged files that the model still names, and the notices; OutputError as `plan_sidecars`."""
        left = [n for n in self.references if n not in written.sidecars and n not in written.superseded]
        copied = {name: read_regular(self.folder / name, access) for name in left}
        self.check_copies(copied)
        sidecars, notices = {**written.sidecars, **copied}, (*self.notices, *written.notices)
        return dataclasses.replace(written, sidecars=sidecars, notices=notices)

    def check_copies(self, names: Iterable[str]) -> None:
        """Raise OutputError if a file of the source would replace one of something else that is different."""
        folder = self.target_folder
        for name in self.strangers.intersection(names):
            if folder is not None and not _equal(folder / name, self.folder / name):
                raise _in_the_way(folder / name)


def plan_sidecars(
    document: Document,
    selection: Selection,
    settings: SmoothSettings,
    kind: OutputFormat,
    ends: tuple[str, str],
    output: Output | None,
    access: Access,
) -> Sidecars:
    """Plan the files beside the output, and check that they may be written; `ends` are the source and the target.

    In another folder than the source's they keep their names. If that folder has a file of such a name already, which
    is not of the model that OUTPUT replaces, changed files are named after OUTPUT, as they are beside the source.
    OutputError if a file exists and must not be replaced, or would have to give way to one of the same name.
    """
    source, target = ends
    moved = is_moved(source, target)
    references = tuple(document.references()) if moved and kind.is_own else ()
    plan = Sidecars(Path(source).parent, references, moved)
    if output is None:
        return plan
    names = _names(plan, document, selection, settings, kind, target)
    output.check_sidecars(names.keys())
    strangers = _strangers(output, {*names, *references}, target, access) if moved else frozenset()
    if any(names.get(name) for name in strangers):
        others = ", ".join(sorted(name for name in strangers if names.get(name)))
        notice = f"{others} beside OUTPUT is of something else, and stays; what is new is named after OUTPUT."
        plan = dataclasses.replace(plan, keep_names=False, notices=(notice,))
        names = _names(plan, document, selection, settings, kind, target)
        output.check_sidecars(names.keys())
        strangers = _strangers(output, {*names, *references}, target, access)
    plan = dataclasses.replace(plan, target_folder=output.folder, strangers=strangers)
    if output.folder is not None and (blocked := [name for name in strangers if names.get(name)]):
        raise _in_the_way(output.folder / min(blocked))
    plan.check_copies(name for name, is_new in names.items() if not is_new)
    return plan


def _names(
    plan: Sidecars,
    document: Document,
    selection: Selection,
    settings: SmoothSettings,
    kind: OutputFormat,
    target: str,
) -> dict[str, bool]:
    """Find the files that would be written beside the output, by writing the old images anew; True: it is new."""
    from beltrami_cli.samples.texel_samples import choose_textures

    suffix = settings.textures.image_suffix
    images = {
        (slot, texture.key): ImageFile(
            # Other bytes, since what is equal is not written anew; each its own.
            f"new {texture.key}".encode(),
            suffix or suffix_for(texture.data, texture.name) or ".png",
        )
        for slot in selection.slots
        for texture in choose_textures(document.textured(slot), settings.textures).textures
    }
    written = make_files(document, None, images, kind, Path(target).stem, moved=plan.keep_names)
    copied = [name for name in plan.references if name not in written.superseded]
    return dict.fromkeys(copied, False) | dict.fromkeys(written.sidecars, True)


def _strangers(output: Output, names: set[str], target: str, access: Access) -> frozenset[str]:
    """Find which of the names stand for files there that the old OUTPUT does not name."""
    folder = output.folder
    found = frozenset() if folder is None else frozenset(name for name in names if (folder / name).exists())
    if found:
        with suppress(BeltramiError):  # there may be no old OUTPUT, or none that names files
            found -= set(open_document(target, dataclasses.replace(access, note=None)).references())
    return found


def _equal(one: Path, other: Path) -> bool:
    with suppress(OSError):
        return read_regular(one, EVERYTHING_INSIDE) == read_regular(other, EVERYTHING_INSIDE)
    return False


def _in_the_way(path: Path) -> OutputError:
    cause = "is of something else than OUTPUT, and would be replaced by a file of the same name"
    return OutputError(str(path), cause, "choose another folder")


def is_moved(source: str, target: str) -> bool:
    """Tell whether the output lies in another folder than the source."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent
