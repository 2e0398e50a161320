"""Views by stages of tensors, as a GPU makes them: on the CPU in float64, which takes the same way."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_models import lit, trained

from chona_model.camera import ORTHOGRAPHIC
from chona_model.grid_actor import GridActor
from chona_model.grid_device import DevicePose
from chona_model.settings import RENDER_PRESETS


@pytest.fixture(scope="module", params=[1, 2])
def scene(request: pytest.FixtureRequest):
    dataset, trainer = trained(500 if request.param == 1 else 250, objects=request.param)
    return lit(trainer.model), dataset.views[1]


def pictures(scene, device: str, dtype: torch.dtype, camera=None, **changes):
    model, view = scene
    settings = replace(RENDER_PRESETS["final"], supersampling=2, newton_steps=12, stop=0.0, **changes)
    fused = GridActor(model)
    staged = GridActor(deepcopy(model).to(device=device, dtype=dtype))
    assert fused.fused
    assert isinstance(staged.ready(view.pose, settings), DevicePose)
    return [actor.render(view.pose, camera or view.camera, settings) for actor in (fused, staged)]


@pytest.mark.parametrize("changes", [{}, {"offset": False}, {"shading": False}, {"occupancy": False}])
def test_the_stages_show_what_the_kernel_shows(scene, changes: dict) -> None:
    same(*pictures(scene, "cpu", torch.float64, **changes))


def test_so_do_they_through_orthographic_cameras(scene) -> None:
    camera = scene[1].camera
    flat = np.diag([40.0, 40.0, 1.0])
    flat[:2, 2] = camera.width / 2, camera.height / 2
    same(*pictures(scene, "cpu", torch.float64, replace(camera, kind=ORTHOGRAPHIC, intrinsics=flat)))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no graphics card with CUDA")
def test_on_a_graphics_card(scene) -> None:
    same(*pictures(scene, "cuda", torch.float32))


def same(fused, staged) -> None:
    """Rays whose samples fall within rounding of an occupancy cell's border may differ by a sample."""
    assert fused.alpha.max() > 0.9
    assert fused.rays == pytest.approx(staged.rays, rel=0.01)
    for name in ("rgb", "alpha", "human", "object"):
        difference = np.abs(getattr(fused, name) - getattr(staged, name))
        assert np.quantile(difference, 0.99) < 5e-3, name
        assert difference.mean() < 5e-4, name
    seen = (fused.alpha > 0.5) & (staged.alpha > 0.5)
    assert np.median(np.abs(fused.depth - staged.depth)[seen]) < 1e-3
