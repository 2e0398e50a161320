"""Folders of captures: every file of every layout spoiled; pickles, pictures and paths that attack."""

from __future__ import annotations

import contextlib
import gzip
import json
import struct
import sys
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from fuzzing import endured, start
from mutations import Attack, hand_written, npy_bytes, spoiled_pickle

pytestmark = pytest.mark.faults
CLAIM_OF_MEMORY = 2
"""Of ``hand_written``: what it remembers is small, only its place in a table is not, and there is no table here."""


def _read(root: Path, layout: str) -> None:
    """What training and check-data open; what is read must be finite and name nothing outside."""
    from chona_model.data.images import load_pixels
    from chona_model.data.opener import open_dataset
    from chona_model.data.soundness import check_dataset, check_pixels

    dataset = open_dataset(root, layout)
    check_dataset(dataset)
    for view in dataset.views:
        for path in (view.image, view.person_mask, view.object_mask):
            assert path is None or path.resolve().is_relative_to(root.resolve()), path
        for name in (view.sequence, view.frame, view.camera_name):
            assert not set(name) & set("/\\\0") and name not in ("", ".", ".."), name
        check_pixels(view, load_pixels(view))


def _family(layout: str) -> Callable[[Path], tuple[Any, Callable[[Any], object]]]:
    def family(folder: Path) -> tuple[Any, Callable[[Any], object]]:
        from captures import LAYOUTS

        root, mark = folder / layout, folder / "code was run"
        spoils = LAYOUTS[layout](root, str(mark))
        _read(root, layout)
        valid = {name: (root / name).read_bytes() for name in spoils}

        def read(spoiled: tuple[str, bytes]) -> None:
            name, content = spoiled
            (root / name).write_bytes(content)
            try:
                _read(root, layout)
            finally:
                (root / name).write_bytes(valid[name])
                assert not mark.exists(), "a file has run code"

        return st.one_of(*(st.tuples(st.just(name), each) for name, each in spoils.items())), read

    return family


behave, zju_mocap, transforms, co3d, blender = map(_family, ("behave", "zju_mocap", "transforms", "co3d", "blender"))


