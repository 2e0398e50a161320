"""What a panel shows, learned by drawing it: a layout that writes down what it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import bpy


@dataclass(frozen=True)
class Setting:
    """A property that is shown: its owner, its name, and the label in place of its own."""

    owner: Any
    name: str
    text: str | None


@dataclass(frozen=True)
class Button:
    """An operator that is shown, and the label in place of its own."""

    operator: str
    text: str | None


@dataclass(frozen=True)
class Rows:
    """A list that is shown: the class that draws its rows, and the collection."""

    kind: str
    owner: Any
    name: str


@dataclass
class Recorder:
    """A `UILayout` as far as panels use it. Rows, columns and boxes are the layout itself."""

    found: list[Setting | Button | Rows] = field(default_factory=list)

    def prop(self, owner: Any, name: str, text: str | None = None, **_options: object) -> None:
        """A setting; `prop_search` and menus of values are settings as well."""
        self.found.append(Setting(owner, name, text or None))

    prop_search = prop_menu_enum = prop

    def operator(self, operator: str, text: str | None = None, **_options: object) -> _Options:
        """A button; what its properties are set to is not told."""
        self.found.append(Button(operator, text or None))
        return _Options()

    def operator_menu_enum(self, operator: str, _name: str, **_options: object) -> _Options:
        """A button that opens a menu; its text is often the present choice, so the operator's label is shown."""
        return self.operator(operator)

    def template_list(self, kind: str, _id: str, owner: Any, name: str, *_rest: Any, **_options: object) -> None:
        """A list."""
        self.found.append(Rows(kind, owner, name))

    def panel(self, *_arguments: object, **_options: object) -> tuple[Recorder, Recorder]:
        """A part that folds: its header and its body."""
        return self, self

    def __getattr__(self, name: str) -> Callable[..., Recorder]:
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *_arguments, **_options: self


class _Options:
    """Properties of a button, which take any value."""


class _Drawn:
    """A panel as its own `draw` sees it, with the recorder for a layout."""

    def __init__(self, panel: type, layout: Recorder) -> None:
        self.layout, self._panel = layout, panel

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._panel, name)
        return value.__get__(self) if hasattr(value, "__get__") and callable(value) else value


def shown_in(panel: type[bpy.types.Panel]) -> list[Setting | Button | Rows]:
    """What a panel shows at present, in order, each once; nothing where it is not shown."""
    poll = getattr(panel, "poll", None)
    if poll is not None and "poll" in {name for cls in panel.__mro__ for name in vars(cls)} and not poll(bpy.context):
        return []
    recorder = Recorder()
    drawn = _Drawn(panel, recorder)
    for name in ("draw_header", "draw"):
        if any(name in vars(cls) for cls in panel.__mro__):
            getattr(panel, name)(drawn, bpy.context)
    once = {}
    for each in recorder.found:
        key = (each.operator,) if isinstance(each, Button) else (each.owner.bl_rna.identifier, each.name)
        once.setdefault(key, each)
    return list(once.values())
