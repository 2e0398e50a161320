"""The doctor: what it finds here, and what it says of computers that lack something."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from chona_model import doctor
from chona_model.doctor import Check


def test_this_computer_can_do_the_work(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "chona_model", "doctor"]
    told = subprocess.run([*command, "--json"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr
    report = json.loads(told.stdout)
    assert report["ok"] is True
    checks = {check["name"]: check for check in report["checks"]}
    assert {"Python", "torch", "numba", "OpenEXR", "CPU", "CUDA", "memory", "kernel cache", "kernels"} <= checks.keys()
    assert all(check["state"] in {"ok", "note", "missing"} and check["found"] for check in checks.values())
    text = doctor.to_text(report)
    assert all(check["found"] in text for check in checks.values()) and "MISSING" not in text


def test_a_missing_package_is_named_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    check = doctor.package("no_such_module", "no-such-package")
    assert check.state == "missing" and "not installed" in check.found and "no-such-package" in check.remedy
    monkeypatch.setattr(doctor, "PACKAGES", {"no_such_module": "no-such-package", "json": "json"})
    for name in ("processor", "cuda", "memory", "kernel_cache", "kernels"):
        monkeypatch.setattr(doctor, name, lambda: Check("x", "ok", "fine"))
    report = doctor.examine()
    assert report["ok"] is False and "MISSING: not installed" in doctor.to_text(report)


def test_a_broken_package_is_told_from_a_missing_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_one.py").write_text("raise OSError('libx.so: cannot\\nopen')", "utf-8")
    (tmp_path / "broken_two.py").write_text("import no_such_module", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    one, two = doctor.package("broken_one", "broken-one"), doctor.package("broken_two", "broken-two")
    assert one.state == two.state == "missing"
    assert "libx.so: cannot open" in one.found and "no_such_module" in two.found
    assert "--force-reinstall broken-one" in one.remedy and "--force-reinstall broken-two" in two.remedy


def test_a_check_that_cannot_look_does_not_hide_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> Check:
        raise ImportError("no torch")

    monkeypatch.setattr(doctor, "PACKAGES", {})
    for name in ("processor", "cuda", "kernel_cache", "kernels"):
        monkeypatch.setattr(doctor, name, fails)
    report = doctor.examine()
    assert [check["name"] for check in report["checks"] if check["state"] != "missing"] == ["Python", "memory"]
    assert not report["ok"]


def test_kernels_with_wrong_numbers_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from chona_model.kernels import reference

    right = reference.encode
    monkeypatch.setattr(reference, "encode", lambda *arguments: right(*arguments) + 0.01)
    check = doctor.kernels()
    assert check.state == "missing" and "WRONG NUMBERS" in check.found and check.remedy


def test_a_full_memory_and_a_cache_without_rights_are_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_free_memory", lambda: 2**30)
    assert doctor.memory().state == "note" and doctor.memory().remedy
    from chona_model.kernels.cpu import encode

    class Stats:
        cache_path = str(tmp_path / "file" / "cache")

    class Kernel:
        stats = Stats()

    (tmp_path / "file").write_text("in the way", "utf-8")
    monkeypatch.setattr(encode, "encode", Kernel())
    assert doctor.kernel_cache().state == "note" and "NUMBA_CACHE_DIR" in doctor.kernel_cache().remedy
