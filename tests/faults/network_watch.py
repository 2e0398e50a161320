"""Commands and Blenders under watch: what opens a connection or a shell is ended, and says so in a file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RECORD = "CHONA_WATCHED"
"""Variable that names the file. It has to be of this name: the add-on takes from its worker what begins with PYTHON."""

WATCH = """
import os, sys

def watch(event, arguments):
    network = event.partition(".")[2] in NETWORK if event.startswith("socket.") else event in REQUESTS
    shell = event == "os.system" or (event == "subprocess.Popen" and str(arguments[0]).endswith("sh"))
    if network or shell:
        with open(os.environ["CHONA_WATCHED"], "a") as log:
            log.write(f"{event} {arguments!r}\\n")
        os._exit(97)

NETWORK = ("connect", "bind", "getaddrinfo", "gethostbyname", "gethostbyaddr", "getnameinfo", "sendto", "sendmsg")
REQUESTS = ("urllib.Request", "ftplib.connect", "smtplib.connect", "http.client.connect")
sys.addaudithook(watch)
"""
"""``sitecustomize``."""


def write_watch(folder: Path) -> Path:
    """The folder that goes first on PYTHONPATH."""
    watch = folder / "watch"
    watch.mkdir(exist_ok=True)
    (watch / "sitecustomize.py").write_text(WATCH)
    return watch


def write_watched_python(folder: Path) -> Path:
    """A worker's Python under watch, for the add-on, which sets PYTHONPATH anew."""
    python = folder / "python-under-watch"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{write_watch(folder)}:$PYTHONPATH" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    return python


def watched(folder: Path) -> str:
    """What the watch has seen; nothing where all is well."""
    record = folder / "watched.txt"
    return record.read_text() if record.exists() else ""


def chona(*words: str | Path, cwd: Path, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """A command under watch, without a network where the system lets one be taken away."""
    command = [sys.executable, "-m", "chona_model", *map(str, words)]
    if subprocess.run(["unshare", "-rn", "true"], capture_output=True, check=False).returncode == 0:
        command = ["unshare", "-rn", *command]
    environment = os.environ | {
        "PYTHONPATH": f"{write_watch(cwd)}{os.pathsep}{ROOT}", RECORD: str(cwd / "watched.txt"),
    }  # fmt: skip
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=500, check=False, input=stdin
    )
    assert not watched(cwd), f"{words[0]}: {watched(cwd)}"
    return done
