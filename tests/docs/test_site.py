"""The manual builds without a warning, and its pages load nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOADED = re.compile(r"<(?:script|img|iframe|link(?![^>]*rel=.canonical))\b[^>]*(?:src|href)=.(?:https?:)?//")
LOADED_BY_STYLE = re.compile(r"url\(\s*['\"]?(?:https?:)?//|@import\s+['\"]?(?:https?:)?//")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built strictly: a broken link, a missing anchor or a page outside the navigation is an error."""
    pytest.importorskip("mkdocs")
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(target)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return target


def test_every_page_is_built(site: Path) -> None:
    sources = {path.relative_to(ROOT / "docs").with_suffix("") for path in (ROOT / "docs").rglob("*.md")}
    pages = {path.relative_to(site).with_suffix("") for path in site.rglob("*.html")}
    assert len(sources) > 10 and sources <= pages


def test_nothing_comes_from_elsewhere(site: Path) -> None:
    """No fonts, scripts, styles or pictures of other servers: the manual works offline and tells nobody."""
    for path in site.rglob("*.html"):
        assert not LOADED.search(path.read_text("utf-8")), path.name
    for path in site.rglob("*.css"):
        assert not LOADED_BY_STYLE.search(path.read_text("utf-8")), path.name


def test_pictures_are_light() -> None:
    """What is seen in a page is not larger than a page should be."""
    for path in (ROOT / "docs" / "pictures").iterdir():
        assert path.stat().st_size <= 400_000, path.name
