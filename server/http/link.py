"""Web links in the Link field (RFC 8288), written and read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from urllib.parse import quote, unquote

from rosld.server.http import header_syntax

_FORBIDDEN = re.compile(r"[\x00-\x20\x7f<>\"{}|\\^`]")
_RESERVED = "!#$%&'()*+,/:;=?@[]~"
_EXTENDED = re.compile(r"utf-8'[^']*'(.*)", re.IGNORECASE | re.DOTALL)
_ATTRIBUTE_CHARS = "!#$&+^`|~"


@dataclass(frozen=True, slots=True)
class Link:
    """A link from the resource at hand (or from `anchor`) to `target`.

    `rel` holds one or more relation types, separated by spaces; `attributes` are further target attributes.
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
        yield f"rel={header_syntax.quote(self.rel)}"
        if self.anchor is not None:
            yield f"anchor={header_syntax.quote(to_uri(self.anchor))}"
        if self.type is not None:
            yield f"type={header_syntax.quote(self.type)}"
        if self.title is not None:
            yield from _text("title", self.title)
        for name, value in self.attributes:
            if not header_syntax.is_token(name):
                raise ValueError(f"{name!r} is no name of a target attribute")
            yield f"{name}={header_syntax.quote(value)}"


def render(links: Iterable[Link]) -> str:
    """The Link field of these links. Raises ValueError for what could end a link or the field early."""
    return ", ".join(map(str, links))


def parse(text: str) -> tuple[Link, ...]:
    """The links of a Link field; malformed ones are passed over (RFC 8288, appendix B.2)."""
    return tuple(link for member in header_syntax.split(text, ",") for link in _link(member))


def to_uri(iri: str) -> str:
    """The URI of an IRI (RFC 3987 3.1): what is not ASCII is percent-encoded as UTF-8.

    Raises ValueError for characters that no IRI reference holds, such as spaces, quotes and angle brackets.
    """
    if _FORBIDDEN.search(iri):
        raise ValueError(f"{iri!r} is no IRI reference")
    return quote(iri, safe=_RESERVED)


def _text(name: str, value: str) -> Iterator[str]:
    """A parameter with free text: quoted where it is plain, else extended (RFC 8187)."""
    try:
        yield f"{name}={header_syntax.quote(value)}"
    except ValueError:
        yield f"{name}*=UTF-8''{quote(value, safe=_ATTRIBUTE_CHARS)}"


def _link(member: str) -> Iterator[Link]:
    end = member.find(">")
    if not member.startswith("<") or end < 0:
        return
    try:
        found = _first_of_each(map(header_syntax.parse_parameter, header_syntax.split(member[end + 1 :], ";")))
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
    """The title: the extended one where it can be read (RFC 8288 3.4.1)."""
    match = _EXTENDED.fullmatch(extended or "")
    return unquote(match[1], errors="replace") if match else plain
