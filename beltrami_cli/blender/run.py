"""Runs the installed command `beltrami` on files in a temporary folder; nothing leaves the machine."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import bpy

from . import images, parameters, undo
from .colour_attribute import ColourAttribute
from .errors import ExtensionError
from .image_textures import ImageTextures


def command(context):
    """Return how beltrami is started: as the preferences say, as it was when this was made, or from the path."""
    own = context.preferences.addons.get(__package__)
    if own is not None and own.preferences.command:
        return [bpy.path.abspath(own.preferences.command)]
    made_by = parameters.DECLARED["command"]
    if Path(made_by[0]).is_file():
        return made_by
    found = shutil.which("beltrami")
    if found is None:
        raise ExtensionError("beltrami is not found; name it in the preferences of this extension")
    return [found]


class Run:
    """One smoothing: the process, its files, and how far it is."""

    def __init__(self, context):
        values, item = context.scene.beltrami, context.active_object
        start = command(context)
        self._saves, self._name = values.saves, item.name
        self._temporary = tempfile.TemporaryDirectory(prefix="beltrami-")
        folder = Path(self._temporary.name)
        try:
            kind = ColourAttribute if values.target == "COLOURS" else ImageTextures
            self._target = kind(item, folder)
            arguments = parameters.arguments(values)
            arguments += ["--space", "data"] if self._target.is_data and "--space" not in arguments else []
            self._log = (folder / "log").open("wb+")
            self.process = subprocess.Popen(
                [*start, "smooth", str(folder / "in.ply"), str(folder / "out.ply"), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._log,
                env=os.environ | {"BELTRAMI_PROGRESS": "lines", "BELTRAMI_PARENT": str(os.getpid())},
            )
        except BaseException as error:
            self._temporary.cleanup()
            if isinstance(error, OSError):
                cause = f"{start[0]} cannot be started ({error.strerror}); name it in the preferences of this extension"
                raise ExtensionError(cause) from error
            raise

    def lines(self):
        """Return the messages of the program so far."""
        return Path(self._log.name).read_text(encoding="utf-8", errors="replace").splitlines()

    def progress(self):
        """Return the current stage, and its progress in per cent."""
        shown = [line for line in self.lines() if line.startswith("progress: ")]
        if not shown:
            return "reading", 0
        label, _, share = shown[-1].removeprefix("progress: ").rpartition(" ")
        return label, int(share.rstrip("%"))

    def finish(self):
        """Take the result; return the messages of the program. ExtensionError if it failed."""
        messages = [line for line in self.lines() if line and not line.startswith("progress: ")]
        try:
            if self.process.returncode:
                raise ExtensionError(messages[-1] if messages else "beltrami failed")
            before = self._taken()
            for name, pixels in (before or {}).items():
                undo.remember(bpy.data.images[name], pixels)
            if self._saves:
                for image in self._target.images:
                    if image.packed_file is None and image.filepath and image.source == "FILE":
                        images.save(image)
        finally:
            self.end()
        folder = Path(self._temporary.name)
        for file in ("in.ply", "out.ply"):
            messages = [line.replace(str(folder / file), self._name) for line in messages]
        return messages

    def _taken(self):
        try:
            return self._target.take()
        except (KeyError, RuntimeError, TypeError, ValueError) as error:
            raise ExtensionError(f"{self._name} was changed meanwhile ({error})") from error

    def end(self):
        """Stop the process, if need be, and remove the files."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._log.close()
        self._temporary.cleanup()
