"""The IRIs, prefixes and JSON-LD terms of message types, all derived from their names alone."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from rosld.ontology.vocab import PREFIXES

_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/([a-z]+)/([A-Za-z][A-Za-z0-9_]*)")
_CAPITALS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]+")


class TypeName(NamedTuple):
    """What a type is called: `iri` is its class, `iri#field` its properties.

    In Turtle the class is `package:short` (`geometry_msgs:Twist`, in `namespace`) and a property `prefix:field`
    (`twist:linear`); `term` (`geometry_msgs.Twist`) is its term in JSON-LD, which no other type has.
    """

    iri: str
    namespace: str
    package: str
    short: str
    prefix: str
    term: str

    def property(self, field: str) -> str:
        """The IRI of a field."""
        return f"{self.iri}#{field}"


def type_names(names: Iterable[str], types: str) -> Mapping[str, TypeName]:
    """What these ROS types are called in the namespace `types`; no two of them share a prefix or a term.

    Raises ValueError for a name that is not PACKAGE/KIND/NAME in ASCII letters, digits and underscores.
    """
    plain = {name: _type_name(name, types) for name in names}
    wanted = Counter(each.prefix for each in plain.values())
    taken = {each.package for each in plain.values()} | PREFIXES.keys() | {"_"}
    return {
        name: each if wanted[each.prefix] == 1 and each.prefix not in taken else each._replace(prefix=each.term)
        for name, each in plain.items()
    }


def _type_name(name: str, types: str) -> TypeName:
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is no name of a ROS type: it should look like geometry_msgs/msg/Twist")
    package, kind, short = match.groups()
    qualified = package if kind == "msg" and package not in PREFIXES else f"{package}-{kind}"
    prefix = _CAPITALS.sub(lambda capitals: capitals[0].lower(), short, count=1) if short[0].isupper() else short
    return TypeName(f"{types}{name}", f"{types}{package}/{kind}/", qualified, short, prefix, f"{qualified}.{short}")
