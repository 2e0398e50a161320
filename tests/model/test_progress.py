"""Progress: events and their order, rate and numbers; signals as a flag."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import threading

import numpy as np
import pytest
import torch

from chona_model.progress import UPDATE_SECONDS, Cancel, Cancelled, Progress


class Clock:
    """Time that moves when told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Terminal(io.StringIO):
    """Text that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def reporter() -> tuple[Progress, io.StringIO, Clock]:
    output, clock = io.StringIO(), Clock()
    return Progress("json", output=output, errors=io.StringIO(), clock=clock), output, clock


def events(output: io.StringIO) -> list[dict]:
    return [json.loads(line) for line in output.getvalue().splitlines()]


def test_events_are_those_of_the_format() -> None:
    progress, output, clock = reporter()
    progress.start("bake", 50)
    clock.now += 2.1
    progress.update(3, "walk_0003.exr")
    progress.result(written=48, skipped=2, seconds=34.0)
    assert events(output) == [
        {"event": "start", "job": "bake", "total": 50},
        {"event": "progress", "job": "bake", "done": 3, "total": 50, "seconds": 2.1, "eta": 32.9,
         "message": "walk_0003.exr"},
        {"event": "result", "job": "bake", "written": 48, "skipped": 2, "seconds": 34.0},
    ]  # fmt: skip
    assert progress.ended == "result"


def test_updates_are_limited_and_the_last_is_written() -> None:
    progress, output, clock = reporter()
    progress.start("train", 1000)
    for done in range(1, 1001):
        clock.now += 0.01
        progress.update(done, loss=1.0 / done)
    progress.result()
    written = [event["done"] for event in events(output) if event["event"] == "progress"]
    assert len(written) <= 1000 * 0.01 / UPDATE_SECONDS + 2 and written[-1] == 1000


def test_what_is_finished_for_good_is_said_at_once() -> None:
    progress, output, _ = reporter()
    progress.start("bake", 10)
    for done in range(1, 4):
        progress.update(done, at_once=done == 2)
    assert [event["done"] for event in events(output)[1:]] == [1, 2]


@pytest.mark.parametrize("end", ["result", "cancelled"])
def test_a_held_update_is_written_before_the_end(end: str) -> None:
    progress, output, _ = reporter()
    progress.start("train", 1000)
    progress.update(1)
    progress.update(7, loss=0.5)
    getattr(progress, end)()
    assert [event["event"] for event in events(output)] == ["start", "progress", "progress", end]
    assert events(output)[2]["done"] == 7 and events(output)[2]["loss"] == 0.5


def test_a_resumed_job_counts_what_was_done_apart() -> None:
    progress, output, clock = reporter()
    progress.start("train", 100, done=60)
    clock.now += 10.0
    progress.update(70)
    assert events(output)[0]["done"] == 60 and events(output)[1]["eta"] == 30.0


def test_without_a_beginning_or_an_end_there_is_no_eta() -> None:
    progress, output, clock = reporter()
    progress.start("train", 10)
    progress.update(0)
    progress.start("train", None)
    clock.now += 1.0
    progress.update(5)
    assert [event["eta"] for event in events(output) if event["event"] == "progress"] == [None, None]


def test_numbers_are_always_json() -> None:
    progress, output, _ = reporter()
    progress.start("train", 10)
    progress.update(5, loss=float("nan"), psnr=np.float32(2.5), worst=torch.tensor(float("inf")), name="für 人")
    progress.result(mean={"psnr": np.float64(1.0), "box": None}, path=[np.int64(3)])
    assert "NaN" not in output.getvalue() and "Infinity" not in output.getvalue()
    update, result = events(output)[1:]
    assert update["loss"] is None and update["worst"] is None and update["psnr"] == 2.5 and update["name"] == "für 人"
    assert result["mean"] == {"psnr": 1.0, "box": None} and result["path"] == [3]


def test_an_error_is_one_event_and_one_line() -> None:
    output, errors = io.StringIO(), io.StringIO()
    progress = Progress("json", output=output, errors=errors)
    progress.job = "bake"
    progress.error("two\n  lines", 2)
    assert events(output) == [{"event": "error", "job": "bake", "code": 2, "message": "two lines"}]
    assert errors.getvalue() == "chona: two lines\n"


def test_without_a_terminal_nothing_is_drawn() -> None:
    output, errors = io.StringIO(), io.StringIO()
    progress = Progress(output=output, errors=errors)
    progress.start("bake", 2)
    progress.update(1, "a")
    progress.result()
    assert output.getvalue() == errors.getvalue() == ""


def test_a_terminal_shows_a_bar_and_its_numbers() -> None:
    output, errors = io.StringIO(), Terminal()
    progress = Progress(output=output, errors=errors)
    progress.start("bake", 2)
    progress.update(1, "walk_0001.exr", psnr=31.25)
    progress.update(2, "walk_0002.exr", psnr=31.5)
    progress.result()
    assert "bake" in errors.getvalue() and "31.5" in errors.getvalue() and output.getvalue() == ""


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="terminal or json"):
        Progress("html")


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals there")
def test_signals_set_the_flag_and_handlers_come_back() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    for number in (signal.SIGINT, signal.SIGTERM):
        progress = Progress()
        with progress.cancel:
            progress.check()
            assert not progress.cancelled_by_user
            os.kill(os.getpid(), number)
            assert progress.cancelled_by_user
            with pytest.raises(Cancelled):
                progress.check()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals there")
def test_a_second_interrupt_interrupts() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), Cancel() as cancel:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        assert cancel.requested
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == before


def test_another_thread_can_use_the_flag_without_handlers() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def work() -> None:
        with Cancel() as cancel:
            cancel.request()
            seen.append((cancel.requested, signal.getsignal(signal.SIGINT) == before))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(True, True)]
