"""``chona doctor``: whether this computer has what the work needs, in words and as JSON.

Every check answers by itself: a missing package never hides what the others would have said.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

OLDEST_PYTHON = (3, 11)
PACKAGES = {
    "numpy": "numpy",
    "torch": "torch",
    "numba": "numba",
    "scipy": "scipy",
    "PIL": "pillow",
    "skimage": "scikit-image",
    "OpenEXR": "OpenEXR",
    "safetensors": "safetensors",
    "msgspec": "msgspec",
    "tqdm": "tqdm",
}
"""Module to import -> package to install."""
LITTLE_MEMORY = 3 * 2**30
"""Bytes; training with less free memory than this is likely to be killed."""
TEST_SECONDS = 1.0
TEST_TOLERANCE = 1e-4
"""Largest difference of kernel and twin on features of size one; they differ by rounding alone, about 1e-6."""


@dataclass(frozen=True)
class Check:
    """One answer.

    Attributes:
        name: what was looked at.
        state: ``ok``, ``note`` (works, but slower or with less) or ``missing`` (something cannot work).
        found: in words.
        remedy: what to do, empty where nothing has to be done.
    """

    name: str
    state: str
    found: str
    remedy: str = ""


def examine() -> dict[str, Any]:
    """All checks: {"ok": bool, "version": …, "checks": [{"name", "state", "found", "remedy"}, …]}."""
    checks = [python_version(), *(package(module, name) for module, name in PACKAGES.items())]
    for name, look in (
        ("CPU", processor),
        ("CUDA", cuda),
        ("memory", memory),
        ("kernel cache", kernel_cache),
        ("kernels", kernels),
    ):
        checks.append(_guarded(name, look))
    return {
        "ok": all(check.state != "missing" for check in checks),
        "version": _version("chona-model") or "sources",
        "checks": [asdict(check) for check in checks],
    }


def surroundings() -> list[Check]:
    """What is around the packages, each within a second: the card, free memory, where kernels are kept."""
    looks = (("CUDA", cuda), ("memory", memory), ("kernel cache", kernel_cache))
    return [_guarded(name, look) for name, look in looks]


def to_text(report: dict[str, Any]) -> str:
    """The report as lines for people."""
    lines = [f"chona        {report['version']}"]
    for check in report["checks"]:
        mark = {"ok": "", "note": "note: ", "missing": "MISSING: "}[check["state"]]
        lines.append(
            f"{check['name']:<12} {mark}{check['found']}" + (f"; {check['remedy']}" if check["remedy"] else "")
        )
    lines.append("all that is needed is there" if report["ok"] else "something is missing: see the lines with MISSING")
    return "\n".join(lines) + "\n"


def _guarded(name: str, look: Callable[[], Check]) -> Check:
    """A check that cannot even look is an answer too."""
    try:
        return look()
    except Exception as error:
        return Check(name, "missing", f"{type(error).__name__}: {error}", "install the packages named above first")


def python_version() -> Check:
    """At least the oldest Python that the sources are written for."""
    found = f"{platform.python_version()} at {sys.executable}"
    if sys.version_info >= OLDEST_PYTHON:
        return Check("Python", "ok", found)
    return Check("Python", "missing", found, f"expected {'.'.join(map(str, OLDEST_PYTHON))} or newer: install one")


def package(module: str, name: str) -> Check:
    """Whether a package is there and loads: a broken one is told from a missing one."""
    install = f"{sys.executable} -m pip install"
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name == module:
            return Check(name, "missing", "not installed", f"install it with: {install} {name}")
        return Check(
            name, "missing", f"does not load ({error})", f"install it again: {install} --force-reinstall {name}"
        )
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        return Check(
            name, "missing", f"does not load ({type(error).__name__}: {reason})",
            f"install it again: {install} --force-reinstall {name}",
        )  # fmt: skip
    return Check(name, "ok", _version(name) or "of unknown version")


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def processor() -> Check:
    """Threads and the instructions that the small networks profit from."""
    import torch

    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    flags = _processor_flags()
    wide = "AVX-512" if "avx512f" in flags else torch.backends.cpu.get_cpu_capability()
    half = [name for name, flag in (("AVX-512", "avx512_bf16"), ("AMX", "amx_bf16")) if flag in flags]
    words = f"{usable} usable of {os.cpu_count()} threads, torch uses {torch.get_num_threads()}, {wide}, "
    if half:
        return Check("CPU", "ok", f"{words}bfloat16 in {' and '.join(half)}")
    return Check("CPU", "note", f"{words}no bfloat16 instructions", "presets below exact gain less from bfloat16 here")


def _processor_flags() -> frozenset[str]:
    """Linux names the processor's instructions; elsewhere nothing is known."""
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8", errors="replace")
    except OSError:
        return frozenset()
    match = re.search(r"^(?:flags|Features)\s*:(.*)$", text, re.MULTILINE)
    return frozenset(match[1].split()) if match else frozenset()


