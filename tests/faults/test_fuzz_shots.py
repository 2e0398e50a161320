"""Shots, and what the live worker's parent writes: refused by name, or read whole."""

from __future__ import annotations

import io
import json
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))

from fuzzing import start
from mutations import deep_json, npy, npy_bytes, packed, spoiled_bytes, spoiled_json, spoiled_npz

pytestmark = pytest.mark.faults
FRAMES = 2


def _shot() -> Any:
    """A shot that has everything: two actors, a shutter, a lens, a scale."""
    from chona_model.formats.shot import Lens, Shot, ShotActor, Shutter

    def still(*shape: int) -> np.ndarray:
        return np.broadcast_to(np.eye(4), (*shape, 4, 4)).copy()

    intrinsics = np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
    actors = (
        ShotActor(
            "Robin", "Sub01", ("crate",), ("pelvis", "spine"), still(FRAMES, 2), still(FRAMES, 1), "m.safetensors"
        ),
        ShotActor("box", None, ("crate",), (), still(FRAMES, 0), still(FRAMES, 1)),
    )
    shutter = Shutter(
        np.array([-0.25, 0.25]), np.broadcast_to(intrinsics, (FRAMES, 2, 3, 3)).copy(), still(FRAMES, 2),
        (still(FRAMES, 2, 2), still(FRAMES, 2, 0)), (still(FRAMES, 2, 1), still(FRAMES, 2, 1)),
    )  # fmt: skip
    lens = Lens(np.full(FRAMES, 2.0), np.full(FRAMES, 0.01), np.full(FRAMES, 5.0), np.zeros(FRAMES), np.ones(FRAMES))
    return Shot(
        "walk", 24.0, 64, 48, "PERSP", np.array([-1, 4]), np.broadcast_to(intrinsics, (FRAMES, 3, 3)).copy(),
        still(FRAMES), np.broadcast_to([0.1, 100.0], (FRAMES, 2)).copy(), actors, 2.0, shutter, lens, 16,
    )  # fmt: skip


def _arrays() -> dict[str, np.ndarray]:
    from chona_model.formats.shot import write_shot_to

    stream = io.BytesIO()
    write_shot_to(stream, _shot())
    stream.seek(0)
    with np.load(stream) as content:
        return {name: content[name] for name in content.files}


def _sound(shot: Any) -> None:
    """What a shot promises once it is read, checked without its own checks."""
    from chona_model.formats.exr import frame_name

    assert len(frame_name(shot.name, int(shot.frames[-1])).encode()) <= 255 and shot.width * shot.height <= 1 << 28
    for index in range(len(shot)):
        camera = shot.camera(index)
        assert np.isfinite(camera.intrinsics).all() and np.isfinite(np.linalg.inv(camera.intrinsics)).all()
    for array in [shot.clip, *(a.world_from_bone for a in shot.actors), *(a.world_from_object for a in shot.actors)]:
        assert np.isfinite(array.astype(np.float32)).all() and len(array) == len(shot)


