"""A captured image shows the frame that its pose was sampled at."""

from __future__ import annotations

import pytest
from operation_helpers import bpy_pythons, run_bpy

pytestmark = pytest.mark.bpy


@pytest.mark.parametrize("python", bpy_pythons())
def test_images_follow_the_animation(python: str, tmp_path) -> None:
    answer = run_bpy(python, "capture_moves.py", tmp_path)
    # 64 pixels over 4 units, the middle at 32: one unit is 16 pixels.
    assert answer["colour"] == pytest.approx([16.0, 32.0, 48.0], abs=0.3)
    assert answer["masks"] == pytest.approx([16.0, 32.0, 48.0], abs=0.3)
    assert answer["unmoved"]
