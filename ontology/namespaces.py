"""Namespaces: which names lie directly in which, found for thousands of names in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

_K = TypeVar("_K")
_V = TypeVar("_V")


@dataclass(frozen=True, slots=True)
class Members:
    """The direct members of a namespace, by their last segment, sorted: names, and namespaces below.

    A segment that is both is in both.
    """

    leaves: tuple[str, ...] = ()
    namespaces: tuple[str, ...] = ()


def members_of(names: Iterable[str]) -> dict[tuple[str, ...], Members]:
    """The members of every namespace of these global names, by the namespace's segments; `()` is always there."""
    leaves: dict[tuple[str, ...], list[str]] = {(): []}
    below: dict[tuple[str, ...], set[str]] = {}
    for name in names:
        *path, leaf = name[1:].split("/")
        namespace = tuple(path)
        if namespace not in leaves:
            _open(namespace, leaves, below)
        leaves[namespace].append(leaf)
    return {
        namespace: Members(tuple(sorted(found)), tuple(sorted(below.get(namespace, ()))))
        for namespace, found in leaves.items()
    }


def _open(
    namespace: tuple[str, ...], leaves: dict[tuple[str, ...], list[str]], below: dict[tuple[str, ...], set[str]]
) -> None:
    """Makes a namespace known to all those it lies in."""
    while namespace not in leaves:
        leaves[namespace] = []
        below.setdefault(namespace[:-1], set()).add(namespace[-1])
        namespace = namespace[:-1]


class IdentityCache(Generic[_K, _V]):
    """Remembers what was computed from the last few immutable values, by identity.

    A graph is looked at very often before it changes, and too large to be compared.
    """

    def __init__(self, compute: Callable[[_K], _V], limit: int = 8) -> None:
        self._compute = compute
        self._limit = limit
        self._kept: tuple[tuple[_K, _V], ...] = ()

    def __call__(self, key: _K) -> _V:
        for known, value in self._kept:
            if known is key:
                return value
        value = self._compute(key)
        # One assignment, so that threads see either the old or the new; at worst something is computed twice.
        self._kept = ((key, value), *self._kept[: self._limit - 1])
        return value


def _namespaces(names: Mapping[str, object]) -> frozenset[tuple[str, ...]]:
    return frozenset(members_of(names))


namespaces_of: IdentityCache[Mapping[str, object], frozenset[tuple[str, ...]]] = IdentityCache(_namespaces)
"""The namespaces of the names of one kind in a graph."""


def is_namespace(name: str, names: Mapping[str, object]) -> bool:
    """Whether a name is also the namespace of others among `names` (a mapping that never changes)."""
    return tuple(name[1:].split("/")) in namespaces_of(names)
