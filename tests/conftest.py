"""What of the tests there is for which system, and that how long an example takes is no failure."""

from __future__ import annotations

import sys

from hypothesis import settings

# Another process on the same processors makes any example last.
settings.register_profile("patient", settings(deadline=None))
settings.load_profile("patient")

# Signals, FIFOs, limits of resources, terminals and shells as POSIX has them.
_OF_POSIX = [
    "batch/test_batch_command.py",
    "batch/test_shell_and_make.py",
    "cli/test_memory_option.py",
    "cli/test_smooth_command.py",
    "formats/test_gltf_container.py",
    "hostile",
]

collect_ignore = _OF_POSIX if sys.platform == "win32" else []
