"""The parameters of `beltrami smooth` as properties of a scene, made from what the program has declared."""

import json
from pathlib import Path

import bpy

DECLARED = json.loads(Path(__file__).with_name("parameters.json").read_text(encoding="utf-8"))
_LARGEST = 2**31 - 1


def _property(declared):
    """Return the property of a parameter; text where Blender has no type for it."""
    words = {"name": declared["label"], "description": declared["help"]}
    kind, default = declared["kind"], declared["default"]
    if kind == "bool":
        return bpy.props.BoolProperty(default=default, **words)
    if declared["choices"]:
        items = [(choice, choice.capitalize(), "") for choice in declared["choices"]]
        return bpy.props.EnumProperty(items=items, default=default, **words)
    if kind == "text":
        return bpy.props.StringProperty(default=default or "", **words)
    low = -_LARGEST if declared["low"] is None else declared["low"]
    high = _LARGEST if declared["high"] is None else min(declared["high"], _LARGEST)
    value = min(max(default or 0, low), high)
    if kind == "int":
        return bpy.props.IntProperty(default=int(value), min=int(low), max=int(high), **words)
    return bpy.props.FloatProperty(default=value, min=low, max=high, precision=3, **words)


def is_optional(declared):
    """Whether a number counts only where its box is ticked; otherwise the program finds it."""
    return declared["kind"] in ("int", "float") and (declared["default"] is None or bool(declared["unset"]))


def _annotations():
    found = {}
    for declared in DECLARED["parameters"]:
        found[declared["name"]] = _property(declared)
        if is_optional(declared):
            text = f"{declared['help']} Otherwise: {declared['unset'] or 'not given'}"
            toggle = bpy.props.BoolProperty(name=declared["label"], description=text)
            found[f"gives_{declared['name']}"] = toggle
    return found


class BeltramiParameters(bpy.types.PropertyGroup):
    """All parameters, and the choice of colours."""

    __annotations__ = {
        "target": bpy.props.EnumProperty(
            name="Smooth",
            items=[
                ("IMAGES", "Image Textures", "The active image of each material, or that of its base colour"),
                ("COLOURS", "Colour Attribute", "The active colour attribute of the mesh"),
            ],
        ),
        "saves": bpy.props.BoolProperty(
            name="Save Images",
            description="Also save images that lie on disk; otherwise they stay changed, as after painting",
        ),
        **_annotations(),
    }


def arguments(values):
    """Return command-line options for all values that differ from the defaults and mean something for the target."""
    given, kind = [], "vertex colours" if values.target == "COLOURS" else "textures"
    for declared in DECLARED["parameters"]:
        if kind not in (declared["of"] or [kind]):
            continue
        name, flag, default = declared["name"], declared["flag"], declared["default"]
        value = getattr(values, name)
        if isinstance(value, float):
            value = round(value, 6)  # Blender keeps single precision
        if is_optional(declared):
            given += [flag, str(value)] if getattr(values, f"gives_{name}") else []
        elif declared["kind"] == "bool":
            given += [flag] if value != default else []
        elif value != (default or ""):
            given += [flag, str(value)]
    return given


def draw(layout, values, *, daily):
    """Draw the parameters that matter daily, or the others in their groups."""
    groups = {}
    for declared in DECLARED["parameters"]:
        if declared["daily"] == daily:
            groups.setdefault("" if daily else declared["group"], []).append(declared)
    for group, members in groups.items():
        if group:
            layout.label(text=group)
        column = layout.column(align=True)
        for declared in members:
            if not is_optional(declared):
                column.prop(values, declared["name"])
                continue
            row, gives = column.row(align=True), f"gives_{declared['name']}"
            row.prop(values, gives)
            field = row.row(align=True)
            field.active = getattr(values, gives)
            field.prop(values, declared["name"], text="")
