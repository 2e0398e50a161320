"""8-bit pictures: what a file shows of colours inside and outside of 0…1."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from chona_model.formats.atomic import WriteError
from chona_model.formats.picture import save_picture


def test_a_picture_is_rounded_and_clipped(tmp_path: Path) -> None:
    file = tmp_path / "new folder" / "picture.png"
    rgb = np.array([[[0.0, 0.5, 1.0], [-0.3, 1.4, 0.3 / 255]], [[0.6 / 255, 100 / 255, 254.6 / 255]] * 2])
    save_picture(file, rgb.astype(np.float32))
    with Image.open(file) as image:
        assert (image.format, image.mode) == ("PNG", "RGB")
        shown = np.asarray(image)
    assert shown.tolist() == [[[0, 128, 255], [0, 255, 0]], [[1, 100, 255]] * 2]
    assert [path.name for path in file.parent.iterdir()] == ["picture.png"]


def test_a_picture_that_cannot_be_written_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(WriteError, match=r"picture\.png"):
        save_picture(tmp_path / "file" / "picture.png", np.zeros((2, 2, 3)))
