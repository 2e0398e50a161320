"""Builds the Blender extension: `python scripts/build_extension.py` writes `dist/chona-<version>.zip`.

The zip holds the manifest and chona_blender's modules at its top, and chona_model's sources under `worker/`, a folder
that only the worker's PYTHONPATH names. The same sources always give the same bytes. Standard library alone.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
EARLIEST = (1980, 1, 1, 0, 0, 0)
REQUIRED = (
    "schema_version",
    "id",
    "version",
    "name",
    "tagline",
    "maintainer",
    "type",
    "blender_version_min",
    "license",
)
SKIPPED = {"__pycache__"}
ALLOWED_IN_BLENDER = {
    "bpy",
    "bpy_extras",
    "mathutils",
    "gpu",
    "gpu_extras",
    "blf",
    "addon_utils",
    "bl_operators",
    "numpy",
}


class BuildError(Exception):
    """Something that would make a broken extension."""


def read_manifest(path: Path) -> dict:
    """The manifest, after the checks that Blender makes at installation and a few more."""
    manifest = tomllib.loads(path.read_text(encoding="utf-8"))
    missing = [key for key in REQUIRED if not manifest.get(key)]
    if missing:
        raise BuildError(f"{path}: {', '.join(missing)} is missing")
    if not re.fullmatch(r"\d+\.\d+\.\d+(-[\w.]+)?", manifest["version"]):
        raise BuildError(f"{path}: version {manifest['version']!r} is not like 1.2.3")
    if len(manifest["tagline"]) > 64 or manifest["tagline"].endswith("."):
        raise BuildError(f"{path}: the tagline has more than 64 characters or ends in a full stop")
    for name, reason in manifest.get("permissions", {}).items():
        if len(reason) > 64 or reason.endswith("."):
            raise BuildError(
                f"{path}: the reason for permission {name} has more than 64 characters or ends in a full stop"
            )
    return manifest


def check_versions(manifest: dict, pyproject: Path) -> None:
    """Add-on and worker travel together and have one version."""
    version = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]["version"]
    if version != manifest["version"]:
        raise BuildError(f"{pyproject} has version {version}, the manifest {manifest['version']}; make them the same")


def check_pins(pyproject: Path, constraints: Path) -> None:
    """Everything that chona_model imports has one version, which Set Up Worker installs."""
    pinned = set(re.findall(r"^([\w.-]+)==\S+$", constraints.read_text(encoding="utf-8"), re.MULTILINE))
    for text in tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]["dependencies"]:
        if text.partition(">=")[0] not in pinned:
            raise BuildError(f"{constraints} has no version of {text.partition('>=')[0]}, which {pyproject} names")


def check_imports(path: Path) -> None:
    """In Blender's process: relative imports, Blender's own modules, numpy and the standard library, nothing else."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
        else:
            continue
        for name in names:
            top = name.partition(".")[0]
            if top not in ALLOWED_IN_BLENDER and top not in sys.stdlib_module_names:
                raise BuildError(f"{path}:{node.lineno}: Blender's process must not import {name}")


def collect(root: Path) -> dict[str, Path]:
    """Name in the zip -> file."""
    files = {"blender_manifest.toml": root / "blender_manifest.toml"}
    for path in sources(root / "chona_blender"):
        if path.suffix == ".py":
            check_imports(path)
        files[path.relative_to(root / "chona_blender").as_posix()] = path
    for path in sources(root / "chona_model"):
        files["worker/" + path.relative_to(root).as_posix()] = path
    files["LICENSE"] = root / "LICENSE"
    for name in ("pyproject.toml", "constraints.txt"):  # what Set Up Worker installs, and in which versions
        files[f"worker/{name}"] = root / name
    check_pins(root / "pyproject.toml", root / "constraints.txt")
    for needed in ("__init__.py", "worker/chona_model/__init__.py"):
        if needed not in files:
            raise BuildError(f"{needed} is missing among the sources in {root}")
    return files


def sources(folder: Path) -> list[Path]:
    """A package's files without what Python and editors leave there."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.is_file() and not SKIPPED & set(path.parts) and not path.name.startswith(".") and path.suffix != ".pyc"
    )


def write_zip(files: dict[str, Path], target: Path) -> None:
    """Sorted names, fixed times and modes: equal sources give equal bytes."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_suffix(".partial")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(files):
            info = zipfile.ZipInfo(name, EARLIEST)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            info.create_system = 3
            archive.writestr(info, files[name].read_bytes())
    partial.replace(target)


def build(root: Path, folder: Path) -> Path:
    """Check and write; the zip's path."""
    manifest = read_manifest(root / "blender_manifest.toml")
    check_versions(manifest, root / "pyproject.toml")
    target = folder / f"{manifest['id']}-{manifest['version']}.zip"
    write_zip(collect(root), target)
    return target


def main(argv: list[str] | None = None) -> int:
    """Command line: 0 built, 1 something is wrong with the sources."""
    parser = argparse.ArgumentParser(description="Build the Blender extension as a zip.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    arguments = parser.parse_args(argv)
    try:
        target = build(ROOT, arguments.out)
    except (BuildError, OSError, SyntaxError, tomllib.TOMLDecodeError) as error:
        sys.stderr.write(f"build_extension: {error}\n")
        return 1
    sys.stdout.write(f"{target}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
