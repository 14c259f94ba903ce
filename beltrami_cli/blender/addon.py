"""Smooths colours and textures of the active object by the installed command `beltrami`.

Nothing but that command is run, on files in a temporary folder, and nothing leaves the machine.
"""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import bpy
import numpy as np

from . import exchange, parameters

_STEP = "beltrami_step"  # of an image: how often it was smoothed, which undo takes back
_kept = {}  # pixels of images in each of their steps, in files: (name, step) -> path
_shown = {}  # the step whose pixels an image has
_folder = None


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
        raise exchange.ExchangeError("beltrami is not found; name it in the preferences of this extension")
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
            kind = exchange.ColourAttribute if values.target == "COLOURS" else exchange.ImageTextures
            self.exchange = kind(item, folder)
            arguments = parameters.arguments(values)
            arguments += ["--space", "data"] if self.exchange.is_data and "--space" not in arguments else []
            self._said = (folder / "said").open("wb+")
            self.process = subprocess.Popen(
                [*start, "smooth", str(folder / "in.ply"), str(folder / "out.ply"), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._said,
                env=os.environ | {"BELTRAMI_PROGRESS": "lines", "BELTRAMI_PARENT": str(os.getpid())},
            )
        except BaseException as error:
            self._temporary.cleanup()
            if isinstance(error, OSError):
                cause = f"{start[0]} cannot be started ({error.strerror}); name it in the preferences of this extension"
                raise exchange.ExchangeError(cause) from error
            raise

    def lines(self):
        """Return what was said so far."""
        return (Path(self._said.name).read_text(encoding="utf-8", errors="replace")).splitlines()

    def progress(self):
        """Return the current stage, and its progress in per cent."""
        shown = [line for line in self.lines() if line.startswith("progress: ")]
        if not shown:
            return "reading", 0
        label, _, share = shown[-1].removeprefix("progress: ").rpartition(" ")
        return label, int(share.rstrip("%"))

    def finish(self):
        """Take the result; return what was said. ExchangeError if the program failed."""
        messages = [line for line in self.lines() if line and not line.startswith("progress: ")]
        try:
            if self.process.returncode:
                raise exchange.ExchangeError(messages[-1] if messages else "beltrami failed")
            before = self._taken()
            for name, pixels in (before or {}).items():
                _remember(bpy.data.images[name], pixels)
            if self._saves:
                for image in self.exchange.images:
                    if image.packed_file is None and image.filepath and image.source == "FILE":
                        exchange.save(image)
        finally:
            self.end()
        folder = Path(self._temporary.name)
        for file in ("in.ply", "out.ply"):
            messages = [line.replace(str(folder / file), self._name) for line in messages]
        return messages

    def _taken(self):
        try:
            return self.exchange.take()
        except (KeyError, RuntimeError, TypeError, ValueError) as error:
            raise exchange.ExchangeError(f"{self._name} was changed meanwhile ({error})") from error

    def end(self):
        """Stop the process, if need be, and remove the files."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._said.close()
        self._temporary.cleanup()


def _remember(image, before):
    """Keep the pixels of an image before and after a step, since Blender's undo leaves pixels as they are."""
    global _folder
    _folder = _folder or tempfile.TemporaryDirectory(prefix="beltrami-undo-")
    step = image.get(_STEP, 0)
    for number, pixels in ((step, before), (step + 1, exchange.pixels_of(image))):
        path = _kept.setdefault((image.name, number), Path(_folder.name) / f"{len(_kept)}.npy")
        np.save(path, pixels)
    image[_STEP] = _shown[image.name] = step + 1


@bpy.app.handlers.persistent
def follow_undo(*_):
    """Give images the pixels of the step that undo or redo went to."""
    for name, shown in list(_shown.items()):
        image = bpy.data.images.get(name)
        step = shown if image is None else image.get(_STEP, 0)
        if step != shown and (name, step) in _kept:
            exchange.set_pixels(image, np.load(_kept[name, step]))
            _shown[name] = step


@bpy.app.handlers.persistent
def forget(*_):
    """Drop what was kept of the images of a file that is closed."""
    global _folder
    _kept.clear()
    _shown.clear()
    if _folder is not None:
        _folder.cleanup()
        _folder = None


class OBJECT_OT_beltrami_smooth(bpy.types.Operator):
    """Smooth the colours of the active object with beltrami, across seams"""

    bl_idname = "object.beltrami_smooth"
    bl_label = "Smooth Colours"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        item = context.active_object
        if item is not None and item.mode == "EDIT":
            cls.poll_message_set("Leave edit mode first")
            return False
        return item is not None and item.type == "MESH"

    def invoke(self, context, event):
        try:
            self._run = Run(context)
        except (exchange.ExchangeError, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(0.2, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self._run.end()
            self._leave(context)
            self.report({"INFO"}, "Stopped; nothing is changed")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._run.process.poll() is None:
            label, percent = self._run.progress()
            context.window_manager.progress_update(percent)
            context.workspace.status_text_set(f"beltrami: {label} {percent} %   (Esc stops it)")
            return {"RUNNING_MODAL"}
        self._leave(context)
        return self._finish(context)

    def execute(self, context):
        try:
            self._run = Run(context)
        except (exchange.ExchangeError, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._run.process.wait()
        return self._finish(context)

    def _leave(self, context):
        manager = context.window_manager
        manager.event_timer_remove(self._timer)
        manager.progress_end()
        context.workspace.status_text_set(None)

    def _finish(self, context):
        try:
            messages = self._run.finish()
        except (exchange.ExchangeError, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for line in messages:
            self.report({"WARNING" if line.startswith("warning: ") else "INFO"}, line)
        context.scene.beltrami_said = messages[-1] if messages else ""
        for area in context.screen.areas if context.screen else ():
            area.tag_redraw()
        return {"FINISHED"}


class VIEW3D_PT_beltrami(bpy.types.Panel):
    bl_label = "Beltrami"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Beltrami"

    def draw(self, context):
        layout, values = self.layout, context.scene.beltrami
        layout.prop(values, "target", text="")
        if values.target == "IMAGES":
            layout.prop(values, "saves")
        parameters.draw(layout, values, daily=True)
        layout.operator(OBJECT_OT_beltrami_smooth.bl_idname, icon="BRUSHES_ALL")
        for part in context.scene.beltrami_said.split(": ", 1)[-1].split(", "):
            layout.label(text=part)


class VIEW3D_PT_beltrami_more(bpy.types.Panel):
    bl_label = "More Parameters"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Beltrami"
    bl_parent_id, bl_options = "VIEW3D_PT_beltrami", {"DEFAULT_CLOSED"}

    def draw(self, context):
        parameters.draw(self.layout, context.scene.beltrami, daily=False)


class BeltramiPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="Command",
        description="The installed beltrami; empty: the one that made this extension, or the one on the path",
        subtype="FILE_PATH",
    )

    def draw(self, context):
        self.layout.prop(self, "command")


_CLASSES = (
    parameters.BeltramiParameters,
    OBJECT_OT_beltrami_smooth,
    VIEW3D_PT_beltrami,
    VIEW3D_PT_beltrami_more,
    BeltramiPreferences,
)
_HANDLERS = (
    (bpy.app.handlers.undo_post, follow_undo),
    (bpy.app.handlers.redo_post, follow_undo),
    (bpy.app.handlers.load_pre, forget),
)


def register():
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.beltrami = bpy.props.PointerProperty(type=parameters.BeltramiParameters)
    bpy.types.Scene.beltrami_said = bpy.props.StringProperty(options={"SKIP_SAVE"})
    for handlers, handler in _HANDLERS:
        handlers.append(handler)


def unregister():
    for handlers, handler in _HANDLERS:
        handlers.remove(handler)
    del bpy.types.Scene.beltrami, bpy.types.Scene.beltrami_said
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
    forget()
