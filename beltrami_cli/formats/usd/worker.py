"""The process that runs usd-core, on a folder of layers."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from beltrami_cli.formats.foreign_library import serve

if TYPE_CHECKING:
    from beltrami_cli.arrays import Array


def _carry_out(order: dict[str, Any], arrays: dict[str, Array]) -> tuple[Any, dict[str, Array]]:
    from beltrami_cli.formats.usd import editing

    os.chdir(order["folder"])
    return editing.TASKS[order["task"]](order, arrays)


if __name__ == "__main__":
    serve(_carry_out, "USD", "usd-core")
