"""Tiny wheels that stand for the worker's packages: real to pip, with nothing in them but what the check asks."""

from __future__ import annotations

import base64
import hashlib
import re
import tomllib
import zipfile
from pathlib import Path

from operation_helpers import ROOT

MODULES = {"pillow": "PIL", "scikit-image": "skimage"}
TORCH = """
__version__ = "{version}+tiny"
class version: cuda = None
class cuda:
    @staticmethod
    def is_available(): return False
"""


def write_worker_wheels(folder: Path, without: str = "") -> Path:
    """One wheel for each package that chona_model names, in its pinned version, but for one."""
    folder.mkdir(parents=True, exist_ok=True)
    pins = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    for text in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]:
        name = text.partition(">=")[0]
        if name != without:
            source = TORCH.format(version=pins[name]) if name == "torch" else ""
            write_wheel(folder, name, pins[name], MODULES.get(name, name), source)
    return folder


def write_wheel(folder: Path, name: str, version: str, module: str, source: str) -> None:
    """A pure Python wheel of one module."""
    stem = f"{name.replace('-', '_')}-{version}"
    files = {
        f"{module}/__init__.py": source,
        f"{stem}.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{stem}.dist-info/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = f"{stem}.dist-info/RECORD"
    with zipfile.ZipFile(folder / f"{stem}-py3-none-any.whl", "w") as archive:
        lines = []
        for path, text in files.items():
            archive.writestr(path, text)
            digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).decode().rstrip("=")
            lines.append(f"{path},sha256={digest},{len(text.encode())}")
        archive.writestr(record, "\n".join([*lines, f"{record},,"]) + "\n")
