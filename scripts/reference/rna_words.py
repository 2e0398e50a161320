"""A property of Blender in words: what it does, its default, its range and unit, and where scripts find it."""

from __future__ import annotations

import re
from math import degrees
from typing import Any

import bpy
from tables import cell

NO_LIMIT = 1e9
"""Beyond this a limit is the type's own, not the setting's."""
INHERITED = (bpy.types.PropertyGroup, bpy.types.AddonPreferences)
UNITS = {"PIXEL": " px", "LENGTH": " m", "ROTATION": "°", "TIME": " s", "TIME_ABSOLUTE": " s", "PERCENTAGE": " %"}


def setting_row(owner: Any, name: str, text: str | None = None) -> tuple[str, str, str, str, str]:
    """Label, what it does, default, range, and where scripts find it."""
    prop = own_properties(owner)[name]
    return cell(text or prop.name), describe(prop), default(prop), limits(prop), f"`{python_path(owner, name)}`"


def own_properties(owner: Any) -> dict[str, bpy.types.Property]:
    """Properties that a class of the add-on declares, by name; one that replaces Blender's own is listed after it."""
    inherited = {prop.identifier: prop for cls in INHERITED for prop in cls.bl_rna.properties}
    declared = owner if isinstance(owner, bpy.types.Struct) else owner.bl_rna
    last = {prop.identifier: prop for prop in declared.properties}
    return {
        name: prop for name, prop in last.items() if prop.description != getattr(inherited.get(name), "description", "")
    }


def describe(prop: bpy.types.Property) -> str:
    """The tooltip, with the choices of a menu that is the same everywhere."""
    words = cell(prop.description)
    if prop.type != "ENUM" or not prop.enum_items_static:
        return words
    choices = [f"*{cell(item.name)}*: {cell(item.description)}" for item in prop.enum_items_static]
    return "<br>".join([words, *choices])


def default(prop: bpy.types.Property) -> str:
    """What it is at the start; nothing for pointers and lists."""
    if prop.type == "BOOLEAN":
        return "on" if prop.default else "off"
    if prop.type in {"INT", "FLOAT"}:
        if prop.is_array:
            return ", ".join(_number(prop, value) for value in prop.default_array)
        return _number(prop, prop.default)
    if prop.type == "STRING":
        return f"`{prop.default}`" if prop.default else ""
    if prop.type == "ENUM":
        names = {item.identifier: item.name for item in prop.enum_items_static}
        return cell(names[prop.default]) if names else ""
    return ""


def limits(prop: bpy.types.Property) -> str:
    """The range that can be typed; where dragging stops earlier, that is not told."""
    if prop.type not in {"INT", "FLOAT"}:
        return ""
    low, high = (value if abs(value) < NO_LIMIT else None for value in (prop.hard_min, prop.hard_max))
    if low is None and high is None:
        return ""
    if high is None:
        return f"from {_number(prop, low)}"
    return f"to {_number(prop, high)}" if low is None else f"{_number(prop, low)} to {_number(prop, high)}"


def python_path(owner: Any, name: str) -> str:
    """How a script names it, from the scene or the window manager on."""
    if isinstance(owner, bpy.types.AddonPreferences):
        return f"preferences.{name}"
    whole = owner.path_from_id(name) if owner.id_data is not owner else name
    whole = re.sub(r"\[[^\]]*\]", "[…]", whole)
    return f"{owner.id_data.bl_rna.identifier.lower().replace('windowmanager', 'window_manager')}.{whole}"


def tooltip(operator: str) -> tuple[str, str]:
    """Label and description of an operator by its name, as `chona.bake`."""
    family, name = operator.split(".")
    rna = getattr(getattr(bpy.ops, family), name).get_rna_type()
    return rna.name, rna.description


def anchor(operator: str) -> str:
    """Where the page of operators has one: MkDocs leaves points out of headings' names."""
    return operator.replace(".", "")


def _number(prop: bpy.types.Property, value: float) -> str:
    digits = prop.precision if prop.type == "FLOAT" else 0
    if prop.unit == "ROTATION":
        value = degrees(value)
    text = f"{value:.{max(digits, 0)}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return text + UNITS.get(prop.subtype if prop.unit == "NONE" else prop.unit, "")
