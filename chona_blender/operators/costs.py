"""Estimate a bake, measure a model, show the plot of that, and look for presets again."""

from __future__ import annotations

import bpy

from .. import jobs, measuring, messages, model_cache, presets
from ..areas import redraw_areas
from ..errors import ChonaError
from ..job_operator import JobOperator
from ..measuring import EstimateJob
from ..readiness import NO_CAPTURES, NO_MODEL
from ..scenes import scene_of
from .bake import why_no_bake
from .image_editor import load_anew, show_image
from .poll import allowed, needs


class CHONA_OT_estimate(JobOperator, bpy.types.Operator):
    """Times this computer for two seconds and predicts the bake with each preset"""

    bl_idname = "chona.estimate"
    bl_label = "Estimate"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return allowed(cls, why_no_bake(context.scene))

    def start(self, context: bpy.types.Context) -> EstimateJob:
        self._scene = context.scene.session_uid
        return measuring.start_estimate(context.scene)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        scene = scene_of(self._scene)
        if scene is None or not isinstance(job, EstimateJob):
            return "Estimated"
        lines = measuring.keep_estimate(scene, job)
        chosen = [line for line in lines if line.startswith(f"{scene.chona.preset}: ")]
        return (chosen or lines or ["Estimated"])[0]


class CHONA_OT_trade(JobOperator, bpy.types.Operator):
    """Measure what every preset and setting costs and gives with this model, and keep it in the model's file"""

    bl_idname = "chona.trade"
    bl_label = "Measure"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        settings = context.scene.chona
        reasons = (
            (bool(jobs.busy()), jobs.busy()),
            (not settings.model_path, NO_MODEL),
            (not settings.data_folder, NO_CAPTURES),
        )
        return allowed(cls, next((words for applies, words in reasons if applies), ""))

    def start(self, context: bpy.types.Context) -> jobs.Job:
        self._scene = context.scene.session_uid
        return measuring.start_trade(context.scene)

    def finish(self, _context: bpy.types.Context, job: jobs.Job) -> str:
        scene = scene_of(self._scene)
        if scene is not None:
            model_cache.refresh(scene.chona.model_path)
        return f"Measured; the plot is {job.result.get('plot', 'beside the model')}"


class CHONA_OT_show_trade(bpy.types.Operator):
    """Show the plot of what was measured of this model, in an image editor"""

    bl_idname = "chona.show_trade"
    bl_label = "Show Plot"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene.chona.model_path, NO_MODEL)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            image = load_anew(measuring.trade_picture(context.scene))
        except (ChonaError, RuntimeError) as error:
            return messages.fail(self, ChonaError(str(error)))
        show_image(context, image)
        return {"FINISHED"}


class CHONA_OT_refresh_presets(bpy.types.Operator):
    """Look again for presets of your own, which chona trade saves"""

    bl_idname = "chona.refresh_presets"
    bl_label = "Find Presets"
    bl_options = {"INTERNAL"}

    def execute(self, _context: bpy.types.Context) -> set[str]:
        presets.refresh()
        redraw_areas("VIEW_3D")
        self.report({"INFO"}, f"Presets: {', '.join(presets.names())}")
        return {"FINISHED"}


CLASSES = (CHONA_OT_estimate, CHONA_OT_trade, CHONA_OT_show_trade, CHONA_OT_refresh_presets)
