"""Brief values as a line for people: `percentage 0.83, voltage 12.4 …` of the brief JSON of a list."""

from __future__ import annotations

import json
from collections.abc import Iterator

from rosld.server.html.view import escape_controls

_MAX_CHARACTERS = 110
_MORE = "..."


def brief_text(value: str) -> str:
    """The line for a brief value, a part of it where that is too long."""
    parsed: object = json.loads(value)
    if isinstance(parsed, dict) and parsed.keys() == {"data"}:
        parsed = parsed["data"]
    parts = list(_parts(parsed, ""))
    line = ", ".join(part for part in parts if part != _MORE)
    if len(line) > _MAX_CHARACTERS:
        cut = line[:_MAX_CHARACTERS]
        return escape_controls(f"{cut.rpartition(',')[0] or cut} …")
    return escape_controls(f"{line} …".lstrip() if _MORE in parts else line)


def _parts(value: object, path: str) -> Iterator[str]:
    """The scalars of a value, each after the path that leads to it."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name == _MORE:
                yield _MORE
            else:
                yield from _parts(inner, f"{path}.{name}" if path else name)
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        for index, inner in enumerate(value):
            yield from _parts(inner, f"{path}[{index}]") if inner != _MORE else iter([_MORE])
    else:
        text = _scalar(value) if not isinstance(value, list) else f"[{', '.join(map(_scalar, value))}]"
        yield f"{path} {text}" if path else text


def _scalar(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