def cuda() -> Check:
    """A card is welcome, not needed. One that is there is tried: a driver can know it and yet not run this torch."""
    import torch

    if torch.version.cuda is None:
        return Check("CUDA", "note", "none: this torch is built for the CPU alone; --device cpu is used")
    try:
        torch.cuda.init()
        total = float((torch.ones(2, device="cuda") + 1.0).sum())
    except (RuntimeError, AssertionError) as error:
        reason = str(error).strip().partition("\n")[0]
        words = f"none: torch has CUDA {torch.version.cuda}, but no card answers ({reason}); --device cpu is used"
        return Check("CUDA", "note", words, "install NVIDIA's driver for this card, or update it")
    if total != 4.0:
        return Check("CUDA", "missing", f"the card adds 1 and 1 to {total / 2.0}", "update its driver")
    memory = torch.cuda.get_device_properties(0).total_memory / 2**30
    return Check("CUDA", "ok", f"{torch.cuda.get_device_name(0)}, {memory:.0f} GB, CUDA {torch.version.cuda}")


def memory() -> Check:
    """What is free now, within a container's limit."""
    free = _free_memory()
    if free is None:
        return Check("memory", "ok", "unknown on this system")
    words = f"{free / 2**30:.1f} GB free"
    if free >= LITTLE_MEMORY:
        return Check("memory", "ok", words)
    return Check("memory", "note", words, "close other programs before training, or use --image-scale 0.5")


def _free_memory() -> int | None:
    try:
        text = Path("/proc/meminfo").read_text("utf-8")
    except OSError:
        return None
    match = re.search(r"^MemAvailable:\s*(\d+) kB", text, re.MULTILINE)
    if match is None:
        return None
    free = int(match[1]) * 1024
    limit, used = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")
    try:
        return min(free, int(limit.read_text()) - int(used.read_text()))
    except (OSError, ValueError):  # no container, or "max"
        return free


def kernel_cache() -> Check:
    """Compiled kernels are kept on the disk; where they cannot be, every start compiles for a minute."""
    from chona_model.kernels.cpu.encode import encode

    folder = Path(str(encode.stats.cache_path))
    remedy = "set NUMBA_CACHE_DIR to a folder that can be written to; until then every start compiles anew"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".chona-"):
            pass
    except OSError as error:
        return Check("kernel cache", "note", f"{folder} cannot be written to ({error.strerror})", remedy)
    return Check("kernel cache", "ok", str(folder))


def kernels() -> Check:
    """The grid encoding's fast kernel against its torch twin, and its speed."""
    import numpy as np
    import torch

    from chona_model.kernels import reference
    from chona_model.kernels.grid import FEATURES, encode, make_layout

    extent, levels, rows, count = np.array([1.0, 1.0, 1.0]), 6, 2**12, 20_000
    layout = make_layout(extent, coarsest=0.2, finest=0.02, levels=levels, rows=rows)
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(count, 3, generator=generator)
    identity = torch.zeros(count, dtype=torch.int32)
    table = torch.randn(1, levels, rows, FEATURES, generator=generator)
    with torch.no_grad():
        started = time.perf_counter()
        fast = encode(points, identity, table, layout)
        compiling = time.perf_counter() - started
        difference = float((fast - reference.encode(points, identity, table, layout)).abs().max())
        rounds, started = 0, time.perf_counter()
        while rounds == 0 or time.perf_counter() - started < TEST_SECONDS / 2:
            encode(points, identity, table, layout)
            rounds += 1
        speed = rounds * count / (time.perf_counter() - started)
    words = (
        f"differ from their twin by {difference:.1e}, {speed / 1e6:.1f} million points/s, ready in {compiling:.1f} s"
    )
    if difference <= TEST_TOLERANCE:
        return Check("kernels", "ok", words)
    remedy = "delete the kernel cache above and try again; report it when it stays"
    return Check("kernels", "missing", f"WRONG NUMBERS: {words}, expected at most {TEST_TOLERANCE:.0e}", remedy)
