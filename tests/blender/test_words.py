"""What the add-on says in labels and tooltips, of every registered class: set, and in Blender's manner."""

from __future__ import annotations

import re

import pytest
from operation_helpers import bpy_pythons, run_bpy

LOWER = {
    *("a", "an", "and", "as", "at", "by", "for", "from", "in", "into", "of", "off", "on", "or", "over"),
    *("per", "the", "then", "to", "up", "with", "without", "s"),
}
"""Words that stay small inside a title."""
NAMES = {"sRGB", "torch"}


def wrong_title(text: str) -> str:
    """The first word of a label that is not in title case, or nothing."""
    words = re.findall(r"[A-Za-z][\w'’-]*", text)
    for number, word in enumerate(words):
        if word[0].isupper() or word in NAMES or (number > 0 and word in LOWER):
            continue
        return word
    return ""


pytestmark = pytest.mark.bpy


@pytest.fixture(scope="module")
def classes() -> list[dict]:
    """Every class of the first Blender, with what it says."""
    return run_bpy(bpy_pythons()[0], "operation_words.py")["classes"]


def test_labels_are_titles(classes: list[dict]) -> None:
    """As Blender's own: capitals, no full stop."""
    labels = [(each["name"], each["label"]) for each in classes if each["kind"] in {"Operator", "Panel"}]
    labels += [(f"{each['name']}.{name}", label) for each in classes for name, label, _, _, _ in each["properties"]]
    labels += [
        (f"{each['name']}.{name}.{item}", item)
        for each in classes for name, _, _, _, items in each["properties"] for item, _ in items
    ]  # fmt: skip
    assert len(labels) > 50
    wrong = [f"{where}: {text!r}: {wrong_title(text)}" for where, text in labels if wrong_title(text)]
    wrong += [f"{where}: {text!r}" for where, text in labels if text != text.strip() or text.endswith(".")]
    assert not wrong, "\n".join(wrong)
    assert not [each["name"] for each in classes if each["kind"] in {"Operator", "Panel"} and not each["label"]]


def test_everything_has_a_tooltip(classes: list[dict]) -> None:
    """Operators, their properties, settings and choices; one sentence without its full stop."""
    told = [(each["name"], each["description"]) for each in classes if each["kind"] == "Operator"]
    for each in classes:
        for name, _, description, hidden, items in each["properties"]:
            if not hidden:
                told.append((f"{each['name']}.{name}", description))
                told += [(f"{each['name']}.{name}: {label}", text) for label, text in items]
    wrong = [f"{where}: {text!r}" for where, text in told if not text or text.endswith(".") or text[0].islower()]
    assert not wrong, "\n".join(wrong)
