"""The files of a batch, from names, folders, globs, URLs and manifests; and the names of their outputs."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from beltrami_cli.batch.manifest import is_manifest, read_manifest
from beltrami_cli.batch.storage import canonical_name, find, is_glob, joined, without_scheme
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.files.paths import is_file, is_url
from beltrami_cli.formats.registry import KEPT_FORMATS, OUTPUT_FORMATS, READ_ONLY
from beltrami_cli.layers.settings import IMAGE_FORMATS, IMAGE_SUFFIXES

# The files that are taken from a folder: models and points. Its images may be textures, its texts and tables anything:
# both must be named themselves.
_AMBIGUOUS = (".txt", ".csv")
_SUFFIXES = tuple(f".{name}" for name in (*OUTPUT_FORMATS, *KEPT_FORMATS))
_MODELS = {*_SUFFIXES} - {*_AMBIGUOUS}
_CONVERTIBLE = _MODELS | {f".{name}" for name in READ_ONLY}
_WRITABLE = {*_SUFFIXES, *IMAGE_SUFFIXES, *(f".{name}" for name in IMAGE_FORMATS)}


@dataclass(frozen=True)
class Request:
    """One file of a batch."""

    source: str
    target: str
    options: Mapping[str, object] = field(default_factory=dict)  # from a manifest, by name
    origin: str = ""  # the manifest and the line or entry, for messages
    folder: Path = Path()  # to which paths among the options are relative


def plan(inputs: Iterable[str], out_dir: str, suffix: str, extension: str | None) -> list[Request]:
    """Find the files of the inputs, and name their outputs; UsageError if two outputs would be the same file.

    What lies below a folder or the fixed part of a glob keeps its place below `out_dir`. `suffix` is put between name
    and extension, or replaces the extension if it has one of a format. `extension` None: as the input.
    """
    if PurePath(f"x{suffix}").name != f"x{suffix}":
        raise UsageError(
            f"--suffix {suffix} cannot be part of a file name; name outputs in other folders in a manifest"
        )
    requests = []
    out_dir = without_scheme(out_dir)
    is_converted = extension is not None or Path(f"x{suffix}").suffix.lower() in _WRITABLE
    for text in map(without_scheme, inputs):
        if text == "-":
            raise UsageError("a batch takes files, not standard input (-); beltrami smooth reads it")
        if is_manifest(text) and not is_glob(text):
            requests += list(_of_manifest(text, out_dir, suffix, extension))
        else:
            requests += [
                Request(source, joined(out_dir, _result_name(place, suffix, extension)))
                for source, place in _found(text, out_dir, _CONVERTIBLE if is_converted else _MODELS)
            ]
    if not requests:
        raise UsageError("there is nothing to do; name files, globs, folders or a manifest")
    requests = list({(each.source, each.target, str(each.options)): each for each in requests}.values())
    _refuse_clashes(requests)
    return requests


def find_sources(inputs: Iterable[str]) -> list[str]:
    """Return the files of names, folders and globs, each once."""
    return list(dict.fromkeys(source for text in inputs for source, _ in _found(text, None, _MODELS)))


def _result_name(place: PurePath, suffix: str, extension: str | None) -> PurePath:
    """Return the path of an output below the output folder, from the path of its input."""
    ending = Path(f"x{suffix}").suffix.lower()
    if ending in _WRITABLE and extension is None:
        return place.with_name(place.stem + suffix)
    return place.with_name(place.stem + suffix + (f".{extension}" if extension else place.suffix))


def _found(text: str, out_dir: str | None, suffixes: Collection[str]) -> list[tuple[str, PurePath]]:
    """Return the files of an input, and their paths below the output folder, if there is one.

    A folder stands for its files with some suffixes. Hidden files and results of an earlier run are meant only if
    they are named.
    """
    root, found = find(text)
    if root:
        outer = PurePath(canonical_name(root))
        inner = outer if out_dir is None else PurePath(canonical_name(out_dir))
        results = inner if inner != outer and inner.is_relative_to(outer) else None
        found = [
            (source, place)
            for source, place in found
            if (is_glob(text) or place.suffix.lower() in suffixes)
            and not any(part.startswith(".") for part in place.parts)
            and (results is None or not PurePath(canonical_name(source)).is_relative_to(results))
        ]
    if not found:
        raise InputError(text, *_no_files_reason(text))
    return found


def _no_files_reason(text: str) -> tuple[str, str]:
    path = Path(text)
    images = {each.suffix.lower() for each in path.glob("*")} if path.is_dir() else set[str]()
    if images := images & set(IMAGE_SUFFIXES):
        cause = "it holds images and no model; images are not taken from folders, as they may be textures"
        return cause, f"name them by a pattern, such as '{path / f'*{min(images)}'}'"
    return "no file that can be smoothed is found there", "check the path or URL"


def _refuse_clashes(requests: Iterable[Request]) -> None:
    known: dict[str, Request] = {}
    for request in requests:
        place = canonical_name(request.target)
        if canonical_name(request.source) == place:
            raise UsageError(f"{request.source} would be replaced by its own output; give a --suffix")
        other = known.setdefault(place, request)
        if other is not request:
            cause = f"{other.source} and {request.source} would both become {request.target}"
            is_one_folder = PurePath(other.source).parent == PurePath(request.source).parent
            remedy = "name one of them" if is_one_folder else "give their folder"
            raise UsageError(f"{cause}; {remedy} instead, or a manifest with outputs")


def _of_manifest(path: str, out_dir: str, suffix: str, extension: str | None) -> Iterator[Request]:
    folder = Path(path).parent
    for entry in read_manifest(path):
        name = without_scheme(entry.source)
        source = name if is_url(name) else str(folder / name)
        if not is_url(source) and not is_file(source):
            raise InputError(source, "there is no such file", f"check {entry.origin}")
        if entry.target:
            place = _place_below(out_dir, entry.target, entry.origin)
        else:
            file_name = PurePath(name.rpartition("/")[2] if is_url(name) else Path(name).name)
            place = _result_name(file_name, suffix, extension)
        yield Request(source, joined(out_dir, place), entry.options, entry.origin, folder)


def _place_below(out_dir: str, target: str, origin: str) -> PurePath:
    """Return the path of a manifest's output below the output folder; InputError if it is outside."""
    # As in URLs, `..` removes the folder before it, even if that is a symbolic link.
    root = Path("out" if is_url(out_dir) else out_dir).absolute()
    place = PurePath(os.path.relpath(root / target, root))
    if place.parts[:1] == (os.pardir,) or is_url(target) or (is_url(out_dir) and target.startswith("/")):
        raise InputError(origin, f"its output {target} leaves --out-dir", "name one below that")
    return place
