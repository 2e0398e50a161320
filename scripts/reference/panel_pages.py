"""The page of all panels: in the sidebar's order, each with its settings, lists and buttons."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
from recorder import Button, Rows, Setting, shown_in
from rna_words import anchor, default, describe, limits, own_properties, python_path, setting_row, tooltip
from tables import cell, table

from chona_blender import panels
from chona_blender.preferences import CHONA_AP_preferences

TITLE = """# Panels and settings

Everything in the sidebar of the 3D view (N), tab **CHONA**, from top to bottom, and the preferences. *Python* is how a
script names a setting: `scene` is `bpy.context.scene`, `preferences` those of the add-on. Folders may begin with `//`,
the folder of the .blend file."""
SETTINGS = ("Setting", "What it does", "Default", "Range", "Python")


def panels_page() -> tuple[str, set[str]]:
    """The page, and the names of the operators on it."""
    parts, shown_settings, shown_operators = [TITLE], set(), set()
    for panel in in_order():
        found = shown_in(panel)
        parent = next((other for other in all_panels() if other.__name__ == getattr(panel, "bl_parent_id", "")), None)
        title = panel.bl_label if parent is None else f"{parent.bl_label} ▸ {panel.bl_label}"
        parts += [f"## {title}", sentence(panel.__doc__), *_shown(found)]
        shown_operators |= {each.operator for each in found if isinstance(each, Button)}
        shown_settings |= {named for each in found for named in _settings_of(each)}
    rows = [
        (cell(prop.name), describe(prop), default(prop), limits(prop), f"`preferences.{prop.identifier}`")
        for prop in own_properties(CHONA_AP_preferences).values()
    ]
    parts += ["## Preferences", sentence(CHONA_AP_preferences.__doc__), table(SETTINGS, rows)]
    rest = [
        setting_row(owner, prop.identifier)
        for owner in setting_groups()
        for prop in own_properties(owner).values()
        if (owner.bl_rna.identifier, prop.identifier) not in shown_settings
        and prop.type not in {"COLLECTION", "POINTER"}
        and not prop.is_hidden
    ]
    if rest:
        parts += ["## In no panel", "Shown elsewhere in Blender, or for scripts.", table(SETTINGS, rest)]
    return "\n\n".join(part for part in parts if part) + "\n", shown_operators


def all_panels() -> list[type[bpy.types.Panel]]:
    """Panels as registered."""
    return [cls for cls in panels.CLASSES if issubclass(cls, bpy.types.Panel)]


def in_order() -> Iterator[type[bpy.types.Panel]]:
    """Panels as the sidebar shows them: those inside others after them."""

    def with_children(panel: type[bpy.types.Panel]) -> Iterator[type[bpy.types.Panel]]:
        yield panel
        for child in all_panels():
            if getattr(child, "bl_parent_id", "") == panel.__name__:
                yield from with_children(child)

    tops = [panel for panel in all_panels() if not getattr(panel, "bl_parent_id", "")]
    for panel in sorted(tops, key=lambda each: getattr(each, "bl_order", 0)):
        yield from with_children(panel)


def setting_groups() -> list[Any]:
    """The scene's settings and every group of them that they point to, furnished."""
    settings = bpy.context.scene.chona
    groups = [settings]
    for prop in own_properties(settings).values():
        value = getattr(settings, prop.identifier)
        if prop.type == "POINTER" and isinstance(value, bpy.types.PropertyGroup):
            groups.append(value)
        if prop.type == "COLLECTION" and len(value):
            groups.append(value[0])
    return groups


def sentence(doc: str | None) -> str:
    """The first paragraph of a docstring."""
    return cell((doc or "").partition("\n\n")[0])


def _settings_of(shown: Setting | Button | Rows) -> set[tuple[str, str]]:
    """Class and name of what is told with something that is shown."""
    if isinstance(shown, Button):
        return set()
    own = {(shown.owner.bl_rna.identifier, shown.name)}
    if isinstance(shown, Rows):
        row = shown.owner.bl_rna.properties[shown.name].fixed_type
        own |= {(row.identifier, name) for name in own_properties(row)}
    return own


def _shown(found: list[Setting | Button | Rows]) -> list[str]:
    settings = [setting_row(each.owner, each.name, each.text) for each in found if isinstance(each, Setting)]
    parts = [table(SETTINGS, settings)] if settings else []
    for each in found:
        if isinstance(each, Rows):
            parts += _list(each)
    buttons = [
        (_label(each), cell(tooltip(each.operator)[1]), f"[`{each.operator}`](operators.md#{anchor(each.operator)})")
        for each in found
        if isinstance(each, Button)
    ]
    return parts + ([table(("Button", "What it does", "Operator"), buttons)] if buttons else [])


def _label(button: Button) -> str:
    """As the button is written, unless it tells the present frames or names after the operator's own label."""
    label = tooltip(button.operator)[0]
    return cell(label if button.text is None or button.text.startswith(label) else button.text)


def _list(rows: Rows) -> list[str]:
    prop = rows.owner.bl_rna.properties[rows.name]
    path = python_path(rows.owner, rows.name)
    columns = [
        (cell(each.name), describe(each), default(each), limits(each), f"`{path}[…].{each.identifier}`")
        for each in own_properties(prop.fixed_type).values()
        if not each.is_hidden and each.type != "COLLECTION"
    ]
    return [f"List **{cell(prop.name)}**: {cell(prop.description)}. Each row has:", table(SETTINGS, columns)]
