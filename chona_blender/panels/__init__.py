"""The sidebar tab CHONA in the 3D view, one subject a module. Drawing reads the settings and what is cached; nothing is
computed and no file is opened.
"""

from __future__ import annotations

from . import bake, blur, composite, costs, learn, model, passes, rig, standin, train, worker
from .worker import draw_setup, draw_worker

CLASSES = (
    *model.CLASSES,
    *rig.CLASSES,
    *standin.CLASSES,
    *bake.CLASSES,
    *blur.CLASSES,
    *passes.CLASSES,
    *costs.CLASSES,
    *composite.CLASSES,
    *learn.CLASSES,
    *train.CLASSES,
    *worker.CLASSES,
)
"""In the order of the sidebar."""

__all__ = ["CLASSES", "draw_setup", "draw_worker"]
