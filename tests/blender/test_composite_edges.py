"""Edges of composited layers against what is counted by hand: wires in front and behind, soft edges, several layers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from composite_truth import CASES, error, is_edge, render_cases
from operation_helpers import bpy_pythons

NOISE = 0.02
"""What 256 samples leave of a wire's coverage, times its contrast of 0.8."""

pytestmark = pytest.mark.bpy


@pytest.fixture(scope="module", params=bpy_pythons())
def rendered(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every case, composited by depth and refined, in one version of Blender."""
    folder = tmp_path_factory.mktemp("edges")
    render_cases(request.param, folder)
    return folder


@pytest.mark.parametrize("name", CASES)
def test_refined_is_right_in_every_pixel(rendered: Path, name: str) -> None:
    """Also where a wire covers a third of the pixel, over opaque and transparent film, alone and between layers."""
    found = error(rendered, name, "refined")
    assert found.max() < NOISE
    assert found.mean() < NOISE / 10


@pytest.mark.parametrize("name", CASES)
def test_depth_is_right_but_where_the_scene_in_front_covers_a_pixel_in_part(rendered: Path, name: str) -> None:
    """Soft edges of the figure over anything, and two layers' soft edges over each other, leave no fringe at all."""
    found = error(rendered, name, "depth")
    assert found[~is_edge(CASES[name])].max(initial=0.0) < 2e-3


@pytest.mark.parametrize("name", ["behind a wire", "behind a bar", "transparent film", "two layers and wires"])
def test_refined_is_worth_its_time(rendered: Path, name: str) -> None:
    """The fringe that depth leaves at wires is ten times what refined does."""
    edge = is_edge(CASES[name])
    depth, refined = (error(rendered, name, edges)[edge] for edges in ("depth", "refined"))
    assert depth.mean() > 10.0 * refined.mean()
    assert np.quantile(refined, 0.95) < NOISE
