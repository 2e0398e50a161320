"""What an estimate counts: presets of one's own, the start, and frames from all over a shot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_files import write_capture, write_tiny_shot
from tiny_models import trained

from chona_model.formats.shot import Shot, read_shot
from chona_model.frame import ShotRenderer, render_frame
from chona_model.grid_actor import GridActor
from chona_model.presets import save_preset
from chona_model.settings import PRESETS, RENDER_PRESETS
from chona_model.trade import estimate as module
from chona_model.trade.estimate import estimate

FRAMES = 6
TRADE = {
    "presets": {name: {"fixed_seconds": 0.0, "seconds_per_ray": 1e-4, "psnr": 30.0, "ssim": 0.9} for name in PRESETS}
}


@pytest.fixture(scope="module")
def actor() -> GridActor:
    return GridActor(trained(60)[1].model)


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    folder = tmp_path_factory.mktemp("estimate")
    return read_shot(write_tiny_shot(folder / "walk.shot.npz", write_capture(folder / "capture"), frames=FRAMES))


def test_presets_of_ones_own_are_estimated_and_broken_files_are_passed_over(
    actor: GridActor, shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CHONA_PRESETS", str(tmp_path))
    save_preset("mine", RENDER_PRESETS["draft"])
    (tmp_path / "broken.json").write_text("{}")
    found = estimate([actor], shot, range(FRAMES), TRADE, "draft", 0.05, started=1.5)
    assert list(found.presets) == [*PRESETS, "mine"]
    assert found.presets["mine"].psnr is None and found.presets["mine"].seconds_per_frame > 0
    assert 1.5 <= found.start_seconds < 1.5 + module.COMPILED
    for each in found.presets.values():
        assert each.total_seconds == pytest.approx(found.start_seconds + FRAMES * each.seconds_per_frame)


def test_the_factor_is_that_of_the_frames_times(
    actor: GridActor, shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A computer on which the last half of the shot takes ten times as long: a factor between, weighted by costs."""
    monkeypatch.setenv("CHONA_PRESETS", str(tmp_path))
    clock, rendered = [0.0], []

    def slow(_: ShotRenderer, index: int) -> object:
        clock[0] += 0.1 if index < FRAMES // 2 else 1.0
        rendered.append(index)
        return layers

    layers = render_frame(actor, shot, 0, RENDER_PRESETS["draft"])
    monkeypatch.setattr(ShotRenderer, "render", slow)
    monkeypatch.setattr(module.time, "perf_counter", lambda: clock[0])
    found = estimate([actor], shot, range(FRAMES), TRADE, "draft", 3.25, started=0.0)
    assert set(rendered[1:3]) & set(range(FRAMES // 2)) and set(rendered[1:3]) & set(range(FRAMES // 2, FRAMES))
    once = rendered[1:]  # the first loads kernels
    assert sorted(once) == list(range(FRAMES)), "3.3 s are one round"
    rays = [actor.count_rays(shot.actors[0].pose(i), shot.camera(i), RENDER_PRESETS["draft"]) for i in once]
    assert found.factor == pytest.approx(3.3 / (1e-4 * np.sum(rays)))
    assert found.presets["draft"].seconds_per_frame == pytest.approx(3.3 / FRAMES)
    assert found.start_seconds == pytest.approx(max(0.1 - found.factor * 1e-4 * rays[0], 0.0))
