"""An armature and empties for a person and objects of a model, standing in their canonical pose."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object, Scene

from ..errors import ChonaError
from ..model_header import ModelHeader
from .rest_pose import RX90

MODEL_KEY, PERSON_KEY, OBJECTS_KEY = "chona_model", "chona_person", "chona_objects"
"""Custom properties of an armature: model path, person, JSON list of objects."""

OBJECT_KEY, ARMATURE_KEY = "chona_object", "chona_armature"
"""Custom properties of an empty: the object it places, the armature it belongs to (a pointer)."""

LEAF_LENGTH_SHARE = 0.5
_SHORTEST_BONE = 1e-3
_STUB_LENGTH = 0.05


@dataclass(frozen=True)
class Rig:
    """What poses a person and its objects.

    Attributes:
        armature: None for objects alone.
        empties: an empty for every object, by the model's name.
    """

    armature: Object | None
    empties: dict[str, Object]


def bone_tails(parents: Sequence[int], joints: np.ndarray) -> np.ndarray:
    """Tails [B, 3] of bones that start at joints [B, 3]: mean of the children's joints, leaves go on half a bone."""
    tails = np.array(joints, dtype=np.float64)
    for index, parent in enumerate(parents):
        children = [child for child, other in enumerate(parents) if other == index]
        if children:
            tails[index] = joints[children].mean(axis=0)
        elif parent >= 0:
            tails[index] = joints[index] + LEAF_LENGTH_SHARE * (joints[index] - joints[parent])
        if np.linalg.norm(tails[index] - joints[index]) < _SHORTEST_BONE:  # Blender removes bones without length
            tails[index] = joints[index] + np.array([0.0, _STUB_LENGTH, 0.0])
    return tails


def stored_path(path: Path) -> str:
    """A path for a custom property: relative ('//') where the blend file is saved, else absolute."""
    absolute = str(path.resolve())
    if not bpy.data.filepath:
        return absolute
    try:
        return bpy.path.relpath(absolute)
    except ValueError:  # another drive
        return absolute


def create_rig(
    scene: Scene, header: ModelHeader, person: str | None, object_names: Sequence[str] = (), name: str | None = None
) -> Rig:
    """Adds an armature for a person and an empty for every object.

    The armature stands on the floor in T-pose, z up, facing −y; its rest pose is the model's canonical pose, so posed
    frames map to canonical space exactly.  Objects stand in front of it.  The armature becomes the active object.

    Args:
        person: None for objects alone.
        name: of the armature, default the person's.

    Raises:
        ChonaError: unknown person or object, or neither of them given.
    """
    joints = header.rest_joints(person) if person else None
    extents = {each: header.extents(each) for each in object_names}
    if joints is None and not extents:
        raise ChonaError("A rig needs a person or an object, got neither. Choose a person, an object or both")
    armature, lift = None, 0.0
    if joints is not None:
        lift = -float(min(joints[:, 1].min(), _lowest_tail(header, joints)))
        armature = _create_armature(scene, header, joints, name or str(person))
        armature.location = (0.0, 0.0, lift)
        armature[MODEL_KEY] = stored_path(header.path)
        armature[PERSON_KEY] = person
        armature[OBJECTS_KEY] = json.dumps(list(object_names))
    empties = {}
    position = RX90 @ header.canonical_object(person)
    for each, (lower, upper) in extents.items():
        empties[each] = create_empty(scene, header, each, position, armature)
        position[0] += float(upper[0] - lower[0]) + 0.2  # the next one beside it
    return Rig(armature, empties)


def create_empty(
    scene: Scene, header: ModelHeader, name: str, position: np.ndarray, armature: Object | None = None
) -> Object:
    """Adds the empty of one object of a model: upright, standing on the floor, as large as the object.

    Args:
        position: [3] in Blender's world; its height is not used.
        armature: whose object it is.

    Raises:
        ChonaError: the model has no such object.
    """
    lower, upper = header.extents(name)
    empty = bpy.data.objects.new(name, None)
    empty.empty_display_type = "CUBE"
    empty.empty_display_size = max(float(np.max(upper - lower)) / 2.0, 1e-3)
    # In canonical space the frame's axes are the world's: y of the object is up, its lowest point on the floor.
    empty.rotation_euler = (np.pi / 2.0, 0.0, 0.0)
    empty.location = (position[0], position[1], max(0.0, -float(lower[1])))
    empty[OBJECT_KEY] = name
    empty[MODEL_KEY] = stored_path(header.path)
    if armature is not None:
        empty[ARMATURE_KEY] = armature
    scene.collection.objects.link(empty)
    return empty


def _lowest_tail(header: ModelHeader, joints: np.ndarray) -> float:
    return float(bone_tails(header.parents, joints)[:, 1].min())


def _create_armature(scene: Scene, header: ModelHeader, joints: np.ndarray, name: str) -> Object:
    data = bpy.data.armatures.new(name)
    data.display_type = "OCTAHEDRAL"
    armature = bpy.data.objects.new(name, data)
    armature.show_in_front = True
    scene.collection.objects.link(armature)
    heads = joints @ RX90.T
    tails = bone_tails(header.parents, joints) @ RX90.T
    layer = scene.view_layers[0] if scene != bpy.context.scene else bpy.context.view_layer
    if bpy.context.object is not None and bpy.context.object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for each in layer.objects:
        each.select_set(False, view_layer=layer)
    armature.select_set(True, view_layer=layer)
    layer.objects.active = armature
    with bpy.context.temp_override(
        scene=scene, view_layer=layer, object=armature, active_object=armature, selected_objects=[armature]
    ):
        bpy.ops.object.mode_set(mode="EDIT")
        try:
            made = []
            for index, bone_name in enumerate(header.names):
                bone = data.edit_bones.new(bone_name)
                bone.head, bone.tail, bone.roll = heads[index], tails[index], 0.0
                if header.parents[index] >= 0:
                    bone.parent = made[header.parents[index]]
                made.append(bone)
            del made  # edit bones die with edit mode
        finally:
            bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def find_rig(armature: Object) -> Rig:
    """The rig that ``create_rig`` made: the armature and the empties that point to it.

    Raises:
        ChonaError: the armature has no model.
    """
    if MODEL_KEY not in armature:
        raise ChonaError(f"Armature '{armature.name}' belongs to no model. Create a rig, or set its model in the panel")
    wanted = json.loads(armature.get(OBJECTS_KEY, "[]"))
    found = {
        each[OBJECT_KEY]: each for each in bpy.data.objects if each.get(ARMATURE_KEY) == armature and OBJECT_KEY in each
    }
    return Rig(armature, {name: found[name] for name in wanted if name in found})


def model_path(item: Object) -> Path:
    """The model file of an armature or empty that ``create_rig`` made.

    Raises:
        ChonaError: it has none.
    """
    if MODEL_KEY not in item:
        raise ChonaError(f"'{item.name}' belongs to no model. Create a rig, or set its model in the panel")
    return Path(bpy.path.abspath(item[MODEL_KEY]))
