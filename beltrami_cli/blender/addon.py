"""Smooths colours and textures of the active object: the operator, the panel and the preferences.

The command `blender-extension` packs this file as `__init__.py`.
"""

import bpy

from . import parameters
from .errors import ExtensionError
from .run import Run
from .undo import follow_undo, forget


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
        except (ExtensionError, OSError, RuntimeError) as error:
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
        except (ExtensionError, OSError, RuntimeError) as error:
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
        except (ExtensionError, OSError, RuntimeError) as error:
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
