"""The command `beltrami`, also as ``python -m beltrami_cli``."""

# ruff: noqa: E402
from beltrami_cli.import_path import secure_imports

secure_imports()  # before anything else is imported

import signal
import sys
import warnings

# Warnings of libraries name lines of source, which users cannot act on; messages say all that matters.
if not sys.warnoptions:
    warnings.simplefilter("ignore")

# While modules are loaded, Ctrl-C ends the process as it ends any other; later `main` says what it did.
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from beltrami_cli.cli.main import main

if __name__ == "__main__":
    main()
