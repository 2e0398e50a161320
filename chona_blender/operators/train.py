"""Training in the worker."""

from __future__ import annotations

import bpy

from .. import actions, jobs, model_cache
from ..errors import ChonaError


class CHONA_OT_train(jobs.JobOperator, bpy.types.Operator):
    """Learn a model from the captures in the data folder; Blender stays usable meanwhile"""

    bl_idname = "chona.train"
    bl_label = "Train"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if jobs.running() is not None:
            cls.poll_message_set("Wait until the running job has ended, or cancel it")
            return False
        if not context.scene.chona.data_folder:
            cls.poll_message_set("Choose the folder with the captures first")
            return False
        return True

    def start(self, context: bpy.types.Context) -> jobs.Job:
        self._scene = context.scene.name
        return actions.start_train(context.scene)

    def finish(self, _context: bpy.types.Context, _job: jobs.Job) -> str:
        scene = bpy.data.scenes.get(self._scene)
        if scene is None:
            return "Trained"
        model = actions.trained_model(scene)
        if not scene.chona.model_path:
            scene.chona.model_path = str(model)
        else:
            model_cache.refresh(scene.chona.model_path)
        return f"Trained {model}"


class CHONA_OT_use_trained(bpy.types.Operator):
    """Use the model that the last training left in the result folder"""

    bl_idname = "chona.use_trained"
    bl_label = "Use Trained Model"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.chona.run_folder:
            cls.poll_message_set("Set the result folder of the training first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        model = actions.trained_model(context.scene)
        if not model.is_file():
            return jobs.fail(self, ChonaError(f"there is no model {model}; train first"))
        context.scene.chona.model_path = str(model)
        return {"FINISHED"}


CLASSES = (CHONA_OT_train, CHONA_OT_use_trained)
