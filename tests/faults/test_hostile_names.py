"""Names and paths that shells, formats and terminals would act on, through the real commands; and no network at all."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "model"))

from network_watch import ROOT, WATCH, chona

pytestmark = pytest.mark.faults

PERSON = "Rob $(touch owned) `touch owned`; touch owned & %s%n%(x)s {0} ü漢😀 \"'\n--out"
THING = "crate|touch owned\t%d"
FOLDER = "a b; touch owned & $(touch owned) %s%(x)d {0} ü漢😀 'q' [*?]\nc"
SEQUENCE = "lift $(touch owned); %s ü漢 'q'"

NETWORK = {
    "socket",
    "socketserver",
    "ssl",
    "http",
    "urllib",
    "ftplib",
    "smtplib",
    "xmlrpc",
    "asyncio",
    "requests",
    "httpx",
}


def test_the_watch_sees_a_connection_and_a_shell(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(WATCH)
    log = tmp_path / "watched.txt"
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "CHONA_WATCHED": str(log)}
    for line, event in (
        ("import socket; socket.create_connection(('127.0.0.1', 9))", "socket."),
        ("import os; os.system('true')", "os.system"),
        ("import subprocess; subprocess.run('true', shell=True)", "subprocess.Popen"),
    ):
        log.unlink(missing_ok=True)
        assert subprocess.run([sys.executable, "-c", line], env=environment, check=False).returncode == 97
        assert log.read_text().startswith(event)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture of hostile names in it."""
    from cli_files import SEQUENCE as PLAIN
    from cli_files import write_capture

    folder = tmp_path_factory.mktemp("names") / FOLDER
    capture = write_capture(folder / "capture")
    content = json.loads((capture / "capture.json").read_text())
    content["persons"] = {PERSON: content["persons"]["Sub01"]}
    content["objects"] = {THING: content["objects"]["box01"]}
    content["sequences"][0] |= {"name": SEQUENCE, "person": PERSON, "objects": [THING]}
    (capture / "capture.json").write_text(json.dumps(content))
    (capture / "sequences" / PLAIN).rename(capture / "sequences" / SEQUENCE)
    return folder


def _nothing_ran(place: Path) -> None:
    assert not [path for path in place.parent.rglob("*") if path.name == "owned" or path.name.startswith("touch")]


def test_names_are_data_from_the_capture_to_the_frame(place: Path) -> None:
    """Trained, described, measured, baked and served under names that shells and formats would act on."""
    from cli_files import write_view_shot

    from chona_model.data.opener import open_dataset
    from chona_model.formats.exr import read_frame

    checked = chona("check-data", place / "capture", "--out", place / "sheets", "--progress", "json", cwd=place)
    assert json.loads(checked.stdout.splitlines()[-1])["event"] == "result", checked.stderr
    assert [path.name for path in (place / "sheets").iterdir()] == [f"{SEQUENCE}.png"]

    trained = chona("train", "--data", place / "capture", "--out", place / "run", "--steps", "3", cwd=place)
    assert trained.returncode == 0, trained.stderr
    model = place / "run" / "model.safetensors"

    described = chona("info", model, cwd=place)
    assert described.returncode == 0 and "%s%n%(x)s {0} ü漢😀" in described.stdout
    facts = json.loads(chona("info", model, "--json", cwd=place).stdout)
    assert list(facts["persons"]) == [PERSON] and list(facts["objects"]) == [THING] and facts["file"] == str(model)

    write_view_shot(place / "still.shot.npz", open_dataset(place / "capture").views[0])
    baked = chona(
        "bake", "--model", model, "--shot", place / "still.shot.npz", "--out", place / "out", "--preset", "draft",
        "--passes", "depth,mattes,cryptomatte", cwd=place,
    )  # fmt: skip
    assert baked.returncode == 0, baked.stderr
    layers, _ = read_frame(place / "out" / "still_0001.exr")
    assert layers.cryptomatte is not None
    assert layers.cryptomatte.names == (f"actor.{PERSON}", f"actor.{THING}")

    served = chona("serve", "--model", model, cwd=place)
    assert served.returncode == 0 and json.loads(served.stdout.splitlines()[0])["event"] == "ready"
    _nothing_ran(place)


@pytest.mark.parametrize("name", [PERSON, "../../up", "%s" * 50, "x" * 3000, "-h", "--debug\n"])
def test_a_message_about_a_name_is_one_line(tmp_path: Path, name: str) -> None:
    """What is refused is repeated as it is, on one line of stderr, and nothing in it is acted on."""
    for words in (("info", f"./{name}.safetensors"), ("bake", "--model=m", f"--preset={name}", "--shot=s", "--out=o")):
        done = chona(*words, cwd=tmp_path)
        assert done.returncode == 2 and not done.stdout
        assert done.stderr.startswith("chona: ") and len(done.stderr.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} <= {"watch"}


def test_nothing_of_the_worker_imports_a_network_library() -> None:
    """Torch's distributed training is its own matter: it connects to what the user names."""
    found = []
    for path in sorted((ROOT / "chona_model").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            found += [f"{path.name}:{node.lineno} {name}" for name in names if name.partition(".")[0] in NETWORK]
    assert not found
