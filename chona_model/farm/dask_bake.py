"""A bake on a Dask cluster: the scheduler deals chunks of frames to its workers, each runs ``chona bake`` on its own.

A chunk is a process of the worker's, so a crash or too little memory is an error message and not a lost worker, and
Dask's own signs of life go on.  Chunks share the folder (``claims``): when Dask gives one to a second worker because
it hears no more of the first, no frame is rendered twice.
"""

from __future__ import annotations

import json
import platform
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

from chona_model.progress import Progress

CONNECT_SECONDS = 20.0
LOOK_SECONDS = 1.0
"""Between two looks at whether the user wants an end."""
COUNTS = ("written", "skipped", "repeated")


class FarmError(RuntimeError):
    """The cluster does not answer, or could not bake everything."""


def bake_on_dask(address: str, words: Sequence[str], chunks: Sequence[str], progress: Progress) -> dict[str, int]:
    """Bakes chunks of frames; a chunk that fails does not keep the others from being baked.

    Args:
        address: of the scheduler, such as ``tcp://farm:8786``.
        words: arguments of ``chona bake`` but for the frames; paths are absolute and the same on every worker.
        chunks: values of ``--frames``.

    Returns:
        frames written, skipped and repeated.

    Raises:
        FarmError: there is no scheduler, or a chunk failed.
        ImportError: the package ``distributed`` is not installed.
    """
    from distributed import Client, Event, wait

    try:
        client = Client(address, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise FarmError(f"no Dask scheduler answers at {address} ({error}); start one with 'dask scheduler'") from error
    total, failures = dict.fromkeys(COUNTS, 0), []
    with client:
        job = f"chona-bake-{secrets.token_hex(4)}"
        stop = Event(job)
        pending = {
            client.submit(bake_chunk, [*words, f"--frames={chunk}"], job, key=f"{job}-{index:06d}", pure=False)
            for index, chunk in enumerate(chunks)
        }
        while pending and not progress.cancelled_by_user:
            try:
                ended, pending = wait(pending, timeout=LOOK_SECONDS, return_when="FIRST_COMPLETED")
            except TimeoutError:
                continue
            for future in ended:
                if future.status == "finished":
                    counted = future.result()
                    total = {name: total[name] + counted[name] for name in COUNTS}
                else:
                    failures.append(str(future.exception()))
            progress.update(total["written"] + total["skipped"])
        if pending:
            stop.set()  # chunks that are being baked end after their frame
            client.cancel(list(pending))
    if failures:
        raise FarmError(f"{len(failures)} of {len(chunks)} chunks could not be baked; the first: {failures[0]}")
    return total


def bake_chunk(words: Sequence[str], job: str) -> dict[str, int]:
    """Runs on a worker: bakes one chunk, until the job is stopped.

    Raises:
        FarmError: the bake failed.
    """
    from distributed import Event, get_client

    get_client()  # raises where this is no worker
    stop = Event(job)
    command = [sys.executable, "-m", "chona_model", *words, "--progress", "json"]
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as output,
        tempfile.TemporaryFile("w+", encoding="utf-8") as said,
    ):
        with subprocess.Popen(command, stdout=output, stderr=said, stdin=subprocess.DEVNULL) as process:
            try:
                while not _ended(process):
                    if stop.is_set():
                        break
            finally:
                process.terminate()  # it ends after its frame
        last = _last_line(output)
        if process.returncode != 0 and not stop.is_set():
            raise FarmError(f"{_last_line(said) or f'exit code {process.returncode}'} (on {platform.node()})")
    event: dict[str, Any] = json.loads(last) if last else {}
    return {name: int(event.get(name, 0)) for name in COUNTS}


def _ended(process: subprocess.Popen[bytes]) -> bool:
    try:
        process.wait(LOOK_SECONDS)
    except subprocess.TimeoutExpired:
        return False
    return True


def _last_line(file: Any) -> str:
    file.seek(0)
    lines = file.read().splitlines()
    return str(lines[-1]) if lines else ""
