"""What workers write and Blender reads: events, pictures, logs; and the notes that processes leave for each other."""

from __future__ import annotations

import io
import json
import math
import sys
import tracemalloc
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "blender"))

from fuzzing import CPU_SECONDS, SECONDS, SEED, start
from mutations import deep_json, spoiled_bytes, spoiled_json
from operation_helpers import bpy_pythons, run_bpy, write_header_only_model
from worker_messages import BAKED, EVENTS, FRAME, LOG, PIXELS, PROGRESS, READY, RESULTS, answers, line

pytestmark = pytest.mark.faults
Read = tuple[Any, Callable[[bytes], object]]


def _refused(words: str) -> Exception:
    from chona_blender.errors import ChonaError

    return ChonaError(words)


def _sound(value: object) -> None:
    """Everything in an event can be shown and counted with, checked without the add-on's own checks."""
    if isinstance(value, dict):
        for name, item in value.items():
            _sound(name)
            _sound(item)
    elif isinstance(value, list):
        for item in value:
            _sound(item)
    elif isinstance(value, str):
        value.encode()
        assert len(value) <= 4096 and not any(ord(each) < 32 or 127 <= ord(each) < 160 for each in value)
    else:
        assert value is None or (isinstance(value, int | float) and math.isfinite(value) and abs(value) < 1e16)


spoiled_event = st.sampled_from(EVENTS).flatmap(spoiled_json)


def events(_folder: Path) -> Read:
    """One line: an event that holds what its kind promises, or a line of the log; and the next one is read."""
    from chona_blender.events import parse_event, read_lines

    def read(content: bytes) -> None:
        found = [parse_event(each) for each in read_lines(io.BytesIO(content + b"\n" + line(BAKED)))]
        good = [event for event in found if event is not None]
        for event in good:
            _sound(event)
            assert event["event"] in {each["event"] for each in EVENTS}
            assert event["event"] != "frame" or FRAME.keys() - {"job"} <= event.keys()
            assert all(isinstance(event[name], int) and event[name] >= 0 for name in ("written", "skipped", "bytes")
                       if name in event)  # fmt: skip
        assert good[-1]["written"] == 48 and good[-1]["max_error"]["unsettled"] == 3
        if len(good) < 2:
            raise _refused("a line that is no event stays a line of the log")

    for each in EVENTS:
        kept = parse_event(line(each).decode())
        assert kept is not None and kept["event"] == each["event"]
        read(line(each))
    return spoiled_event, read


def pictures(_folder: Path) -> Read:
    """A live worker's answers: every picture that comes is one that was announced, and whole."""
    from chona_blender.live_frames import read_answers

    def read(content: bytes) -> None:
        said: list[str] = []
        for event, frame in read_answers(io.BytesIO(content), said.append):
            _sound(event)
            assert (frame is not None) == (event["event"] == "frame")
            if frame is not None:
                assert frame.rgba.shape == (event["height"], event["width"], 4)
                assert frame.depth.shape == (event["height"], event["width"])
                sent = np.concatenate([frame.rgba, frame.depth[..., None]], axis=-1).astype("<f4").tobytes()
                assert sent in content and len(sent) == event["bytes"]
        for each in said:
            _sound(each)

    valid = answers()
    read(valid)
    frame = spoiled_json(FRAME).map(lambda text: line(READY) + text + b"\n" + PIXELS + line(FRAME) + PIXELS)
    return st.one_of(spoiled_bytes(valid), frame), read


def logs(folder: Path) -> Read:
    """A training's log: what is understood becomes a picture of its curves."""
    from chona_blender.train_log import draw_curves, read_log

    path = folder / "log.jsonl"

    def read(content: bytes) -> None:
        path.write_bytes(content)
        log = read_log(path)
        for values in (log.step, log.loss, log.psnr):
            assert np.isfinite(values).all() and len(values) == len(log.preview_psnr)
        picture = draw_curves(log, (120, 100))
        assert picture.shape == (100, 120, 3) and picture.min() >= 0.0 and picture.max() <= 1.0
        if len(log.step) < len(LOG):
            raise _refused("a line that no training writes is left out")

    rows = b"".join(map(line, LOG))
    read(rows)
    row = st.sampled_from(LOG).flatmap(spoiled_json).map(lambda text: rows[: rows.index(b"\n") + 1] + text + b"\n")
    return st.one_of(spoiled_bytes(rows), row.map(lambda text: text + line(LOG[-1]))), read


