"""Members described in brief where many resources are listed: name, type, rate and latest value of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import TypeRef
from rosld.ontology.triples import double, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros

_TYPE_RELATIONS: Mapping[NamedNode, NamedNode] = {
    ros.Topic: ros.hasMessageType,
    ros.Service: ros.hasServiceType,
    ros.Action: ros.hasActionType,
}


@dataclass(frozen=True, slots=True)
class MemberOutline:
    """A resource in a list: its URL, its class (None: not told), its name, and what is at hand of it.

    `types` are its ROS types; two or more contradict each other. `rate` is in messages a second, `value`
    brief plain JSON; both are None where they are not at hand.
    """

    url: str
    kind: NamedNode | None
    name: str | None
    types: tuple[TypeRef | str, ...] = ()
    rate: float | None = None
    value: str | None = None


def member_triples(member: MemberOutline, space: Space) -> list[Triple]:
    """The triples of a member of a list."""
    relation = None if member.kind is None else _TYPE_RELATIONS.get(member.kind)
    name = member.name and (member.name.rstrip("/") or "/")  # as a container says it of itself
    return triples_about(
        NamedNode(member.url),
        (rdf.type, member.kind),
        (ros.name, text(name)),
        *(() if relation is None else _types(relation, member.types, space)),
        (ros.rate, None if member.rate is None else double(member.rate)),
        (ros.briefValue, None if member.value is None else Literal(member.value, datatype=rdf.JSON)),
    )


def _types(
    relation: NamedNode, types: tuple[TypeRef | str, ...], space: Space
) -> list[tuple[NamedNode, NamedNode | Literal]]:
    if len(types) == 1:
        (type,) = types
        return [(relation, NamedNode(space.class_of(type if isinstance(type, str) else type.name)))]
    return [(ros.conflictingType, NamedNode(space.type(type))) for type in types]
