"""Groups of names: a page that lists very many members shows them folded, by namespace, to be unfolded or filtered."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Generic, TypeVar

MAX_ROWS = 40
"""Rows of a table that a page shows one below the other. More of them are folded, by namespace."""
MAX_OPEN = 16
"""Rows of a group that is unfolded from the beginning."""
_MAX_GROUPS = 40
_T = TypeVar("_T")
_V = TypeVar("_V")


@dataclass(frozen=True, slots=True)
class NameGroup(Generic[_T]):
    """What has names of one namespace, or names next to each other; `is_open`: it is unfolded from the beginning."""

    title: str
    items: tuple[_T, ...]
    is_open: bool = False


def group_names(items: Sequence[_T], name: Callable[[_T], str]) -> tuple[NameGroup[_T], ...]:
    """The items by the first part of their names, those in no namespace first; none where they are few.

    A page has a bounded number of groups: of very many namespaces several are one, and so are very many names in none.
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
    """The items in at most `limit` parts of one size, in their order."""
    size = max(1, ceil(len(items) / min(limit, _MAX_GROUPS)))
    for start in range(0, len(items), size):
        yield items[start : start + size]
