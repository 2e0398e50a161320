"""Pages of the manual from argparse: every command, its options, what they take and what they do without."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from tables import cell, table


def command_page(parser: argparse.ArgumentParser, title: str, words: str, call: str) -> str:
    """A page for a parser with commands.

    Args:
        title: heading of the page.
        words: paragraph under it.
        call: how the program is called, before the command's name.
    """
    commands = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    helps = {choice.dest: choice.help or "" for choice in commands._choices_actions}
    names = list(commands.choices)
    parts = [f"# {title}", words, table(("Command", "What it does"), _contents(names, helps))]
    parts += [_section(name, commands.choices[name], call) for name in names]
    return "\n\n".join(parts) + "\n"


def _contents(names: Iterable[str], helps: dict[str, str]) -> list[tuple[str, str]]:
    return [(f"[`{name}`](#{name})", cell(helps[name])) for name in names]


def _section(name: str, parser: argparse.ArgumentParser, call: str) -> str:
    needed = [action for action in parser._actions if action.required]
    usage = " ".join([call, name, *(_written(action) for action in needed), "…"])
    parts = [f"## {name}", parser.description or "", f"    {usage}"]
    rows = [_row(action) for action in parser._actions if not isinstance(action, argparse._HelpAction)]
    if rows:
        parts.append(table(("Option", "What it does", "Without it"), rows))
    return "\n\n".join(part for part in parts if part)


def _row(action: argparse.Action) -> tuple[str, str, str]:
    names = ", ".join(f"`{name}`" for name in action.option_strings) or f"`{_value(action)}`"
    if action.option_strings and action.nargs != 0 and (action.choices is None or action.metavar):
        names += f" `{_value(action)}`"
    return names, cell(_words(action)), _default(action)


def _words(action: argparse.Action) -> str:
    words = (action.help or "") % {"default": action.default}
    choices = "" if action.choices is None else "one of " + ", ".join(f"`{choice}`" for choice in action.choices)
    return "; ".join(part for part in (words, choices) if part)


def _default(action: argparse.Action) -> str:
    if action.required:
        return "needed"
    nothing = action.default is None or action.default is False or action.default == argparse.SUPPRESS
    if nothing or "default:" in (action.help or ""):
        return ""
    values = action.default if isinstance(action.default, list | tuple) else [action.default]
    return ", ".join(f"`{value}`" for value in values)


def _written(action: argparse.Action) -> str:
    return f"{action.option_strings[-1]} {_value(action)}" if action.option_strings else _value(action)


def _value(action: argparse.Action) -> str:
    written = action.metavar or (" or ".join(map(str, action.choices)) if action.choices else action.dest.upper())
    return (written if isinstance(written, str) else " ".join(written)).replace("|", " or ")
