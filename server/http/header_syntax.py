"""Header fields: reading and writing their common pieces (RFC 9110 5.5 and 5.6), with nothing injectable.

Everything here is a pure function of text. What is read comes from strangers, so no function's work grows faster
than the text; what is written is refused (ValueError) when it could end the field early.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

TOKEN = r"[!#$%&'*+\-.^_`|~0-9A-Za-z]+"
QUOTED = r'"(?:[^"\\]|\\.)*"'
_IS_TOKEN = re.compile(TOKEN)
_UNSAFE = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_NUMBER = re.compile(r"([0-9]{1,20}(\.[0-9]{0,20})?|\.[0-9]{1,20})([eE][+-]?[0-9]{1,3})?")
_PAIR = re.compile(r"\\(.)", re.DOTALL)


def parse_decimal(text: str) -> float | None:
    """The decimal number that a query parameter gives, None for everything else, such as `1_0`, `inf` and `+1`."""
    return float(text) if _NUMBER.fullmatch(text) else None


def is_token(text: str) -> bool:
    """Whether `text` is a token (RFC 9110 5.6.2)."""
    return _IS_TOKEN.fullmatch(text) is not None


def require_field_value(value: str) -> str:
    """The value unchanged, if it may stand in a header field (RFC 9110 5.5): no CR, LF, NUL or other control.

    Raises ValueError otherwise, also for characters that no header can carry (outside Latin-1).
    """
    if _UNSAFE.search(value):
        raise ValueError(f"a header field cannot hold control characters: {value!r}")
    if not value.isascii():
        raise ValueError(f"a header field holds ASCII only: {value!r}")
    return value


def quote(text: str) -> str:
    """`text` as a quoted-string (RFC 9110 5.6.4). Raises ValueError for what cannot be quoted."""
    return '"' + require_field_value(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def unquote(text: str) -> str:
    """The content of a quoted-string; a bare token is its own content."""
    if len(text) >= 2 and text[0] == text[-1] == '"':
        return _PAIR.sub(r"\1", text[1:-1])
    return text


def split(text: str, separator: str) -> Iterator[str]:
    """The parts of `text` between separators that stand outside quoted strings and `<>`, stripped.

    Empty parts are left out, as RFC 9110 5.6.1.2 has it. An unfinished quoted string reaches to the end.
    """
    start, quoted, angled, escaped = 0, False, False, False
    for place, char in enumerate(text):
        if escaped:
            escaped = False
        elif quoted:
            escaped, quoted = char == "\\", char != '"'
        elif angled:
            angled = char != ">"
        elif char == '"':
            quoted = True
        elif char == "<":
            angled = True
        elif char == separator:
            yield from _part(text[start:place])
            start = place + 1
    yield from _part(text[start:])


def _part(text: str) -> Iterator[str]:
    stripped = text.strip(" \t")
    if stripped:
        yield stripped


def parse_parameter(text: str) -> tuple[str, str]:
    """One `name=value` or `name="value"` (RFC 9110 5.6.6); the name in lower case; a bare name has the value "".

    Raises ValueError where the name is no token or the value is neither token nor quoted-string.
    """
    name, equals, value = text.partition("=")
    name, value = name.strip(" \t").lower(), value.strip(" \t")
    if not is_token(name):
        raise ValueError(f"{name!r} is no parameter name")
    if equals and not (is_token(value) or re.fullmatch(QUOTED, value, re.DOTALL)):
        raise ValueError(f"{value!r} is neither a token nor a quoted string")
    return name, unquote(value)
