"""Many processes, one folder: everything is made, and nothing twice, whoever dies and however late changes are seen."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from chona_model.claims import BEATS, FOLDER, Claim, Claims, claim_path, each_once

SCRIPT = Path(__file__).with_name("claiming_process.py")
ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 1.5
"""Seconds; a busy computer may let a process wait for half a second."""
LATE = PATIENCE / 2


@contextmanager
def processes(out: Path, number: int, late: float, seconds: float, count: int) -> Iterator[list[subprocess.Popen]]:
    """``number`` of them on one folder, ended when the block is."""
    out.mkdir(exist_ok=True)
    command = [sys.executable, SCRIPT, out, str(late), str(seconds), str(PATIENCE), str(count)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    started = [subprocess.Popen(list(map(str, command)), env=environment) for _ in range(number)]
    try:
        yield started
    finally:
        for one in started:
            one.kill()
            one.wait()


def lines(out: Path) -> list[tuple[str, int, int]]:
    """Of the log: word, item, process."""
    path = out / "log"
    words = [line.split() for line in path.read_text().splitlines()] if path.exists() else []
    return [(word, int(item), int(pid)) for word, item, pid in words]


def counted(out: Path, word: str) -> Counter[int]:
    return Counter(item for said, item, _ in lines(out) if said == word)


def wait_for(happened: Callable[[], bool], seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.01)


@pytest.mark.parametrize("late", [0.0, LATE], ids=["at once", "late"])
def test_nothing_is_made_twice(tmp_path: Path, late: float, often: Callable[[int, int], int]) -> None:
    """Every process begins with the same item, so every one of them is contended."""
    for turn in range(often(1, 30)):
        out, count = tmp_path / str(turn), 40
        with processes(out, 4, late, 0.01, count) as started:
            assert [one.wait(60) for one in started] == [0] * 4
        assert counted(out, "begun") == counted(out, "made") == dict.fromkeys(range(count), 1)
        assert len({pid for _, _, pid in lines(out)}) > 1, "one process did everything"


@pytest.mark.parametrize("late", [0.0, LATE], ids=["at once", "late"])
def test_what_the_killed_held_is_taken_over(tmp_path: Path, late: float, often: Callable[[int, int], int]) -> None:
    """Of four processes three are killed, anywhere; the last makes the rest, and again nothing twice."""
    for turn in range(often(1, 40)):
        chance, out, count = random.Random(turn), tmp_path / str(turn), 40
        with processes(out, 4, late, 0.05, count) as started:
            for one in started[:3]:
                wait_for(lambda out=out, one=one: any(pid == one.pid for _, _, pid in lines(out)))
                time.sleep(chance.uniform(0.0, 0.3))
                one.send_signal(signal.SIGKILL)
            assert started[3].wait(60) == 0
        assert all((out / f"item_{item:04d}").read_bytes() == b"whole" for item in range(count))
        begun, made = counted(out, "begun"), counted(out, "made")
        assert set(begun) == set(range(count)) and sum(begun.values()) <= count + 3, begun
        # Who is killed between putting an item into its place and saying so has made it all the same.
        unsaid = set(range(count)) - set(made)
        killed = {one.pid for one in started[:3]}
        assert set(made.values()) == {1} and len(unsaid) <= 3
        makers = {item: pid for _, item, pid in lines(out)}
        assert all(makers[each] in killed and begun[each] == 1 for each in unsaid)


def test_who_stood_still_drops_what_was_taken_over(tmp_path: Path, often: Callable[[int, int], int]) -> None:
    """A process is stopped while it makes an item, and goes on after another has made it."""
    for turn in range(often(1, 20)):
        out = tmp_path / str(turn)
        with processes(out, 2, 0.0, 0.3, 3) as started:
            wait_for(lambda out=out: bool(lines(out)))
            word, item, pid = lines(out)[0]
            os.kill(pid, signal.SIGSTOP)
            other = next(one for one in started if one.pid != pid)
            assert word == "begun" and other.wait(60) == 0
            os.kill(pid, signal.SIGCONT)
            assert [one.wait(60) for one in started] == [0, 0]
        assert counted(out, "made") == dict.fromkeys(range(3), 1)
        assert ("dropped", item, pid) in lines(out)


class Hours:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_only_silence_makes_a_claim_abandoned(tmp_path: Path) -> None:
    """By the observer's own clock, from when it saw the last sign of life."""
    clock = Hours()
    one, other = Claims(tmp_path, 60.0, clock), Claims(tmp_path, 60.0, clock)
    held = one.take("walk_0001", "key")
    assert held is not None and other.take("walk_0001", "key") is None
    for _ in range(3):
        clock.now += 59.0
        held.beat()
        assert other.take("walk_0001", "key") is None
    clock.now += 59.0
    assert other.take("walk_0001", "key") is None and held.is_ours()
    clock.now += 2.0
    taken = other.take("walk_0001", "key")
    assert taken is not None and taken.is_ours() and not held.is_ours()
    # Its late sign of life changes nothing.
    held.beat()
    assert taken.is_ours() and one.take("walk_0001", "key") is None


