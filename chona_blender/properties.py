"""What the user sets, kept in the scene: `scene.chona`.

Blender reads the annotations of property classes, so they are not postponed here.
"""

from collections.abc import Iterator

import bpy

from .actor_properties import RELATIVE_PATH, CHONA_PG_actor
from .bake_properties import BakeSettings
from .blur_properties import CHONA_PG_blur
from .capture_properties import CaptureSettings
from .compositing_properties import CHONA_PG_composite
from .part_properties import CHONA_PG_object
from .passes_properties import CHONA_PG_passes
from .train_properties import TrainSettings


def _first_model_chosen(self: "CHONA_PG_settings", _context: bpy.types.Context) -> None:
    if self.first_model:
        self.ensure_actor().model_path = self.first_model
        self.first_model = ""


class CHONA_PG_settings(BakeSettings, CaptureSettings, TrainSettings, bpy.types.PropertyGroup):
    """Everything that one scene's actors, bake and training need.

    ``model_path``, ``person``, ``armature`` and ``objects`` are those of the selected actor: most scenes have only one.
    """

    actors: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_actor, name="Actors", description="Everybody and everything that is rendered together"
    )
    first_model: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Model",
        description="Model file (.safetensors) that a training wrote; choosing one makes the first actor",
        subtype="FILE_PATH",
        options=RELATIVE_PATH | {"SKIP_SAVE"},
        update=_first_model_chosen,
    )
    active_actor: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Actor",
        description="The selected row of the list of actors",
        options={"HIDDEN"},
    )

    blur: bpy.props.PointerProperty(type=CHONA_PG_blur, name="Blur")  # type: ignore[valid-type]
    composite: bpy.props.PointerProperty(type=CHONA_PG_composite, name="Composite")  # type: ignore[valid-type]
    passes: bpy.props.PointerProperty(type=CHONA_PG_passes, name="Passes")  # type: ignore[valid-type]

    @property
    def actor(self) -> CHONA_PG_actor | None:
        """The selected actor; None where the scene has none."""
        return self.actors[min(self.active_actor, len(self.actors) - 1)] if self.actors else None

    def ensure_actor(self) -> CHONA_PG_actor:
        """The selected actor, made if there is none.  Not to be called while drawing."""
        if not self.actors:
            self.actors.add()
            self.active_actor = 0
        return self.actor  # type: ignore[return-value]

    @property
    def model_path(self) -> str:
        """Of the selected actor."""
        return self.actor.model_path if self.actor else ""

    @model_path.setter
    def model_path(self, value: str) -> None:
        self.ensure_actor().model_path = value

    @property
    def person(self) -> str:
        """Of the selected actor."""
        return self.actor.person if self.actor else ""

    @person.setter
    def person(self, value: str) -> None:
        self.ensure_actor().person = value

    @property
    def armature(self) -> bpy.types.Object | None:
        """Of the selected actor."""
        return self.actor.armature if self.actor else None

    @armature.setter
    def armature(self, value: bpy.types.Object | None) -> None:
        self.ensure_actor().armature = value

    @property
    def objects(self) -> "bpy.types.bpy_prop_collection | tuple":
        """Of the selected actor."""
        return self.actor.objects if self.actor else ()

    def used_actors(self) -> list[CHONA_PG_actor]:
        """The actors that are to be rendered."""
        return [actor for actor in self.actors if actor.use]

    def used_objects(self) -> Iterator[CHONA_PG_object]:
        """The selected actor's objects that are to be rendered."""
        return self.actor.used_objects() if self.actor else iter(())

    def set_objects(self, pairs: dict[str, bpy.types.Object | None]) -> None:
        """Replace the selected actor's list of objects."""
        self.ensure_actor().set_objects(pairs)


def register() -> None:
    """Give every scene its settings. The classes are registered already."""
    bpy.types.Scene.chona = bpy.props.PointerProperty(type=CHONA_PG_settings)


def unregister() -> None:
    """Take the settings' type away; values stay in saved files."""
    del bpy.types.Scene.chona
