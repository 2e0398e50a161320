"""The whole way through a worker: the command and the operator in the background, and the posed mesh to a file.

Arguments: model file, the worker's Python, a folder.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from operation_scene import say
from stand_in_bodies import evaluated

import chona_blender
from chona_blender import actions, commands, preferences, standin
from chona_blender.errors import ChonaError
from chona_blender.rig.cast import cast
from chona_blender.rig.sampling import sample

model, python, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
chona_blender.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.chona.model_path = model
bpy.ops.chona.create_rig()
actor = scene.chona.actor
options = ["--python", python, "--device", "cpu"]
answer = {"code": commands.main(["stand-in", *options, "--voxel", "0.03", "--use", "shadow"])}
person, thing = standin.stand_ins(actor)
answer["camera"], answer["vertices"] = person.visible_camera, len(person.data.vertices)
random = np.random.default_rng(2)
for bone in actor.armature.pose.bones:
    bone.rotation_mode = "XYZ"
    bone.rotation_euler = random.normal(0.0, 0.4, 3)
    bone.keyframe_insert("rotation_euler", frame=1)
scene.frame_set(1)
driver = cast(actions.actor_plan(actor)).driver
pose = driver.pose(sample(scene, actor.armature, driver.bones, [], frames=[1]), [], limit=0.1, object_limit=0.1)
np.savez(folder / "posed.npz", found=evaluated(person), world_from_bone=pose.world_from_bone[0])
actor.stand_in.voxel = 0.05
with preferences.overridden(python=python, device="cpu"):
    answer["operator"] = sorted(bpy.ops.chona.stand_in_make())
answer["coarser"] = len(person.data.vertices)
answer["kept"] = standin.stand_ins(actor) == [person, thing]
answer["wrong"] = commands.main(["stand-in", *options, "--voxel", "0.05", "--person", "Nobody"])
actor.person = "Sub01"
with preferences.overridden(python=python, device="cpu"):
    job = standin.start_stand_in(scene, actor)
    job.cancel()
    while not job.poll():
        pass
    answer["cancelled"] = [job.status, Path(job.place.name).exists()]
actor.person = ""
try:
    standin.finish_stand_in(job)
except ChonaError as error:
    answer["changed"] = str(error)
actor.person = "Sub01"
answer["removed"] = commands.main(["stand-in", "--remove", "--save", str(folder / "saved.blend")])
answer["left"] = len(bpy.data.meshes)
say(answer)
