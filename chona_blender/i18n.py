"""Words with values in them, in the user's language. Plain labels and tooltips are translated by Blender itself."""

from __future__ import annotations

import bpy


def report_text(message: str, **values: object) -> str:
    """A message for a report or a panel, translated before its values are put in.

    Args:
        message: a literal with `{name}` where a value goes, so that translators find whole sentences.
    """
    return bpy.app.translations.pgettext_rpt(message).format(**values)
