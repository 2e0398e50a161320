"""Everything a developer or a first user runs, on any system: ``python scripts/dev.py env|test|demo|bench|lint|…``.

``make`` calls the same commands.  Two environments are made beside the sources, since torch and bpy must never meet in
one process: ``.venv`` (chona_model) and ``.venv-blender`` (Blender as a module).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENV, BLENDER_ENV = ROOT / ".venv", ROOT / ".venv-blender"
MOST_TESTERS = 4
"""Processes of tests at once: each may take two gigabytes."""
READY = ".ready"
"""Stamp inside an environment: newer than the files it was made from."""


def program(env: Path, name: str) -> Path:
    """Path of a program in an environment."""
    return env / ("Scripts" if os.name == "nt" else "bin") / (name + (".exe" if os.name == "nt" else ""))


def run(*command: str | Path, **extra: str) -> None:
    """Runs a command in the repository's root and ends with its exit code when it fails."""
    print("+", *command, flush=True)
    code = subprocess.run(
        [str(word) for word in command], cwd=ROOT, env={**os.environ, **extra}, check=False
    ).returncode
    if code:
        sys.exit(code)


def make_environment(env: Path, sources: list[str], install: list[str]) -> None:
    """Makes an environment unless it is newer than the files it depends on."""
    if sys.version_info[:2] != (3, 11):
        version = ".".join(str(number) for number in sys.version_info[:2])
        sys.exit(f"this is Python {version}, the pinned packages need 3.11: run it as python3.11 scripts/dev.py …")
    stamp = env / READY
    if stamp.exists() and all(stamp.stat().st_mtime >= (ROOT / name).stat().st_mtime for name in sources):
        return
    venv.create(env, with_pip=True, clear=not program(env, "python").exists())
    run(program(env, "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *install)
    stamp.touch()


def environment() -> None:
    """``.venv`` with ``chona`` and everything its tests need."""
    make_environment(
        ENV, ["pyproject.toml", "constraints.txt"], ["--constraint", "constraints.txt", "--editable", ".[test,docs]"]
    )


def blender_environment() -> None:
    """``.venv-blender`` with Blender as a Python module."""
    make_environment(BLENDER_ENV, ["constraints-blender.txt"], ["--constraint", "constraints-blender.txt", "bpy"])


def lint() -> None:
    """ruff and the type checker."""
    environment()
    python = program(ENV, "python")
    run(python, "-m", "ruff", "check", ".")
    run(python, "-m", "ruff", "format", "--check", ".")
    run(python, "-m", "mypy")


def test(words: list[str]) -> None:
    """All tests but slow ones, those of the add-on included."""
    environment()
    blender_environment()
    lint()
    bpy = os.environ.get("CHONA_BPY", str(program(BLENDER_ENV, "python")))
    # Files go side by side, each whole: what a module's fixtures make is made once.
    cores = os.cpu_count() or 1
    testers = min(cores, MOST_TESTERS)
    beside = ["-n", str(testers), "--dist", "loadfile"]
    # Each has its share of the cores: more of torch's threads than cores wait for each other in circles.
    threads = str(max(1, cores // testers))
    quick = ["-m", "not slow and not blender and not gpu"]
    run(program(ENV, "python"), "-m", "pytest", *quick, *beside, *words, CHONA_BPY=bpy, OMP_NUM_THREADS=threads)


def test_faults(words: list[str]) -> None:
    """Kills, full disks and bad input, as often as docs/reliability.md says; hours. CI runs each a few times."""
    environment()
    blender_environment()
    bpy = os.environ.get("CHONA_BPY", str(program(BLENDER_ENV, "python")))
    run(program(ENV, "python"), "-m", "pytest", "-m", "faults", *words, CHONA_BPY=bpy, CHONA_FAULTS="all")


def demo(words: list[str]) -> None:
    """The whole job, from a scene to a composite."""
    environment()
    blender_environment()
    command = ["-m", "chona_model", "demo", "--out", "demo/out", "--blender-python", program(BLENDER_ENV, "python")]
    run(program(ENV, "python"), *command, *words)


def bench(words: list[str]) -> None:
    """Speed, and what it costs: ``benchmarks/results``. Of the demo's capture, or of what ``words`` name."""
    environment()
    run(program(ENV, "python"), "-m", "benchmarks", *words)


def reference() -> None:
    """``docs/reference``: every panel, setting, operator and command, from the sources."""
    environment()
    blender_environment()
    folder = ROOT / "docs" / "reference"
    run(os.environ.get("CHONA_BPY", "").split(os.pathsep)[0] or program(BLENDER_ENV, "python"),
        "scripts/reference/addon_pages.py", folder)  # fmt: skip
    run(program(ENV, "python"), "scripts/reference/model_pages.py", folder)


def docs() -> None:
    """``site``: the manual as pages; a broken link is an error."""
    environment()
    run(program(ENV, "python"), "-m", "mkdocs", "build", "--strict", "--quiet")


def extension() -> None:
    """``dist/chona-VERSION.zip``, to be installed in Blender."""
    run(sys.executable, "scripts/build_extension.py", "--out", "dist")


ACTIONS = {
    "env": environment, "blender-env": blender_environment, "lint": lint, "docs": docs, "reference": reference,
    "extension": extension,
}  # fmt: skip
WITH_WORDS = {"test": test, "test-faults": test_faults, "demo": demo, "bench": bench}


def main() -> None:
    """Reads the command and runs it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=(*ACTIONS, *WITH_WORDS))
    arguments, words = parser.parse_known_args()
    if arguments.command in ACTIONS:
        ACTIONS[arguments.command]()
    else:
        WITH_WORDS[arguments.command](words)


if __name__ == "__main__":
    main()
