"""The IRIs, prefixes and JSON-LD terms of message types, all derived from their names alone.

No two types share one, so that what is written of different schemas can stand in one document.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/([a-z]+)/([A-Za-z][A-Za-z0-9_]*)")
_TAKEN = frozenset(
    {"dcat", "dct", "dcterms", "foaf", "hctl", "hydra", "ldp", "owl", "prov", "rdf", "rdfs", "ros"}
    | {"schema", "sh", "skos", "sosa", "ssn", "td", "xsd"}
)


class TypeName(NamedTuple):
    """What a type is called: `iri` is its class, `iri#field` its properties.

    `term` (`geometry_msgs.Twist`) is its JSON-LD term and the Turtle prefix of its properties; `package`
    (`geometry_msgs`) is the Turtle prefix of `namespace`, in which the class is `short`.
    """

    iri: str
    term: str
    package: str
    namespace: str
    short: str

    def property(self, field: str) -> str:
        """The IRI of a field."""
        return f"{self.iri}#{field}"


def type_name(name: str, namespace: str) -> TypeName:
    """The names of the ROS type `name` in the namespace of types.

    Raises ValueError for a name that is not PACKAGE/KIND/NAME in ASCII letters, digits and underscores.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is no name of a ROS type: it should look like geometry_msgs/msg/Twist")
    package, kind, short = match.groups()
    prefix = package if kind == "msg" and package not in _TAKEN else f"{package}-{kind}"
    return TypeName(f"{namespace}{name}", f"{prefix}.{short}", prefix, f"{namespace}{package}/{kind}/", short)
