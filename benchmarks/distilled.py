"""What a field without perceptrons would cost: density and colour of one identity pair read off into plain grids.

An experiment, not a setting: ``draft`` frames traced in stages with the field, and with grids of several spacings in
its place, both without the pose's occlusion.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.common import Bench, save
from chona_model.data.dataset import View
from chona_model.data.images import load_pixels
from chona_model.evaluate.metrics import psnr
from chona_model.grid_model import GridModel
from chona_model.render.posed import depth_spans
from chona_model.render.tracing import RayRows, TraceSettings, make_pose_table, trace
from chona_model.settings import RENDER_PRESETS

SPACINGS = (0.015, 0.01, 0.0075)
"""Metres between the grids' points."""

VIEWS = 4


class PlainGrids(nn.Module):
    """Density and colour of every part at the points of a grid, for one pair of identities; takes a field's place."""

    def __init__(self, model: GridModel, pair: Tensor, spacing: float) -> None:
        super().__init__()
        lower, upper = model.boxes
        self.spacing, self.lower = spacing, torch.as_tensor(lower, dtype=torch.float32)
        self.grids: list[Tensor] = []
        for part in range(len(lower)):
            dims = [int(n) for n in np.ceil((upper[part] - lower[part]) / spacing).astype(int) + 1]
            axes = [float(lower[part][k]) + spacing * torch.arange(dims[k]) for k in range(3)]
            points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3).float()
            index = torch.zeros(len(points), dtype=torch.int64)
            density, rgb = model.field(points, torch.full_like(index, part).int(), pair, index, None, index)
            grid = torch.cat([density[:, None], rgb], dim=1).T.reshape(1, 4, *dims)
            self.grids.append(grid)

    def forward(self, points: Tensor, part: Tensor, *_: Tensor | None) -> tuple[Tensor, Tensor]:
        """As ``GridField``'s; pair and pose are settled."""
        out = points.new_zeros(len(points), 4)
        for number, grid in enumerate(self.grids):
            mine = (part == number).nonzero()[:, 0]
            size = torch.tensor(grid.shape[2:]) - 1
            place = (points[mine] - self.lower[number]) / self.spacing / size * 2.0 - 1.0
            found = nn.functional.grid_sample(grid, place.flip(-1)[None, None, None], align_corners=True)
            out[mine] = found[0, :, 0, 0].T
        return out[:, 0], out[:, 1:]


@torch.no_grad()
def measure(bench: Bench) -> None:
    """Writes ``distilled.json``."""
    actor, _ = bench.seen()
    views = bench.dataset(bench.test).views
    chosen = [views[index] for index in np.linspace(0, len(views) - 1, VIEWS).astype(int)]
    rows = {"field": _scores(actor.model, chosen)}
    for spacing in SPACINGS:
        posed = actor.model.posed(chosen[0].pose)
        pair = torch.tensor([[posed.person, posed.objects[0] if posed.objects else -1]])
        grids = PlainGrids(actor.model, pair, spacing)
        rows[f"{1000 * spacing:g} mm"] = _scores(actor.model, chosen, grids)
    save("distilled", {"views": VIEWS, "settings": "draft at full resolution, no occlusion", "psnr": rows})


def _scores(model: GridModel, views: list[View], field: PlainGrids | None = None) -> float:
    """Mean PSNR against the pictures, dB."""
    draft, found = RENDER_PRESETS["draft"], []
    for view in views:
        posed = model.posed(view.pose)
        table, (matrices, index) = make_pose_table(model, [posed]), model.matrices([posed], draft.offset)
        near, far = depth_spans(table.parts[0], posed.figure, view.camera)
        rows, columns = np.nonzero(far > near)
        origins, directions = posed.figure.rays(view.camera, np.stack([columns, rows], axis=-1) + 0.5)
        arrays = (origins, directions, near[rows, columns], far[rows, columns], np.full(len(rows), 0.5))
        count = len(rows)
        rays = RayRows(
            *(torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32) for array in arrays),
            torch.zeros(count, dtype=torch.int32), torch.zeros(count, 1 + len(posed.objects), dtype=torch.int64),
        )  # fmt: skip
        pairs = torch.tensor([[posed.person, posed.objects[0] if posed.objects else -1]])
        lights, own = model.root_light([posed]), model.field
        settings = TraceSettings(step=draft.step, stop=draft.stop, trust=0.0)
        if field is not None:
            model.field = field  # type: ignore[assignment]
        out = trace(model, table, matrices, index, rays, pairs, None, lights, settings).out.numpy()
        model.field = own
        picture = np.zeros((view.camera.height, view.camera.width, 3), np.float32)
        picture[rows, columns] = np.clip(out[:, :3], 0.0, 1.0)
        found.append(psnr(picture, load_pixels(view).rgb))
    return round(float(np.mean(found)), 2)
