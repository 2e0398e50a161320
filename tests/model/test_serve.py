"""The worker that stays up, as a process of its own and by its parts."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from cli_files import write_view_shot
from tiny_models import trained

from chona_model.formats.shot import read_shot
from chona_model.frame import render_frame
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor, save_actor
from chona_model.serve import LARGEST_SHOT, Inbox, RequestError, read_request
from chona_model.settings import RENDER_PRESETS


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """A model file and the bytes of a shot."""
    folder = tmp_path_factory.mktemp("served")
    dataset, trainer = trained()
    save_actor(folder / "model.safetensors", GridActor(trainer.model), "chona", {"preset": "fast"}, {"steps": 1})
    write_view_shot(folder / "a.shot.npz", dataset.views[1])
    return folder / "model.safetensors", (folder / "a.shot.npz").read_bytes()


def request(number: int, shot: bytes, preset: str = "preview", **more: object) -> bytes:
    line = {"request": number, "preset": preset, "bytes": len(shot), **more}
    return json.dumps(line).encode() + b"\n" + shot


def answers(output: bytes) -> list[tuple[dict, bytes]]:
    stream, found = io.BytesIO(output), []
    while line := stream.readline():
        event = json.loads(line)
        found.append((event, stream.read(event.get("bytes", 0))))
    return found


def start(model: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "chona_model", "serve", "--model", str(model)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def test_a_served_frame_is_the_baked_one(scene) -> None:
    model, shot = scene
    worker = start(model)
    out, errors = worker.communicate(request(7, shot, "final"), timeout=300)
    assert worker.returncode == 0, errors.decode()
    (ready, _), (frame, content) = answers(out)
    assert ready["event"] == "ready"
    assert {key: frame[key] for key in ("event", "request", "preset")} == {
        "event": "frame", "request": 7, "preset": "final",
    }  # fmt: skip
    pixels = np.frombuffer(content, "<f4").reshape(frame["height"], frame["width"], 5)
    expected = render_frame(load_actor(model), read_shot(io.BytesIO(shot)), 0, RENDER_PRESETS["final"])
    # Not bit for bit: torch's products round by the number of threads, which tests set to one.
    np.testing.assert_allclose(pixels[..., :4], expected.combined, rtol=0, atol=1e-5)
    solid = expected.combined[..., 3] > 0.01
    np.testing.assert_allclose(pixels[..., 4][solid], expected.depth[solid], rtol=1e-5)
    assert pixels[..., 3].max() > 0.9


def test_what_cannot_be_rendered_is_said_and_the_next_request_served(scene) -> None:
    model, shot = scene
    worker = start(model)
    assert worker.stdin is not None
    assert worker.stdout is not None
    assert json.loads(worker.stdout.readline())["event"] == "ready"
    for words, message in (
        (request(1, b"no shot at all"), "cannot read the shot"),
        (request(2, shot, "splendid"), "expected one of draft, preview, final, exact"),
        (request(3, shot, scale=0.0), "expected more than 0"),
    ):
        worker.stdin.write(words)
        worker.stdin.flush()
        event = json.loads(worker.stdout.readline())
        assert (event["event"], event["request"]) == ("error", int(words[12:13]))
        assert message in event["message"]
    out, _ = worker.communicate(request(4, shot, scale=0.5), timeout=60)
    ((half, content),) = answers(out)
    assert (half["event"], half["width"], half["height"]) == ("frame", 32, 24)
    assert len(content) == 32 * 24 * 5 * 4


def test_the_newest_request_overtakes_those_that_wait() -> None:
    inbox = Inbox(io.BytesIO(request(1, b"x") + request(2, b"y") + request(3, b"z")))
    with inbox._changed:
        inbox._changed.wait_for(lambda: inbox._ended, timeout=10)
    newest, overtaken = inbox.next()
    assert newest is not None
    assert (newest.number, overtaken) == (3, [1, 2])
    assert inbox.next() == (None, [])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (b"hello\n", "expected one line of JSON with request, preset and bytes"),
        (b'{"request": 1, "preset": "draft"}\n', "missing required field `bytes`"),
        (b'{"request": 1, "preset": "draft", "bytes": 10}\nshort', "announces 10 bytes and ends after 5"),
        (b'{"request": 1, "preset": "draft", "bytes": -1}\n', "announces -1 bytes"),
        (b'{"request": 1, "preset": "draft", "bytes": %d}\n' % (LARGEST_SHOT + 1), f"expected 1 to {LARGEST_SHOT}"),
    ],
)
def test_input_that_is_no_request_is_refused(words: bytes, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        read_request(io.BytesIO(words))


def test_the_worker_ends_with_its_parents_end_of_the_pipe(scene) -> None:
    worker = start(scene[0])
    assert worker.stdout is not None
    assert worker.stdin is not None
    assert json.loads(worker.stdout.readline())["event"] == "ready"
    closing = threading.Timer(0.2, worker.stdin.close)
    closing.start()
    assert worker.wait(timeout=30) == 0


def test_nonsense_on_standard_input_ends_the_worker_with_a_message(scene) -> None:
    worker = start(scene[0])
    _, errors = worker.communicate(b"GET / HTTP/1.1\n", timeout=300)
    assert worker.returncode == 2
    assert b"expected one line of JSON" in errors
