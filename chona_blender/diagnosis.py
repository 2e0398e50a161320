"""What is known about this Blender, the add-on, the worker and the last failure, in words to be copied."""

from __future__ import annotations

import platform
import sys

import bpy

from . import jobs, messages
from .worker_check import WorkerReport

worker_report: WorkerReport | None = None


def report_text() -> str:
    """The whole report."""
    lines = [
        f"Blender {bpy.app.version_string}, Python {sys.version.split()[0]}, {platform.platform()}",
        f"add-on: {__package__}",
        f"last error: {messages.last_error() or 'none'}",
        "",
        "no check of the worker yet" if worker_report is None else worker_report.text,
    ]
    if jobs.board.last is not None:
        lines += ["", jobs.board.last.report]
    return "\n".join(lines)
