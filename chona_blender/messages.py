"""What the panel tells until it is dismissed: the last failure, and what happened while Blender was closed."""

from __future__ import annotations

import bpy

from .errors import ChonaError


def fail(operator: bpy.types.Operator, error: ChonaError, job: str = "") -> set[str]:
    """Report an error and keep its words for the panel, where they can be copied; ``job`` is the title of one."""
    text = sentence(error)
    remember_error(text, job)
    operator.report({"ERROR"}, text)
    return {"CANCELLED"}


def sentence(error: ChonaError) -> str:
    """The error's words with a capital first letter and on one line."""
    text = " ".join(str(error).split())
    return text[:1].upper() + text[1:]


class _Last:
    error = job = ""
    news: list[str] = []


def remember_error(text: str, job: str = "") -> None:
    """Keep the words of the last failure for the panel, until a job of the same title begins."""
    _Last.error, _Last.job = text, job


def forget_error(job: str) -> None:
    """What had stopped a job of this title is over: it begins anew."""
    if _Last.job == job:
        remember_error("")


def forget() -> None:
    """Nothing is told any more."""
    remember_error("")
    _Last.news.clear()


def last_error() -> str:
    """The words of the last failure, or nothing."""
    return _Last.error


def add_news(text: str) -> None:
    """Keep for the panel what happened while Blender was closed."""
    _Last.news.append(text)


def news() -> list[str]:
    """What happened while Blender was closed and was not dismissed yet."""
    return _Last.news
