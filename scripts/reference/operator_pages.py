"""The page of all operators, for scripts and the search (F3)."""

from __future__ import annotations

import bpy
from rna_words import default, describe, limits, tooltip
from tables import cell, table

from chona_blender import registration

TITLE = """# Operators

For scripts, keymaps and the search (F3): `bpy.ops.chona.bake()` does what the button does. Without a window an operator
works until it has ended; in one it runs beside Blender where it takes long, and *Esc* cancels it."""


def operators_page(in_panels: set[str]) -> str:
    """Every operator with its properties; those that no panel shows are named as such."""
    parts = [TITLE]
    classes = [cls for cls in registration.CLASSES if issubclass(cls, bpy.types.Operator)]
    for cls in sorted(classes, key=lambda each: each.bl_idname):
        label, words = tooltip(cls.bl_idname)
        where = "" if cls.bl_idname in in_panels else " Not in a panel at all times."
        parts += [f"## {cls.bl_idname}", f"**{cell(label)}.** {cell(words)}.{where}"]
        rna = getattr(bpy.ops.chona, cls.bl_idname.partition(".")[2]).get_rna_type()
        rows = [
            (f"`{prop.identifier}`", cell(prop.name), describe(prop), default(prop), limits(prop))
            for prop in rna.properties
            if prop.identifier != "rna_type" and not prop.is_hidden
        ]
        if rows:
            parts.append(table(("Property", "Name", "What it does", "Default", "Range"), rows))
    return "\n\n".join(parts) + "\n"
