"""Poses a rig of the add-on's by given rotations, writes a shot, and says where armature and camera stand."""

from __future__ import annotations

import json
import sys
from math import radians
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from chona_blender.model_header import read_model_header
from chona_blender.rig.armature import create_rig
from chona_blender.shot import write_shot

model, rotations, shot = (Path(word) for word in sys.argv[1:4])
local = np.load(rotations, allow_pickle=False)["local"]

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 80, 60
scene.render.resolution_percentage = 100
header = read_model_header(model)
person = next(iter(header.persons))
rig = create_rig(scene, header, person, list(header.objects))
armature = rig.armature
armature.matrix_world = Matrix.Translation((0.4, 1.1, 0.2)) @ Matrix.Rotation(0.7, 4, "Z") @ armature.matrix_world
blender_from_canonical = Matrix.Rotation(radians(90.0), 3, "X")
for name, rotation in zip(header.names, local, strict=True):
    bone = armature.pose.bones[name]
    rest = bone.bone.matrix_local.to_3x3()
    turned = blender_from_canonical @ Matrix(rotation.tolist()) @ blender_from_canonical.inverted()
    bone.rotation_mode = "QUATERNION"
    bone.rotation_quaternion = (rest.inverted() @ turned @ rest).to_quaternion()
empty = next(iter(rig.empties.values()))
empty.matrix_world = armature.matrix_world @ Matrix.Translation((0.05, -0.45, 0.2)) @ Matrix.Rotation(0.5, 4, "X")

data = bpy.data.cameras.new("camera")
data.lens, data.shift_x = 60.0, 0.03
camera = bpy.data.objects.new("camera", data)
camera.location = (2.2, -1.5, 1.0)
middle = armature.matrix_world @ Vector((0.0, 0.0, 0.2))
camera.rotation_euler = (middle - camera.location).to_track_quat("-Z", "Y").to_euler()
scene.collection.objects.link(camera)
scene.camera = camera
bpy.context.view_layer.update()

write_shot(shot, scene, armature, rig.empties, person, list(header.objects), [1, 2], header, "parity")
sys.stdout.write("\n" + json.dumps({
    "armature": [list(row) for row in armature.matrix_world], "object": [list(row) for row in empty.matrix_world],
    "camera": [list(row) for row in camera.matrix_world], "lens": data.lens, "sensor": data.sensor_width,
    "shift_x": data.shift_x,
}) + "\n")  # fmt: skip
