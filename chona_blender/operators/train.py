"""Training in the worker: into the list, one after the other, paused, resumed, and its model used."""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import jobs, messages, model_cache, pick_up, train_queue, train_rows
from ..errors import ChonaError
from ..output import absolute
from ..readiness import NO_CAPTURES
from ..train_job import PAUSED, TrainJob
from ..train_rows import CANCELLED, FAILED, RUNNING, WAITING
from ..train_view import MODEL
from .poll import allowed, needs


class CHONA_OT_train(bpy.types.Operator):
    """Learn a model from the captures in the data folder; where a job runs already, after it. Blender stays usable"""

    bl_idname = "chona.train"
    bl_label = "Train"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return needs(cls, context.scene.chona.data_folder, NO_CAPTURES)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            train_queue.add(context.scene)
        except ChonaError as error:
            return messages.fail(self, error)
        return _go_on(self, context)


class CHONA_OT_run_trainings(pick_up.DetachableOperator, bpy.types.Operator):
    """Start the first training that waits; the others follow"""

    bl_idname = "chona.run_trainings"
    bl_label = "Start Waiting Trainings"
    bl_options = {"INTERNAL"}

    escapes = False  # it takes hours, and ESC is pressed for other things meanwhile

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return needs(cls, train_queue.next_waiting() is not None, "No training waits, or a job is running")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: one training after the other, until none waits."""
        result = {"CANCELLED"}
        while train_queue.next_waiting() is not None:
            result = super().execute(context)
        return result

    def start(self, _context: bpy.types.Context) -> jobs.Job:
        row = train_queue.next_waiting()
        if row is None:
            raise ChonaError("no training waits; add one with Train")
        try:
            return pick_up.running_at(pick_up.train_place(Path(row.run_folder), row.key)) or train_queue.start(row)
        except ChonaError:
            train_queue.wake()
            raise

    def finish(self, context: bpy.types.Context, job: jobs.Job) -> str:
        return finish_training(context, job)

    def _ended(self, context: bpy.types.Context, job: jobs.Job) -> set[str]:
        told = training_ended(self, job)
        return super()._ended(context, job) if told is None else told


def finish_training(context: bpy.types.Context, job: jobs.Job) -> str:
    """Use the model that was trained where the scene has none; words for a report."""
    model = job.run / MODEL if isinstance(job, TrainJob) else ""
    settings = context.scene.chona
    if not settings.model_path:
        settings.model_path = str(model)
    else:
        model_cache.refresh(settings.model_path)
    return f"Trained {model}"


def training_ended(operator: bpy.types.Operator, job: jobs.Job) -> set[str] | None:
    """Start what waits; what the operator returns where the training was paused, else None."""
    train_queue.wake()
    if job.status != PAUSED:
        return None
    operator.report({"INFO"}, f"{job.title} is paused: its checkpoint is written, Resume goes on from it")
    return {"FINISHED"}


def _go_on(operator: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
    """Start what waits, now or when the running job has ended."""
    running = jobs.running()
    if running is not None:
        train_queue.wake()
        operator.report({"INFO"}, f"Waits until the running job has ended: {running.title}")
        return {"FINISHED"}
    return bpy.ops.chona.run_trainings("INVOKE_DEFAULT" if context.window is not None else "EXEC_DEFAULT")


class CHONA_OT_pause_training(bpy.types.Operator):
    """Stop the running training after its step, with a checkpoint; the trainings that wait go on waiting"""

    bl_idname = "chona.pause_training"
    bl_label = "Pause"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        job = jobs.running()
        if not isinstance(job, TrainJob):
            return allowed(cls, "No training is running")
        return allowed(cls, "It is stopping already" if job.stopping else "")

    def execute(self, _context: bpy.types.Context) -> set[str]:
        job = jobs.running()
        if isinstance(job, TrainJob):
            job.pause()
        return {"FINISHED"}


class CHONA_OT_resume_training(bpy.types.Operator):
    """Go on with the selected training from its last checkpoint; it comes before all that wait"""

    bl_idname = "chona.resume_training"
    bl_label = "Resume"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        row = train_rows.selected()
        if row is None:
            return allowed(cls, "There is no training; add one with Train")
        words = {RUNNING: "It is running", train_rows.DONE: "It is done; press Train to train anew"}
        return allowed(cls, words.get(row.state, ""))

    def execute(self, context: bpy.types.Context) -> set[str]:
        row = train_rows.selected()
        if row is not None:
            train_queue.resume(row)
        return _go_on(self, context)


class CHONA_OT_cancel_training(bpy.types.Operator):
    """Stop the selected training after its step, and go on with the next; its checkpoint stays"""

    bl_idname = "chona.cancel_training"
    bl_label = "Cancel"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        row = train_rows.selected()
        stops = row is not None and row.state in {RUNNING, WAITING, train_rows.PAUSED}
        return needs(cls, stops, "The selected training neither runs nor waits")

    def execute(self, _context: bpy.types.Context) -> set[str]:
        row = train_rows.selected()
        if row is not None:
            train_queue.stop(row, jobs.running(), pause=False)
        return {"FINISHED"}


class CHONA_OT_move_training(bpy.types.Operator):
    """Move the selected training in the list; those that wait start from the top"""

    bl_idname = "chona.move_training"
    bl_label = "Move Training"
    bl_options = {"INTERNAL"}

    by: bpy.props.IntProperty(name="By", description="-1 moves it up, 1 down", default=-1)  # type: ignore[valid-type]

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return needs(cls, len(train_rows.rows()) > 1, "There is no other training")

    def execute(self, _context: bpy.types.Context) -> set[str]:
        row = train_rows.selected()
        if row is not None:
            train_queue.move(row, self.by)
        return {"FINISHED"}


class CHONA_OT_remove_training(bpy.types.Operator):
    """Take the selected training out of the list; its folder and its model stay"""

    bl_idname = "chona.remove_training"
    bl_label = "Remove Training"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        row = train_rows.selected()
        if row is None:
            return allowed(cls, "There is no training")
        return allowed(cls, "It is running: pause or cancel it first" if row.state == RUNNING else "")

    def execute(self, _context: bpy.types.Context) -> set[str]:
        row = train_rows.selected()
        if row is not None:
            train_queue.remove(row)
        return {"FINISHED"}


class CHONA_OT_use_trained(bpy.types.Operator):
    """Use the model of the selected training, or of the result folder, for the selected actor; makes one if need be"""

    bl_idname = "chona.use_trained"
    bl_label = "Use Model"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        nothing = train_rows.selected() is None and not context.scene.chona.run_folder
        return allowed(cls, "Set the result folder of the training first" if nothing else "")

    def execute(self, context: bpy.types.Context) -> set[str]:
        row, settings = train_rows.selected(), context.scene.chona
        model = train_queue.model_of(row) if row is not None else absolute(settings.run_folder) / MODEL
        if not model.is_file():
            failed = row is not None and row.state in {FAILED, CANCELLED}
            remedy = "train again" if failed else "wait until it has ended, or pause it" if row else "train first"
            return messages.fail(self, ChonaError(f"there is no model {model} yet; {remedy}"))
        settings.model_path = str(model)
        model_cache.refresh(settings.model_path)
        self.report({"INFO"}, f"{settings.actor.label} uses {model}")
        return {"FINISHED"}


CLASSES = (
    CHONA_OT_train, CHONA_OT_run_trainings, CHONA_OT_pause_training, CHONA_OT_resume_training,
    CHONA_OT_cancel_training, CHONA_OT_move_training, CHONA_OT_remove_training, CHONA_OT_use_trained,
)  # fmt: skip
