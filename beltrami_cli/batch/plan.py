"""Which files a batch is about, and where their results go."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from beltrami_cli.batch.manifest import is_manifest, read_manifest
from beltrami_cli.batch.storage import find_at, is_url, joined, place_of, without_scheme
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.samples.settings.smooth import IMAGE_FORMATS, IMAGE_SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

# What a folder stands for: models and points. Its images may be their textures, and are named by themselves.
MODEL_SUFFIXES = tuple(f".{name}" for name in OUTPUT_FORMATS)
_MAGIC = set("*?[")
_WRITABLE = {*MODEL_SUFFIXES, *IMAGE_SUFFIXES, *(f".{name}" for name in IMAGE_FORMATS)}


@dataclass(frozen=True)
class Request:
    """One file of a batch.

    Attributes
    ----------
    source, target : str
        Where from, where to.
    options : mapping of str to object
        What a manifest says for this file, by the names of options of `smooth`.
    origin : str
        Which line of which manifest that is.
    folder : Path
        What paths among the options are relative to.
    """

    source: str
    target: str
    options: Mapping[str, object] = field(default_factory=dict)
    origin: str = ""
    folder: Path = Path()


def plan(inputs: Iterable[str], out_dir: str, suffix: str, extension: str | None) -> list[Request]:
    """Find the files that inputs stand for, and name their outputs.

    Parameters
    ----------
    inputs : iterable of str
        Files; globs; folders, for all models in them and below; manifests. All but manifests may be URLs.
    out_dir : str
        Folder of the outputs, or its URL. What lies below a folder or the fixed part of a glob keeps its place
        below it.
    suffix : str
        Put between the name and the extension; or, with the extension of a format in it, instead of the extension.
    extension : str or None
        Format of the outputs; None: as the input.

    Returns
    -------
    list of Request

    Raises
    ------
    InputError
        If there is no such file.
    UsageError
        If two outputs are the same file, or an output is its input.
    """
    requests = []
    out_dir = without_scheme(out_dir)
    for text in map(without_scheme, inputs):
        if text == "-":
            raise UsageError("a batch is of files, and - is none; beltrami smooth takes a pipe")
        if is_manifest(text):
            requests += list(_of_manifest(text, out_dir, suffix, extension))
        else:
            requests += [
                Request(source, joined(out_dir, result_name(place, suffix, extension)))
                for source, place in (_found_at if is_url(text) else _found)(text, out_dir)
            ]
    if not requests:
        raise UsageError("there is nothing to do; name files, globs, folders or a manifest")
    requests = list({(each.source, each.target, str(each.options)): each for each in requests}.values())
    _refuse_clashes(requests)
    return requests


def result_name(place: PurePath, suffix: str, extension: str | None) -> PurePath:
    """Return the place of an output below the folder of all, from that of its input."""
    ending = Path(f"x{suffix}").suffix.lower()
    if ending in _WRITABLE and extension is None:
        return place.with_name(place.stem + suffix)
    return place.with_name(place.stem + suffix + (f".{extension}" if extension else place.suffix))


def _found(text: str, out_dir: str) -> Iterator[tuple[str, PurePath]]:
    """Give the files that an input stands for, and their places below the output folder."""
    path, results = Path(text), None if is_url(out_dir) else Path(out_dir)
    if path.is_dir():
        inside = sorted(each for each in path.rglob("*") if each.suffix.lower() in MODEL_SUFFIXES)
        found = [(each, each.relative_to(path)) for each in inside if _is_input(each, path, results)]
    elif path.exists() or not _MAGIC & set(text):
        if not path.is_file():
            raise InputError(text, "there is no such file", "check the path")
        found = [(path, Path(path.name))]
    else:
        root = _fixed_part(path)
        named = sorted(root.glob(str(path.relative_to(root))))
        found = [(each, each.relative_to(root)) for each in named if _is_input(each, root, results)]
    if not found:
        raise InputError(text, "no file that can be smoothed is found there", "check the path")
    yield from ((str(each), place) for each, place in found)


def _found_at(url: str, out_dir: str) -> Iterator[tuple[str, PurePath]]:
    """Do the same for a URL; of a folder, all models."""
    found = [
        (source, place)
        for source, place in find_at(url)
        if (source == url or _MAGIC & set(url) or place.suffix.lower() in MODEL_SUFFIXES)
        and not _is_hidden(place)
        and not (is_url(out_dir) and source.startswith(f"{out_dir.rstrip('/')}/") and source != url)
    ]
    if not found:
        raise InputError(url, "no file that can be smoothed is found there", "check the URL")
    yield from found


def _is_hidden(place: PurePath) -> bool:
    return any(part.startswith(".") for part in place.parts)


def _is_input(path: Path, root: Path, out_dir: Path | None) -> bool:
    """Tell whether a file that was found is meant: results of an earlier run and hidden files are not."""
    hidden = _is_hidden(path.relative_to(root))
    if out_dir is None:
        return path.is_file() and not hidden
    inner, outer = out_dir.resolve(), root.resolve()
    is_result = inner != outer and inner.is_relative_to(outer) and path.resolve().is_relative_to(inner)
    return path.is_file() and not hidden and not is_result


def _fixed_part(pattern: Path) -> Path:
    fixed = next(number for number, part in enumerate(pattern.parts) if _MAGIC & set(part))
    return Path(*pattern.parts[:fixed])


def _of_manifest(text: str, out_dir: str, suffix: str, extension: str | None) -> Iterator[Request]:
    folder = Path(text).parent
    for row in read_manifest(text):
        name = without_scheme(row.input)
        source = name if is_url(name) else str(folder / name)
        if not is_url(source) and not Path(source).is_file():
            raise InputError(source, "there is no such file", f"check {row.origin}")
        own_name = PurePath(name.rpartition("/")[2] if is_url(name) else Path(name).name)
        place = PurePath(row.output) if row.output else result_name(own_name, suffix, extension)
        yield Request(source, joined(out_dir, place), row.options, row.origin, folder)


def _refuse_clashes(requests: Iterable[Request]) -> None:
    known: dict[str, Request] = {}
    for request in requests:
        place = place_of(request.target)
        if place_of(request.source) == place:
            raise UsageError(f"{request.source} would be replaced by its own output; give a --suffix")
        other = known.setdefault(place, request)
        if other is not request:
            raise UsageError(
                f"{other.source} and {request.source} would both become {request.target}; give their folder "
                "instead, or a manifest with outputs"
            )
