"""One actor as the user sets it: whose model, which person and objects, and what moves them.

Blender reads the annotations of property classes, so they are not postponed here.
"""

import json
from collections.abc import Iterator

import bpy

from . import model_cache
from .errors import ChonaError
from .part_properties import FOLLOWS, FOUND, MISSING, CHONA_PG_bone, CHONA_PG_object
from .rig.mapping import FOLLOW, map_rig
from .standin_properties import CHONA_PG_stand_in

RELATIVE_PATH = {"PATH_SUPPORTS_BLEND_RELATIVE"}
ROOT_PATHS = (
    (
        "RIG",
        "As the Rig",
        "Hips stand where the rig's do; feet float or sink where the figure's legs are of another length",
    ),
    (
        "LEGS",
        "Scaled by Legs",
        "Hips rise and travel as much more or less as the figure's legs are longer or shorter, so that feet stay on "
        "the ground and do not slide",
    ),
)


_filling: list[str] = []


def _model_changed(self: "CHONA_PG_actor", context: bpy.types.Context) -> None:
    """Read the new model's header once, and fill in what it has only one of."""
    header = model_cache.refresh(self.model_path)
    if header is not None and self.person not in header.persons:
        self.person = next(iter(header.persons), "")
    _rig_changed(self, context)


def _rig_changed(self: "CHONA_PG_actor", _context: bpy.types.Context) -> None:
    self.refresh_bones()


def _search_persons(self: "CHONA_PG_actor", _context: bpy.types.Context, text: str) -> list[str]:
    return [name for name in model_cache.person_names(self.model_path) if text.lower() in name.lower()]


def _get_mapping(self: "CHONA_PG_actor") -> str:
    whole = {
        item.name: item.target or item.found.partition(", ")[0] or (FOLLOW if item.state == FOLLOWS else "")
        for item in self.bones
    }
    return json.dumps({name: bone for name, bone in whole.items() if bone})


def _set_mapping(self: "CHONA_PG_actor", text: str) -> None:
    chosen = json.loads(text)
    self.refresh_bones()
    _filling.append(self.name)
    try:
        for item in self.bones:
            item.target = str(chosen.get(item.name, ""))
    finally:
        _filling.clear()
    self.refresh_bones()


def _is_armature(_self: bpy.types.PropertyGroup, candidate: bpy.types.Object) -> bool:
    return candidate.type == "ARMATURE"


class CHONA_PG_actor(bpy.types.PropertyGroup):
    """A person with objects, or objects alone."""

    name: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Actor",
        description="What this actor is called in the shot; empty takes the armature's name",
    )
    use: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Render",
        description="Render this actor; switched off it is not there and costs nothing",
        default=True,
    )
    model_path: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Model",
        description="Model file (.safetensors) that a training wrote",
        subtype="FILE_PATH",
        options=RELATIVE_PATH,
        update=_model_changed,
    )
    person: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Person",
        description="Which of the model's people is rendered; empty renders the objects alone",
        search=_search_persons,
        update=_rig_changed,
    )
    armature: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Armature",
        description="The armature that poses the person: one that Create Rig made, or any other",
        type=bpy.types.Object,
        poll=_is_armature,
        update=_rig_changed,
    )
    root_path: bpy.props.EnumProperty(  # type: ignore[valid-type]
        name="Path",
        description="How the figure's hips follow a rig whose legs are of another length",
        items=ROOT_PATHS,
        default="RIG",
    )
    objects: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_object, name="Objects", description="Objects of the actor and what moves each"
    )
    active_object: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Object", description="The selected row of the list of objects", options={"HIDDEN"}
    )
    bones: bpy.props.CollectionProperty(  # type: ignore[valid-type]
        type=CHONA_PG_bone, name="Bones", description="The model's bones and the armature's for each"
    )
    active_bone: bpy.props.IntProperty(  # type: ignore[valid-type]
        name="Bone", description="The selected row of the table of bones", options={"HIDDEN"}
    )
    mapping: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Mapping",
        description="The whole table of bones as JSON, model bone to armature bone: what a preset keeps",
        get=_get_mapping,
        set=_set_mapping,
    )
    family: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="Recognised As",
        description="Family of rigs that the armature was recognised as, and how many bones were found",
        options={"SKIP_SAVE"},
    )

    stand_in: bpy.props.PointerProperty(  # type: ignore[valid-type]
        name="Stand-In", description="Meshes that show the actor while its rig is posed", type=CHONA_PG_stand_in
    )

    @property
    def label(self) -> str:
        """For lists."""
        return self.name or self.person or ", ".join(item.name for item in self.objects) or "Actor"

    def used_objects(self) -> Iterator[CHONA_PG_object]:
        """The objects that are to be rendered."""
        return (item for item in self.objects if item.use)

    def set_objects(self, pairs: dict[str, bpy.types.Object | None]) -> None:
        """Replace the list of objects."""
        self.objects.clear()
        for name, empty in pairs.items():
            item = self.objects.add()
            item.name = name
            item.empty = empty

    def chosen_bones(self) -> dict[str, str]:
        """What the user chose in the table: model bone → armature bone or ``FOLLOW``."""
        return {item.name: item.target for item in self.bones if item.target}

    def refresh_bones(self) -> None:
        """Bring the table up to date with model and armature; what the user chose stays."""
        if not _filling:
            _filling.append(self.name)  # filling in a target is no choice of the user's
            try:
                self._fill_bones()
            finally:
                _filling.clear()

    def _fill_bones(self) -> None:
        header = model_cache.cached(self.model_path)
        if header is None or self.armature is None or not self.person:
            self.family = ""
            self.bones.clear()
            return
        if [item.name for item in self.bones] != list(header.names):
            chosen = self.chosen_bones()
            self.bones.clear()
            for name in header.names:
                self.bones.add().name = name
            for item in self.bones:
                item.target = chosen.get(item.name, "")
        present = self.armature.data.bones
        chosen = {k: v for k, v in self.chosen_bones().items() if v == FOLLOW or v in present}
        try:
            mapping = map_rig(self.armature, header.names, chosen)
        except ChonaError:  # told by Check and Bake
            self.family = ""
            return
        self.family = mapping.summary
        for item in self.bones:
            item.found = ", ".join(mapping.bones[item.name])
            wrong = item.name in mapping.problems or (item.target and item.name not in chosen)
            item.state = MISSING if wrong else FOUND if mapping.bones[item.name] else FOLLOWS
