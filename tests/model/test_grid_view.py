"""Whole rays in one kernel against the separate stages they are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tiny_models import lit, trained

from chona_model import grid_view
from chona_model.camera import ORTHOGRAPHIC
from chona_model.grid_actor import GridActor
from chona_model.kernels.cpu import newton
from chona_model.kernels.cpu.jit import entry
from chona_model.kernels.warp import NewtonLimits, invert
from chona_model.render.posed import Window, window_of
from chona_model.render.tracing import RayRows, TraceSettings, make_pose_table, trace
from chona_model.settings import RENDER_PRESETS

find_root = newton.find_root


@pytest.fixture(scope="module", params=[1, 2])
def scene(request: pytest.FixtureRequest):
    dataset, trainer = trained(500 if request.param == 1 else 250, objects=request.param)
    return GridActor(lit(trainer.model)), dataset.views[1]


def ready(actor, view, settings):
    return actor.ready(view.pose, settings)


def look(actor, view, settings, window: Window | None = None):
    window = window or Window(0, view.camera.height, 0, view.camera.width)
    return grid_view.render_view(actor.model, ready(actor, view, settings), view.camera, settings, window)


@pytest.mark.parametrize("changes", [{}, {"offset": False}, {"shading": False}])
def test_the_kernel_sees_what_the_stages_see(scene, changes: dict) -> None:
    """Roots to a micrometre, since the two start their searches in different places."""
    actor, view = scene
    settings = replace(RENDER_PRESETS["final"], supersampling=1, newton_steps=12, stop=0.0, tolerance=1e-6, **changes)
    seen = look(actor, view, settings)
    model, posed = actor.model, actor.model.posed(view.pose)
    table = make_pose_table(model, [posed])
    near, far = grid_view.depth_spans(table.parts[0], posed.figure, view.camera)
    rows, columns = np.nonzero(far > near)
    places = np.stack([columns, rows], axis=-1) + 0.5
    rays = [*posed.figure.rays(view.camera, places), near[rows, columns], far[rows, columns], np.full(len(rows), 0.5)]
    count, slots = len(rows), len(posed.objects)
    with torch.no_grad():
        matrices, index = model.matrices([posed], settings.offset)
        traced = trace(
            model, table, matrices, index,
            RayRows(
                *(torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32) for array in rays),
                torch.zeros(count, dtype=torch.int32), torch.arange(1 + slots).expand(count, -1),
            ),
            model.pairs(posed),
            torch.as_tensor(posed.code[None], dtype=torch.float32) if settings.shading else None,
            model.root_light([posed]),
            TraceSettings(step=settings.step, newton=NewtonLimits(12, tolerance=1e-6), trust=0.0, stop=0.0),
        )  # fmt: skip
    np.testing.assert_array_equal(seen.rows, rows)
    expected = traced.out.numpy()
    assert expected[:, 3].max() > 0.9
    # Rays whose samples fall within rounding of an occupancy cell's border may differ by a sample.
    difference = np.abs(seen.values[:, :6] - expected)
    assert np.quantile(difference, 0.99) < 2e-3
    assert difference.mean() < 2e-4


def test_the_early_stop_saves_evaluations_and_little_else(scene) -> None:
    actor, view = scene
    whole, stopped = (
        look(actor, view, settings)
        for settings in (replace(RENDER_PRESETS["final"], stop=stop) for stop in (0.0, 0.01))
    )
    assert stopped.evaluated < whole.evaluated
    brightest = max(1.0, float(whole.values[:, :3].max()))  # light may take colours beyond 1
    assert np.abs(stopped.values[:, :4] - whole.values[:, :4]).max() < 0.011 * brightest


def test_threads_change_nothing(scene, monkeypatch: pytest.MonkeyPatch) -> None:
    actor, view = scene
    settings = RENDER_PRESETS["final"]
    first = look(actor, view, settings)
    monkeypatch.setattr(grid_view, "PIECE", 10**9)
    second = look(actor, view, settings)
    np.testing.assert_array_equal(first.values, second.values)


def test_a_window_of_the_view_is_that_part_of_it(scene) -> None:
    """Bit for bit: what tiles are joined from shows no seams."""
    actor, view = scene
    whole, window = look(actor, view, RENDER_PRESETS["final"]), Window(10, 31, 20, 50)
    part = look(actor, view, RENDER_PRESETS["final"], window)
    inside = (whole.rows >= 10) & (whole.rows < 31) & (whole.columns >= 20) & (whole.columns < 50)
    np.testing.assert_array_equal(part.rows, whole.rows[inside])
    np.testing.assert_array_equal(part.columns, whole.columns[inside])
    # But for how many roots were tried: rays look ahead the farther the fewer of them are left in their block.
    np.testing.assert_array_equal(part.values[:, :6], whole.values[inside, :6])
    assert len(part.rows) > 100


def test_nothing_is_seen_outside_the_figures_window(scene) -> None:
    actor, view = scene
    part, figure = ready(actor, view, RENDER_PRESETS["final"]).part, actor.model.posed(view.pose).figure
    for turn in np.linspace(-0.6, 0.6, 7):
        moved = view.camera.world_from_camera @ rotation_about_y(turn)
        for camera in (
            replace(view.camera, world_from_camera=moved),
            replace(view.camera, world_from_camera=moved, kind=ORTHOGRAPHIC),
        ):
            near, far = grid_view.depth_spans(part, figure, camera)
            rows, columns = np.nonzero(far > near)
            window = window_of(part, figure, camera)
            assert window.pixels or len(rows) == 0
            if len(rows):
                assert window.top <= rows.min() and rows.max() < window.bottom
                assert window.left <= columns.min() and columns.max() < window.right


def rotation_about_y(angle: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    return turn


def test_bands_cover_a_window_once() -> None:
    window = Window(3, 40, 5, 25)
    bands = list(window.bands(20 * 8))
    assert [(band.top, band.bottom) for band in bands] == [(3, 11), (11, 19), (19, 27), (27, 35), (35, 40)]
    assert all((band.left, band.right) == (5, 25) for band in bands)
    assert list(Window(0, 0, 0, 0).bands(10)) == []


@entry
def find_roots(posed, starts, volume, limits, roots, residuals):
    work = np.empty(newton.WORK, np.float32)
    for m in range(len(posed)):
        roots[m, 0], roots[m, 1], roots[m, 2], residuals[m] = find_root(
            posed[m, 0], posed[m, 1], posed[m, 2], starts[m, 0], starts[m, 1], starts[m, 2], volume, limits, work
        )


def test_roots_are_those_of_the_voxel_volumes_kernel(scene) -> None:
    actor, view = scene
    model, posed = actor.model, actor.model.posed(view.pose)
    volume = ready(actor, view, RENDER_PRESETS["final"]).volume
    canonical = model.cells(model.occupancy)[posed.person].centres
    random = np.random.default_rng(0)
    known = canonical + random.uniform(-0.005, 0.005, canonical.shape).astype(np.float32)
    with torch.no_grad():
        matrices, index = model.matrices([posed])
    targets = model.warp_points(posed, known)
    pose = torch.zeros(len(targets), dtype=torch.int32)
    theirs, errors = invert(
        matrices, torch.from_numpy(targets), torch.from_numpy(canonical), pose, index, NewtonLimits(steps=8)
    )
    roots, residuals = np.empty_like(targets), np.empty(len(targets), np.float32)
    real = np.float32
    find_roots(targets, canonical, volume, newton.RootLimits(8, real(2e-4), real(0.05), real(2e-3)), roots, residuals)
    np.testing.assert_allclose(roots, theirs.numpy(), atol=2e-5)
    np.testing.assert_allclose(residuals, errors.numpy(), atol=2e-6)
    assert (residuals < 2e-4).mean() > 0.9