def pickles(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    """Without a reader around them."""
    from chona_model.data.restricted_pickle import read_object_npy, read_pickle

    mark, path = folder / "code was run", folder / "fit.pkl"
    valid = {"pose": np.zeros(156), "betas": [0.5, 1.0], "trans": np.ones(3, np.float32), "name": "x"}

    def read(content: bytes) -> None:
        path.write_bytes(content)
        endured(lambda: read_object_npy(path))
        try:
            read_pickle(path)
        finally:
            assert not mark.exists(), "a file has run code"

    spoiled = spoiled_pickle(valid, str(mark)) | spoiled_pickle(valid, str(mark), npy_of_object=True)
    return spoiled | st.binary(max_size=80), read


FAMILIES = {"behave": 50, "zju_mocap": 40, "transforms": 25, "co3d": 25, "blender": 50, "pickles": 150}


@pytest.mark.parametrize("family", FAMILIES)
def test_spoiled_captures_are_refused_or_read_whole(tmp_path: Path, often, family: str) -> None:
    report = start("test_fuzz_captures", family, often(FAMILIES[family], 10_000), tmp_path)
    assert f"{family}: 0 refused" not in report


@pytest.fixture
def capture(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A valid capture of the layout that the test is given."""
    from captures import LAYOUTS

    root = tmp_path / "inside" / "capture"
    LAYOUTS[request.param](root, str(tmp_path / "mark"))
    return root


def _refused(root: Path, layout: str, message: str) -> None:
    from chona_model.data.dataset import DatasetError

    with pytest.raises(DatasetError, match=message) as caught:
        _read(root, layout)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("number", range(len(hand_written(""))))
def test_pickles_that_no_pickler_writes_are_refused_at_once(tmp_path: Path, number: int) -> None:
    """Memory asked for, keys whose hash takes for ever, nesting, code: none gets anywhere."""
    from chona_model.data.restricted_pickle import read_pickle

    mark, path = tmp_path / "mark", tmp_path / "fit.pkl"
    path.write_bytes(hand_written(str(mark))[number])
    began = time.process_time()
    read = endured(lambda: read_pickle(path))
    assert time.process_time() - began < 5.0
    assert not mark.exists()
    assert read == (number == CLAIM_OF_MEMORY), "all others are refused"


@pytest.mark.parametrize(
    ("capture", "layout", "file"),
    [("behave", "behave", "sequences/Date01_Sub01_crate_lift/t0003.000/person/fit02/person_fit.pkl"),
     ("behave", "behave", "smplh/SMPL_male.pkl"), ("zju_mocap", "zju_mocap", "annots.npy"),
     ("zju_mocap", "zju_mocap", "new_params/0.npy")],
    indirect=["capture"],
)  # fmt: skip
def test_code_in_a_pickle_is_not_run(capture: Path, layout: str, file: str, tmp_path: Path) -> None:
    import pickle

    mark = tmp_path / "mark"
    content: Any = {"pose": Attack(str(mark)), "cams": Attack(str(mark))}
    if file.startswith("smplh"):
        (capture / "smplh" / "SMPL_male.npz").unlink()
    if file.endswith(".npy"):
        holder = np.empty((), dtype=object)
        holder[()] = content
        (capture / file).write_bytes(npy_bytes(holder))
    else:
        (capture / file).write_bytes(pickle.dumps(content))
    _refused(capture, layout, r"holds .*open, which is refused")
    assert not mark.exists()


def _changed(path: Path, change: Callable[[Any], object], packed: bool = False) -> None:
    content = json.loads(gzip.decompress(path.read_bytes()) if packed else path.read_bytes())
    change(content)
    text = json.dumps(content).encode()
    path.write_bytes(gzip.compress(text) if packed else text)


def _set(*path: Any) -> Callable[[Any], object]:
    *keys, last, value = path

    def change(content: Any) -> None:
        for key in keys:
            content = content[key]
        content[last] = value

    return change


CLIMBS = ("../secret.png", "{outside}/secret.png", "link/secret.png", "..\\secret.png", "linked.png")
"""Up, absolute, through a linked folder, up with Windows' separators, and a file that is a link."""


@pytest.mark.parametrize("climb", CLIMBS)
@pytest.mark.parametrize(
    ("capture", "layout", "file", "place", "packed"),
    [("transforms", "transforms", "transforms.json", ("frames", 0, "file_path"), False),
     ("transforms", "transforms", "transforms.json", ("frames", 0, "mask_path"), False),
     ("co3d", "co3d", "ball/frame_annotations.jgz", (0, "image", "path"), True),
     ("co3d", "co3d", "ball/frame_annotations.jgz", (0, "mask", "path"), True),
     ("co3d", "co3d", "ball/sequence_annotations.jgz", (0, "point_cloud", "path"), True)],
    indirect=["capture"],
)  # fmt: skip
def test_no_file_outside_is_opened(
    capture: Path, layout: str, file: str, place: tuple, packed: bool, climb: str, tmp_path: Path
) -> None:
    from captures import png

    outside = tmp_path / "outside"
    outside.mkdir()
    for folder in (outside, capture.parent):
        (folder / "secret.png").write_bytes(png())
    (capture / "link").symlink_to(outside)
    (capture / "linked.png").symlink_to(outside / "secret.png")
    _changed(capture / file, _set(*place, climb.format(outside=outside)), packed)
    _refused(capture, layout, "outside of its folder.*refused")


@pytest.mark.parametrize("climb", CLIMBS)
@pytest.mark.parametrize("capture", ["zju_mocap"], indirect=True)
def test_no_image_outside_of_a_subject_is_opened(capture: Path, climb: str, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.png").write_bytes(b"")
    (capture / "link").symlink_to(outside)
    (capture / "linked.png").symlink_to(outside / "secret.png")
    cams = {"K": [np.eye(3)], "D": [np.zeros(5)], "R": [np.eye(3)], "T": [np.zeros(3)]}
    holder = np.empty((), dtype=object)
    holder[()] = {"cams": cams, "ims": [{"ims": [climb.format(outside=outside)]}]}
    (capture / "annots.npy").write_bytes(npy_bytes(holder))
    _refused(capture, "zju_mocap", "outside of its folder.*refused")


@pytest.mark.parametrize("name", ["../../../up", "/abs", "a/b", "..", "", "x" * 200, "a\0b"])
@pytest.mark.parametrize(
    "rename",
    [lambda c, n: c["sequences"][0].update(name=n), lambda c, n: c["sequences"][0].update(cameras=[n]),
     lambda c, n: (c["persons"].update({n: c["persons"].pop("Sub01")}), c["sequences"][0].update(person=n))],
    ids=["sequence", "camera", "person"],
)  # fmt: skip
@pytest.mark.parametrize("capture", ["blender"], indirect=True)
def test_names_that_would_be_paths_are_refused(capture: Path, name: str, rename: Callable[[Any, str], object]) -> None:
    """Folders and files are called after them, also those that are written (check-data --out, evaluate)."""
    _changed(capture / "capture.json", lambda content: rename(content, name))
    _refused(capture, "blender", "expected one that files can be called after")


@pytest.mark.parametrize("capture", ["co3d"], indirect=True)
def test_a_scans_name_that_would_be_a_path_is_refused(capture: Path) -> None:
    for file in ("frame_annotations.jgz", "sequence_annotations.jgz"):
        _changed(
            capture / "ball" / file, lambda content: [each.update(sequence_name="../../up") for each in content], True
        )
    _refused(capture, "co3d", "expected one that files can be called after")


@pytest.mark.parametrize("capture", ["behave"], indirect=True)
def test_calibrations_outside_of_behave_are_passed_over(capture: Path, tmp_path: Path) -> None:
    """info.json names the places of its authors' disk; what lies there now is somebody else's."""
    other = tmp_path / "other" / "0"
    other.mkdir(parents=True)
    (other / "calibration.json").write_text("{}")
    for stated in (str(tmp_path / "other"), "../../../../other", "x" * 5000, "a\0b"):
        _changed(
            capture / "sequences" / "Date01_Sub01_crate_lift" / "info.json",
            lambda content, stated=stated: content.update(intrinsic=stated, cat="../../../other"),
        )
        _read(capture, "behave")


def _png_of(width: int, height: int, data: bytes = b"") -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", data or zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(100_000, 100_000), (12_000, 12_000), ((1 << 31) - 1, 1)])
@pytest.mark.parametrize(("capture", "layout"), [("blender", "blender"), ("behave", "behave")], indirect=["capture"])
def test_a_picture_that_claims_a_gigapixel_is_not_unpacked(capture: Path, layout: str, size: tuple[int, int]) -> None:
    for name in ("sequences/lift/0001/k0.color.png", "sequences/Date01_Sub01_crate_lift/t0003.000/k0.color.png"):
        if (capture / name).exists():
            (capture / name).write_bytes(_png_of(*size))
    _refused(capture, layout, "pixels")


def test_a_chunk_that_claims_gigabytes_is_not_believed(tmp_path: Path) -> None:
    """A picture of another picture's size with a chunk of 2.6 GB behind its data: Pillow would ask for as much."""
    from chona_model.data.dataset import DatasetError
    from chona_model.data.images import read_image

    content = _png_of(2, 1, zlib.compress(bytes(7)))
    at = content.index(b"IDAT") - 4
    (tmp_path / "valid.png").write_bytes(content)
    assert read_image(tmp_path / "valid.png", "RGB", (1, 2), "").shape == (1, 2, 3)
    lie = struct.pack(">I", 2_600_000_000)
    (tmp_path / "lie.png").write_bytes(content[:at] + lie + content[at + 4 :])
    tracemalloc.start()
    with contextlib.suppress(DatasetError):
        read_image(tmp_path / "lie.png", "RGB", (1, 2), "")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10_000_000


@pytest.mark.parametrize("capture", ["transforms"], indirect=True)
def test_other_programs_are_not_started_for_a_picture(capture: Path) -> None:
    """Pillow starts Ghostscript for EPS."""
    eps = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 16 12\n%%EndComments\n(mark) (w) file\n"
    (capture / "images" / "0.png").write_bytes(eps)
    _refused(capture, "transforms", "cannot read the image")


@pytest.mark.parametrize("capture", ["co3d"], indirect=True)
def test_annotations_that_unpack_without_end_are_refused(capture: Path) -> None:
    (capture / "ball" / "frame_annotations.jgz").write_bytes(gzip.compress(b" " * (64 << 20)))
    _refused(capture, "co3d", "unpacks to more than")
