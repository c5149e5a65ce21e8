"""Names: namespaces of ROS names, and IRIs of types."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Generic, NamedTuple, TypeVar

from msgspec import Struct

from rosld.ontology.vocab import PREFIXES

_K = TypeVar("_K")
_V = TypeVar("_V")


class Members(Struct, frozen=True):
    """The direct members of a namespace, by their last segment, sorted: names, and namespaces below.

    A segment can be in both.
    """

    leaves: tuple[str, ...] = ()
    namespaces: tuple[str, ...] = ()


def members_of(names: Iterable[str]) -> dict[tuple[str, ...], Members]:
    """Return the members of every namespace of these global names by the namespace's segments; `()` always exists."""
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
    while namespace not in leaves:
        leaves[namespace] = []
        below.setdefault(namespace[:-1], set()).add(namespace[-1])
        namespace = namespace[:-1]


class IdentityCache(Generic[_K, _V]):
    """Cache of values computed from the last few immutable values, compared by identity.

    A graph is read very often before it changes, and is too large to be compared.
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
        # One assignment, so that threads see either the old or the new; at worst a value is computed twice.
        self._kept = ((key, value), *self._kept[: self._limit - 1])
        return value


def _namespaces(names: Mapping[str, object]) -> frozenset[tuple[str, ...]]:
    return frozenset(members_of(names))


namespaces_of: IdentityCache[Mapping[str, object], frozenset[tuple[str, ...]]] = IdentityCache(_namespaces)
"""The namespaces of the names of one kind in a graph."""


def is_namespace(name: str, names: Mapping[str, object]) -> bool:
    """Whether a name is also the namespace of others among `names` (a mapping that never changes)."""
    return tuple(name[1:].split("/")) in namespaces_of(names)


_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/([a-z]+)/([A-Za-z][A-Za-z0-9_]*)")
_CAPITALS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]+")


class TypeName(NamedTuple):
    """Names of a type: `iri` is its class, `iri#field` are its properties.

    In Turtle the class is `package:short` (`geometry_msgs:Twist`, in `namespace`) and a property `prefix:field`
    (`twist:linear`); `term` (`geometry_msgs.Twist`) is its unique term in JSON-LD.
    """

    iri: str
    namespace: str
    package: str
    short: str
    prefix: str
    term: str

    def property(self, field: str) -> str:
        """Return the IRI of a field."""
        return f"{self.iri}#{field}"


def type_names(names: Iterable[str], types: str) -> Mapping[str, TypeName]:
    """Return the names of these ROS types in the namespace `types`; no two share a prefix or a term.

    Raises ValueError for a name that is not PACKAGE/KIND/NAME in ASCII letters, digits and underscores.
    """
    plain = {name: _type_name(name, types) for name in names}
    wanted = Counter(each.prefix for each in plain.values())
    reserved = {each.package for each in plain.values()} | PREFIXES.keys() | {"_"}
    return {
        name: each if wanted[each.prefix] == 1 and each.prefix not in reserved else each._replace(prefix=each.term)
        for name, each in plain.items()
    }


def _type_name(name: str, types: str) -> TypeName:
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is not a ROS type name: it must look like geometry_msgs/msg/Twist")
    package, kind, short = match.groups()
    qualified = package if kind == "msg" and package not in PREFIXES else f"{package}-{kind}"
    prefix = _CAPITALS.sub(lambda capitals: capitals[0].lower(), short, count=1) if short[0].isupper() else short
    return TypeName(f"{types}{name}", f"{types}{package}/{kind}/", qualified, short, prefix, f"{qualified}.{short}")
