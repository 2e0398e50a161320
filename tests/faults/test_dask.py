"""``chona bake --dask``: a local cluster of real processes, and one of them killed in the middle."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from farm_scene import CHONA, ENVIRONMENT, ROOT, assert_same_frames, baked, numbers, watch, write_scene

from chona_model.farm.chunks import chunks_of

FRAMES, PATIENCE = 24, 3.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Model, shot, and the frames of a bake by one process."""
    folder = tmp_path_factory.mktemp("scene")
    model, shot = write_scene(folder, FRAMES, size=(320, 240))
    return model, shot, baked(model, shot, folder / "truth")


@pytest.fixture(scope="module")
def cluster() -> Iterator[object]:
    """Two workers of one thread each, whose processes find this source tree."""
    distributed = pytest.importorskip("distributed", reason="pip install distributed")
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *([before] if before else [])])
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    ) as local:
        yield local
    if before is None:
        del os.environ["PYTHONPATH"]
    else:
        os.environ["PYTHONPATH"] = before


def start(address: str, model: Path, shot: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    """A bake on a cluster."""
    command = [
        *CHONA,
        "bake",
        "--model",
        model,
        "--shot",
        shot,
        "--out",
        out,
        "--preset",
        "draft",
        "--progress",
        "json",
    ]
    command += ["--device", "cpu", "--dask", address, "--chunk", "12", "--share", str(PATIENCE), *options]
    environment = ENVIRONMENT | {"PYTHONPATH": os.environ.get("PYTHONPATH", str(ROOT))}
    return subprocess.Popen(
        list(map(str, command)), env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def end_of(process: subprocess.Popen[str]) -> tuple[dict, str]:
    """The last event of a bake, and what it said."""
    output, said = process.communicate(timeout=300)
    return json.loads(output.splitlines()[-1]), said


def test_a_worker_that_is_killed_costs_no_frame(
    cluster, scene: tuple[Path, Path, Path], tmp_path: Path, often: Callable[[int, int], int]
) -> None:
    """Its chunk goes to another; every frame is one process's, and equal to that of a bake by one."""
    model, shot, truth = scene
    for turn in range(often(1, 20)):
        out = tmp_path / str(turn)
        process = start(cluster.scheduler_address, model, shot, out)
        until = time.monotonic() + 200
        while len(numbers(out)) < 2:
            assert time.monotonic() < until and process.poll() is None, process.communicate()
            time.sleep(0.01)
        busy = [worker for worker in cluster.scheduler.workers.values() if worker.processing]
        worker = cluster.workers[busy[0].name]
        os.kill(worker.pid, signal.SIGKILL)
        watch(out, lambda process=process: process.poll() is not None)
        end, said = end_of(process)
        assert process.returncode == 0 and end["event"] == "result", said
        assert_same_frames(out, truth)


@pytest.mark.slow
def test_everything_there_costs_no_rendering(cluster, scene: tuple[Path, Path, Path], tmp_path: Path) -> None:
    model, shot, truth = scene
    end, said = end_of(start(cluster.scheduler_address, model, shot, truth, "--frames", "1-9"))
    assert (end["event"], end.get("written"), end.get("skipped")) == ("result", 0, 9), said


@pytest.mark.slow
def test_a_chunk_that_fails_is_told_and_keeps_no_other(cluster, scene: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """Frame 3 cannot be put into its place, as a folder is there; all other chunks are baked."""
    model, shot, _ = scene
    (tmp_path / "roll_0003.exr").mkdir()
    process = start(cluster.scheduler_address, model, shot, tmp_path, "--frames", "1-8", "--chunk", "4")
    end, said = end_of(process)
    assert process.returncode == 1 and end["event"] == "error"
    assert end["message"].startswith("1 of 2 chunks could not be baked; the first: chona: ") and "roll_0003.exr" in said
    assert {f"roll_000{number}.exr" for number in (5, 6, 7, 8)} <= numbers(tmp_path)


@pytest.mark.slow
def test_a_user_who_cancels_stops_the_cluster(cluster, scene: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """After the frames that are being rendered; what is there is whole."""
    model, _, _ = scene
    _, shot = write_scene(tmp_path / "long", 400, size=(320, 240))
    out = tmp_path / "out"
    process = start(cluster.scheduler_address, model, shot, out, "--chunk", "200")
    until = time.monotonic() + 200
    while not numbers(out):
        assert time.monotonic() < until and process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    end, _ = end_of(process)
    assert process.returncode == 1 and end["event"] == "cancelled"
    there = -1
    while there != (there := len(numbers(out))):
        assert time.monotonic() < until
        time.sleep(3.0)
    assert there < 400


def test_no_scheduler_is_told(scene: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="pip install distributed")
    from chona_model.farm import dask_bake
    from chona_model.progress import Progress

    monkeypatch.setattr(dask_bake, "CONNECT_SECONDS", 0.5)
    with pytest.raises(dask_bake.FarmError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9 .*; start one with"):
        dask_bake.bake_on_dask("tcp://127.0.0.1:9", ["bake"], ["1"], Progress())


def test_without_the_package_it_says_what_to_install(scene: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """Found missing by a Python that sees only what the core needs."""
    from importlib.util import find_spec

    if find_spec("distributed") is not None:
        pytest.skip("distributed is installed")
    model, shot, _ = scene
    process = start("tcp://127.0.0.1:9", model, shot, tmp_path)
    _, said = end_of(process)
    assert process.returncode == 2 and said == (
        "chona: --dask needs the package distributed, which is not installed; install it here and on the workers: pip "
        "install distributed\n"
    )


@pytest.mark.parametrize(
    ("frames", "size", "chunks"),
    [((1, 2, 3, 7), 3, ["1-3", "7"]), ((-2, -1, 0, 5), 9, ["-2-0,5"]), ((4,), 1, ["4"]), ((), 5, [])],
)
def test_chunks(frames: tuple[int, ...], size: int, chunks: list[str]) -> None:
    from chona_model.arguments import frame_list

    assert chunks_of(frames, size) == chunks
    assert tuple(number for chunk in chunks for number in frame_list(chunk)) == frames
