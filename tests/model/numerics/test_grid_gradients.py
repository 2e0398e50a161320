"""Gradients of the default path at the ends of what can be posed: finite, and bounded, in every parameter."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
import torch
from grid_cases import POSES, scene

from chona_model.render.posed import depth_spans
from chona_model.render.tracing import RayRows, TraceSettings, make_pose_table, trace

STEP = 0.03
"""Between samples, metres: coarse, as only gradients are looked at."""


def gradients(name: str, dtype: torch.dtype) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """By parameter, of the sum of what all rays of a view show; and what they show [R, 6]."""
    source, view = scene()
    model = deepcopy(source).to(dtype).train()
    pose = model.posed(POSES[name](view.pose))
    matrices, index = model.matrices([pose])
    table = make_pose_table(model, [pose])
    near, far = depth_spans(table.parts[0], pose.figure, view.camera)
    rows, columns = np.nonzero(far > near)
    origins, directions = pose.figure.rays(view.camera, np.stack([columns, rows], axis=-1) + 0.5)
    count, slots = len(rows), model.shape.object_slots
    rays = RayRows(
        model.real(origins.copy()), model.real(directions), model.real(near[rows, columns]),
        model.real(far[rows, columns]), model.real(np.full(count, 0.5)), torch.zeros(count, dtype=torch.int32),
        torch.zeros(count, 1 + slots, dtype=torch.int64),
    )  # fmt: skip
    pairs = torch.tensor([[pose.person, pose.objects[0] if pose.objects else -1]])
    codes, lights = model.real(pose.code[None]), model.root_light([pose])
    out = trace(model, table, matrices, index, rays, pairs, codes, lights, TraceSettings(step=STEP, stop=0.0)).out
    (out[:, :4].sum() + 0.1 * out[:, 4].sum()).backward()
    found = {key: value.grad for key, value in model.named_parameters() if value.grad is not None}
    if dtype == torch.float32:  # the kernel adds up the table's gradient in a buffer of its own
        found["field.table"] = model.field.gradient.buffer
    return found, out.detach()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", POSES)
def test_gradients_are_finite_in_every_pose(name: str, dtype: torch.dtype) -> None:
    found, out = gradients(name, dtype)
    assert torch.isfinite(out).all()
    for key, value in found.items():
        assert torch.isfinite(value).all(), key
        assert value.abs().max() < 1e6, key
    assert found["field.table"].abs().max() > 0
    if name != "person absent":
        assert found["volumes.0.logits"].abs().max() > 0


@pytest.mark.parametrize("name", ["as it is", "opposed", "object inside"])
def test_gradients_in_float32_are_those_in_float64(name: str) -> None:
    """Samples within rounding of a cell's border may fall in it or not: directions are compared, not every number."""
    single, double = gradients(name, torch.float32)[0], gradients(name, torch.float64)[0]
    for key in ("field.density_in.weight", "field.colour_out.weight", "field.table"):
        one, other = single[key].double().flatten(), double[key].flatten()
        assert torch.cosine_similarity(one, other, dim=0) > 0.99, key
        assert float(one.norm() / other.norm()) == pytest.approx(1.0, abs=0.05), key
