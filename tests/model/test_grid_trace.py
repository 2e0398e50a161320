"""Rays traced in one pass each way against the same in stages: values and every gradient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_models import lit, trained

from chona_model import grid_trace
from chona_model.grid_inputs import parts_of, starts_of, surfaces_of
from chona_model.grid_trace import PoseRays, trace_rays
from chona_model.kernels.cpu.sample import GivenRays
from chona_model.kernels.threads import in_pieces
from chona_model.kernels.warp import NewtonLimits
from chona_model.render.posed import depth_spans
from chona_model.render.tracing import RayRows, TraceSettings, make_pose_table, trace

SETTINGS = TraceSettings(step=0.02, newton=NewtonLimits(steps=12, tolerance=1e-6), trust=0.0, stop=0.0)


class Case:
    """Some hundred rays of two poses, with several identity pairs, and a random loss."""

    def __init__(self, objects: int) -> None:
        dataset, trainer = trained(200, persons=2, objects=objects)
        self.model, random = lit(trainer.model), np.random.default_rng(1)
        views = [dataset.views[0], dataset.views[-1]]
        self.posed = [self.model.posed(view.pose) for view in views]
        self.table = make_pose_table(self.model, self.posed)
        lights = self.model.root_light(self.posed).detach().numpy()
        self.pairs = torch.tensor([[0, 0], [1, 0], [-1, 0], [0, -1]])
        self.rays = []
        for number, view in enumerate(views):
            near, far = depth_spans(self.table.parts[number], self.posed[number].figure, view.camera)
            rows, columns = np.nonzero(far > near)
            pick = random.choice(len(rows), 300)
            places = np.stack([columns[pick], rows[pick]], axis=-1) + random.random((300, 2))
            origins, directions = self.posed[number].figure.rays(view.camera, places)
            occupancy = self.model.occupancy
            self.rays.append(
                PoseRays(
                    self.posed[number], torch.zeros(0), starts_of(self.table.parts[number]),
                    parts_of(self.model, self.posed[number], occupancy, surfaces_of(occupancy), lights[number]),
                    GivenRays(
                        origins.astype(np.float32), directions.astype(np.float32), near[rows, columns][pick],
                        far[rows, columns][pick], random.random(300, dtype=np.float32),
                        random.integers(4, size=(300, 2)), number,
                    ),
                )
            )  # fmt: skip
        self.codes = torch.as_tensor(np.stack([posed.code for posed in self.posed]), dtype=torch.float32)
        self.factors = torch.as_tensor(random.normal(size=(600, 6)) * 1e-3, dtype=torch.float32)

    def outcome(self, fused: bool, settings: TraceSettings = SETTINGS) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Results and gradients by parameter's name."""
        self.model.zero_grad()
        self.model.field.gradient.buffer.zero_()
        dtype = self.model.field.lower.dtype
        if fused:
            blended = [self.model.matrices([posed])[0] for posed in self.posed]
            lights = self.model.root_light(self.posed)
            rays = [
                replace(rays, matrices=matrices, parts=rays.parts._replace(light=light.detach().numpy()))
                for rays, matrices, light in zip(self.rays, blended, lights, strict=True)
            ]
            out, _ = trace_rays(self.model, rays, self.pairs, self.codes, lights, settings)
        else:
            given = [rays.given for rays in self.rays]
            columns = [
                torch.from_numpy(np.concatenate([getattr(each, name) for each in given])).to(dtype)
                for name in ("origins", "directions", "near", "far", "jitter")
            ]
            pose = torch.arange(2, dtype=torch.int32).repeat_interleave(300)
            pair = torch.from_numpy(np.concatenate([each.pair for each in given]))
            matrices, index = self.model.matrices(self.posed)
            out = trace(
                self.model, self.table, matrices, index, RayRows(*columns, pose, pair), self.pairs,
                self.codes.to(dtype), self.model.root_light(self.posed), settings,
            ).out  # fmt: skip
        (out * self.factors).sum().backward()
        grads = {n: p.grad.clone() for n, p in self.model.named_parameters() if p.grad is not None}
        return out.detach(), grads | {"table": self.model.field.gradient.buffer.clone()}


@pytest.mark.parametrize("objects", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_one_pass_equals_the_stages(objects: int) -> None:
    case = Case(objects)
    out, grads = case.outcome(True)
    expected, twins = case.outcome(False)
    assert expected[:, 3].max() > 0.9
    difference = (out - expected).abs()
    # A ray may gain or lose a sample that falls within rounding of an occupancy cell's border.
    assert difference.amax(dim=1).kthvalue(int(0.98 * len(out))).values < 1e-3
    assert set(grads) == set(twins)
    for name, twin in twins.items():
        scale = twin.abs().max()
        assert scale > 0 or name.endswith("object_codes"), name
        assert (grads[name] - twin).norm() <= 0.03 * twin.norm() + 1e-9, name


def test_gradients_are_those_of_finite_differences() -> None:
    """The loss along the gradient, where no sample appears or vanishes: parameters of the perceptrons."""
    case = Case(1)
    _, grads = case.outcome(True)
    for short in ("colour_out.weight", "density_out.bias", "person_codes", "pose_in.weight", "light"):
        name = f"field.{short}"
        parameter = dict(case.model.named_parameters())[name]
        direction = grads[name] / grads[name].norm()
        values = []
        for sign in (1.0, -1.0):
            with torch.no_grad():
                parameter += sign * 1e-2 * direction
            values.append(float((case.outcome(True)[0].double() * case.factors).sum()))
            with torch.no_grad():
                parameter -= sign * 1e-2 * direction
        slope = (values[0] - values[1]) / 2e-2
        assert slope == pytest.approx(float(grads[name].norm()), rel=0.02), name


def test_neither_threads_nor_room_change_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case(1)
    out, grads = case.outcome(True)
    monkeypatch.setattr(grid_trace, "in_pieces", lambda f, n, _: [f(k, k + 1) for k in range(n)])
    again, twins = case.outcome(True)
    assert torch.equal(out, again)
    assert all(torch.equal(grads[name], twins[name]) for name in grads)
    assert in_pieces is not grid_trace.in_pieces


def test_the_early_stop_evaluates_less_and_sees_nearly_the_same() -> None:
    case = Case(1)
    settings = TraceSettings(step=0.02, stop=1e-2)
    out, _ = case.outcome(True, settings)
    whole, _ = case.outcome(True, TraceSettings(step=0.02, stop=0.0))
    brightest = max(1.0, float(whole[:, :3].max()))  # light may take colours beyond 1
    assert (out[:, :4] - whole[:, :4]).abs().max() < 0.011 * brightest
