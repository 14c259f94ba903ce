"""The process with usd-core: it carries out the requests of `layers`, in the folder of the layers."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

from beltrami_cli.arrays import Array
from beltrami_cli.formats.files.foreign_library import serve_files
from beltrami_cli.surface.worker_process import Message

_NO_MEMORY = "std::bad_alloc"  # in messages of usd-core


class UsdError(Exception):
    """An error that usd-core reports for a layer."""


def carry_out(request: dict[str, Any], arrays: dict[str, Array]) -> Message:
    # Here, so that `serve_files` reports a package that is not installed.
    from pxr import Tf

    from beltrami_cli.formats.usd import editing, reading

    os.chdir(request["folder"])
    tasks: dict[str, Callable[[Any, dict[str, Array]], Message]] = {
        "read": reading.read, "text": reading.text, "edit": editing.edit, "convert": editing.convert,
    }  # fmt: skip
    try:
        return tasks[request["task"]](request, arrays)
    except Tf.ErrorException as error:
        if _NO_MEMORY in str(error):
            raise MemoryError from error
        raise UsdError(_first_message(str(error), request["folder"])) from error


def _first_message(error: str, folder: str) -> str:
    """Return the first message of an error, without C++ namespaces and the path of the temporary folder."""
    match = re.search(r" at line \d+ in file \S+ : '(.*?)'(?:\s*Error in '|\s*$)", error, re.DOTALL)
    message = error if match is None else match[1]
    return re.sub(r"pxrInternal_\w+::|" + re.escape(f"{folder}{os.sep}"), "", message)


if __name__ == "__main__":
    serve_files(carry_out, "USD", "usd-core")
