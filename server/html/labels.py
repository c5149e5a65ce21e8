"""Labels: words for predicates and fields, and groups of names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from math import ceil
from typing import Generic, TypeVar

from msgspec import Struct

_HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_WORDS = {
    "contains": "contains",
    "comment": "about",
    "md5": "MD5",
    "typeHash": "type hash",
    "uri": "URI",
    "isDefinedBy": "defined by",
    "subClassOf": "is a kind of",
    "subPropertyOf": "is a kind of",
    "seeAlso": "see also",
}


def local_name(iri: str) -> str:
    """Return the part of an IRI after the last `#`, `/` or `:`, ignoring trailing ones."""
    return re.split(r"[#/:]", iri.rstrip("#/:"))[-1] or iri


@lru_cache(maxsize=4096)
def label(iri: str) -> str:
    """Return the words for a predicate: `hasMessageType` is "message type"."""
    name = local_name(iri)
    return _WORDS.get(name) or split_words(name).removeprefix("has ")


def split_words(name: str) -> str:
    """Return `messageType` and `message_type` as "message type"; capitalized abbreviations stay unchanged."""
    parts = _HUMP.sub(" ", name.replace("_", " ")).split()
    return " ".join(part if part.isupper() else part.lower() for part in parts) or name


def capitalize(text: str) -> str:
    """Return `text` with its first letter capitalized."""
    return text[:1].upper() + text[1:]


MAX_ROWS = 40
"""Maximum number of rows in a plain table; more are folded by namespace."""
MAX_OPEN = 16
"""Maximum number of rows in a group that is initially open."""
_MAX_GROUPS = 40
_T = TypeVar("_T")
_V = TypeVar("_V")


class NameGroup(Struct, Generic[_T], frozen=True):
    """Items with names in one namespace, or a run of adjacent items; `is_open`: initially unfolded."""

    title: str
    items: tuple[_T, ...]
    is_open: bool = False


def group_names(items: Sequence[_T], name: Callable[[_T], str]) -> tuple[NameGroup[_T], ...]:
    """Return the items by the first segment of their names, those without a namespace first; empty if there are few.

    The number of groups is bounded: many namespaces share groups, and many names without a namespace are split into
    runs.
    """
    if len(items) <= MAX_ROWS:
        return ()
    namespaces: dict[str, list[_T]] = {}
    direct: list[_T] = []
    for item in items:
        first, slash, _ = name(item).partition("/")
        (namespaces.setdefault(first, []) if slash else direct).append(item)
    return (*_groups_of_names(direct, name), *_groups_of_namespaces(namespaces))


def _groups_of_names(items: Sequence[_T], name: Callable[[_T], str]) -> Iterator[NameGroup[_T]]:
    for part in _parts(items, max(1, ceil(len(items) / MAX_ROWS))):
        title = name(part[0]) if len(part) == 1 else f"{name(part[0])} … {name(part[-1])}"
        yield NameGroup(title, tuple(part), is_open=len(items) <= MAX_OPEN)


def _groups_of_namespaces(namespaces: dict[str, list[_T]]) -> Iterator[NameGroup[_T]]:
    for part in _parts(list(namespaces), _MAX_GROUPS):
        title = f"{part[0]}/" if len(part) == 1 else f"{part[0]}/ … {part[-1]}/"
        yield NameGroup(title, tuple(item for first in part for item in namespaces[first]))


def _parts(items: Sequence[_V], limit: int) -> Iterator[Sequence[_V]]:
    """Yield the items in at most `limit` parts of equal size, in order."""
    size = max(1, ceil(len(items) / min(limit, _MAX_GROUPS)))
    for start in range(0, len(items), size):
        yield items[start : start + size]
