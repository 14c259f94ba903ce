"""Where modules are imported from: never from the working folder, in which anybody's files may lie.

Imported before everything else, so it imports nothing but what Python has loaded when it starts.
"""

# ruff: noqa: PTH117, PTH120
import os
import sys


def safe_environment() -> dict[str, str]:
    """Return the environment of this process for a child: its path has no working folder and no relative entry."""
    path = {"PYTHONPATH": os.pathsep.join(filter(os.path.isabs, _given())), "PYTHONSAFEPATH": "1"}
    return {**os.environ, **path}


def secure_imports() -> None:
    """Take the working folder and relative entries of PYTHONPATH off the path of this process and its children."""
    given = _given()
    os.environ.update(safe_environment())
    checkout = os.path.dirname(os.path.dirname(__file__))  # which may be the working folder
    try:
        removed = {os.path.realpath(folder) for folder in (os.curdir, *given) if not os.path.isabs(folder)}
        removed -= {os.path.realpath(folder) for folder in (checkout, *filter(os.path.isabs, given))}
        sys.path[:] = [entry for entry in sys.path if os.path.realpath(entry) not in removed]
    except OSError:  # the working folder was removed, so nothing can be imported from it
        return


def _given() -> list[str]:
    return os.environ.get("PYTHONPATH", "").split(os.pathsep)
