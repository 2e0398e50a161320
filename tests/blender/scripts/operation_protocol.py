"""A small program that speaks the worker's protocol, runs in the worker's Python and behaves as its argument says."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from types import FrameType


def say(**event: object) -> None:
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def stop(_number: int, _frame: FrameType | None) -> None:
    say(event="cancelled", job="test")
    sys.exit(1)


behaviour = sys.argv[1]
if behaviour == "steps":
    signal.signal(signal.SIGTERM, stop)
    total = int(sys.argv[2])
    say(event="start", job="test", total=total)
    for done in range(1, total + 1):
        time.sleep(0.05)
        eta = 0.05 * (total - done)
        say(event="progress", job="test", done=done, total=total, seconds=0.05 * done, eta=eta, loss=0.25)
    say(event="result", job="test", written=total, skipped=0)
elif behaviour == "noise":
    sys.stdout.write("a library says hello\n{not json}\n[1, 2]\n\n")
    sys.stderr.write("a warning\n")
    say(event="start", job="test", total=1)
    sys.stdout.buffer.write(b"\xff\xfe broken bytes\n")
    say(event="result", job="test", written=1)
elif behaviour == "error":
    say(event="error", job="test", code=2, message="model.safetensors: expected version 1, found 9; train it again")
    sys.stderr.write("chona: model.safetensors: expected version 1, found 9; train it again\n")
    sys.exit(2)
elif behaviour == "crash":
    sys.stderr.write("x" * 200_000 + "\n")
    raise ValueError("the reason")
elif behaviour == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
elif behaviour == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    say(event="start", job="test", total=10)
    time.sleep(60)
