"""``blender --command chona shot``: what a farm bakes, written where there is no worker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from operation_helpers import bpy_pythons, run_bpy, write_header_only_model

pytestmark = pytest.mark.bpy


@pytest.mark.parametrize("python", bpy_pythons())
def test_the_shot_is_written_alone(python: str, tmp_path: Path) -> None:
    """Frames, name and poses are the scene's; the only line on stdout is the file."""
    out = tmp_path / "out"
    answer = run_bpy(python, "farm_shot.py", write_header_only_model(tmp_path / "Robin.safetensors"), out)
    assert answer["codes"] == [0, 2] and "none.safetensors" in answer["said"]
    assert answer["told"] == f"{out / 'walk.shot.npz'}\n" and answer["files"] == ["walk.shot.npz"]
    assert answer["frames"] == [-2, 0, 2, 4] and answer["header"]["name"] == "walk"
    assert [actor["person"] for actor in answer["header"]["actors"]] == ["Robin"]
    # Keys hold before the first: frames 1 to 9 move 0.1 m each.
    np.testing.assert_allclose(np.diff(answer["root"]), [0.0, 0.1, 0.2], atol=1e-6)
