"""Stand-ins in a scene: made, renewed, undone, removed, rendered; the operators' polls and files that are refused.

Argument: a folder for files.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from operation_scene import say
from rig_bodies import SMPL
from stand_in_bodies import JOINTS, body, crate, put_together, write_model, write_stand_in

import chona_blender
from chona_blender import standin
from chona_blender.capturing import capture_meshes
from chona_blender.errors import ChonaError
from chona_blender.standin_file import read_stand_in

FOLDER = Path(sys.argv[1])
KINDS = ("objects", "meshes", "materials", "collections", "armatures", "scenes", "node_groups")
chona_blender.register()
MODEL = write_model(FOLDER / "model.safetensors")
FILE = write_stand_in(FOLDER / "both.npz", {"Robin": body(), "crate": crate()})


def fresh() -> bpy.types.Scene:
    """An empty file with a rig for Robin and the crate, keyed, in Pose Mode."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.chona.model_path = str(MODEL)
    bpy.ops.chona.create_rig()
    return scene


def held() -> dict[str, list[str]]:
    """Names of all data that a stand-in might leave behind."""
    return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in KINDS}


def made_and_removed() -> dict:
    """Names after making (both ways to follow) and after removing; modes and selection stay."""
    scene = fresh()
    bpy.ops.object.mode_set(mode="POSE")
    before, actor = held(), scene.chona.actor
    answer = {"poll before": bpy.ops.chona.stand_in_remove.poll()}
    for follow in ("RIG", "FIGURE", "RIG"):
        actor.stand_in.follow = follow
        put_together(scene, FILE)
    answer["renewed"] = {kind: len(names) - len(before[kind]) for kind, names in held().items()}
    actor.stand_in.follow = "FIGURE"
    meshes = put_together(scene, FILE)
    answer["figure"] = {kind: len(names) - len(before[kind]) for kind, names in held().items()}
    answer["captured"] = len(capture_meshes(actor.armature))
    answer["mode"] = [bpy.context.mode, bpy.context.object == actor.armature]
    answer["collections"] = [[each.name for each in item.users_collection] for item in meshes]
    answer["selectable"] = [item.hide_select for item in meshes]
    answer["poll"] = bpy.ops.chona.stand_in_remove.poll()
    bpy.ops.chona.stand_in_remove()
    answer["left"] = {kind: sorted(set(names) - set(before[kind])) for kind, names in held().items()}
    answer["gone"] = {kind: sorted(set(before[kind]) - set(held()[kind])) for kind in KINDS}
    return answer


def renewed() -> dict:
    """What of the user's stays when the meshes are made again, and that nothing piles up."""
    scene = fresh()
    actor = scene.chona.actor
    person, thing = put_together(scene, FILE)
    own = bpy.data.materials.new("own")
    person.data.materials[0] = own
    person.name, person.color = "My Name", (1.0, 0.0, 0.0, 1.0)
    person.modifiers.new("Smooth", "SMOOTH")
    thing.hide_viewport = True
    standin.set_use(actor, "SHADOW")
    thing.visible_shadow = False
    actor.stand_in.use_proxy = True
    other = write_stand_in(FOLDER / "other.npz", {"Robin": body(seed=4), "crate": crate()})
    before = np.array([vertex.co for vertex in person.data.vertices])
    again = put_together(scene, other)
    after = np.array([vertex.co for vertex in again[0].data.vertices])
    return {
        "same": [again[0] == person, again[1] == thing], "materials": [slot.name for slot in person.data.materials],
        "name": person.name, "modifiers": [modifier.name for modifier in person.modifiers],
        "camera": person.visible_camera, "render": person.hide_render, "shadow": thing.visible_shadow,
        "display": person.display_type, "hidden": thing.hide_viewport, "new": float(np.abs(before - after).max()),
        "meshes": len(bpy.data.meshes), "groups": len(person.vertex_groups), "parts": len(actor.stand_in.parts),
        "colours": [each.name for each in person.data.color_attributes],
    }  # fmt: skip


def shown() -> dict:
    """Colours and the material's."""
    scene = fresh()
    person = put_together(scene, FILE)[0]
    mesh = person.data
    stored = np.empty(4 * len(mesh.vertices), dtype=np.float32)
    mesh.color_attributes[0].data.foreach_get("color_srgb", stored)
    material = mesh.materials[0]
    attribute = next(node for node in material.node_tree.nodes if node.type == "ATTRIBUTE")
    return {
        "error": float(np.abs(stored.reshape(-1, 4)[:, :3] - body()["colours"] / 255.0).max()),
        "active": mesh.color_attributes.active_color.name, "render": mesh.color_attributes.render_color_index,
        "attribute": attribute.attribute_name, "smooth": bool(all(each.use_smooth for each in mesh.polygons)),
        "viewport": list(material.diffuse_color)[:3], "valid": not mesh.validate(),
        "linear": [float(((v / 255.0 + 0.055) / 1.055) ** 2.4 if v > 10 else v / 255.0 / 12.92)
                   for v in body()["colours"][0]],
    }  # fmt: skip


