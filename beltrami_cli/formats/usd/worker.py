"""The process that runs usd-core: an order comes in by standard input, arrays go out by standard output."""

from __future__ import annotations

import json
import os
import sys
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.surface.worker_process import limit_process

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

MISSING = 77  # exit code where usd-core is not installed


def send(file: IO[bytes], words: object, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an order or an answer."""
    everything: dict[str, Any] = {"words": np.array(json.dumps(words)), **arrays}
    np.savez(file, **everything)


def receive(file: IO[bytes]) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Read what `send` wrote."""
    with np.load(file, allow_pickle=False) as made:
        arrays = {name: made[name] for name in made.files if name != "words"}
        return json.loads(str(made["words"])), arrays


def main() -> None:
    """Carry out an order in a folder of layers."""
    folder, seconds, memory = sys.argv[1:]
    limit_process(int(seconds), int(memory))
    os.chdir(folder)
    # What a library prints must not come between the numbers.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    order, arrays = receive(sys.stdin.buffer)
    try:
        from beltrami_cli.formats.usd import editing

        words, made = editing.TASKS[order["task"]](order, arrays)
    except ImportError as error:
        sys.stderr.write(f"to read USD files, the package usd-core is needed ({error.name})\n")
        sys.exit(MISSING)
    except MemoryError:
        sys.exit("it needs more memory than it may take")
    except Exception as error:  # whatever the library makes of a damaged file
        said = " ".join(str(error).split())
        sys.exit(f"it is damaged, or not understood ({said[:200]})")
    with out:
        send(out, words, made)
    os._exit(0)  # what a library does at the end takes time, and may fail


if __name__ == "__main__":
    main()
