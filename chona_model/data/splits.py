"""``--split FILE:KEY``: the sequences, or frames of sequences, that a JSON file lists under a dotted key."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from chona_model.data.dataset import DatasetError
from chona_model.plain_json import JsonError, parse, read_text, shortened

_FRAME = re.compile(r"t\d+(\.\d+)?")
_MAX_REFERENCES = 8


def read_split(text: str) -> tuple[str, ...]:
    """Names of sequences, or ``SEQUENCE/FRAME`` for single frames, of a split written ``FILE:KEY``.

    KEY walks the file's objects, e.g. ``novel_pose.chairwood.train``.  What it leads to may be a list of sequences, a
    list of frames (``boxes.SEQUENCE.train``: the sequence is the key before), one frame (``{"sequence", "frame"}``),
    one sequence, the dotted key of another split in the same file, or a set list of CO3D
    (``set_lists_manyview_dev_0.json:train``).

    Raises:
        DatasetError: no such file or key (the message lists the keys there are), or no names under it.
    """
    file, colon, key = text.rpartition(":")
    if not colon or not file or not key:
        raise DatasetError(f"the split is '{text}', expected FILE:KEY, for example splits.json:compositional.train")
    path = Path(file)
    try:
        content = parse(read_text(path))
    except (OSError, JsonError) as error:
        raise DatasetError(f"cannot read the split file {path}: {error}; expected JSON") from error
    for _ in range(_MAX_REFERENCES):
        value, names = _walk(content, key, path)
        if isinstance(value, str) and "." in value and value.split(".", maxsplit=1)[0] in content:
            key = value
            continue
        return _selection(value, names, f"{path}:{key}")
    raise DatasetError(f"the split {text} refers to other splits more than {_MAX_REFERENCES} times; correct the file")


def _walk(content: Any, key: str, path: Path) -> tuple[Any, list[str]]:
    """The value under a dotted key and the names on the way; names may hold dots themselves."""
    names: list[str] = []
    value, rest = content, key
    while rest:
        parts = rest.split(".")
        heads = [".".join(parts[:count]) for count in range(len(parts), 0, -1)]
        head = next((head for head in heads if isinstance(value, dict) and head in value), None)
        if head is None:
            where = f"{path}:{'.'.join(names)}" if names else str(path)
            raise DatasetError(f"there is no '{parts[0]}' in the split {where}; {_keys(value)}")
        value, rest = value[head], rest[len(head) + 1 :]
        names.append(head)
    return value, names


def _selection(value: Any, names: list[str], where: str) -> tuple[str, ...]:
    if isinstance(value, dict):
        if isinstance(value.get("sequence"), str) and isinstance(value.get("frame"), str):
            return (f"{value['sequence']}/{value['frame']}",)
        raise DatasetError(
            f"the split {where} is not a list of sequences; {_keys(value)}, name one of them after a dot"
        )
    entries = [value] if isinstance(value, str) else value
    if isinstance(entries, list):
        entries = [_of_set_list(entry) for entry in entries]
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, str) for entry in entries):
        raise DatasetError(f"the split {where} holds {str(value)[:60]}, expected a list of names of sequences")
    if not all(_FRAME.fullmatch(entry) for entry in entries):
        return tuple(entries)
    sequence = next((name for name in reversed(names) if "_" in name and name != names[0]), None)
    if sequence is None:
        raise DatasetError(f"the split {where} lists frames, but no part of its key names their sequence")
    return tuple(f"{sequence}/{entry}" for entry in entries)


def _of_set_list(entry: Any) -> Any:
    """``SEQUENCE/FRAME`` of an entry of CO3D's set lists, ``[sequence, frame number, path]``; others as they are."""
    if isinstance(entry, list) and len(entry) == 3 and isinstance(entry[0], str) and isinstance(entry[1], int):
        return f"{entry[0]}/{entry[1]}"
    return entry


def _keys(value: Any) -> str:
    return f"it has {shortened(', '.join(value))}" if isinstance(value, dict) else "nothing lies below it"
