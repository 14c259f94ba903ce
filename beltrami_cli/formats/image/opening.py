"""Image files as OpenImageIO opens them: by a name, which bytes in memory are given for a while."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.channels import colour_part
from beltrami_cli.formats.image.containers.jpeg import first_image
from beltrami_cli.formats.image.file_formats import FORMATS

_MIN_JPEG_XL = 128  # bytes without which OpenImageIO does not recognise it
UNNAMED = "an image"
_OPEN_FILES = Path("/proc/self/fd")


@contextmanager
def opened(data: bytes, config: Any = None, name: str = UNNAMED) -> Iterator[tuple[Any, Path]]:
    """Open an image file; give an OpenImageIO.ImageInput, or None if that fails, and its path, which errors name."""
    import OpenImageIO

    if data.startswith(FORMATS["jpegxl"].signatures):
        data = data.ljust(_MIN_JPEG_XL, b"\0")
    with scratch_file(first_image(data), name=name) as path:
        arguments = (str(path),) if config is None else (str(path), config)
        file = OpenImageIO.ImageInput.open(*arguments)
        if file is None:
            yield None, path
            return
        try:
            yield file, path
        finally:
            file.close()
            error_of(file)
            error_of(OpenImageIO)


@contextmanager
def scratch_file(data: bytes = b"", name: str = UNNAMED) -> Iterator[Path]:
    """Yield a path to the bytes of a file: in memory on Linux, elsewhere a temporary file.

    Other processes can open it as well.
    """
    if hasattr(os, "memfd_create") and _OPEN_FILES.is_dir():
        descriptor = os.memfd_create("image")
        try:
            path = Path(f"/proc/{os.getpid()}/fd/{descriptor}")
            _fill(path, data, name)
            yield path
        finally:
            with suppress(OSError):  # its content is not needed any more
                os.close(descriptor)
    else:
        from beltrami_cli.surface.temporary_files import temporary_folder

        with temporary_folder() as folder:
            path = folder / "image"
            _fill(path, data, name)
            yield path


def _fill(path: Path, data: bytes, name: str) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        cause = f"there is no room for a copy of its {len(data)} bytes ({error.strerror})"
        raise InputError(name, cause, "free memory, or space for temporary files") from error


def seek_colours(file: Any) -> tuple[dict[str, tuple[str, ...]], int | None]:
    """Go to the part of an EXR file that holds the colours; return the channels of all parts, and its number.

    Deep parts have no channels that can be used. The number is None, and the part the first, if it is ambiguous.
    """
    parts: dict[str, tuple[str, ...]] = {}
    if file.format_name() != "openexr":
        return parts, 0
    while file.seek_subimage(len(parts), 0):
        spec = file.spec()
        label = spec.get_string_attribute("oiio:subimagename") or f"number {len(parts) + 1}"
        parts[label] = () if spec.deep else tuple(spec.channelnames)
    part = colour_part(parts) if len(parts) > 1 else 0
    file.seek_subimage(part or 0, 0)
    return parts, part


def error_of(source: Any) -> str:
    """Return, and clear, the error of OpenImageIO or of one of its objects."""
    try:
        return str(source.geterror())
    except UnicodeDecodeError as error:  # The message quotes bytes of the file.
        return error.object.decode(errors="replace")
