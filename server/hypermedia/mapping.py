"""Mappings as values: documents of `map:` that arrange resources, name relations and define conditions. Pure.

`mapping_parser.py` reads them from RDF. Paths and names are those of resources without `/resources`: a path
(`/aircraft/`) ends in a slash and is a complex resource, a name (`/aircraft/power`) does not and is a property or an
action.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import Struct, field
from pyoxigraph import NamedNode

from rosld.ontology.units import UNKNOWN, Quantity
from rosld.server.robot.software_stop import StopCommand
from rosld.shapes.shapes_graph import NodeShape


class Condition(Struct, frozen=True):
    """A SHACL node shape for the state of one resource: the complex resource or the property `about`.

    The focus node is the URL of that resource. The state of a complex resource is its properties by predicate, that of
    a property is its rdf:value. `iri` identifies the condition in reports.
    """

    iri: str
    about: str
    shape: NodeShape


class MappedProperty(Struct, frozen=True):
    """A value (or, with `field`, one scalar of it: `pose.position.x`) as a property of a complex resource.

    `name` is its key in plain JSON and in Thing Descriptions. It is writable only while all of `writable_when` hold.
    """

    predicate: NamedNode
    member: str
    name: str
    field: str | None = None
    quantity: Quantity = UNKNOWN
    writable_when: tuple[Condition, ...] = ()


class MappedAction(Struct, frozen=True):
    """A service offered as `name` under a complex resource, linked by `relation`, while all conditions hold."""

    relation: NamedNode
    name: str
    service: str
    available_when: tuple[Condition, ...] = ()


class MappedLink(Struct, frozen=True):
    """A link from a complex resource to another one (`target` is its path), while all conditions hold."""

    relation: NamedNode
    target: str
    available_when: tuple[Condition, ...] = ()


class MappedStop(Struct, frozen=True):
    """A command that stops the robot, and the conditions under which its refusal is no failure."""

    command: StopCommand
    at_rest_when: tuple[Condition, ...] = ()


class ComplexResource(Struct, frozen=True):
    """A complex resource defined by a mapping; it adds to the resources found at `path`."""

    iri: str
    path: str
    properties: tuple[MappedProperty, ...] = ()
    actions: tuple[MappedAction, ...] = ()
    links: tuple[MappedLink, ...] = ()
    exists_when: tuple[Condition, ...] = ()
    title: str | None = None
    stops: tuple[MappedStop, ...] = ()

    def conditions(self) -> Iterator[Condition]:
        """Yield every condition of the resource, its properties, actions and links."""
        yield from self.exists_when
        for one in self.properties:
            yield from one.writable_when
        for action in self.actions:
            yield from action.available_when
        for link in self.links:
            yield from link.available_when

    def all_conditions(self) -> Iterator[Condition]:
        """Yield these conditions and those of stop commands, which do not affect what is on offer."""
        yield from self.conditions()
        for stop in self.stops:
            yield from stop.at_rest_when


class MappingSet(Struct, frozen=True):
    """All mappings in force together, by path. `revision` changes with any of them."""

    revision: int = 0
    resources: Mapping[str, ComplexResource] = field(default_factory=dict)

    def stop_commands(self) -> Iterator[tuple[StopCommand, str]]:
        """Yield the stop commands, each with the IRI of the complex resource that defines it."""
        for resource in self.resources.values():
            yield from ((each.command, resource.iri) for each in resource.stops)

    def at_rest_when(self, command: StopCommand) -> tuple[Condition, ...]:
        """Return the conditions under which the refusal of a command is no failure; empty if it always is one."""
        found = [each for resource in self.resources.values() for each in resource.stops if each.command == command]
        conditional = all(each.at_rest_when for each in found)
        return tuple(condition for each in found for condition in each.at_rest_when) if conditional else ()