def undone() -> dict:
    """One step back, and forth."""
    scene = fresh()
    bpy.ops.ed.undo_push(message="before")
    put_together(scene, FILE)
    bpy.ops.ed.undo_push(message="Make Stand-In")
    answer = {"made": len(bpy.data.meshes)}
    bpy.ops.ed.undo()
    answer["undone"] = [len(bpy.data.meshes), len(bpy.context.scene.chona.actor.stand_in.parts)]
    bpy.ops.ed.redo()
    answer["redone"] = [len(bpy.data.meshes), len(standin.stand_ins(bpy.context.scene.chona.actor))]
    bpy.ops.chona.stand_in_remove("EXEC_DEFAULT", True)
    answer["removed"] = len(bpy.data.meshes)
    bpy.ops.ed.undo()
    answer["back"] = len(bpy.data.meshes)
    return answer


def several() -> dict:
    """Two actors have their own; a mesh that the user deletes comes back; one actor's are removed."""
    scene = fresh()
    first = put_together(scene, FILE)
    bpy.ops.chona.actor_add()
    bpy.ops.chona.create_rig()
    second = put_together(scene, FILE)
    answer = {"meshes": len({item.name for item in (*first, *second)})}
    names = [item.name for item in first]
    bpy.data.objects.remove(second[0])
    scene.chona.active_actor = 1
    answer["deleted"] = len(standin.stand_ins(scene.chona.actor))
    answer["again"] = len(put_together(scene, FILE))
    for collection in list(first[0].users_collection):
        collection.objects.unlink(first[0])
    scene.chona.active_actor = 0
    answer["unlinked"] = len(standin.stand_ins(scene.chona.actor))
    answer["linked"] = [item.name for item in put_together(scene, FILE)] == names
    answer["removed"] = standin.remove_stand_in(scene.chona.actor)
    scene.chona.active_actor = 1
    answer["kept"] = len(standin.stand_ins(scene.chona.actor))
    return answer


def rendered() -> dict:
    """A crate over a white floor, lit from above: what each use leaves in a picture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.chona.model_path, scene.chona.person = str(MODEL), ""
    bpy.ops.chona.object_add(object="crate")
    scene.chona.actor.objects[0].empty.location = (0.0, 0.0, 0.6)
    bpy.ops.mesh.primitive_plane_add(size=20.0)
    bpy.ops.object.light_add(type="SUN", rotation=(0.0, 0.6, 0.0))
    bpy.context.object.data.energy, bpy.context.object.data.angle = 3.0, 0.0
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 3.0, (0.0, 0.0, 5.0)
    scene.collection.objects.link(camera)
    scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 8
    scene.cycles.use_denoising = False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.film_transparent = 60, 40, True
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    alone = write_stand_in(FOLDER / "alone.npz", {"crate": crate()})
    put_together(scene, alone)
    answer = {}
    for use in ("VIEWPORT", "SHADOW", "HOLDOUT", "VISIBLE"):
        standin.set_use(scene.chona.actor, use)
        path = FOLDER / f"{bpy.app.version[0]}{bpy.app.version[1]}_{use}.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(path))
        pixels = np.array(image.pixels[:]).reshape(40, 60, 4)
        # Light falls 0.6 rad aslant: the crate, about 0.6 m up, throws its shadow beside itself.
        light = pixels[..., 1]
        answer[use] = {"middle": pixels[20, 30].tolist(), "darkest": float(light[18:22, :24].min()),
                       "darkest right": float(light[18:22, 36:].min()), "open": float(np.median(light))}  # fmt: skip
    return answer


def refused() -> dict:
    """Files that are damaged in one way each."""
    good = {"Robin": body()}
    cases = {
        "version": {"version": 2},
        "format": {"format": "other"},
        "count": {"parts": [{"kind": "person", "name": "Robin", "vertices": 3, "faces": 1}]},
        "no parts": {"parts": 3},
    }
    files = {name: write_stand_in(FOLDER / f"{name}.npz", good, **change) for name, change in cases.items()}
    for name, array, row in (("faces", "faces", 10**6), ("bone", "bones", 99), ("sum", "weights", 0.7)):
        part = body()
        part[array] = part[array].copy()
        part[array][0, 0] = row
        files[name] = write_stand_in(FOLDER / f"{name}.npz", {"Robin": part})
    nan = body()
    nan["vertices"][0, 0] = np.nan
    files["nan"] = write_stand_in(FOLDER / "nan.npz", {"Robin": nan})
    wide = body()
    wide["vertices"] = wide["vertices"].astype(np.float64)
    files["type"] = write_stand_in(FOLDER / "type.npz", {"Robin": wide})
    (FOLDER / "cut.npz").write_bytes(FILE.read_bytes()[:3000])
    files["cut"], files["none"] = FOLDER / "cut.npz", FOLDER / "none.npz"
    answer = {}
    for name, file in files.items():
        try:
            read_stand_in(file, len(SMPL))
            answer[name] = "read"
        except ChonaError as error:
            answer[name] = str(error)
    return answer


def polls() -> dict:
    """Why the button is off."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    from chona_blender.operators.standin import why_no_stand_in

    answer = {"no model": why_no_stand_in(bpy.context)}
    bpy.context.scene.chona.model_path = str(MODEL)
    answer["no rig"] = why_no_stand_in(bpy.context)
    bpy.ops.chona.create_rig()
    answer["fine"] = why_no_stand_in(bpy.context)
    return answer | {"joints": len(JOINTS)}


cases = (made_and_removed, renewed, shown, undone, several, rendered, refused, polls)
say({case.__name__: case() for case in cases})
