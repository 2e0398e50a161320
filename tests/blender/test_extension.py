"""The extension's zip: built twice alike, accepted by Blender's own validator, installed, used and switched off."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
from operation_helpers import ROOT, bpy_pythons, run_bpy

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
