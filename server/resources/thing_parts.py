"""Parts of a Thing Description of many affordances (WoT TD 1.1): some of them, with a link to the next. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias
from urllib.parse import urljoin

import orjson

from rosld.server.rest.path_item import MAX_PART, part_url

_Affordance: TypeAlias = "Mapping[str, object]"
_KINDS = ("properties", "actions")
_PUNCTUATION = 6
"""Bytes between the members of an object."""
_FRAME = 600
"""Bytes for links to the whole and to the next part."""


@dataclass(frozen=True, slots=True)
class _Named:
    """An affordance, of which kind it is and what it is called."""

    kind: str
    name: str
    affordance: _Affordance


def add_part_link(data: bytes, url: str) -> bytes:
    """A description that links to its first part, if it has several; `url` is its own."""
    if len(data) <= MAX_PART:
        return data
    thing = orjson.loads(data)
    return orjson.dumps({**thing, "links": [*thing["links"], _link("section", part_url(url, "/"))]})


def thing_parts(data: bytes, base: str, url: str, below: str) -> tuple[bytes, ...]:
    """The parts of the description at `url` with the affordances at paths below `base` that begin with `below`.

    None where there are none.
    """
    thing = orjson.loads(data)
    affordances = [
        _Named(kind, name, one)
        for kind in _KINDS
        for name, one in thing.get(kind, {}).items()
        if _is_below(one, thing["id"], base, below)
    ]
    head = {**{name: each for name, each in thing.items() if name not in _KINDS}, "links": [_link("collection", url)]}
    room = MAX_PART - len(orjson.dumps(head)) - 2 * len(url) - 3 * len(below) - _FRAME
    parts = tuple(_cut(affordances, room))
    return tuple(
        orjson.dumps(
            {
                **head,
                **{kind: {one.name: one.affordance for one in part if one.kind == kind} for kind in _KINDS},
                "links": [
                    *head["links"],
                    *([_link("next", part_url(url, below, number))] if number < len(parts) else ()),
                ],
            }
        )
        for number, part in enumerate(parts, 1)
    )


def _cut(affordances: list[_Named], room: int) -> Iterator[list[_Named]]:
    """Affordances in their order, as many at a time as have room together, but one at the least."""
    part: list[_Named] = []
    size = 0
    for one in affordances:
        own = len(orjson.dumps(one.affordance)) + len(orjson.dumps(one.name)) + _PUNCTUATION
        if part and size + own > room:
            yield part
            part, size = [], 0
        part.append(one)
        size += own
    if part:
        yield part


def _is_below(affordance: _Affordance, own: str, base: str, below: str) -> bool:
    """Whether a form of an affordance leads to a path below `base` that begins with `below`."""
    forms = affordance["forms"]
    assert isinstance(forms, list)
    return any(urljoin(own, form["href"]).startswith(base.rstrip("/") + below) for form in forms)


def _link(relation: str, target: str) -> dict[str, str]:
    """A link to a Thing Description (RFC 6573, RFC 8288)."""
    return {"rel": relation, "href": target, "type": "application/td+json"}