def locks(_folder: Path) -> Read:
    """A lock's file: who holds it, or nobody who says who he is."""
    from chona_model.formats.folder_lock import Holder, _words, parse_holder
    from chona_model.owner import this_process

    holder = Holder(this_process(), "2026-01-02 03:04:05", "the shot walk", frozenset({1, 2, 3}))
    valid = json.loads(holder.text())
    assert parse_holder(holder.text()) == holder

    def read(content: bytes) -> None:
        found = parse_holder(content.decode("utf-8", "replace"))
        if found is None:
            raise _refused("a lock that does not say whose it is")
        assert isinstance(found.owner.is_here and found.owner.is_alive(), bool)
        words = _words(Path("out/.chona-1.lock"), found, holder)
        assert len(words.encode()) < 4000 and isinstance(found.meets(holder), bool)

    return spoiled_json(valid), read


def claims(folder: Path) -> Read:
    """A claim on a frame: it is respected or taken over, and what is taken over is this process's."""
    from chona_model.claims import FOLDER, Claims, claim_path

    place = folder / FOLDER
    valid = {"host": "a", "pid": 7, "state": "held", "beats": 2, "token": "0" * 16, "key": "k"}

    def read(content: bytes) -> None:
        for path in place.glob("*.json"):
            path.unlink()
        claim_path(place, "walk_0001", 0).write_bytes(content)
        claim = Claims(folder, 60.0).take("walk_0001", "other")
        if claim is None:
            raise _refused("somebody else may be at this frame still")
        assert claim.is_ours() and claim_path(place, "walk_0001", 1).is_file()

    place.mkdir()
    states = st.sampled_from(("held", "done", "free")).flatmap(lambda state: spoiled_json(valid | {"state": state}))
    return states, read


FAMILIES = [("events", 250), ("pictures", 120), ("logs", 80), ("locks", 80), ("claims", 80)]


@pytest.mark.parametrize(("family", "few"), FAMILIES)
def test_spoiled_messages_are_understood_or_left_alone(tmp_path: Path, often, family: str, few: int) -> None:
    report = start("test_fuzz_messages", family, often(few, 10_000), tmp_path)
    assert f"{family}: 0 refused" not in report and ", 0 read" not in report


class Endless(io.RawIOBase):
    """A pipe into which somebody writes and writes."""

    def __init__(self, left: int, end: bytes) -> None:
        self.left, self.end = left, end

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        size = min(len(buffer), self.left)
        if size:
            buffer[:size] = b"x" * size
            self.left -= size
            return size
        size = min(len(buffer), len(self.end))
        buffer[:size], self.end = self.end[:size], self.end[size:]
        return size


def test_a_line_without_end_takes_little_memory_and_hides_nothing_after_it() -> None:
    from chona_blender.events import LONGEST_LINE, parse_event, read_lines

    tracemalloc.start()
    stream = io.BufferedReader(Endless(100_000_000, b"\n" + line(BAKED)))
    first, second = read_lines(stream)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(first) == LONGEST_LINE and peak < 8 * LONGEST_LINE
    assert parse_event(first) is None and parse_event(second)["written"] == 48


@pytest.mark.parametrize(
    "text",
    ['{"event": "progress", "done": NaN}', '{"event": "progress", "done": 1e999}', '{"event": "progress", "done": "3"}',
     '{"event": "progress", "eta": -1}', '{"event": "progress", "done": true}', '{"event": "result", "written": 1.5}',
     '{"event": "progress", "done": 1' + "0" * 400 + "}", '{"event": "error", "message": null}',
     '{"event": "result", "presets": {"final": {"seconds_per_frame": 1}}}', '{"event": "frame", "request": 1}',
     '{"event": "other"}', '{"event": ["start"]}', '{"event": "start"', "[]", deep_json(), '{"event":' * 100_000],
)  # fmt: skip
def test_what_is_no_event_is_none(text: str) -> None:
    from chona_blender.events import parse_event

    assert parse_event(text) is None


