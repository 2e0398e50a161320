"""The extension's zip: built twice alike, accepted by Blender's own validator, installed, used and switched off."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
from operation_helpers import ROOT, bpy_pythons, run_bpy, write_header_only_model

BUILD = ROOT / "scripts" / "build_extension.py"
FIND_VALIDATOR = (
    "import importlib.util, pathlib, sys; "
    "print(next(pathlib.Path(importlib.util.find_spec('bpy').origin).parent.rglob('bl_pkg/cli/blender_ext.py')))"
)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The zip, built by the script's command line."""
    folder = tmp_path_factory.mktemp("extension")
    done = subprocess.run(
        [sys.executable, BUILD, "--out", folder], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return Path(done.stdout.strip())


@pytest.fixture(scope="module")
def build_module() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_extension", BUILD)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_zip_has_both_packages_and_nothing_else(package: Path) -> None:
    names = zipfile.ZipFile(package).namelist()
    assert {"blender_manifest.toml", "__init__.py", "LICENSE", "worker/chona_model/__init__.py"} <= set(names)
    assert {"worker/constraints.txt", "worker/pyproject.toml"} <= set(names), "Set Up Worker reads them"
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", ".so", ".pyd", ".dll"))]
    assert "chona_model/__init__.py" not in names


def test_zip_is_the_same_every_time(package: Path, tmp_path: Path, build_module: ModuleType) -> None:
    assert build_module.build(ROOT, tmp_path).read_bytes() == package.read_bytes()


def test_foreign_imports_are_refused(tmp_path: Path, build_module: ModuleType) -> None:
    module = tmp_path / "wrong.py"
    module.write_text("import json\nfrom torch import nn\n")
    with pytest.raises(build_module.BuildError, match="must not import torch"):
        build_module.check_imports(module)


@pytest.mark.bpy
@pytest.mark.parametrize("python", bpy_pythons())
def test_blender_accepts_and_installs_it(python: str, package: Path, tmp_path: Path) -> None:
    if not python:
        pytest.skip("$CHONA_BPY names no Python with bpy")
    script = subprocess.run([python, "-c", FIND_VALIDATOR], capture_output=True, text=True, check=True).stdout.strip()
    done = subprocess.run(
        [python, script, "validate", package], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path / "resources")}
    for mode in ("install", "again"):
        answer = run_bpy(python, "operation_extension.py", package, mode, environment=environment)
        assert answer["enabled"] and answer["disabled"] and answer["enabled again"], answer
        assert answer["folder"].startswith(str(tmp_path)), answer
        assert answer["sources"] == str(Path(answer["folder"]) / "worker")
        assert answer["code"] == 2 and "torch" in answer["words"]
        assert answer["warnings"] == "{}", answer


@pytest.mark.bpy
@pytest.mark.parametrize("python", bpy_pythons())
def test_nothing_is_left_behind(python: str, package: Path, tmp_path: Path) -> None:
    """On and off twenty times, an update while it is on, an uninstall: what Blender holds is the same each time."""
    older = tmp_path / "chona-0.0.9.zip"
    with zipfile.ZipFile(package) as source, zipfile.ZipFile(older, "w") as target:
        for name in source.namelist():
            text = source.read(name)
            if name == "blender_manifest.toml":
                text, count = re.subn(rb'(?m)^version = ".*"$', b'version = "0.0.9"', text)
                assert count == 1
            target.writestr(name, text)
    model = write_header_only_model(tmp_path / "Robin.safetensors")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path / "resources"), "TMPDIR": str(temporary)}
    answer = run_bpy(python, "operation_rounds.py", older, package, model, temporary, environment=environment)
    assert answer["older"] == "0.0.9" and answer["used"][0] == "FINISHED" and "has no torch" in answer["used"][1]
    assert answer["first"] == {}, answer["first"]
    assert answer["rounds on"] == {} and answer["rounds off"] == {}, answer
    updated = answer["updated"]
    assert updated["version"] != "0.0.9" and updated["enabled"] and updated["used"] == ["FINISHED"]
    assert updated["device"] == "cpu" and updated["kept"], "preferences and the worker's environment outlive an update"
    assert updated["differences"] == {} and updated["warnings"] == "{}"
    assert answer["uninstalled"] == {"differences": {}, "folder": False, "sources": False}


@pytest.mark.bpy
@pytest.mark.parametrize("python", bpy_pythons())
def test_one_that_cannot_load_says_why(python: str, package: Path, tmp_path: Path) -> None:
    """A module that breaks at any stage: a panel with a report to copy, nothing else, and all is well once mended."""
    environment = {"BLENDER_USER_RESOURCES": str(tmp_path)}
    answer = run_bpy(python, "operation_broken.py", package, environment=environment)
    for case, reason in (
        ("syntax", "SyntaxError"),
        ("import", "No module named 'no_such_module'"),
        ("register", "ValueError: the reason"),
    ):
        broken, mended = answer[case]["broken"], answer[case]["mended"]
        assert broken["classes"] == ["CHONA_OT_copy_failure", "CHONA_PT_failure"] and not broken["scene"], case
        assert reason in broken["report"] and "Blender" in broken["report"] and answer[case]["copied"], case
        assert answer[case]["off"] == {"classes": [], "scene": False, "report": "", "stand-in": False}, case
        assert mended["scene"] and not mended["stand-in"] and "CHONA_PT_main" in mended["classes"], case
        assert answer[case]["mended off"]["classes"] == [], case
