"""Frames that show the same are rendered once, and are the same pixels under their own numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from cli_files import write_capture, write_tiny_shot
from tiny_models import trained

from chona_model import bake as module
from chona_model.bake import bake
from chona_model.formats.exr import read_frame
from chona_model.formats.shot import read_shot, write_shot
from chona_model.model_store import save_actor
from chona_model.progress import Progress


def test_a_hold_is_rendered_once(tmp_path: Path, monkeypatch) -> None:
    """Frames 1, 2, 3 = 1, 4 = 2 and 5, which differs from 1 by its camera alone."""
    _, trainer = trained()
    model, shot = tmp_path / "model.safetensors", tmp_path / "hold.shot.npz"
    save_actor(model, trainer.actor(), "chona", {}, {})
    content = read_shot(write_tiny_shot(tmp_path / "walk.shot.npz", write_capture(tmp_path / "capture"), frames=2))
    order = np.array([0, 1, 0, 1, 0])
    (actor,) = content.actors
    cameras = content.world_from_camera[order].copy()
    cameras[4, 0, 3] += 0.1
    write_shot(shot, replace(
        content, name="hold", frames=np.arange(1, 6), intrinsics=content.intrinsics[order],
        world_from_camera=cameras, clip=content.clip[order],
        actors=(replace(actor, world_from_bone=actor.world_from_bone[order],
                        world_from_object=actor.world_from_object[order]),),
    ))  # fmt: skip
    rendered = []
    render = module.render_frame
    monkeypatch.setattr(module, "render_frame", lambda *a: rendered.append(a[2]) or render(*a))
    report = bake(model, shot, tmp_path / "out", None, "preview", False, Progress())
    assert (report.written, report.repeated, rendered) == (5, 2, [0, 1, 4])
    frames = [read_frame(tmp_path / "out" / f"hold_{number:04d}.exr") for number in range(1, 6)]
    assert [header.frame for _, header in frames] == [1, 2, 3, 4, 5]
    np.testing.assert_array_equal(frames[0][0].combined, frames[2][0].combined)
    np.testing.assert_array_equal(frames[1][0].depth, frames[3][0].depth)
    assert np.abs(frames[0][0].combined - frames[4][0].combined).max() > 0.05
    assert bake(model, shot, tmp_path / "out", None, "preview", False, Progress()).skipped == 5
