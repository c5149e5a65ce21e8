"""Header fields: common syntax (RFC 9110 5.5 and 5.6) and web links (RFC 8288).

All functions are pure functions of text. Input is untrusted: no function takes more than linear time. Output that could
end the field early is rejected (ValueError).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from urllib.parse import quote, unquote

from msgspec import Struct

TOKEN = r"[!#$%&'*+\-.^_`|~0-9A-Za-z]+"
QUOTED = r'"(?:[^"\\]|\\.)*"'
_IS_TOKEN = re.compile(TOKEN)
_UNSAFE = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_NUMBER = re.compile(r"([0-9]{1,20}(\.[0-9]{0,20})?|\.[0-9]{1,20})([eE][+-]?[0-9]{1,3})?")
_PAIR = re.compile(r"\\(.)", re.DOTALL)


def parse_decimal(text: str) -> float | None:
    """Return the decimal number in a query parameter, or None for other text, such as `1_0`, `inf` and `+1`."""
    return float(text) if _NUMBER.fullmatch(text) else None


def is_token(text: str) -> bool:
    """Whether `text` is a token (RFC 9110 5.6.2)."""
    return _IS_TOKEN.fullmatch(text) is not None


def require_field_value(value: str) -> str:
    """Return a value that is valid in a header field (RFC 9110 5.5) unchanged.

    Raises ValueError for CR, LF, NUL, other controls, and characters outside ASCII.
    """
    if _UNSAFE.search(value):
        raise ValueError(f"a header field cannot contain control characters: {value!r}")
    if not value.isascii():
        raise ValueError(f"a header field can contain only ASCII: {value!r}")
    return value


def quote_string(text: str) -> str:
    """Return `text` as a quoted-string (RFC 9110 5.6.4). Raises ValueError for text that cannot be quoted."""
    return '"' + require_field_value(text).replace("\\", "\\\\").replace('"', '\\"') + '"'


def unquote_string(text: str) -> str:
    """Return the content of a quoted-string; a bare token is its own content."""
    if len(text) >= 2 and text[0] == text[-1] == '"':
        return _PAIR.sub(r"\1", text[1:-1])
    return text


def split_members(text: str, separator: str) -> Iterator[str]:
    """Yield the stripped parts of `text` between separators outside quoted strings and `<>`.

    Empty parts are skipped (RFC 9110 5.6.1.2). An unterminated quoted string extends to the end.
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
    """Return a `name=value` or `name="value"` (RFC 9110 5.6.6) with a lower-case name; a bare name has the value "".

    Raises ValueError if the name is not a token, or the value neither a token nor a quoted-string.
    """
    name, equals, value = text.partition("=")
    name, value = name.strip(" \t").lower(), value.strip(" \t")
    if not is_token(name):
        raise ValueError(f"{name!r} is not a parameter name")
    if equals and not (is_token(value) or re.fullmatch(QUOTED, value, re.DOTALL)):
        raise ValueError(f"{value!r} is neither a token nor a quoted string")
    return name, unquote_string(value)


_FORBIDDEN = re.compile(r"[\x00-\x20\x7f<>\"{}|\\^`]")
_RESERVED = "!#$%&'()*+,/:;=?@[]~"
_EXTENDED = re.compile(r"utf-8'[^']*'(.*)", re.IGNORECASE | re.DOTALL)
_ATTRIBUTE_CHARS = "!#$&+^`|~"


class Link(Struct, frozen=True):
    """A link from the current resource (or from `anchor`) to `target`.

    `rel` contains one or more relation types, separated by spaces; `attributes` are further target attributes.
    """

    target: str
    rel: str
    type: str | None = None
    title: str | None = None
    anchor: str | None = None
    attributes: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return "; ".join((f"<{to_uri(self.target)}>", *self._parameters()))

    def _parameters(self) -> Iterator[str]:
        yield f"rel={quote_string(self.rel)}"
        if self.anchor is not None:
            yield f"anchor={quote_string(to_uri(self.anchor))}"
        if self.type is not None:
            yield f"type={quote_string(self.type)}"
        if self.title is not None:
            yield from _text("title", self.title)
        for name, value in self.attributes:
            if not is_token(name):
                raise ValueError(f"{name!r} is not a valid target attribute name")
            yield f"{name}={quote_string(value)}"


def render_links(links: Iterable[Link]) -> str:
    """Return the Link field of these links. Raises ValueError for values that could end a link or the field early."""
    return ", ".join(map(str, links))


def parse_links(text: str) -> tuple[Link, ...]:
    """Return the links of a Link field, skipping malformed ones (RFC 8288, appendix B.2)."""
    return tuple(link for member in split_members(text, ",") for link in _link(member))


def to_uri(iri: str) -> str:
    """Return the URI of an IRI (RFC 3987 3.1): non-ASCII characters are percent-encoded as UTF-8.

    Raises ValueError for characters that no IRI reference contains, such as spaces, quotes and angle brackets.
    """
    if _FORBIDDEN.search(iri):
        raise ValueError(f"{iri!r} is not an IRI reference")
    return quote(iri, safe=_RESERVED)


def _text(name: str, value: str) -> Iterator[str]:
    """Yield a parameter with free text: quoted if possible, else extended (RFC 8187)."""
    try:
        yield f"{name}={quote_string(value)}"
    except ValueError:
        yield f"{name}*=UTF-8''{quote(value, safe=_ATTRIBUTE_CHARS)}"


def _link(member: str) -> Iterator[Link]:
    end = member.find(">")
    if not member.startswith("<") or end < 0:
        return
    try:
        found = _first_of_each(map(parse_parameter, split_members(member[end + 1 :], ";")))
        yield Link(
            target=to_uri(member[1:end].strip(" \t")),
            rel=found.pop("rel"),
            type=found.pop("type", None),
            title=_title(found.pop("title*", None), found.pop("title", None)),
            anchor=found.pop("anchor", None),
            attributes=tuple(found.items()),
        )
    except (KeyError, ValueError):
        return


def _first_of_each(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, value in pairs:
        found.setdefault(name, value)
    return found


def _title(extended: str | None, plain: str | None) -> str | None:
    """Return the title, preferring the extended one if it is valid (RFC 8288 3.4.1)."""
    match = _EXTENDED.fullmatch(extended or "")
    return unquote(match[1], errors="replace") if match else plain