def shots(folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    from chona_model.formats.shot import read_shot
    from chona_model.shot_models import find_models

    path = folder / "walk.shot.npz"

    def read(content: bytes) -> None:
        path.write_bytes(content)
        _sound(read_shot(path))
        shot = read_shot(io.BytesIO(content))
        named = tuple(actor for actor in shot.actors if actor.model not in (None, "m.safetensors"))
        if named:
            find_models(replace(shot, actors=named[:1], shutter=None), path, folder)

    arrays = _arrays()
    read(packed({name: npy_bytes(array) for name, array in arrays.items()}))
    return spoiled_npz(arrays, "header"), read


def requests(_folder: Path) -> tuple[Any, Callable[[bytes], object]]:
    """The live worker's input up to its end; nobody may wait for ever."""
    from chona_model.serve import Inbox

    line = {"request": 7, "preset": "draft", "bytes": 4, "scale": 0.5}
    stream = st.one_of(
        spoiled_bytes((json.dumps(line).encode() + b"\nshot") * 3),
        spoiled_json(line).map(lambda text: text + b"\nshot"),
        spoiled_json(line).map(lambda text: text[:70_000] + b"\nshot"),
    )  # fmt: skip

    def read(content: bytes) -> None:
        inbox = Inbox(io.BytesIO(content))
        with inbox._changed:
            assert inbox._changed.wait_for(lambda: inbox._ended, timeout=20), "the worker waits for ever"
        while inbox.next()[0] is not None:
            pass

    return stream, read


@pytest.mark.parametrize(("family", "few"), [("shots", 120), ("requests", 80)])
def test_spoiled_shots_and_requests_are_refused_or_read_whole(tmp_path: Path, often, family: str, few: int) -> None:
    report = start("test_fuzz_shots", family, often(few, 10_000), tmp_path)
    assert f"{family}: 0 refused" not in report


def _bomb() -> bytes:
    """120 kB that unpack to 120 MB of zeros, of which there are ten."""
    zeros = npy("'<f8'", "(15000000,)", bytes(120_000_000))
    return packed({f"a{number}": zeros for number in range(3)})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (lambda: packed({"header": npy("'<f8'", "(1000000000000,)")}), "more than"),
        (lambda: packed({"header": npy("'|O'", "()", b"cos\nsystem\n(S'true'\ntR.")}), "no plain array of numbers"),
        (lambda: packed({"header": npy("'<f99'", "()")}), "numbers of the unknown type <f99"),
        (lambda: packed({"header": npy("-" * 9000 + "1", "()")}), "no plain array of numbers"),
        (_bomb, "more than"),
        (lambda: b"PK\x03\x04", "not a zip file"),
    ],
)
def test_bombs_are_refused_before_they_unpack(tmp_path: Path, content: Callable[[], bytes], message: str) -> None:
    from chona_model.formats.shot import ShotError, read_shot

    path = tmp_path / "walk.shot.npz"
    path.write_bytes(content())
    with pytest.raises(ShotError, match=message):
        read_shot(path)


@pytest.mark.parametrize(
    "name", ["../out", "/abs", "a/b", "a\\b", "..", ".hidden", "a\nb", "a\0", "x" * 201, "ü" * 101, "con:x", "a|b", ""]
)
def test_a_shots_name_stays_in_the_output_folder(name: str) -> None:
    from chona_model.formats.shot import ShotError

    with pytest.raises(ShotError, match="name"):
        replace(_shot(), name=name)


@pytest.mark.parametrize(
    "model", ["../secret.txt", "/etc/passwd", "a\0.safetensors", "x" * 5000 + ".safetensors", "gone.safetensors"]
)
def test_a_shots_model_is_a_model_file_or_refused(tmp_path: Path, model: str) -> None:
    from chona_model.formats.shot import ShotError
    from chona_model.shot_models import find_models

    shot = _shot()
    actor = replace(shot.actors[0], model=model)
    with pytest.raises(ShotError, match=r"expected a \.safetensors file|there is no file"):
        find_models(replace(shot, actors=(actor,), shutter=None), tmp_path / "m.safetensors", tmp_path)


@pytest.mark.parametrize(
    "text",
    [deep_json(60_000).encode(), b'{"request": 1e999, "preset": "draft", "bytes": 1}',
     b'{"request": 1, "preset": 5, "bytes": 1}',
     b"1" * 6000, b"[]", b"null", b'{"request": NaN, "preset": "x", "bytes": 1}'],
)  # fmt: skip
def test_no_line_leaves_the_worker_waiting(text: bytes) -> None:
    """Once, an exception that nobody expected ended the thread that reads, and the worker waited for it."""
    from chona_model.serve import Inbox, RequestError

    inbox = Inbox(io.BytesIO(text + b"\n"))
    answers: list[object] = []

    def ask() -> None:
        try:
            answers.append(inbox.next())
        except RequestError as error:
            answers.append(error)

    waiting = threading.Thread(target=ask, daemon=True)
    waiting.start()
    waiting.join(timeout=30)
    assert len(answers) == 1 and isinstance(answers[0], RequestError)
    assert "expected one line of JSON" in str(answers[0])
