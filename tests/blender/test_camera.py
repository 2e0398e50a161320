"""The sampled camera against Blender's own render of a cross: every sensor fit, shift, pixel aspect and percentage."""

from __future__ import annotations

import numpy as np
import pytest
from operation_helpers import bpy_pythons, run_bpy

pytestmark = pytest.mark.bpy


@pytest.mark.parametrize("python", bpy_pythons())
def test_points_are_where_cycles_shows_them(python: str, tmp_path) -> None:
    answer = run_bpy(python, "camera_cross.py", tmp_path)
    assert len(answer) == 17
    for name, case in answer.items():
        assert case["size"] == case["rendered"], name
        error = np.linalg.norm(np.array(case["seen"]) - np.array(case["placed"]), axis=-1)
        assert error.max() < 0.2, f"{name}: {error.round(3)} pixels off"
        spread = np.ptp(np.array(case["seen"]), axis=0)
        assert spread.min() > 8, f"{name}: the cross must fill the picture"
