"""The catalogue of resources that follow from a robot's names by convention (paper, section 4.2; Listings 1 and 2).

A `Property` has a value: `NS/get_X`, `NS/set_X`, the topic `NS/X` and the parameter `NS/X` form one property. An
`Action` is a service that is neither a getter nor a setter, or a ROS action, which has properties for the state of its
goal below its name. `conventions.py` proposes both, `type_inference.py` checks their types.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TypeAlias

from msgspec import Struct, field

from rosld.adapters.model import ActionSchema, Field, MessageSchema, ServiceSchema
from rosld.ontology.names import Members
from rosld.ontology.urls import Space
from rosld.shapes.value import ValueShape


class TopicSource(Struct, frozen=True):
    """A topic: read as its latest message, written by publishing. `schema` is None if its type is unknown."""

    name: str
    schema: MessageSchema | None


class Getter(Struct, frozen=True):
    """A service with an empty request that returns the value in `fields` of its response, besides a status."""

    name: str
    schema: ServiceSchema
    fields: tuple[Field, ...]


class Setter(Struct, frozen=True):
    """A service whose request is the value."""

    name: str
    schema: ServiceSchema


class ParameterSource(Struct, frozen=True):
    """A parameter."""

    name: str


class GoalPart(Enum):
    """Part of the state of an action's current or last goal; the value is the last segment of the property's name."""

    STATUS = "status"
    GOAL = "goal"
    FEEDBACK = "feedback"
    RESULT = "result"


IDLE = "idle"
"""Status of an action without a known goal."""


class GoalSource(Struct, frozen=True):
    """Part of the goal of a ROS action. `schema` is that of the part; None for the status, which is a word."""

    name: str
    part: GoalPart
    schema: MessageSchema | None


Reader: TypeAlias = TopicSource | Getter | ParameterSource | GoalSource
Writer: TypeAlias = Setter | ParameterSource | TopicSource


def source_url(way: Reader | Writer, space: Space) -> str:
    """Return the URL of a topic, service, parameter or action."""
    match way:
        case TopicSource():
            return space.topic(way.name)
        case GoalSource():
            return space.action(way.name)
        case ParameterSource():
            return space.parameter(way.name)
        case _:
            return space.service(way.name)


class Property(Struct, frozen=True):
    """A resource with a value, by its full name (`/aircraft/engine/speed`).

    `shape` is that of the first reader, else of the first writer. `readers` and `writers` are in the order in which
    they are tried: topic, getter, parameter, goal; setter, parameter, topic. A writer is able to write by its kind; its
    permission is checked at the time of the write.
    """

    name: str
    shape: ValueShape
    readers: tuple[Reader, ...] = ()
    writers: tuple[Writer, ...] = ()


class Action(Struct, frozen=True):
    """A resource that performs an operation, named after its service or (`sends_goals`) its ROS action.

    `schema` is None if its type is unknown, so that it cannot be invoked.
    """

    name: str
    service: str
    schema: ServiceSchema | ActionSchema | None
    sends_goals: bool = False


class Catalogue(Struct, frozen=True):
    """All resources found by convention, by full name; a name may be both a property and an action.

    `namespaces` are those of both. The `by_` mappings map the name of a topic, service or parameter to the full name of
    the property that it reads or writes. A service in none of them is an action or excluded.
    """

    properties: Mapping[str, Property] = field(default_factory=dict)
    actions: Mapping[str, Action] = field(default_factory=dict)
    namespaces: Mapping[tuple[str, ...], Members] = field(default_factory=dict)
    by_topic: Mapping[str, str] = field(default_factory=dict)
    by_service: Mapping[str, str] = field(default_factory=dict)
    by_parameter: Mapping[str, str] = field(default_factory=dict)
