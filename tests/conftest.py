"""What of the tests there is for which system, and that how long an example takes is no failure."""

from __future__ import annotations

import signal
import sys

from hypothesis import settings

# A shell that starts tests in the background has them ignore Ctrl-C, which the commands that they start would inherit.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

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