def test_text_is_made_fit_to_be_shown() -> None:
    from chona_blender.events import parse_event

    event = parse_event(json.dumps({"event": "error", "message": "a\nb\0\x1b[31m\ud800é" + "x" * 9000, "new": [1]}))
    assert event == {"event": "error", "message": ("a b  [31m?é" + "x" * 9000)[:4096]}


def test_carriage_returns_overwrite_as_on_a_terminal() -> None:
    from chona_blender.events import read_lines

    assert list(read_lines(io.BytesIO(b"10 %\r20 %\r\n\xff\nlast"))) == ["20 %", "�", "last"]


def test_a_picture_is_refused_before_memory_is_asked_for() -> None:
    from chona_blender.errors import ChonaError
    from chona_blender.live_frames import read_answers

    def answer(**change: int) -> bytes:
        return line(READY) + line(FRAME | change) + PIXELS

    for content, words in (
        (answer(width=1 << 20, height=1 << 20, bytes=20 << 40), "bytes for 1048576 x 1048576"),
        (answer(bytes=len(PIXELS) - 1), "bytes for 6 x 4"),
        (answer(height=5000, bytes=6 * 5000 * 20), "ends after 0 of 5000 rows"),
        (line(READY) + b"\x00\x01 not an event\n", "not understood"),
    ):
        with pytest.raises(ChonaError, match=words):
            list(read_answers(io.BytesIO(content), print))


@st.composite
def spoiled_stream(draw: st.DrawFn) -> tuple[str, bytes]:
    """Whose it is, and what a child of Blender writes: one line or more of it spoiled."""
    kind = draw(st.sampled_from((*RESULTS, "live", "log", "picture")))
    files = {"live": answers(), "log": b"".join(map(line, LOG)), "picture": _png()}
    if kind in files:
        return kind, draw(spoiled_bytes(files[kind]))
    lines = [draw(spoiled_event) if draw(st.booleans()) else line(PROGRESS) for _ in range(2)]
    last = draw(spoiled_json(RESULTS[kind]) | st.just(json.dumps(RESULTS[kind]).encode()))
    return kind, b"\n".join([*lines, last, b""])


def _write_streams(folder: Path, examples: int) -> int:
    """Files ``KIND-NUMBER``; how many."""
    made = count()

    @seed(SEED)
    @settings(
        max_examples=examples, database=None, suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )  # fmt: skip
    @given(spoiled_stream())
    def write(stream: tuple[str, bytes]) -> None:
        (folder / f"{stream[0]}-{next(made)}").write_bytes(stream[1])

    write()
    return next(made)


def _png() -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.arange(24 * 16 * 3, dtype=np.uint8).reshape(16, 24, 3)).save(stream, "PNG")
    return stream.getvalue()


@pytest.mark.bpy
@pytest.mark.parametrize("python", bpy_pythons()[:1])
def test_no_message_makes_blender_raise_hang_or_grow(tmp_path: Path, often, python: str) -> None:
    """Real children write to the jobs of the add-on, and all that panels and reports show is looked at."""
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    streams = tmp_path / "streams"
    streams.mkdir()
    written = _write_streams(streams, often(100, 10_000))
    model = write_header_only_model(tmp_path / "model.safetensors")
    answer = run_bpy(python, "fuzz_messages.py", streams, model, tmp_path, seconds=3000.0)
    assert answer["raised"] == [] and answer["in threads"] == []
    assert answer["read"] == written
    assert answer["slowest"][0] < CPU_SECONDS and answer["slowest"][1] < SECONDS
    counts = answer["ends"]
    assert counts["DONE"] > 0 and counts["FAILED"] > 0 and counts["live pictures"] > 0, counts
    assert answer["grown"] < 1 << 30
    endless = answer["endless"]
    assert endless["grown"] < 100 << 20 and endless["longest look"] < 5.0 and endless["seconds to end"] < 10.0
    assert endless["longest kept"] <= 4096
    flood = answer["flood"]
    assert flood["longest look"] < 5.0 and flood["grown"] < 100 << 20 and flood["seen"] > 0
    assert answer["no result"] == ["FAILED", "the worker ended with code 0: it said nothing; expected a result"]