def test_what_was_let_go_is_free_at_once(tmp_path: Path) -> None:
    one, other = Claims(tmp_path, 60.0), Claims(tmp_path, 60.0)
    held = one.take("walk_0001", "key")
    assert held is not None
    with pytest.raises(RuntimeError), held:
        raise RuntimeError("the card is out of memory")
    assert other.take("walk_0001", "key") is not None


def test_a_finished_claim_counts_until_its_item_must_have_been_seen(tmp_path: Path) -> None:
    """For the same key; what is out of date may be made again at once."""
    clock = Hours()
    one, other = Claims(tmp_path, 60.0, clock), Claims(tmp_path, 60.0, clock)
    held = one.take("walk_0001", "key")
    assert held is not None
    with held:
        held.done()
    assert other.take("walk_0001", "key") is None
    assert other.take("walk_0001", "another pose") is not None
    assert one.take("walk_0002", "key") is not None
    clock.now += 2 * 60.0 - 1.0
    assert one.take("walk_0003", "key") is not None and claim_path(tmp_path / FOLDER, "walk_0001", 0).exists()


def test_claims_of_what_everybody_has_seen_are_removed(tmp_path: Path) -> None:
    """Those of earlier owners before one's own, else an earlier owner would find itself the only one."""
    clock = Hours()
    dead, one = Claims(tmp_path, 60.0, clock), Claims(tmp_path, 60.0, clock)
    first = dead.take("walk_0001", "key")
    assert first is not None and one.take("walk_0001", "key") is None
    clock.now += 61.0
    second = one.take("walk_0001", "key")
    assert second is not None
    with second:
        second.done()
    clock.now += 121.0
    assert one.take("walk_0002", "key") is not None
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["walk_0002.0.json"] and not first.is_ours()


def test_a_claim_says_whose_it_is(tmp_path: Path) -> None:
    Claims(tmp_path, 60.0).take("walk_0001", "key")
    record = json.loads(claim_path(tmp_path / FOLDER, "walk_0001", 0).read_bytes())
    assert record["pid"] == os.getpid() and record["host"] and record["state"] == "held"


def test_a_claim_that_was_cut_off_while_it_was_made_is_taken_over(tmp_path: Path) -> None:
    clock = Hours()
    claims = Claims(tmp_path, 60.0, clock)
    claim_path(tmp_path / FOLDER, "walk_0001", 0).touch()
    assert claims.take("walk_0001", "key") is None
    clock.now += 61.0
    assert claims.take("walk_0001", "key") is not None


def test_signs_of_life_go_on_while_an_item_is_made(tmp_path: Path) -> None:
    """From a thread of the process, well before its claim would be abandoned."""
    with Claims(tmp_path, PATIENCE) as claims:
        held = claims.take("walk_0001", "key")
        assert isinstance(held, Claim)
        path = claim_path(tmp_path / FOLDER, "walk_0001", 0)
        before = json.loads(path.read_bytes())["beats"]
        time.sleep(PATIENCE)
        assert BEATS // 2 <= json.loads(path.read_bytes())["beats"] - before <= BEATS


def test_a_user_who_cancels_does_not_wait_for_others(tmp_path: Path) -> None:
    other = Claims(tmp_path, 60.0)
    assert other.take("0", "key") is not None
    stopped, told = iter([False, False, False, True, True, True, True]), []
    with Claims(tmp_path, 60.0) as claims:
        left = each_once(
            [0], lambda _: False, lambda *_: None, lambda: next(stopped), claims, lambda _: ("0", "key"), told.append
        )
        assert list(left) == [] and told == [1]
